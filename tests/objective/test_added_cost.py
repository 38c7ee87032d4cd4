"""A cost in a file of its own, found by its name: everything that takes a cost knows it."""

import json
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from exact_costs import applied, inner, product, quadratic, spatial
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from strategies import definite

import certpgo
from certpgo import Estimate, Session, certify, solve, write
from certpgo.cli import main
from certpgo.errors import SpecError, UnusableFile
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective import costs as edge_costs
from certpgo.objective.choose_cost import (
    COSTS,
    Sum,
    costs_of,
    objective_of,
)

ADDED = Path(__file__).parents[1] / "data" / "edge_costs"
PRIOR = "and a planar-motion prior"


@pytest.fixture
def added(monkeypatch):
    """Adds files to the folder of costs for the time of a test, by default the toy one."""

    def add(folder):
        monkeypatch.setattr(edge_costs, "__path__", [*edge_costs.__path__, str(folder)])

    known = tuple(COSTS)
    add(ADDED)
    yield add
    for name in set(COSTS) - set(known):
        sys.modules.pop(f"{edge_costs.__name__}.{name}", None)


@pytest.fixture
def path(tmp_path):
    """A file of eight poses in space on a circle, with noisy steps and chords."""
    rng, n = np.random.default_rng(0), 8
    angle = 2.0 * np.pi * np.arange(n) / n
    R = so.exp(np.outer(angle, [0.0, 0.0, 1.0]))
    t = 5.0 * np.stack([np.sin(angle), -np.cos(angle), np.zeros(n)], axis=1)
    edges = np.array([(k, (k + s) % n) for s in (1, 3) for k in range(n)])
    i, j = edges.T
    m, back = len(edges), np.swapaxes(R[i], 1, 2)
    turns = back @ R[j] @ so.exp(0.03 * rng.standard_normal((m, 3)))
    v = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + 0.1 * rng.standard_normal((m, 3))
    information = Information.of(definite(rng, m, 6, 4.0), "g2o")
    rotation = RotationGraph(n, edges, turns, np.ones(m))
    graph = PoseGraph(rotation, v, np.ones(m), information=information)
    file = tmp_path / "flat.g2o"
    initial = Estimate(R, t)
    write(file, Instance("flat", graph, np.arange(n), initial=initial))
    return file


def test_the_file_is_short_and_found_by_its_name(added):
    assert len((ADDED / "planar.py").read_text().splitlines()) < 60
    assert tuple(COSTS) == ("chordal", "g2o", "gtsam", "planar")
    assert COSTS["planar"].name == "planar"


def test_a_file_that_is_no_cost_is_named(added, tmp_path):
    (tmp_path / "broken.py").write_text("1 / 0\n")
    (tmp_path / "other.py").write_text("from certpgo.objective.costs.g2o import COST\n")
    added(tmp_path)
    with pytest.raises(UnusableFile, match=r"broken\.py: cannot be loaded: ZeroDivisionError"):
        COSTS["broken"]
    with pytest.raises(UnusableFile, match=r"other\.py: COST must be called other, not g2o"):
        COSTS["other"]


def cost_of(rng, d, m=50, measured=None):
    """The toy cost of unconnected edges."""
    measured = so.random(rng, m, d) if measured is None else measured
    tau = 10.0 ** rng.uniform(-2.0, 2.0, m)
    edges = np.arange(2 * m).reshape(m, 2)
    graph = PoseGraph(
        RotationGraph(2 * m, edges, measured, np.ones(m)), rng.standard_normal((m, d)), tau
    )
    Omega = definite(rng, m, d * (d + 1) // 2, 10.0)
    return COSTS["planar"](graph.with_information(Omega))


@pytest.mark.parametrize("d", [2, 3])
def test_minorants_touch_and_are_nowhere_above(added, d):
    rng = np.random.default_rng(1)
    cost = cost_of(rng, d)
    m = cost.graph.num_edges
    Q0 = cost.graph.rotations @ so.exp(0.2 * rng.standard_normal((m, so.tangent_dim(d))))
    v0 = cost.graph.translations + rng.standard_normal((m, d))
    found = cost.minorants(v0, Q0)
    assert found.exist.mean() > 0.9

    def below(v, Q):
        arm = v + (Q @ found.a[:, :, None])[:, :, 0] - found.b
        inner = np.einsum("mab,mab->m", found.N, Q)
        return found.tau * (arm**2).sum(axis=1) - 2.0 * inner + found.constant

    here, kept = cost.costs(v0, Q0), found.exist
    assert (np.abs(here - below(v0, Q0))[kept] <= 1e-9 * here[kept]).all()
    for size in (1e-3, 1.0, 1e3):
        v = v0 + size * rng.standard_normal((m, d))
        Q = so.random(rng, m, d) if size == 1.0 else Q0
        there = cost.costs(v, Q)
        assert (below(v, Q)[kept] <= there[kept] * (1.0 + 1e-12)).all()


def test_the_enclosure_contains_the_exact_cost(added):
    """Squares of integer quaternions have rational norms; the measured turn permutes the axes."""
    rng, m = np.random.default_rng(2), 20
    turn = np.roll(np.eye(3, dtype=int), 1, axis=0)
    cost = cost_of(rng, 3, m, np.tile(turn.astype(float), (m, 1, 1)))
    t, tau = cost.graph.translations, cost.graph.tau
    v, exact, Q = t + rng.standard_normal((m, 3)), [], np.empty((m, 3, 3))
    for e, (a, *b) in enumerate(rng.integers(1, 9, (m, 4)).tolist()):
        norm = a * a + inner(b, b)
        q = [Fraction(2 * a * a - norm, norm), *(Fraction(2 * a * x, norm) for x in b)]
        Q[e] = np.array(product(turn.tolist(), spatial(q)), dtype=float)
        there, measured = map(Fraction, v[e]), map(Fraction, t[e])
        y = applied(turn.T.tolist(), [x - z for x, z in zip(there, measured, strict=True)])
        r = [*y, *(x if q[0] > 0 else -x for x in q[1:])]
        Omega = [[*map(Fraction, row)] for row in cost.graph.information_matrices[e]]
        exact.append(quadratic(Omega, r) + Fraction(10.0 * tau[e]) * Fraction(v[e, 2]) ** 2)
    found = cost.enclosures(Ball.exact(v), Ball.within(Q, 2.0**-52))
    for low, value, high in zip(found.lower, exact, found.upper, strict=True):
        assert Fraction(low) <= value <= Fraction(high)
        assert high - low <= 1e-9 * high


def descended(graph, start):
    """The cost that scipy's least squares reaches from poses, by residuals of their own."""
    i, j = graph.edges.T
    roots = np.swapaxes(np.linalg.cholesky(graph.information_matrices), 1, 2)
    measured = Rotation.from_matrix(graph.rotations)
    weight = np.sqrt(10.0 * graph.tau)

    def residuals(x):
        x = x.reshape(-1, 6)
        R = Rotation.from_matrix(start.rotations) * Rotation.from_rotvec(x[:, 3:])
        t = start.translations + x[:, :3]
        v = R[i].inv().apply(t[j] - t[i])
        q = (measured.inv() * R[i].inv() * R[j]).as_quat(canonical=True)
        e = np.concatenate([measured.inv().apply(v - graph.translations), q[:, :3]], axis=1)
        return np.concatenate([(roots @ e[:, :, None]).ravel(), weight * v[:, 2]])

    zeros = np.zeros(6 * len(start.translations))
    return 2.0 * least_squares(residuals, zeros, xtol=1e-15, ftol=1e-15, gtol=1e-12).cost


def test_solve_certify_and_sessions_know_it(added, path):
    instance = certpgo.read(path)
    assert costs_of(instance) == ("g2o", "chordal", "gtsam", "planar")
    answer = solve(instance, cost="planar")
    assert answer.verdict.value == "CERTIFIED"
    assert answer.certificate.objective.endswith(PRIOR)
    problem = objective_of(instance, "planar")
    best = descended(problem.graph, instance.initial)
    assert answer.cost == pytest.approx(best, rel=1e-9)
    assert answer.certificate.lower_bound <= best * (1.0 + 1e-12)
    # Another cost: g2o's optimum is not planar, and is refined to this one.
    free = solve(instance, cost="g2o")
    assert problem.cost(free.estimate) > 1.001 * best
    judged = certify(problem, free.estimate)
    assert judged.verdict.value == "BOUNDED"
    assert judged.refined_cost == pytest.approx(best, rel=1e-9)

    session = Session(cost="planar")
    session.add(instance)
    assert PRIOR in session.standing.objective


def test_it_goes_with_positions(added, path):
    """An edge of a position alone has g2o's term and no prior."""
    instance = certpgo.read(path)
    full = objective_of(instance, "planar").graph
    kappa, Omega = full.kappa.copy(), full.information_matrices.copy()
    kappa[0], Omega[0, 3:], Omega[0, :, 3:] = 0.0, 0.0, 0.0
    partial = full.with_weights(kappa).with_information(Omega)
    problem = Sum(partial, COSTS["planar"])
    answer = solve(problem)
    assert answer.verdict.value == "CERTIFIED"
    terms = objective_of(instance, "planar").edge_costs(answer.estimate)
    v, _ = problem.relative(answer.estimate)
    y = v[0] - full.translations[0]
    expected = [y @ Omega[0, :3, :3] @ y, *terms[1:]]
    np.testing.assert_allclose(problem.edge_costs(answer.estimate), expected, rtol=1e-9)


def test_the_commands_know_it(added, path, tmp_path, capsys):
    def run(*arguments):
        code = main([*map(str, arguments)])
        return code, capsys.readouterr()

    code, done = run("info", path, "--json")
    assert json.loads(done.out)["costs"] == ["g2o", "chordal", "gtsam", "planar"]
    _, done = run("info", path)
    assert "g2o (default), chordal, gtsam, planar" in done.out

    best, page = tmp_path / "best.g2o", tmp_path / "page.html"
    code, done = run("solve", path, "--cost", "planar", "-o", best, "--html", page)
    assert code == 0
    assert PRIOR in done.out
    assert PRIOR in page.read_text()
    assert "--cost planar" in page.read_text()
    code, done = run("certify", path, best, "--cost", "planar", "--json")
    assert (code, json.loads(done.out)["verdict"]) == (0, "CERTIFIED")
    code, done = run("certify", path, best, "--cost", "planar", "--proof", tmp_path / "p.cert")
    assert (code, "not for --cost planar" in done.err) == (1, True)

    methods = ("--methods", "certified,certified (F)", "--out", tmp_path / "r")
    code, done = run("compare", path, "--cost", "planar", *methods, "--json")
    rows = json.loads(done.out)
    assert [row["minimised"] for row in rows] == ["planar", "chordal"]
    assert [row["verdict"] for row in rows] == ["CERTIFIED", "BOUNDED"]
    assert all(row["objective"].endswith(PRIOR) for row in rows)

    code, done = run("follow", path, "--cost", "planar")
    assert (code, PRIOR in done.out) == (0, True)


def test_a_cost_that_is_not_there_is_refused(path, capsys):
    with pytest.raises(SpecError, match="unknown cost 'planar'; known: chordal, g2o, gtsam"):
        solve(certpgo.read(path), cost="planar")
    assert main(["solve", str(path), "--cost", "planar"]) == 2
    assert "unknown cost 'planar'" in capsys.readouterr().err

"""Solving and certifying in g2o's cost: published data, surrogates, symmetries, refusals."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import definite, dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, Quadratic, certify, read, solve, write
from certpgo.certify.normalized import NormalizedProblem
from certpgo.cli import main
from certpgo.errors import GraphError, InputError, NumericalError, SpecError
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.components import connected_parts
from certpgo.graph.information import Information
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import (
    COSTS,
    Sum,
    objective_of,
    own_cost,
)
from certpgo.objective.costs.g2o import G2oCost
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.normal_equations import NormalEquations
from certpgo.optimize.initialization import start_of
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.solution import Status
from certpgo.solve.bounding import lowered_bound, reached

few = settings(max_examples=10)

#: g2o's chi2 at the optimum and the largest relative gap (OBJECTIVES, 1d, and as measured there).
GOLDEN = {
    "intel": (45.00469581, 4e-8),
    "MIT": (41.16326884, 1e-8),
    "kitti_00": (98.32201174, 2e-5),
    "kitti_05": (157.1043651, 1e-5),
    "manhattan": (3549.036796, 1e-8),
    "M3500a": (912.1150122, 2e-8),
    "pudq_M3500_4": (6188.636293, 1e-8),
    "smallGrid3D": (458.1537843, 1e-9),
    "sphere2500": (727.1496672, 1e-7),
    "parking-garage": (1.23869058, 2e-6),
}


def problem_of_random(rng, n, d, *, noise=0.05, condition=5.0, cross=True, extra=None):
    graph, R, t = pose_graph(rng, n, d, noise=noise, extra=extra)
    Omega = definite(rng, graph.num_edges, d * (d + 1) // 2, condition)
    if not cross:
        Omega[:, :d, d:] = Omega[:, d:, :d] = 0.0
        Omega[:, :d, :d] = graph.tau[:, None, None] * np.eye(d)
    return Sum(graph.with_information(Omega), G2oCost), Estimate(R, t)


# --- Published data


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_optima_are_found_and_certified(name, dataset):
    result = solve(dataset(name), cost="g2o")
    cost, gap = GOLDEN[name]
    digits = 5e-10 if cost < 1000.0 else 2e-10  # ten digits, as printed
    assert result.cost == pytest.approx(cost, rel=digits)
    c = result.certificate
    assert (c.verdict.value, c.tier.value) == ("CERTIFIED", "standard")
    assert c.lower_bound <= result.cost <= c.cost_upper
    assert 0.0 <= c.gap <= gap * cost
    assert "g2o's chi2 of EdgeSE" in c.objective
    assert result.start == "laplacian_gauss_newton"


def test_wrong_optima_are_refuted(dataset):
    """MIT's initial values lead to 770.87; the optimum of F costs 2381 (OBJECTIVES)."""
    instance = dataset("MIT")
    problem = objective_of(instance, "g2o")
    stuck = descend(problem, instance.initial, max_iterations=500)
    assert stuck.cost == pytest.approx(770.87, rel=1e-3)
    alone = certify(problem, stuck.estimate, refine=False)
    assert alone.verdict.value in ("BOUNDED", "UNDECIDED")
    found = certify(problem, stuck.estimate)
    assert found.verdict.value == "REFUTED"
    assert found.better_cost == pytest.approx(41.16326884, rel=1e-8)
    assert found.lower_bound <= 41.16326884 * (1 + 1e-9)
    chordal = solve(instance, cost="chordal").estimate
    assert problem.cost(chordal) > 50.0 * 41.0
    found = certify(problem, chordal)
    assert found.verdict.value == "BOUNDED"
    assert found.basin_is_global
    assert found.refined_cost == pytest.approx(41.16326884, rel=1e-8)


# --- Descent


@given(seeds, dimensions)
@few
def test_descents_never_rise_and_report_the_steps_that_would(seed, d):
    rng = rng_of(seed)
    problem, x = problem_of_random(rng, 7, d)
    far = Estimate(so.random(rng, 7, d), 10.0 * rng.standard_normal((7, d)))
    for start in (x, far):
        found = descend(problem, start)
        assert found.trace[0].cost == pytest.approx(problem.cost(start), rel=1e-12)
        for last, following in itertools.pairwise(found.trace):
            assert following.cost <= last.cost * (1.0 + 1e-14)
            if not following.accepted:
                assert following.cost == last.cost
                assert following.gain is None or following.gain <= 1e-3
        assert found.cost == pytest.approx(problem.cost(found.estimate), rel=1e-12)


def test_a_factor_serves_as_long_as_its_steps_converge_fast(monkeypatch):
    problem, x = problem_of_random(rng_of(0), 30, 3, noise=0.1)
    matrices = []
    assemble = NormalEquations.gauss_newton.func
    monkeypatch.setattr(
        NormalEquations, "gauss_newton", property(lambda p: matrices.append(p) or assemble(p))
    )
    found = descend(problem, x)
    assert found.status.value == "converged"
    assert len({id(p) for p in matrices}) < found.iterations
    # By a step at a time, each has its own matrix.
    point = x
    for _ in range(60):
        point = descend(problem, point, max_iterations=1).estimate
    assert problem.cost(point) == pytest.approx(found.cost, rel=1e-12)


# --- Surrogates


@given(seeds, dimensions, st.booleans())
@few
def test_a_surrogate_equals_the_cost_at_its_point_and_is_stationary_there(seed, d, cross):
    rng = rng_of(seed)
    problem, x = problem_of_random(rng, 7, d, cross=cross)
    found = descend(problem, x).estimate
    assert problem.stationarity(found) < 1e-9
    below = problem.surrogate(found)
    f = problem.cost(found)
    size = abs(below.constant) + f
    assert below.problem.cost(found) + below.constant <= f + 1e-14 * size
    assert below.problem.cost(found) + below.constant == pytest.approx(f, abs=1e-10 * size)
    assert below.problem.stationarity(found) < 1e-7
    for _ in range(10):
        near = 10.0 ** rng.uniform(-6.0, 0.0)
        moved = Estimate(
            found.rotations @ so.exp(near * rng.standard_normal((7, so.tangent_dim(d)))),
            found.translations + near * rng.standard_normal((7, d)),
        )
        value = below.problem.cost(moved) + below.constant
        assert value <= problem.cost(moved) + 1e-13 * size


@given(seeds, dimensions)
@few
def test_normal_equations_are_derivatives_of_the_cost(seed, d):
    rng = rng_of(seed)
    problem, x = problem_of_random(rng, 6, d, noise=0.2)
    here = problem.linearized(x)
    cost, H = here.cost, here.gauss_newton
    gradient = problem.tangent_layout.unpack(here.gradient)
    assert cost == pytest.approx(problem.cost(x), rel=1e-12)
    v = rng.standard_normal(gradient.shape)

    def moved(h):
        R = x.rotations @ so.exp(h * v[:, d:])
        return problem.cost(Estimate.trusted(R, x.translations + h * v[:, :d]))

    h = 1e-5
    slope = (moved(h) - moved(-h)) / (2.0 * h)
    assert 2.0 * float(np.sum(gradient * v)) == pytest.approx(slope, rel=1e-6, abs=1e-6 * cost)
    assert np.linalg.eigvalsh(H.toarray())[0] >= -1e-10 * abs(H).max()
    assert abs(H - H.T).max() <= 1e-12 * abs(H).max()


@pytest.mark.skipif(not compiled.AVAILABLE, reason="installed without a C compiler")
@pytest.mark.parametrize("kind", [G2oCost, GtsamCost])
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1.0, 2.9, 3.1, np.pi - 1e-7])
@pytest.mark.parametrize("d", [2, 3])
def test_compiled_equations_are_those_in_numpy(kind, angle, d, monkeypatch):
    """For residual rotations by all angles, about all axes."""
    rng, q = rng_of(0), d * (d - 1) // 2
    problem, x = problem_of_random(rng, 20, d)
    axes = rng.standard_normal((20, q))
    i, j = problem.graph.edges.T
    turns = so.exp(angle * axes / np.linalg.norm(axes, axis=1)[:, None])[i % 20]
    rotations = np.swapaxes(x.rotations[i], 1, 2) @ x.rotations[j] @ turns
    graph = replace(problem.graph, rotations=rotations, kappa=np.ones(len(i)))
    measured = graph.with_information(problem.graph.information_matrices)
    found = Sum(measured, kind).linearized(x)
    monkeypatch.setattr(compiled, "AVAILABLE", False)
    expected = Sum(measured, kind).linearized(x)
    assert found.cost == pytest.approx(expected.cost, rel=1e-13)
    np.testing.assert_allclose(
        found.gradient, expected.gradient, rtol=0, atol=1e-12 * abs(expected.gradient).max()
    )
    H = expected.gauss_newton
    assert abs(found.gauss_newton - H).max() <= 1e-12 * abs(H).max()


@given(seeds, dimensions)
@few
def test_the_cost_of_an_estimate_is_enclosed(seed, d):
    problem, x = problem_of_random(rng_of(seed), 8, d, noise=0.3, condition=1e6)
    low, high = problem.enclosure(x)
    assert low <= problem.cost(x) <= high
    assert high - low <= 1e-11 * high


# --- Symmetries


@given(seeds, dimensions, st.integers(-30, 30))
@few
def test_the_frame_the_labels_and_the_unit_do_not_matter(seed, d, exponent):
    rng, n = rng_of(seed), 7
    problem, x = problem_of_random(rng, n, d, cross=d == 2)
    best = descend(problem, x).estimate
    first = certify(problem, best)
    moved = best.moved(so.random(rng, 1, d)[0], 3.0 * rng.standard_normal(d))
    nodes = rng.permutation(n)
    place = np.argsort(nodes)
    graph = problem.graph
    relabelled = replace(graph, edges=place[graph.edges])
    other = Sum(relabelled, G2oCost)
    found = [certify(problem, moved), certify(other, best.subset(nodes))]
    for c in found:
        assert c.verdict is first.verdict
        assert c.cost_upper == pytest.approx(first.cost_upper, rel=1e-9)
        assert c.lower_bound == pytest.approx(first.lower_bound, rel=1e-6)
    unit = 2.0**exponent
    heavier = certify(problem.scaled(unit), best)
    assert heavier.verdict is first.verdict
    assert heavier.cost_upper == unit * first.cost_upper
    assert heavier.lower_bound == unit * first.lower_bound
    assert heavier.scale == unit * first.scale


# --- Where the cost is not near its measurements


def around(n, closing=0.0):
    """A planar cycle of identities that the estimate winds around, with cross terms."""
    edges = np.c_[np.arange(n), (np.arange(n) + 1) % n]
    rotation = RotationGraph(n, edges, np.tile(np.eye(2), (n, 1, 1)), np.ones(n))
    graph = PoseGraph(rotation, np.tile([-3.0, 0.0], (n, 1)), np.ones(n))
    Omega = np.array([[4.0, 0.0, 1.0], [0.0, 4.0, 0.0], [1.0, 0.0, 1.0]])
    problem = Sum(graph.with_information(np.tile(Omega, (n, 1, 1))), G2oCost)
    angles = 2.0 * np.pi * np.arange(n)[:, None] / n
    return problem, Estimate(so.exp(angles), np.zeros((n, 2)))


def test_edges_without_minorants_leave_a_verdict_undecided(monkeypatch):
    """Three edges of a triangle that miss their turns by 120 degrees: no minorant, no error."""
    problem, wound = around(3)
    relaxed = certify(problem, wound)
    assert relaxed.verdict.value in ("BOUNDED", "REFUTED")
    assert 0.0 < relaxed.lower_bound <= solve(problem).cost < relaxed.cost_upper
    normalized = NormalizedProblem.of(problem, "standard", 1e-5, 1e-12)
    assert lowered_bound(normalized, wound).support.lowered
    monkeypatch.setattr(G2oCost, "relaxed", lambda self: None)
    assert lowered_bound(normalized, wound) is None
    with pytest.raises(NumericalError, match="do not connect the graph"):
        problem.surrogate(wound)
    alone = certify(problem, wound, refine=False)
    assert (alone.verdict.value, alone.lower_bound) == ("UNDECIDED", 0.0)
    assert certify(problem, wound).verdict.value != "CERTIFIED"
    assert solve(problem, initial=wound).verdict.value != "REFUTED"
    normalized = NormalizedProblem.of(problem, "standard", 1e-5, 1e-12)
    assert not list(reached(normalized, wound, problem.cost(wound)))


def test_exact_loops_with_one_inaccurate_angle_are_certified():
    """The bound is zero, and suffices; yaw is known a hundred times less than roll and pitch."""
    rng = rng_of(0)
    R, t = so.random(rng, 4, 3), rng.standard_normal((4, 3))
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 0)])
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0]
    graph = PoseGraph(
        RotationGraph(4, edges, so.project(back @ R[j]), np.ones(4)), steps, np.ones(4)
    )
    Omega = np.tile(np.diag([100.0, 100.0, 100.0, 4e4, 4e4, 4.0]), (4, 1, 1))
    problem = Sum(graph.with_information(Omega), G2oCost)
    assert solve(problem, time_limit=10.0).verdict.value == "CERTIFIED"
    assert certify(problem, Estimate(R, t)).verdict.value == "CERTIFIED"


def test_weights_beyond_their_range_leave_a_verdict():
    problem, x = problem_of_random(rng_of(1), 5, 3, cross=False)
    Omega = np.tile(
        np.diag([1.0, 1.0, 1.0, 1e-118, 1e-118, 1e-118]), (problem.graph.num_edges, 1, 1)
    )
    tiny = Sum(problem.graph.with_information(Omega), G2oCost)
    assert certify(tiny, x).verdict.value in ("BOUNDED", "UNDECIDED")


def test_random_estimates_get_a_verdict_without_warnings(recwarn):
    for seed in range(3):
        for d in (2, 3):
            rng = rng_of(seed)
            problem, _ = problem_of_random(rng, 6, d, noise=1.0, condition=100.0, extra=4)
            x = Estimate(so.random(rng, 6, d), 3.0 * rng.standard_normal((6, d)))
            best = solve(problem, initial=x, max_rank=d)
            found = certify(problem, x)
            assert best.certificate.lower_bound <= best.cost
            assert found.lower_bound <= best.certificate.cost_upper
    assert [str(w.message) for w in recwarn] == []


def test_patience_holds_under_another_cost():
    problem, _ = problem_of_random(rng_of(4), 12, 3, noise=1.5, extra=20)
    whole = solve(problem, time_limit=math.inf)
    answer = solve(problem, patience=0.0)
    assert (whole.verdict.value, answer.verdict.value) == ("BOUNDED", "BOUNDED")
    assert answer.solution.status is Status.TIME_LIMIT
    assert "ended 0 s after a first bound" in answer.solution.note
    assert "first bound" not in whole.solution.note
    assert len(answer.solution.trace) < len(whole.solution.trace)
    assert {"start", "newton", "certify", "descend"} <= set(whole.solution.seconds)


def test_the_values_of_the_file_are_a_start_under_another_cost():
    problem, truth = problem_of_random(rng_of(3), 12, 3, noise=1.5, extra=20)
    best = solve(problem)
    instance = Instance("spoiled", problem.graph, np.arange(12), initial=best.estimate)
    far = Estimate(so.random(rng_of(0), 12, 3), truth.translations)
    only = {"cost": "g2o", "initial": far, "max_rank": 3}
    assert solve(instance, **only, try_file_start=False).cost > 1.01 * best.cost
    answer = solve(instance, **only)
    assert answer.cost == pytest.approx(best.cost)
    assert answer.start == "the initial values of the file"


# --- Refusals

SQUARE = """\
VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 1.57
VERTEX_SE2 2 1 1 3.14
VERTEX_SE2 3 0 1 -1.57
EDGE_SE2 0 1 1.01 0 1.57 100 3 0 200 1 50
EDGE_SE2 1 2 0.99 0 1.58 100 0 2 120 0 60
EDGE_SE2 2 3 1 0.01 1.56 130 0 0 100 5 70
EDGE_SE2 3 0 1 0 1.57 100 0 0 100 0 100
"""


@pytest.fixture
def square(tmp_path):
    path = tmp_path / "square.g2o"
    path.write_text(SQUARE)
    return path


def written(tmp_path, text):
    path = tmp_path / "other.g2o"
    path.write_text(text)
    return read(path, quiet=True)


def test_indefinite_information_is_refused(dataset):
    sentence = (
        "5021 of 16869 information matrices are not positive definite: g2o's chi2 of EdgeSE3:QUAT "
        r"with full information has no proven lower bound there \(--cost chordal has\)"
    )
    instance = dataset("cubicle")
    with pytest.raises(InputError, match=sentence):
        solve(instance, cost="g2o")
    with pytest.raises(InputError, match="5021 of 16869"):
        objective_of(instance, "g2o")


def test_what_has_no_information_is_refused(square, tmp_path):
    without = SQUARE.replace("EDGE_SE2 3 0 1 0 1.57 100 0 0 100 0 100", "EDGE_SE2 3 0 1 0 1.57")
    for instance in (
        read(square, unit_weights=True, quiet=True),
        read(square, kappa=2.0, quiet=True),
        written(tmp_path, without),
    ):
        with pytest.raises(InputError, match="needs poses with information matrices on every edge"):
            solve(instance, cost="g2o")
    with pytest.raises(InputError, match="this problem has 'chordal'"):
        solve(Quadratic(read(square, quiet=True).graph), cost="g2o")
    with pytest.raises(SpecError, match=r"unknown cost 'g2o2'; did you mean g2o\?"):
        solve(read(square, quiet=True), cost="g2o2")


def test_gtsams_cost_has_all_tiers(square):
    instance = read(square, quiet=True)
    problem = objective_of(instance, "gtsam")
    estimate = solve(instance, cost="gtsam", tier="proof").estimate
    found = {tier: certify(problem, estimate, tier=tier) for tier in ("screen", "proof")}
    assert found["screen"].verdict.value == "BOUNDED"
    assert found["proof"].verdict.value == "CERTIFIED"
    assert found["proof"].lower_bound <= found["proof"].cost_upper


def test_disconnected_graphs_are_refused_or_solved_apart(tmp_path):
    two = SQUARE + "".join(
        line.replace("EDGE_SE2 3 0", "EDGE_SE2 7 4")
        .replace("EDGE_SE2 0 1", "EDGE_SE2 4 5")
        .replace("EDGE_SE2 1 2", "EDGE_SE2 5 6")
        .replace("EDGE_SE2 2 3", "EDGE_SE2 6 7")
        + "\n"
        for line in SQUARE.splitlines()
        if line.startswith("EDGE")
    )
    instance = written(tmp_path, two.replace(" 50\n", " 55\n", 1))
    with pytest.raises(GraphError, match="2 components"):
        solve(instance, cost="g2o")
    parts = connected_parts(instance, "each")
    last = [part.graph.information_matrices[0, 2, 2] for part in parts]
    assert sorted(last) == [50.0, 55.0]
    for part in parts:
        assert solve(part, cost="g2o").verdict.value == "CERTIFIED"


def test_information_graphs_refuse_what_is_not_theirs():
    graph, _, _ = pose_graph(rng_of(0), 4, 2)
    m = graph.num_edges
    eye = np.tile(np.eye(3), (m, 1, 1))
    for wrong, words in (
        (eye[:-1], "must be"),
        (np.tile(np.eye(6), (m, 1, 1)), "must be"),
        (np.full((m, 3, 3), np.inf), "finite"),
        (np.full((m, 3, 3), np.nan), "finite"),
        (eye * 1e130, "below"),
        (eye + np.triu(np.ones((3, 3)), 1), "symmetric"),
    ):
        with pytest.raises(GraphError, match=words):
            G2oCost(graph.with_information(wrong))
    with pytest.raises(GraphError, match="a matrix per edge"):
        graph.with_information(Information(eye, np.arange(m - 1)))
    for distinct, index in ((eye, np.arange(1, m + 1)), (eye, -np.arange(m)), (eye[0], [0])):
        with pytest.raises(GraphError, match=r"numbered|must be square"):
            Information(distinct, index)


# --- Reading


def test_information_is_that_of_the_file_and_follows_its_edges(tmp_path):
    lines = SQUARE + "EDGE_SE2 1 0 -1 0 -1.57 7 0 0 8 0 9\nEDGE_SE2 1 2 1 0 1.5 17 1 2 18 3 19\n"
    path = tmp_path / "parallel.g2o"
    path.write_text(lines)
    whole = read(path, quiet=True)
    first = np.array([[100.0, 3.0, 0.0], [3.0, 200.0, 1.0], [0.0, 1.0, 50.0]])
    np.testing.assert_array_equal(whole.graph.information_matrices[0], first)
    last = np.array([[17.0, 1.0, 2.0], [1.0, 18.0, 3.0], [2.0, 3.0, 19.0]])
    for keep, wanted, corner in (("first", [0, 1, 2, 3], 50.0), ("last", [2, 3, 4, 5], 9.0)):
        part = read(path, keep=keep, quiet=True)
        np.testing.assert_array_equal(
            part.graph.information_matrices, whole.graph.information_matrices[np.array(wanted)]
        )
        assert part.graph.num_edges == 4
        assert corner in part.graph.information_matrices[:, 2, 2]
        result = solve(part, cost="g2o")
        assert result.verdict.value == "CERTIFIED"
        edges = objective_of(part, "g2o").graph
        np.testing.assert_array_equal(edges.edges, part.graph.edges)
    np.testing.assert_array_equal(
        read(path, keep="last", quiet=True).graph.information_matrices[-1], last
    )


@pytest.mark.parametrize("keep", ["all", "last"])
def test_information_survives_npz_and_what_reading_leaves_out(keep, tmp_path):
    path, packed = tmp_path / "parallel.g2o", tmp_path / "parallel.npz"
    path.write_text(SQUARE + "EDGE_SE2 1 0 -1 0 -1.57 7 0 -0.0 8 1e-300 9\n")
    write(packed, read(path, quiet=True))
    there, back = (read(p, keep=keep, quiet=True) for p in (path, packed))
    assert back.graph.information_matrices.tobytes() == there.graph.information_matrices.tobytes()
    assert solve(back, cost="g2o").cost == solve(there, cost="g2o").cost
    assert read(packed, kappa=2.0, quiet=True).graph.information is None


def test_the_objective_is_what_solve_takes(square):
    instance = read(square, quiet=True)
    assert objective_of(instance, "chordal").graph is instance.graph
    assert objective_of(instance.graph).graph is instance.graph
    assert own_cost(instance) == "g2o"
    problem = objective_of(instance)
    one, other = solve(instance), solve(problem)
    assert one.cost == other.cost == pytest.approx(problem.cost(one.estimate), rel=1e-14)
    again = certify(problem, one.estimate)
    assert again.verdict.value == "CERTIFIED"
    given = solve(problem, initial=start_of(problem.chordal).estimate)
    assert given.start == "the given estimate"
    assert given.cost == pytest.approx(one.cost, rel=1e-10)
    assert certpgo.certify(problem, given.estimate).verdict.value == "CERTIFIED"


# --- The command line


def run(capsys, *arguments):
    capsys.readouterr()
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def test_the_command_line_has_costs(square, tmp_path, capsys):
    out = tmp_path / "best.g2o"
    code, text, _ = run(capsys, "solve", square, "--cost", "g2o", "-o", out, "--json")
    found = json.loads(text)
    assert (code, found["verdict"]) == (0, "CERTIFIED")
    assert "g2o's chi2 of EdgeSE2 with full information" in found["objective"]
    instance = read(square, quiet=True)
    assert found["cost"] == pytest.approx(solve(instance, cost="g2o").cost, rel=1e-10)
    code, text, _ = run(capsys, "certify", square, out, "--cost", "g2o", "--json")
    found = json.loads(text)
    assert (code, found["verdict"]) == (0, "CERTIFIED")
    assert "g2o's chi2" in found["objective"]
    code, text, _ = run(capsys, "certify", square, square, "--cost", "g2o", "--json")
    found = json.loads(text)
    assert (code, found["verdict"]) == (3, "BOUNDED")
    assert found["best"]["is_optimal"]
    code, text, _ = run(capsys, "solve", square, "--cost", "g2o")
    assert code == 0
    assert "g2o's chi2" in text


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--cost", "g2o", "--unit-weights"), "needs poses with information matrices"),
        (("--cost", "g2o", "--method", "newton"), "is for --cost chordal"),
        (("--cost", "gtsam", "--proof", "x.npz"), "is for --cost chordal and g2o"),
    ],
)
def test_the_command_line_refuses_what_a_cost_does_not_have(square, capsys, options, words):
    code, _, err = run(capsys, "solve", square, *options)
    assert code == 1
    assert words in " ".join(err.split())


def test_a_written_estimate_is_judged_as_read(square, tmp_path, capsys):
    """Six digits: within the tolerance or not, but the cost is that of the file's poses."""
    instance = read(square, quiet=True)
    best = solve(instance, cost="g2o").estimate
    path = tmp_path / "rounded.g2o"
    write(path, best, instance=instance)
    code, text, _ = run(capsys, "certify", square, path, "--cost", "g2o", "--json")
    assert code == 0
    assert json.loads(text)["cost"] == pytest.approx(
        objective_of(instance, "g2o").cost(best), rel=1e-9
    )


def test_the_own_cost_is_g2os_where_that_can_be_certified(square, tmp_path, dataset):
    instance = read(square, quiet=True)
    assert own_cost(instance) == "g2o"
    assert own_cost(connected_parts(instance, "each")[0]) == "g2o"
    kept = tmp_path / "square.npz"
    write(kept, instance)
    assert own_cost(read(kept, quiet=True)) == "g2o"
    text = square.read_text()
    others = [
        read(square, unit_weights=True, quiet=True),
        written(tmp_path, text.replace("100 3 0 200 1 50", "100 3 0 200 150 50")),  # indefinite
        *(
            replace(
                instance,
                graph=instance.graph.with_information(
                    replace(instance.graph.information, residual=residual)
                ),
            )
            for residual in (None, "unknown")
        ),
    ]
    for other in others:
        assert own_cost(other) == "chordal"
        assert solve(other).certificate.objective == "F"
    assert solve(instance).certificate.objective.startswith("g2o's chi2 of EdgeSE2")
    alone = solve(instance.graph)
    assert (alone.cost, alone.certificate.objective) == (
        solve(instance).cost,
        solve(instance).certificate.objective,
    )
    assert solve(instance.graph, cost="chordal").certificate.objective == "F"
    definite = others[1].graph.is_definite
    np.testing.assert_array_equal(definite, [False, True, True, True])


def test_fallback_to_f_is_said(square, tmp_path, capsys):
    path = tmp_path / "indefinite.g2o"
    path.write_text(square.read_text().replace("100 3 0 200 1 50", "100 3 0 200 150 50"))
    main(["solve", str(path)])
    said = capsys.readouterr()
    assert "1 of 4 information matrices are not positive definite: the cost is F" in said.err
    assert "F with weights from the file" in said.out


def test_misuse_of_other_costs_is_one_line(square):
    instance = read(square, quiet=True)
    with pytest.raises(SpecError, match=r"unknown cost .chordl.*known: chordal, g2o, gtsam$"):
        objective_of(instance, "chordl")
    with pytest.raises(SpecError, match=r"known: chordal, g2o, gtsam$"):
        solve(instance.graph, cost="ceres")
    problem = objective_of(instance, "g2o")
    other = Estimate(np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2)))
    with pytest.raises(InputError, match="3 nodes"):
        problem.cost(other)
    with pytest.raises(InputError, match=r"takes a Sum, not an Instance"):
        certpgo.to_gtsam(instance, other)
    with pytest.raises(InputError, match="a factor graph and Values, not an Instance"):
        certpgo.from_gtsam(instance, other)


@pytest.mark.gtsam
def test_values_that_are_no_poses_are_refused_by_their_key():
    gtsam = pytest.importorskip("gtsam")
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    for k in range(2):
        graph.add(gtsam.BetweenFactorPose3(k, k + 1, gtsam.Pose3(), noise))
        values.insert(k, gtsam.Pose3())
    values.insert(2, gtsam.Point3(1.0, 2.0, 3.0))
    with pytest.raises(InputError, match=r"hold no 3D pose or rotation at key 2$"):
        certpgo.from_gtsam(graph, values)


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_problems_that_leave_nodes_free_say_which(cost):
    pairs = np.array([[0, 1], [1, 2], [2, 0], [1, 0], [2, 1], [0, 2]])
    turns, t = np.tile(np.eye(2), (6, 1, 1)), np.arange(12.0).reshape(6, 2)
    information = np.tile(np.diag([1.0, 1.0, 0.0]), (6, 1, 1))

    def problem(kappa, t):
        information[:, 2, 2] = kappa
        graph = PoseGraph(RotationGraph(3, pairs, turns, np.array(kappa)), t, np.ones(6))
        return Sum(graph.with_information(information), COSTS[cost])

    with pytest.raises(
        GraphError, match=rf"^the cost of {cost} needs relative poses, not positions"
    ):
        problem([0.0] * 6, t)
    with pytest.raises(GraphError, match=r"^no measurement determines the rotation of node 2"):
        problem([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.0 * t)
    assert solve(problem([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], 0.0 * t)).verdict.value == "CERTIFIED"


def test_toro_and_g2o_files_of_the_same_data_have_the_same_default_cost(tmp_path):
    """TORO orders the information xx xy yy tt xt yt; the optimum is scipy's."""
    toro, g2o = tmp_path / "a.graph", tmp_path / "a.g2o"
    steps = ("0 1 1.0 0 0.02", "1 2 1.02 0 0.01", "0 2 2.1 0.03 0.05")
    toro.write_text("".join(f"EDGE2 {step} 100 1 90 400 2 3\n" for step in steps))
    g2o.write_text("".join(f"EDGE_SE2 {step} 100 1 2 90 3 400\n" for step in steps))
    for path in (toro, g2o):
        answer = certpgo.solve(certpgo.read(path, quiet=True))
        assert answer.certificate.objective.startswith("g2o")
        assert answer.cost == pytest.approx(0.270994721624, abs=2e-12)

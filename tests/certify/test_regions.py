"""How far estimates can be from every optimum: no other estimate is ever outside."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import definite, dimensions, point_graph, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import InputError
from certpgo.certify.dual import Attempts
from certpgo.certify.regions import Regions, _inverse_blocks
from certpgo.graph import Estimate
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.blocks import pinned
from certpgo.objective.choose_cost import COSTS
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum

KINDS = ("rotations", "poses", "points", "fixes", "g2o", "gtsam", "priors g2o")


def problem_of(kind, rng, d, noise=0.1):
    """A small problem and an estimate near its optimum."""
    n = int(rng.integers(4, 8))
    if kind == "rotations":
        graph, R = rotation_graph(rng, n, d, noise=noise)
        return Quadratic(graph), Estimate(R)
    if kind == "points":
        graph, truth = point_graph(rng, n, 4, d, noise=noise)
        return Quadratic(graph), truth
    graph, R, t = pose_graph(rng, n, d, noise=noise)
    if kind == "poses":
        return Quadratic(graph), Estimate(R, t)
    if kind != "fixes" and not kind.startswith("priors"):
        # In space the minorants of GTSAM's cost are those of isotropic translations.
        information = definite(rng, graph.num_edges, d + so.tangent_dim(d), 3.0)
        if kind == "gtsam" and d == 3:
            information[:, :d, d:] = information[:, d:, :d] = 0.0
            information[:, :d, :d] = np.eye(d)
        return Sum(graph.with_information(information), COSTS[kind]), Estimate(R, t)
    fixes = t + noise * rng.standard_normal((n, d))
    fixed = certpgo.with_priors(graph, np.arange(n), translations=fixes, tau=2.0)
    truth = Estimate(np.concatenate([R, np.eye(d)[None]]), np.concatenate([t, np.zeros((1, d))]))
    if kind == "fixes":
        return Quadratic(fixed), truth
    m, q = fixed.num_edges, so.tangent_dim(d)
    information = np.zeros((m, d + q, d + q))
    information[:, :d, :d] = fixed.tau[:, None, None] * np.eye(d)
    information[:, d:, d:] = 2.0 * fixed.kappa[:, None, None] * np.eye(q)
    return Sum(fixed.with_information(information), COSTS["g2o"]), truth


def moved(rng, x, size):
    """The estimate with every pose moved by as much, and all of them elsewhere in the world."""
    n, d, _ = x.rotations.shape
    R = x.rotations @ so.exp(size * rng.standard_normal((n, so.tangent_dim(d))))
    Q = so.random(rng, 1, d)[0]
    if x.translations is None:
        return Estimate(Q @ R)
    t = x.translations + size * rng.standard_normal((n, d))
    return Estimate(Q @ R, t @ Q.T + rng.standard_normal(d))


def apart(x, other, i):
    """(n,) metres and degrees between the poses of two estimates in the frame of node i."""
    V = x.rotations[i].T @ x.rotations - other.rotations[i].T @ other.rotations
    squares = np.minimum(np.einsum("nab,nab->n", V, V) / 8.0, 1.0)
    degrees = np.degrees(2.0 * np.arcsin(np.sqrt(squares)))
    if x.translations is None:
        return None, degrees
    u = (x.translations - x.translations[i]) @ x.rotations[i]
    u -= (other.translations - other.translations[i]) @ other.rotations[i]
    return np.linalg.norm(u, axis=1), degrees


def between(certificate, x, other):
    """The regions of two estimates, whatever their costs."""
    known = certificate.regions
    costs = [known.problem.enclosure(point)[1] for point in (x, other)]
    return Regions(known.problem, known.bound, max(costs), min(costs), known.point)


def shares(certificate, x, other, reference):
    """The largest shares of the limits, of distances and angles; none is above one."""
    found = between(certificate, x, other).around(reference)
    is_point = ~np.isin(np.arange(len(x.rotations)), certificate.regions.problem.chordal.poses)
    metres, degrees = apart(x, other, reference)
    degrees[is_point] = 0.0
    tiny = 1e-300
    angles = np.where(found.degrees < 180.0, degrees / np.maximum(found.degrees, tiny), 0.0)
    lengths = np.zeros(1) if metres is None else metres / np.maximum(found.metres, tiny)
    others = np.arange(len(angles)) != reference
    assert (found.metres is None) == (metres is None)
    return (lengths if metres is None else lengths[others]).max(), angles[others].max()


@pytest.mark.parametrize("kind", KINDS)
@given(seeds, dimensions)
@settings(max_examples=8)
def test_no_other_estimate_is_outside(kind, seed, d):
    """Near ones, far ones, and any; from every pose."""
    rng = rng_of(seed)
    problem, truth = problem_of(kind, rng, d)
    x = moved(rng, truth, 10.0 ** rng.uniform(-6.0, 0.0))
    certificate = certpgo.certify(problem, x)
    for reference in problem.chordal.poses[::2].tolist():
        for size in (1e-6, 1e-3, 0.1, 1.0, 30.0):
            other = moved(rng, certificate.best, size)
            assert max(shares(certificate, x, other, reference)) <= 1.0
            assert max(shares(certificate, certificate.best, other, reference)) <= 1.0
        # The optimum itself, without knowing it.
        found, poses = certificate.distance_from(reference), problem.chordal.poses
        metres, degrees = apart(x, certificate.best, reference)
        assert (degrees[poses] <= found.degrees[poses] + 1e-12).all()
        assert metres is None or (metres <= found.metres + 1e-12).all()


@pytest.mark.parametrize("kind", ["poses", "points", "g2o"])
@pytest.mark.parametrize("d", [2, 3])
def test_an_adversary_stays_within_the_limit(kind, d):
    """From the worst direction, by steps at random that come nearer to it."""
    rng, nearest = rng_of(7), 0.0
    problem, truth = problem_of(kind, rng, d, noise=0.03)
    certificate = certpgo.certify(problem, truth)
    best, regions = certificate.refined, certificate.regions
    reference = problem.chordal.anchor
    attempts = Attempts(regions.form, regions.point, True, -np.inf, False)
    S = attempts.matrix(regions.bound.multipliers, np.zeros(0), attempts.rows_of(reference))
    inverse, layout = np.linalg.inv(S.toarray()), regions.form.pattern.layout_of(S)
    for node in range(problem.n):
        if node == reference:
            continue
        row = layout.first_row(node)
        worst = layout.unpack(inverse[:, row] / np.sqrt(inverse[row, row]))
        v = rng.standard_normal(d)
        for size in 10.0 ** np.arange(-2.0, 2.0, 0.5):
            step = size * worst
            t = best.translations + step[:, :1] * v
            R = so.project(best.rotations + v[:, None] * step[:, None, 1:])
            # Exactly as it was, the frame is the same.
            t[reference], R[reference] = best.translations[reference], best.rotations[reference]
            other = Estimate(R, t)
            share = max(shares(certificate, best, other, reference))
            for _ in range(4):
                trial = Estimate(*near(rng, other, 0.1 * size))
                nearer = max(shares(certificate, best, trial, reference))
                other, share = (trial, nearer) if nearer > share else (other, share)
            assert share <= 1.0
            nearest = max(nearest, share)
    assert nearest > 0.6


def near(rng, x, size):
    q = so.tangent_dim(x.d)
    R = x.rotations @ so.exp(0.1 * size * rng.standard_normal((len(x.rotations), q)))
    return R, x.translations + size * 0.1 * rng.standard_normal(x.translations.shape)


def exact_inverse(A):
    """The inverse of a matrix of doubles, in fractions."""
    n = len(A)
    rows = [[Fraction(float(x)) for x in row] for row in A]
    rows = [row + [Fraction(int(r == c)) for c in range(n)] for r, row in enumerate(rows)]
    for k in range(n):
        pivot = rows[k][k]
        rows[k] = [x / pivot for x in rows[k]]
        for r in range(n):
            if r != k and rows[r][k]:
                factor = rows[r][k]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[k], strict=True)]
    return [row[n:] for row in rows]


def is_definite(A):
    """Whether all pivots of a matrix of fractions are >= 0."""
    A = [list(row) for row in A]
    for k in range(len(A)):
        if A[k][k] < 0 or (A[k][k] == 0 and any(A[k][k + 1 :])):
            return False
        for r in range(k + 1, len(A)):
            factor = A[r][k] / A[k][k] if A[k][k] else 0
            A[r] = [a - factor * b for a, b in zip(A[r], A[k], strict=True)]
    return True


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("kind", ["rotations", "poses", "points"])
@pytest.mark.parametrize("d", [2, 3])
def test_blocks_are_above_those_in_fractions(engine, kind, d, monkeypatch):
    """Of the stored matrix: by rounding only, and never below."""
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    problem, truth = problem_of(kind, rng_of(d), d)
    certificate = certpgo.certify(problem, truth)
    known, reference = certificate.regions, problem.anchor
    form, multipliers = known.form, known.bound.multipliers
    found = _inverse_blocks(form, known.point, multipliers, reference)
    layout = form.pattern.layout_of(form.matrix)
    rows = layout.first_row(reference) + np.arange(layout.sizes[reference])
    A = pinned(form.certificate_matrix(multipliers), rows).toarray()
    inverse = exact_inverse(A)
    for node in range(problem.n):
        own = layout.first_row(node) + np.arange(layout.sizes[node])
        exact = [[inverse[r][c] for c in own] for r in own]
        mine = found[node, : len(own), : len(own)]
        excess = [
            [Fraction(float(a)) - b for a, b in zip(*both, strict=True)]
            for both in zip(mine, exact, strict=True)
        ]
        assert is_definite(excess)
        dense = np.array(exact, dtype=float)
        assert np.abs(mine - dense).max() <= 1e-6 * np.abs(dense).max()


def test_a_certified_estimate_far_from_the_optimum(dataset):
    """MIT: poses move by a metre for a thousandth of a per cent of the cost."""
    answer = certpgo.solve(dataset("MIT"), cost="chordal")
    best, regions, v = answer.estimate, answer.certificate.regions, np.array([0.6, 0.8])
    attempts = Attempts(regions.form, regions.point, True, -np.inf, False)
    A = attempts.matrix(regions.bound.multipliers, np.zeros(0), attempts.rows_of(0))
    layout, node = regions.form.pattern.layout_of(A), answer.certificate.distance_from(0).node
    row = layout.first_row(node)
    bend = attempts.symbolic.factor(A).solve(np.eye(1, A.shape[0], row).ravel())
    share = np.sqrt(0.97e-5 * regions.problem.cost(best) / bend[row])
    step = share * layout.unpack(bend)
    R = so.project(best.rotations + v[:, None] * step[:, None, 1:])
    bent = regions.form.complete(R)
    certificate = certpgo.certify(answer.problem, bent)
    found, (metres, degrees) = certificate.distance_from(0), apart(bent, best, 0)
    assert certificate.is_optimal
    assert 0.5 < metres[node] <= found.metres[node] < 5.0
    assert (metres <= found.metres + 1e-9).all()
    assert (degrees <= found.degrees + 1e-9).all()
    assert answer.certificate.distance.largest[0] < 0.3
    assert found.metres[0] == found.degrees[0] == 0.0
    assert found.largest == (found.metres[found.node], found.degrees.max())


def test_it_is_of_the_best_answer_known():
    """A worse estimate may be further off, by the cost that it has more."""
    problem, _ = problem_of("poses", rng_of(1), 3)
    best = certpgo.solve(problem).estimate
    sizes = [0.0, 1e-3, 1e-2, 0.1]
    found = [certpgo.certify(problem, moved(rng_of(2), best, size)).distance for size in sizes]
    largest = [one.largest for one in found]
    assert largest == sorted(largest)


def test_weights_have_no_unit():
    problem, truth = problem_of("poses", rng_of(1), 3)
    one, other = (certpgo.certify(problem.scaled(by), truth).distance for by in (1.0, 4.0))
    np.testing.assert_allclose(one.metres, other.metres, rtol=1e-9)
    np.testing.assert_allclose(one.degrees, other.degrees, rtol=1e-9)


def test_nothing_is_said_where_nothing_is_proven(dataset):
    problem, truth = problem_of("poses", rng_of(1), 2)
    screened = certpgo.certify(problem, truth, tier="screen")
    assert screened.distance is None
    rejecting = certpgo.certify(problem, truth, rejected=np.array([0]))
    assert rejecting.distance is None
    instance, _ = winding_cycle(6, 0.3, 0)
    proven = certpgo.certify(Quadratic(instance.graph), instance.truth, tier="proof")
    assert proven.distance.metres is None
    assert proven.distance.degrees.max() < 0.01


def test_points_are_no_references():
    problem, truth = problem_of("points", rng_of(1), 2)
    certificate = certpgo.certify(problem, truth)
    [point, *_] = np.flatnonzero(problem.graph.is_point)
    for wrong in (int(point), -1, problem.n):
        with pytest.raises(InputError, match="poses"):
            certificate.distance_from(wrong)
    assert certificate.distance.degrees[point] == 0.0
    assert certificate.distance.metres[point] > 0.0


@given(seeds, st.sampled_from(["poses", "points"]))
@settings(max_examples=10)
def test_it_costs_nothing_before_it_is_asked_for(seed, kind):
    problem, truth = problem_of(kind, rng_of(seed), 2)
    regions = certpgo.certify(problem, truth).regions
    assert not regions._found
    assert set(vars(regions)) == {"problem", "bound", "cost", "known", "point", "_found"}
    first = regions.around()
    assert regions.around() is first


def test_costs_at_the_proof_tier_are_those_of_the_stored_numbers_too():
    graph = pose_graph(rng_of(1), 8, 3, noise=0.2)[0]
    problem = Quadratic(graph)
    judged = certpgo.certify(problem, certpgo.solve(problem).estimate, tier="proof")
    normalized = judged.regions.problem
    upper = normalized.enclosure(judged.refined)[1]
    assert judged.regions.known >= upper
    assert judged.distance.metres.max() < 0.1
    with pytest.raises(ValueError, match="read-only"):
        judged.distance.metres[0] = 0.0
    with pytest.raises(InputError, match="the number of a node"):
        judged.distance_from(1.7)

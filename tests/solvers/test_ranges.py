"""Measured distances: minorants, derivatives, bounds, and the real data's gaps."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, point_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, GraphError, InputError, PoseGraph, Ranges, RotationGraph, solve
from certpgo.certify.ranged import cost_upper, range_bound
from certpgo.costs import range_problem
from certpgo.costs.range_descent import descend
from certpgo.costs.ranges import RangeProblem
from certpgo.costs.signed import SignedProblem, quarter_turn
from certpgo.graph.lift import Lift, lifted
from certpgo.linalg import so
from certpgo.optimize.low_rank import orthonormal

few = settings(max_examples=12)


def measured(seed, d, *, noise=0.1, poses=5, points=3):
    """A graph with points, and distances from every pose to every point, in random order."""
    rng = rng_of(seed)
    graph, truth = point_graph(rng, poses, points, d, noise=noise)
    seen, places = np.flatnonzero(graph.points), graph.pose_nodes
    pairs = np.array([(a, b) if rng.random() < 0.5 else (b, a) for a in places for b in seen])
    apart = np.linalg.norm(
        truth.translations[pairs[:, 1]] - truth.translations[pairs[:, 0]], axis=1
    )
    distances = np.abs(apart + noise * rng.standard_normal(len(pairs)))
    weights = rng.uniform(0.5, 4.0, len(pairs))
    return RangeProblem(graph, Ranges(graph.num_nodes, pairs, distances, weights)), truth, rng


def anywhere(rng, problem, rises):
    """A random point of the relaxation, which rose some times into new dimensions."""
    rank = problem.d + rises * problem.whole.dimensions
    Z = rng.standard_normal((problem.n, rank, problem.d))
    if problem.d == 2:
        Z[:, :, 1] = quarter_turn(Z[:, :, 0])
    return Lift(orthonormal(Z), 3.0 * rng.standard_normal((problem.n, rank)))


def written_out(problem, point):
    """The cost by a loop, as its formula reads."""
    graph, total = problem.measured, 0.0
    R, t = point.rotations, point.translations
    for e, (i, j) in enumerate(graph.edges):
        if graph.rotation.kappa[e] > 0.0:
            apart = R[j] - R[i] @ graph.rotation.rotations[e]
            total += graph.rotation.kappa[e] * np.linalg.norm(apart) ** 2
        total += graph.tau[e] * np.linalg.norm(t[j] - t[i] - R[i] @ graph.translations[e]) ** 2
    ranges = problem.ranges
    for e, (i, j) in enumerate(ranges.edges):
        total += ranges.weights[e] * (ranges.distances[e] - np.linalg.norm(t[j] - t[i])) ** 2
    return total


@given(seeds, dimensions)
@few
def test_the_surrogate_is_below_and_touches(seed, d):
    problem, _, rng = measured(seed, d)
    point = anywhere(rng, problem, seed % 3)
    assert problem.cost(point) == pytest.approx(written_out(problem, point))
    below, constant = problem.surrogate(point)
    assert below.cost(point) + constant == pytest.approx(problem.cost(point))
    for _ in range(10):
        other = anywhere(rng, problem, seed % 3)
        assert below.cost(other) + constant <= problem.cost(other) * (1.0 + 1e-12) + 1e-12


@given(seeds)
@few
def test_constants_are_rounded_down(seed):
    problem, _, rng = measured(seed, 2)
    below, constant = problem.surrogate(anywhere(rng, problem, 0))
    tau = below.graph.tau[-problem.ranges.num_edges :]
    exact = Fraction(0)
    for w, distance, weight in zip(
        problem.ranges.weights, problem.ranges.distances, tau, strict=True
    ):
        w, distance, weight = Fraction(float(w)), Fraction(float(distance)), Fraction(float(weight))
        exact -= w * distance**2 * weight / (w - weight)
    assert Fraction(constant) <= exact
    assert float(exact - Fraction(constant)) <= 1e-12 * abs(constant) + 1e-12


@given(seeds, dimensions)
@few
def test_derivatives(seed, d):
    problem, _, rng = measured(seed, d)
    point = anywhere(rng, problem, seed % 2)
    rank = point.rank
    basis = problem.whole.tangent_basis(point.rotations)
    layout = problem.layout(rank)
    G = problem.gradient(point)
    turn = np.einsum("nqrd,nrd->nq", basis, G[:, :, 1:])
    slope = layout.pack(np.concatenate([G[:, :, 0], turn], axis=1))
    x = rng.standard_normal(layout.size)
    step = layout.unpack(x)
    V = np.einsum("nq,nqrd->nrd", step[:, rank:], basis)

    def along(h):
        moved = orthonormal(point.rotations + h * V)
        return problem.cost(Lift(moved, point.translations + h * step[:, :rank]))

    h = 1e-4
    assert 2.0 * slope @ x == pytest.approx((along(h) - along(-h)) / (2.0 * h), rel=1e-5, abs=1e-4)
    multipliers = problem.surrogate(point)[0].multipliers(point)
    H = problem.hessian(point, basis, multipliers)
    second = (along(h) - 2.0 * along(0.0) + along(-h)) / h**2
    assert 2.0 * x @ (H @ x) == pytest.approx(second, rel=1e-3, abs=1e-2)


@given(seeds, dimensions)
@few
def test_bounds_are_below_what_descents_find(seed, d):
    problem, truth, rng = measured(seed, d, noise=0.6)
    answer = solve(problem)
    assert answer.certificate.lower_bound <= written_out(problem, truth)
    for _ in range(5):
        start = lifted(
            Estimate(so.random(rng, problem.n, d), rng.standard_normal((problem.n, d))), d
        )
        found, _ = descend(problem, start)
        cost = problem.cost(found)
        assert answer.certificate.lower_bound <= cost * (1.0 + 1e-12)
    # So is that of any point, whether stationary or not.
    bound = range_bound(problem, anywhere(rng, problem, 1), answer.cost)
    assert bound is None or bound.value <= answer.cost


@given(seeds, dimensions)
@few
def test_certificate_matrices_have_the_cost_and_its_multipliers(seed, d):
    problem, _, rng = measured(seed, d)
    point = anywhere(rng, problem, seed % 3)
    below, _ = problem.surrogate(point)
    E = np.concatenate(
        [np.swapaxes(below.position_rows(point.translations), 1, 2), point.rotations], axis=2
    )
    X = below.pattern.layout_of(below.matrix).pack(np.swapaxes(E, 1, 2))
    scale = (abs(below.matrix) @ abs(X) * abs(X)).sum()
    assert (below.matrix @ X * X).sum() == pytest.approx(below.cost(point), abs=1e-13 * scale)
    # Blocks of the gradient, less what the multipliers explain, are tangent or zero.
    lam = below.multipliers(point)
    S = below.certificate_matrix(lam)
    assert (S @ X * X).sum() == pytest.approx(
        below.cost(point) - np.trace(lam[problem.poses], axis1=1, axis2=2).sum(), abs=1e-12 * scale
    )


class Real(RangeProblem):
    """The relaxation over real matrices."""

    @property
    def whole(self):
        oriented = RangeProblem(self.measured, self.ranges).whole
        return self.__dict__.setdefault("real", SignedProblem(oriented.graph, oriented.engine))


@given(seeds)
@few
def test_the_oriented_relaxation_is_at_least_as_tight_as_the_real_one(seed):
    problem, _, _ = measured(seed, 2, noise=1.0)
    real = Real(problem.measured, problem.ranges)
    ours, theirs = solve(problem), solve(real)
    assert ours.certificate.lower_bound >= (1.0 - 1e-5) * theirs.certificate.lower_bound
    assert ours.cost <= (1.0 + 1e-6) * theirs.cost


@given(seeds)
@few
def test_oriented_points_stay_so(seed):
    problem, _, rng = measured(seed, 2)
    point = anywhere(rng, problem, 2)
    rows = rng.standard_normal((problem.n, 4))
    rising = problem.whole.rising(rows)
    # The first coordinates are the rows.
    first = np.concatenate(
        [problem.whole.position_rows(rising.translations)[:, :, 0], rising.rotations[:, 0]], axis=1
    )
    np.testing.assert_array_equal(first, rows)
    found, _ = descend(problem, point)
    for Y in (rising.rotations, found.rotations):
        np.testing.assert_allclose(quarter_turn(Y[:, :, 0]), Y[:, :, 1], atol=1e-12)
    (frame,) = problem.whole.frames(np.linalg.qr(rng.standard_normal((6, 2)))[0])
    proper = np.linalg.det(frame.T @ found.rotations)
    assert (proper > 0.0).all()


@given(seeds, dimensions)
@few
def test_exact_data_are_recovered(seed, d):
    problem, truth, _ = measured(seed, d, noise=0.0, poses=6, points=5)
    answer = solve(problem)
    assert answer.cost <= 1e-9 * problem.scale
    upper = cost_upper(problem, truth)
    assert 0.0 <= upper <= 1e-9 * problem.scale


@given(seeds)
@few
def test_laws(seed):
    problem, _, rng = measured(seed, 2, noise=0.3)
    answer = solve(problem)
    moved = answer.estimate.moved(so.random(rng, 1, 2)[0], np.array([1e3, -7.0]))
    assert problem.cost(moved) == pytest.approx(answer.cost, rel=1e-6)
    heavier = solve(problem.scaled(8.0))
    assert heavier.cost == pytest.approx(8.0 * answer.cost, rel=1e-5)
    i, j = problem.ranges.edges.T
    back = Ranges(
        problem.n, np.stack([j, i], axis=1), problem.ranges.distances, problem.ranges.weights
    )
    assert RangeProblem(problem.measured, back).cost(answer.estimate) == pytest.approx(answer.cost)
    assert cost_upper(problem, answer.estimate) >= problem.cost(answer.estimate)


def test_distances_between_some_nodes_are_renumbered():
    ranges = Ranges(5, [[0, 4], [2, 3], [4, 2]], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    some = ranges.between(np.array([0, 2, 4]))
    assert some.edges.tolist() == [[0, 2], [2, 1]]
    assert (some.distances.tolist(), some.weights.tolist()) == ([1.0, 3.0], [4.0, 6.0])
    assert ranges.between(np.array([1, 3])) is None


def test_distances_that_fit_exactly_or_are_tiny_cost_no_bound():
    """Met exactly they have no weight, and near zero the tangent would be vertical."""
    rng = rng_of(2)
    graph, _ = point_graph(rng, 5, 2, 2, noise=0.2)
    poses = graph.pose_nodes
    n = graph.num_nodes + 1
    rotation = RotationGraph(n, graph.edges, graph.rotation.rotations, graph.rotation.kappa)
    points = np.append(graph.points, True)  # one more, of which one distance alone is known
    more = PoseGraph(rotation, graph.translations, graph.tau, points=points)
    alone = solve(graph)
    for distance in (2.0, 1e-15, 1e-20, 1e-300):
        ranges = Ranges(n, [[poses[0], n - 1]], [distance], [3.0])
        answer = solve(RangeProblem(more, ranges))
        assert answer.verdict.value == "CERTIFIED"
        assert answer.cost == pytest.approx(alone.cost, rel=1e-6)
    with pytest.raises(InputError, match="beyond the range of doubles"):
        solve(RangeProblem(more, Ranges(n, [[poses[0], n - 1]], [1e160], [3.0])))


@given(seeds, dimensions)
@few
def test_estimates_of_others_are_judged(seed, d):
    problem, truth, _ = measured(seed, d, noise=0.3)
    answer = solve(problem)
    for estimate in (truth, answer.estimate):
        found = certpgo.certify(problem, estimate)
        assert found.cost_upper == pytest.approx(problem.cost(estimate))
        assert found.lower_bound <= min(found.refined_cost, answer.cost)
        assert found.verdict.value in ("CERTIFIED", "BOUNDED", "REFUTED")
    assert found.verdict is not certpgo.Verdict.REFUTED
    assert found.lower_bound == pytest.approx(answer.certificate.lower_bound, rel=1e-5)
    with pytest.raises(InputError, match="proof tier"):
        certpgo.certify(problem, truth, tier="proof")


def test_a_map_stuck_elsewhere_is_refuted(dataset):
    instance = dataset("goats_16")
    problem = range_problem(instance)
    estimate = solve(problem).estimate
    t = estimate.translations.copy()
    t[instance.graph.points, 0] *= -3.0  # beacons on the wrong side
    found = certpgo.certify(problem, Estimate(estimate.rotations, t))
    assert found.verdict.value == "REFUTED"
    assert found.better_cost == pytest.approx(7788.24042, rel=1e-6)
    assert found.refined_cost > 2.0 * found.better_cost


def test_covariances_are_inverse_matrices():
    problem, _, _ = measured(4, 2)
    answer = solve(problem)
    H = problem.gauss_newton(answer.estimate).toarray()
    layout = problem.tangent_layout
    first = layout.first_row(problem.poses[0])
    kept = np.setdiff1d(np.arange(layout.size), first + np.arange(3))
    C = np.linalg.inv(H[np.ix_(kept, kept)])
    point = int(np.flatnonzero(problem.measured.points)[0])
    rows = np.searchsorted(kept, layout.first_row(point) + np.arange(2))
    np.testing.assert_allclose(answer.covariance(point), C[np.ix_(rows, rows)], rtol=1e-8)


@pytest.mark.parametrize(
    ("name", "cost", "gap"),
    [("goats_15", 36409.2473, 0.1035), ("goats_16", 7788.24042, 0.0465)],
)
def test_published_graphs(dataset, name, cost, gap):
    answer = solve(dataset(name))
    assert answer.verdict.value == "BOUNDED"
    assert answer.cost == pytest.approx(cost, rel=1e-6)
    assert answer.certificate.relative_gap < gap
    assert "not tight" in answer.certificate.reason


def test_what_is_refused():
    problem, _, _ = measured(1, 2)
    n = problem.n
    with pytest.raises(GraphError, match="a distance is not negative and finite"):
        Ranges(n, [[0, 1]], [-1.0], [1.0])
    with pytest.raises(GraphError, match="weight is 0"):
        Ranges(n, [[0, 1]], [1.0], [0.0])
    with pytest.raises(GraphError, match="nodes are numbered"):
        Ranges(n, [[0, n]], [1.0], [1.0])
    with pytest.raises(GraphError, match="the distances are of another graph"):
        RangeProblem(problem.measured, Ranges(n + 1, [[0, 1]], [1.0], [1.0]))
    with pytest.raises(InputError, match="proof tier is not for graphs with measured distances"):
        solve(problem, tier="proof")
    rotation = RotationGraph(3, [[0, 1]], np.eye(2)[None], np.ones(1))
    pair = PoseGraph(rotation, np.ones((1, 2)), np.ones(1))
    with pytest.raises(GraphError, match="no measurement determines the rotation of node 2"):
        RangeProblem(pair, Ranges(3, [[1, 2]], [1.0], [1.0]))
    with pytest.raises(GraphError, match="no measurement or distance joins node 2"):
        RangeProblem(pair, Ranges(3, [[0, 1]], [1.0], [1.0]))
    instance = certpgo.Instance("lonely", problem.measured, np.arange(n), ranges=problem.ranges)
    with pytest.raises(InputError, match="only the cost F"):
        solve(instance, cost="g2o")
    assert solve(instance).cost == pytest.approx(solve(problem).cost)

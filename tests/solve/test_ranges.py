"""Measured distances: minorants, derivatives, bounds, and the real data's gaps."""

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, point_graph, pose_graph, rng_of, seeds

import certpgo
from certpgo import (
    Estimate,
    GraphError,
    InputError,
    NumericalError,
    Quadratic,
    Ranges,
    solve,
)
from certpgo.certify.normalized import NormalizedProblem
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.kinds import Node
from certpgo.graph.relaxed_point import Lift
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum, objective_of
from certpgo.objective.families.distances import Distances
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.objective.lifting import quarter_turn
from certpgo.objective.term import Term
from certpgo.objective.truncated_cost import rejecting
from certpgo.optimize.descent_loop import minimise
from certpgo.optimize.levenberg_marquardt import DampedSteps, descend
from certpgo.optimize.low_rank_descent import orthonormal
from certpgo.optimize.monitor import Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Status
from certpgo.optimize.staircase import way_down
from certpgo.solve import search_loop
from certpgo.solve.relaxation import Relaxed, range_bound

few = settings(max_examples=12)


def measured(seed, d, *, noise=0.1, poses=5, points=3):
    """A graph with points, and distances from every pose to every point, in random order."""
    rng = rng_of(seed)
    graph, truth = point_graph(rng, poses, points, d, noise=noise)
    seen, places = np.flatnonzero(graph.is_point), graph.pose_nodes
    pairs = np.array([(a, b) if rng.random() < 0.5 else (b, a) for a in places for b in seen])
    apart = np.linalg.norm(
        truth.translations[pairs[:, 1]] - truth.translations[pairs[:, 0]], axis=1
    )
    distances = np.abs(apart + noise * rng.standard_normal(len(pairs)))
    weights = rng.uniform(0.5, 4.0, len(pairs))
    return (
        objective_of(graph.with_ranges(Ranges(graph.num_nodes, pairs, distances, weights))),
        truth,
        rng,
    )


def anywhere(rng, problem, rises):
    """A random point of the relaxation, which rose some times into new dimensions."""
    rank = problem.d + rises * problem.lifted_form.whole.lifting.dimensions
    Z = rng.standard_normal((problem.n, rank, problem.d))
    if problem.d == 2:
        Z[:, :, 1] = quarter_turn(Z[:, :, 0])
    # Of blocks that are nearly singular, the first frames are off by more than rounding.
    return Lift(orthonormal(orthonormal(Z)), 3.0 * rng.standard_normal((problem.n, rank)))


def stationary(problem, point):
    """The end of a descent at the rank of a point."""
    here = problem.lifted_form.linearized(point)
    return minimise(here, DampedSteps(here), Progress(silent, 1e-11, 400, Stopwatch()))


def written_out(problem, point):
    """The cost by a loop, as its formula reads."""
    graph, ranges, total = problem.measured, problem.measured.ranges, 0.0
    R, t = point.rotations, point.translations
    for e, (i, j) in enumerate(graph.edges):
        if graph.kappa[e] > 0.0:
            apart = R[j] - R[i] @ graph.rotations[e]
            total += graph.kappa[e] * np.linalg.norm(apart) ** 2
        total += graph.tau[e] * np.linalg.norm(t[j] - t[i] - R[i] @ graph.translations[e]) ** 2
    for e, (i, j) in enumerate(ranges.edges):
        total += ranges.weights[e] * (ranges.distances[e] - np.linalg.norm(t[j] - t[i])) ** 2
    return total


@given(seeds, dimensions)
@few
def test_the_surrogate_is_below_and_touches(seed, d):
    posed, _, rng = measured(seed, d)
    problem, point = posed.lifted_form, anywhere(rng, posed, seed % 3)
    assert problem.cost(point) == pytest.approx(written_out(problem, point))
    below, constant = next(problem.tangents(point))
    assert below.cost(point) + constant == pytest.approx(problem.cost(point))
    for _ in range(10):
        other = anywhere(rng, posed, seed % 3)
        assert below.cost(other) + constant <= problem.cost(other) * (1.0 + 1e-12) + 1e-12


@given(seeds)
@few
def test_constants_are_rounded_down(seed):
    posed, _, rng = measured(seed, 2)
    problem = posed.lifted_form
    below, constant = next(problem.tangents(anywhere(rng, posed, 0)))
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
    posed, _, rng = measured(seed, d)
    problem, point = posed.lifted_form, anywhere(rng, posed, seed % 2)
    rank = point.rank
    basis = problem.whole.kinds.apply("tangents", point.rotations)
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
    multipliers = next(problem.tangents(point))[0].multipliers(point)
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
        start = Estimate(so.random(rng, problem.n, d), rng.standard_normal((problem.n, d)))
        cost = descend(problem, start).cost
        assert answer.certificate.lower_bound <= cost * (1.0 + 1e-12)
    # So is that of any point, whether stationary or not.
    bound = range_bound(problem.lifted_form, anywhere(rng, problem, 1), answer.cost)
    assert bound is None or bound.value <= answer.cost


@given(seeds, dimensions)
@few
def test_certificate_matrices_have_the_cost_and_its_multipliers(seed, d):
    posed, _, rng = measured(seed, d)
    problem, point = posed.lifted_form, anywhere(rng, posed, seed % 3)
    below, _ = next(problem.tangents(point))
    E = np.concatenate(
        [np.swapaxes(below.lifting.position_rows(point.translations), 1, 2), point.rotations],
        axis=2,
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


@cached_property
def over_real_matrices(problem):
    """The lifted form with the relaxation over real matrices."""
    form = LiftedDistances(problem.measured)
    form.__dict__["whole"] = Quadratic(form.whole.graph, form.engine)
    return form


@given(seeds)
@few
def test_the_oriented_relaxation_is_at_least_as_tight_as_the_real_one(seed):
    problem, _, _ = measured(seed, 2, noise=1.0)
    ours = solve(problem)
    with pytest.MonkeyPatch.context() as patch:
        over_real_matrices.__set_name__(Sum, "over_real_matrices")
        patch.setattr(Sum, "lifted_form", over_real_matrices)
        theirs = solve(objective_of(problem.measured))
    assert ours.certificate.lower_bound >= (1.0 - 1e-5) * theirs.certificate.lower_bound
    assert ours.cost <= (1.0 + 1e-6) * theirs.cost


@given(seeds)
@few
def test_oriented_points_stay_so(seed):
    posed, _, rng = measured(seed, 2)
    problem, point = posed.lifted_form, anywhere(rng, posed, 2)
    rows = rng.standard_normal((problem.n, 4))
    rising = problem.whole.lifting.rising(rows, problem.d)
    # The first coordinates are the rows.
    first = np.concatenate(
        [problem.whole.lifting.position_rows(rising.translations)[:, :, 0], rising.rotations[:, 0]],
        axis=1,
    )
    np.testing.assert_array_equal(first, rows)
    found = stationary(posed, point).point
    for Y in (rising.rotations, found.rotations):
        np.testing.assert_allclose(quarter_turn(Y[:, :, 0]), Y[:, :, 1], atol=1e-12)
    (frame,) = problem.whole.lifting.frames(np.linalg.qr(rng.standard_normal((6, 2)))[0])
    proper = np.linalg.det(frame.T @ found.rotations)
    assert (proper > 0.0).all()


@given(seeds, dimensions)
@few
def test_exact_data_are_recovered(seed, d):
    problem, truth, _ = measured(seed, d, noise=0.0, poses=6, points=5)
    answer = solve(problem)
    assert answer.cost <= 1e-9 * problem.scale
    upper = problem.enclosure(truth)[1]
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
    ranges = problem.measured.ranges
    i, j = ranges.edges.T
    back = Ranges(problem.n, np.stack([j, i], axis=1), ranges.distances, ranges.weights)
    assert objective_of(problem.measured.with_ranges(back)).cost(answer.estimate) == pytest.approx(
        answer.cost
    )
    assert problem.enclosure(answer.estimate)[1] >= problem.cost(answer.estimate)


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
    rotation = RotationGraph(n, graph.edges, graph.rotations, graph.kappa)
    points = np.append(graph.is_point, True)  # one more, of which one distance alone is known
    more = PoseGraph(rotation, graph.translations, graph.tau, points=points)
    alone = solve(graph)
    for distance in (2.0, 1e-15, 1e-20, 1e-300):
        ranges = Ranges(n, [[poses[0], n - 1]], [distance], [3.0])
        answer = solve(objective_of(more.with_ranges(ranges)))
        assert answer.verdict.value == "CERTIFIED"
        assert answer.cost == pytest.approx(alone.cost, rel=1e-6)
    with pytest.raises(InputError, match="beyond the range of doubles"):
        solve(objective_of(more.with_ranges(Ranges(n, [[poses[0], n - 1]], [1e160], [3.0]))))


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
    proven = certpgo.certify(problem, truth, tier="proof")
    assert proven.lower_bound <= min(found.refined_cost, answer.cost)


def in_lengths_of(problem, unit):
    """The same problem with lengths times ``unit``."""
    graph, ranges = problem.measured, problem.measured.ranges
    measured = PoseGraph(
        graph.rotations_alone, unit * graph.translations, graph.tau / unit**2, points=graph.is_point
    )
    distances, weights = unit * ranges.distances, ranges.weights / unit**2
    return objective_of(measured.with_ranges(Ranges(problem.n, ranges.edges, distances, weights)))


@pytest.mark.parametrize("unit", [1e-10, 1e10])
def test_the_unit_of_length_changes_nothing(unit):
    for noise in (0.0, 0.3):
        problem, truth, _ = measured(5, 3, noise=noise, poses=6)
        other = in_lengths_of(problem, unit)
        there = truth.with_translations(unit * truth.translations)
        assert other.cost(there) == pytest.approx(problem.cost(truth), rel=1e-9, abs=1e-20)
        here, found = solve(problem), solve(other)
        assert found.cost == pytest.approx(here.cost, rel=1e-6, abs=1e-12 * problem.scale)
        assert found.verdict is here.verdict


def pair(distances, d=2):
    """A point one metre from a pose, and distances between them."""
    rotation = RotationGraph(2, [[0, 1]], np.eye(d)[None], np.zeros(1))
    graph = PoseGraph(rotation, np.eye(d)[:1], np.ones(1), points=[False, True])
    pairs = [[0, 1], [1, 0], [0, 1]][: len(distances)]
    return objective_of(graph.with_ranges(Ranges(2, pairs, distances, np.ones(len(distances)))))


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_nodes_closer_than_they_can_be_are_apart_all_the_same(unit):
    """Costs have the lengths themselves; tangents take only those with directions."""
    problem = in_lengths_of(pair([1.0]), unit)
    t = unit * np.array([[0.0, 0.0], [1e-3, 0.0]])
    close = Estimate(np.tile(np.eye(2), (2, 1, 1)), t)
    assert problem.cost(close) == pytest.approx(2.0 * 0.999**2, rel=1e-12)
    assert problem.enclosure(close)[0] <= problem.cost(close) <= problem.enclosure(close)[1]
    assert problem.enclosure(close)[1] == pytest.approx(problem.enclosure(close)[0], rel=1e-12)
    apart = Estimate(close.rotations, 1e3 * t)
    assert certpgo.certify(problem, apart).verdict.value == "CERTIFIED"
    assert certpgo.certify(problem, close, refine=False).verdict.value != "REFUTED"


@pytest.mark.parametrize("d", [2, 3])
def test_repeated_distances_need_not_agree(d):
    """What they weigh adds up to zero where their mean is met, and nothing else holds a node."""
    rotation = RotationGraph(4, [[0, 1], [0, 2]], np.tile(np.eye(d), (2, 1, 1)), [0.0, 0.0])
    graph = PoseGraph(rotation, np.eye(d)[:2], np.ones(2), points=[False, True, True, True])
    pairs, distances = [[1, 3], [3, 1], [2, 3], [2, 3]], [2.9, 3.1, 3.3, 3.5]
    answer = solve(objective_of(graph.with_ranges(Ranges(4, pairs, distances, np.ones(4)))))
    assert answer.cost == pytest.approx(0.04, rel=1e-6)
    assert answer.verdict.value == "CERTIFIED"


def test_tangents_that_leave_positions_free_are_made_firm():
    """Points that contradictory distances put on a line, from which no weight holds them."""
    rotation = RotationGraph(4, [[2, 3]], np.eye(2)[None], [0.0])
    graph = PoseGraph(rotation, [[8.9, -2.6]], [1.0], points=[True, True, False, True])
    pairs = [[1, 0], [1, 3], [0, 1], [1, 2], [0, 3], [2, 0], [2, 1]]
    distances = [1.4, 5.9, 2.4, 6.8, 1.1, 3.3, 3.3]
    answer = solve(objective_of(graph.with_ranges(Ranges(4, pairs, distances, np.ones(7)))))
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(answer.certificate.lower_bound, rel=1e-6)


def test_most_distances_may_be_zero():
    """(x - 1)^2 + (2 - x)^2 + 2 x^2 is least at 3 / 4; descents must not begin at zero."""
    assert solve(pair([2.0, 0.0, 1e-200], 3)).cost == pytest.approx(2.75, rel=1e-6)
    assert solve(pair([0.0, 0.0])).cost == pytest.approx(2.0 / 3.0, rel=1e-6)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("far", [1e100, 1e154, 1e200, 1e308])
def test_estimates_beyond_the_range_of_doubles_are_undecided(far):
    problem, truth, _ = measured(0, 2)
    t = truth.translations.copy()
    t[:2] = far * np.array([[1.0, 0.0], [-1.0, 1.0]])
    found = certpgo.certify(problem, Estimate(truth.rotations, t))
    assert found.verdict.value != "CERTIFIED"
    assert found.lower_bound <= problem.cost(truth)


def test_a_search_that_finds_nothing_decides_nothing(monkeypatch):
    monkeypatch.setattr(Relaxed, "projections", lambda self: [])
    problem, truth, rng = measured(3, 3, noise=1.0)
    t = truth.translations + rng.standard_normal(truth.translations.shape)
    found = certpgo.certify(problem, Estimate(truth.rotations, t))
    assert found.verdict.value in ("BOUNDED", "UNDECIDED")
    assert found.better is None


@pytest.mark.parametrize("seed", [42, 79, 89, 124])
def test_a_descent_does_not_depend_on_how_the_world_is_turned(seed):
    problem, _, rng = measured(seed, 3, noise=3.0, poses=12, points=4)
    n = problem.n
    far = Estimate(so.random(rng, n, 3), 5.0 * rng.standard_normal((n, 3)))
    ends = [
        descend(problem, start).cost
        for start in (far, far.moved(so.random(rng, 1, 3)[0], np.ones(3)))
    ]
    assert ends[1] == pytest.approx(ends[0], rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_at_the_time_limit_the_answer_has_been_descended(clock, seed):
    """A second for each step: the climb is cut after 70 % of them, and the rest are descent."""
    problem, _, _ = measured(seed, 3, noise=1.0, poses=12, points=4)
    costs = []

    def tick(step):
        clock.now += 1.0
        costs.append(step.cost)
        return False

    answer = solve(problem, time_limit=30.0, monitor=tick)
    assert (answer.solution.status, answer.levels[-1].status) == (Status.TIME_LIMIT,) * 2
    assert clock.now <= 32.0
    descended = costs[22:]
    assert len(descended) >= 8
    assert answer.cost <= min(descended) * (1.0 + 1e-9) < 0.9 * descended[0]
    assert answer.solution.note.startswith("initialized by a random point of higher rank")


@pytest.mark.parametrize("seed", range(3))
def test_a_stopped_climb_is_projected(seed):
    """Without time for a descent, the answer is at least near the point that was reached."""
    problem, _, _ = measured(seed, 3, noise=0.1, poses=12, points=4)
    costs = []

    def stop_after_30(step):
        costs.append(step.cost)
        return len(costs) >= 30

    answer = solve(problem, monitor=stop_after_30)
    assert answer.solution.status is Status.INTERRUPTED
    assert not answer.certificate.settled
    assert answer.cost == pytest.approx(costs[30], rel=1e-12)
    assert costs[30] < 0.5 * costs[0]


def test_a_descent_that_fails_is_not_the_last(monkeypatch):
    problem, _, _ = measured(1, 3, noise=1.0, poses=12, points=4)
    descent, failures = search_loop.descend, [NumericalError("no"), np.linalg.LinAlgError("no")]

    def failing_first(*given, **more):
        if failures:
            raise failures.pop()
        return descent(*given, **more)

    whole = solve(problem)
    assert {"descend", "certify", "escape", "round"} <= set(whole.solution.seconds)
    monkeypatch.setattr(search_loop, "descend", failing_first)
    found = solve(problem)
    assert not failures
    assert found.solution.status is Status.CONVERGED
    assert found.cost <= 1.5 * whole.cost


def test_the_values_of_the_file_are_a_start(clock):
    problem, truth, _ = measured(2, 3, noise=0.5, poses=12, points=4)
    nodes = np.arange(problem.n)
    instance = certpgo.Instance("kept", problem.measured, nodes, initial=truth)
    at_once = solve(instance, monitor=lambda step: True)
    assert at_once.cost <= problem.cost(truth)
    assert at_once.start == "the initial values of the file"
    without = solve(instance, monitor=lambda step: True, try_file_start=False)
    assert without.cost > 2.0 * problem.cost(truth)
    assert without.start == "a random point of higher rank"
    unfinished = replace(instance, initial=Estimate(truth.rotations))
    assert solve(unfinished, monitor=lambda step: True).cost == without.cost


@pytest.mark.parametrize(("seed", "d"), [(10, 2), (52, 2), (58, 2), (3, 3), (13, 3)])
def test_rounding_of_lengths_does_not_stall_descents(seed, d):
    """Errors of a millimetre: lengths are rounded to more than the last decreases of their cost."""
    problem, _, _ = measured(seed, d, noise=1e-3)
    answer = solve(problem)
    ends = [answer.solution.status, *(level.status for level in answer.levels)]
    assert set(ends) == {Status.CONVERGED}
    assert answer.verdict.value == "CERTIFIED"


def test_ways_down_are_not_looked_for_after_a_stop():
    problem, _, _ = measured(2, 3, noise=1.0, poses=12, points=4)
    normalized = NormalizedProblem.of(problem, "standard", 0.0, 0.0)
    relaxed = Relaxed(normalized.problem.lifted_form, normalized.stop, 10)
    point = stationary(problem, relaxed.point).point
    asked = []

    def third():
        asked.append(None)
        return len(asked) == 3

    assert way_down(problem.lifted_form, point, point.rank) is not None
    with pytest.raises(NumericalError, match="stopped before"):
        way_down(problem.lifted_form, point, point.rank, third)
    assert len(asked) == 3


def test_rejected_steps_are_reported_and_may_be_the_last():
    problem, _, rng = measured(0, 3, noise=1.0, poses=12, points=4)
    start = Estimate(so.random(rng, problem.n, 3), rng.standard_normal((problem.n, 3)))
    steps = []

    def at_the_first_rejected(step):
        steps.append(step)
        return not step.accepted

    found = descend(problem, start, monitor=at_the_first_rejected)
    assert found.status is Status.INTERRUPTED
    assert [step.accepted for step in steps] == [True] * (len(steps) - 1) + [False]
    assert found.cost == steps[-1].cost == steps[-2].cost


def test_a_map_stuck_elsewhere_is_refuted(dataset):
    instance = dataset("goats_16")
    problem = objective_of(instance)
    estimate = solve(problem).estimate.anchored(0)
    t = estimate.translations.copy()
    t[instance.graph.is_point, 0] *= -3.0  # beacons on the wrong side
    found = certpgo.certify(problem, Estimate(estimate.rotations, t))
    assert found.verdict.value == "REFUTED"
    assert found.better_cost == pytest.approx(7788.24042, rel=1e-6)
    assert found.refined_cost > 2.0 * found.better_cost


def test_covariances_are_inverse_matrices():
    problem, _, _ = measured(4, 2)
    answer = solve(problem)
    H = problem.gauss_newton(answer.estimate).toarray()
    layout = problem.tangent_layout
    first = layout.first_row(problem.measured.pose_nodes[0])
    kept = np.setdiff1d(np.arange(layout.size), first + np.arange(3))
    C = np.linalg.inv(H[np.ix_(kept, kept)])
    point = int(np.flatnonzero(problem.measured.is_point)[0])
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
    with pytest.raises(GraphError, match="distances are of 9 nodes, the graph has 8"):
        problem.measured.with_ranges(Ranges(n + 1, [[0, 1]], [1.0], [1.0]))
    rotation = RotationGraph(3, [[0, 1]], np.eye(2)[None], np.ones(1))
    pair = PoseGraph(rotation, np.ones((1, 2)), np.ones(1))
    with pytest.raises(GraphError, match="no measurement determines the rotation of node 2"):
        objective_of(pair.with_ranges(Ranges(3, [[1, 2]], [1.0], [1.0])))
    with pytest.raises(GraphError, match="2 components of 2, 1 nodes"):
        objective_of(pair.with_ranges(Ranges(3, [[0, 1]], [1.0], [1.0])))
    points = PoseGraph(RotationGraph(2, [[0, 1]], np.eye(2)[None], [0.0]), [[0.0, 0.0]], [1.0])
    points = replace(points, nodes=np.full(2, Node.POINT))
    with pytest.raises(GraphError, match="no poses"):
        objective_of(points.with_ranges(Ranges(2, [[0, 1]], [1.0], [1.0])))
    with pytest.raises(GraphError, match="must be connected"):
        objective_of(pair.with_ranges(Ranges(3, np.empty((0, 2), dtype=int), [], [])))
    instance = certpgo.Instance("lonely", problem.measured, np.arange(n))
    with pytest.raises(InputError, match="not all edges have one"):
        solve(instance, cost="g2o")
    assert solve(instance).cost == pytest.approx(solve(problem).cost)


def test_robust_fits_take_distances():
    problem, _, _ = measured(3, 2)
    instance = certpgo.Instance("distances", problem.measured, np.arange(problem.n))
    answer = certpgo.solve_robustly(instance)
    assert not len(answer.solution.rejected)
    assert answer.cost == pytest.approx(solve(problem).cost, rel=1e-8)


def doubtful():
    """A drive whose loops and distances are right but for three distances, four metres too long."""
    rng, instance = rng_of(3), helix(8, rng_of(3))
    n, t = instance.graph.num_nodes, instance.truth.translations
    pairs = np.array([(i, j) for i in range(0, n, 2) for j in range(i + 3, n, 4)])
    apart = np.linalg.norm(t[pairs[:, 0]] - t[pairs[:, 1]], axis=1)
    distances = np.abs(apart + 0.05 * rng.standard_normal(len(pairs)))
    wrong = np.array([5, 40, 90])
    distances[wrong] += 4.0
    ranges = Ranges(n, pairs, distances, np.full(len(pairs), 400.0))
    graph = instance.graph.with_ranges(ranges)
    return replace(instance, graph=graph), graph.num_edges + wrong


@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_wrong_distances_are_named(cost, tmp_path):
    instance, wrong = doubtful()
    path = tmp_path / "doubtful.npz"
    information = certpgo.graph.information.Information
    measured = instance.graph
    known = information.isotropic(measured.kappa, measured.tau, 3, "g2o", "quaternion")
    certpgo.write(path, replace(instance, graph=measured.with_information(known)))
    answer = solve(path, cost=cost)
    assert answer.disagreement.edges.tolist() == wrong.tolist()
    robust = certpgo.solve_robustly(path, cost=cost)
    assert robust.solution.rejected.tolist() == wrong.tolist()


def test_a_wrong_distance_between_maps_is_the_one_that_is_named():
    instance, wrong = doubtful()
    n = instance.graph.num_nodes
    first, second = np.arange(n // 2), np.arange(n // 2, n)
    maps = [
        certpgo.Instance(name, instance.graph.with_ranges(None).subgraph(nodes), nodes)
        for name, nodes in (("a", first), ("b", second))
    ]
    graph, ranges = instance.graph, instance.graph.ranges
    crosses = (graph.edges < n // 2).sum(axis=1) == 1
    between = graph.with_edges(crosses).with_ranges(
        ranges.subset((ranges.edges < n // 2).sum(axis=1) == 1)
    )
    joint = certpgo.Instance("joint", between, np.arange(n))
    for robust in (False, True):
        found = certpgo.merge(maps, joint, robust=robust)
        named = found.instance.graph.pairs[found.disagreeing]
        across = [pair for pair in graph.pairs[wrong].tolist() if (min(pair) < n // 2 <= max(pair))]
        assert sorted(map(sorted, named.tolist())) == sorted(map(sorted, across))
        assert found.left_out == (robust and len(across) > 0)


def test_a_class_that_derives_from_distances_has_a_cost_of_its_own():
    """Half the weight, by its own term: neither descents nor bounds take it for distances."""
    graph, _, t = pose_graph(rng_of(5), 6, 2, noise=0.1)
    pairs = np.array([[0, 3], [1, 4], [2, 5], [0, 5]])
    apart = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
    apart = apart + np.array([1.5, -0.5, 1.0, 2.0])
    halves = graph.with_blocks(HalfRanges(6, pairs, apart, np.ones(4)))
    plain = graph.with_ranges(Ranges(6, pairs, apart, 0.5 * np.ones(4)))
    found, expected = solve(halves), solve(plain)
    assert found.verdict.value == expected.verdict.value == "CERTIFIED"
    assert found.cost == pytest.approx(expected.cost, rel=1e-7)
    assert halves.ranges is None
    assert objective_of(halves).lifted_form is None


@dataclass(frozen=True, eq=False, repr=False)
class HalfRanges(Ranges):
    """Distances that cost half."""


@dataclass(frozen=True, eq=False)
class Half(Term):
    """Half the term of the same distances."""

    of: HalfRanges
    takes = HalfRanges
    plural = "half distances"
    in_metres = True

    @property
    def plain(self):
        of = self.of
        return Distances(Ranges(of.num_nodes, of.edges, of.distances, 0.5 * of.weights))

    @property
    def edges(self):
        return self.of.edges

    @property
    def weights(self):
        return self.plain.weights

    @property
    def scale(self):
        return self.plain.scale

    def residuals(self, v, Q):
        return self.plain.residuals(v, Q)

    def linearized(self, v, Q):
        return self.plain.linearized(v, Q)

    def enclosures(self, v, Q):
        return self.plain.enclosures(v, Q)

    def minorants(self, v, Q):
        return self.plain.minorants(v, Q)


def test_stiff_measurements_beside_distances_cost_no_bound():
    """Two rings, a mount of 1e12 times the weight, three distances, one wrong measurement."""
    rng, n = np.random.default_rng(0), 12
    R, t = so.exp(rng.uniform(-3, 3, (n, 1))), 3.0 * rng.standard_normal((n, 2))
    ring = [(k, (k + 1) % 6) for k in range(6)] + [(0, 3), (1, 4), (2, 5), (0, 2)]
    edges = np.array([*ring, *((a + 6, b + 6) for a, b in ring), (0, 6)])
    (i, j), m = edges.T, len(edges)
    turns = np.swapaxes(R[i], 1, 2) @ R[j] @ so.exp(0.05 * rng.standard_normal((m, 1)))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + 0.05 * rng.standard_normal((m, 2))
    turns[7] = turns[7] @ so.exp(np.array([[2.0]]))[0]
    weights = np.full(m, 400.0)
    weights[-1] *= 1e12
    pairs = np.array([[0, 4], [7, 10], [3, 5]])
    apart = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
    graph = PoseGraph(RotationGraph(n, edges, turns, weights), steps, weights)
    graph = graph.with_ranges(Ranges(n, pairs, apart, np.full(3, 400.0)))
    robust = certpgo.solve_robustly(graph)
    assert robust.solution.rejected.tolist() == [7]
    assert (robust.verdict.value, robust.rejection.verdict.value) == ("CERTIFIED",) * 2
    assert solve(graph).verdict.value == "CERTIFIED"


def test_truncated_costs_are_judged_and_not_posed_again():
    problem, _, _ = measured(1, 2)
    truncated = rejecting(problem, np.array([0]))
    with pytest.raises(InputError, match="rejects none"):
        rejecting(truncated, np.array([1]))
    with pytest.raises(InputError, match="is certified, not solved"):
        certpgo.solve_robustly(truncated)
    assert "certpgo.certify" in str(truncated)
    assert "certpgo.solve" not in str(truncated)

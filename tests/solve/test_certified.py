"""The certified pipeline: golden optima, the way out of wound-up starts, laws, interruptions."""

import math
import os
import signal
import threading
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, random_edges, rng_of, rotation_graph, seeds

from certpgo import SolveSettings, certify, solve
from certpgo.certify import Tier, Verdict
from certpgo.certify.dual import Attempts
from certpgo.certify.normalized import NormalizedProblem
from certpgo.errors import GraphError, InputError, NumericalError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import corridor, grid3d, helix, winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.objective.complex_relaxation import over_complex_numbers
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize import staircase
from certpgo.optimize.curvature import resolution
from certpgo.optimize.initialization import Start
from certpgo.optimize.methods.low_rank import LowRank
from certpgo.optimize.monitor import Iteration, silent
from certpgo.optimize.progress import Stop
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Level, Status
from certpgo.solve import bounding, endings, search_loop
from certpgo.solve import search as plans
from certpgo.solve.search_loop import Search

#: DESIGN section 5: SE-Sync's weights, poses and rotations alone.
OPTIMA = {
    "smallGrid3D": (1025.398056, None),
    "parking-garage": (1.262524428, 0.001732578),
    "sphere2500": (1687.005814, 885.362701),
    "torus3D": (24227.045558, 12188.386283),
    "sphere_bignoise_vertex3": (2961756.490288, 2951513.234140),
    "cubicle": (717.125990742, 108.439655767),
    "intel": (52.3482, None),
    "MIT": (61.1541, None),
    "manhattan": (6431.391387, None),
    "kitti_00": (125.6935, None),
    "kitti_05": (276.5144, None),
    "city10000": (638.6246, None),
    "ring": (11.2575, None),
    "M3500a": (1597.6363, None),
}


@pytest.mark.parametrize("name", OPTIMA)
def test_the_published_optima_are_certified(name, dataset):
    graph = dataset(name).graph
    for part, optimum in zip((graph, graph.rotations_alone), OPTIMA[name], strict=True):
        answer = solve(part, cost="chordal")
        assert answer.verdict is Verdict.CERTIFIED
        assert answer.certificate.lower_bound <= answer.cost
        assert len(answer.levels) == 1
        if optimum is not None:
            assert answer.cost == pytest.approx(optimum, rel=3e-6)


def certified_at(answer, cost, scale=1.0):
    """Whether the answer is proven, and no worse than a cost that is known."""
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.certificate.gap <= answer.certificate.tolerance
    assert answer.cost == pytest.approx(cost, rel=1e-6, abs=1e-12 * scale)
    return True


def solve_from(graph, start, **options):
    """The answer found from a given start alone, so that there is something to climb out of."""
    return solve(graph, initial=start, try_own_start=False, **options)


def climbed(answer):
    """Whether the staircase left the given start at rank d for a better point above."""
    ranks = [level.rank for level in answer.levels]
    assert answer.start == "the given estimate"
    assert len(ranks) > 1
    assert ranks == list(range(ranks[0], ranks[0] + len(ranks)))
    assert all(level.eigenvalue < 0.0 for level in answer.levels[:-1])
    assert answer.cost < answer.levels[0].cost
    assert f"rank {ranks[-1]}" in answer.solution.note
    return True


def pulled(graph, lever, rng):
    """Poses whose rotations are measured as in the graph, and whose steps are exact."""
    n, d = graph.num_nodes, graph.d
    R = winding_cycle(n, 0.3, 0, d)[1].rotations
    t = lever * rng.standard_normal((n, d))
    i, j = graph.edges.T
    return PoseGraph(graph, np.einsum("mba,mb->ma", R[i], t[j] - t[i]), np.ones(n)), t


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("winding", [1, 2])
@pytest.mark.parametrize("theta", [0.0, 0.3])
@pytest.mark.parametrize("n", [5, 20, 60])
def test_wound_up_cycles_are_unwound(n, theta, winding, d):
    instance, wound = winding_cycle(n, theta, winding, d)
    optimum = 8 * n * math.sin(theta / (2 * n)) ** 2
    answer = solve_from(instance.graph, wound)
    assert certified_at(answer, optimum, n)
    assert climbed(answer)
    assert answer.levels[0].rank == d
    assert answer.levels[0].cost == pytest.approx(Quadratic(instance.graph).cost(wound))
    # Poses at one place: their translations hold nothing together.
    together = PoseGraph(instance.graph, np.zeros((n, d)), np.ones(n))
    answer = solve_from(together, Estimate(wound.rotations, np.ones((n, d))))
    assert certified_at(answer, optimum, n)
    assert climbed(answer)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("winding", [1, 2])
@pytest.mark.parametrize("n", [5, 20, 60])
def test_wound_up_cycles_of_poses_are_unwound(n, winding, d):
    instance, wound = winding_cycle(n, 0.3, winding, d)
    graph, t = pulled(instance.graph, 0.5, np.random.default_rng(n))
    answer = solve_from(graph, Estimate(wound.rotations, t))
    assert answer.start == "the given estimate"
    # The steps agree with the optimum of the rotations, and pull nowhere.
    assert certified_at(answer, 8 * n * math.sin(0.3 / (2 * n)) ** 2, Quadratic(graph).scale)
    if n == 60 and winding == 1:
        assert climbed(answer)


@pytest.mark.parametrize("d", [2, 3])
def test_a_long_wound_up_cycle_is_unwound(d):
    instance, wound = winding_cycle(2000, 0.3, 1, d)
    answer = solve_from(instance.graph, wound)
    assert certified_at(answer, 8 * 2000 * math.sin(0.3 / 4000) ** 2)


def wound_around_the_cylinder(truth, winding):
    """Each pose of a helix turned about the axis by its own angle around the cylinder."""
    x, y, _ = truth.translations.T
    angle = winding * np.unwrap(np.arctan2(y, x))
    turns = so.exp(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    return Estimate(turns @ truth.rotations, truth.translations)


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize(("turns", "winding"), [(8, 1), (12, 1), (12, 2)])
def test_helices_wound_up_around_the_cylinder(turns, winding, poses):
    instance = helix(turns, np.random.default_rng(turns))
    start = wound_around_the_cylinder(instance.truth, winding)
    graph = instance.graph if poses else instance.graph.rotations_alone
    own = solve(graph)
    assert own.verdict is Verdict.CERTIFIED
    answer = solve_from(graph, start)
    assert certified_at(answer, own.cost)
    assert answer.start == "the given estimate"
    if winding == 1:
        assert climbed(answer)
        assert answer.levels[0].cost > 100.0 * own.cost


def test_an_uneven_helix_wound_up():
    instance = helix(12, np.random.default_rng(12), uneven=True)
    truth = instance.truth
    x, y, _ = truth.translations.T
    turns = so.exp(np.arctan2(y, x)[:, None] * np.array([0.0, 0.0, 1.0]))
    start = Estimate(turns @ truth.rotations, truth.translations)
    answer = solve_from(instance.graph, start)
    assert certified_at(answer, solve(instance.graph).cost)


def test_random_starts_are_as_good_as_any():
    for seed in range(4):
        rng = np.random.default_rng(seed)
        d = 2 + seed % 2
        graph, _, _ = pose_graph(rng, 30, d, noise=0.05)
        start = Estimate(so.random(rng, 30, d), 100.0 * rng.standard_normal((30, d)))
        for part in (graph, graph.rotations_alone):
            own = solve(part)
            assert own.start != "given"
            assert certified_at(solve_from(part, start), own.cost)


def honest(answer, problem):
    """What must hold of every answer, certified or not."""
    certificate, slack = answer.certificate, 1e-12 * problem.scale
    assert answer.cost == problem.cost(answer.estimate)
    assert answer.cost <= certificate.cost_upper + 1e-16 * problem.scale
    gap = certificate.cost_upper - certificate.lower_bound
    assert certificate.gap in (gap, math.nextafter(gap, math.inf))  # rounded up
    assert 0.0 <= certificate.lower_bound <= answer.cost * (1.0 + 1e-12) + slack
    assert answer.solution.lower_bound == certificate.lower_bound
    closed = certificate.gap <= certificate.tolerance
    assert (answer.verdict is Verdict.CERTIFIED) == closed
    assert (answer.verdict is Verdict.UNDECIDED) == (not closed and certificate.lower_bound == 0.0)
    assert answer.verdict is not Verdict.REFUTED
    return True


def test_loose_relaxations_end_bounded():
    """With this much noise hardly any is tight: the best found, and a bound below all others."""
    verdicts = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        d = 2 + seed % 2
        graph, _, _ = pose_graph(rng, 8, d, noise=2.0)
        problem = Quadratic(graph if seed % 4 < 2 else graph.rotations_alone)
        answer = solve(problem)
        verdicts.append(answer.verdict)
        assert honest(answer, problem)
        assert answer.certificate.lower_bound > 0.0
        # The bound is the relaxation's: points of enough dimensions come down to it. Poses in the
        # plane have a tighter one.
        relaxed = LowRank(rank=d + 4, seed=seed).solve(problem).trace[-1].cost
        if over_complex_numbers(problem) is None:
            assert answer.certificate.lower_bound <= relaxed * (1.0 + 1e-9)
        assert answer.certificate.lower_bound >= relaxed * (1.0 - 1e-3)
        judged = certify(problem, answer.estimate)
        assert judged.lower_bound <= answer.certificate.lower_bound * (1.0 + 1e-6)
        for _ in range(3):
            local = newton(
                problem, problem.complete(so.random(rng, 8, d)), NewtonSettings(max_iterations=200)
            )
            assert answer.certificate.lower_bound <= local.cost * (1.0 + 1e-12)
    assert verdicts.count(Verdict.BOUNDED) >= 6
    assert set(verdicts) <= {Verdict.BOUNDED, Verdict.CERTIFIED}


@settings(max_examples=25)
@given(seeds, dimensions, st.booleans(), st.sampled_from([0.0, 1e-6, 0.05, 0.3]))
def test_small_noise_is_always_certified(seed, d, poses, noise):
    graph, R, t = pose_graph(rng_of(seed), 8, d, noise=noise)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    answer = solve(problem)
    assert honest(answer, problem)
    assert answer.verdict is Verdict.CERTIFIED
    truth = problem.cost(Estimate(R, t if poses else None))
    assert answer.cost <= truth * (1.0 + 1e-5) + 1e-12 * problem.scale
    if noise == 0.0:
        assert answer.cost < 1e-20 * problem.scale


@settings(max_examples=25)
@given(seeds, dimensions, st.integers(2, 6), st.booleans())
def test_trees_cost_nothing(seed, d, n, poses):
    """A single edge is the tree of two nodes; a tree has nothing to disagree with."""
    graph, _, _ = pose_graph(rng_of(seed), n, d, extra=0, noise=1.0)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    answer = solve(problem)
    assert honest(answer, problem)
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.cost < 1e-20 * problem.scale


@settings(max_examples=25)
@given(seeds, st.integers(2, 6), st.booleans())
def test_parallel_edges_in_the_plane_have_a_mean(seed, m, poses):
    """F = 2 sum kappa |e^(i a) - e^(i b)|^2: the best angle is the weighted mean's."""
    rng = rng_of(seed)
    angles, kappa = rng.normal(0.0, 0.5, m), rng.uniform(0.5, 2.0, m)
    edges = np.where(rng.random(m)[:, None] < 0.5, [0, 1], [1, 0])
    signed = np.where(edges[:, 0] == 0, angles, -angles)
    graph = RotationGraph(2, edges, so.exp(signed[:, None]), kappa)
    if poses:
        graph = PoseGraph(graph, np.zeros((m, 2)), np.ones(m))
    answer = solve(graph)
    mean = np.sum(kappa * np.exp(1j * angles))
    assert certified_at(answer, 4.0 * (kappa.sum() - abs(mean)), kappa.sum())
    R = answer.estimate.rotations
    assert so.log(R[0].T @ R[1])[0] == pytest.approx(np.angle(mean), abs=1e-7)


@settings(max_examples=25)
@given(seeds, dimensions, st.booleans())
def test_parallel_edges_are_edges(seed, d, poses):
    graph, _, _ = pose_graph(rng_of(seed), 4, d, extra=8, noise=0.1)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    answer = solve(problem)
    assert honest(answer, problem)
    assert answer.verdict is Verdict.CERTIFIED


@settings(max_examples=20)
@given(seeds, dimensions, st.floats(-8.0, 8.0), st.booleans())
def test_weights_of_any_scale(seed, d, decades, poses):
    graph, _, _ = pose_graph(rng_of(seed), 8, d, noise=0.05)
    scale = 10.0**decades
    heavier = graph.with_weights(scale * graph.kappa, scale * graph.tau)
    parts = (graph, heavier) if poses else (graph.rotations_alone, heavier.rotations_alone)
    one, other = (solve(part) for part in parts)
    assert certified_at(other, scale * one.cost)


@settings(max_examples=20)
@given(seeds, dimensions, st.floats(0.0, 8.0), st.booleans())
def test_weights_of_different_scale_in_one_graph(seed, d, decades, poses):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 8, d, noise=0.05)
    # Poses bear less: what is eliminated is as ill-conditioned as what stays.
    span = 0.6 * decades if poses else decades
    kappa, tau = 10.0 ** rng.uniform(-span, span, (2, graph.num_edges))
    graph = graph.with_weights(kappa, tau)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    answer = solve(problem)
    assert honest(answer, problem)
    assert answer.verdict is Verdict.CERTIFIED


@settings(max_examples=30)
@given(seeds, dimensions, st.floats(-6.0, -2.0), st.floats(-6.0, 1.0))
def test_kappa_and_tau_of_different_scale(seed, d, turn, move):
    """Weights that are what the noise says: a micrometre may stand beside a degree."""
    rng = rng_of(seed)
    turn, move = 10.0**turn, 10.0**move
    edges = random_edges(rng, 8, 16)
    R, t = so.random(rng, 8, d), 3.0 * rng.standard_normal((8, d))
    (i, j), m = edges.T, len(edges)
    measured = np.swapaxes(R[i], 1, 2) @ R[j]
    measured = measured @ so.exp(turn * rng.standard_normal((m, so.tangent_dim(d))))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + move * rng.standard_normal((m, d))
    rotation = RotationGraph(8, edges, measured, np.full(m, turn**-2))
    problem = Quadratic(PoseGraph(rotation, steps, np.full(m, move**-2)))
    answer = solve(problem)
    assert honest(answer, problem)
    # A cost of much less is near the rounding of its own evaluation.
    assert answer.verdict is Verdict.CERTIFIED or answer.cost < 1e-9 * problem.scale
    assert answer.cost <= problem.cost(Estimate(R, t)) * (1.0 + 1e-5) + 1e-12 * problem.scale


@settings(max_examples=15)
@given(seeds, dimensions, st.integers(-200, 200), st.sampled_from([0.1, 1.5]), st.booleans())
def test_powers_of_two_change_nothing_else(seed, d, power, noise, poses):
    graph, _, _ = pose_graph(rng_of(seed), 7, d, noise=noise)
    scale = 2.0**power
    heavier = graph.with_weights(scale * graph.kappa, scale * graph.tau)
    parts = (graph, heavier) if poses else (graph.rotations_alone, heavier.rotations_alone)
    one, other = (solve(part) for part in parts)
    assert other.verdict is one.verdict
    assert other.cost == scale * one.cost
    assert other.certificate.lower_bound == scale * one.certificate.lower_bound
    assert [level.cost for level in other.levels] == [scale * level.cost for level in one.levels]
    assert [level.eigenvalue and level.eigenvalue / scale for level in other.levels] == [
        level.eigenvalue for level in one.levels
    ]
    assert [step.cost for step in other.solution.trace] == [
        scale * step.cost for step in one.solution.trace
    ]
    np.testing.assert_array_equal(other.estimate.rotations, one.estimate.rotations)


def test_the_start_is_named(dataset):
    intel = dataset("intel").graph.under("chordal")
    assert solve(intel).start == solve(intel.rotations_alone).start == "laplacian_gauss_newton"
    # Too much noise for averaging to settle.
    for d, name in ((2, "eigen_ma"), (3, "eigen_q")):
        stop = {"max_rank": d}
        rough = [pose_graph(np.random.default_rng(seed), 9, d, noise=2.0)[0] for seed in range(2)]
        assert name in {solve(graph, **stop).start for graph in rough}
        assert "eigen_ra" in {solve(graph.rotations_alone, **stop).start for graph in rough}


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("d", [2, 3])
def test_every_engine_gives_the_same_answers(d, engine, monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    graph, R, t = pose_graph(np.random.default_rng(d), 20, d)
    answer = solve(graph)
    assert certified_at(answer, newton(Quadratic(graph), Estimate(R, t)).cost)
    assert answer.certificate.engine == engine
    instance, wound = winding_cycle(20, 0.3, 1, d)
    unwound = solve_from(instance.graph, wound)
    assert certified_at(unwound, 160 * math.sin(0.3 / 40) ** 2)
    assert climbed(unwound)


def wound_graph():
    """A cycle that needs two more dimensions, and its wound-up start."""
    instance, wound = winding_cycle(60, 0.3, 1)
    return instance.graph, wound


def test_the_answer_forwards_and_reports():
    graph, wound = wound_graph()
    answer = solve_from(graph, wound)
    assert answer.estimate is answer.solution.estimate
    assert answer.cost == answer.solution.cost == Quadratic(graph).cost(answer.estimate)
    assert answer.verdict is answer.certificate.verdict
    assert answer.solution.status is Status.CONVERGED
    assert answer.solution.counts["factorizations"] >= 3
    assert answer.solution.counts["products"] >= 1
    assert {"start", "newton", "certify", "escape", "low rank"} <= set(answer.solution.seconds)
    numbers = [step.number for step in answer.solution.trace]
    assert numbers == list(range(len(numbers)))
    at = [step.seconds for step in answer.solution.trace]
    assert 0.0 < at[0] < at[-1] <= sum(answer.solution.seconds.values())
    assert answer.levels[-1].eigenvalue is None
    plain = solve(graph)
    assert plain.start != "given"
    assert plain.start in plain.solution.note
    assert set(plain.solution.counts) >= {"factorizations"}


def test_the_monitor_sees_the_trace_in_the_units_of_the_graph():
    graph, wound = wound_graph()
    graph = graph.with_weights(1e6)
    told = []
    answer = solve_from(graph, wound, monitor=lambda step: told.append(step) or False)
    assert tuple(told) == answer.solution.trace
    assert told[0].cost == pytest.approx(Quadratic(graph).cost(wound))
    assert answer.levels[0].cost == pytest.approx(told[0].cost)


@pytest.mark.parametrize("tight", [True, False])
def test_a_monitor_may_stop_it_anywhere(tight):
    """The best so far, and a verdict that claims no more than was proven by then."""
    graph, wound = wound_graph()
    if not tight:
        graph, wound = pose_graph(np.random.default_rng(3), 8, 3, noise=2.0)[0], None
    problem = Quadratic(graph)
    whole = solve_from(graph, wound)
    steps = len(whole.solution.trace)
    assert (whole.verdict is Verdict.CERTIFIED) == tight
    assert len(whole.levels) > 1
    bound = 0.0
    for last in sorted({*range(6), *range(6, steps, max(5, steps // 10)), steps - 1}):
        answer = solve_from(graph, wound, monitor=lambda step, last=last: step.number >= last)
        assert answer.solution.status is Status.INTERRUPTED
        assert honest(answer, problem)
        assert answer.cost <= whole.solution.trace[0].cost * (1.0 + 1e-12)
        assert answer.cost >= whole.cost - whole.certificate.tolerance
        assert answer.certificate.lower_bound >= bound  # it only gets better
        bound = answer.certificate.lower_bound
        if answer.verdict is Verdict.UNDECIDED:
            assert "stopped" in answer.certificate.reason
    early = solve_from(graph, wound, monitor=lambda step: True)
    assert (early.verdict, len(early.solution.trace)) == (Verdict.UNDECIDED, 1)


@pytest.mark.parametrize("d", [2, 3])
def test_no_time_at_all_still_gives_an_estimate(d):
    graph, _, _ = pose_graph(np.random.default_rng(d), 10, d)
    for part in (graph, graph.rotations_alone):
        problem = Quadratic(part)
        answer = solve(part, time_limit=0.0)
        assert answer.solution.status is Status.TIME_LIMIT
        assert answer.verdict is Verdict.UNDECIDED
        assert "stopped" in answer.certificate.reason
        assert honest(answer, problem)
        problem.check(answer.estimate)
    unhurried = solve(graph, time_limit=3600.0)
    assert (unhurried.verdict, unhurried.solution.status) == (Verdict.CERTIFIED, Status.CONVERGED)


def test_a_deadline_after_the_search_is_not_the_reason_of_the_verdict(clock, monkeypatch):
    certificate = endings.certificate

    def late(search):
        clock.now = 2.0
        return certificate(search)

    graph = winding_cycle(40, 1e-8, 0)[0].graph
    options = {"time_limit": 1.0, "atol": 0.0, "tier": "standard"}
    expected = solve(graph, **options).certificate.reason
    monkeypatch.setattr(endings, "certificate", late)
    answer = solve(graph, **options)
    assert (answer.verdict, answer.solution.status) == (Verdict.UNDECIDED, Status.CONVERGED)
    assert answer.certificate.reason == expected
    assert "stopped" not in expected


def test_a_deadline_during_the_closing_bound_does_not_stop_the_search(clock, monkeypatch):
    bound = bounding.bound_near

    def late(normalized, point, cost, **options):
        found = bound(normalized, point, cost, **options)
        if found is not None and cost - found.value <= normalized.tolerance(cost):
            clock.now = 3.0
        return found

    monkeypatch.setattr(bounding, "bound_near", late)
    instance, wound = winding_cycle(20, 0.3, 1)
    answer = solve_from(instance.graph, wound, time_limit=2.0)
    assert clock.now == 3.0
    assert (answer.verdict, answer.solution.status) == (Verdict.CERTIFIED, Status.CONVERGED)


def test_a_deadline_before_the_last_bound_stops_the_search(clock):
    def late(step):
        if step.number == 3:
            clock.now = 3.0
        return False

    instance, wound = winding_cycle(20, 0.3, 1)
    answer = solve_from(instance.graph, wound, time_limit=2.0, monitor=late)
    assert (answer.verdict, answer.solution.status) == (Verdict.UNDECIDED, Status.TIME_LIMIT)
    assert answer.certificate.reason == "stopped before a useful bound was found"


@pytest.fixture
def shifts_alone(monkeypatch):
    """Bounds lose to rounding, as those of lifts do."""
    monkeypatch.setattr(Attempts, "loses_to_rounding", lambda self: False)


@pytest.mark.usefixtures("shifts_alone")
@pytest.mark.parametrize("tier", [None, "proof"])
def test_a_proof_that_the_deadline_leaves_out_is_a_stop(clock, monkeypatch, tier):
    certificate = endings.certificate

    def late(search):
        clock.now = 2.0
        return certificate(search)

    graph = corridor(400, np.random.default_rng(0)).graph
    assert solve(graph, atol=1e-13, time_limit=1.0, tier=tier).verdict is Verdict.CERTIFIED
    monkeypatch.setattr(endings, "certificate", late)
    answer = solve(graph, atol=1e-13, time_limit=1.0, tier=tier)
    assert answer.solution.status is Status.TIME_LIMIT
    assert answer.verdict is (Verdict.BOUNDED if tier is None else Verdict.UNDECIDED)


def test_asking_whether_to_stop_changes_nothing(clock):
    stop = Stop(silent, deadline=1.0)
    clock.now = 2.0
    assert (stop.stop_requested, stop.request, stop.ended_by) == (True, Status.TIME_LIMIT, None)
    assert stop.should_stop()
    assert stop.ended_by is Status.TIME_LIMIT


def test_iterations_on_a_minorant_are_shown_and_not_kept():
    seen = []
    stop = Stop(lambda iteration: seen.append(iteration) or len(seen) == 3, 2.0)
    aside = stop.of_minorant(0.5)
    assert not stop(Iteration(0, 7.0, 1.0, 0.0, 0.0))
    assert not aside(Iteration(0, 6.0, 1.0, 0.0, 0.0))
    assert aside(Iteration(1, 5.0, 1.0, 0.0, 0.0))
    assert [iteration.cost for iteration in seen] == [14.0, 13.0, 11.0]
    assert [iteration.cost for iteration in stop.trace] == [14.0]
    assert stop.interrupted


def test_the_maximal_rank_is_not_exceeded():
    graph, wound = wound_graph()
    grounded = solve_from(graph, wound, max_rank=3)
    assert [level.rank for level in grounded.levels] == [3]
    assert grounded.levels[0].eigenvalue < 0.0
    assert grounded.verdict in (Verdict.BOUNDED, Verdict.UNDECIDED)
    assert grounded.cost <= Quadratic(graph).cost(wound)
    free = solve_from(graph, wound)
    highest = free.levels[-1].rank
    assert highest > 4
    for rank in (4, highest, 20):
        answer = solve_from(graph, wound, max_rank=rank)
        assert max(level.rank for level in answer.levels) <= rank
        assert answer.verdict is Verdict.CERTIFIED or rank < highest
        assert honest(answer, Quadratic(graph))


@pytest.fixture
def own_handler():
    """A SIGINT handler of the caller's, which must be back in place afterwards."""
    calls = []

    def handler(signum, frame):
        calls.append(signum)

    before = signal.signal(signal.SIGINT, handler)
    yield handler, calls
    signal.signal(signal.SIGINT, before)


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_returns_the_best_so_far(own_handler):
    handler, calls = own_handler
    graph, wound = wound_graph()

    def press(step):
        if step.number == 2:
            interrupt()
        return False

    answer = solve_from(graph, wound, monitor=press)
    assert answer.solution.status is Status.INTERRUPTED
    assert answer.verdict is Verdict.UNDECIDED
    assert len(answer.solution.trace) < len(solve_from(graph, wound).solution.trace)
    assert answer.cost <= answer.solution.trace[0].cost
    assert honest(answer, Quadratic(graph))
    assert calls == []  # it was ours to catch
    assert signal.getsignal(signal.SIGINT) is handler
    interrupt()
    assert calls == [signal.SIGINT]


def test_a_second_ctrl_c_is_meant(own_handler):
    handler, calls = own_handler
    graph, wound = wound_graph()

    def press_twice(step):
        interrupt()
        interrupt()
        return False

    with pytest.raises(KeyboardInterrupt):
        solve_from(graph, wound, monitor=press_twice)
    assert signal.getsignal(signal.SIGINT) is handler
    assert calls == []


def test_an_error_in_the_monitor_passes_and_restores_the_handler(own_handler):
    handler, _ = own_handler
    graph, wound = wound_graph()

    def broken(step):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        solve_from(graph, wound, monitor=broken)
    assert signal.getsignal(signal.SIGINT) is handler


def test_threads_are_no_place_for_signals(own_handler):
    handler, _ = own_handler
    graph, wound = wound_graph()
    answers = []
    thread = threading.Thread(target=lambda: answers.append(solve_from(graph, wound)))
    thread.start()
    thread.join()
    assert certified_at(answers[0], solve(graph).cost)
    assert signal.getsignal(signal.SIGINT) is handler


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time_limit": -1.0}, "time limit must not be negative: -1.0"),
        ({"time_limit": math.nan}, "time limit must not be negative: nan"),
        ({"max_rank": 2}, "maximal rank must be at least 3, not 2"),
        ({"rtol": -1e-9}, "tolerances must lie within"),
        ({"atol": math.inf}, "tolerances must lie within"),
        ({"rtol": math.nan}, "tolerances must lie within"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    graph, _, _ = pose_graph(np.random.default_rng(0), 5, 3)
    with pytest.raises(InputError, match=message):
        solve(graph, **options)


def test_estimates_and_graphs_that_make_no_sense_are_refused():
    graph, R, t = pose_graph(np.random.default_rng(0), 5, 3)
    with pytest.raises(InputError, match="4 nodes in 3D, the graph 5 in 3D"):
        solve(graph, initial=Estimate(R[:4], t[:4]))
    with pytest.raises(InputError, match="no translations"):
        solve(graph, initial=Estimate(R))
    apart = RotationGraph(4, np.array([[0, 1], [2, 3]]), np.tile(np.eye(3), (2, 1, 1)), np.ones(2))
    with pytest.raises(GraphError, match="2 components"):
        solve(apart)
    far = PoseGraph(graph.rotations_alone, np.full(graph.translations.shape, 1e160), graph.tau)
    with pytest.raises(InputError, match="beyond the range of doubles"):
        solve(far)


def half_turns():
    """Three measurements that are half turns about the axes: around the triangle, half a turn."""
    turns = np.array([np.eye(3), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0])])
    return RotationGraph(3, np.array([[0, 1], [0, 2], [1, 2]]), turns, np.ones(3))


def test_no_answer_is_a_saddle():
    """A half turn shared by three edges: 60 degrees each, F* = 3 * 8 sin^2(30 degrees) = 6."""
    graph = half_turns()
    answer = solve(graph)
    assert certified_at(answer, 6.0)
    assert certify(Quadratic(graph), answer.estimate).verdict is Verdict.CERTIFIED
    np.testing.assert_allclose(
        np.degrees(Quadratic(graph).residual_angles(answer.estimate)), 60.0, rtol=0, atol=1e-4
    )


def test_a_kick_leaves_a_saddle_where_no_rank_may_be_added():
    answer = solve(half_turns(), max_rank=3)
    assert [level.rank for level in answer.levels] == [3]
    assert answer.cost == pytest.approx(6.0)


def test_answers_can_be_had_again():
    graph, _, _ = pose_graph(np.random.default_rng(3), 12, 3, noise=2.0)
    one, other = solve(graph), solve(graph)
    assert one.verdict is Verdict.BOUNDED
    assert one.cost == other.cost
    np.testing.assert_array_equal(one.estimate.rotations, other.estimate.rotations)


def test_a_given_start_that_leads_nowhere_gives_way_to_our_own():
    graph, wound = wound_graph()
    answer = solve(graph, initial=wound)
    assert certified_at(answer, 480 * math.sin(0.3 / 120) ** 2)
    assert len(answer.levels) == 1
    assert answer.start == solve(graph).start
    assert f"initialized by {answer.start}, which led to a lower cost than" in answer.solution.note
    # Where it leads to the optimum, nothing else is tried.
    again = solve(graph, initial=answer.estimate)
    assert again.start == "the given estimate"
    assert again.solution.note.startswith("initialized by the given estimate")
    assert len(again.solution.trace) <= 2


def test_the_values_of_the_file_are_tried_where_the_first_descent_is_stuck(monkeypatch):
    instance, wound = winding_cycle(60, 0.3, 1)
    kept = replace(instance, initial=instance.truth)
    usual = solve(instance)
    assert (solve(kept).cost, solve(kept).start) == (usual.cost, usual.start)
    assert len(solve(kept).solution.trace) == len(usual.solution.trace)
    monkeypatch.setattr(plans, "start_of", lambda problem: Start(wound, "wound"))
    answer = solve(kept)
    assert certified_at(answer, usual.cost)
    assert (answer.start, len(answer.levels)) == ("the initial values of the file", 1)
    assert "which led to a lower cost than wound" in answer.solution.note
    assert len(solve(kept, try_file_start=False).levels) > 1
    # Those that lead nowhere lose to the search.
    stuck = solve(replace(instance, initial=wound))
    assert certified_at(stuck, usual.cost)


def test_widespread_disagreement_ends_the_climb_early(monkeypatch):
    monkeypatch.setattr(search_loop, "OUTLIERS_PATIENCE", 0.0)
    rng = np.random.default_rng(1)
    graph, _, _ = pose_graph(rng, 15, 3, noise=0.02, weights=False)
    R, wrong = graph.rotations.copy(), np.arange(14, graph.num_edges, 3)
    R[wrong] = so.random(rng, len(wrong), 3)
    spoiled = replace(graph, rotations=R)
    spoiled, told = spoiled.with_weights(1250.0, 2500.0), []
    early = solve(spoiled, on_disagreement=told.append)
    assert told[0].spreads_over(spoiled)
    assert early.disagreement is told[0]
    assert (early.verdict, early.solution.status) == (Verdict.BOUNDED, Status.TIME_LIMIT)
    assert "0 s after a first bound" in early.solution.note
    assert solve(spoiled, time_limit=math.inf).solution.status is not Status.TIME_LIMIT
    few = replace(told[0], edges=told[0].edges[:1])
    assert not few.spreads_over(spoiled)


def test_a_given_start_is_kept_where_our_own_is_no_better():
    graph, _, _ = pose_graph(np.random.default_rng(3), 8, 3, noise=2.0)
    own = solve(graph)
    assert own.verdict is Verdict.BOUNDED
    answer = solve(graph, initial=own.estimate)
    assert answer.start == "the given estimate"
    assert answer.cost <= own.cost * (1.0 + 1e-12)


def test_the_climb_ends_some_time_after_a_first_bound():
    """No time at all here: the bound in hand, how the search ended, and how to go on."""
    for seed in range(20):
        graph, _, _ = rotations_at_random(np.random.default_rng(seed), 30)
        whole = solve(graph, time_limit=math.inf)
        if len(whole.levels) > 3:
            break
    answer = solve(graph, patience=0.0)
    assert len(answer.levels) < len(whole.levels)
    assert (answer.verdict, answer.solution.status) == (Verdict.BOUNDED, Status.TIME_LIMIT)
    assert 0.0 < answer.certificate.lower_bound <= whole.certificate.lower_bound
    assert honest(answer, Quadratic(graph))
    for text in (answer.certificate.reason, answer.solution.note):
        assert "0 s after a first bound" in text
        assert "--time-limit" in text
    assert "first bound" not in whole.certificate.reason
    assert whole.solution.status is Status.CONVERGED


def rotations_at_random(rng, n):
    """Measurements that have nothing to do with one another."""
    graph, truth = rotation_graph(rng, n, 3, weights=False)
    measured = so.random(rng, graph.num_edges, 3)
    return RotationGraph(n, graph.edges, measured, graph.kappa), truth, None


def nearly_exact(weight=1e12):
    """Data that agree to nine digits, under weights that say they do to twelve."""
    graph, _, _ = pose_graph(np.random.default_rng(0), 40, 3, noise=1e-9, weights=False)
    return graph.with_weights(weight, weight)


@pytest.mark.usefixtures("shifts_alone")
def test_an_undecided_answer_says_what_to_do_next():
    graph = nearly_exact()
    answer = solve(graph, atol=0.0, rtol=0.0)
    assert answer.verdict is Verdict.UNDECIDED
    assert len(answer.levels) == 1
    assert "has no lower point" in answer.certificate.reason
    assert "too much for an exact fit" in answer.certificate.reason
    assert solve(graph, atol=0.5).verdict is Verdict.UNDECIDED  # W does not make up for a gap


@pytest.mark.usefixtures("shifts_alone")
def test_a_bound_that_rounding_limits_is_computed_once(monkeypatch):
    """Weights of 1e12 on exact data: the second and third attempt would say what the first did."""
    points, bound = [], bounding.bound_near

    def counted(normalized, point, cost, **options):
        points.append(point)
        return bound(normalized, point, cost, **options)

    monkeypatch.setattr(bounding, "bound_near", counted)
    assert solve(nearly_exact(), atol=0.0, rtol=0.0).verdict is Verdict.UNDECIDED
    assert len(points) == 1


@pytest.mark.parametrize("over", [0.5, 2.0])
def test_only_an_eigenvalue_beyond_rounding_is_a_way_down(over):
    problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    normalized = NormalizedProblem.of(problem, Tier.STANDARD, 0.0, 0.0)
    search = Search(plans.CHORDAL, problem, normalized, SolveSettings())
    search.begin(None)
    search.levels = [Level(3, search.best.cost, search.best.status)]
    eigenvalue = -over * resolution(normalized.problem)
    point = search.best.estimate
    assert plans.goes_on(search, point, eigenvalue) == (over > 1.0)
    assert search.floor == (normalized.problem.cost(point) if over < 1.0 else -math.inf)
    assert search.has_reached_the_floor == (over < 1.0)


def test_looser_tolerances_certify_more():
    for seed in range(20):
        graph, _, _ = pose_graph(np.random.default_rng(seed), 8, 3, noise=1.0)
        strict = solve(graph)
        if strict.verdict is Verdict.BOUNDED and strict.certificate.relative_gap < 0.5:
            break
    else:
        pytest.fail("no bounded answer among the seeds")
    loose = solve(graph, rtol=1.01 * strict.certificate.relative_gap)
    assert loose.verdict is Verdict.CERTIFIED
    assert loose.certificate.rtol == 1.01 * strict.certificate.relative_gap
    absolute = solve(graph, atol=1.01 * strict.certificate.gap / strict.certificate.scale)
    assert absolute.verdict is Verdict.BOUNDED  # more than a thousandth of the cost


def test_the_judge_agrees_and_grids_are_certified():
    instance = grid3d(4, np.random.default_rng(0))
    problem = Quadratic(instance.graph)
    answer = solve(instance.graph)
    assert answer.verdict is Verdict.CERTIFIED
    judged = certify(problem, answer.estimate)
    assert judged.verdict is Verdict.CERTIFIED
    assert judged.cost_upper == pytest.approx(answer.certificate.cost_upper, rel=1e-12)
    assert answer.cost < problem.cost(instance.truth)


@pytest.mark.parametrize(
    "where",
    [(staircase, "negative_curvature"), (low_rank, "descend")],
    ids=["curvature", "descent"],
)
def test_an_error_in_the_climb_loses_nothing(monkeypatch, where):
    instance, wound = winding_cycle(20, 0.0, 1)

    def fails(*args, **kwargs):
        raise NumericalError("not today")

    monkeypatch.setattr(*where, fails)
    problem = Quadratic(instance.graph)
    answer = solve_from(instance.graph, wound)
    assert honest(answer, problem)
    assert answer.cost <= problem.cost(wound)


def test_a_laplacian_that_cannot_be_factorized_is_no_end():
    graph = RotationGraph(
        3, np.array([[0, 1], [1, 2]]), np.tile(np.eye(3), (2, 1, 1)), np.array([1e-9, 1e8])
    )
    assert solve(graph).verdict is Verdict.CERTIFIED


@pytest.mark.parametrize(
    ("name", "factorizations", "products"),
    [
        ("parking-garage", 5, 9),
        ("sphere2500", 4, 5),
        ("torus3D", 4, 5),
        ("sphere_bignoise_vertex3", 3, 6),
        ("cubicle", 4, 5),
        ("city10000", 3, 4),
        ("manhattan", 3, 2),
        ("ais2klinik", 8, 4),
    ],
)
def test_the_work_stays_small(name, factorizations, products, dataset):
    counts = solve(dataset(name), cost="chordal").solution.counts
    assert counts["factorizations"] <= factorizations
    assert counts.get("products", 0) <= products
    assert counts["nonzeros"] > 0


def test_what_is_no_graph_is_refused():
    with pytest.raises(InputError, match="a graph, a problem, an instance or a path, not an int"):
        solve(2500)


@pytest.mark.skipif(
    "multifrontal" not in factor.engines(), reason="rounding of SuperLU is missing, too"
)
@pytest.mark.usefixtures("shifts_alone")
def test_the_proof_tier_is_asked_where_rounding_is_all_that_is_missing():
    graph = corridor(400, np.random.default_rng(0)).graph
    answer = solve(graph, atol=1e-13)
    assert (answer.verdict, answer.certificate.tier) == (Verdict.CERTIFIED, Tier.PROOF)
    standard = certify(Quadratic(graph), answer.estimate, atol=1e-13)
    assert standard.verdict is Verdict.BOUNDED
    assert standard.lower_bound < answer.certificate.lower_bound <= answer.cost
    assert "prove" in answer.solution.seconds
    loose = solve(graph, rtol=0.1)
    assert (loose.verdict, loose.certificate.tier) == (Verdict.CERTIFIED, Tier.STANDARD)


def test_a_search_stopped_before_its_proof_claims_none():
    """The standard tier certifies, and then the time is up: that is no proof."""
    instance, _ = winding_cycle(6, 0.3, 0)
    problem = Quadratic(instance.graph)
    normalized = NormalizedProblem.of(problem, Tier.STANDARD, 1e-5, 1e-12)
    search = Search(plans.CHORDAL, problem, normalized, SolveSettings(tier=Tier.STANDARD))
    search.begin(None)
    assert search.is_certified
    search.stop.deadline = -math.inf
    assert endings.certificate(search).verdict is Verdict.CERTIFIED
    search.tier = Tier.PROOF
    stopped = endings.certificate(search)
    assert (stopped.verdict, stopped.tier) == (Verdict.UNDECIDED, Tier.PROOF)
    assert stopped.lower_bound == 0.0


@pytest.mark.parametrize("tier", ["screen", "standard", "proof", Tier.PROOF])
def test_every_tier_can_be_asked_for(tier):
    instance, _ = winding_cycle(9, 0.3, 0)
    answer = solve(instance.graph, tier=tier)
    assert answer.certificate.tier is Tier(tier)
    verdict = Verdict.BOUNDED if tier == "screen" else Verdict.CERTIFIED
    assert answer.verdict is verdict


def test_settings_are_in_the_answer_and_can_be_given_one_by_one():
    graph = winding_cycle(6, 0.3, 0)[0].graph
    settings = SolveSettings(time_limit=100.0, newton=NewtonSettings(tolerance=1e-9))
    answer = solve(graph, settings, max_rank=5)
    assert answer.settings == replace(settings, max_rank=5)
    assert solve(graph).settings == SolveSettings()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"time_limit": -1.0}, InputError, "time limit must not be negative"),
        ({"patience": math.nan}, SpecError, "patience must not be negative"),
        ({"rounds": 0}, SpecError, "rounds must be positive"),
        ({"same_cost": 1.0}, SpecError, "same_cost must lie between 0 and 1"),
        ({"time_limits": 1.0}, SpecError, "unknown setting of solve 'time_limits'; did you mean"),
        ({"max_rank": 1}, InputError, "maximal rank must be at least 3"),
        ({"max_rank": 0}, InputError, "maximal rank must be at least 1, not 0"),
        ({"max_rank": 5.5}, SpecError, "max_rank must be an integer or None, not 5.5"),
        ({"max_rank": True}, SpecError, "max_rank must be an integer or None, not True"),
        ({"tier": "proofs"}, SpecError, "did you mean proof"),
        ({"tier": 3}, SpecError, "unknown tier '3'; known: proof, screen, standard"),
        ({"lifted_tolerance": math.inf}, SpecError, "lifted_tolerance must be finite"),
        ({"rank_steps": 2.5}, SpecError, "rank_steps must be an integer, not 2.5"),
        ({"try_own_start": "no"}, SpecError, "try_own_start must be True or False, not 'no'"),
        ({"newton": None}, SpecError, "newton must be of type NewtonSettings, not None"),
        ({"newton": {}}, SpecError, "newton must be of type NewtonSettings, not {}"),
        ({"hope": "far"}, SpecError, "hope must be a number, not 'far'"),
    ],
)
def test_settings_out_of_range_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        solve(winding_cycle(6, 0.3, 0)[0].graph, **options)


def test_settings_are_refused_where_they_are_made():
    with pytest.raises(SpecError, match="unknown tier 'bogus'"):
        SolveSettings(tier="bogus")
    for field in fields(SolveSettings):
        if "float" in field.type:
            with pytest.raises((InputError, SpecError)):
                SolveSettings(**{field.name: math.nan})


def test_low_rank_optimization_has_the_forcing_terms_of_the_settings(monkeypatch):
    asked, descend = [], low_rank.descend

    def noted(*args, **options):
        asked.append({key: options[key] for key in ("tolerance", "loosest", "tightest")})
        return descend(*args, **options)

    monkeypatch.setattr(low_rank, "descend", noted)
    instance, wound = winding_cycle(9, 0.3, 1)
    own = NewtonSettings(tolerance=1e-3, loosest=1e-3, tightest=1e-5)
    answer = solve_from(instance.graph, wound, newton=own)
    assert len(answer.levels) > 1
    assert asked[0] == {"tolerance": 1e-3, "loosest": 1e-3, "tightest": 1e-5}


@pytest.mark.parametrize("seed", [11, 15, 102, 537])
@pytest.mark.parametrize("order", [0, 1])
def test_bounds_reach_the_relaxation_where_bridges_join_parts(seed, order):
    """Also where a tight bound succeeds in some parts only, which depends on rounding."""
    graph, _, _ = pose_graph(rng_of(seed), 10, 2, noise=1.5, extra=3)
    if order:
        graph = graph.with_edges(rng_of(seed).permutation(graph.num_edges))
    answer = solve(graph)
    lowest = min(level.cost for level in answer.levels)
    assert answer.certificate.lower_bound == pytest.approx(lowest, rel=1e-6)

"""What a judge of many estimates keeps, and what it does where eigenvectors fail."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from strategies import pose_graph, rng_of

from certpgo import certify
from certpgo.certify import Tier, Verdict
from certpgo.certify.units import unit_of
from certpgo.certify.wording import meaning
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.ranges import Ranges
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum, objective_of
from certpgo.objective.costs.g2o import G2oCost
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.riemannian_newton import newton
from certpgo.optimize.solution import Status
from certpgo.solve import bounding, judging
from certpgo.solve.judging import Judge


def noisy_cycle(n=20, noise=0.05):
    """A cycle of noisy measurements: its best estimate, and where it is wound up once."""
    instance, wound = winding_cycle(n, 0.3, 1)
    turns = so.exp(noise * rng_of(0).standard_normal((n, 3)))
    graph = RotationGraph(n, instance.graph.edges, instance.graph.rotations @ turns, np.ones(n))
    problem = Quadratic(graph)
    return problem, *(newton(problem, x).estimate for x in (instance.truth, wound))


def test_the_better_estimate_from_eigenvectors_is_improved_until_it_is_stationary():
    problem, best, wound = noisy_cycle()
    certificate = certify(problem, wound)
    assert certificate.verdict is Verdict.REFUTED
    assert problem.stationarity(certificate.better) < 1e-9
    assert certificate.better_cost == pytest.approx(problem.cost(best), rel=1e-9)


@pytest.mark.parametrize("tier", [Tier.STANDARD, Tier.PROOF])
def test_the_best_bound_so_far_serves_every_later_estimate(tier):
    problem, best, wound = noisy_cycle()
    best = best.moved(so.random(rng_of(1), 1, 3)[0])
    judge_of = Judge(problem, tier=tier)
    first = judge_of.certify(best)
    assert first.verdict is Verdict.CERTIFIED
    for estimate in (wound, wound, best, wound):
        later = judge_of.certify(estimate)
        assert later.lower_bound == first.lower_bound
        if estimate is wound:
            assert later.verdict is Verdict.REFUTED
            np.testing.assert_array_equal(later.better.rotations, first.refined.rotations)


def failing(*_):
    raise NumericalError("by design")


def test_where_eigenvectors_fail_descent_starts_at_identities(monkeypatch):
    problem, best, wound = noisy_cycle()
    monkeypatch.setattr(spectral, "spectral_start", failing)
    certificate = certify(problem, wound)
    assert certificate.verdict is Verdict.REFUTED
    start = Estimate(np.tile(np.eye(3), (20, 1, 1)))
    assert certificate.better_cost == pytest.approx(newton(problem, start).cost, rel=1e-12)
    assert certificate.better_cost == pytest.approx(problem.cost(best), rel=1e-9)


def test_bounds_that_cannot_be_computed_are_left_out(monkeypatch):
    problem, best, _ = noisy_cycle()
    assert certify(problem, best).bounds is None  # not asked for
    assert certify(problem, best, angles=True).bounds is not None
    monkeypatch.setattr(judging, "bounds", failing)
    certificate = certify(problem, best, angles=True)
    assert certificate.bounds is None
    assert certificate.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("options", [{"time_limit": 0.0}, {"monitor": lambda _: True}])
def test_work_that_is_stopped_claims_no_more_than_was_proven(options):
    problem, best, wound = noisy_cycle()
    stopped = certify(problem, wound, **options)
    assert (stopped.verdict, stopped.lower_bound) == (Verdict.UNDECIDED, 0.0)
    how = "time limit" if "time_limit" in options else "interrupted"
    assert stopped.reason.endswith(f"the search for a bound ended early ({how})")
    assert stopped.cost_upper == certify(problem, wound).cost_upper
    assert "ended early" not in certify(problem, best, time_limit=60.0).reason


def test_each_estimate_has_the_time_limit_of_its_own():
    problem, best, wound = noisy_cycle()
    asked = iter([True])
    judge_of = Judge(problem, monitor=lambda _: next(asked, False))
    assert judge_of.certify(wound).verdict is Verdict.UNDECIDED
    assert judge_of.interrupted
    assert judge_of.certify(wound).verdict is Verdict.REFUTED
    assert not judge_of.interrupted
    assert judge_of.certify(best).verdict is Verdict.CERTIFIED


def test_a_bound_that_is_known_serves_work_that_is_stopped():
    problem, best, wound = noisy_cycle()
    stops = iter([False] * 1000)
    judge_of = Judge(problem, monitor=lambda _: next(stops))
    first = judge_of.certify(best)
    stops = iter([True] * 1000)
    again = judge_of.certify(best)
    assert (again.verdict, again.lower_bound) == (Verdict.CERTIFIED, first.lower_bound)
    assert judge_of.certify(wound).lower_bound == first.lower_bound
    assert judge_of.ended_by is Status.INTERRUPTED


def test_a_search_of_distances_that_was_stopped_is_not_kept():
    rng = rng_of(0)
    graph, _, t = pose_graph(rng, 8, 2, noise=0.05)
    pairs = np.array([rng.choice(8, 2, replace=False) for _ in range(30)])
    distances = np.abs(np.linalg.norm(np.diff(t[pairs], axis=1)[:, 0], axis=1) + rng.normal(30))
    problem = objective_of(graph.with_ranges(Ranges(8, pairs, distances, np.ones(30))))
    bad = Estimate(so.random(rng, 8, 2), 10.0 * rng.standard_normal((8, 2)))
    steps = []
    whole = certify(problem, bad, monitor=lambda step: steps.append(step) or False)
    left = iter(range(int(0.7 * len(steps)), -1, -1))
    judge_of = Judge(problem, monitor=lambda _: next(left, 1) == 0)
    judge_of.certify(bad)
    assert judge_of.ended_by is Status.INTERRUPTED
    assert judge_of.certify(bad).lower_bound == pytest.approx(whole.lower_bound, rel=1e-9)
    assert judge_of.ended_by is None


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_ctrl_c_is_left_to_programs_unless_asked_for():
    problem, _, wound = noisy_cycle()

    def press(_):
        os.kill(os.getpid(), signal.SIGINT)
        return False

    with pytest.raises(KeyboardInterrupt):
        certify(problem, wound, monitor=press)
    judge_of = Judge(problem, monitor=once(press), ctrl_c=True)
    assert judge_of.certify(wound).verdict is Verdict.UNDECIDED
    assert judge_of.interrupted


def once(function):
    """The function for the first call; False after it."""
    left = iter([function])
    return lambda step: next(left, lambda _: False)(step)


@pytest.mark.parametrize("limit", [-1.0, np.nan])
def test_time_limits_are_not_negative(limit):
    problem, best, _ = noisy_cycle()
    with pytest.raises(InputError, match="time limit"):
        certify(problem, best, time_limit=limit)


def test_of_two_basins_the_lower_is_worth_a_climb(monkeypatch):
    instance, wound = winding_cycle(9, 0.3, 1)
    graph = PoseGraph(instance.graph, np.zeros((9, 3)), np.ones(9))
    problem = Sum(graph.with_information(np.tile(np.eye(6), (9, 1, 1))), G2oCost)
    far = Estimate(wound.rotations, np.zeros((9, 3)))
    raised = []
    keep = bounding.raised
    monkeypatch.setattr(
        bounding, "raised", lambda of, basin: raised.append(basin.cost) or keep(of, basin)
    )
    certificate = certify(problem, far)
    assert raised == []  # the other basin is certified without
    assert certificate.verdict is Verdict.REFUTED
    assert certificate.proves_optimal(certificate.best_cost)
    assert not certificate.proves_optimal(2.0 * certificate.best_cost)
    assert not replace(certificate, tier=Tier.SCREEN).proves_optimal(certificate.best_cost)
    # Without any bounds at the points themselves, the lower one is climbed from.
    monkeypatch.setattr(bounding, "bound_near", lambda *_, **__: None)
    certified = certify(problem, far)
    assert raised == [pytest.approx(certificate.best_cost / unit_of(problem), rel=1e-6)]
    assert certified.proves_optimal(certified.best_cost)
    # Both basins are climbed from if the first gives nothing, the known one once.
    raised.clear()
    monkeypatch.setattr(bounding, "raised", lambda of, basin: raised.append(basin) or basin)
    judge_of = Judge(problem)
    assert [judge_of.certify(far).lower_bound for _ in range(2)] == [0.0, 0.0]
    assert len(raised) == 3
    monkeypatch.setattr(bounding, "raised", failing)
    assert certify(problem, far).lower_bound == 0.0


def test_costs_beyond_the_range_of_doubles_have_no_bounds():
    graph, R, t = pose_graph(rng_of(0), 5, 3)
    problem = Sum(graph.with_information(np.tile(np.eye(6), (graph.num_edges, 1, 1))), G2oCost)
    with np.errstate(over="ignore", invalid="ignore"):
        for scale in (5.6e152, 1e154):  # the sum, and already its terms
            assert problem.enclosure(Estimate(R, scale * t))[1] == np.inf


def test_estimates_of_other_graphs_are_not_judged():
    problem, best, _ = noisy_cycle()
    with pytest.raises(InputError, match="19 nodes"):
        Judge(problem).certify(best.subset(np.arange(19)))


def long_descent(seed=0, n=30):
    """Poses under g2o's cost, and an estimate whose descent takes more than a few steps."""
    graph, R, t = pose_graph(rng_of(seed), n, 3, noise=0.05)
    problem = Sum(graph.with_information(np.tile(np.eye(6), (graph.num_edges, 1, 1))), G2oCost)
    rng = rng_of(seed + 1)
    far = Estimate(
        R @ so.exp(0.7 * rng.standard_normal((n, 3))), t + 3.0 * rng.standard_normal(t.shape)
    )
    return problem, far


def test_a_descent_that_cannot_reach_a_proven_optimum_is_given_up(monkeypatch):
    problem, far = long_descent()
    monkeypatch.setattr(judging, "FEW", 1)
    whole = certify(problem, far)
    assert whole.settled
    assert (whole.verdict, whole.basin_is_global) == (Verdict.BOUNDED, True)
    monkeypatch.setattr(judging, "HOPE", 0.0)
    monkeypatch.setattr(judging, "RECENT", 1)
    given_up = certify(problem, far)
    assert (given_up.verdict, given_up.settled) == (Verdict.REFUTED, False)
    assert "was given up far from it" in meaning(given_up)
    assert given_up.better_cost == pytest.approx(whole.refined_cost, rel=1e-9)
    assert given_up.lower_bound == pytest.approx(whole.lower_bound, rel=1e-6)
    assert "was given up far from it" in given_up.reason
    assert "part of a local descent" in str(given_up)


@pytest.mark.parametrize("seed", [229, 3901])
def test_a_descent_that_rests_at_a_saddle_is_not_given_up(seed):
    """One step there wins next to nothing; those after it lead to the optimum."""
    graph, _, _ = pose_graph(rng_of(seed), 20, 3, noise=0.05, extra=10 if seed == 229 else 6)
    problem = Quadratic(graph)
    far = problem.complete(so.random(rng_of(seed + 1), 20, 3))
    judged = certify(problem, far)
    assert (judged.verdict, judged.basin_is_global) == (Verdict.BOUNDED, True)


def test_a_descent_that_is_stopped_refutes_nothing(monkeypatch):
    problem, far = long_descent()
    monkeypatch.setattr(judging, "FEW", 1)
    stopped = certify(problem, far, monitor=lambda step: step.number >= 3)
    assert stopped.verdict is not Verdict.REFUTED

"""What a judge of many estimates keeps, and what it does where eigenvectors fail."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import rng_of

from certpgo.certify import Tier, Verdict, certify, judge
from certpgo.certify.judge import Judge
from certpgo.certify.own_cost import OwnCostCase
from certpgo.certify.units import unit_of
from certpgo.costs import InformationProblem
from certpgo.costs.g2o import G2oCost
from certpgo.datasets.synthetic import winding_cycle
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import InformationGraph
from certpgo.linalg import so
from certpgo.objective.problem import RotationProblem
from certpgo.optimize import spectral
from certpgo.optimize.newton import newton


def noisy_cycle(n=20, noise=0.05):
    """A cycle of noisy measurements: its best estimate, and where it is wound up once."""
    instance, wound = winding_cycle(n, 0.3, 1)
    turns = so.exp(noise * rng_of(0).standard_normal((n, 3)))
    graph = RotationGraph(n, instance.graph.edges, instance.graph.rotations @ turns, np.ones(n))
    problem = RotationProblem(graph)
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
    assert certify(problem, best).bounds is not None
    monkeypatch.setattr(judge, "bounds", failing)
    certificate = certify(problem, best)
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


def test_each_estimate_has_the_time_limit_of_its_own(monkeypatch):
    problem, best, wound = noisy_cycle()
    asked = iter([True])
    judge_of = Judge(problem, monitor=lambda _: next(asked, False))
    assert judge_of.certify(wound).verdict is Verdict.UNDECIDED
    assert judge_of.interrupted
    assert judge_of.certify(wound).verdict is Verdict.REFUTED
    assert not judge_of.interrupted
    assert judge_of.certify(best).verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("limit", [-1.0, np.nan])
def test_time_limits_are_not_negative(limit):
    problem, best, _ = noisy_cycle()
    with pytest.raises(InputError, match="time limit"):
        certify(problem, best, time_limit=limit)


def test_of_two_basins_the_lower_is_worth_a_climb(monkeypatch):
    instance, wound = winding_cycle(9, 0.3, 1)
    graph = PoseGraph(instance.graph, np.zeros((9, 3)), np.ones(9))
    problem = InformationProblem(G2oCost(InformationGraph(graph, np.tile(np.eye(6), (9, 1, 1)))))
    far = Estimate(wound.rotations, np.zeros((9, 3)))
    raised = []
    keep = OwnCostCase.raised
    monkeypatch.setattr(
        OwnCostCase, "raised", lambda case, basin: raised.append(basin.cost) or keep(case, basin)
    )
    certificate = certify(problem, far)
    assert raised == []  # the other basin is certified without
    assert certificate.verdict is Verdict.REFUTED
    assert certificate.is_optimal(certificate.best_cost)
    assert not certificate.is_optimal(2.0 * certificate.best_cost)
    assert not replace(certificate, tier=Tier.SCREEN).is_optimal(certificate.best_cost)
    # Without any bounds at the points themselves, the lower one is climbed from.
    monkeypatch.setattr(OwnCostCase, "bound", lambda *_, **__: None)
    certified = certify(problem, far)
    assert raised == [pytest.approx(certificate.best_cost / unit_of(problem), rel=1e-6)]
    assert certified.is_optimal(certified.best_cost)


def test_estimates_of_other_graphs_are_not_judged():
    problem, best, _ = noisy_cycle()
    with pytest.raises(InputError, match="19 nodes"):
        Judge(problem).certify(best.subset(np.arange(19)))

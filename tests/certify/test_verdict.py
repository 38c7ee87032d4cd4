"""The verdict from basins made by hand, tolerances, and the sentence that says why."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import pose_graph

from certpgo.certify import Tier, Verdict
from certpgo.certify import bound as module
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import FLOOR, difference_up
from certpgo.certify.verdict import verdict as verdict_on
from certpgo.certify.wording import reason_of
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.bounding import bound_near
from certpgo.solve.minima import local_minimum

positive = st.floats(min_value=1e-300, max_value=1e300)


@given(positive, positive)
def test_differences_are_rounded_up_by_at_most_a_unit(high, low):
    difference = Fraction(high) - Fraction(low)
    up = difference_up(high, low)
    assert Fraction(math.nextafter(up, -math.inf)) < difference <= Fraction(up)


def test_a_difference_that_rounds_down_is_the_next_double():
    assert difference_up(1.0 + 2.0**-52, 3.0 * 2.0**-54) == 1.0 + 2.0**-52
    assert difference_up(math.inf, 1.0) == math.inf


def case_of_a_triangle(tier=Tier.STANDARD, rtol=0.5, atol=0.0, scale=1.0):
    instance, wound = winding_cycle(3, 0.5, 1)
    problem = Quadratic(instance.graph.with_weights(scale))
    return NormalizedProblem.of(problem, tier, rtol, atol), instance.truth, wound


@pytest.mark.parametrize(
    ("rtol", "atol", "fits"),
    [
        (0.0, 0.0, True),
        (1.0 - 2.0**-53, 1.0 - 2.0**-53, True),
        (1.0, 0.0, False),
        (0.0, 1.0, False),
        (-1e-300, 0.0, False),
        (0.0, -1e-300, False),
        (math.nan, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_tolerances_are_shares(rtol, atol, fits):
    if fits:
        case, _, _ = case_of_a_triangle(rtol=rtol, atol=atol)
        assert (case.rtol, case.atol) == (rtol, atol)
    else:
        with pytest.raises(InputError, match=r"within 0 \.\.\. 1"):
            case_of_a_triangle(rtol=rtol, atol=atol)


@pytest.mark.parametrize("scale", [0.45, 1.0, 3.3e-9, 7e20])
def test_tolerances_are_those_of_the_problem_in_its_own_units(scale):
    """rtol F + atol W, of which differences between points that are optimal take a millionth.

    No part of W is more than a thousandth of F.
    """
    case, _, _ = case_of_a_triangle(rtol=2.0**-10, atol=2.0**-5, scale=scale)
    W = 3.0 * scale
    assert case.problem.scale * case.unit == pytest.approx(W, rel=1e-14)
    for F in (0.0, W, 100.0 * W):
        tolerance = case.unit * case.tolerance(F / case.unit)
        assert tolerance == pytest.approx(2.0**-10 * F + min(2.0**-5 * W, 1e-3 * F), rel=1e-14)
        difference = case.unit * case.difference(F / case.unit)
        assert difference == pytest.approx(
            2.0**-10 * F + min(FLOOR * 2.0**-5 * W, 1e-3 * F), rel=1e-14
        )


def basin(case, point, *, cost=None, value=None, settled=True):
    """A basin of this cost and bound, as if descent and a factorization had found them."""
    bound = None
    if value is not None:
        bound = DualBound(value, np.zeros((case.problem.n, 3, 3)), case.problem, 0.0, 1, 1)
    return LocalMinimum(point, case.cost_upper(point) if cost is None else cost, settled, bound)


def test_a_basin_is_sharp_where_nothing_better_can_be_told_from_it():
    case, right, _ = case_of_a_triangle(rtol=0.25)
    for value, sharp in ((4.0, True), (3.0, True), (2.999, False), (None, False)):
        assert case.is_sharp(basin(case, right, cost=4.0, value=value)) is sharp


def test_bounds_are_never_negative():
    case, right, _ = case_of_a_triangle()
    for value, expected in ((-1.0, 0.0), (None, 0.0), (0.25, 0.25)):
        assert basin(case, right, value=value).value == expected


@pytest.mark.parametrize(
    ("share", "tier", "verdict"),
    [
        (0.5, Tier.STANDARD, Verdict.CERTIFIED),
        (0.5 - 1e-9, Tier.STANDARD, Verdict.BOUNDED),
        (1e-6, Tier.STANDARD, Verdict.BOUNDED),
        (0.0, Tier.STANDARD, Verdict.UNDECIDED),
        (None, Tier.STANDARD, Verdict.UNDECIDED),
        (0.5, Tier.SCREEN, Verdict.BOUNDED),
        (0.0, Tier.SCREEN, Verdict.UNDECIDED),
    ],
)
def test_certified_is_a_gap_up_to_the_tolerance(share, tier, verdict):
    """Of an estimate in its own basin, with a bound of this share of its cost; rtol is a half."""
    case, _, wound = case_of_a_triangle(tier)
    own = basin(case, wound, value=None if share is None else share * case.cost_upper(wound))
    judged = verdict_on(case, wound, own)
    assert judged.verdict is verdict
    assert judged.basin_is_global is (verdict is Verdict.CERTIFIED)
    assert judged.gap == judged.cost_upper - judged.lower_bound
    assert judged.cost_upper == own.cost * case.unit
    assert judged.lower_bound == (share or 0.0) * judged.cost_upper
    assert (judged.multipliers is None) is (share is None)


def test_a_bound_above_the_cost_is_a_fault_and_no_verdict():
    case, _, wound = case_of_a_triangle()
    above = basin(case, wound, value=1.001 * case.cost_upper(wound))
    with pytest.raises(NumericalError, match="a bound above the cost"):
        verdict_on(case, wound, above)
    screened, _, wound = case_of_a_triangle(Tier.SCREEN)
    assert verdict_on(screened, wound, above).verdict is Verdict.BOUNDED


def test_another_basin_refutes_where_it_is_better_than_the_estimates_own():
    case, right, wound = case_of_a_triangle(rtol=1e-3)
    cost = case.cost_upper(wound)
    for settled, other_cost, refuted, better in (
        (True, 0.5 * cost, True, True),
        (False, 0.5 * cost, False, True),
        (True, (1.0 - 0.5e-3) * cost, False, False),
        (True, 2.0 * cost, False, False),
    ):
        own = basin(case, wound, settled=settled)
        other = basin(case, right, cost=other_cost, value=0.25 * cost)
        judged = verdict_on(case, wound, own, other)
        assert judged.verdict is (Verdict.REFUTED if refuted else Verdict.BOUNDED)
        assert judged.better_cost == (other_cost * case.unit if better else None)
        assert (judged.better is right) is better
        assert judged.lower_bound == 0.25 * judged.cost_upper  # the better of the two bounds


def test_a_point_that_is_worse_than_the_improved_estimate_is_no_better_one():
    """Halfway down from an estimate to where descent leads."""
    case, right, wound = case_of_a_triangle(rtol=1e-3)
    cost = case.cost_upper(wound)
    own = basin(case, right, cost=0.25 * cost)
    judged = verdict_on(case, wound, own, basin(case, wound, cost=0.5 * cost))
    assert (judged.better, judged.better_cost) == (None, None)


def test_the_larger_of_two_bounds_counts():
    case, _, wound = case_of_a_triangle(rtol=1e-3)
    cost = case.cost_upper(wound)
    own, other = (basin(case, wound, value=share * cost) for share in (0.5, 0.25))
    assert verdict_on(case, wound, own, other).lower_bound == 0.5 * cost * case.unit
    assert verdict_on(case, wound, other, own).lower_bound == 0.5 * cost * case.unit


def test_unrefined_estimates_are_judged_by_their_own_multipliers():
    rng = np.random.default_rng(0)
    graph, R, t = pose_graph(rng, 8, 3)
    case = NormalizedProblem.of(Quadratic(graph), Tier.STANDARD, 1e-5, 1e-12)
    start = Estimate(R @ so.exp(0.01 * rng.standard_normal((8, 3))), t)
    given = local_minimum(case, start, refine=False)
    np.testing.assert_array_equal(given.point.rotations, start.rotations)
    assert given.cost < case.cost_upper(start)  # its translations are the best ones
    assert given.value < local_minimum(case, start).value
    assert given.settled


@pytest.mark.parametrize("tier", [Tier.SCREEN, Tier.STANDARD])
def test_only_screening_trusts_a_factorization_as_it_is(tier):
    case, right, _ = case_of_a_triangle(tier)
    assert (local_minimum(case, right).bound.nonzeros == 0) is (tier is Tier.SCREEN)


def test_a_bound_is_enough_where_it_certifies_what_it_is_asked_for(monkeypatch):
    case, right, _ = case_of_a_triangle(rtol=0.25, atol=2.0**-10)
    asked = []
    monkeypatch.setattr(module, "dual_bound", lambda *_, enough, **__: asked.append(enough))
    bound_near(case, right, 8.0)
    assert asked == [8.0 - case.difference(8.0)]  # no part of W makes up for a gap


# --- The sentence


def made(**changes):
    """A certificate with the numbers that its reason speaks of."""
    case, right, _ = case_of_a_triangle(rtol=1e-5, atol=1e-12)
    plain = verdict_on(case, right, basin(case, right, value=0.0))
    numbers = {"cost_upper": 8.0, "refined_cost": 8.0, "lower_bound": 6.0, "gap": 2.0, "scale": 1e3}
    bounded = replace(plain, verdict=Verdict.BOUNDED, basin_is_global=False, **numbers)
    return replace(bounded, **changes)


FLOOR_6 = "no estimate of this graph costs less than 6"
ABOVE = "at most 2 (25 % of the cost) above the optimum"
DESCENDED = "this one costs 8, after local descent 7"
MOVED = "this one costs 8, with its best translations 7"
SMALL = "which is negligible against the total weight W = 1e+03"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, f"{FLOOR_6}; this one costs 8, {ABOVE}"),
        (
            {"tier": Tier.SCREEN},
            f"probably, though this tier proves nothing, {FLOOR_6}; this one costs 8, {ABOVE}",
        ),
        (
            {"gap": 0.004},
            f"{FLOOR_6}; this one costs 8, at most 0.00401 (5.01e-04 of the cost) above the "
            "optimum",
        ),
        ({"cost_upper": math.inf}, "the cost of this estimate is beyond the range of doubles"),
        (
            {"verdict": Verdict.UNDECIDED, "lower_bound": 0.0},
            "this one costs 8; no lower bound above zero could be proven",
        ),
        (
            {"refined_cost": 7.0},
            f"{FLOOR_6}; {DESCENDED}, so the optimum is at most that",
        ),
        (
            {"refined_cost": 7.0, "basin_is_global": True},
            f"{FLOOR_6}; right basin: {DESCENDED}, the optimum",
        ),
        (
            {"refined_cost": 7.0, "descended": False},
            f"{FLOOR_6}; {MOVED}, so the optimum is at most that",
        ),
        (
            {"refined_cost": 7.0, "basin_is_global": True, "descended": False},
            f"{FLOOR_6}; right basin: {MOVED}, the optimum",
        ),
        (
            {"gap": 8.0, "lower_bound": 6.0},
            f"{FLOOR_6}; this one costs 8, at most 8 (100 % of the cost) above the optimum",
        ),
        (
            {"verdict": Verdict.REFUTED, "better_cost": 6.5},
            "another estimate costs 6.5; this one costs 8, and local descent from it does not lead "
            f"there; {FLOOR_6}",
        ),
        (
            {"verdict": Verdict.REFUTED, "better_cost": 6.5, "refined_cost": 7.0},
            f"another estimate costs 6.5; {DESCENDED}, and local descent from it does not lead "
            f"there; {FLOOR_6}",
        ),
        (
            {"better_cost": 6.5, "refined_cost": 7.0},
            f"{FLOOR_6}; {DESCENDED}; another estimate costs 6.5",
        ),
        ({"better_cost": 6.5}, f"{FLOOR_6}; this one costs 8; another estimate costs 6.5"),
        (
            {"verdict": Verdict.CERTIFIED, "gap": 8e-6},
            f"{FLOOR_6}; this one costs 8, at most 8e-06 (1.00e-06 of the cost) above the optimum",
        ),
        (
            {"verdict": Verdict.CERTIFIED, "gap": 0.004, "atol": 1e-5},
            f"{FLOOR_6}; this one costs 8, at most 0.00401 (5.01e-04 of the cost) above the "
            f"optimum, {SMALL}",
        ),
        (
            {"verdict": Verdict.CERTIFIED, "rounding": 8.0},
            f"{FLOOR_6}; this one costs 8, and every measurement is met up to rounding",
        ),
        (
            {"verdict": Verdict.CERTIFIED, "cost_upper": 0.5, "gap": 5e-7},
            f"{FLOOR_6}; this one costs 0.5, at most 5e-07 (1.00e-06 of the cost) above the "
            "optimum",
        ),
        (
            {"verdict": Verdict.CERTIFIED, "cost_upper": 0.0, "gap": 0.0},
            f"{FLOOR_6}; this one costs 0, at most 0 above the optimum",
        ),
    ],
)
def test_the_reason_is_a_sentence_of_the_numbers(changes, expected):
    assert reason_of(made(**changes)) == expected


def test_what_improves_by_no_more_than_the_tolerance_is_not_said_to():
    for refined, improved in ((7.5, False), (7.0, True)):
        said = reason_of(made(refined_cost=refined, rtol=0.1, atol=0.0))
        assert ("after local descent" in said) is improved

"""The lesson on certifying an answer of GTSAM, with GTSAM and with what stands in for it."""

import sys
from functools import cache

import pytest

VERDICTS = {
    "isotropic weights": "CERTIFIED",
    "full information": "BOUNDED",
    "stopped early": "BOUNDED",
    "wound up": "REFUTED",
    "wound up, refine=False": "UNDECIDED",
}
OPTIMUM = 382.398685920


@cache
def without_gtsam(run):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "gtsam", None)
        return run.__wrapped__("certify_my_slam_result")


@pytest.fixture(params=[pytest.param("gtsam", marks=pytest.mark.gtsam), "stand-in"])
def taught(request, lesson):
    if request.param == "stand-in":
        return without_gtsam(lesson)
    pytest.importorskip("gtsam")
    return lesson("certify_my_slam_result")


def test_each_verdict_has_its_example(taught):
    found = {name: c.verdict.value for name, c in taught["judgements"].items()}
    assert found == VERDICTS


def test_the_lower_bound_is_one_for_all(taught):
    bounded = [c for c in taught["judgements"].values() if c.verdict.value != "UNDECIDED"]
    assert [c.lower_bound for c in bounded] == pytest.approx([OPTIMUM] * 4, rel=1e-8)
    assert taught["judgements"]["wound up, refine=False"].lower_bound == 0.0


def test_the_better_answer_is_near_and_proven(taught):
    review = taught["review"]
    assert review.best_is_optimal
    assert review.best_cost == pytest.approx(OPTIMUM, rel=1e-10)
    assert 0.01 < review.certificate.relative_gap < 0.1
    assert review.distance.worst_deg < 2.0
    assert 0.005 < review.distance.worst_m < 0.1


def test_the_wound_up_map_has_no_edge_to_blame_and_is_left_by_a_restart(taught):
    assert taught["wound"].edges[0].share < 0.05
    assert taught["wound"].excess > 0.9 * taught["wound"].certificate.cost_upper
    assert taught["judged"](taught["again"]).verdict.value == "BOUNDED"


def test_proof_and_command_line(taught):
    assert taught["checked"].lower <= OPTIMUM * (1.0 + 1e-11) <= taught["checked"].upper * 1.0001
    assert taught["checked"].relative_gap < 1e-8
    assert "SHA-256 differs" in taught["refused"]
    assert taught["codes"] == [3, 0, 0]


def test_exercises(taught):
    verdicts = [taught["rounded"][decimals].verdict.value for decimals in (1, 2, 3, 4)]
    assert verdicts == ["BOUNDED", "BOUNDED", "BOUNDED", "CERTIFIED"]
    assert taught["biased"][-360].verdict.value == "REFUTED"
    wound_up = taught["judgements"]["wound up"].cost_upper
    times = 1.0 if taught["gtsam"] is None else 3.06
    assert taught["biased"][-360].cost_upper == pytest.approx(times * wound_up, rel=1e-2)
    assert taught["biased"][120].verdict.value == "BOUNDED"


@pytest.mark.gtsam
def test_each_answer_is_better_by_its_own_measure(lesson):
    pytest.importorskip("gtsam")
    taught = lesson("certify_my_slam_result")
    own, other = (taught["factors"].error(taught[name]) for name in ("answer", "best_values"))
    assert own == pytest.approx(181.216, rel=1e-4)
    assert other > 1.03 * own

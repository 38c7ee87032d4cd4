"""The lesson on other costs: on MIT where the file is, else on a simulated drive."""

import pytest

NAME = "certify_the_cost_you_minimise"


@pytest.fixture
def taught(lesson):
    return lesson(NAME)


def test_the_minorant_by_hand_is_the_package_s(taught):
    assert abs(taught["touching"]) < 1e-14
    assert taught["margin"] > 0.0
    assert taught["kappa"] == pytest.approx(taught["again"][2], rel=1e-12)
    assert -1e-11 < taught["rounded"] < 1e-13  # below what is exact


def test_the_best_chordal_estimate_is_a_bad_one(taught):
    assert taught["times_best"] > 50.0
    if "instance" in taught:
        assert taught["f"] == pytest.approx(41.16326884, rel=1e-9)


def test_the_surrogate_touches_and_certifies(taught):
    assert taught["minorised"] == pytest.approx(taught["f"], rel=1e-8)
    assert abs(taught["spectrum"][:3]).max() < 1e-13 < taught["spectrum"][3]
    certificate = taught["certificate"]
    assert certificate.verdict.value == "CERTIFIED"
    assert certificate.relative_gap < 1e-7
    assert "EdgeSE2" in certificate.objective


def test_the_wrong_optimum_touches_and_is_refuted(taught):
    there, wrong = taught["there"], taught["wrong"]
    cost = taught["problem"].cost(wrong)
    assert there.problem.cost(wrong) + there.constant == pytest.approx(cost, rel=1e-6)
    assert cost > 10.0 * taught["f"]
    assert taught["wrong_spectrum"][0] < -1e-6
    assert taught["refuted"].verdict.value == "REFUTED"
    assert taught["alone"].verdict.value != "CERTIFIED"


def test_condition_and_noise_limit_it(taught):
    for (_, noise, condition), found in taught["limits"].items():
        if condition <= 10.0:
            assert found.verdict.value == "CERTIFIED"
        elif noise == max(taught["NOISES"]):
            assert found.verdict.value in ("BOUNDED", "UNDECIDED")


def test_exercises(taught):
    assert taught["loose_bound"] < 0.99 * taught["f"]
    misses = [taught["f"] - bound for bound in taught["after"].values()]
    for near, far in zip(misses[1:], misses, strict=False):
        assert 0.0 < near < 0.1 * far
    assert taught["best_share"] == pytest.approx(0.88, abs=0.011)

"""What *Two valleys, one region* says: two valleys, the theorem, and how far each knows."""

import numpy as np
import pytest


@pytest.fixture
def shown(lesson):
    return lesson("two_valleys")


def test_the_profile_has_both_valleys(shown):
    assert shown["answer"].verdict.value == "CERTIFIED"
    assert shown["profile"](0.0) == pytest.approx(shown["answer"].cost)
    assert shown["profile"](np.pi) == pytest.approx(shown["second"])


def test_the_bound_of_the_theorem_is_nowhere_above_the_profile(shown):
    turns, cost = shown["turns"], shown["answer"].cost
    bound = cost + 8.0 * np.sin(0.5 * turns) ** 2 / shown["g"]
    assert (bound <= shown["profile"](turns) + 1e-9).all()
    assert ((turns / shown["sigma"]) ** 2 > shown["profile"](turns) - cost + 0.1).any()


def test_regions_hold_the_second_valley_where_the_cost_does(shown):
    found = shown["found"]
    assert [holds for _, _, holds in found.values()] == [False] * 4 + [True]
    assert all(local < proven for local, proven, _ in found.values())
    assert found[1.0][0] < 90.0
    assert found[1.0][1] == 180.0
    assert 8.0 / shown["g"] / shown["needed"] == pytest.approx(0.83, abs=0.005)


def test_a_hundredth_of_the_gap_is_a_tenth_of_the_distance(shown):
    gaps, limits = np.array(list(shown["distances"].values())).T
    np.testing.assert_allclose(gaps[:-1] / gaps[1:], 100.0, rtol=0.05)
    np.testing.assert_allclose(limits[:-1] / limits[1:], 10.0, rtol=0.1)

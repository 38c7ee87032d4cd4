"""What *How big is the map?* says: traces of multipliers, units, and what is certified."""

import numpy as np
import pytest


@pytest.fixture
def shown(lesson):
    return lesson("how_big_is_the_map")


def test_a_held_pose_carries_the_whole_cost(shown):
    held = shown["held"]
    traces = np.trace(held.certificate.multipliers, axis1=1, axis2=2)
    assert held.verdict.value == "CERTIFIED"
    assert traces[0] == pytest.approx(held.cost, rel=1e-6)
    assert abs(traces[1:]).max() < 1e-6 * held.cost


def test_the_mean_unit_spreads_it_evenly(shown):
    mean, n = shown["mean"], shown["n"]
    traces = np.trace(mean.certificate.multipliers, axis1=1, axis2=2)
    assert mean.verdict.value == "CERTIFIED"
    assert traces == pytest.approx(mean.cost / n, rel=1e-6)
    assert mean.certificate.lower_bound <= mean.cost


def test_the_held_pose_shrinks_the_map(shown):
    truth = shown["with_scales"].scales
    off = {name: np.log(shown[name].estimate.scales / truth) for name in ("held", "mean")}
    assert off["held"].mean() < -np.std(off["mean"])
    assert np.std(off["held"]) > np.std(off["mean"])


def test_a_held_camera_shrinks_the_others_the_more_the_noise(shown):
    held, mean = shown["shrunk"]["first camera held"], shown["shrunk"]["mean unit"]
    assert held[0] == pytest.approx(1.0, rel=1e-6)
    assert (np.diff(held) < 0.0).all()
    assert held[-1] < 0.6
    assert np.abs(np.array(mean) - 1.0).max() < 0.2

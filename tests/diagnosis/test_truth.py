"""Frames, units and clocks of ground truth."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.test_estimates import MISTAKES, as_instance, walk

import certpgo
from certpgo import Estimate
from certpgo.diagnosis import KnownTruth, truth
from certpgo.diagnosis.examined import Clock, Examined
from certpgo.linalg import rotations as so

OF_TRUTH = [kind for kind in MISTAKES if kind not in ("reordered", "inverse-rotations")]


def found_of(estimate, graph, known, clock=None):
    nodes = np.arange(known.num_nodes)
    examined = Examined(as_instance(graph), estimate, KnownTruth(nodes, known, clock))
    return list(truth.found(examined))


@pytest.mark.parametrize("kind", OF_TRUTH)
def test_conventions_of_the_truth(kind):
    graph, best = walk(3)
    R, t = MISTAKES[kind](best.rotations, best.translations)
    [found] = found_of(best, graph, Estimate(R, t))
    assert found.kind in (kind, "mirrored" if kind == "other-handedness" else kind)
    assert "as it stands" in found.said


def test_right_truth_says_nothing():
    graph, best = walk(3)
    assert found_of(best, graph, best.moved(so.exp(np.array([[0.3, 0.2, 1.0]]))[0])) == []


def test_another_frame_of_the_body():
    graph, best = walk(3)
    C = so.exp(np.array([[0.4, -0.2, 0.7]]))[0]
    a = np.array([0.2, -0.5, 0.3])
    R = best.rotations @ C
    [turned] = found_of(best, graph, Estimate(R, best.translations))
    assert turned.kind == "other-frame"
    moved = best.translations + 8.0 * best.rotations @ a
    [arm] = found_of(best, graph, Estimate(best.rotations, moved))
    assert arm.kind == "lever-arm"
    assert "(1.6, -4, 2.4)" in arm.said
    [both] = found_of(best, graph, Estimate(R, best.translations + 8.0 * R @ a))
    assert both.kind == "other-frame"
    assert "(1.6, -4, 2.4)" in both.said


def test_mounting_is_exact_without_noise():
    _, best = walk(3)
    C, a = so.exp(np.array([[1.0, 0.3, -0.5]]))[0], np.array([0.3, 0.1, -0.2])
    R = best.rotations @ C
    other = Estimate(R, best.translations + R @ a).moved(C, np.ones(3))
    found, arm = truth.mounting(best, other)
    np.testing.assert_allclose(found, C, atol=1e-6)
    np.testing.assert_allclose(arm, a, atol=1e-6)


def clocked(late, unit=1.0):
    """A wavy track at 50 Hz by a clock that is late, and nodes at 2 Hz."""
    graph, _ = walk(3)
    times = np.arange(0.0, 20.0, 0.02)
    track = np.stack([times, np.sin(times), 0.3 * np.cos(2.1 * times)], axis=1)
    at = 2.0 + 0.5 * np.arange(graph.num_nodes)
    t = np.stack([np.interp(at, times, x) for x in track.T], axis=1)
    estimate = Estimate(np.tile(np.eye(3), (len(at), 1, 1)), t)
    return graph, estimate, Clock(at, unit * (times + late), track)


@pytest.mark.parametrize("late", [0.7, -1.3, 100.0])
def test_the_offset_of_a_clock(late):
    graph, estimate, clock = clocked(late)
    wrong = Estimate(estimate.rotations, np.roll(estimate.translations, 2, axis=0))
    [found] = [f for f in found_of(estimate, graph, wrong, clock) if f.kind == "shifted-times"]
    offset = float(found.next.rpartition(" ")[2])
    assert offset == pytest.approx(-late, abs=0.02)


def test_clocks_in_other_units():
    graph, estimate, clock = clocked(0.0, unit=1e9)
    kinds = [found.kind for found in found_of(estimate, graph, estimate, clock)]
    assert kinds == ["times-units"]
    graph, estimate, clock = clocked(0.0)
    assert found_of(estimate, graph, estimate, clock) == []


def test_positions_alone():
    graph, best = walk(3)
    keys = certpgo.graph.keys.Keys(points=np.ones(best.num_nodes, dtype=bool))
    [found] = found_of(best, graph, Estimate(best.rotations, 1e3 * best.translations, keys))
    assert found.kind == "millimetres"


@pytest.mark.parametrize("rate", [0.03, -0.05])
def test_the_drift_of_a_clock_without_an_offset(rate):
    graph, estimate, clock = clocked(0.0)
    middle = float(np.median(clock.nodes))
    fast = replace(clock, times=middle + (1.0 + rate) * (clock.times - middle))
    t = np.stack([np.interp(fast.nodes, fast.times, x) for x in fast.positions.T], axis=1)
    [found] = found_of(estimate, graph, Estimate(estimate.rotations, t), fast)
    assert found.kind == "clock-drift"
    assert found.cost < 0.1 * found.cost_as_given
    assert float(found.next.rpartition(" ")[2]) == pytest.approx(1.0 + rate, abs=1e-3)

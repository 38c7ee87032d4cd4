"""Steps with the factor of an earlier Hessian."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo.optimize.chord_method import FLATTEST, STEEPEST, Chord


def chord(decrease=1e-6, last=1e-2, curvature=1.0):
    return Chord(np.array([1.0, -2.0]), decrease, last, curvature)


def test_how_many_steps_are_left():
    assert chord().count(1e-12) == pytest.approx(1.5)  # each gains 1e4 less than the one before
    assert chord().count(1e-6) == 0.0
    assert chord().count(0.0) == math.inf
    assert chord(decrease=1e-2).count(1e-12) == math.inf  # no progress


@given(st.floats(FLATTEST, STEEPEST), st.floats(FLATTEST, STEEPEST))
def test_the_curvature_is_that_of_a_quadratic(curvature, assumed):
    """Along the direction F - a 2p + a^2 h p for the factor's prediction p."""
    step = chord(curvature=assumed)
    length = 1.0 / assumed
    fallen = (2.0 * length - length**2 * curvature) * step.decrease
    assert step.curvature_for(fallen) == pytest.approx(curvature, rel=1e-12)


@given(st.floats(FLATTEST, STEEPEST))
def test_a_quadratic_of_one_variable_is_solved_by_the_second_chord(h):
    """F = h x^2 by the factor of x^2, from x = 1: 2 g = 2 h x."""
    first = Chord(np.array([-h]), h**2, math.inf)
    x = 1.0 + float(first.step[0])
    curvature = first.curvature_for(h - h * x**2)
    second = Chord(np.array([-h * x]), (h * x) ** 2, first.decrease, curvature)
    assert x + float(second.step[0]) == pytest.approx(0.0, abs=1e-12)


def test_the_curvature_stays_within_limits():
    assert chord().curvature_for(math.inf) == FLATTEST
    assert chord().curvature_for(-math.inf) == STEEPEST
    np.testing.assert_array_equal(chord(curvature=2.0).step, [0.5, -1.0])
    assert chord(curvature=2.0).predicted == 5e-7

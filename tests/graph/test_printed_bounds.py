"""Numbers in words."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo.graph.phrases import rounded_down, rounded_up


def test_bounds_are_rounded_outward():
    assert rounded_down(1231.49634160, 10) == "1231.496341"
    assert rounded_up(1231.49634160, 10) == "1231.496342"
    assert rounded_down(0.1, 3) == "0.1" == rounded_down(0.1000999, 3)
    assert rounded_up(1.001e-9, 2) == "1.1e-09"
    assert rounded_up(math.inf, 3) == "inf"


@given(st.floats(1e-290, 1e290), st.sampled_from([-1.0, 1.0]))
@pytest.mark.parametrize("digits", [2, 7, 12])
def test_what_is_printed_stays_a_bound(digits, size, sign):
    value = sign * size
    low, high = (Fraction(way(value, digits)) for way in (rounded_down, rounded_up))
    assert low <= Fraction(value) <= high
    assert high - low <= Fraction(10) ** (1 - digits) * Fraction(size)

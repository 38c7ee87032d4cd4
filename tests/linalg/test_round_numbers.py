"""Lengths of scale bars."""

from hypothesis import given
from hypothesis import strategies as st

from certpgo.linalg.arrays import round_below


@given(st.floats(1e-250, 1e250))
def test_round_numbers_are_the_next_below(number):
    found = round_below(number)
    assert found <= number < 2.6 * found
    assert f"{found:.0e}"[0] in "125"

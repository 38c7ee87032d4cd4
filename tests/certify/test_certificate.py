"""The figures that a certificate derives from others."""

import math
from dataclasses import replace

from certpgo import Quadratic, certify
from certpgo.io.datasets.synthetic import winding_cycle


def test_gaps_are_relative_to_the_cost_and_tolerances_to_both_scales():
    instance, _ = winding_cycle(6, 0.3, 0)
    certificate = certify(Quadratic(instance.graph), instance.truth)
    made = replace(certificate, cost_upper=8.0, gap=2.0, rtol=0.5, atol=0.25, scale=3.0)
    assert (made.relative_gap, made.tolerance) == (0.25, 4.0 + 1e-3 * 8.0)
    assert replace(made, scale=2.0**-20).tolerance == 4.0 + 2.0**-22
    assert replace(made, rounding=7.0).tolerance == 7.0
    assert replace(made, cost_upper=0.5).relative_gap == 4.0
    assert replace(made, cost_upper=0.0).relative_gap == math.inf

"""Langevin rotations: exact moments, the angle's law, isotropy, and what is thrown away."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.special import ive
from scipy.stats import kstest

from certpgo.errors import InputError
from certpgo.linalg import rotations as so

CONCENTRATIONS = [0.0, 1e-3, 0.3, 1.0, 7.0, 100.0, 1e4, 1e8]

#: Smallest p-value believed: of some thirty tests here, a true law fails one in thirty runs.
PLAUSIBLE = 1e-3


def rng():
    return np.random.default_rng(11)


def mean_trace(k, d):
    """E[tr R] by Bessel functions: the angle has density (1 - cos t)^(d - 2) exp(2 k cos t)."""
    i0, i1, i2 = ive([0, 1, 2], 2 * k)
    return 2 * i1 / i0 if d == 2 else 1 + (2 * i1 - i0 - i2) / (i0 - i1)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("k", CONCENTRATIONS[:-1])
def test_the_mean_trace_is_the_quotient_of_bessel_functions(k, d):
    R = so.langevin(rng(), k, 40000, d)
    assert so.worst_defect(R)[1] < 1e-14
    trace = np.trace(R, axis1=1, axis2=2)
    assert trace.mean() == pytest.approx(mean_trace(k, d), abs=4 * trace.std() / 200)


def angle_law(k, d):
    """The distribution function of the angle, by quadrature of its density."""
    t = np.linspace(0.0, min(np.pi, 12.0 / np.sqrt(2 * k) if k else np.pi), 20001)
    s = np.sin(t / 2) ** 2
    mass = cumulative_trapezoid(s ** (d - 2) * np.exp(-4 * k * s), t, initial=0.0)
    return lambda angle: np.interp(angle, t, mass / mass[-1])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("k", CONCENTRATIONS)
def test_angles_follow_their_law(k, d):
    angles = so.angle(so.langevin(rng(), k, 20000, d))
    assert kstest(angles, angle_law(k, d)).pvalue > PLAUSIBLE
    assert kstest(angles, angle_law(1.1 * k + 0.1, d)).pvalue < 1e-4


@pytest.mark.parametrize("k", [0.0, 0.7, 1e4])
def test_the_axis_is_uniform_and_independent_of_the_angle(k):
    v = so.log(so.langevin(rng(), k, 40000, 3))
    axis, angle = v / np.linalg.norm(v, axis=1, keepdims=True), np.linalg.norm(v, axis=1)
    np.testing.assert_allclose(axis.mean(axis=0), 0.0, rtol=0, atol=4 / np.sqrt(3 * 40000))
    np.testing.assert_allclose(axis.T @ axis / 40000, np.eye(3) / 3, rtol=0, atol=0.01)
    np.testing.assert_allclose(np.corrcoef(angle, axis.T)[0, 1:], 0.0, rtol=0, atol=0.02)
    for component in axis.T:  # Archimedes: uniform on [-1, 1]
        assert kstest(component, "uniform", (-1.0, 2.0)).pvalue > PLAUSIBLE


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("k", [1e4, 1e8, 1e20])
def test_for_high_concentrations_the_deviation_per_axis_is_one_over_sqrt_2k(k, d):
    v = np.sqrt(2 * k) * so.log(so.langevin(rng(), k, 40000, d))
    assert v.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * v.size))
    assert kstest(v.ravel(), "norm").pvalue > PLAUSIBLE


class Counting(np.random.Generator):
    drawn = 0

    def standard_normal(self, size):
        self.drawn += size[0]
        return super().standard_normal(size)


@pytest.mark.parametrize("k", [*CONCENTRATIONS, 1e300])
@pytest.mark.parametrize(("d", "least"), [(2, 0.658), (3, 0.447)])
def test_the_share_accepted_is_bounded_below(k, d, least):
    counting = Counting(np.random.PCG64(3))
    so.langevin(counting, k, 40000, d)
    share = 40000 / counting.drawn
    assert share >= least - 0.01
    if k == 0.0:
        assert share == 1.0


@pytest.mark.parametrize("d", [2, 3])
def test_the_ends_of_the_range(d):
    np.testing.assert_array_equal(so.langevin(rng(), np.inf, 2, d), [np.eye(d)] * 2)
    assert so.langevin(rng(), 1.0, 0, d).shape == (0, d, d)
    for k in (-1.0, np.nan):
        with pytest.raises(InputError, match="must not be negative"):
            so.langevin(rng(), k, 3, d)

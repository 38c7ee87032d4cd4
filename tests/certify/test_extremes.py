"""Weights at the ends of their range, contradicting measurements, graphs of uneven weights."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certpgo
from certpgo import certify
from certpgo.certify import Tier, Verdict
from certpgo.certify.units import in_units, scaled_blocks, scaled_down, scaled_up
from certpgo.errors import FormatError, GraphError, InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.objective import cost_upper
from certpgo.objective.quadratic import Quadratic

TIERS = [Tier.STANDARD, Tier.PROOF]


def contradiction(d=2):
    """Two nodes, measured to agree and to be opposite: in the plane every estimate costs 8."""
    half = so.exp(np.pi * np.eye(so.tangent_dim(d))[-1:])
    R = so.project(np.concatenate([np.eye(d)[None], half]))
    return RotationGraph(2, np.array([[0, 1], [0, 1]]), R, np.ones(2))


def uneven(exponents):
    """A square of poses, every other measured a little wrong, weights of these powers of ten."""
    rng = np.random.default_rng(0)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    R = so.exp(1e-3 * rng.standard_normal((5, 3)))
    weights = 10.0 ** np.asarray(exponents, dtype=float)
    return PoseGraph(RotationGraph(4, edges, R, weights), rng.standard_normal((5, 3)), weights)


@pytest.mark.parametrize("text", ["1e-300", "1e300", "5e-121"])
def test_weights_out_of_range_are_refused_where_they_are_read(text, tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text(
        f"EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 {text}\n", "ascii"
    )
    if text == "5e-121":
        assert certpgo.read(path).graph.kappa[1] == 5e-121
        return
    with pytest.raises(FormatError, match=r"2: .*weights between 3\.9e-121 and 2\.6e"):
        certpgo.read(path)


@pytest.mark.parametrize("weight", [-1.0, 1e-121, 1e121, 2.0**-400, 2.0**400, np.inf, np.nan])
def test_weights_out_of_range_are_refused_where_the_graph_is_made(weight):
    graph = contradiction()
    with pytest.raises(GraphError, match=r"edge \(0, 1\): kappa is .* must be (positive|between)"):
        graph.with_weights(weight)
    with pytest.raises(GraphError, match=r"edge \(0, 1\): tau is"):
        PoseGraph(graph, np.zeros((2, 2)), np.full(2, weight))


@pytest.mark.parametrize("tier", TIERS)
def test_scaling_drops_no_measurement(tier):
    """An edge of which one weight vanishes in the problem's units once took the other with it."""
    graph = PoseGraph(
        RotationGraph(2, np.array([[0, 1], [0, 1]]), np.tile(np.eye(2), (2, 1, 1)), [1e-100, 1.0]),
        np.array([[0.0, 0.0], [1e15, 0.0]]),
        np.array([1.0, 1e30]),
    )
    estimate = Estimate(np.tile(np.eye(2), (2, 1, 1)), np.zeros((2, 2)))
    with pytest.raises(InputError, match=r"too uneven weights: .*kappa is"):
        certify(Quadratic(graph), estimate, tier=tier)
    # Two distances, 0 and 10^15: the best lies where the springs of weight 1 and 1/1000 balance.
    mild = graph.with_weights(np.array([1e-30, 1.0]), np.array([1.0, 1e-3]))
    certificate = certify(Quadratic(mild), estimate, tier=tier)
    assert certificate.lower_bound <= 1e27 / 1.001 * (1.0 + 1e-12)
    assert certificate.cost_upper == pytest.approx(1e27, rel=1e-12)
    assert certificate.refined_cost == pytest.approx(1e27 / 1.001, rel=1e-12)


@pytest.mark.parametrize("tier", TIERS)
@pytest.mark.parametrize("rtol", [0.0, 1e-16])
def test_equally_good_points_do_not_refute_each_other(tier, rtol):
    problem = Quadratic(contradiction())
    for seed in range(20):
        estimate = Estimate(so.random(np.random.default_rng(seed), 2, 2))
        assert problem.cost(estimate) == pytest.approx(8.0, rel=1e-14)
        certificate = certify(problem, estimate, tier=tier, rtol=rtol, atol=0.0)
        assert certificate.verdict is Verdict.BOUNDED
        certificate = certify(problem, estimate, tier=tier, rtol=rtol)
        assert certificate.verdict is Verdict.CERTIFIED


@given(st.integers(0, 1000))
def test_costs_are_enclosed(seed):
    rng = np.random.default_rng(seed)
    problem = Quadratic(uneven(rng.uniform(-8, 8, 5)))
    estimate = Estimate(so.random(rng, 4, 3), 10.0 ** rng.uniform(-6, 6) * rng.random((4, 3)))
    exact = _exact_cost(problem.graph, estimate)
    low, high = problem.enclosure(estimate)[0], cost_upper(problem, estimate)
    # The stored matrices are rotations but for rounding, which both bounds allow for.
    assert Fraction(low) <= exact <= Fraction(high)
    assert high - low <= 1e-9 * high


def _exact_cost(graph, estimate):
    """F of the stored numbers, in rationals."""
    rational = np.vectorize(Fraction, otypes=[object])
    R, t, measured = map(rational, (estimate.rotations, estimate.translations, graph.rotations))
    kappa, tau, steps = map(rational, (graph.kappa, graph.tau, graph.translations))
    i, j = graph.edges.T
    turn = R[j] - np.einsum("mab,mbc->mac", R[i], measured)
    move = t[j] - t[i] - np.einsum("mab,mb->ma", R[i], steps)
    return (kappa * (turn**2).sum(axis=(1, 2))).sum() + (tau * (move**2).sum(axis=1)).sum()


#: Doubles of all sizes that survive a first scaling.
NUMBERS = st.floats(min_value=2.0**-900, max_value=2.0**400)
UNITS = st.integers(-1000, 600).map(lambda k: math.ldexp(1.0, k))


@given(UNITS, NUMBERS, st.sampled_from([-1.0, 1.0]))
def test_units_are_rounded_outwards(unit, size, sign):
    x = sign * size
    exact = Fraction(unit) * Fraction(x)
    up, down = scaled_up(unit, x), scaled_down(unit, x)
    assert Fraction(down) <= exact
    assert up == math.inf or exact <= Fraction(up)
    tiniest = 2.0**-1074
    assert up == math.inf or Fraction(up) - Fraction(down) <= Fraction(tiniest)


def test_a_lower_bound_that_vanishes_is_rounded_down():
    assert scaled_down(2.0**-1000, 0.75 * 2.0**-74) == 0.0
    assert scaled_up(2.0**-1000, 0.25 * 2.0**-74) == 2.0**-1074
    assert scaled_down(2.0**-1000, 1.75 * 2.0**-74) == 2.0**-1074


@given(st.integers(0, 10_000), st.sampled_from([2, 3]), st.integers(-1000, -900))
def test_multipliers_in_other_units_are_no_larger(seed, d, power):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, d, d)) * 2.0 ** rng.integers(-120, 0, (3, 1, 1))
    A = A + np.swapaxes(A, 1, 2)
    unit = math.ldexp(1.0, power)
    for block, scaled in zip(A, scaled_blocks(unit, A), strict=True):
        less = [
            [Fraction(unit) * Fraction(block[a, b]) - Fraction(scaled[a, b]) for b in range(d)]
            for a in range(d)
        ]
        for a in range(d):  # diagonally dominant, exactly
            assert less[a][a] >= sum(abs(less[a][b]) for b in range(d) if b != a)


def test_multipliers_in_other_units_are_the_same_where_nothing_underflows():
    A = np.random.default_rng(0).standard_normal((3, 2, 2))
    np.testing.assert_array_equal(scaled_blocks(2.0**-100, A), 2.0**-100 * A)


@pytest.mark.parametrize("power", [-1074, -1000])
def test_certificates_in_units_that_underflow_stay_true(power):
    instance, _ = winding_cycle(9, 0.3, 0)
    certificate = certify(Quadratic(instance.graph), instance.truth)
    unit = math.ldexp(1.0, power)
    scaled = in_units(unit, certificate)
    assert Fraction(scaled.lower_bound) <= Fraction(unit) * Fraction(certificate.lower_bound)
    for name in ("cost_upper", "gap", "refined_cost"):
        before, after = getattr(certificate, name), getattr(scaled, name)
        exact = Fraction(unit) * Fraction(before)
        assert exact <= Fraction(after) <= exact + Fraction(2.0**-1074)
    assert scaled.scale == unit * certificate.scale


@pytest.mark.parametrize("power", [-300, -3, 0, 300])
def test_the_bounds_of_a_certificate_are_in_the_weights_units(power):
    """Of a triangle that does not close, whose bound by eigenvalues is its optimum."""
    instance, _ = winding_cycle(3, 0.5, 0)
    problem = Quadratic(instance.graph.with_weights(2.0**power))
    found = certify(problem, instance.truth, angles=True).bounds
    assert found.fiedler == pytest.approx(2.0**power * 3.0, rel=1e-9)
    optimum = 2.0**power * 24.0 * math.sin(0.5 / 6.0) ** 2
    assert found.spectral == pytest.approx(optimum, rel=1e-4)
    assert found.spectral <= optimum
    assert found.cycle == pytest.approx(math.pi / 3.0)


@pytest.mark.parametrize("scale", [2.0**-380, 1.0, 2.0**380])
@pytest.mark.parametrize("tier", TIERS)
def test_verdicts_at_the_ends_of_the_range(tier, scale):
    instance, wound = winding_cycle(9, 0.3, 1)
    problem = Quadratic(instance.graph.with_weights(scale))
    assert certify(problem, wound, tier=tier).verdict is Verdict.REFUTED
    certificate = certify(problem, instance.truth, tier=tier)
    assert certificate.verdict is Verdict.CERTIFIED
    optimum = 8 * 9 * math.sin(0.3 / 18) ** 2
    assert certificate.lower_bound <= scale * optimum * (1.0 + 1e-14)


def test_far_steps_of_conjugate_gradients_do_not_overflow():
    edges = np.array([[0, 1], [0, 1], [0, 2]])
    R = np.stack([np.eye(2), -np.eye(2), np.eye(2)])
    problem = Quadratic(RotationGraph(3, edges, R, np.ones(3)))
    for seed in (1, 11, 24):
        estimate = Estimate(so.random(np.random.default_rng(seed), 3, 2))
        certificate = certify(problem, estimate)  # the third node is the only one that costs more
        assert certificate.refined_cost == pytest.approx(8.0, rel=1e-12)
        assert certificate.lower_bound == pytest.approx(8.0, rel=1e-12)
        assert certpgo.solve(problem, initial=estimate).verdict is Verdict.CERTIFIED


@pytest.mark.parametrize(
    "exponents", [[20, 0, 20, 0, 20], [-30, 0, 30, 0, 0], [16, 16, 0, -16, -16], [0, 40, 0, 40, 0]]
)
def test_uneven_weights_get_an_answer(exponents):
    graph = uneven(exponents)
    answer = certpgo.solve(graph)
    assert answer.certificate.lower_bound <= answer.certificate.cost_upper
    again = certify(Quadratic(graph), answer.estimate)
    assert again.verdict is not Verdict.REFUTED


def test_solve_and_certify_agree_where_a_bridge_outweighs_the_rest():
    """What atol W lets pass for optimal is improved all the same, when it was given."""
    instance, wound = winding_cycle(9, 0.3, 1)
    edges = np.concatenate([instance.graph.edges, [[0, 9]]])
    R = np.concatenate([instance.graph.rotations, np.eye(3)[None]])
    graph = RotationGraph(10, edges, R, np.r_[np.full(9, 1e-14), 1.0])
    start = Estimate(np.concatenate([wound.rotations, wound.rotations[:1]]))
    assert certify(Quadratic(graph), start).verdict is Verdict.REFUTED
    answer = certpgo.solve(graph, initial=start)
    assert answer.cost == pytest.approx(1e-14 * 8 * 9 * math.sin(0.3 / 18) ** 2, rel=1e-6)
    assert certify(Quadratic(graph), answer.estimate).verdict is Verdict.CERTIFIED

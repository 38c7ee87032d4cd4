"""Rejections certified: minorants of truncated costs, and verdicts about all choices."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import point_graph, rng_of

from certpgo import certify, solve, solve_robustly
from certpgo.certify.certificate import Verdict
from certpgo.certify.obstacle import LimitedBy
from certpgo.errors import InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated import Truncation
from certpgo.objective.truncated_cost import TruncatedCost, rejecting


def doubtful_graph(rng, d, *, poses, n=6, doubtful=4):
    """A random graph with noise as stated, and doubtful measurements with errors of all sizes."""
    R, t = so.random(rng, n, d), 3.0 * rng.normal(size=(n, d))
    pairs = [(k, k + 1) for k in range(n - 1)]
    pairs += [tuple(rng.choice(n, 2, replace=False)) for _ in range(n + doubtful)]
    edges, m = np.array(pairs), len(pairs)
    kappa, tau = np.exp(0.7 * rng.normal(size=(2, m))) * np.array([[200.0], [100.0]])
    size = np.where(np.arange(m) < m - doubtful, 0.0, np.exp(rng.uniform(-3.0, 1.0, m)))
    turns = rng.normal(size=(m, so.tangent_dim(d))) * (size + 1.0 / np.sqrt(2.0 * kappa))[:, None]
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    rotation = RotationGraph(n, edges, back @ R[j] @ so.exp(turns), kappa)
    if not poses:
        return rotation, size > 0.0
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0]
    steps += rng.normal(size=(m, d)) * (size + 1.0 / np.sqrt(tau))[:, None]
    return PoseGraph(rotation, steps, tau), size > 0.0


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2, 3]), st.floats(-6.0, 6.0), st.booleans())
def test_minorants_are_below_truncated_costs_and_touch_them(seed, d, decade, general):
    rng, k = rng_of(seed), 50
    edges = np.tile([0, 1], (k, 1))
    kappa, tau = np.exp(rng.uniform(-7.0, 7.0, (2, k))) * 10.0**decade
    R, Q = so.random(rng, k, d), so.random(rng, k, d)
    t, v = rng.normal(size=(2, k, d))
    graph = PoseGraph(RotationGraph(2, edges, R, kappa), t, tau)
    f = kappa * ((Q - R) ** 2).sum(axis=(1, 2)) + tau * ((v - t) ** 2).sum(axis=1)
    prices = f * np.exp(rng.uniform(-5.0, 2.0, k))
    at = Truncation(graph, prices, v, Q)
    W = at.plain()
    if general:  # any weights, for any centre
        A = rng.normal(size=(k, d + 1, d + 1))
        W = W.max(axis=(1, 2))[:, None, None] * (A @ np.swapaxes(A, 1, 2))
    found = at.minorants(W)

    def values(v, Q):
        moved = v + (Q @ found.a[:, :, None])[:, :, 0] - found.b
        linear = 2.0 * np.einsum("kab,kab->k", found.N, Q)
        size = np.abs(found.tau) * (moved**2).sum(axis=1) + np.abs(linear) + np.abs(found.constant)
        return found.tau * (moved**2).sum(axis=1) - linear + found.constant, size

    def truncated(v, Q):
        f = kappa * ((Q - R) ** 2).sum(axis=(1, 2)) + tau * ((v - t) ** 2).sum(axis=1)
        return np.minimum(f, prices)

    # Where cost and minorant are closest: v is between t and b - Q a, and what is left is linear.
    beta, y = -found.tau, t - found.b
    both = (beta * tau / (beta + tau))[:, None, None]
    linear = found.N - kappa[:, None, None] * R + both * (y[:, :, None] * found.a[:, None, :])
    closest = so.project(-linear)
    moved = found.b - (closest @ found.a[:, :, None])[:, :, 0]
    between = (tau[:, None] * t + beta[:, None] * moved) / (tau + beta)[:, None]
    below, size = values(between, closest)
    assert (below <= truncated(between, closest) + 1e-13 * size).all()

    for step in (0.0, 1e-6, 1e-2, 1.0, 30.0):
        # Near the estimate, near the measurement, and between them, where minorants are closest.
        for w, P in ((v, Q), (t, R), (0.5 * (v + t), so.project(0.5 * (Q + R) + 1e-3))):
            turned = P @ so.exp(min(step, 3.0) * rng.normal(size=(k, so.tangent_dim(d))))
            at_w = w + step * rng.normal(size=(k, d))
            below, size = values(at_w, turned)
            assert (below <= truncated(at_w, turned) + 1e-12 * size).all()
    if not general:
        used = W.any(axis=(1, 2))
        there, size = values(v, Q)
        assert (there + 1e-10 * size >= np.minimum(f, prices))[used].all()


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [0.3, 1.5, 3.0])
def test_two_rotations_are_certified_up_to_what_taking_one_back_costs(d, angle):
    # One measurement has weight 3, and another of weight 1 is off by an angle: F of both is at
    # least 4 (3 + 1 - |3 + exp(i angle)|), and without orthogonality 3/4 of |R - I|^2.
    turn = so.exp(np.array([[angle] if d == 2 else [0.0, 0.0, angle]]))
    graph = RotationGraph(2, [[0, 1]] * 2, np.concatenate([np.eye(d)[None], turn]), [3.0, 1.0])
    rise, less = 4.0 * (4.0 - abs(3.0 + np.exp(1j * angle))), 3.0 * (1.0 - math.cos(angle))
    kept = Estimate(np.tile(np.eye(d), (2, 1, 1)))
    for price, certified in ((0.999 * less, True), (1.001 * rise, False)):
        problem = TruncatedCost(Quadratic(graph), [np.inf, price])
        certificate = certify(problem, kept)
        assert (certificate.verdict is Verdict.CERTIFIED) is certified
        assert certificate.lower_bound <= rise
        assert certificate.cost_upper == pytest.approx(price)


@pytest.mark.parametrize("seed", range(10))
def test_no_choice_is_better_than_a_certified_one(seed):
    rng = rng_of(seed)
    d, poses = 2 + seed % 2, seed % 4 < 2
    graph, doubtful = doubtful_graph(rng, d, poses=poses)
    price = math.exp(rng.uniform(1.0, 4.0))
    problem = TruncatedCost(Quadratic(graph), np.where(doubtful, price, np.inf))
    kept = solve(problem.kept).estimate
    certificate = certify(problem, kept)
    best = math.inf
    for choice in itertools.product([0.0, 1.0], repeat=int(doubtful.sum())):
        factors = np.ones(len(doubtful))
        factors[doubtful] = choice
        taken = solve(graph.reweighted(factors), initial=kept)
        best = min(best, taken.cost + price * choice.count(0.0))
    assert certificate.lower_bound <= best * (1.0 + 1e-9)
    if certificate.verdict is Verdict.CERTIFIED:
        assert certificate.cost_upper - certificate.tolerance <= best * (1.0 + 1e-9)
    elif certificate.basin_is_global:
        assert certificate.refined_cost <= best * (1.0 + 1e-5)
    else:
        assert certificate.limited_by in {LimitedBy.AMBIGUOUS, LimitedBy.TIGHT}


@pytest.mark.parametrize(("share", "bad"), [(10, 50), (30, 147), (50, 263)])
def test_all_choices_of_labelled_outliers_are_certified(dataset, share, bad):
    instance = dataset(f"grid1000_{share}p_outliers")
    answer = solve_robustly(instance.graph)
    assert len(answer.rejection.edges) == bad
    assert answer.rejection.verdict is Verdict.CERTIFIED
    cost = answer.certificate.cost_upper + answer.rejection.prices.sum()
    assert answer.rejection.certificate.cost_upper == pytest.approx(cost)
    assert answer.rejection.certificate.gap < 1e-5


def test_a_measurement_that_costs_less_than_its_price_is_taken_back():
    graph, doubtful = doubtful_graph(rng_of(3), 3, poses=True, doubtful=1)
    problem, rejected = Quadratic(graph), np.flatnonzero(doubtful)
    fit = solve(graph).estimate
    price = 20.0 * problem.edge_costs(fit)[rejected[0]]
    truncated = TruncatedCost(problem, np.where(doubtful, price, np.inf))
    kept = solve(truncated.kept).estimate
    certificate = certify(truncated, kept)
    assert certificate.verdict is Verdict.BOUNDED
    assert certificate.basin_is_global
    assert certificate.refined_cost == pytest.approx(problem.cost(fit), rel=1e-6)


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**60])
def test_the_unit_of_weights_decides_nothing(unit):
    graph, doubtful = doubtful_graph(rng_of(5), 2, poses=True)
    prices = np.where(doubtful, 5.0, np.inf)
    problem = TruncatedCost(Quadratic(graph), prices)
    kept = solve(problem.kept).estimate
    one, other = (certify(of, kept) for of in (problem, problem.scaled(unit)))
    assert one.verdict is other.verdict
    assert other.lower_bound == unit * one.lower_bound


@pytest.mark.parametrize("d", [2, 3])
def test_a_sighting_of_a_point_is_rejected(d):
    graph, *_ = point_graph(rng_of(1), 30, 12, d, noise=0.01)
    kappa, tau = np.where(graph.measures_rotation, 5e3, 0.0), np.where(graph.tau > 0.0, 1e4, 0.0)
    sighting = np.flatnonzero(~graph.measures_rotation)[-1]
    t = np.array(graph.translations)
    t[sighting] += 5.0
    wrong = replace(graph.with_weights(kappa, tau), translations=t)
    answer = solve_robustly(wrong)
    assert answer.solution.rejected.tolist() == [sighting]
    assert answer.rejection.verdict is Verdict.CERTIFIED
    assert "neither taking the rejected measurement back nor" in answer.rejection.sentence


def test_rejections_that_cannot_be_are_refused():
    graph, _ = doubtful_graph(rng_of(0), 2, poses=True)
    problem, m = Quadratic(graph), graph.num_edges
    for rejected, quantile, said in (
        ([m], None, f"indices from 0 to {m - 1}"),
        ([0, 0], None, "each once"),
        ([0.5], None, "by their indices"),
        ([m - 1], 1.0, "between 0 and 1"),
        ([], None, "no measurement is rejected"),
        (range(m), None, "none is kept"),
    ):
        with pytest.raises(InputError, match=said):
            rejecting(problem, np.array(rejected, dtype=None if rejected else int), quantile)
    with pytest.raises(InputError, match="none are given"):
        certify(graph, solve(graph), quantile=0.9)
    with pytest.raises(InputError, match="between 0 and 1"):
        solve_robustly(graph, quantile=2.0)


@pytest.mark.parametrize(("weight", "angle", "price"), [(1e14, 0.5, 20.0), (1.0, 1e-3, 5e-5)])
def test_what_is_tolerated_is_small_against_a_price(weight, angle, price):
    # Taking the last measurement back costs a fraction of its price, which is less than a share
    # 1e-12 of the total weight, or 1e-5 of the cost of two measurements half a turn apart.
    half = math.pi if weight == 1.0 else 0.0
    turns = so.exp(np.array([[0.0], [0.0], [0.0], [half], [angle]]))
    edges, kappa = [(1, 2), (0, 1), (2, 3), (2, 3), (0, 1)], [weight, 1.0, weight, weight, 100.0]
    graph = RotationGraph(4, edges, turns, kappa)
    problem = TruncatedCost(Quadratic(graph), [np.inf] * 4 + [price])
    certificate = certify(problem, solve(problem.kept).estimate)
    assert certificate.verdict is not Verdict.CERTIFIED
    assert certificate.tolerance < price


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_the_proof_tier_trusts_no_factorization(d, poses):
    graph, doubtful = doubtful_graph(rng_of(d + 4), d, poses=poses, n=12, doubtful=1)
    problem, kept = Quadratic(graph), solve(graph.reweighted(np.where(doubtful, 0.0, 1.0)))
    [cost] = problem.edge_costs(kept.estimate)[doubtful]
    for price, certified in ((0.01 * cost, True), (0.99 * cost, False)):
        truncated = TruncatedCost(problem, np.where(doubtful, price, np.inf))
        found = certify(truncated, kept.estimate, tier="proof")
        assert (found.verdict is Verdict.CERTIFIED) is certified
        assert found.limited_by is (LimitedBy.TIGHT if certified else LimitedBy.AMBIGUOUS)
        assert found.lower_bound <= found.cost_upper

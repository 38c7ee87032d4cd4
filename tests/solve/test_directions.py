"""Directions of the world, such as gravity's, seen by poses; and attitudes alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, InputError, Quadratic, solve, with_directions, with_priors
from certpgo.linalg import rotations as so
from certpgo.optimize.riemannian_newton import newton

few = settings(max_examples=12)


def seen_by(rng, R, nodes, h, noise):
    g = np.swapaxes(R[nodes], 1, 2) @ h
    return g + noise * rng.standard_normal(g.shape)


@given(seeds, dimensions)
@few
def test_the_cost_is_what_it_says(seed, d):
    rng = rng_of(seed)
    graph, R, _ = pose_graph(rng, 5, d)
    h = rng.standard_normal(d)
    nodes, kappa = np.array([0, 2, 4]), np.array([1.0, 2.0, 3.0])
    g = seen_by(rng, R, nodes, h / np.linalg.norm(h), 0.1)
    joined = with_directions(graph, nodes, g, kappa=kappa, direction=h)
    problem, alone = Quadratic(joined), Quadratic(graph)
    t = rng.standard_normal((6, d))
    t[5] = t[0]  # where the world is put
    point = Estimate(so.random(rng, 6, d), t)
    here = Estimate(point.rotations[:5], point.translations[:5])
    g, h = g / np.linalg.norm(g, axis=1)[:, None], h / np.linalg.norm(h)
    off = h @ point.rotations[5].T - np.einsum("kab,kb->ka", point.rotations[nodes], g)
    expected = alone.cost(here) + kappa @ (off**2).sum(axis=1)
    assert problem.cost(point) == pytest.approx(expected)


@given(seeds)
@few
def test_bounds_are_below_what_descents_find(seed):
    rng = rng_of(seed)
    graph, R, _ = pose_graph(rng, 5, 3, noise=0.2)
    nodes = np.arange(5)
    joined = with_directions(graph, nodes, seen_by(rng, R, nodes, np.eye(3)[2], 0.2), kappa=3.0)
    answer, problem = solve(joined), Quadratic(joined)
    assert answer.verdict.value in ("CERTIFIED", "BOUNDED")
    for _ in range(4):
        found = newton(problem, problem.complete(so.random(rng, 6, 3)))
        assert answer.certificate.lower_bound <= found.cost * (1.0 + 1e-12)


def test_a_world_may_be_measured_twice():
    rng = rng_of(3)
    graph, R, t = pose_graph(rng, 6, 3, noise=0.02)
    nodes = np.arange(6)
    fixed = with_priors(graph, nodes, translations=t, tau=100.0)
    joined = with_directions(
        fixed, nodes, seen_by(rng, R, nodes, np.eye(3)[2], 0.01), kappa=50.0, world=6
    )
    assert joined.num_nodes == 7
    again = with_priors(graph, nodes[:1], R[:1], kappa=50.0, world=None)
    assert with_priors(again, nodes[1:], translations=t[1:], tau=4.0, world=6).num_nodes == 7
    answer = solve(joined)
    assert answer.verdict.value == "CERTIFIED"
    up = answer.estimate.anchored(6).rotations[:6, 2]
    np.testing.assert_allclose(up, R[:, 2], atol=0.1)


def test_attitudes_alone():
    graph, R, _ = pose_graph(rng_of(4), 6, 3, noise=0.05)
    joined = with_priors(graph, [1, 3], R[[1, 3]], kappa=100.0)
    answer = solve(joined)
    assert answer.verdict.value == "CERTIFIED"
    # The world's position is free, and costs nothing.
    there = answer.estimate.translations
    np.testing.assert_allclose(there[6], there[1], atol=1e-6)


def test_opposite_directions_have_a_turn():
    for d in (2, 3):
        h = np.eye(d)[-1]
        R = so.aligning(np.stack([h, -h]), h)
        turned = (R @ np.stack([h, -h])[:, :, None])[:, :, 0]
        np.testing.assert_allclose(turned, np.stack([h, h]), atol=1e-15)


def test_what_is_refused():
    graph, _, _ = pose_graph(rng_of(4), 4, 3)
    with pytest.raises(InputError, match="finite and not zero"):
        with_directions(graph, [0], np.zeros((1, 3)), kappa=1.0)
    with pytest.raises(InputError, match=r"directions must be \(1, 3\)"):
        with_directions(graph, [0], np.ones((1, 2)), kappa=1.0)
    with pytest.raises(certpgo.GraphError, match="kappa is nan"):
        with_directions(graph, [0], np.ones((1, 3)), kappa=np.nan)

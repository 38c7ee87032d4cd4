"""Costs rounded upwards, where rounding and stored matrices do their worst."""

from fractions import Fraction

import numpy as np
import pytest
from strategies import random_edges, rng_of

from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.objective import cost_upper
from certpgo.objective.quadratic import Quadratic

U = 2.0**-53


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [1e-13, 1e-9, 1e-6, 1e-4])
def test_the_defect_is_the_distance_from_the_rotations(d, size):
    """Q (I + size / 2 J), J all ones, is as far from Q as its defect allows."""
    Q = so.random(rng_of(d), 20, d)
    R = Q.copy()
    R[7] = R[7] @ (np.eye(d) + 0.5 * size * np.ones((d, d)))
    distance = 0.5 * size * d
    assert distance * (1 - 1e-12) <= rotation_defect(R) <= 1.03 * distance + 32 * d * U
    assert 2.0 * d * U <= rotation_defect(Q) <= 16 * d * U


def storing(made, R):
    """An estimate or a graph that stores R as it is, though it is off by more than rounding."""
    object.__setattr__(made, "rotations", R)
    return made


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("which", ["estimate", "measured", "both", "neither"])
@pytest.mark.parametrize("size", [1e-10, 1e-6])
def test_stored_matrices_that_are_too_small_do_not_hide_cost(d, which, size):
    """The nearest rotations have F = kappa 8 and tau |t|^2; what is stored seems to cost less."""
    R = np.tile(np.eye(d), (2, 1, 1))
    turn = np.eye(d)
    turn[:2, :2] = -np.eye(2)
    rotation = RotationGraph(2, np.array([[0, 1]]), turn[None], np.array([3.0]))
    graph = PoseGraph(rotation, np.full((1, d), 5.0), np.array([0.25]))
    x, at = Estimate(R), Estimate(R, np.zeros((2, d)))
    if which in ("estimate", "both"):
        x, at = (storing(made, R * (1.0 - size)) for made in (x, at))
    if which in ("measured", "both"):
        rotation, graph = (storing(made, turn[None] * (1.0 - size)) for made in (rotation, graph))
    cost, pulled = 3.0 * 8.0, 0.25 * 25.0 * d
    plain = cost_upper(Quadratic(rotation), x)
    assert cost < plain <= cost * (1 + 4 * d * size + 1000 * U)
    whole = cost_upper(Quadratic(graph), at) - plain
    assert pulled < whole <= pulled * (1 + 4 * d * size + 1000 * U)


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("extra", [0, 3, 2000])
def test_sums_are_rounded_upwards_however_long(extra, poses):
    """Quarter turns are rotations as stored: what is left of F is sums and products."""
    rng, n = rng_of(extra), 40
    edges = random_edges(rng, n, extra)
    m = len(edges)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    turns = np.array([np.linalg.matrix_power(quarter, k) for k in range(4)])
    rotation = RotationGraph(n, edges, turns[rng.integers(4, size=m)], rng.uniform(0.5, 4.0, m))
    graph = PoseGraph(rotation, rng.standard_normal((m, 2)), rng.uniform(0.5, 4.0, m))
    R, t = turns[rng.integers(4, size=n)], 100.0 * rng.standard_normal((n, 2))
    exact = Fraction(0)
    for e, (i, j) in enumerate(edges):
        E = R[j] - R[i] @ rotation.rotations[e]
        exact += Fraction(rotation.kappa[e]) * Fraction(float((E**2).sum()))
        step = R[i] @ graph.translations[e]
        for a in range(2 * poses):
            r = Fraction(t[j, a]) - Fraction(t[i, a]) - Fraction(step[a])
            exact += Fraction(graph.tau[e]) * r * r
    problem = Quadratic(graph) if poses else Quadratic(rotation)
    upper = cost_upper(problem, Estimate(R, t if poses else None))
    assert exact <= Fraction(upper) <= exact * (1 + Fraction(5 * m + 600) * Fraction(U))


@pytest.mark.parametrize("d", [2, 3])
def test_what_an_arm_may_lose_is_added_to_what_is_left(d):
    """An arm of length 1 that misses by r = 2 k u, and a longer one that hardly weighs."""
    arms = np.zeros((2, d))
    arms[:, 0] = 1.0, 1e6
    edges, weights = np.array([[0, 1], [0, 2]]), np.array([1.0, 1e-40])
    rotation = RotationGraph(3, edges, np.tile(np.eye(d), (2, 1, 1)), np.full(2, 1e-20))
    problem = Quadratic(PoseGraph(rotation, arms, weights))
    at = np.concatenate([np.zeros((1, d)), arms])
    for k in range(40):
        r = 2 * k * U
        at[1, 0] = 1.0 + r
        upper = cost_upper(problem, Estimate(np.tile(np.eye(d), (3, 1, 1)), at))
        # The product R t alone may be off by d u.
        assert (r + d * U) ** 2 <= upper <= (r + 70 * U) ** 2 * (1 + 1e-9)

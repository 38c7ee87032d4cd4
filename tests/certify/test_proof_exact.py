"""The parts of the proof tier: what measured rotations are off by, and who pays for it."""

import math
from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo.certify import proof
from certpgo.certify.dual import dual_bound
from certpgo.certify.proof import (
    distances,
    exact_cost,
    exact_graph,
    prove,
    proven_bound,
    quaternions,
)
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic


def optimum(poses, d=3, n=6):
    graph, _, _ = pose_graph(rng_of(d), n, d)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    return problem, certpgo.solve(problem).estimate


@given(seeds, dimensions)
@settings(max_examples=20)
def test_measured_rotations_are_within_their_distance_of_the_stored_ones(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 4, d, noise=3.0)
    R = graph.rotations
    found = distances(exact_graph(Quadratic(graph)), R)
    for q, stored, bound in zip(quaternions(R), R, found, strict=True):
        exact = proofs.exact_rotation(q)
        apart = [Fraction(stored[a, b]) - exact[a][b] for a in range(d) for b in range(d)]
        assert sum(x * x for x in apart) <= Fraction(bound) ** 2
        assert bound <= 1e-14


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("angle", [1e-9, 0.3, math.pi])
def test_distances_are_those_of_the_turn_between(d, angle):
    problem, _ = optimum(poses=False, d=d)
    R = problem.graph.rotations
    turned = R @ so.exp(angle * np.eye(so.tangent_dim(d))[-1])
    expected = np.full(len(R), 2.0 * math.sqrt(2.0) * math.sin(0.5 * angle))
    found = distances(exact_graph(problem), turned)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    assert np.all(found >= expected * (1.0 - 1e-15))


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_both_nodes_of_an_edge_pay_for_what_its_rotation_is_off_by(poses, d, monkeypatch):
    """kappa |D| is taken off their diagonals, and little more; of the trace, the bound."""
    problem, x = optimum(poses, d)
    mine, start = exact_graph(problem), dual_bound(problem, x)
    off = rng_of(0).uniform(0.0, 1e-3, problem.graph.num_edges)
    monkeypatch.setattr(proof, "distances", lambda graph, R: off)
    bound = proven_bound(problem, mine, x, start)
    before = prove(problem, mine, x, start.multipliers)[0]
    due = np.zeros(problem.n)
    for (i, j), kappa, less in zip(problem.graph.edges, mine.kappa, off, strict=True):
        due[[i, j]] += kappa * less
    diagonals = [np.einsum("naa->na", Lam) for Lam in (before, bound.multipliers)]
    taken = (diagonals[0] - diagonals[1]) / due[:, None]
    assert np.all((taken >= 1.0) & (taken <= 1.002))
    assert bound.value < math.fsum(diagonals[1].ravel())
    assert bound.value == pytest.approx(math.fsum(diagonals[1].ravel()), rel=1e-15)
    apart = before - bound.multipliers
    assert np.all(apart[:, ~np.eye(d, dtype=bool)] == 0.0)
    least = np.einsum("naa->na", problem.multipliers(x)) - diagonals[1]
    assert bound.shift == pytest.approx(least.max(), rel=1e-6)


def test_diagonals_are_rounded_down_even_where_nothing_is_off(monkeypatch):
    problem, x = optimum(poses=True)
    mine, start = exact_graph(problem), dual_bound(problem, x)
    monkeypatch.setattr(proof, "distances", lambda graph, R: np.zeros(len(R)))
    bound = proven_bound(problem, mine, x, start)
    before = prove(problem, mine, x, start.multipliers)[0]
    less = np.einsum("naa->na", before) - np.einsum("naa->na", bound.multipliers)
    assert np.all((less > 0.0) & (less < 1e-14))


def test_costs_beyond_the_range_of_doubles_are_infinite():
    problem, x = optimum(poses=True)
    far = certpgo.Estimate(x.rotations, 1e170 * np.eye(problem.n, 3))
    assert exact_cost(problem, exact_graph(problem), far) == math.inf


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("length", [2.0**-20, 1.0, 2.0**20])
def test_a_witness_weighs_translations_by_a_typical_arm_and_rotations_alone_by_none(poses, length):
    graph, _, _ = pose_graph(rng_of(1), 6, 3)
    graph = certpgo.PoseGraph(
        graph.rotations_alone, graph.translations * length, graph.tau / length**2
    )
    problem = Quadratic(graph if poses else graph.rotations_alone)
    x = certpgo.solve(problem).estimate
    _, witness = prove(problem, exact_graph(problem), x, problem.multipliers(x))
    assert sorted(witness.order) == list(range(6))
    if not poses:
        assert (witness.pin, witness.exponent) == (0, 0)
        return
    t = problem.with_optimal_translations(x).translations
    assert witness.pin == np.argmin(np.linalg.norm(t - t.mean(axis=0), axis=1))
    typical = np.sqrt(((t - t[witness.pin]) ** 2).sum(axis=1).mean())
    assert witness.exponent == round(math.log2(typical))

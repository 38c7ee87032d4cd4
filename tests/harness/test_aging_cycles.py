"""`reports.studies.aging_cycles`: its bound is the exact one, and below the optimum."""

from fractions import Fraction

import numpy as np
import pytest
from strategies import rng_of

from certpgo import cycle_checker
from certpgo.certify.cycles import prove
from certpgo.graph import Estimate, RotationGraph
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from reports.studies.aging_cycles import (
    ABOUT,
    OUT,
    Left,
    optimum,
    passing,
    prefix,
    rows,
    turned,
    way_back,
)

CHORDS = [[0, 3], [2, 5], [1, 6], [4, 9], [7, 9], [3, 11]]


@pytest.fixture(scope="module")
def stream():
    """A chain in space with chords, in no order."""
    rng = rng_of(0)
    edges = rng.permutation(np.vstack([np.c_[np.arange(11), np.arange(1, 12)], CHORDS]))
    truth = so.random(rng, 12, 3)
    i, j = edges.T
    noise = so.exp(0.15 * rng.standard_normal((len(edges), 3)))
    measured = np.swapaxes(truth[i], 1, 2) @ truth[j] @ noise
    return RotationGraph(12, edges, measured, rng.uniform(0.5, 2.0, len(edges)))


@pytest.fixture(scope="module")
def old(stream):
    """A proof of its first nodes."""
    problem, here = optimum(prefix(stream, 8))
    proof = prove(problem, here)
    assert proof.proven
    return proof, problem.graph.num_edges, here


def test_the_bound_is_the_exact_one(stream, old):
    """By fractions, with rotations that are off and measurements that the proof does not know."""
    proof, _, first = old
    problem, here = optimum(prefix(stream, 10))
    off = so.exp(0.01 * rng_of(1).standard_normal((10, 3)))
    moved = Estimate(turned(here, first).rotations @ off)
    graph, given = problem.graph, prove(problem, moved).rotations
    q = quaternion.to_write(graph.rotations).tolist()
    edges = [
        (i, j, cycle_checker.whole(turn), Fraction(kappa))
        for (i, j), turn, kappa in zip(graph.edges.tolist(), q, graph.kappa.tolist(), strict=True)
    ]
    unit = 1 / Fraction(2) ** proof.bits
    upper, lower = cycle_checker.bounds(edges, dict(enumerate(given)), proof.walks, unit)
    assert lower > 0
    loss = Left.of(proof, problem, moved).loss()
    assert loss == pytest.approx(float(upper - lower), rel=1e-8)


@pytest.mark.parametrize("far", [0.0, 0.02, 0.2])
def test_bounds_are_below_the_optimum(stream, old, far):
    proof, edges, first = old
    problem, here = optimum(prefix(stream, 12))
    moved = Estimate(
        turned(here, first).rotations @ so.exp(far * rng_of(2).standard_normal((12, 3)))
    )
    left = Left.of(proof, problem, moved)
    closed = left.closed(problem.graph, edges)
    best = problem.cost(here)
    for found in (left, closed):
        assert problem.cost(moved) - found.loss() <= best * (1.0 + 1e-12)
    if not far:
        assert closed.loss() < left.loss()
        # What is left at a stationary point is a flow without sources.
        sums = np.zeros((12, 3))
        for at, sign in zip(problem.graph.edges.T, (-1.0, 1.0), strict=True):
            np.add.at(sums, at, sign * closed.torques)
        assert np.abs(sums).max() < 1e-9


def test_new_cycles_pass_and_close(stream):
    graph = prefix(stream, 12)
    edges, signs = way_back(graph, graph.num_edges - 1)
    ends = np.where(signs[:, None] > 0, graph.edges[edges], graph.edges[edges][:, ::-1])
    assert (ends[:, 1] == np.roll(ends[:, 0], -1)).all()
    spare, torque = rng_of(3).uniform(0.1, 3.0, 6), 0.7
    w = passing(spare, torque)
    assert np.ptp(w / spare) < 1e-12
    u = w[0]
    for spring in w[1:-1]:
        assert u + spring > 0.0
        u = (u * spring - torque**2) / (u + spring)
    assert 0.0 <= u + w[-1] < 1e-6


def test_nothing_is_lost_before_a_closure(stream):
    found = list(rows(stream))
    assert found[0][1] == "0"
    assert float(found[0][3]) < 1e-12
    assert float(found[-1][3]) > float(found[-1][4]) > 1e-9
    assert OUT.read_text().startswith(ABOUT)

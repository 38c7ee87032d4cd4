"""Coordinate descent on the semidefinite relaxation: the paper's step and the gap."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.io.datasets.synthetic import cycle, random_graph, winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods._coordinates import Coordinates, _coloring, stacked
from certpgo.optimize.methods._relaxed import ALONE
from certpgo.optimize.methods.block_coordinate_descent import BlockCoordinateDescent
from certpgo.optimize.methods.rotation_coordinate_descent import RotationCoordinateDescent
from certpgo.optimize.solution import Status

ORDERS = ["colors", "cyclic", "random"]


def dense_step(problem, Y, k):
    """Algorithm 1's step for block k by eq. 47, with W the block column of -Rtilde."""
    d, n = problem.d, problem.n
    L = problem.matrix.toarray()
    Rtilde = np.kron(np.diag(problem.node_weights), np.eye(d)) - L
    inside = np.arange(k * d, k * d + d)
    outside = np.setdiff1d(np.arange(n * d), inside)
    B, W = Y[np.ix_(outside, outside)], -Rtilde[np.ix_(outside, inside)]
    values, U = np.linalg.eigh(W.T @ B @ W)
    root = np.where(values > 1e-12, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    S = -B @ W @ (U * root) @ U.T
    Y = Y.copy()
    Y[np.ix_(outside, inside)], Y[np.ix_(inside, outside)] = S, S.T
    return Y


@given(seeds, dimensions, st.sampled_from(ORDERS[:2]))
@settings(max_examples=20)
def test_a_sweep_is_the_papers(seed, d, order):
    graph, _ = rotation_graph(rng_of(seed), 6, d)
    problem = Quadratic(graph)
    point = Coordinates(problem, np.eye(6 * d), order, rng_of(0))
    before, Y = point.evaluate()[0], np.eye(6 * d)
    blocks = range(6)
    if order == "colors":
        blocks = np.argsort(_coloring(6, graph.edges), kind="stable")
    fallen, _ = point.sweep()
    for k in blocks:
        Y = dense_step(problem, Y, int(k))
    assert pytest.approx(Y, abs=1e-10) == point.X @ point.X.T
    after = point.evaluate()[0]
    assert after == pytest.approx(np.trace(problem.matrix.toarray() @ Y), rel=1e-10)
    assert fallen == pytest.approx(before - after, rel=1e-9)
    assert fallen >= 0.0


@given(seeds)
def test_colors_differ_along_edges(seed):
    graph, _ = rotation_graph(rng_of(seed), 9, 2)
    colors = _coloring(9, graph.edges)
    i, j = graph.edges.T
    assert (colors[i] != colors[j]).all()
    assert set(colors) == set(range(colors.max() + 1))


@given(seeds, dimensions)
@settings(max_examples=30)
def test_descends_to_the_certified_optimum(seed, d):
    graph, _ = rotation_graph(rng_of(seed), 8, d, noise=0.2)
    best = certpgo.solve(graph)
    found = BlockCoordinateDescent(tolerance=1e-9).solve(Quadratic(graph))
    assert found.status is Status.CONVERGED
    assert found.relaxation.value == pytest.approx(best.cost, rel=1e-8)
    assert found.cost == pytest.approx(best.cost, rel=1e-6)
    assert found.lower_bound <= best.cost * (1 + 1e-12)
    assert found.lower_bound >= best.cost * (1 - 2e-9)
    trace = [step.cost for step in found.trace]
    assert all(b <= a + 1e-9 * abs(a) for a, b in pairwise(trace))
    blocks = found.relaxation.rows
    gram = np.einsum("nra,nrb->nab", blocks, blocks)
    assert gram == pytest.approx(np.tile(np.eye(d), (8, 1, 1)), abs=1e-9)


def test_a_loose_relaxation_stays_below_every_estimate():
    graph, _ = rotation_graph(rng_of(4), 7, 3, extra=10, noise=1.5)
    best = certpgo.solve(graph)
    found = BlockCoordinateDescent().solve(Quadratic(graph))
    assert found.status is Status.CONVERGED
    assert found.relaxation.rank > 3
    assert found.note.startswith("duality gap within 1e-06, relaxation ")
    assert found.note.endswith(f"rank {found.relaxation.rank}")
    assert found.relaxation.value < best.cost * (1 - 1e-4)
    assert found.lower_bound == pytest.approx(best.certificate.lower_bound, rel=1e-5)
    assert found.cost >= best.cost


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("d", [2, 3])
def test_the_same_descent_at_rank_d(order, d):
    rng = rng_of(7)
    graph, _ = rotation_graph(rng, 12, d, noise=0.5)
    problem, start = Quadratic(graph), Estimate(so.random(rng, 12, d))
    sweeps = {"max_iterations": 5, "order": order}
    dense = BlockCoordinateDescent(tolerance=0.0, **sweeps).solve(problem, initial=start)
    sparse = RotationCoordinateDescent(tolerance=0.0, **sweeps).solve(problem, initial=start)
    assert [s.cost for s in dense.trace] == pytest.approx([s.cost for s in sparse.trace], rel=1e-12)
    assert dense.cost == pytest.approx(sparse.cost, rel=1e-9)


@pytest.mark.parametrize("noise", [0.8, 1.2, 3.0])
def test_what_has_converged_at_rank_d_is_stationary(noise):
    for seed in range(15):
        problem = Quadratic(random_graph(12, 4.0, noise, rng_of(seed)).graph)
        found = RotationCoordinateDescent().solve(problem)
        assert found.status is Status.CONVERGED
        assert problem.stationarity(found.estimate) < 1e-6
        assert found.trace[-1].cost == pytest.approx(found.cost, rel=1e-9)


@given(seeds, dimensions)
def test_steps_at_rank_d_go_from_rotations_to_rotations(seed, d):
    rng = rng_of(seed)
    problem = Quadratic(rotation_graph(rng, 8, d, noise=3.0)[0])
    point = Coordinates(problem, stacked(Estimate(so.random(rng, 8, d))), "colors", rng)
    for _ in range(3):
        before = point.evaluate()[0]
        fallen, _ = point.sweep()
        assert so.determinants(point.blocks) == pytest.approx(np.ones(8))
        assert fallen == pytest.approx(before - point.evaluate()[0], rel=1e-9, abs=1e-9)
        assert fallen >= 0.0


@pytest.mark.parametrize("winding", [1, 2])
def test_a_wound_up_cycle_holds_rank_d_and_not_the_identity(winding):
    instance, wound = winding_cycle(20, 0.1, winding)
    problem = Quadratic(instance.graph)
    stuck = RotationCoordinateDescent().solve(problem, initial=wound)
    assert stuck.cost == pytest.approx(problem.cost(wound), rel=1e-9)
    free = BlockCoordinateDescent().solve(problem)
    assert free.cost == pytest.approx(8 * 20 * np.sin(0.1 / 40) ** 2, rel=1e-3)


@pytest.mark.parametrize("order", ORDERS)
def test_every_order_reaches_the_optimum(order):
    instance = random_graph(30, 6.0, 0.3, rng_of(1))
    problem = Quadratic(instance.graph)
    found = BlockCoordinateDescent(order=order).solve(problem)
    assert found.cost == pytest.approx(certpgo.solve(instance.graph).cost, rel=1e-5)
    sparse = RotationCoordinateDescent(order=order).solve(problem)
    assert problem.stationarity(sparse.estimate) < 1e-6


def test_dimensions_that_y_does_not_feel_are_left_out():
    problem = Quadratic(cycle(20, 0.2, rng_of(0)).graph)
    found = BlockCoordinateDescent().solve(problem)
    assert found.status is Status.CONVERGED
    assert found.relaxation.rows.shape[1] < 30
    assert found.relaxation.value == pytest.approx(certpgo.solve(problem.graph).cost, rel=1e-6)


def test_exact_data_cost_nothing():
    graph, _ = rotation_graph(rng_of(3), 6, 3, noise=0.0)
    found = BlockCoordinateDescent().solve(Quadratic(graph))
    assert found.status is Status.CONVERGED
    assert found.cost < 1e-10 * Quadratic(graph).scale


@given(seeds, dimensions)
@settings(max_examples=10)
def test_the_scale_of_the_weights_changes_nothing(seed, d):
    graph, _ = rotation_graph(rng_of(seed), 6, d)
    one = BlockCoordinateDescent().solve(Quadratic(graph))
    other = BlockCoordinateDescent().solve(Quadratic(graph.with_weights(2.0**30 * graph.kappa)))
    assert other.iterations == one.iterations
    assert other.cost == pytest.approx(2.0**30 * one.cost, rel=1e-12)


def test_poses_are_completed_by_translations():
    graph, _, _ = pose_graph(rng_of(5), 8, 3)
    for solver in (BlockCoordinateDescent(), RotationCoordinateDescent()):
        found = solver.solve(Quadratic(graph))
        assert found.estimate.translations.shape == (8, 3)
        assert found.cost == pytest.approx(Quadratic(graph).cost(found.estimate))
        assert found.note.endswith(ALONE)


def test_a_missing_direction_is_completed():
    # Two measurements that disagree by half a turn leave a block without a direction.
    R = np.stack([np.eye(2), -np.eye(2)])
    graph = certpgo.RotationGraph(3, [[0, 1], [2, 1]], R, np.ones(2))
    problem = Quadratic(graph)
    start = Estimate(np.tile(np.eye(2), (3, 1, 1)))
    point = Coordinates(problem, stacked(start), "cyclic", rng_of(0))
    point.sweep()
    blocks = point.X.reshape(3, 2, 2)
    gram = blocks @ np.swapaxes(blocks, 1, 2)
    assert gram == pytest.approx(np.tile(np.eye(2), (3, 1, 1)))


def test_settings_are_checked():
    with pytest.raises(SpecError, match="order"):
        BlockCoordinateDescent(order="backwards")
    with pytest.raises(SpecError, match="order"):
        RotationCoordinateDescent(order="backwards")
    with pytest.raises(SpecError, match="tolerance"):
        BlockCoordinateDescent(tolerance=-1.0)


def test_a_dense_start_that_does_not_fit_is_refused():
    n = 8000
    edges = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    graph = certpgo.RotationGraph(n, edges, np.tile(np.eye(3), (n - 1, 1, 1)), np.ones(n - 1))
    with pytest.raises(SpecError, match="rotation_coordinate_descent"):
        BlockCoordinateDescent().solve(Quadratic(graph))


@given(seeds, dimensions)
def test_inverse_square_roots(seed, d):
    rng = rng_of(seed)
    A = rng.standard_normal((5, d, d))
    M = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(d)
    M[0] = 2.0 * np.eye(d)
    root = so.inverse_square_roots(M)
    assert root @ M @ root == pytest.approx(np.tile(np.eye(d), (5, 1, 1)), abs=1e-9)
    assert root == pytest.approx(np.swapaxes(root, 1, 2))

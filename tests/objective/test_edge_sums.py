"""The compiled sums over edges against their NumPy forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, general_graph, pose_graph, rng_of, rotation_graph, seeds

from certpgo.certify.assembly_errors import _lever_sums
from certpgo.certify.multipliers import Shifted
from certpgo.errors import GraphError
from certpgo.graph import Estimate
from certpgo.graph.edges import symmetric
from certpgo.graph.relaxed_point import Lift, lifted
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.linalg.blocks import BlockPattern, diagonal_places, pinned, scatter_sum
from certpgo.objective import operators, residuals
from certpgo.objective.edge_sums import LARGEST_RANK, EdgeSums
from certpgo.objective.quadratic import Quadratic

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")


def in_numpy(function, *args):
    """What a function returns without the compiled kernel."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "AVAILABLE", False)
        return function(*args)


def graphs(seed, d):
    """A graph of rotations, of poses, and of general edges, each with a point of it."""
    rng = rng_of(seed)
    poses, R, t = pose_graph(rng, 7, d)
    yield poses.rotations_alone, Estimate(R)
    yield poses, Estimate(R, t)
    general, R, t = general_graph(rng, 7, d)
    yield general, Estimate(R, t)
    yield general.rotations_alone, Estimate(R)


@settings(max_examples=40)
@given(seeds, dimensions, st.integers(0, 3))
def test_gradients_and_terms(seed, d, more):
    for graph, point in graphs(seed, d):
        lift = lifted(point, d + more)
        U = np.linalg.qr(rng_of(seed).standard_normal((d + more, d + more)))[0]
        t = lift.translations
        lift = Lift(U @ lift.rotations, None if t is None else t @ U.T)
        expected = operators.gradient(graph, lift)
        sums = EdgeSums(graph)
        found = sums.gradient(lift)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)
        np.testing.assert_array_equal(sums.terms(lift), found[1])


@settings(max_examples=40)
@given(seeds, dimensions)
def test_derivatives_along_rotations(seed, d):
    for graph, point in graphs(seed, d):
        turning, moving = rng_of(seed).uniform(0.5, 2.0, (2, graph.num_nodes))
        turning[2] = np.inf  # as of a point
        for weights in ((turning, moving), (turning, None)):
            if not graph.has_positions:
                weights = turning, None
            expected = operators.first_order(graph, point, *weights)
            found = EdgeSums(graph).first_order(point, *weights)
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)


def test_a_stationarity_that_is_no_number_is_not_hidden():
    graph, R, t = pose_graph(rng_of(1), 5, 3)
    t[3, 0] = np.nan
    ones = np.ones(5)
    assert np.isnan(EdgeSums(graph).first_order(Estimate.trusted(R, t), ones, ones)[3])


@settings(max_examples=40)
@given(seeds, dimensions)
def test_blocks_of_hessians(seed, d):
    for graph, point in graphs(seed, d):
        multipliers = symmetric(rng_of(seed).standard_normal(point.rotations.shape))
        sums = operators.NodeSums.of(graph)
        expected = (
            operators.hessian_diagonal(sums, point.rotations, multipliers),
            operators.couplings(graph, point.rotations),
        )
        found = EdgeSums(graph).hessian(point.rotations, multipliers)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)


@settings(max_examples=40)
@given(seeds, dimensions)
def test_sizes_of_residuals(seed, d):
    for graph, point in graphs(seed, d):
        sums, R = EdgeSums(graph), point.rotations
        expected = residuals.residual_angles(graph, R)
        np.testing.assert_allclose(sums.angles(R), expected, rtol=0, atol=1e-12)
        if graph.is_general:
            continue
        expected = residuals.residual_norms(graph, point)
        for one, other in zip(sums.residuals(point), expected, strict=True):
            if other is not None:
                np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)


def test_angles_where_no_rotation_is_measured():
    graph, R, t = pose_graph(rng_of(2), 6, 3)
    kappa = graph.kappa.copy()
    kappa[3] = 0.0
    assert EdgeSums(graph.with_weights(kappa)).angles(R)[3] == 0.0
    edges = EdgeSums(graph)._measured
    angles = np.empty(graph.num_edges)
    for wrong in ((edges, 3, R[1:], angles), (edges, 3, R, angles[1:])):
        with pytest.raises(ValueError, match="another graph"):
            compiled.kernel.angles(*wrong)
    rows = R, t, angles, angles.copy()
    for place in range(4):
        wrong = [*rows[:place], rows[place][:-1], *rows[place + 1 :]]
        with pytest.raises(ValueError, match="another graph"):
            compiled.kernel.residuals(edges, 3, *wrong)
    with pytest.raises(ValueError, match="another graph"):
        compiled.kernel.residuals(edges, 3, R, None, *rows[2:])


@given(seeds, dimensions, st.integers(-200, 2), st.booleans())
def test_turned_rotations(seed, d, power, left):
    rng = rng_of(seed)
    R, v = so.random(rng, 5, d), 10.0**power * rng.standard_normal((5, so.tangent_dim(d)))
    v[3] = 0.0
    expected = so.exp(v) @ R if left else R @ so.exp(v)
    np.testing.assert_allclose(so.turned(R, v, left=left), expected, rtol=0, atol=1e-14)
    with pytest.raises(ValueError, match="as many rotations as tangents"):
        so.turned(R, v[:-1])


def test_large_ranks_are_left_to_numpy():
    graph, R = rotation_graph(rng_of(0), 5, 3)
    lift = lifted(Estimate(R), LARGEST_RANK + 1)
    low, high = EdgeSums(graph).gradient(Estimate(R)), EdgeSums(graph).gradient(lift)
    np.testing.assert_allclose(high[0][:, :3], low[0], rtol=1e-12, atol=1e-12)
    for rank in (40, 2**30):
        with pytest.raises(ValueError, match="rank above 32"):
            compiled.kernel.gradient(
                EdgeSums(graph).edges, 3, rank, np.zeros((5, 40, 3)), None, None, np.zeros(15)
            )


def test_poses_need_translations():
    graph, R, _ = pose_graph(rng_of(0), 5, 3)
    with pytest.raises(GraphError, match="no translations"):
        EdgeSums(graph).gradient(Estimate(R))


@settings(max_examples=40)
@given(seeds, st.integers(1, 6), st.booleans())
def test_block_matrices(seed, b, parallel):
    rng = rng_of(seed)
    edges = np.array([(k // 2, k) for k in range(1, 9)] + [(0, 5), (7, 3)])
    if parallel:
        edges = np.concatenate([edges, edges[3:6, ::-1], edges[:2]])
    P, m = BlockPattern(9, edges), len(edges)
    diagonal, upper = rng.standard_normal((9, b, b)), rng.standard_normal((m, b, b))
    diagonal += np.swapaxes(diagonal, 1, 2)
    dense = np.zeros((9 * b, 9 * b))
    for i in range(9):
        dense[i * b : i * b + b, i * b : i * b + b] = diagonal[i]
    for (i, j), block in zip(edges, upper, strict=True):
        dense[i * b : i * b + b, j * b : j * b + b] += block
        dense[j * b : j * b + b, i * b : i * b + b] += block.T
    with pytest.MonkeyPatch.context() as patch:
        for here in (True, False):
            patch.setattr(compiled, "AVAILABLE", here)
            A = BlockPattern(9, edges).assemble(diagonal, upper)
            np.testing.assert_allclose(A.toarray(), dense, rtol=1e-14, atol=1e-14)
            assert A.has_sorted_indices
            np.testing.assert_array_equal(A.data[diagonal_places(A)], A.diagonal())
            less = BlockPattern(9, edges)
            S = less.subtract(less.assemble(diagonal, upper), diagonal[:, :1, :1]).toarray()
            last = np.arange(b - 1, 9 * b, b)
            np.testing.assert_allclose(
                S[last, last], dense[last, last] - diagonal[:, 0, 0], rtol=0, atol=1e-14
            )
            cut = pinned(A, np.array([0, 4])).toarray()
            expected = dense.copy()
            for k in (0, 4):
                expected[k, :] = expected[:, k] = 0.0
                expected[k, k] = dense[k, k]
            np.testing.assert_allclose(cut, expected, rtol=1e-14, atol=1e-14)
    assert P.layout(b) is P.layout(b)


@given(seeds, st.integers(0, 12))
def test_occupied_blocks(seed, m):
    edges = rng_of(seed).permuted(np.array([np.arange(6)] * m).reshape(m, 6), axis=1)[:, :2]
    found = BlockPattern(6, edges)._slots
    expected = in_numpy(lambda: BlockPattern(6, edges)._slots)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    assert found[0].dtype == expected[0].dtype == np.int32


def test_blocks_off_another_diagonal():
    indptr, own, data = np.array([0, 1, 2]), np.array([0, 1]), np.zeros(8)
    values = np.ones((2, 2, 2))
    compiled.kernel.subtract(indptr, own, 2, values, 2, data)
    assert (data == -1.0).all()
    for wrong in (
        (indptr[:-1], own, 2, values, 2, data),
        (indptr, own + 1, 2, values, 2, data),
        (indptr, own[::-1].copy(), 2, values, 2, data),
        (indptr, own, 2, values[1:], 2, data),
        (indptr, own, 1, values, 2, data),
        (indptr, own, 2, values, 2, data[1:]),
    ):
        with pytest.raises(ValueError, match="another pattern"):
            compiled.kernel.subtract(*wrong)


def test_occupied_blocks_of_other_nodes():
    indptr, room = np.empty(4, dtype=np.int64), np.empty(5, dtype=np.int64)
    for wrong in (
        (np.array([[0, 3]]), indptr, room, room),
        (np.array([[0, -1]]), indptr, room, room),
        (np.array([[0, 1]]), indptr[:-1], room, room),
        (np.array([[0, 1]]), indptr, room[:-1], room),
        (np.array([[0, 1]]), indptr, room, room[:-1]),
    ):
        with pytest.raises(ValueError, match="other nodes"):
            compiled.kernel.blocks(*wrong)


def test_a_matrix_without_a_diagonal_entry():
    A = BlockPattern(3, np.array([[0, 1], [1, 2]])).assemble(np.ones((3, 1, 1)), np.ones((2, 1, 1)))
    A.indices[0] = 1
    with pytest.raises(ValueError, match="not stored"):
        diagonal_places(A)


@given(seeds, st.integers(1, 3))
def test_sums_by_index(seed, columns):
    rng = rng_of(seed)
    index, values = rng.integers(0, 6, 20), rng.standard_normal((20, columns))
    expected = np.zeros((6, columns))
    np.add.at(expected, index, values)
    np.testing.assert_array_equal(scatter_sum(index, values, 6), expected)


def test_sums_stay_in_range():
    for wrong in (-1, 6):
        with pytest.raises(IndexError, match="out of range"):
            scatter_sum(np.array([0, wrong]), np.ones((2, 3)), 6)


@given(seeds, dimensions, st.integers(-18, 1))
def test_the_matrix_farthest_from_a_rotation(seed, d, power):
    rng = rng_of(seed)
    R = so.random(rng, 9, d)
    R[4] += 10.0**power * rng.standard_normal((d, d))
    with pytest.MonkeyPatch.context() as patch:
        found = so.worst_defect(R)
        patch.setattr(compiled, "AVAILABLE", False)
        expected = so.worst_defect(R)
    assert found[1] == pytest.approx(expected[1], rel=1e-9, abs=2e-15)
    assert found[0] == expected[0] or expected[1] < 1e-14


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e200])
def test_what_is_no_matrix_is_infinitely_far(wrong):
    R = np.tile(np.eye(3), (4, 1, 1))
    R[2, 0, 1] = wrong
    assert so.worst_defect(R) == in_numpy(so.worst_defect, R) == (2, np.inf)
    R = np.tile(np.eye(2), (4, 1, 1))
    R[3, 0, 0] = -1.0
    assert so.worst_defect(R) == in_numpy(so.worst_defect, R) == (3, np.inf)
    assert so.worst_defect(R[:0]) == (0, 0.0)


@settings(max_examples=40)
@given(seeds, dimensions, st.integers(0, 2))
def test_multipliers_less_a_shift(seed, d, more):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 7, d)
    point = lifted(Estimate(R, t), d + more)
    shifted = Shifted.of(Quadratic(graph), point)
    demand = rng.uniform(0.0, 1.0, len(shifted.weights))
    found = shifted.less(0.3, demand)
    np.testing.assert_allclose(found, in_numpy(shifted.less, 0.3, demand), rtol=0, atol=1e-10)
    alone = Shifted.of(Quadratic(graph.rotations_alone), Estimate(R))
    np.testing.assert_array_equal(alone.less(0.3, demand), in_numpy(alone.less, 0.3, demand))


@given(seeds, dimensions)
def test_sums_of_levers(seed, d):
    for graph, _ in graphs(seed, d):
        if graph.has_positions:
            found, expected = _lever_sums(graph), in_numpy(_lever_sums, graph)
            np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_multipliers_of_other_nodes():
    one, nodes, gauge = np.tile(np.eye(3), (4, 1, 1)), np.arange(4), np.eye(3)
    for wrong in (
        (gauge, one[1:], nodes, 3),
        (gauge, one, nodes + 1, 3),
        (gauge[1:], one, nodes, 3),
        (gauge, one, nodes, 4),
        (gauge, one, nodes, 2**16),
        (np.eye(33), np.zeros((4, 33, 3)), nodes, 3),
    ):
        with pytest.raises(ValueError, match="other nodes"):
            compiled.kernel.lessen(0.1, *wrong, one.copy())
    edges = np.array([[0, 4]]), one[:1], None, np.ones(1), np.ones(1), np.ones((1, 3)), None
    for sums in (np.zeros((4, 4)), np.zeros((5, 3))):
        with pytest.raises(ValueError, match="graph of poses"):
            compiled.kernel.lever_sums(edges, 3, sums)

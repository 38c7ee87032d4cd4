"""Covariances in graphs with landmarks: closed forms, dense inverses, laws, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import definite, dimensions, point_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, InputError, Marginals, NumericalError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import of_positions
from certpgo.linalg import rotations as so
from certpgo.linalg.rotations import tangent_dim
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.g2o import G2oCost
from certpgo.objective.quadratic import Quadratic

few = settings(max_examples=12)


def problem_at(seed, d, under):
    """A graph with landmarks under F or under g2o's cost, its truth, and two poses."""
    rng = rng_of(seed)
    graph, truth = point_graph(rng, 4, 3, d)
    anchor, other = rng.permutation(graph.pose_nodes)[:2].tolist()
    if under == "chordal":
        return Quadratic(graph), truth, anchor, other
    m, alone = graph.num_edges, graph.kappa == 0.0
    information = definite(rng, m, d + tangent_dim(d))
    information[alone] = of_positions(definite(rng, m, d)[alone])
    problem = Sum(graph.with_information(information), G2oCost)
    return problem, truth, anchor, other


def points_of(problem):
    return problem.graph.is_point


def residuals(problem, estimate):
    """Residuals whose squares add up to half the Gauss-Newton model's cost."""
    i, j = problem.graph.edges.T
    R, t = estimate.rotations, estimate.translations
    if isinstance(problem, Sum):
        e = np.zeros(problem.graph.information_matrices.shape[:2])
        for rows, term in problem.terms:
            own = term.residuals(*term.relative(estimate))
            e[rows, : own.shape[1]] = own
        d, roots = problem.d, np.zeros_like(problem.graph.information_matrices)
        for k, full in enumerate(problem.graph.information_matrices):
            size = len(full) if full[d:].any() else d
            roots[k, :size, :size] = np.linalg.cholesky(full[:size, :size]).T
        return (roots @ e[:, :, None]).ravel()
    rotation = problem.rotation.graph
    E = np.swapaxes(R[i], 1, 2) @ R[j] - rotation.rotations
    E *= np.sqrt(rotation.kappa)[:, None, None]
    r = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) - problem.graph.translations
    return np.r_[E.ravel(), (np.sqrt(problem.graph.tau)[:, None] * r).ravel()]


def moved(estimate, points, node, step):
    """A pose moves in its own frame, a point in the world's."""
    R, t, d = estimate.rotations.copy(), estimate.translations.copy(), estimate.d
    t[node] += step if points[node] else R[node] @ step[:d]
    if not points[node]:
        R[node] = R[node] @ so.exp(step[d:])
    return Estimate(R, t)


def dense(problem, estimate, anchor):
    """The inverse of J^T J by differences, and the rows of each node."""
    d, h, points = problem.d, 1e-6, points_of(problem)
    columns, rows, count = [], [], 0
    for node in range(problem.n):
        size = d if points[node] else d + tangent_dim(d)
        rows.append(np.arange(count, count + size))
        count += size
        for step in h * np.eye(size):
            ahead, behind = (moved(estimate, points, node, s) for s in (step, -step))
            columns.append((residuals(problem, ahead) - residuals(problem, behind)) / (2.0 * h))
    J, free = np.stack(columns, axis=1), np.ones(count, dtype=bool)
    free[rows[anchor]] = False
    C = np.zeros((count, count))
    C[np.ix_(free, free)] = np.linalg.inv(J[:, free].T @ J[:, free])
    return C, rows


def test_a_landmark_in_closed_form():
    """A step ahead, a landmark seen beyond: the turn moves the landmark by its lever arm."""
    edges, R = np.array([[0, 1], [1, 2]]), np.tile(np.eye(2), (2, 1, 1))
    rotation = RotationGraph(3, edges, R, np.array([50.0, 0.0]))  # 100 per square radian
    steps, tau = np.array([[1.0, 0.0], [2.0, 0.0]]), np.array([25.0, 100.0])
    graph = PoseGraph(rotation, steps, tau, points=[False, False, True])
    t = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])
    truth = Estimate(np.tile(np.eye(2), (3, 1, 1)), t)
    marginals = Marginals(Quadratic(graph), truth)
    expected = np.diag([0.04 + 0.01, 0.04 + 0.01 + 4.0 * 0.01])
    np.testing.assert_allclose(marginals.covariance(2), expected, atol=1e-15)
    np.testing.assert_allclose(marginals.relative(1, 2), 0.01 * np.eye(2), atol=1e-15)
    assert marginals.covariances.shape == (3, 3, 3)
    np.testing.assert_array_equal(marginals.covariances[2, 2], 0.0)
    np.testing.assert_array_equal(marginals.covariances[2, :, 2], 0.0)


@given(seeds, dimensions, st.sampled_from(["chordal", "g2o"]))
@few
def test_blocks_of_a_dense_inverse(seed, d, under):
    problem, estimate, anchor, other = problem_at(seed, d, under)
    marginals, (C, rows) = Marginals(problem, estimate, anchor), dense(problem, estimate, anchor)
    close = {"rtol": 1e-4, "atol": 1e-5 * np.abs(C).max()}
    for node, own in enumerate(rows):
        expected = C[np.ix_(own, own)]
        size = len(own)
        np.testing.assert_allclose(marginals.covariance(node), expected, **close)
        np.testing.assert_allclose(marginals.covariances[node, :size, :size], expected, **close)
        np.testing.assert_array_equal(marginals.covariances[node, size:], 0.0)
    point = int(np.flatnonzero(points_of(problem))[0])
    chosen = np.concatenate([rows[point], rows[other], rows[anchor]])
    joint = marginals.joint(point, other, anchor)
    np.testing.assert_allclose(joint, C[np.ix_(chosen, chosen)], **close)


@given(seeds, dimensions, st.sampled_from(["chordal", "g2o"]))
@few
def test_points_relative_to_poses_do_not_depend_on_the_anchor(seed, d, under):
    problem, estimate, anchor, other = problem_at(seed, d, under)
    found, there = Marginals(problem, estimate, anchor), Marginals(problem, estimate, other)
    back = estimate.rotations[other].T
    for point in np.flatnonzero(points_of(problem)).tolist():
        expected = back @ there.covariance(point) @ back.T
        close = {"rtol": 1e-7, "atol": 1e-9 * np.abs(expected).max()}
        np.testing.assert_allclose(found.relative(other, point), expected, **close)
        np.testing.assert_allclose(there.relative(other, point), expected, **close)
    expected = there.covariance(anchor)
    atol = 1e-9 * np.abs(expected).max()
    np.testing.assert_allclose(found.relative(other, anchor), expected, rtol=1e-7, atol=atol)


@given(seeds, dimensions)
@few
def test_frames_and_units(seed, d):
    problem, estimate, anchor, _ = problem_at(seed, d, "chordal")
    points = points_of(problem)
    expected = Marginals(problem, estimate, anchor).covariances
    S, atol = so.random(rng_of(1), 1, d)[0], 1e-9 * np.abs(expected).max()
    elsewhere = estimate.moved(S, np.full(d, 7.0))
    found = Marginals(problem, elsewhere, anchor).covariances
    np.testing.assert_allclose(found[~points], expected[~points], rtol=1e-7, atol=atol)
    turned = S @ expected[points, :d, :d] @ S.T  # those of points are in the world's frame
    np.testing.assert_allclose(found[points, :d, :d], turned, rtol=1e-7, atol=atol)
    found = Marginals(problem.scaled(4.0), estimate, anchor).covariances
    np.testing.assert_allclose(4.0 * found, expected, rtol=1e-7, atol=atol)
    other = estimate.rotations.copy()
    other[points] = so.random(rng_of(2), int(points.sum()), d)
    again = Marginals(problem, Estimate(other, estimate.translations), anchor).covariances
    np.testing.assert_allclose(again, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_what_is_refused():
    problem, estimate, anchor, other = problem_at(0, 3, "chordal")
    point = int(np.flatnonzero(points_of(problem))[0])
    with pytest.raises(InputError, match=f"node {point} is a point; the anchor must be a pose"):
        Marginals(problem, estimate, point)
    with pytest.raises(InputError, match=f"node {point} is a point, which has no frame"):
        Marginals(problem, estimate, anchor).relative(point, other)
    with pytest.raises(InputError, match="is not among"):
        Marginals(problem, estimate, anchor).relative(anchor, 99)


def test_a_pose_that_only_sees_one_point_is_not_determined():
    edges, R = np.array([[0, 1], [2, 1], [0, 2]]), np.tile(np.eye(2), (3, 1, 1))
    rotation = RotationGraph(3, edges, R, np.zeros(3))
    steps, tau = np.array([[1.0, 0.0], [2.0, 0.0], [1.0, 1.0]]), np.array([1.0, 1.0, 1e-18])
    graph = PoseGraph(rotation, steps, tau, points=[False, True, False])
    estimate = Estimate(np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2)))
    with pytest.raises(NumericalError, match="do not determine"):
        _ = Marginals(Quadratic(graph), estimate).covariances


def test_in_an_answer():
    graph, _ = point_graph(rng_of(4), 5, 6, 3)
    answer = certpgo.solve(graph)
    point = int(np.flatnonzero(graph.is_point)[0])
    anchor = 0 if not graph.is_point[0] else int(graph.pose_nodes[0])
    expected = Marginals(answer.problem, answer.estimate, anchor).covariance(point)
    assert expected.shape == (3, 3)
    if anchor == 0:
        np.testing.assert_array_equal(answer.covariance(point), expected)

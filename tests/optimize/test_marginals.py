"""Covariances: closed forms, dense inverses, GTSAM's, and laws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, general_graph, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import Estimate, InputError, Marginals, NumericalError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective import operators
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic

few = settings(max_examples=15)


def moved(estimate, i, step):
    """The estimate with node i moved in its own frame."""
    R, t, d = estimate.rotations.copy(), estimate.translations, estimate.d
    q = so.tangent_dim(d)
    if t is not None:
        t = t.copy()
        t[i] += R[i] @ step[:d]
    R[i] = R[i] @ so.exp(step[-q:])
    return Estimate(R, t)


def residuals(problem, estimate):
    """Residuals whose squares add up to F/2 where F is theirs doubled."""
    rotation, (i, j) = problem.rotation.graph, problem.graph.edges.T
    R, t = estimate.rotations, estimate.translations
    E = np.swapaxes(R[i], 1, 2) @ R[j] - rotation.rotations
    E *= np.sqrt(rotation.kappa)[:, None, None]
    if t is None:
        return E.ravel()
    r = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) - problem.graph.translations
    return np.r_[E.ravel(), (np.sqrt(problem.graph.tau)[:, None] * r).ravel()]


def dense(problem, estimate, anchor):
    """The inverse of J^T J from differences, without the anchor."""
    h, columns = 1e-6, []
    b = problem.gauss_newton(estimate).shape[0] // problem.n
    for node in range(problem.n):
        for step in h * np.eye(b):
            ahead, behind = (moved(estimate, node, s) for s in (step, -step))
            columns.append((residuals(problem, ahead) - residuals(problem, behind)) / (2.0 * h))
    J = np.stack(columns, axis=1)
    free = np.arange(problem.n * b) // b != anchor
    C = np.zeros((problem.n * b,) * 2)
    C[np.ix_(free, free)] = np.linalg.inv(J[:, free].T @ J[:, free])
    return C.reshape(problem.n, b, problem.n, b).swapaxes(1, 2)


def problem_at(seed, d, poses):
    rng = rng_of(seed)
    n = int(rng.integers(2, 9))
    if poses:
        graph, R, t = pose_graph(rng, n, d)
        return Quadratic(graph), Estimate(R, t), int(rng.integers(n))
    graph, R = rotation_graph(rng, n, d)
    return Quadratic(graph), Estimate(R), int(rng.integers(n))


def test_a_chain_in_closed_form():
    """Two steps ahead: turns add up, and the first turn moves the end by the lever arm."""
    edges, R = np.array([[0, 1], [1, 2]]), np.tile(np.eye(2), (2, 1, 1))
    rotation = RotationGraph(3, edges, R, np.full(2, 50.0))  # 2 kappa = 100 per square radian
    graph = PoseGraph(rotation, np.array([[1.0, 0.0]] * 2), np.full(2, 25.0))
    truth = Estimate(np.tile(np.eye(2), (3, 1, 1)), np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))
    C = Marginals(Quadratic(graph), truth).covariance(2)
    expected = [[0.08, 0.0, 0.0], [0.0, 0.08 + 0.01, 0.01], [0.0, 0.01, 0.02]]
    np.testing.assert_allclose(C, expected, atol=1e-15)


@given(seeds, dimensions, st.booleans())
@few
def test_blocks_of_a_dense_inverse(seed, d, poses):
    problem, estimate, anchor = problem_at(seed, d, poses)
    marginals, C = Marginals(problem, estimate, anchor), dense(problem, estimate, anchor)
    close = {"rtol": 1e-5, "atol": 1e-6 * np.abs(C).max()}
    n = np.arange(problem.n)
    np.testing.assert_allclose(marginals.covariances, C[n, n], **close)
    i, j = n[-1], n[0]
    b = C.shape[-1]
    joint = marginals.joint(i, j).reshape(2, b, 2, b).swapaxes(1, 2)
    np.testing.assert_allclose(joint, C[np.ix_([i, j], [i, j])], **close)
    np.testing.assert_allclose(marginals.covariance(i), C[i, i], **close)


@given(seeds, dimensions, st.booleans())
@few
def test_relative_covariances_do_not_depend_on_the_anchor(seed, d, poses):
    problem, estimate, anchor = problem_at(seed, d, poses)
    i, j = 0, problem.n - 1
    expected = Marginals(problem, estimate, i).covariance(j)
    found = Marginals(problem, estimate, anchor).relative(i, j)
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


@given(seeds, dimensions)
@few
def test_general_edges_bend_the_cost_of_exact_measurements(seed, d):
    rng = rng_of(seed)
    graph, R, t = general_graph(rng, 5, d)
    estimate = Estimate(R, t)
    exact = Quadratic(operators.explained(graph, estimate))
    step = 1e-5 * rng.standard_normal((5, d + so.tangent_dim(d)))
    ahead = estimate
    for node in range(5):
        ahead = moved(ahead, node, step[node])
    world = step.copy()
    world[:, :d] = np.einsum("nab,nb->na", R, step[:, :d])
    bent = world.ravel() @ (Quadratic(graph).gauss_newton(estimate) @ world.ravel())
    assert exact.cost(ahead) == pytest.approx(bent, rel=1e-3)


@given(seeds, dimensions)
@few
def test_frames_and_units(seed, d):
    problem, estimate, anchor = problem_at(seed, d, True)
    expected = Marginals(problem, estimate, anchor).covariances
    elsewhere = estimate.moved(so.random(rng_of(1), 1, d)[0], np.full(d, 7.0))
    atol = 1e-9 * np.abs(expected).max()
    found = Marginals(problem, elsewhere, anchor).covariances
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=atol)
    found = Marginals(problem.scaled(4.0), estimate, anchor).covariances
    np.testing.assert_allclose(4.0 * found, expected, rtol=1e-7, atol=atol)


@pytest.mark.parametrize("name", ["smallGrid3D", "intel", "sphere2500"])
def test_gtsam_agrees(name, dataset):
    gtsam = pytest.importorskip("gtsam")
    answer = certpgo.solve(dataset(name), cost="gtsam", tier="screen")
    graph, values = certpgo.to_gtsam(answer.problem, answer.estimate)
    d, keys = answer.problem.d, sorted(values.keys())
    first = values.atPose3(keys[0]) if d == 3 else values.atPose2(keys[0])
    factor = gtsam.PriorFactorPose3 if d == 3 else gtsam.PriorFactorPose2
    order = np.r_[3:6, 0:3] if d == 3 else np.arange(3)  # theirs is rotation first in space
    sigmas = np.linspace(0.1, 0.2, len(order))
    graph.add(factor(keys[0], first, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    theirs, ours = gtsam.Marginals(graph, values), answer.marginals
    for k in (1, len(keys) // 2, len(keys) - 1):
        carried = ours._carried(0, k)
        prior = carried @ np.diag(sigmas[order] ** 2) @ carried.T
        C = theirs.marginalCovariance(keys[k])[np.ix_(order, order)]
        np.testing.assert_allclose(ours.covariance(k) + prior, C, atol=1e-6 * np.abs(C).max())
        np.testing.assert_allclose(ours.covariances[k], ours.covariance(k), rtol=1e-6, atol=1e-12)


def test_of_an_answer(dataset):
    instance = dataset("smallGrid3D")
    answer = certpgo.solve(instance)
    problem = objective_of(instance)
    expected = Marginals(problem, answer.estimate).covariance(3)
    np.testing.assert_array_equal(answer.covariance(3), expected)
    robust = certpgo.solve_robustly(instance.graph)
    kept = Marginals(robust.solution.judged(problem), robust.estimate)
    np.testing.assert_array_equal(robust.covariance(3), kept.covariance(3))


def test_what_is_refused():
    problem, estimate, _ = problem_at(0, 3, True)
    with pytest.raises(InputError, match=f"node 99 is not among 0 to {problem.n - 1}"):
        Marginals(problem, estimate).covariance(99)
    with pytest.raises(InputError, match="node -1 is not among"):
        Marginals(problem, estimate, -1)
    with pytest.raises(InputError, match="nodes"):
        Marginals(problem, Estimate(np.tile(np.eye(3), (99, 1, 1)), np.zeros((99, 3))))


def test_what_is_not_determined(monkeypatch):
    problem, estimate, _ = problem_at(0, 3, True)
    H = 0.0 * problem.gauss_newton(estimate)
    monkeypatch.setattr(type(problem), "gauss_newton", lambda *_: H)
    with pytest.raises(NumericalError, match="do not determine"):
        Marginals(problem, estimate).covariance(1)

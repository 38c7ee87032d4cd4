"""Edges with matrix weights, arms and couplings: against loops, isotropic edges and derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import (
    definite,
    dense_cost,
    dimensions,
    general_graph,
    pose_graph,
    rng_of,
    rotation_graph,
    seeds,
)

from certpgo import get_solver, solve
from certpgo.errors import GraphError, InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.capabilities import require_capable
from certpgo.graph.relaxed_point import Lift
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.linalg.rotations import tangent_basis
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic

few = settings(max_examples=20)


def some_estimate(rng, n, d):
    return Estimate(so.random(rng, n, d), 2.0 * rng.standard_normal((n, d)))


def weighted_cost(graph, W, x):
    """tr(E W E^T) by a loop, E = X_j - X_i T~ with X = [t R], for the graph as measured."""
    total = 0.0
    for e, (i, j) in enumerate(graph.edges):
        R, t = x.rotations, x.translations
        moved = t[j] - t[i] - R[i] @ graph.translations[e]
        turned = R[j] - R[i] @ graph.rotations[e]
        E = np.c_[moved, turned]
        total += np.trace(E @ W[e] @ E.T)
    return total


def general_cost(graph, x):
    """tau |t_j + R_j a - t_i - R_i b|^2 + tr(K) + tr(K') - 2 <N, R_i^T R_j> by a loop.

    Both traces are the nuclear norm of N.
    """
    total, R, t = 0.0, x.rotations, x.translations
    for e, (i, j) in enumerate(graph.edges):
        N = graph.couplings[e]
        nuclear = np.linalg.norm(N, "nuc")
        total += 2.0 * nuclear - 2.0 * np.sum(N * (R[i].T @ R[j]))
        r = t[j] + R[j] @ graph.arms[e] - t[i] - R[i] @ graph.translations[e]
        total += graph.tau[e] * float(r @ r)
    return total


def stacked(x):
    """X = [t_1 R_1 ... t_n R_n], (r, (d + 1) n)."""
    X = np.concatenate([x.translations[:, :, None], x.rotations], axis=2)
    return np.concatenate(list(X), axis=1)


# --- Matrix weights


def test_one_edge_by_hand():
    """E = X_j - X_i T~ of a half turn and a step, all of whose entries are integers."""
    rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.ones(1))
    graph = PoseGraph(rotation, np.array([[1.0, 0.0]]), np.ones(1))
    W = np.array([[[4.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 2.0]]])
    x = Estimate(np.array([np.eye(2), -np.eye(2)]), np.array([[0.0, 0.0], [2.0, 1.0]]))
    # E = [[1, -2, 0], [1, 0, -2]]: 4 - 4 + 12 from the first row, 4 + 8 from the second.
    assert Quadratic(graph.with_matrix_weights(W)).cost(x) == pytest.approx(24.0, rel=1e-14)


@given(seeds, dimensions)
def test_matrix_weights_weigh_the_difference_of_poses(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 6, d)
    W = definite(rng, graph.num_edges, d + 1, 1e3)
    general = graph.with_matrix_weights(W)
    x = some_estimate(rng, 6, d)
    problem, expected = Quadratic(general), weighted_cost(graph, W, x)
    assert problem.cost(x) == pytest.approx(expected, rel=1e-12)
    assert problem.edge_costs(x).sum() == pytest.approx(expected, rel=1e-12)
    X = stacked(x)
    assert np.trace(X @ problem.matrix.toarray() @ X.T) == pytest.approx(expected, rel=1e-11)
    # From DESIGN: M_jj += W, M_ii += T~ W T~^T, M_ij = -T~ W.
    M, b = np.zeros((6 * (d + 1), 6 * (d + 1))), d + 1
    for e, (i, j) in enumerate(graph.edges):
        T = np.eye(b)
        T[1:, 0], T[1:, 1:] = graph.translations[e], graph.rotations[e]
        p, q = (slice(k * b, k * b + b) for k in (i, j))
        M[q, q] += W[e]
        M[p, p] += T @ W[e] @ T.T
        M[p, q] -= T @ W[e]
        M[q, p] -= W[e] @ T.T
    size = np.abs(M).max()
    np.testing.assert_allclose(problem.matrix.toarray(), M, rtol=0, atol=1e-12 * size)


@given(seeds, dimensions)
def test_isotropic_weights_as_matrices_change_nothing(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 6, d)
    W = np.zeros((graph.num_edges, d + 1, d + 1))
    W[:, 0, 0] = graph.tau
    W[:, 1:, 1:] = graph.kappa[:, None, None] * np.eye(d)
    x = some_estimate(rng, 6, d)
    one, other = Quadratic(graph), Quadratic(graph.with_matrix_weights(W))
    size = 1e-12 * np.abs(one.matrix).max() * max(1.0, np.abs(x.translations).max() ** 2)
    assert other.graph.is_general
    assert other.cost(x) == pytest.approx(one.cost(x), rel=1e-12)
    assert other.scale == pytest.approx(one.scale, rel=1e-12)
    assert other.stationarity(x) == pytest.approx(one.stationarity(x), rel=1e-12)
    for f in (
        lambda p: p.matrix.toarray(),
        lambda p: p.rotation.matrix.toarray(),
        lambda p: p.gradient(x),
        lambda p: p.first_order(x).tangent,
        lambda p: p.multipliers(x),
        lambda p: p.pattern.assemble(*p.hessian(x, p.multipliers(x))).toarray(),
    ):
        np.testing.assert_allclose(f(other), f(one), rtol=0, atol=size)


@given(seeds)
def test_tangent_information_is_the_angle_weighed_along_its_axis(seed):
    """4 sin^2(theta/2) n^T O_R n for K = tr(O_R)/2 I - O_R (OBJECTIVES, section 2)."""
    rng = rng_of(seed)
    O_R = definite(rng, 1, 3, 1.9)
    K = 0.5 * np.trace(O_R[0]) * np.eye(3) - O_R
    axis, theta = rng.standard_normal(3), rng.uniform(0.0, np.pi)
    axis /= np.linalg.norm(axis)
    R, A = so.random(rng, 2, 3)
    rotation = RotationGraph(2, np.array([[0, 1]]), R[None], np.ones(1)).with_matrix_weights(K)
    x = Estimate(np.array([A, A @ R @ so.exp(theta * axis)]))
    # The residual rotation turns about an axis in the frame of pose j.
    expected = 4.0 * np.sin(theta / 2) ** 2 * axis @ O_R[0] @ axis
    assert Quadratic(rotation).cost(x) == pytest.approx(expected, rel=1e-11)


@given(seeds, dimensions)
@few
def test_later_matrix_weights_replace_earlier_ones(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, d)
    first, second = (definite(rng, graph.num_edges, d + 1) for _ in range(2))
    x = some_estimate(rng, 5, d)
    twice = Quadratic(graph.with_matrix_weights(first).with_matrix_weights(second))
    assert twice.cost(x) == pytest.approx(weighted_cost(graph, second, x), rel=1e-12)


# --- Derivatives of the complete class


@given(seeds, dimensions)
def test_cost_is_the_loop_and_the_quadratic_form_also_for_reflections(seed, d):
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 6, d)
    assert (np.linalg.det(graph.couplings) < 0.0).any()
    x, problem = some_estimate(rng, 6, d), Quadratic(graph)
    expected = general_cost(graph, x)
    assert problem.cost(x) == pytest.approx(expected, rel=1e-12)
    X = stacked(x)
    M = problem.matrix.toarray()
    assert np.trace(X @ M @ X.T) == pytest.approx(expected, rel=1e-11)
    np.testing.assert_allclose(M, M.T, rtol=0, atol=1e-12 * np.abs(M).max())
    assert np.linalg.eigvalsh(M)[0] > -1e-12 * np.abs(M).max()
    np.testing.assert_allclose(
        np.concatenate(list(problem.gradient(x)), axis=1), X @ M, rtol=0, atol=1e-10
    )
    rotations = problem.rotation
    R = np.concatenate(list(x.rotations), axis=1)
    L = rotations.matrix.toarray()
    assert np.trace(R @ L @ R.T) == pytest.approx(rotations.cost(x), rel=1e-11)


def moved_along(x, v):
    p = so.tangent_dim(x.d)
    R = x.rotations @ so.exp(v[:, -p:])
    return Estimate(R, x.translations + v[:, : x.d] if v.shape[1] > p else None)


@given(seeds, dimensions)
def test_gradient_and_hessian_by_the_slope_of_the_taylor_error(seed, d):
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 5, d, extra=4)
    x = some_estimate(rng, 5, d)
    for problem in (Quadratic(graph), Quadratic(graph.rotations_alone)):
        g = problem.first_order(x).tangent
        v = rng.standard_normal(g.shape)
        H = problem.pattern.assemble(*problem.hessian(x, problem.multipliers(x)))
        np.testing.assert_allclose(H.toarray(), H.toarray().T, rtol=0, atol=1e-10)
        curvature = float(v.ravel() @ (H @ v.ravel()))
        errors = []
        for h in (2e-3, 1e-3):
            model = problem.cost(x) + 2.0 * h * float(np.sum(g * v)) + h * h * curvature
            errors.append(abs(problem.cost(moved_along(x, h * v)) - model))
        # Third order: halving the step divides the error by eight (or it is rounding).
        assert errors[1] < errors[0] / 5.0 + 1e-11 * problem.cost(x)


@given(seeds, dimensions)
@few
def test_the_lifted_hessian_at_rank_d_is_the_hessian(seed, d):
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 5, d)
    x = some_estimate(rng, 5, d)
    basis = x.rotations[:, None] @ so.hat(np.eye(so.tangent_dim(d)))
    for problem in (Quadratic(graph), Quadratic(graph.rotations_alone)):
        multipliers = problem.multipliers(x)
        lifted = operators.lifted_hessian(problem.graph, basis, multipliers)
        for one, other in zip(lifted, problem.hessian(x, multipliers), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * problem.scale)


@given(seeds, dimensions, dimensions)
@few
def test_the_lifted_hessian_is_the_second_difference_at_higher_ranks(seed, d, more):
    """Along Y exp of a tangent, d^2 F / 2 = <V, V (M - Lam)>, here by differences."""
    rng = rng_of(seed)
    r, n = d + more - 1, 4
    graph, _, _ = general_graph(rng, n, d, extra=3)
    Y = np.linalg.qr(rng.standard_normal((n, r, d)))[0]
    point = Lift(Y, rng.standard_normal((n, r)))
    problem = Quadratic(graph)
    basis = tangent_basis(Y)
    blocks = operators.lifted_hessian(graph, basis, problem.multipliers(point))
    H = problem.pattern.assemble(*blocks)
    v = rng.standard_normal((n, H.shape[0] // n))
    V = np.einsum("nq,nqrd->nrd", v[:, r:], basis)

    def cost(h):
        Z = Y + h * V  # the polar factor is a second-order retraction
        U, _, Vt = np.linalg.svd(Z, full_matrices=False)
        return problem.cost(Lift(U @ Vt, point.translations + h * v[:, :r]))

    h = 1e-3
    # Richardson: errors of order h^4.
    second = [(cost(k * h) - 2.0 * cost(0.0) + cost(-k * h)) / (k * h) ** 2 for k in (1, 2)]
    difference = (4.0 * second[0] - second[1]) / 3.0
    quadratic = 2.0 * float(v.ravel() @ (H @ v.ravel()))
    assert difference == pytest.approx(quadratic, rel=1e-5, abs=1e-5 * problem.cost(point))


# --- Laws


@given(seeds, dimensions)
@few
def test_settled_translations_minimise_the_cost(seed, d):
    rng = rng_of(seed)
    graph, R, _ = general_graph(rng, 6, d)
    problem = Quadratic(graph)
    best = problem.complete(R)
    np.testing.assert_allclose(problem.gradient(best)[:, :, 0], 0.0, rtol=0, atol=1e-10)
    for _ in range(3):
        moved = Estimate(R, best.translations + 0.1 * rng.standard_normal((6, d)))
        assert problem.cost(moved) > problem.cost(best)
    trace = np.trace(problem.multipliers(best), axis1=1, axis2=2).sum()
    assert trace == pytest.approx(problem.cost(best), rel=1e-10)
    Y = np.linalg.qr(rng.standard_normal((6, d + 2, d)))[0]
    lifted = problem.with_optimal_translations(Lift(Y, rng.standard_normal((6, d + 2))))
    np.testing.assert_allclose(problem.gradient(lifted)[:, :, 0], 0.0, rtol=0, atol=1e-10)


@given(seeds, dimensions)
@few
def test_gauge_relabelling_and_scaling(seed, d):
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 6, d)
    problem, x = Quadratic(graph), some_estimate(rng, 6, d)
    moved = x.moved(so.random(rng, 1, d)[0], rng.standard_normal(d))
    assert problem.cost(moved) == pytest.approx(problem.cost(x), rel=1e-11)
    nodes = rng.permutation(6)
    relabelled = Quadratic(graph.subgraph(nodes))
    assert relabelled.cost(x.subset(nodes)) == pytest.approx(problem.cost(x), rel=1e-12)
    heavier = problem.scaled(4.0)
    assert heavier.cost(x) == 4.0 * problem.cost(x)
    assert heavier.stationarity(x) == pytest.approx(problem.stationarity(x), rel=1e-12)


@given(seeds, dimensions)
@few
def test_an_edge_of_the_complete_class_may_be_read_backwards(seed, d):
    """N becomes N^T, and the two arms change places."""
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 6, d)
    rotation = graph.rotations_alone
    back = RotationGraph(
        6,
        graph.edges[:, ::-1],
        np.swapaxes(rotation.rotations, 1, 2),
        rotation.kappa,
        np.swapaxes(rotation.couplings, 1, 2),
    )
    reversed_ = PoseGraph(back, graph.arms, graph.tau, graph.translations)
    x = some_estimate(rng, 6, d)
    one, other = Quadratic(graph), Quadratic(reversed_)
    assert other.cost(x) == pytest.approx(one.cost(x), rel=1e-12)
    assert abs(one.matrix - other.matrix).max() < 1e-11 * one.scale


@given(seeds, dimensions)
@few
def test_enclosures_of_edges_hold_their_terms(seed, d):
    rng = rng_of(seed)
    general, _, _ = general_graph(rng, 6, d)
    plain, _, _ = pose_graph(rng, 6, d)
    armed = replace(plain, arms=rng.normal(size=(plain.num_edges, d)))
    x = some_estimate(rng, 6, d)
    R, t = x.rotations, x.translations
    i, j = armed.edges.T
    moved = (
        t[j]
        - t[i]
        + (R[j] @ armed.arms[:, :, None] - R[i] @ armed.translations[:, :, None])[:, :, 0]
    )
    turned = R[j] - R[i] @ armed.rotations
    own = armed.tau * (moved**2).sum(axis=1)
    own += armed.kappa * (turned**2).sum(axis=(1, 2))
    others = [general_cost(general.with_edges([e]), x) for e in range(general.num_edges)]
    for graph, terms in ((armed, own), (general, np.array(others))):
        low, high = Quadratic(graph).edge_enclosures(x)
        slack = 1e-13 * terms
        assert (low <= terms + slack).all()
        assert (terms <= high + slack).all()
        assert (high - low <= 1e-9 * terms + 1e-9).all()
        least, most = Quadratic(graph).enclosure(x)
        assert (least, most) == pytest.approx((terms.sum(), terms.sum()), rel=1e-9)


@given(seeds, dimensions)
@few
def test_a_choice_of_edges_carries_their_arms_and_couplings(seed, d):
    rng = rng_of(seed)
    graph, _, _ = general_graph(rng, 8, d, extra=20)
    x = some_estimate(rng, 8, d)
    terms = Quadratic(graph).edge_costs(x)
    chosen = np.sort(rng.permutation(graph.num_edges)[:14])

    def terms_of(part, point=x):
        # The terms of each edge need no connected graph.
        one = general_cost(part, point)
        assert part.arms.shape == part.translations.shape
        assert part.couplings.shape == part.rotations.shape
        return one

    assert terms_of(graph.with_edges(chosen)) == pytest.approx(terms[chosen].sum(), rel=1e-11)
    factors = np.where(rng.random(graph.num_edges) < 0.5, 0.0, rng.uniform(1.0, 2.0))
    factors[0] = 2.0
    assert terms_of(graph.reweighted(factors)) == pytest.approx(factors @ terms, rel=1e-11)
    nodes = np.array([5, 1, 4, 2])
    inside = np.isin(graph.edges, nodes).all(axis=1)
    if inside.any():
        part = graph.subgraph(nodes)
        assert terms_of(part, x.subset(nodes)) == pytest.approx(terms[inside].sum(), rel=1e-11)
    pairs = np.sort(graph.edges, axis=1) @ np.array([8, 1])
    for keep, order in (("first", 1), ("last", -1)):
        kept = np.unique(pairs[::order], return_index=True)[1]
        kept = kept if order == 1 else graph.num_edges - 1 - kept
        part = graph.without_parallel_edges(keep)
        assert terms_of(part) == pytest.approx(terms[kept].sum(), rel=1e-11)


def test_isotropic_graphs_stay_isotropic():
    graph, R, t = pose_graph(rng_of(0), 6, 3)
    chosen = graph.with_edges(np.arange(8)).reweighted(np.full(8, 2.0))
    assert not chosen.is_general
    assert chosen.arms is None
    assert Quadratic(graph).cost(Estimate(R, t)) == pytest.approx(dense_cost(graph, R, t))


# --- Refusals


def test_matrix_weights_that_are_none_are_refused():
    graph, _, _ = pose_graph(rng_of(0), 5, 3)
    m = graph.num_edges
    W = np.tile(np.eye(4), (m, 1, 1))
    i, j = graph.edges[2]

    def changed(entry, value, both=True):
        other = W.copy()
        other[(2, *entry)] = value
        if both:
            other[(2, *entry[::-1])] = value
        return other

    for wrong, words in (
        (W[:-1], "matrix weights must be"),
        (np.tile(np.eye(3), (m, 1, 1)), "matrix weights must be"),
        (changed((1, 2), 0.5, both=False), "symmetric"),
        (changed((1, 2), np.nan), "symmetric"),
        (changed((0, 0), 0.0), rf"edge \({i}, {j}\): tau is 0.0; it must be positive"),
        (changed((0, 0), 1e130), "tau is 1e.130"),
        (changed((1, 1), 0.0), rf"edge \({i}, {j}\): K is not positive definite"),
        (changed((1, 2), 1.5), "K is not positive definite"),
        (changed((0, 1), 1.5), "K is not positive definite"),  # the Schur complement
        (changed((1, 1), 1e130), "must be"),
        (changed((1, 1), np.inf), "not positive definite|must be"),
    ):
        with pytest.raises(GraphError, match=words):
            graph.with_matrix_weights(wrong)
    with pytest.raises(GraphError, match="and symmetric"):
        graph.rotations_alone.with_matrix_weights(np.ones((m, 2, 2)))


def test_arms_and_couplings_out_of_range_are_refused():
    graph, _, _ = general_graph(rng_of(0), 5, 2)
    rotation, m = graph.rotations_alone, graph.num_edges
    with pytest.raises(GraphError, match="arms must be"):
        PoseGraph(rotation, graph.translations, graph.tau, graph.arms[:-1])
    for value in (np.nan, np.inf, 1e130):
        arms, N = graph.arms.copy(), rotation.couplings.copy()
        arms[1, 0] = N[1, 0, 0] = value
        with pytest.raises(GraphError, match="arms must be below"):
            PoseGraph(rotation, graph.translations, graph.tau, arms)
        with pytest.raises(GraphError, match="couplings must be below"):
            RotationGraph(5, graph.edges, rotation.rotations, rotation.kappa, N)
    with pytest.raises(GraphError, match="couplings must be"):
        RotationGraph(5, graph.edges, rotation.rotations, rotation.kappa, np.ones((m, 3, 3)))


ISOTROPIC = ("eig_se3", "irls_eig_se3", "expectation_maximization", "low_rank_sparse", "eigen_rao")
GTSAM = ("gtsam_chordal", "gtsam_fastsync", "gtsam_gauss_newton", "gtsam_staircase")


@pytest.mark.parametrize(
    "name", [*ISOTROPIC, *(pytest.param(name, marks=pytest.mark.gtsam) for name in GTSAM)]
)
def test_methods_for_isotropic_weights_refuse_others(name):
    poses, _, _ = pose_graph(rng_of(1), 5, 3)
    general = poses.with_matrix_weights(definite(rng_of(2), poses.num_edges, 4))
    method = get_solver(name)
    posed = Quadratic(general if method.poses else general.rotations_alone)
    with pytest.raises(InputError, match="this method does not take matrix weights"):
        method().solve(posed)


def test_closed_forms_for_isotropic_weights_refuse_others():
    cycle = winding_cycle(5, 0.3, 0)[0].graph
    general = Quadratic(cycle.with_matrix_weights(np.tile(np.diag([1.0, 2, 3]), (5, 1, 1))))
    with pytest.raises(InputError, match="this method does not take matrix weights"):
        get_solver("cycle_closed_form")().solve(general)
    graph, _, _ = general_graph(rng_of(0), 5, 3)
    with pytest.raises(InputError, match="this method does not take matrix weights"):
        get_solver("eigen_ma")(translations="thesis").solve(Quadratic(graph))
    require_capable(cycle, "isotropic method")


def test_the_proof_tier_of_general_edges():
    graph, _, _ = pose_graph(rng_of(1), 5, 3)
    general = graph.with_matrix_weights(definite(rng_of(2), graph.num_edges, 4))
    proven, standard = (solve(general, tier=tier).certificate for tier in ("proof", "standard"))
    assert proven.verdict.value == "CERTIFIED"
    assert standard.lower_bound <= proven.lower_bound <= proven.refined_cost


def test_weights_of_rotations_alone():
    graph, R = rotation_graph(rng_of(3), 6, 3)
    K = definite(rng_of(4), graph.num_edges, 3)
    problem = Quadratic(graph.with_matrix_weights(K))
    total = 0.0
    for e, (i, j) in enumerate(graph.edges):
        E = R[j] - R[i] @ graph.rotations[e]
        total += np.trace(E @ K[e] @ E.T)
    assert problem.cost(Estimate(R)) == pytest.approx(total, rel=1e-12)
    assert not graph.with_matrix_weights(K).with_weights(1.0).is_general

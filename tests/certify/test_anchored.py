"""Bounds with the gauge taken out, in rational and ball arithmetic, and where they are needed."""

from fractions import Fraction

import numpy as np
import pytest
from exact_certificates import (
    exact_certificate,
    positive_definite_in_balls,
    with_exact_rotations,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, general_graph, point_graph, pose_graph, rng_of, seeds

import certpgo
from certpgo.certify import dual, dual_bound
from certpgo.certify.anchored import Anchored, EdgeForces
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.constructors import of_couplings
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.objective.objective import cost_upper
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton


def anchored(problem, point, enough=-np.inf):
    return dual.Attempts(problem, point, True, enough, True).anchored(point)


def with_fixes(rng, n, d, far, noise=0.1):
    """Poses with odometry, and positions around a place that is ``far`` from the origin."""
    graph, R, t = pose_graph(rng, n, d, noise=noise)
    fixes = t + noise * rng.standard_normal((n, d))
    fixed = certpgo.with_priors(graph, np.arange(n), translations=fixes, tau=4.0)
    moved = fixed.translations.copy()
    moved[-n:] += far
    return PoseGraph(fixed.rotations_alone, moved, fixed.tau), R, t


def optimum(graph, R, t=None):
    problem = Quadratic(graph)
    if problem.n > len(R):  # the world
        R = np.concatenate([R, np.eye(problem.d)[None]])
    return problem, problem.complete(newton(problem, problem.complete(R)).estimate.rotations)


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("kind", ["rotations", "poses", "fixes", "far"])
@pytest.mark.parametrize("noise", [1e-4, 0.1, 0.5])
def test_the_matrix_is_positive_definite_in_ball_arithmetic(engine, kind, noise, monkeypatch):
    """On the exact data, and the bound is the multipliers' trace."""
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    proved = 0
    for seed in range(6):
        rng, d, poses = rng_of(seed), 2 + seed % 2, kind != "rotations"
        if kind in ("fixes", "far"):
            graph, R, t = with_fixes(rng, 4, d, 1e6 if kind == "far" else 0.0, noise)
        else:
            graph, R, t = pose_graph(rng, 5, d, noise=noise)
        graph, exact = with_exact_rotations(graph)
        problem, point = optimum(graph if poses else graph.rotations_alone, R, t)
        bound = anchored(problem, point)
        if bound is None:
            continue
        proved += 1
        S = exact_certificate(graph, exact, bound.multipliers, poses)
        assert positive_definite_in_balls(S)
        diagonal = bound.multipliers[:, range(d), range(d)].ravel()
        assert Fraction(bound.value) <= sum(map(Fraction, diagonal))
        assert bound.value <= problem.cost(point) + 1e-12 * problem.scale
    assert proved >= 3


@settings(max_examples=40)
@given(seeds, dimensions, st.floats(-12, 0))
def test_no_point_is_too_far_from_stationary_for_the_bound_to_hold(seed, d, exponent):
    """The gradient is paid for: away from the optimum bounds are weaker, and true."""
    graph, R, t = pose_graph(rng_of(seed), 5, d)
    problem, best = optimum(graph, R, t)
    step = 10.0**exponent * rng_of(seed).standard_normal((5, so.tangent_dim(d)))
    moved = problem.complete(best.rotations @ so.exp(step))
    bound = anchored(problem, moved)
    if bound is not None:
        assert bound.value <= cost_upper(problem, best)


@settings(max_examples=30)
@given(seeds, dimensions)
def test_no_estimate_costs_less_where_edges_are_general_or_lead_to_points(seed, d):
    rng = rng_of(seed)
    for graph in (general_graph(rng, 6, d)[0], point_graph(rng, 5, 3, d)[0]):
        problem = Quadratic(graph)
        start = problem.complete(so.random(rng, problem.n, d))
        point = problem.complete(newton(problem, start).estimate.rotations)
        bound = anchored(problem, point)
        if bound is None:
            continue
        assert bound.value <= cost_upper(problem, point)
        for _ in range(4):
            other = problem.complete(so.random(rng, problem.n, d))
            assert bound.value <= problem.cost(newton(problem, other).estimate) * (1 + 1e-12)


@settings(max_examples=20)
@given(seeds, dimensions, st.sampled_from([0.0, 1e3, 1e7]))
def test_errors_of_forces_bound_the_rounding(seed, d, far):
    """Against rationals: the gradient less the multipliers' part, node by node, and F."""
    graph, R, t = with_fixes(rng_of(seed), 4, d, far)
    graph, exact = with_exact_rotations(graph)
    problem, point = optimum(graph, R, t)
    # Quarter turns are rotations to the last bit.
    turns = np.tile(np.eye(d), (problem.n, 1, 1))
    turns[::2, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    point = Estimate(turns, point.translations)
    multipliers = problem.multipliers(point)
    at = Anchored.of(problem, point, multipliers)
    G, errors = at.rows
    x, total = exact_rows(graph, exact, point, at.multipliers)
    x[at.anchor * (d + 1) : (at.anchor + 1) * (d + 1)] = 0
    off = np.array([[float(x[k, c] - Fraction(G[k, c])) for c in range(d)] for k in range(len(G))])
    assert np.all(np.linalg.norm(off, axis=1) <= errors)
    forces = EdgeForces.of(graph, point)
    assert abs(float(total - Fraction(float(np.trace(forces.moment))))) <= d * forces.moment_error


@settings(max_examples=20)
@given(seeds, dimensions, st.sampled_from([1e-17, 1e-9, 1e-2]))
def test_errors_of_forces_bound_what_polar_factors_lose(seed, d, noise):
    """The form of couplings N is tr K + tr K' - 2 <N, Q>, however small it is."""
    rng = rng_of(seed)
    turns = np.tile(np.eye(d), (4, 1, 1))
    turns[::2, :2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    edges = np.array([(i, j) for i in range(4) for j in range(i + 1, 4)])
    Q = np.swapaxes(turns[edges[:, 0]], 1, 2) @ turns[edges[:, 1]]
    L = rng.standard_normal((len(edges), d, d)) * 10.0 ** rng.uniform(-3, 3, (len(edges), 1, 1))
    N = (
        Q
        @ (L @ np.swapaxes(L, 1, 2))
        @ so.exp(noise * rng.standard_normal((len(edges), so.tangent_dim(d))))
    )
    graph = of_couplings(4, edges, Q, N)
    _, K, K_left = graph.polar
    total = sum(Fraction(x) for A in (K, K_left) for x in np.diagonal(A, 0, 1, 2).ravel())
    total -= 2 * sum(Fraction(a) * Fraction(b) for a, b in zip(N.ravel(), Q.ravel(), strict=True))
    forces = EdgeForces.of(graph, Estimate(turns))
    off = float(total - Fraction(float(np.trace(forces.moment))))
    assert abs(off) <= d * forces.moment_error


def exact_rows(graph, exact, point, multipliers):
    """(N, d) rows of M X^T - blkdiag(0, Lam) X^T, and F, in rationals."""
    n, d = graph.num_nodes, graph.d
    rational = np.vectorize(Fraction, otypes=[object])
    R, t = rational(point.rotations), rational(point.translations)
    rows, total = np.full((n, d + 1, d), Fraction(0), dtype=object), Fraction(0)
    for e, (i, j) in enumerate(graph.edges):
        kappa, tau = Fraction(graph.kappa[e]), Fraction(graph.tau[e])
        measured = np.array(exact[e], dtype=object)
        E = R[j] - R[i].dot(measured)
        b = rational(graph.translations[e])
        r = t[j] - t[i] - R[i].dot(b)
        rows[j, 1:] += kappa * E.T
        rows[i, 1:] -= kappa * measured.dot(E.T)
        rows[j, 0] += tau * r
        rows[i, 0] -= tau * r
        rows[i, 1:] -= tau * np.outer(b, r)
        total += kappa * (E * E).sum() + tau * (r * r).sum()
    for k in range(n):
        rows[k, 1:] -= rational(multipliers[k]).dot(R[k].T)
    return rows.reshape(-1, d), total


def test_wound_up_cycles_have_no_anchored_bound():
    """Their certificate matrix has a negative eigenvalue, however the gauge is fixed."""
    for n in (6, 60, 600):
        for d in (2, 3):
            instance, wound = winding_cycle(n, 0.3, 1, d)
            problem = Quadratic(instance.graph)
            bound = anchored(problem, problem.complete(wound.rotations))
            assert bound is None or bound.value <= problem.cost(instance.truth)


def road(d, fixes=400, length=1e5, sigma=0.01, seed=0):
    """A road whose poses have odometry, and positions from a satellite, much better than that."""
    rng, n = rng_of(seed), fixes
    x = np.linspace(0.0, length, n)
    bends = np.array([0.0, 0.02, 0.01]), np.array([0.0, 8.0, 30.0])
    t = length * bends[0] * np.sin(bends[1] * x[:, None] / length)
    t = (t + x[:, None] * [1.0, 0.0, 0.0])[:, :d]
    heading = np.zeros((n, so.tangent_dim(d)))
    heading[:, -1] = np.arctan2(np.gradient(t[:, 1]), np.gradient(t[:, 0]))
    R, back = so.exp(heading), np.arange(n - 1)
    noise = so.exp(0.002 * rng.standard_normal((n - 1, so.tangent_dim(d))))
    turns = np.swapaxes(R[:-1], 1, 2) @ R[1:] @ noise
    steps = np.einsum("nba,nb->na", R[:-1], np.diff(t, axis=0))
    steps += 0.1 * rng.standard_normal(steps.shape)
    kappa = np.full(n - 1, 0.5 * 0.002**-2)
    rotation = RotationGraph(n, np.stack([back, back + 1], axis=1), turns, kappa)
    graph = PoseGraph(rotation, steps, np.full(n - 1, 0.1**-2))
    measured = t + sigma * rng.standard_normal((n, d))
    return certpgo.with_priors(graph, np.arange(n), translations=measured, tau=sigma**-2)


@pytest.mark.parametrize("d", [2, 3])
def test_precise_positions_along_a_long_road_keep_their_bound(d):
    """A centimetre in 100 km: shifts lose all of F to rounding, the anchored bound nothing."""
    answer = certpgo.solve(road(d))
    proven = answer.certificate
    assert proven.gap <= 1e-6 * proven.cost_upper
    problem, point = answer.problem, answer.estimate
    shifted = dual_bound(problem, point)
    assert shifted is None or shifted.value < 0.5 * proven.cost_upper


def test_what_counts_as_zero_does_not_grow_with_the_distance_from_the_origin():
    """Poses that are all a centimetre off cost twice as much, and are not certified."""
    graph = road(2)
    problem = Quadratic(graph)
    best = certpgo.solve(graph)
    off = 0.01 * np.random.default_rng(1).choice([-1.0, 1.0], best.estimate.translations.shape)
    moved = best.estimate.with_translations(best.estimate.translations + off)
    judged = certpgo.certify(problem, moved)
    assert judged.cost_upper > 1.5 * best.cost
    assert (judged.verdict.value, judged.basin_is_global) == ("BOUNDED", True)
    assert best.certificate.tolerance < 1e-3 * best.cost


@pytest.mark.parametrize("d", [2, 3])
def test_a_bound_does_not_depend_on_where_the_origin_is(d):
    """Positions that are farther than a map is long are read relative to a place near them."""
    graph, gaps = road(d, fixes=100, length=1e3, sigma=0.1), []
    for far in (0.0, 1e2, 8e3, 1e7):
        moved = graph.translations.copy()
        moved[graph.absolute] += far
        moved = PoseGraph(graph.rotations_alone, moved, graph.tau, absolute=graph.absolute)
        gaps.append(certpgo.solve(moved).certificate.relative_gap)
    assert max(gaps[:3]) <= 1.3 * min(gaps[:3])
    assert max(gaps) <= 1e-5


@pytest.mark.parametrize("far", [1e4, 1e7])
def test_a_bound_does_not_depend_on_where_the_estimate_is(far):
    graph, R, t = pose_graph(rng_of(0), 20, 3)
    problem, best = optimum(graph, R, t)
    turn = so.random(rng_of(1), 1, 3)[0]
    here = certpgo.certify(problem, best)
    there = certpgo.certify(problem, best.moved(turn, far * np.ones(3)))
    assert there.verdict is here.verdict
    assert there.gap == pytest.approx(here.gap, rel=0.05, abs=1e-15 * here.cost_upper)


@pytest.mark.parametrize("name", ["kitti_00", "ais2klinik", "drone"])
def test_gaps_of_long_chains_are_within_rtol_of_a_small_cost(name, dataset):
    instance = dataset(name)
    answer = certpgo.solve(instance.graph, cost="chordal")
    judged = certpgo.certify(instance.graph, answer, cost="chordal")
    for proven in (answer.certificate, judged):
        assert (proven.verdict.value, proven.tier.value) == ("CERTIFIED", "standard")
        assert proven.gap <= 5e-6 * proven.cost_upper

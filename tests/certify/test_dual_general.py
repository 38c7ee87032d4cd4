"""Bounds of graphs with matrix weights, arms and couplings: published data, rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import definite, dimensions, general_graph, pose_graph, rng_of, seeds

from certpgo import certify, solve
from certpgo.certify.assembly_errors import assembly_errors
from certpgo.certify.dual import dual_bound
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.relaxed_point import Lift
from certpgo.linalg import rotations as so
from certpgo.objective.objective import cost_upper
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton

#: With the files' own rotational information (OBJECTIVES, section 2), and relative gaps.
GOLDEN = {
    "smallGrid3D": (1025.398056, 1e-9),
    "sphere2500": (1351.215697, 1e-7),
    "parking-garage": (1.268384384, 4e-6),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_costs_with_the_files_own_rotational_information(name, dataset):
    instance = dataset(name)
    graph = instance.graph
    O_R = instance.graph.information_matrices[:, 3:, 3:]
    K = 0.5 * np.trace(O_R, axis1=1, axis2=2)[:, None, None] * np.eye(3) - O_R
    values = np.linalg.eigvalsh(K)
    if values.min() > 0.0:
        W = np.zeros((graph.num_edges, 4, 4))
        W[:, 0, 0], W[:, 1:, 1:] = graph.tau, K
        general, constant = graph.with_matrix_weights(W), 0.0
    else:
        # Couplings R K cost 2 tr|K| - 2 <R K, Q>, with |K| for K.
        rotation = graph.rotations_alone
        turned = RotationGraph(
            graph.num_nodes,
            graph.edges,
            rotation.rotations,
            np.abs(values).mean(axis=1),
            rotation.rotations @ K,
        )
        general = PoseGraph(turned, graph.translations, graph.tau)
        constant = 2.0 * float((np.abs(values) - values).sum())
    result = solve(general)
    expected, gap = GOLDEN[name]
    assert result.cost - constant == pytest.approx(expected, rel=1e-9)
    assert result.verdict.value == "CERTIFIED"
    assert result.certificate.gap <= gap * expected
    judged = certify(general, result.estimate, angles=True)
    assert judged.bounds is None  # angle bounds are about isotropic weights


# --- Bounds are bounds


@given(seeds, dimensions, st.booleans(), st.sampled_from([0.1, 1.0]))
@settings(max_examples=30)
def test_no_estimate_costs_less_than_a_bound(seed, d, poses, noise):
    rng, n = rng_of(seed), 6
    graph, R, t = general_graph(rng, n, d, noise=noise, extra=4)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    near = newton(problem, Estimate(R, t if poses else None)).estimate
    Y = np.linalg.qr(rng.standard_normal((n, d + 1, d)))[0]
    raised = problem.with_optimal_translations(
        Lift(Y, rng.standard_normal((n, d + 1)) if poses else None)
    )
    points = (near, Estimate(so.random(rng, n, d)), raised)
    costs = [problem.cost(near)]
    for _ in range(6):
        start = problem.complete(so.random(rng, n, d))
        costs.append(problem.cost(newton(problem, start).estimate))
    for point in points:
        settled = problem.with_optimal_translations(
            point
            if point.translations is not None or not poses
            else problem.complete(point.rotations)
        )
        bound = dual_bound(problem, settled)
        if bound is not None:
            assert bound.value <= min(costs) * (1 + 1e-12)
            S = problem.certificate_matrix(bound.multipliers).toarray()
            assert np.linalg.eigvalsh(S)[0] >= -1e-13 * np.abs(S).max()


@given(seeds, dimensions)
@settings(max_examples=10)
def test_matrix_weights_of_little_noise_are_certified(seed, d):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 8, d, noise=0.02)
    general = graph.with_matrix_weights(definite(rng, graph.num_edges, d + 1))
    problem = Quadratic(general)
    for found in (solve(general).certificate, certify(problem, Estimate(R, t))):
        assert found.lower_bound <= found.refined_cost
        assert found.refined_cost - found.lower_bound <= 1e-7 * found.refined_cost
    certificate = certify(problem, solve(general).estimate, tier="standard")
    assert certificate.verdict.value == "CERTIFIED"
    proven = certify(problem, solve(general).estimate, tier="proof")
    assert certificate.lower_bound <= proven.lower_bound <= proven.refined_cost


def test_what_only_rounding_leaves_open_of_matrix_weights():
    """With rtol = 0 solve escalates to a proof."""
    graph, _, _ = pose_graph(rng_of(5), 6, 2, noise=0.05)
    general = graph.with_matrix_weights(definite(rng_of(6), graph.num_edges, 3))
    for options in ({"rtol": 1e-15}, {"rtol": 1e-12}, {"rtol": 1e-9}):
        result = solve(general, atol=0.0, **options)
        assert result.certificate.lower_bound <= result.cost <= result.certificate.cost_upper
        assert result.certificate.cost_upper == pytest.approx(result.cost, rel=1e-9)


# --- Rounding, in rational arithmetic


def fractions(A):
    return np.vectorize(Fraction, otypes=[object])(A)


def exact_matrix(problem, multipliers):
    """M - blkdiag(0, Lam) of the stored doubles, in fractions."""
    graph, n, d = problem.rotation.graph, problem.n, problem.d
    poses = problem.has_positions
    b = d + poses
    _, K, K_left = (fractions(A) for A in graph.polar)
    N = fractions(graph.couplings)
    M = np.full((n * b, n * b), Fraction(0))
    for e, (i, j) in enumerate(graph.edges):
        p, q = (slice(k * b + poses, k * b + b) for k in (i, j))
        M[p, p] += K_left[e]
        M[q, q] += K[e]
        M[p, q] -= N[e]
        M[q, p] -= N[e].T
        if poses:
            # tau |t_j + R_j a - t_i - R_i b|^2 is tau times the square of one row.
            row = np.full(n * b, Fraction(0))
            row[j * b], row[i * b] = Fraction(1), Fraction(-1)
            row[p] = -fractions(problem.graph.translations[e])
            row[q] = fractions(problem.graph.arms[e])
            M += Fraction(problem.graph.tau[e]) * np.outer(row, row)
    for k in range(n):
        p = slice(k * b + poses, k * b + b)
        M[p, p] -= fractions(multipliers[k])
    return M


def uneven(rng, n, d, poses):
    """A general graph with weights and arms over decades, and parallel edges."""
    graph, R, _ = general_graph(rng, n, d, extra=5, noise=1.0)
    m = graph.num_edges
    decades = 10.0 ** rng.uniform(-4.0, 4.0, (4, m))
    rotation = RotationGraph(
        n,
        graph.edges,
        graph.rotations,
        graph.kappa,
        graph.couplings * decades[0][:, None, None],
    )
    arms, t = graph.arms * decades[1][:, None], graph.translations * decades[2][:, None]
    other = PoseGraph(rotation, t, graph.tau * decades[3], arms)
    return Quadratic(other if poses else rotation), R


@given(seeds, dimensions, st.booleans(), st.integers(-8, 8))
@settings(max_examples=25)
def test_radii_bound_the_rounding_of_every_row(seed, d, poses, exponent):
    rng, n = rng_of(seed), 4
    problem, R = uneven(rng, n, d, poses)
    multipliers = problem.multipliers(problem.complete(R))
    b = d + poses
    turns = np.arange(n * b) % b >= poses
    w = np.where(turns, 1.0, 2.0**exponent)
    radii = assembly_errors(problem, multipliers, w, turns)
    stored = problem.certificate_matrix(multipliers).toarray()
    apart = np.abs(fractions(stored) - exact_matrix(problem, multipliers))
    rows = apart @ fractions(w)
    assert all(row <= Fraction(radius) for row, radius in zip(rows, radii, strict=True))
    # An a priori bound is larger, but not without limit.
    sizes = np.abs(problem.certificate_matrix(0.0 * multipliers).toarray()) @ w
    assert np.all(radii <= 2e-14 * (sizes.sum() + np.abs(multipliers).sum()))


def exact_cost(problem, x):
    """The cost of the rotations nearest to the stored ones, with the stored weights, in balls."""
    from exact_costs import applied, arb, balls, inner, nearest_rotation, product, transposed

    graph, total = problem.rotation.graph, arb(0)
    _, K, K_left = graph.polar
    R = [nearest_rotation(A) for A in x.rotations]
    for e, (i, j) in enumerate(graph.edges):
        Q, N = product(transposed(R[i]), R[j]), balls(graph.couplings[e])
        traces = [arb(float(A[k, k])) for A in (K[e], K_left[e]) for k in range(problem.d)]
        total += sum(traces) - 2 * sum(inner(p, q) for p, q in zip(N, Q, strict=True))
        if x.translations is not None:
            step = applied(R[i], balls(problem.graph.translations[e]))
            arm = applied(R[j], balls(problem.graph.arms[e]))
            r = [
                arb(float(x.translations[j, k]))
                + arm[k]
                - arb(float(x.translations[i, k]))
                - step[k]
                for k in range(problem.d)
            ]
            total += arb(float(problem.graph.tau[e])) * inner(r, r)
    return total


@given(seeds, dimensions, st.booleans(), st.sampled_from([0.0, 1e-12, 1e-8]))
@settings(max_examples=25)
def test_upper_and_lower_costs_enclose_the_exact_cost(seed, d, poses, off):
    pytest.importorskip("flint", reason="python-flint is not installed")
    rng, n = rng_of(seed), 4
    problem, R = uneven(rng, n, d, poses)
    stored = problem.complete(R)
    spoilt = R * (1.0 + off * rng.uniform(-0.5, 0.5, (n, 1, 1)))  # off by more than rounding
    near = Estimate.trusted(spoilt, stored.translations)
    far = Estimate(so.random(rng, n, d), 1e3 * rng.standard_normal((n, d)) if poses else None)
    for x in (near, far):
        exact = exact_cost(problem, x)
        low, high = problem.enclosure(x)[0], cost_upper(problem, x)
        assert exact >= low
        assert exact <= high
        if x is far:
            assert high - low <= 1e-11 * high

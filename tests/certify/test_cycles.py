"""Proofs by cycles: closed forms, laws, and agreement with eigenvalues and with F* itself."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import solve
from certpgo.certify.bounds import cycle_sum_holds
from certpgo.certify.cycle_program import SplitProgram
from certpgo.certify.cycles import prove
from certpgo.errors import InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.cycles import cycle_list
from certpgo.io.datasets.synthetic import complete, random_graph, winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton

#: Relative accuracy of the solver's ratio.
SOLVER = 1e-6


def stationary(graph, seed=None):
    """A stationary point, from random rotations or from the optimum."""
    problem = Quadratic(graph)
    if seed is None:
        start = Estimate(solve(graph, cost="chordal").estimate.rotations)
    else:
        start = Estimate(so.random(rng_of(seed), graph.num_nodes, graph.d))
    found = newton(problem.rotation, start, NewtonSettings(max_iterations=300))
    return problem, found.estimate


def least_eigenvalue(problem, estimate):
    """Of S of the rotations, relative to the largest weight of a node."""
    rotation = problem.rotation
    S = rotation.certificate_matrix(rotation.multipliers(estimate)).toarray()
    return np.linalg.eigvalsh(0.5 * (S + S.T))[0] / rotation.node_weights.max()


def at_identity(edges, kappa, angles, d):
    """A graph whose residuals at identities are these angles, about one axis."""
    turns = np.zeros((len(edges), so.tangent_dim(d)))
    turns[:, -1] = angles
    n = int(np.max(edges)) + 1
    return RotationGraph(n, edges, so.exp(turns), kappa), Estimate(np.tile(np.eye(d), (n, 1, 1)))


def around(n):
    return np.c_[np.arange(n), (np.arange(n) + 1) % n]


# --- Closed forms


@pytest.mark.parametrize(("n", "theta"), [(3, 0.7), (6, 3.0), (20, 3.14), (20, 3.15)])
def test_equal_weights_hold_up_to_half_a_turn(n, theta):
    """Theorem 4.2, with the ratio of tangents."""
    instance, point = winding_cycle(n, theta, 0)
    proof = prove(Quadratic(instance.graph), Estimate(point.rotations))
    assert proof.ratio == pytest.approx(np.tan(theta / n) / np.tan(np.pi / n), rel=SOLVER)
    assert proof.proven == (theta < np.pi)
    assert bool(proof.reason) != proof.proven


@pytest.mark.parametrize("winding", [1, 2, -1])
def test_a_cycle_that_winds_is_not_proven(winding):
    instance, point = winding_cycle(12, 0.7, winding)
    proof = prove(Quadratic(instance.graph), Estimate(point.rotations))
    assert not proof.proven
    assert "stiffness" in proof.reason
    assert proof.lower_bound <= 8 * 12 * np.sin(0.7 / 24) ** 2


@given(seeds, dimensions, st.floats(0.9, 1.1), st.booleans())
@settings(max_examples=10)
def test_weighted_cycles_hold_exactly_up_to_half_a_turn(seed, d, total, beyond):
    """The sum of the angles alone decides, that of one beyond 90 degrees included."""
    rng, n = rng_of(seed), 6
    assume(abs(total - 1.0) > 1e-3)
    angles = rng.dirichlet(np.ones(n)) * total * np.pi
    if beyond:
        angles[0] = 0.7 * np.pi
        angles[1:] *= (total - 0.7) * np.pi / angles[1:].sum()
    assume(angles.min() > 1e-2)
    assume(angles.max() < 3.0)
    graph, here = at_identity(around(n), 1.0 / np.sin(angles), angles, d)
    problem = Quadratic(graph)
    assert problem.stationarity(here) < 1e-12
    proof = prove(problem, here)
    assert proof.proven == (total < 1.0)
    assert (least_eigenvalue(problem, here) > -1e-10) == (total < 1.0)


def test_half_a_turn_on_one_edge_of_a_cycle_is_not_optimal():
    """Stationary, without a torque, and angles add up to pi; springs in series tell."""
    for weakest, optimal in ((1.0, False), (0.4, True)):
        graph, here = at_identity(around(3), np.array([weakest, 1.0, 1.0]), [np.pi, 0.0, 0.0], 2)
        problem = Quadratic(graph)
        assert problem.stationarity(here) < 1e-12
        assert cycle_sum_holds(problem, here) is False
        assert prove(problem, here).proven == optimal
        assert (least_eigenvalue(problem, here) > -1e-12) == optimal


def test_k4_has_optima_that_cycles_do_not_prove():
    """Integers: S >= 0 even with 1.68 times these torques, but the split reaches .977 of them."""
    edges = np.array(list(combinations(range(4), 2)))
    c, phi = np.array([2.0, 9, 2, 2, 9, 1]), np.array([7.0, 0, -7, 5, 2, 5])
    assert (c > 0).all()
    graph, here = at_identity(edges, np.hypot(c, phi), np.arctan2(phi, c), 2)
    problem = Quadratic(graph)
    assert problem.stationarity(here) < 1e-12
    assert least_eigenvalue(problem, here) > -1e-12
    stronger, _ = at_identity(edges, np.hypot(c, 1.68 * phi), np.arctan2(1.68 * phi, c), 2)
    assert least_eigenvalue(Quadratic(stronger), here) > -1e-12
    proof = prove(problem, here)
    assert len(cycle_list(4, edges, 100)) == 7
    assert proof.ratio == pytest.approx(1.0 / 0.9765845, rel=1e-5)
    assert not proof.proven
    assert 0.0 < proof.lower_bound < proof.cost


@pytest.mark.parametrize(
    ("path", "ratio"),
    [
        ("cycle20_0.5_SO3.g2o", 0.860),
        ("tinyGrid3D.g2o", 0.287),
        ("MIT.g2o", 0.62),
    ],
)
def test_public_sets_are_proven(path, ratio, dataset_path):
    from certpgo import read

    problem, here = stationary(read(dataset_path(path), quiet=True).graph.rotations_alone)
    proof = prove(problem, here)
    assert proof.proven
    assert proof.ratio <= ratio + 5e-4
    assert 0.0 <= proof.cost - proof.lower_bound <= 1e-10 * proof.cost


# --- The fold of springs


@given(seeds, st.integers(2, 7), dimensions)
@settings(max_examples=40)
def test_a_cycle_passes_where_its_form_is_positive(seed, m, d):
    """The lemma, by eigenvalues: sum w |z - z'|^2 + 2 f.(z x z') around the cycle."""
    rng = rng_of(seed)
    w, f = rng.normal(0.6, 1.0, m), rng.normal(0.0, 0.5, so.tangent_dim(d))
    form = np.zeros((m * d, m * d))
    turn = so.hat(f if d == 3 else f[:1])
    for k in range(m):
        a, b = slice(k * d, k * d + d), slice((k + 1) % m * d, (k + 1) % m * d + d)
        for at in (a, b):
            form[at, at] += w[k] * np.eye(d)
        # f . (z x z') = z' . (f x z)
        form[b, a] += turn - w[k] * np.eye(d)
        form[a, b] += (turn - w[k] * np.eye(d)).T
    least = np.linalg.eigvalsh(form)[0]
    assume(abs(least) > 1e-9 or least > -1e-9)
    u, passes = w[0], True
    for stiffness in w[1:-1]:
        passes &= bool(u + stiffness > 0.0)
        u = (u * stiffness - f @ f) / (u + stiffness)
    passes &= bool(u + w[-1] >= 0.0)
    assert passes == (least > -1e-9)


# --- Laws


@pytest.fixture(scope="module")
def noisy():
    graph = random_graph(12, 4.0, 0.25, rng_of(3)).graph
    problem, here = stationary(graph)
    return graph, here, prove(problem, here)


def alike(proof, other, factor=1.0):
    assert other.proven == proof.proven
    assert other.ratio == pytest.approx(proof.ratio, rel=SOLVER)
    assert other.lower_bound == pytest.approx(factor * proof.lower_bound, rel=1e-9)


def test_gauge(noisy):
    graph, here, proof = noisy
    assert proof.proven
    turned = so.random(rng_of(0), 1, 3) @ here.rotations
    alike(proof, prove(Quadratic(graph), Estimate(turned)))


def test_relabelling_reversal_and_scaling(noisy):
    graph, here, proof = noisy
    to = rng_of(1).permutation(12)
    there = Estimate(here.rotations[np.argsort(to)])
    alike(
        proof,
        prove(Quadratic(RotationGraph(12, to[graph.edges], graph.rotations, graph.kappa)), there),
    )
    back = np.swapaxes(graph.rotations, 1, 2)
    alike(proof, prove(Quadratic(RotationGraph(12, graph.edges[:, ::-1], back, graph.kappa)), here))
    for factor in (2.0**-30, 1e6):
        alike(proof, prove(Quadratic(graph.scaled(factor)), here), factor)


def test_edges_that_are_doubled_are_twice_as_stiff():
    graph, here = at_identity(around(4), np.ones(4), np.full(4, 0.5), 3)
    twice = [np.concatenate([x, x]) for x in (graph.edges, graph.rotations, graph.kappa)]
    proof = prove(Quadratic(graph), here)
    alike(proof, prove(Quadratic(RotationGraph(4, *twice)), here), 2.0)


# --- Agreement


@given(seeds, dimensions, st.sampled_from([0.2, 0.6, 1.2]), st.booleans())
@settings(max_examples=12)
def test_what_is_proven_is_optimal_and_bounds_are_below_the_optimum(seed, d, noise, optimum):
    rng = rng_of(seed)
    graph, _ = rotation_graph(
        rng, int(rng.integers(3, 8)), d, extra=int(rng.integers(1, 6)), noise=noise
    )
    problem, here = stationary(graph, None if optimum else seed)
    best = solve(graph, cost="chordal")
    proof = prove(problem, here)
    assert proof.lower_bound <= best.certificate.cost_upper
    assert proof.cost >= problem.enclosure(here)[0]
    if proof.proven:
        assert least_eigenvalue(problem, here) > -1e-7
        assert proof.cost - proof.lower_bound <= 1e-5 * proof.cost + 1e-12 * graph.kappa.sum()


@given(seeds, dimensions, st.floats(1e-6, 1.0))
@settings(max_examples=10)
def test_the_bound_holds_at_any_rotations(seed, d, far):
    """The loss is of second order in the distance from a stationary point."""
    rng = rng_of(seed)
    graph, _ = rotation_graph(rng, 6, d, extra=3, noise=0.2)
    best = solve(graph, cost="chordal")
    off = so.exp(far * rng.standard_normal((6, so.tangent_dim(d))))
    problem = Quadratic(graph)
    proof = prove(problem, Estimate(best.estimate.rotations @ off))
    assert proof.lower_bound <= best.certificate.cost_upper
    at_best = prove(problem, Estimate(best.estimate.rotations))
    if far < 1e-3 and at_best.ratio < 0.9:
        assert proof.cost - proof.lower_bound <= 1e3 * far**2 * graph.kappa.sum()


def test_parts_of_poses():
    """Positions, points and edges without rotations change nothing."""
    graph = pose_graph(rng_of(5), 8, 3, extra=5, noise=0.1)[0]
    problem, here = stationary(graph.rotations_alone)
    alone = prove(problem, here)
    posed = Quadratic(graph)
    with_positions = posed.complete(here.rotations)
    alike(alone, prove(posed, with_positions))
    point = PoseGraph(
        RotationGraph(
            9,
            np.vstack([graph.edges, [[0, 8], [1, 8]]]),
            np.concatenate([graph.rotations, np.tile(np.eye(3), (2, 1, 1))]),
            np.r_[graph.kappa, 0.0, 0.0],
        ),
        np.vstack([graph.translations, np.ones((2, 3))]),
        np.r_[graph.tau, 1.0, 1.0],
        points=np.arange(9) == 8,
    )
    alike(alone, prove(Quadratic(point), Quadratic(point).complete(here.rotations)))


def test_a_tree_needs_no_cycles():
    graph, _ = rotation_graph(rng_of(2), 5, 3, extra=0)
    problem, here = stationary(graph)
    proof = prove(problem, here)
    assert proof.proven
    assert (len(proof.cycles), proof.ratio) == (0, 0.0)
    # A residual of half a turn on a bridge is stationary too, and no optimum.
    graph, here = at_identity(np.array([[0, 1], [1, 2]]), np.ones(2), [0.0, np.pi], 2)
    assert not prove(Quadratic(graph), here).proven


def test_refusals():
    graph, _ = rotation_graph(rng_of(2), 5, 3)
    with pytest.raises(InputError, match="4 nodes"):
        prove(Quadratic(graph), Estimate(np.tile(np.eye(3), (4, 1, 1))))
    here = Estimate(np.tile(np.eye(3), (5, 1, 1)))
    weights = np.tile(np.diag([1.0, 2.0, 3.0]), (graph.num_edges, 1, 1))
    with pytest.raises(InputError, match="isotropic weights"):
        prove(Quadratic(graph.with_matrix_weights(weights)), here)
    with pytest.raises(InputError, match="chordal problem"):
        prove(objective_of(graph, kernel="huber:5deg"), here)


def test_more_cycles_ask_for_less():
    graph = complete(6, 0.3, rng_of(4)).graph
    problem, here = stationary(graph)
    few, all_ = prove(problem, here, most=0), prove(problem, here)
    assert len(few.cycles) < len(all_.cycles)
    assert all_.ratio <= few.ratio * (1.0 + SOLVER)


def test_the_smallest_loss_is_what_cycles_leave():
    """Two parallel edges: w and -w, f and -f, whose best values a grid finds."""
    phi, c = np.array([[0.3], [0.1]]), np.array([1.0, 2.0])
    split = SplitProgram(cycle_list(2, np.array([[0, 1], [0, 1]]), 10), phi, c).smallest_loss()

    def loss(w, f):
        delta, off = np.array([w, -w]) - c, phi[:, 0] - [f, -f]
        return (delta + np.hypot(delta, off)).sum()

    best = min(loss(w, f) for w in np.linspace(-2, 2, 81) for f in np.linspace(-0.4, 0.4, 81))
    assert best - 0.005 <= split.value <= best + 1e-6

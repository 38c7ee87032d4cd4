"""Attempts to get a false verdict, kept after they were found."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from certpgo import certify, io, solve
from certpgo.certify import Verdict, dual_bound
from certpgo.errors import InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import CSC
from certpgo.linalg.rounding_bound import RoundingBound, is_cholesky
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import descent
from certpgo.optimize.methods.eigen_ra import EigenRA
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.optimize.solution import Status

ATTACKS = Path(__file__).parents[1] / "data" / "attacks"


def wound_poses(n, winding, tau=1.0, theta=0.0):
    """A wound-up cycle of poses that all stand at the origin."""
    instance, estimate = winding_cycle(n, theta, winding)
    graph = PoseGraph(instance.graph, np.zeros((n, 3)), np.full(n, tau))
    return Quadratic(graph), estimate


@pytest.mark.parametrize("refine", [True, False])
def test_overflow_certifies_nothing(refine):
    problem, wound = wound_poses(20, 1)
    far = Estimate(wound.rotations, 1e170 * np.eye(20, 3))
    certificate = certify(problem, far, refine=refine)
    assert math.isinf(certificate.cost_upper)
    assert certificate.verdict is not Verdict.CERTIFIED
    assert "range of doubles" in certificate.reason


def test_weights_that_add_up_beyond_doubles_are_refused():
    problem, wound = wound_poses(20, 1)
    far = Quadratic(PoseGraph(problem.graph.rotations_alone, np.full((20, 3), 1e160), np.ones(20)))
    with pytest.raises(InputError, match="beyond the range of doubles"):
        certify(far, Estimate(wound.rotations, np.zeros((20, 3))))


@pytest.mark.parametrize("power", [-390, -300, 0, 300, 390])
def test_verdicts_know_no_scale(power):
    instance, wound = winding_cycle(20, 0.3, 1)
    _, right = winding_cycle(20, 0.3, 0)
    reference = certify(Quadratic(instance.graph), right)
    problem = Quadratic(instance.graph.with_weights(2.0**power))
    assert certify(problem, wound).verdict is Verdict.REFUTED
    certificate = certify(problem, right)
    assert certificate.verdict is Verdict.CERTIFIED
    assert certificate.relative_gap == reference.relative_gap  # to the bit
    assert certificate.lower_bound == 2.0**power * reference.lower_bound


class _Rigged:
    """A factorization that always completes: of the matrix made definite by force."""

    engine = "rigged"
    measurable = False

    def __init__(self, A):
        self.lengths = np.full(A.shape[0], float(A.shape[0]))

    def rounding(self, A, w):
        values, vectors = np.linalg.eigh(A.toarray())
        forced = (vectors * np.maximum(values, 1e-3)) @ vectors.T
        L = np.linalg.cholesky(forced)
        if not is_cholesky((L**2).sum(axis=1), A):
            return None
        return RoundingBound(2.0**-53 * len(L) * (abs(L) @ abs(L).T @ w), L.size)


def test_a_rigged_factorization_is_noticed(monkeypatch):
    instance, wound = winding_cycle(12, 0.5, 1)
    problem = Quadratic(instance.graph)
    monkeypatch.setattr(Quadratic, "symbolic", lambda self, A: _Rigged(A))
    bound = dual_bound(problem, wound)
    optimum = 8 * 12 * math.sin(0.5 / 24) ** 2
    assert bound is None or bound.value <= optimum


@pytest.mark.parametrize("engine", factor.engines())
def test_the_factor_residual_stays_within_its_bound_on_a_graded_matrix(engine):
    """SuperLU's U is not D L^T: without its excess the bound fails by a factor of a million."""
    x = np.logspace(-8, 8, 200)
    G = np.exp(-(np.subtract.outer(x, x) ** 2)) * np.sqrt(np.outer(x, x)) + np.diag(x) * 1e-9
    A = CSC(sparse.csc_array(G))
    A.sort_indices()
    analysis = factor.analyze(A.indptr, A.indices, engine=engine).blocks(np.ones(200, dtype=int))
    L, p = analysis.factor(A).lower()
    dense = L.toarray().astype(np.longdouble)
    residual = np.empty(200)
    residual[p] = np.abs(G[np.ix_(p, p)].astype(np.longdouble) - dense @ dense.T).sum(axis=1)
    assert np.all(residual <= analysis.rounding(A, np.ones(200)).sums)


@pytest.mark.parametrize("offset", [1.0, 100.0, 1e5])
def test_a_costly_estimate_does_not_loosen_the_judgement_of_its_basin(offset):
    problem, wound = wound_poses(20, -1, theta=math.pi - 0.05)
    certificate = certify(problem, Estimate(wound.rotations, offset * np.eye(20, 3)))
    assert not certificate.basin_is_global
    assert certificate.verdict is Verdict.REFUTED
    assert certify(problem, certificate.refined).verdict is Verdict.REFUTED


@pytest.mark.parametrize("n", [10, 100, 1000])
@pytest.mark.parametrize("noise", [0.0, 1e-7, 1e-5, 1e-3])
def test_near_the_truth_of_exact_data(n, noise):
    rng = np.random.default_rng(0)
    instance, right = winding_cycle(n, 0.0, 0)
    graph = PoseGraph(instance.graph, np.zeros((n, 3)), np.ones(n))
    turned = right.rotations @ so.exp(noise * rng.standard_normal((n, 3)))
    certificate = certify(Quadratic(graph), Estimate(turned, np.zeros((n, 3))))
    assert certificate.lower_bound == 0.0
    assert certificate.basin_is_global
    assert certificate.verdict is (Verdict.BOUNDED if noise else Verdict.CERTIFIED)
    assert certificate.is_exact_fit is not bool(noise)


def test_descent_that_has_not_settled_refutes_nothing(monkeypatch):
    """Two steps do not suffice here; more of them end in the optimum's own basin."""
    rng = np.random.default_rng(0)
    instance = helix(18, rng)
    problem = Quadratic(instance.graph)
    start = Estimate(
        instance.truth.rotations @ so.exp(0.3 * rng.standard_normal((problem.n, 3))),
        instance.truth.translations,
    )
    assert newton(problem, start, NewtonSettings(max_iterations=2)).status is Status.ITERATION_LIMIT
    monkeypatch.setattr(descent, "DESCENT", NewtonSettings(max_iterations=2))
    certificate = certify(problem, start)
    assert certificate.verdict is not Verdict.REFUTED
    monkeypatch.undo()
    assert certify(problem, start).basin_is_global


def test_weights_of_absurdly_different_size_end_in_a_verdict():
    n = 6
    for signs in ([-1, 1, 1, 1, 1, -1], [1, -1, 1, -1, 1, -1]):
        for power in (6, 8, 12):
            problem, wound = wound_poses(n, 1)
            tau = 10.0 ** (power * np.array(signs, dtype=float))
            problem = Quadratic(problem.graph.with_weights(tau=tau))
            certificate = certify(problem, Estimate(wound.rotations, np.eye(n, 3)))
            assert certificate.verdict is not Verdict.CERTIFIED
            assert certificate.lower_bound <= 1e-6  # F* = 0


def test_the_spectral_bound_is_below_the_optimum_even_so():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        d = 2 + seed % 2
        angles = 0.01 * rng.standard_normal((12, so.tangent_dim(d)))
        instance, right = winding_cycle(12, 0.0, 0, d)
        graph = RotationGraph(12, instance.graph.edges, so.exp(angles), np.ones(12))
        problem = Quadratic(graph)
        best = newton(problem, right).cost
        assert EigenRA().solve(problem).lower_bound <= best


@pytest.mark.parametrize("tier", ["standard", "proof"])
def test_a_long_bridge_hides_no_winding(tier):
    # W is large, for one edge is 4,600 km long; what is wound up costs little beside it.
    rng = np.random.default_rng(0)
    n, step = 60, 2.0 * np.pi / 60
    ring = so.exp((step * np.arange(n))[:, None])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    noise = so.exp(0.02 * rng.standard_normal((n, 1)))
    measured = np.swapaxes(ring[i], 1, 2) @ ring[j] @ noise
    t = 10.0 * np.stack([np.sin(i * step), -np.cos(i * step)], axis=1)
    moves = np.einsum("nba,nb->na", ring[i], t[j] - t[i])
    edges = np.concatenate([np.stack([i, j], axis=1), [[0, n]]])
    rotation = RotationGraph(
        n + 1, edges, np.concatenate([measured, np.eye(2)[None]]), np.full(n + 1, 1000.0)
    )
    graph = PoseGraph(rotation, np.concatenate([moves, [[4.6e6, 0.0]]]), np.full(n + 1, 100.0))
    problem = Quadratic(graph)
    twice = np.concatenate([so.exp((2.0 * step * np.arange(n))[:, None]), np.eye(2)[None]])
    wound = newton(problem, problem.complete(twice)).estimate
    certificate = certify(problem, wound, tier=tier)
    assert certificate.verdict is Verdict.REFUTED
    assert certificate.better_cost < 0.1 * certificate.cost_upper


def test_a_better_point_in_hand_is_given_even_where_descent_did_not_settle():
    instance, _ = winding_cycle(200, 0.1, 1)
    graph = PoseGraph(instance.graph, np.tile([1.0, 0.0, 0.0], (200, 1)), np.ones(200))
    problem = Quadratic(graph)
    line = Estimate(np.tile(np.eye(3), (200, 1, 1)), np.arange(200)[:, None] * np.eye(1, 3))
    certificate = certify(problem, line)
    assert certificate.verdict is not Verdict.CERTIFIED
    best = certificate.better_cost or certificate.refined_cost
    assert best <= certificate.refined_cost


def test_graphs_and_problems_are_judged_and_nothing_else():
    instance, wound = winding_cycle(5, 0.0, 0)
    assert certify(instance.graph, wound).verdict == certify(instance, wound).verdict
    with pytest.raises(InputError, match="Quadratic"):
        certify(wound, wound)


@pytest.mark.parametrize("factor", [1.0, 2.0**170])
def test_weights_of_1e8_with_nearly_exact_data_prove_no_more_than_the_cost(factor):
    """What polar factors lose to rounding is larger than the residuals' own cost."""
    graph = io.read(ATTACKS / "stiff_and_nearly_exact.npz", quiet=True).graph.scaled(factor)
    for cost in ("gtsam", "g2o"):
        judged = solve(graph, cost=cost).certificate
        assert judged.lower_bound <= judged.cost_upper


def test_a_graph_that_stays_stiff_has_a_verdict():
    graph = io.read(ATTACKS / "always_stiff.npz", quiet=True).graph
    judged = solve(graph, cost="chordal").certificate
    assert judged.verdict is Verdict.BOUNDED
    assert 0.0 < judged.lower_bound <= judged.cost_upper

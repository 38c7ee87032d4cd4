"""GTSAM's cost against 80 digits and GTSAM itself; its minorants never above it, and touching."""

from dataclasses import replace

import arbs
import numpy as np
import pytest
from flint import arb, fmpq
from scipy.optimize import least_squares
from strategies import rng_of, rotation_graph

import certpgo
from certpgo import PoseGraph
from certpgo.graph import RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import Ball, near_rotations
from certpgo.objective import gtsam_plane, gtsam_space, gtsam_terms
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.minorants import Minorants

KINDS = ("plane", "plane without cross terms", "isotropic", "anisotropic", "cross terms")


@pytest.fixture(autouse=True)
def _precise():
    with arbs.precision():
        yield


def definite(rng, m, p, condition):
    V = np.linalg.qr(rng.standard_normal((m, p, p)))[0]
    values = condition ** rng.uniform(-0.5, 0.5, (m, 1, p))
    A = (V * values) @ np.swapaxes(V, 1, 2)
    return 0.5 * (A + np.swapaxes(A, 1, 2))


def cost_of(rng, m, kind, condition):
    """Edges with information of a kind; conditions of whole matrices, 10 of their blocks."""
    d = 2 if "plane" in kind else 3
    p = d * (d + 1) // 2
    information = definite(rng, m, p, condition)
    if kind in ("anisotropic", "cross terms"):
        information[:, :3, :3] = definite(rng, m, 3, 10.0)
        information[:, 3:, 3:] = 100.0 * definite(rng, m, 3, condition)
    if kind == "isotropic":
        information[:, :3, :3] = information[:, :1, :1] * np.eye(3)
    if kind == "cross terms":
        P = 0.3 * rng.standard_normal((m, 3, 3))
        carried = np.swapaxes(P, 1, 2) @ np.linalg.solve(information[:, :3, :3], P)
        information[:, 3:, 3:] += 0.5 * (carried + np.swapaxes(carried, 1, 2))
        information[:, :3, 3:], information[:, 3:, :3] = P, np.swapaxes(P, 1, 2)
    elif kind != "plane":
        information[:, :d, d:] = information[:, d:, :d] = 0.0
    t = 10.0 ** rng.uniform(-2, 2, (m, 1)) * rng.standard_normal((m, d))
    rotation = RotationGraph(2, np.tile([[0, 1]], (m, 1)), so.random(rng, m, d), np.ones(m))
    return GtsamCost(PoseGraph(rotation, t, np.ones(m)).with_information(information))


def turns(rng, m, d, least=-6.0, most=np.pi):
    """Rotation vectors with angles on a logarithmic scale up to ``most``."""
    w = rng.standard_normal((m, so.tangent_dim(d)))
    return w / np.linalg.norm(w, axis=1)[:, None] * most * 10.0 ** rng.uniform(least, 0, (m, 1))


def at(cost, y, w):
    """v and Q of translations y and rotation vectors w."""
    R = cost.graph.rotations
    return cost.graph.translations + (R @ y[:, :, None])[:, :, 0], R @ so.exp(w)


def unexplained(cost, v, Q, e):
    """y and log(E) of an edge, at 80 digits, and the measured pose."""
    R, t = arbs.nearest_rotation(cost.graph.rotations[e]), arbs.column(cost.graph.translations[e])
    E = R.transpose() * arbs.nearest_rotation(Q[e])
    return R.transpose() * (arbs.column(v[e]) - t), arbs.logarithm(E), R, t


@pytest.mark.parametrize("d", [2, 3])
def test_residuals_and_derivatives(d):
    rng = np.random.default_rng(d)
    cost = cost_of(rng, 12, "plane" if d == 2 else "cross terms", 100.0)
    v, Q = at(cost, rng.standard_normal((12, d)), turns(rng, 12, d, -4.0))
    e, in_v, in_w = cost.linearized(v, Q)
    np.testing.assert_array_equal(e, cost.residuals(v, Q))
    h = arb(fmpq(1, 10**25))
    for k in range(12):
        y, w, R, _ = unexplained(cost, v, Q, k)
        expected = arbs.gtsam_residual(w, y)
        size = np.linalg.norm(e[k]) + np.abs(v[k]).max() + 1.0
        assert np.abs(e[k] - floats(expected)).max() <= 1e-15 * size
        for a in range(d):
            moved = y + R.transpose() * arbs.column(np.eye(d)[a]) * h
            slope = floats((arbs.gtsam_residual(w, moved) - expected) * (1 / h))
            assert np.abs(in_v[k, :, a] - slope).max() <= 1e-14
        for a in range(in_w.shape[2]):
            step = [h * int(b == a) for b in range(in_w.shape[2])]
            turned = arbs.logarithm(arbs.exponential(w) * arbs.exponential(step))
            slope = floats((arbs.gtsam_residual(turned, y) - expected) * (1 / h))
            assert np.abs(in_w[k, :, a] - slope).max() <= 1e-14 * size


def floats(column):
    return np.array([float(x) for x in column.entries()])


@pytest.mark.gtsam
@pytest.mark.parametrize("d", [2, 3])
def test_costs_are_twice_the_error_of_gtsam(d):
    gtsam = pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")
    rng = np.random.default_rng(d)
    cost = cost_of(rng, 300, "plane" if d == 2 else "cross terms", 100.0)
    # GTSAM's own logarithm is less accurate at the ends: 1e-12 from a thousandth to 3.
    v, Q = at(cost, rng.standard_normal((300, d)), turns(rng, 300, d, -3.0, 3.0))
    graph = cost.graph
    for k, own in enumerate(cost.costs(v, Q)):
        if d == 2:
            measured = gtsam.Pose2(gtsam.Rot2(*angle(graph.rotations[k])), graph.translations[k])
            there = gtsam.Pose2(gtsam.Rot2(*angle(Q[k])), v[k])
            factor, first, order = gtsam.BetweenFactorPose2, gtsam.Pose2(), [0, 1, 2]
        else:
            measured = gtsam.Pose3(gtsam.Rot3(graph.rotations[k]), graph.translations[k])
            there = gtsam.Pose3(gtsam.Rot3(Q[k]), v[k])
            factor, first, order = gtsam.BetweenFactorPose3, gtsam.Pose3(), [3, 4, 5, 0, 1, 2]
        information = graph.information_matrices[k][np.ix_(order, order)]
        model = gtsam.noiseModel.Gaussian.Information(information)
        values = gtsam.Values()
        values.insert(0, first)
        values.insert(1, there)
        assert 2.0 * factor(0, 1, measured, model).error(values) == pytest.approx(own, rel=1e-12)


def angle(R):
    return (np.arctan2(R[1, 0], R[0, 0]),)


@pytest.mark.parametrize("d", [2, 3])
def test_enclosures_contain_the_cost_and_are_small(d):
    rng = np.random.default_rng(d)
    m = 100
    cost = cost_of(rng, m, "plane" if d == 2 else "cross terms", 100.0)
    w = turns(rng, m, d)
    w[:8] *= (np.pi - 10.0 ** -np.arange(8, 16.0))[:, None] / np.linalg.norm(w[:8], axis=1)[:, None]
    v, Q = at(cost, rng.standard_normal((m, d)), w)
    found = cost.enclosures(Ball.exact(v), near_rotations(Q))
    assert (found.radius[8:] <= 1e-13 * found.mid[8:]).all()
    for k in range(m):
        y, omega, _, _ = unexplained(cost, v, Q, k)
        value = arbs.gtsam_cost(cost.graph.information_matrices[k], omega, y)
        assert arbs.exact(found.lower[k]) <= value <= arbs.exact(found.upper[k])


@pytest.mark.parametrize("condition", [10.0, 1e8])
@pytest.mark.parametrize("kind", KINDS)
def test_minorants_are_nowhere_above_the_cost(kind, condition):
    """At points near and far, in the same direction and at half a turn: no tolerance."""
    rng = np.random.default_rng(len(kind))
    m, d = 20, 2 if "plane" in kind else 3
    cost = cost_of(rng, m, kind, condition)
    w, y = turns(rng, m, d, -4.0), 10.0 ** rng.uniform(-3, 1, (m, 1)) * rng.standard_normal((m, d))
    w[0] *= (np.pi - 1e-12) / np.linalg.norm(w[0])
    found = cost.minorants(*at(cost, y, w))
    assert found.exist.all()
    for k in range(m):
        R, t = (
            arbs.nearest_rotation(cost.graph.rotations[k]),
            arbs.column(cost.graph.translations[k]),
        )
        for j in range(12):
            near = 10.0 ** rng.uniform(-8, 0.5, 2)
            omega = w[k] + (j % 4 != 0) * near[0] * rng.standard_normal(w.shape[1])
            omega *= min(1.0, 3.14159265 / np.linalg.norm(omega))
            there = y[k] + (j % 4 != 1) * near[1] * rng.standard_normal(d)
            exactly = [arbs.exact(x) for x in omega]
            if j == 11:
                length = sum((x * x for x in exactly), arb(0)).sqrt()
                exactly = [x * arb.pi() / length for x in exactly]
            Q, v = R * arbs.exponential(exactly), t + R * arbs.column(there)
            value = arbs.gtsam_cost(cost.graph.information_matrices[k], exactly, arbs.column(there))
            assert arbs.minorant(found, k, v, Q) <= value


@pytest.mark.parametrize("kind", KINDS)
def test_minorants_touch_the_cost(kind):
    rng = np.random.default_rng(0)
    m, d = 60, 2 if "plane" in kind else 3
    cost = cost_of(rng, m, kind, 10.0)
    v, Q = at(cost, 0.1 * rng.standard_normal((m, d)), turns(rng, m, d, -4.0, 0.3))
    found = cost.minorants(v, Q)
    for k in range(m):
        y, omega, R, _ = unexplained(cost, v, Q, k)
        value = arbs.gtsam_cost(cost.graph.information_matrices[k], omega, y)
        loss = value - arbs.minorant(found, k, arbs.column(v[k]), R * arbs.exponential(omega))
        # The couplings and the constant are doubles.
        size = np.abs(found.N[k]).sum() + float(value) + found.tau[k] * found.b[k] @ found.b[k]
        assert 0 <= loss <= 4e-15 * size


def test_what_has_no_minorant():
    cost = cost_of(np.random.default_rng(0), 2, "anisotropic", 10.0)
    information = cost.graph.information_matrices.copy()
    information[0, 0, 0] = -1.0
    cost = GtsamCost(cost.graph.with_information(information))
    found = cost.minorants(*at(cost, np.ones((2, 3)), np.full((2, 3), 0.1)))
    assert found.exist.tolist() == [False, True]
    assert np.isfinite(np.c_[found.a, found.b, found.N.reshape(2, 9), found.tau]).all()


@pytest.mark.parametrize("kind", ["anisotropic", "cross terms"])
def test_a_coupling_that_is_not_paid_for_has_no_minorant(kind):
    cost = cost_of(np.random.default_rng(1), 40, kind, 10.0)
    y, w = 0.1 * np.ones((40, 3)), turns(np.random.default_rng(2), 40, 3, -1.0, 1e-3)
    enough = gtsam_terms.taken_apart(cost.graph, y, w)
    assert (enough.share == 1.0).all()
    less = replace(enough, mu=0.99 * enough.mu)
    for terms, exist in ((enough, True), (less, False)):
        tau, a, b, N = gtsam_space._edges(cost.graph, terms)
        found = Minorants(tau, a, b, N, np.zeros(40))
        constants = gtsam_space._constants(cost.graph, cost.measured, found, terms)
        assert (np.isfinite(constants) == exist).all()


@pytest.mark.parametrize("kind", ["plane", "isotropic"])
def test_a_term_that_is_not_convex_has_no_minorant(kind, monkeypatch):
    """X of more than five times the curvature, as for large angles it would be."""
    cost = cost_of(np.random.default_rng(1), 40, kind, 10.0)
    d = cost.graph.d
    where = at(cost, np.ones((40, d)), turns(np.random.default_rng(2), 40, d, -0.01, 3.0))
    assert cost.minorants(*where).exist.all()
    for module in (gtsam_plane, gtsam_terms):
        monkeypatch.setattr(module, "ROOM", 5.001)
    assert not cost.minorants(*where).exist.all()


@pytest.mark.parametrize("d", [2, 3])
def test_rotations_alone_are_averaged_by_their_angles(d):
    """Of weights that F has of small angles; against SciPy, from several starts."""
    graph, R = rotation_graph(rng_of(5), 7, d, extra=8, noise=0.1)
    found = {tier: certpgo.solve(graph, cost="gtsam", tier=tier) for tier in ("standard", "proof")}
    i, j = graph.edges.T
    weights = graph.kappa * (1.0 if d == 2 else 2.0)

    def residuals(x):
        R = so.exp(x.reshape(graph.num_nodes, -1))
        turns = so.log(np.swapaxes(R[i] @ graph.rotations, 1, 2) @ R[j])
        return (np.sqrt(weights)[:, None] * turns).ravel()

    starts = [R, found["standard"].estimate.rotations]
    least = min(2.0 * least_squares(residuals, so.log(one).ravel()).cost for one in starts)
    for answer in found.values():
        assert answer.verdict.value == "CERTIFIED"
        assert answer.cost == pytest.approx(least, rel=1e-8)
        assert answer.certificate.lower_bound <= least * (1.0 + 1e-12)

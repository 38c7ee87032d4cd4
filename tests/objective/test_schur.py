"""Weight set aside, what minimising over translations leaves, and less information."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import definite, dimensions, pose_graph, rng_of, seeds

from certpgo.linalg import rotations as so
from certpgo.objective import marginalized
from certpgo.objective.choose_cost import COSTS
from certpgo.objective.costs.g2o import G2oCost
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.g2o_space import quaternions
from certpgo.objective.marginalized import blocks, lowered, remainder, set_aside

few = settings(max_examples=20)


def weighed(rng, d, *, condition=100.0, n=5):
    graph, _, _ = pose_graph(rng, n, d, noise=0.1)
    Omega = definite(rng, graph.num_edges, d * (d + 1) // 2, condition)
    return graph.with_information(Omega)


def anywhere(rng, graph):
    d, m = graph.d, graph.num_edges
    return rng.standard_normal((m, d)), so.random(rng, m, d)


def forms(A, x):
    return np.einsum("ma,mab,mb->m", x, A, x)


# --- What is left


@given(seeds, dimensions)
@few
def test_the_remainder_is_the_minimum_over_translations(seed, d):
    """At the minimizer y = -A^-1 (P x + lam y'), and below the difference elsewhere."""
    rng = rng_of(seed)
    graph = weighed(rng, d)
    m, q = graph.num_edges, so.tangent_dim(d)
    e = rng.standard_normal((m, d + q))
    aside = set_aside(graph, e, lambda S, x, slope: np.ones(len(S)))
    measured = G2oCost(graph).measured
    quadratic, linear, constant = remainder(graph, measured, aside.lam, aside.b)
    np.testing.assert_allclose(aside.schur, quadratic.mid, rtol=1e-8)
    T, P, _ = blocks(graph.information_matrices, d)
    back = np.swapaxes(graph.rotations, 1, 2)
    at = (back @ (aside.b - graph.translations)[:, :, None])[:, :, 0]
    A = T - aside.lam[:, None, None] * np.eye(d)

    def difference(y, x):
        far = ((y - at) ** 2).sum(axis=1)
        return forms(graph.information_matrices, np.concatenate([y, x], axis=1)) - aside.lam * far

    for _ in range(4):
        x = rng.standard_normal((m, q))
        left = forms(quadratic.mid, x) + (linear.mid * x).sum(axis=1) + constant.mid
        push = (P @ x[:, :, None])[:, :, 0] + aside.lam[:, None] * at
        best = -np.linalg.solve(A, push[:, :, None])[:, :, 0]
        np.testing.assert_allclose(difference(best, x), left, rtol=1e-7, atol=1e-9)
        assert np.all(difference(rng.standard_normal((m, d)), x) >= left - 1e-9 * np.abs(left))
    # Nothing is lost where it is to touch.
    x = e[:, d:]
    left = forms(quadratic.mid, x) + (linear.mid * x).sum(axis=1) + constant.mid
    np.testing.assert_allclose(difference(e[:, :d], x), left, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_isotropic_translations_have_the_same_remainder_in_closed_form(d, monkeypatch):
    rng = rng_of(0)
    graph = weighed(rng, d)
    m = graph.num_edges
    Omega = graph.information_matrices.copy()
    Omega[:, :d, d:] = Omega[:, d:, :d] = 0.0
    t = rng.uniform(1.0, 100.0, m)
    Omega[:, :d, :d] = t[:, None, None] * np.eye(d)
    graph = graph.with_information(Omega)
    b = graph.translations + rng.standard_normal((m, d))
    measured = G2oCost(graph).measured
    for share in (0.3, 0.999, 1.0 - 2.0**-30):
        closed = remainder(graph, measured, share * t, b)
        with monkeypatch.context() as patched:
            patched.setattr(marginalized, "is_isotropic", lambda T: np.zeros(len(T), dtype=bool))
            eliminated = remainder(graph, measured, share * t, b)
        for found, expected in zip(closed, eliminated, strict=True):
            apart = np.abs(found.mid - expected.mid)
            assert np.all(apart <= found.radius + expected.radius)
            assert np.all(found.radius <= expected.radius)
    *_, constant = remainder(graph, measured, t, b)
    assert np.all(constant.lower == -np.inf)


def test_more_than_there_is_leaves_no_bound():
    graph = weighed(rng_of(0), 3)
    lam = 1.01 * np.linalg.eigvalsh(graph.information_matrices[:, :3, :3])[:, 0]
    *_, constant = remainder(graph, G2oCost(graph).measured, lam, graph.translations)
    assert np.all(constant.lower == -np.inf)


def test_the_share_with_the_largest_worth_is_set_aside():
    graph = weighed(rng_of(1), 2)
    T, P, W = blocks(graph.information_matrices, 2)
    limit = np.linalg.eigvalsh(T - P @ np.swapaxes(P, 1, 2) / W)[:, 0]
    e = np.ones((graph.num_edges, 3))
    none = set_aside(graph, e, lambda S, x, slope: np.full(len(S), -np.inf))
    assert np.isnan(none.lam).all()
    # Little curvature counts alone, and the smallest share leaves the most.
    least = set_aside(graph, e, lambda S, x, slope: S[:, 0, 0] - 1e9)
    np.testing.assert_allclose(least.lam, 0.1 * limit, rtol=1e-9)
    most = set_aside(graph, e, lambda S, x, slope: np.ones(len(S)))
    np.testing.assert_allclose(most.lam, 0.99 * limit, rtol=1e-9)


# --- Less information


@given(seeds, dimensions)
@few
def test_lowered_information_is_nowhere_above_and_has_no_cross_terms(seed, d):
    rng = rng_of(seed)
    graph = weighed(rng, d, condition=10.0 ** rng.uniform(0.0, 4.0))
    chosen = rng.random(graph.num_edges) < 0.7
    chosen[0] = True
    less = lowered(graph, chosen, lambda T, W: (T, W))
    assert (
        np.linalg.eigvalsh(graph.information_matrices - less.information_matrices)[chosen].min()
        > 0.0
    )
    np.testing.assert_array_equal(
        graph.information_matrices[~chosen], less.information_matrices[~chosen]
    )
    assert not blocks(less.information_matrices[chosen], d)[1].any()
    assert less.is_definite.all()
    assert lowered(graph, np.zeros_like(chosen), lambda T, W: (T, W)) is None
    # More than there was cannot be proven to be less.
    assert lowered(graph, chosen, lambda T, W: (2.0 * T, W)) is None


@pytest.mark.parametrize("name", ["g2o", "gtsam"])
@given(seeds, dimensions)
@few
def test_relaxed_costs_are_nowhere_above_and_have_minorants_everywhere(name, seed, d):
    rng = rng_of(seed)
    graph = weighed(rng, d, condition=10.0 ** rng.uniform(0.0, 3.0))
    cost = COSTS[name](graph)
    relaxed = cost.relaxed()
    if relaxed is None:
        assert (name, d) == ("gtsam", 2)
        return
    again = relaxed.relaxed()
    assert (again is None) is (name == "gtsam")
    assert again is None or again.relaxed() is None
    for _ in range(3):
        v, Q = anywhere(rng, graph)
        assert np.all(relaxed.costs(v, Q) <= cost.costs(v, Q))
        found = relaxed.minorants(v, Q)
        assert found.exist.all()
        at = v + (Q @ found.a[:, :, None])[:, :, 0] - found.b
        value = found.tau * (at * at).sum(axis=1) - 2.0 * (found.N * Q).sum(axis=(1, 2))
        value += found.constant
        assert np.all(value <= relaxed.costs(v, Q) * (1.0 + 1e-9))
        if name == "g2o":
            np.testing.assert_allclose(value, relaxed.costs(v, Q), rtol=1e-6)


@pytest.mark.parametrize("W", [(1e-8, 1.0, 1.0), (1e-6, 1.0, 10.0), (1e-3, 1.0, 1.0)])
def test_relaxing_ends_where_one_eigenvalue_is_tiny(W):
    graph = weighed(rng_of(2), 3)
    Omega = np.tile(np.diag([2.0, 3.0, 4.0, *W]), (graph.num_edges, 1, 1))
    relaxed = G2oCost(graph.with_information(Omega)).relaxed()
    if relaxed is not None:
        values = np.diag(relaxed.graph.information_matrices[0])[3:]
        assert values[2] == pytest.approx(max(values[1], 0.999 * (values[0] + values[1])), rel=1e-6)
        again = relaxed.relaxed()
        assert again is None or again.relaxed() is None


def test_nothing_is_relaxed_where_nothing_is_in_the_way():
    graph = weighed(rng_of(2), 3)
    plain = np.tile(np.diag([2.0, 2.0, 2.0, 1.0, 1.5, 2.0]), (graph.num_edges, 1, 1))
    flat = graph.with_information(plain)
    assert G2oCost(flat).relaxed() is None
    assert GtsamCost(flat).relaxed() is None
    plain[0, 5, 5] = 3.0
    steep = graph.with_information(plain)
    clipped = G2oCost(steep).relaxed().graph.information_matrices
    np.testing.assert_allclose(np.diag(clipped[0])[3:], [1.0, 1.5, 0.999 * 2.5], rtol=1e-8)
    np.testing.assert_array_equal(clipped[1:], plain[1:])
    assert GtsamCost(steep).relaxed() is None


# --- Curvature in space


@given(seeds)
@few
def test_couplings_are_semidefinite_where_minorants_touch(seed):
    """Steep rotational information: K of the couplings, in the frame of the estimate."""
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, 3, noise=0.1)
    m = graph.num_edges
    axes, Omega = so.random(rng, m, 3), np.tile(np.eye(6), (m, 1, 1))
    Omega[:, 3:, 3:] = (axes * np.array([1.0, 2.0, 50.0])) @ np.swapaxes(axes, 1, 2)
    Omega = 0.5 * (Omega + np.swapaxes(Omega, 1, 2))
    cost = G2oCost(graph.with_information(Omega))
    E = so.exp(0.02 * rng.standard_normal((m, 3)))
    v, Q = graph.translations, graph.rotations @ E
    found = cost.minorants(v, Q)
    assert found.exist.all()
    K = np.swapaxes(Q, 1, 2) @ found.N
    assert np.linalg.eigvalsh(0.5 * (K + np.swapaxes(K, 1, 2))).min() > -1e-12
    # It touches all the same.
    value = found.tau * ((v - found.b) ** 2).sum(axis=1) + found.constant
    value -= 2.0 * (found.N * Q).sum(axis=(1, 2))
    np.testing.assert_allclose(value, cost.costs(v, Q), atol=1e-11)


def test_quaternions_have_no_negative_real_part():
    E = np.stack([np.eye(3), np.diag([1.0, -1.0, -1.0]), so.exp(np.array([[0.0, 0.0, 3.0]]))[0]])
    q = quaternions(E)
    assert np.all(q[:, 0] >= 0.0)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(np.abs(q[1]), [0.0, 1.0, 0.0, 0.0], atol=1e-15)

"""g2o's chi2: against quaternion algebra, differences and ball arithmetic; minorants below it."""

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.spatial.transform import Rotation
from strategies import dimensions, rng_of, seeds

from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.g2o import G2oCost

pytest.importorskip("flint", reason="python-flint is not installed")

from exact_costs import (
    arb,
    balls,
    minorant,
    nearest_rotation,
    normalized,
    planar,
    product,
    quadratic,
    random_edges,
    residual,
    rounded,
    spatial,
    transposed,
    turns,
)

few = settings(max_examples=20)


def cost_of(R, t, Omega):
    """One measured pose with its information."""
    R, t, Omega = (np.asarray(x, dtype=float)[None] for x in (R, t, Omega))
    graph = PoseGraph(RotationGraph(2, np.array([[0, 1]]), R, np.ones(1)), t, np.ones(1))
    return G2oCost(graph.with_information(Omega))


# --- Values


def test_a_planar_edge_by_hand():
    """A quarter turn measured, an eighth more found; the step is off by (0.1, 0.2) in its frame."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    Omega = [[2.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 4.0]]
    cost = cost_of(turn, [1.0, 0.0], Omega)
    v, Q = np.array([[1.0 - 0.2, 0.1]]), turn[None] @ so.exp(np.array([[np.pi / 4]]))
    a = np.pi / 4
    np.testing.assert_allclose(cost.residuals(v, Q), [[0.1, 0.2, a]], rtol=0, atol=1e-15)
    expected = 2 * 0.01 + 3 * 0.04 + 4 * a * a + 2 * (0.02 + 0.05 * a - 0.2 * a)
    assert cost.costs(v, Q)[0] == pytest.approx(expected, rel=1e-14)


def test_a_spatial_edge_by_hand():
    """A turn of 2 pi / 3 about (1, 1, 1) has the quaternion (1, 1, 1, 1) / 2."""
    around = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    Omega = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    Omega[0, 3] = Omega[3, 0] = 0.5
    cost = cost_of(np.eye(3), [0.0, 0.0, 1.0], Omega)
    v, Q = np.array([[1.0, 0.0, 0.0]]), around[None]
    wanted = [[1.0, 0.0, -1.0, 0.5, 0.5, 0.5]]
    np.testing.assert_allclose(cost.residuals(v, Q), wanted, rtol=0, atol=1e-15)
    assert cost.costs(v, Q)[0] == pytest.approx(1 + 3 + 15 / 4 + 0.5, rel=1e-14)


@given(seeds, dimensions)
def test_residuals_are_those_of_g2os_own_pose_algebra(seed, d):
    """error = measurement^-1 * (from^-1 * to), in quaternions with w >= 0, or by angles."""
    rng, m = rng_of(seed), 8
    edges = random_edges(rng, m, d)
    graph = edges.cost.graph
    R, t = so.random(rng, m + 1, d), rng.standard_normal((m + 1, d))
    problem = Sum(graph, G2oCost)
    found = edges.cost.residuals(*problem.relative(Estimate(R, t)))
    total = 0.0
    for e, (i, j) in enumerate(graph.edges):
        if d == 2:
            angle = [np.arctan2(A[1, 0], A[0, 0]) for A in (graph.rotations[e], R[i], R[j])]
            turned = angle[2] - angle[1] - angle[0]
            turned = [np.arctan2(np.sin(turned), np.cos(turned))]
            # Rotations of vectors as products of complex numbers.
            step = complex(*(t[j] - t[i])) * np.exp(-1j * angle[1])
            off = (step - complex(*graph.translations[e])) * np.exp(-1j * angle[0])
            off = [off.real, off.imag]
        else:
            measured, first, second = (
                Rotation.from_matrix(A) for A in (graph.rotations[e], R[i], R[j])
            )
            q = (measured.inv() * (first.inv() * second)).as_quat()
            turned = q[:3] if q[3] >= 0.0 else -q[:3]
            off = measured.inv().apply(first.inv().apply(t[j] - t[i]) - graph.translations[e])
        error = np.r_[off, turned]
        np.testing.assert_allclose(found[e], error, rtol=0, atol=1e-13)
        total += error @ graph.information_matrices[e] @ error
    assert problem.cost(Estimate(R, t)) == pytest.approx(total, rel=1e-11)


@given(seeds, dimensions)
@few
def test_linearized_by_differences_at_fifty_digits(seed, d):
    rng, m = rng_of(seed), 3
    edges = random_edges(rng, m, d)
    v, Q = rounded(edges)
    e, in_v, in_w = edges.cost.linearized(v, Q)
    np.testing.assert_array_equal(e, edges.cost.residuals(v, Q))
    for k in range(m):
        by_v, by_w = differences(edges.cost, k, v[k], Q[k])
        np.testing.assert_allclose(in_v[k], by_v, rtol=0, atol=1e-13)
        np.testing.assert_allclose(in_w[k], by_w, rtol=0, atol=1e-12)


def differences(cost, k, v, Q):
    """Central differences of an edge's residual in v and in w, Q exp(w), with errors of 2^-160."""
    d, h = len(v), arb(2) ** -80
    R, t = nearest_rotation(cost.graph.rotations[k]), balls(cost.graph.translations[k])
    x, A = balls(v), nearest_rotation(Q)

    def central(there):
        ahead, behind = (residual(R, t, *there(s)) for s in (h, -h))
        return [float(((p - q) / (2 * h)).mid()) for p, q in zip(ahead, behind, strict=True)]

    def turned(c, s):
        if d == 2:
            return x, product(A, planar(s))
        q = normalized([arb(1), *(s / 2 * (b == c) for b in range(3))])
        return x, product(A, spatial(q))  # up to the third order

    by_v = [
        central(lambda s, c=c: ([y + s * (b == c) for b, y in enumerate(x)], A)) for c in range(d)
    ]
    by_w = [central(lambda s, c=c: turned(c, s)) for c in range(so.tangent_dim(d))]
    return np.array(by_v).T, np.array(by_w).T


# --- Enclosures


def enclosed(cost, v, Q):
    return cost.enclosures(Ball.exact(v), Ball.within(Q, rotation_defect(Q)))


@given(seeds, dimensions)
@few
def test_enclosures_contain_the_cost_of_the_doubles(seed, d):
    """The data are the nearest rotations; condition 1e8, angles up to pi - 1e-12."""
    rng, m = rng_of(seed), 8
    edges = random_edges(rng, m, d, condition=1e8, size=10.0 ** rng.uniform(-3.0, 3.0))
    gap = 10.0 ** rng.uniform(-12.0, -1.0, m // 2)
    if d == 2:
        edges.turn[: m // 2, 0] = np.copysign(np.pi - gap, edges.turn[: m // 2, 0])
    else:
        edges.turn[: m // 2, 0] = gap
    v, Q = rounded(edges)
    found = enclosed(edges.cost, v, Q)
    graph = edges.cost.graph
    for k in range(m):
        R, t = nearest_rotation(graph.rotations[k]), balls(graph.translations[k])
        e = residual(R, t, balls(v[k]), nearest_rotation(Q[k]))
        exact = quadratic(balls(graph.information_matrices[k]), e)
        assert exact >= found.lower[k]
        assert exact <= found.upper[k]
        size = np.abs(graph.information_matrices[k]).max() * max(float(x.mid()) ** 2 for x in e)
        lengths = np.abs(graph.information_matrices[k]).max() * np.abs(v[k]).max() ** 2
        if k >= m // 2:
            assert found.upper[k] - found.lower[k] <= 1e-12 * (size + lengths + 1.0)


HALF_TURNS = [np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])]


@pytest.mark.parametrize("axis", range(3))
def test_enclosures_at_half_turns_contain_both_costs(axis):
    """Where the residual angle is pi exactly, b and -b are both residuals."""
    Omega = np.eye(6)
    Omega[0, 3 + axis] = Omega[3 + axis, 0] = 0.5
    cost = cost_of(np.eye(3), np.zeros(3), Omega)
    v, Q = np.array([[2.0, 0.0, 0.0]]), HALF_TURNS[axis][None]
    found = enclosed(cost, v, Q)
    for sign in (1.0, -1.0):
        assert found.lower[0] <= 4.0 + 1.0 + sign * 2.0 <= found.upper[0]
    planar_cost = cost_of(
        np.eye(2), np.zeros(2), [[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]]
    )
    found = enclosed(planar_cost, np.array([[2.0, 0.0]]), -np.eye(2)[None])
    for sign in (1.0, -1.0):
        assert found.lower[0] <= 4.0 + np.pi**2 + sign * 2.0 * np.pi <= found.upper[0]


def test_stored_matrices_that_are_too_small_do_not_hide_cost():
    """Matrices off by 1e-9 stand for the nearest rotations."""
    rng = rng_of(3)
    for d in (2, 3):
        edges = random_edges(rng, 6, d)
        v, Q = rounded(edges)
        spoilt = Q * (1.0 - 1e-9)
        found = enclosed(edges.cost, v, spoilt)
        graph = edges.cost.graph
        for k in range(6):
            R, t = nearest_rotation(graph.rotations[k]), balls(graph.translations[k])
            e = residual(R, t, balls(v[k]), nearest_rotation(spoilt[k]))
            exact = quadratic(balls(graph.information_matrices[k]), e)
            assert exact >= found.lower[k]
            assert exact <= found.upper[k]


@given(seeds, dimensions)
@few
def test_enclosures_contain_the_costs_of_all_poses_in_the_balls(seed, d):
    """Rotations and translations at the balls' ends, moved together."""
    rng, m, r = rng_of(seed), 4, 1e-6
    edges = random_edges(rng, m, d, condition=1e3)
    edges.turn[0] = np.r_[0.3 * r, edges.turn[0, 1:]] if d == 3 else np.pi - 0.3 * r
    v, Q = rounded(edges)
    found = edges.cost.enclosures(Ball.within(v, r), Ball.within(Q, r))
    for _ in range(20):
        axis = rng.choice([-1.0, 1.0], (m, so.tangent_dim(d)))
        step = so.exp(1e-3 * axis) - np.eye(d)
        size = 0.999 * r * 1e-3 / np.abs(Q @ step).max(axis=(1, 2))
        turned = so.project(Q @ so.exp(size[:, None] * axis))
        moved = v + r * rng.choice([-1.0, 1.0], v.shape)
        assert np.all(np.abs(turned - Q) <= r)
        value = edges.cost.costs(moved, turned)
        assert np.all(value >= found.lower - 1e-12 * np.abs(value))
        assert np.all(value <= found.upper + 1e-12 * np.abs(value))


# --- Minorants


def points(rng, edges, e, count):
    """Residuals near and far from the expansion point of an edge, half turns included."""
    d = edges.cost.graph.d
    for k in range(count):
        step = 10.0 ** rng.uniform(-9.0, 0.5)
        near = k % 3 != 2
        scale = np.linalg.norm(edges.y[e]) if near else 10.0 ** rng.uniform(-2.0, 2.0)
        y = near * edges.y[e] + (step if near else 1.0) * scale * rng.standard_normal(d)
        turn = edges.turn[e] + step * rng.standard_normal(edges.turn.shape[1])
        if not near:
            turn = turns(rng, 1, d, True)[0]
        if d == 2:
            turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
            if k % 7 == 6:
                turn = np.copysign(np.pi - 10.0 ** rng.uniform(-15.0, -1.0), turn)
        else:
            if k % 7 == 6:
                turn[0] = rng.choice([0.0, 10.0 ** rng.uniform(-15.0, -1.0)])
            turn = turn if turn[0] >= 0.0 else -turn
        yield y, turn


@given(seeds, dimensions)
@settings(max_examples=40)
def test_minorants_are_nowhere_above_the_cost_without_any_tolerance(seed, d):
    """Exactly, for the stored doubles: condition up to 1e8, expansion up to pi - 1e-12."""
    rng, m = rng_of(seed), 6
    condition = 10.0 ** rng.uniform(0.0, 8.0)
    size = 10.0 ** rng.uniform(-2.0, 1.0)
    edges = random_edges(rng, m, d, condition=condition, size=size, far=seed % 2 == 0)
    gap = 10.0 ** rng.uniform(-12.0, -1.0)
    edges.turn[0, 0] = gap if d == 3 else np.copysign(np.pi - gap, edges.turn[0, 0])
    found = edges.cost.minorants(*rounded(edges))
    assert np.all(found.constant[~found.exist] == -np.inf)
    for e in np.flatnonzero(found.exist):
        R = nearest_rotation(edges.cost.graph.rotations[e])
        Omega = balls(edges.cost.graph.information_matrices[e])
        for y, turn in [(edges.y[e], edges.turn[e]), *points(rng, edges, e, 8)]:
            v, Q, residuals = edges.point(e, R, y, turn)
            assert quadratic(Omega, residuals) >= minorant(found, e, v, Q)


@given(seeds, dimensions)
@few
def test_minorants_touch_the_cost_with_its_gradient(seed, d):
    """Relative 1e-8 for information of condition 10 and residuals of the order one."""
    rng, m = rng_of(seed), 6
    edges = random_edges(rng, m, d, condition=10.0, size=0.3)
    if d == 2:
        edges.turn *= 0.4
    found = edges.cost.minorants(*rounded(edges))
    assert found.exist.sum() >= m - 1
    for e in np.flatnonzero(found.exist):
        R = nearest_rotation(edges.cost.graph.rotations[e])
        Omega = balls(edges.cost.graph.information_matrices[e])

        def apart(y, turn, R=R, Omega=Omega, e=e):
            v, Q, residuals = edges.point(e, R, y, turn)
            f = quadratic(Omega, residuals)
            return float((f - minorant(found, e, v, Q)).mid()), float(f.mid())

        y, turn = edges.y[e], edges.turn[e]
        lost, f = apart(y, turn)
        assert 0.0 <= lost <= 1e-8 * f
        # Equal gradients: at a distance of h, the two differ by some h^2.
        h, most = 1e-4, np.linalg.eigvalsh(edges.cost.graph.information_matrices[e])[-1]
        for c in range(d):
            moved, _ = apart(y + h * np.eye(d)[c], turn)
            assert moved <= 2.0 * most * h * h + 1e-8 * f
        for _ in range(2):
            nearby = turn + h * rng.uniform(-1.0, 1.0, turn.shape)
            if d == 2 or nearby[0] > 0.1:
                moved, _ = apart(y, nearby)
                assert moved <= 1e3 * most * h * h


@given(seeds)
@few
def test_rotational_information_costs_nothing_in_space(seed):
    """With isotropic translations and no cross terms m is f everywhere, up to 2^-29.

    But for (z.q)^2, where the largest eigenvalue of W is above the sum of the others.
    """
    rng, m = rng_of(seed), 4
    edges = random_edges(rng, m, 3, cross=0.0)
    values = np.linalg.eigvalsh(edges.cost.graph.information_matrices[:, 3:, 3:])
    taken = np.where(values[:, 2] < 0.999 * (values[:, 0] + values[:, 1]), 0.0, values[:, 2])
    found = edges.cost.minorants(*rounded(edges))
    assert found.exist.all()
    for e in range(m):
        R = nearest_rotation(edges.cost.graph.rotations[e])
        Omega = balls(edges.cost.graph.information_matrices[e])
        for y, turn in [(edges.y[e], edges.turn[e]), *points(rng, edges, e, 4)]:
            v, Q, residuals = edges.point(e, R, y, turn)
            f = quadratic(Omega, residuals)
            scale = f + quadratic(Omega, [*balls(edges.y[e]), *(arb(1) for _ in range(3))])
            lost = float((f - minorant(found, e, v, Q)).mid())
            assert 0.0 <= lost <= 1e-8 * float(scale.mid()) + taken[e]
            if turn is edges.turn[e]:
                assert lost <= 1e-8 * float(scale.mid())


def test_where_there_is_no_minorant_the_constant_says_so():
    """Translations that are not definite, or a slope that no turn below pi has."""
    half = np.diag([-1.0, -1.0, 1.0])
    for Omega in (np.diag([1.0, 0.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, 0.0])):
        found = cost_of(np.eye(2), np.zeros(2), Omega).minorants(np.zeros((1, 2)), np.eye(2)[None])
        assert (found.constant[0], bool(found.exist[0])) == (-np.inf, False)
    # Cross terms leave w - p^2 / T < 0 of the angle.
    crossed = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0], [2.0, 0.0, 3.0]])
    found = cost_of(np.eye(2), np.zeros(2), crossed).minorants(np.zeros((1, 2)), np.eye(2)[None])
    assert not found.exist[0]
    # The gradient is that of an angle beyond pi.
    steep = np.array([[4.0, 0.0, 1.0], [0.0, 4.0, 0.0], [1.0, 0.0, 1.0]])
    v = np.array([[10.0, 0.0], [0.1, 0.0]])
    R = np.tile(np.eye(2), (2, 1, 1))
    edges = np.array([[0, 1], [1, 2]])
    graph = PoseGraph(RotationGraph(3, edges, R, np.ones(2)), np.zeros((2, 2)), np.ones(2))
    cost = G2oCost(graph.with_information(np.tile(steep, (2, 1, 1))))
    np.testing.assert_array_equal(cost.minorants(v, R).exist, [False, True])
    flat = np.diag([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    found = cost_of(np.eye(3), np.zeros(3), flat).minorants(np.zeros((1, 3)), half[None])
    assert not found.exist[0]


def test_half_turns_exactly():
    """At pi the cost is two-valued with cross terms; a minorant is below both, if there is one."""
    for d, Q in ((2, -np.eye(2)), (3, HALF_TURNS[2])):
        p = d * (d + 1) // 2
        Omega = np.diag(np.r_[np.full(d, 4.0), np.full(p - d, 9.0)])
        plain = cost_of(np.eye(d), np.zeros(d), Omega)
        found = plain.minorants(np.ones((1, d)), Q[None])
        assert found.exist[0] == (d == 3)  # in the plane alpha is pi itself
        Omega[0, p - 1] = Omega[p - 1, 0] = 1.0
        crossed = cost_of(np.eye(d), np.zeros(d), Omega)
        found = crossed.minorants(np.ones((1, d)), Q[None])
        if found.exist[0]:
            for sign in (1, -1):
                b = [arb(0), arb(0), arb(sign)]
                f = quadratic(balls(Omega), [*(arb(1) for _ in range(d)), *b[3 - (p - d) :]])
                assert f >= minorant(found, 0, [arb(1)] * d, balls(Q))


def test_exact_arithmetic_agrees_with_itself():
    """The residual of an edge's point is the one that it was made from."""
    for d in (2, 3):
        edges = random_edges(rng_of(d), 5, d)
        for e in range(5):
            R = nearest_rotation(edges.cost.graph.rotations[e])
            v, Q, made = edges.point(e, R)
            again = residual(R, balls(edges.cost.graph.translations[e]), v, Q)
            assert all(abs(float((x - y).mid())) < 1e-60 for x, y in zip(made, again, strict=True))
            identity = product(transposed(R), R)
            assert all(
                abs(float((identity[a][b] - (a == b)).mid())) < 1e-60
                for a in range(d)
                for b in range(d)
            )

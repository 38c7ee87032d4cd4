"""Robust kernels: their functions, curvatures, minorants and costs, with bounds on all of them."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from strategies import pose_graph, rng_of

import certpgo
from certpgo import (
    Estimate,
    InputError,
    RotationGraph,
    SpecError,
    certify,
    solve,
    solve_robustly,
)
from certpgo.certify.bound import lower_bound
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.kernel_profiles import FARTHEST, PROFILES, least_of_convex
from certpgo.objective.kernels import AppliedKernel, Kernel
from certpgo.objective.robust_minorants import of_poses, of_rotations
from certpgo.objective.truncated_cost import UncertifiableError, rejecting
from certpgo.optimize.descent import descend

NAMES = sorted(PROFILES)
SMOOTH = ["cauchy", "geman-mcclure", "huber"]


def curvature(name, s, c):
    at = (Ball.exact(np.atleast_1d(np.asarray(x, dtype=float))) for x in (s, c))
    return PROFILES[name].curvature(*at)


def sampled(name, s, c):
    """The infimum over the circle that k is, in extended precision, on two grids."""
    profile, L = PROFILES[name], np.longdouble
    theta = np.arccos(L(1) - L(s) / 4)
    g0 = L(c) * profile.values(np.array([L(s) / L(c)]))[0]
    slope = 4 * np.sin(theta) * profile.slopes(np.array([L(s) / L(c)]))[0]

    def ratio(x):
        g = L(c) * profile.values(4 * (1 - np.cos(theta + x)) / L(c))
        return (g - g0 - slope * np.sin(x)) / (1 - np.cos(x))

    x = np.linspace(L(1e-5), 2 * L(np.pi) - L(1e-5), 20_000)
    near = x[np.argmin(ratio(x))]
    fine = np.linspace(max(near - 4e-4, L(1e-5)), min(near + 4e-4, 2 * L(np.pi) - L(1e-5)), 4_000)
    return float(min(ratio(x).min(), ratio(fine).min()))


# --- The functions --------------------------------------------------------------------------------


def test_the_least_curvatures_in_closed_form():
    """At no residual k is half of what a half turn costs; the others by hand."""
    for name, c in product(NAMES, (0.03, 1.0, 5.0)):
        half_turn = c * float(PROFILES[name].values(np.array([FARTHEST / c]))[0])
        assert curvature(name, 0.0, c) == pytest.approx(0.5 * half_turn, rel=1e-9)
    assert curvature("huber", 4.0, 1.0) == pytest.approx(-1.5, rel=1e-12)  # c / 2 - (c s)^(1/2)
    assert curvature("truncated", 8.0, 2.0) == pytest.approx(-1.0, rel=1e-12)  # -c / 2
    # A = c - s: (A^2 - 8 s + s^2) / (2 A).
    assert curvature("truncated", 1.0, 3.0) == pytest.approx((4.0 - 7.0) / 4.0, rel=1e-12)
    for name in ("huber", "truncated"):  # no two rotations are beyond the scale
        assert curvature(name, 3.0, 9.0) == pytest.approx(1.0, rel=1e-12)  # 4 cos theta
    assert curvature("truncated", 2.0, 2.0) == -np.inf  # the kink


@pytest.mark.parametrize("name", NAMES)
def test_the_curvature_is_below_and_near_the_sampled_infimum(name):
    rng = np.random.default_rng(3)
    s, c = 8.0 * rng.random(8) ** 2, 10.0 ** rng.uniform(-2.5, 1.2, 8)
    for found, s0, c0 in zip(curvature(name, s, c), s, c, strict=True):
        least = sampled(name, s0, c0)
        scale = max(min(4.0, c0), abs(least))
        assert least - 1e-6 * scale <= found <= least + 1e-8 * scale


@pytest.mark.parametrize("name", SMOOTH)
def test_half_the_square_that_is_taken_away_suffices(name):
    profile, x = PROFILES[name], np.linspace(0.0, 60.0, 60_001)
    for u in (0.0, 0.01, 0.3, 1.0, 2.0, 9.0, 400.0):
        x0, w = math.sqrt(u), float(profile.falls(np.array([u]))[0])
        slope = 2.0 * x0 * float(profile.slopes(np.array([u]))[0])
        below = profile.values(np.array([u])) + slope * (x - x0) - w * (x - x0) ** 2
        assert (below <= profile.values(x * x) + 1e-12).all()
        rise = np.diff(profile.values(x * x)) / np.diff(x)
        assert rise.max() <= profile.steepest


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_the_values(name):
    kernel = AppliedKernel(Kernel(name, 1.5), np.full(400, 2.25))
    q, h = np.linspace(0.01, 9.0, 400), 1e-6
    smooth = np.abs(q - 2.25) > 0.05
    by = (kernel.costs(q + h) - kernel.costs(q - h)) / (2.0 * h)
    assert np.allclose(by[smooth], kernel.slopes(q)[smooth], rtol=0.0, atol=1e-8)
    by = (kernel.slopes(q + h) - kernel.slopes(q - h)) / (2.0 * h)
    assert np.allclose(by[smooth], kernel.bends(q)[smooth], rtol=0.0, atol=1e-8)


def test_the_least_of_a_convex_function_is_bounded_from_below():
    places = Ball.exact(np.array([-0.5, 0.3, 0.77, 1.5]))

    def value(x):
        return (x - places) * (x - places) - 1.0

    least = least_of_convex(value, lambda x: 2.0 * (x - places), np.zeros(4), np.ones(4))
    exact = np.array([-0.75, -1.0, -1.0, -0.75])
    assert (least <= exact).all()
    assert (least >= exact - 1e-12).all()


# --- Minorants ------------------------------------------------------------------------------------


def rotated(name, seed, d):
    """Edges with residuals of all sizes, their kernel and where they are."""
    rng, m = rng_of(seed), 40
    R, kappa = so.random(rng, m, d), np.exp(rng.normal(size=m))
    axis = rng.normal(size=(m, so.tangent_dim(d)))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    size = np.pi * rng.random(m) ** rng.integers(1, 6, m)
    size[:4] = 0.0, np.pi, np.pi - 1e-9, 1e-9
    c = kappa * 10.0 ** rng.uniform(-2.0, 1.2, m)
    graph = RotationGraph(2 * m, np.arange(2 * m).reshape(m, 2), R, kappa)
    return rng, graph, AppliedKernel(Kernel(name, 1.0), c), R @ so.exp(size[:, None] * axis)


def robust_costs(kernel, graph, Q):
    return kernel.costs(graph.kappa * ((Q - graph.rotations) ** 2).sum(axis=(1, 2)))


def linear(found, Q):
    return found.constant - 2.0 * np.einsum("mab,mab->m", found.N, Q)


@settings(max_examples=12, deadline=None)
@given(name=st.sampled_from(NAMES), seed=st.integers(0, 2**31), d=st.sampled_from([2, 3]))
def test_minorants_of_rotations_touch_and_are_nowhere_above(name, seed, d):
    rng, graph, kernel, Q = rotated(name, seed, d)
    found, here = of_rotations(kernel, graph, Q), robust_costs(kernel, graph, Q)
    assert found.exist.all()
    room = 1e-12 * (graph.kappa + here)
    assert (linear(found, Q) <= here + 1e-3 * room).all()
    assert (linear(found, Q) >= here - 1e2 * room).all()
    m, q = len(Q), so.tangent_dim(d)
    for size in (0.0, 1e-6, 1e-3, 0.1):
        near = Q @ so.exp(size * rng.normal(size=(m, q)))
        for other in (near, graph.rotations @ so.exp(size * rng.normal(size=(m, q)))):
            assert (linear(found, other) <= robust_costs(kernel, graph, other) + room).all()
    for _ in range(20):
        other = so.random(rng, m, d)
        assert (linear(found, other) <= robust_costs(kernel, graph, other) + room).all()
    # Gradients are equal where the cost has one.
    smooth = np.abs(here / kernel.squares - 1.0) > 1e-2
    step, smooth = 1e-5 * rng.normal(size=(m, q)), smooth & (here > 0.0)
    ahead, back = Q @ so.exp(step), Q @ so.exp(-step)
    by_cost = robust_costs(kernel, graph, ahead) - robust_costs(kernel, graph, back)
    by_minorant = linear(found, ahead) - linear(found, back)
    bent = 1e-8 * (graph.kappa + here) * (1.0 + graph.kappa / kernel.squares)
    assert (np.abs(by_cost - by_minorant)[smooth] <= bent[smooth]).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
def test_minorants_of_poses_touch_and_are_nowhere_above(name, d):
    rng = np.random.default_rng(5)
    graph, *_ = pose_graph(rng, 8, d)
    m, q = graph.num_edges, so.tangent_dim(d)
    kernel = AppliedKernel(Kernel(name, 1.0), 10.0 ** rng.uniform(-2.0, 2.0, m))
    size = 10.0 ** rng.uniform(-3.0, 0.5, (m, 1))
    Q = graph.rotations @ so.exp(size * rng.normal(size=(m, q)))
    v = graph.translations + size * rng.normal(size=(m, d))

    def costs(v, Q):
        turned = graph.kappa * ((Q - graph.rotations) ** 2).sum(axis=(1, 2))
        return kernel.costs(turned + graph.tau * ((v - graph.translations) ** 2).sum(axis=1))

    def below(v, Q):
        return linear(found, Q) + found.tau * ((v - found.b) ** 2).sum(axis=1)

    found = of_poses(kernel, graph, v, Q)
    assert found.exist.all()
    assert (found.tau <= 0.0).all()
    here = costs(v, Q)
    touching = found.tau < 0.0  # the truncated kernel has none for some
    assert (below(v, Q) <= here * (1.0 + 1e-12) + 1e-12).all()
    assert (np.abs(below(v, Q) - here)[touching] <= 1e-8 * (1.0 + here)[touching]).all()
    for far in (0.0, 1e-3, 0.1, 1.0, 30.0, 1e3):
        for origin in (v, graph.translations):
            there = origin + far * rng.normal(size=(m, d))
            for other in (Q, graph.rotations, so.random(rng, m, d)):
                assert (below(there, other) <= costs(there, other) + 1e-9 * (1.0 + here)).all()


# --- Costs and bounds -----------------------------------------------------------------------------


def view_graph(seed, d=3, n=8, wrong=4, noise=0.05):
    """Rotations, each measured with each other, some wrongly."""
    rng = np.random.default_rng(seed)
    truth, pairs = so.random(rng, n, d), [(i, j) for i in range(n) for j in range(i)]
    edges, m = np.array(pairs), len(pairs)
    i, j = edges.T
    turns = so.exp(noise * rng.normal(size=(m, so.tangent_dim(d))))
    R = np.swapaxes(truth[i], 1, 2) @ truth[j] @ turns
    chosen = rng.choice(m, wrong, replace=False)
    R[chosen] = so.random(rng, wrong, d)
    return RotationGraph(n, edges, R, np.exp(0.3 * rng.normal(size=m))), Estimate(truth)


@pytest.mark.parametrize("kernel", ["huber:10deg", "huber:0.3", "geman-mcclure:40deg"])
def test_wrong_rotations_are_certified_among_all(kernel):
    graph, truth = view_graph(0, n=14, wrong=8)
    answer = solve(graph, kernel=kernel)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.problem.title == f"F, under {Kernel.parse(kernel)}"
    assert certify(graph, truth, kernel=kernel).lower_bound <= answer.cost
    # A plain fit costs more, and is refuted or bounded by that.
    plain = certify(graph, solve(graph).estimate, kernel=kernel)
    assert plain.verdict.value != "CERTIFIED"
    assert plain.lower_bound == pytest.approx(answer.cost, rel=1e-4)


@pytest.mark.parametrize("name", ["huber", "truncated"])
def test_an_idle_kernel_is_the_plain_cost(name):
    graph, _ = view_graph(1)
    plain, idle = solve(graph), solve(graph, kernel=f"{name}:180deg")
    assert idle.cost == pytest.approx(plain.cost, rel=1e-12)
    assert idle.verdict == plain.verdict
    scale = np.full(graph.num_edges, np.inf)
    problem = objective_of(graph, kernel=Kernel(name, scale))
    at = plain.estimate
    assert problem.cost(at) == pytest.approx(plain.cost, rel=1e-12)
    assert lower_bound(problem, at) == pytest.approx(plain.cost, rel=1e-9)


@pytest.mark.parametrize("kernel", ["huber:8deg", "cauchy:20deg"])
def test_laws_of_frames_names_directions_and_units(kernel):
    graph, _ = view_graph(2, n=10, wrong=3)
    best = solve(graph, kernel=kernel)
    problem, rng = best.problem, np.random.default_rng(0)
    W = so.random(rng, 1, 3)[0]
    turned = Estimate(W @ best.estimate.rotations)
    assert problem.cost(turned) == pytest.approx(best.cost, rel=1e-12)
    assert lower_bound(problem, turned) == pytest.approx(best.cost, rel=1e-6)
    order = rng.permutation(graph.num_nodes)
    i, j = order[graph.edges].T
    reversed_ = np.stack([j, i], axis=1), np.swapaxes(graph.rotations, 1, 2)
    other = RotationGraph(graph.num_nodes, *reversed_, graph.kappa)
    assert solve(other, kernel=kernel).cost == pytest.approx(best.cost, rel=1e-8)
    four = solve(graph.scaled(4.0), kernel=kernel)
    assert (four.cost, four.verdict) == (pytest.approx(4.0 * best.cost, rel=1e-9), best.verdict)
    # Given as residuals, scales grow with the roots of the weights.
    c = math.sqrt(8.0 * math.sin(math.radians(4.0)) ** 2)
    fixed = Kernel(kernel.split(":")[0], c * np.sqrt(graph.kappa))
    if kernel.startswith("huber"):
        assert solve(graph, kernel=fixed).cost == pytest.approx(best.cost, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_in_the_plane_scipy_reaches_the_same_optimum(name):
    graph, _ = view_graph(3, d=2, n=7, wrong=2)
    scale = 0.4
    found = solve(graph, kernel=f"{name}:{scale}")
    i, j = graph.edges.T
    a = np.arctan2(graph.rotations[:, 1, 0], graph.rotations[:, 0, 0])

    def residuals(x):
        angles = np.r_[0.0, x]
        return np.sqrt(8.0 * graph.kappa) * np.sin(0.5 * (angles[j] - angles[i] - a))

    def loss(z):
        profile = PROFILES[name]
        return np.stack([profile.values(z), profile.slopes(z), profile.bends(z)])

    known = {"huber": "huber", "cauchy": "cauchy"}.get(name, loss)
    R = found.estimate.rotations[0].T @ found.estimate.rotations
    own = np.arctan2(R[1:, 1, 0], R[1:, 0, 0])
    starts = [own, *np.random.default_rng(0).uniform(-np.pi, np.pi, (20, len(own)))]
    ends = [
        2.0 * least_squares(residuals, x, loss=known, f_scale=scale, xtol=1e-12, ftol=1e-14).cost
        for x in starts
    ]
    assert ends[0] == pytest.approx(found.cost, rel=1e-9)
    # Of truncated squares the search is local, but its bound is not.
    assert min(ends) >= found.certificate.lower_bound * (1.0 - 1e-9)
    if name != "truncated":
        assert min(ends) == pytest.approx(found.cost, rel=1e-7)


def test_no_bound_of_small_graphs_is_above_descents_from_many_starts():
    """A sample of ``python -m reports.studies.kernels campaign``."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        d, name = int(rng.integers(2, 4)), NAMES[seed % len(NAMES)]
        graph, truth = view_graph(seed, d, int(rng.integers(4, 8)), 2, 0.2 * rng.random())
        problem = objective_of(graph, kernel=Kernel(name, float(rng.uniform(5.0, 90.0)), True))
        answer = solve(problem, time_limit=1.0)
        starts = [truth, *(Estimate(so.random(rng, graph.num_nodes, d)) for _ in range(4))]
        least = min(descend(problem, start).cost for start in starts)
        assert answer.certificate.lower_bound <= least * (1.0 + 1e-9)
        if answer.verdict.value == "CERTIFIED":
            assert answer.cost <= least * (1.0 + 1e-5) + answer.certificate.tolerance


@pytest.mark.parametrize("cost", ["chordal", "g2o", "gtsam"])
@pytest.mark.parametrize("name", NAMES)
def test_poses_are_solved_with_what_else_is_measured(cost, name):
    """With priors and distances, which keep their squares, and odometry without a kernel."""
    rng = np.random.default_rng(8)
    graph, *_ = pose_graph(rng, 8, 2, extra=8, noise=0.02)
    W = np.zeros((graph.num_edges, 3, 3))
    W[:, [0, 1], [0, 1]], W[:, 2, 2] = graph.tau[:, None], graph.kappa
    graph = graph.with_information(W)
    m = graph.num_edges
    scale = np.where(np.arange(m) < 7, np.inf, 0.5)
    problem = objective_of(graph, cost, Kernel(name, scale))
    answer = solve(problem, time_limit=10.0)
    costs = objective_of(graph, cost).edge_costs(answer.estimate)
    by_hand = AppliedKernel(Kernel(name, 1.0), scale**2).costs(costs)
    assert answer.cost == pytest.approx(by_hand.sum(), rel=1e-12)
    low, high = problem.enclosure(answer.estimate)
    assert low <= by_hand.sum() <= high
    assert high - low <= 1e-9 * high
    assert answer.certificate.lower_bound <= answer.cost
    if cost != "chordal":
        return
    at = {"rotations": np.tile(np.eye(2), (2, 1, 1)), "translations": np.eye(2)}
    priors = certpgo.with_priors(graph, np.arange(2), **at, kappa=1.0, tau=1.0)
    far = certpgo.Ranges(8, np.array([[0, 5]]), np.ones(1), np.ones(1))
    for other in (graph.with_ranges(far), priors):
        both = solve(other, kernel=f"{name}:0.5", cost=cost, time_limit=5.0)
        plain = objective_of(other, cost).edge_costs(both.estimate)
        c = np.where(np.arange(len(plain)) < m, 0.25, np.inf)
        by_hand = AppliedKernel(Kernel(name, 1.0), c).costs(plain)
        assert both.cost == pytest.approx(by_hand.sum(), rel=1e-9)
        assert both.certificate.lower_bound <= both.cost


# --- What is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("huber", "the kernel 'huber' needs a scale: huber:SCALE, a positive number"),
        ("huber:-1", "the kernel 'huber:-1' needs a scale"),
        ("huber:inf", "needs a scale"),
        ("cauchy:5grad", "one of degrees such as cauchy:5deg"),
        ("huber:190deg", "at most 180"),
        ("huber:1e-200", "from 1e-100 to 1e.100"),
        ("huber:1e200", "beyond doubles"),
    ],
)
def test_kernels_without_a_scale_are_refused(text, said):
    with pytest.raises(InputError, match=said):
        Kernel.parse(text)


def test_other_names_are_refused():
    with pytest.raises(SpecError, match="hubert"):
        Kernel.parse("hubert:1")


def test_what_a_kernel_is_not_for_is_refused():
    graph, _ = view_graph(0)
    problem = objective_of(graph, kernel="huber:5deg")
    with pytest.raises(InputError, match="this problem has its cost already"):
        solve(problem, kernel="huber:5deg")
    with pytest.raises(InputError, match="one scale, or 28"):
        solve(graph, kernel=Kernel("huber", np.ones(3)))
    poses, *_ = pose_graph(np.random.default_rng(0), 5, 2)
    with pytest.raises(InputError, match="an angle for rotations alone"):
        solve(poses, kernel="huber:5deg")
    with pytest.raises(UncertifiableError, match="measurements are not rejected of F, under"):
        rejecting(problem, np.array([0]), prices=np.array([1.0]))
    with pytest.raises(InputError, match="a robust fit rejects measurements, which Huber's kernel"):
        solve_robustly(problem)
    with pytest.raises(InputError, match="the proof tier is not for F, under Huber"):
        solve(problem, tier="proof")
    answer = solve(problem)
    with pytest.raises(InputError, match=r"is no chi.2: give an excess, and no level"):
        answer.region(1)
    assert answer.region(1, excess=0.1).holds(answer.estimate)
    with pytest.raises(InputError, match="covariances are for costs without a robust kernel"):
        answer.covariance(1)
    couplings = graph.with_matrix_weights(np.tile(np.diag([1.0, 2.0, 3.0]), (28, 1, 1)))
    with pytest.raises(InputError, match="not take matrix weights"):
        solve(couplings, kernel="huber:1")
    with pytest.raises(InputError, match=r"huber:1\.5, expected"):
        solve(graph, kernel=3)

"""Graphs with priors and partial edges: solved, certified, and honest about what is open."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dense_cost, dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, Verdict, certify, solve, with_priors
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.kinds import Kind
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton

few = settings(max_examples=15)


def fixes(rng, graph, estimate, count, sigma, d, flat=None):
    """Noisy positions of some poses."""
    nodes = np.sort(rng.choice(graph.num_nodes, count, replace=False))
    p = estimate.translations[nodes] + sigma * rng.standard_normal((count, d))
    if flat is not None:
        p[:, 2] = flat
    return with_priors(graph, nodes, translations=p, tau=sigma**-2)


@given(seeds, dimensions)
@few
def test_bounds_are_below_what_descents_find(seed, d):
    rng = rng_of(seed)
    n = int(rng.integers(4, 9))
    graph, _, t = pose_graph(rng, n, d, noise=0.3)
    if seed % 2:
        partial = with_priors(graph, [0, 1, 2], translations=t[:3], tau=[1.0, 2.0, 3.0])
    else:
        kappa, tau = graph.kappa.copy(), graph.tau.copy()
        kappa[n - 1 :: 3] = 0.0  # of the edges that are not in the tree
        tau[n::3] = 0.0
        rotation = RotationGraph(n, graph.edges, graph.rotations, kappa)
        partial = PoseGraph(rotation, graph.translations, tau)
    problem = Quadratic(partial)
    answer = solve(partial)
    assert answer.cost == pytest.approx(dense_cost(partial, *_of(answer.estimate)), rel=1e-12)
    assert answer.certificate.lower_bound <= answer.cost * (1.0 + 1e-12)
    for _ in range(5):
        start = problem.complete(so.random(rng, problem.n, d))
        found = newton(problem, start).estimate
        assert answer.certificate.lower_bound <= problem.cost(found) * (1.0 + 1e-9)
        judged = certify(problem, found)
        assert judged.lower_bound <= answer.cost * (1.0 + 1e-9)


def _of(estimate):
    return estimate.rotations, estimate.translations


@pytest.mark.parametrize("name", ["sphere2500", "torus3D", "intel", "MIT"])
@pytest.mark.parametrize("share", [0.02, 0.5])
def test_gps_around_a_certified_optimum(name, share, dataset):
    graph = dataset(name).graph.under("chordal")
    best = solve(graph).estimate
    joined = fixes(rng_of(0), graph, best, int(share * graph.num_nodes), 0.5, graph.d)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer = solve(joined)
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.certificate.relative_gap < 1e-6
    world = graph.num_nodes
    there = answer.estimate.anchored(world).translations[:world]
    rms = np.sqrt(((there - best.translations) ** 2).sum(axis=1).mean())
    assert rms < 1.0  # metres: the estimate is in the frame of the positions


@given(seeds, dimensions)
@few
def test_moving_the_world_moves_the_answer(seed, d):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 8, d, noise=0.05)
    S, s = so.random(rng, 1, d)[0], rng.standard_normal(d)
    nodes = np.arange(8)
    first = solve(with_priors(graph, nodes, R, t, kappa=1.0, tau=1.0))
    second = solve(with_priors(graph, nodes, S @ R, t @ S.T + s, kappa=1.0, tau=1.0))
    assert second.cost == pytest.approx(first.cost, rel=1e-7)
    expected = first.estimate.anchored(8).moved(S, s).translations[:8]
    np.testing.assert_allclose(
        second.estimate.anchored(8).translations[:8], expected, atol=1e-5 * np.abs(expected).max()
    )


def test_a_graph_of_priors_alone_is_their_mean():
    """Two poses, each measured twice by position: the mean, in closed form."""
    rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.array([10.0]))
    graph = PoseGraph(rotation, np.array([[2.0, 0.0]]), np.array([1e8]))
    p = np.array([[0.0, 0.0], [0.0, 0.4], [2.0, 0.0], [2.0, 0.4]])
    answer = solve(with_priors(graph, [0, 0, 1, 1], translations=p, tau=1.0))
    there = answer.estimate.anchored(2).translations[:2]
    np.testing.assert_allclose(there, [[0.0, 0.2], [2.0, 0.2]], atol=1e-6)
    assert answer.cost == pytest.approx(4 * 0.2**2, rel=1e-6)
    assert answer.verdict is Verdict.CERTIFIED


def flat_fixes(seed, attitudes):
    """Odometry along a tree, and positions without their height; or attitudes of some poses too."""
    rng, n = rng_of(seed), 12
    graph, R, t = pose_graph(rng, n, 3, extra=0, noise=0.5)
    p = t + 0.3 * rng.standard_normal((n, 3))
    p[:, 2] = 0.0
    nodes = np.r_[np.arange(n), np.arange(attitudes)]
    tau = np.r_[np.full(n, 1.0 / 0.09), np.zeros(attitudes)]
    kappa = np.r_[np.zeros(n), np.full(attitudes, 10.0)]
    turned = R[nodes] if attitudes else None
    return with_priors(graph, nodes, turned, p[nodes % n], kappa=kappa, tau=tau)


def test_positions_in_a_plane_leave_handedness_open_and_attitudes_settle_it():
    for seed in (6, 8, 10):
        answer = solve(flat_fixes(seed, 0))
        assert answer.verdict is Verdict.BOUNDED
        assert 1e-3 < answer.certificate.relative_gap < 0.1
        assert "the positions lie in a plane, so a mirror image fits" in answer.certificate.reason
        cured = solve(flat_fixes(seed, 12))
        assert cured.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("cost", ["chordal", "g2o"])
@pytest.mark.parametrize("off", [0.05, 0.1])
def test_positions_on_a_line_of_the_plane_are_settled_over_complex_numbers(tmp_path, cost, off):
    """There a mirror image is no rotation; over real numbers, as in proofs, it fits."""
    rng, road = rng_of(0), tmp_path / "road.g2o"
    lines = []
    for k in range(9):
        x, y, turn = np.array([1.0, 0.0, 0.0]) + 0.1 * rng.standard_normal(3)
        lines.append(f"EDGE_SE2 {k} {k + 1} {x} {y} {turn} 100 0 0 100 0 100")
    fixes_at = ((0, off), (4, -off), (9, off))
    lines += [f"EDGE_PRIOR_SE2_XY {k} {k} {y} 100 0 100" for k, y in fixes_at]
    road.write_text("\n".join(lines))
    instance = certpgo.read(road, quiet=True)
    answer = solve(instance, cost=cost)
    assert answer.verdict is Verdict.CERTIFIED
    proven = certify(instance, answer.estimate, cost=cost, tier="proof")
    assert proven.lower_bound < answer.certificate.lower_bound <= answer.cost
    road.write_text("\n".join([*lines, "EDGE_PRIOR_SE2 0 0 0 0 100 0 0 100 0 100"]))
    assert solve(certpgo.read(road, quiet=True), cost=cost).verdict is Verdict.CERTIFIED


def test_other_methods_refuse_partial_edges_or_solve_them():
    rng = rng_of(3)
    graph, R, t = pose_graph(rng, 8, 3, noise=0.05)
    problem = Quadratic(fixes(rng, graph, Estimate(R, t), 6, 0.1, 3))
    best = solve(problem.graph)
    assert best.verdict is Verdict.CERTIFIED
    for name in ("newton", "eigen_q", "spanning_tree", "low_rank"):
        found = certpgo.get_solver(name)().solve(problem)
        assert best.certificate.lower_bound <= problem.cost(found.estimate) * (1.0 + 1e-9)
    assert certify(problem, best.estimate, tier="proof").verdict is Verdict.CERTIFIED


def test_covariances_in_the_world(dataset):
    """A position prior of one pose alone is its covariance, where attitudes are certain."""
    graph, R, t = pose_graph(rng_of(5), 6, 3, noise=0.0)
    joined = with_priors(graph, [2], R[2:3], t[2:3], kappa=1e9, tau=4.0)
    answer = solve(joined)
    C = certpgo.Marginals(answer.problem, answer.estimate, anchor=6).covariance(2)
    np.testing.assert_allclose(C[:3, :3], 0.25 * np.eye(3), atol=1e-6)


def test_removing_a_bridge_or_outliers_frees_no_rotation():
    """A node held by a lever alone, and a world whose only good fix is at its origin."""
    edges = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [3, 4]])
    kappa = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    rotation = RotationGraph(5, edges, np.tile(np.eye(2), (6, 1, 1)), kappa)
    t = np.array([[1.0, 0], [0, 1], [-1, -1], [1, 2], [0, 2], [3000, 0]])
    assert solve(PoseGraph(rotation, t, np.ones(6))).certificate.lower_bound >= 0.0
    instance = helix(6, np.random.default_rng(0))
    nodes = np.arange(0, 36, 6)
    fixes = 50.0 * rng_of(0).standard_normal((6, 3))
    fixes[0] = 0.0
    joined = with_priors(instance.graph, nodes, translations=fixes, tau=100.0)
    answer = certpgo.solve_robustly(joined)
    assert answer.problem.n == 37


@pytest.mark.parametrize("count", [1, 2])
def test_what_too_few_positions_leave_open_has_no_covariance(count):
    instance = helix(6, np.random.default_rng(0))
    fixes = instance.truth.translations[:count]
    answer = solve(with_priors(instance.graph, np.arange(count), translations=fixes, tau=1.0))
    marginals = certpgo.Marginals(answer.problem, answer.estimate, anchor=36)
    for compute in (lambda: marginals.covariances, lambda: marginals.covariance(3)):
        with pytest.raises(certpgo.NumericalError, match="do not determine all nodes"):
            compute()


def test_a_world_that_was_assumed_to_be_somewhere_is_where_positions_say():
    made = helix(3, np.random.default_rng(0))
    nodes, n = np.arange(0, made.graph.num_nodes, 4), made.graph.num_nodes
    R, positions = made.truth.rotations[nodes], made.truth.translations[nodes] + 0.3
    turned = with_priors(made.graph, nodes, R, kappa=50.0)
    assert np.flatnonzero(turned.assumed).tolist() == [made.graph.num_edges + len(nodes)]
    both = with_priors(turned, nodes, translations=positions, tau=9.0, world=n)
    other = with_priors(made.graph, nodes, translations=positions, tau=9.0)
    other = with_priors(other, nodes, R, kappa=50.0, world=n)
    assert both.assumed is other.assumed is None
    assert solve(both).cost == pytest.approx(solve(other).cost, rel=1e-9)


def compasses(wrong, rng):
    """Twelve poses around a circle, a compass at five of them, one of which is wrong."""
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    t, R = (
        3.0 * np.stack([np.cos(turns), np.sin(turns)], axis=1),
        so.exp(turns[:, None] + np.pi / 2),
    )
    edges = np.stack([np.arange(12), np.roll(np.arange(12), -1)], axis=1)
    i, j = edges.T
    measured = np.swapaxes(R[i], 1, 2) @ R[j] @ so.exp(0.01 * rng.standard_normal((12, 1)))
    steps = (np.swapaxes(R[i], 1, 2) @ (t[j] - t[i])[:, :, None])[:, :, 0]
    steps += 0.01 * rng.standard_normal((12, 2))
    rotation = RotationGraph(12, edges, measured, np.full(12, 1e4))
    seen = 0.01 * rng.standard_normal((5, 1))
    seen[wrong] += 1.5
    nodes = np.array([0, 3, 5, 7, 9])
    graph = PoseGraph(rotation, steps, np.full(12, 1e4))
    return with_priors(graph, nodes, R[nodes] @ so.exp(seen), kappa=1e4)


@pytest.mark.parametrize("wrong", range(5))
def test_a_wrong_compass_is_rejected_whichever_it_is(wrong):
    """Also the first, at whose node the world is put."""
    graph = compasses(wrong, np.random.default_rng(1))
    answer = certpgo.solve_robustly(graph)
    assert answer.rejected.tolist() == [12 + wrong]
    assert answer.verdict.value == answer.rejection.verdict.value == "CERTIFIED"
    assert answer.rejection.quantile == pytest.approx(1.0 - 0.01 / 17, rel=1e-15)
    without = solve(graph.with_edges(np.delete(np.arange(18), 12 + wrong)))
    assert answer.certificate.cost_upper == pytest.approx(without.cost, rel=1e-9)
    judged = certpgo.certify(graph, answer.estimate, rejected=answer.rejected)
    assert judged.cost_upper == pytest.approx(without.cost + answer.rejection.prices[0], rel=1e-9)
    assert graph.num_measurements == 17
    session = certpgo.RobustSession(every=None)
    session.add(graph, [*range(12), certpgo.WORLD])
    session.settle()
    assert session.rejected.tolist() == [12 + wrong]
    assert session.standing.edges == 16
    assert session.rejection().edges.tolist() == [12 + wrong]


@pytest.mark.parametrize("d", [2, 3])
def test_wrong_closures_and_fixes_of_gps_are_rejected_and_no_others(d):
    """A fit to all measurements hides them: odometry and GPS alone show where to begin."""
    rng, n = np.random.default_rng(d), 80
    turn = np.linspace(0.0, 4.0 * np.pi, n)
    t = np.stack([20.0 * np.cos(turn), 12.0 * np.sin(turn), 2.0 * np.sin(3.0 * turn)], axis=1)
    yaw = np.pad(turn[:, None], ((0, 0), (2, 0)))
    R = so.exp(yaw if d == 3 else turn[:, None])
    steps = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    around = np.stack([np.arange(0, n // 2, 3), np.arange(0, n // 2, 3) + n // 2], axis=1)
    bad = np.array([[3, 50], [11, 62], [20, 33], [40, 71], [9, 27]])
    pairs = np.concatenate([steps, around, bad])
    i, j = pairs.T
    turns = np.swapaxes(R[i], 1, 2) @ R[j]
    turns = turns @ so.exp(0.01 * rng.standard_normal((len(pairs), so.tangent_dim(d))))
    turns[-5:] = so.exp(rng.uniform(-1.0, 1.0, (5, so.tangent_dim(d))))
    moves = np.einsum("mba,mb->ma", R[i], (t[j] - t[i])[:, :d])
    moves += 0.03 * rng.standard_normal(moves.shape)
    moves[-5:] = rng.uniform(-2.0, 2.0, (5, d))
    m, nodes = len(pairs), np.arange(0, n, 8)
    rotation = RotationGraph(n, pairs, turns, np.full(m, 5e3))
    measured = t[nodes, :d] + 0.3 * rng.standard_normal((len(nodes), d))
    measured[4] += 12.0
    graph = PoseGraph(rotation, moves, np.full(m, 0.03**-2))
    answer = certpgo.solve_robustly(with_priors(graph, nodes, translations=measured, tau=0.3**-2))
    assert answer.rejected.tolist() == [*range(m - 5, m), m + 4]
    assert answer.verdict is answer.rejection.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("d", [2, 3])
def test_files_of_attitudes_alone_are_read_written_and_merged(tmp_path, d):
    """Where the world is put is in no file, and in no count."""
    if d == 2:
        step, attitude = (
            "EDGE_SE2 {} {} 1 0 0.3 4 0 0 4 0 9\n",
            "EDGE_PRIOR_SE2 {} 7 8 {} 0 0 0 0 0 9\n",
        )
    else:
        weights = "4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 9 0 0 9 0 9"
        step = "EDGE_SE3:QUAT {} {} 1 0 0 0 0 0.1 0.995 " + weights + "\n"
        attitude = "EDGE_SE3_PRIOR {} 0 7 8 9 {} 0 0 0.995 " + weights.replace("4", "0") + "\n"
    lines = [step.format(k, k + 1) for k in range(5)] + [step.format(0, 5)]
    priors = [attitude.format(1, 0.1), attitude.format(4, 0.3)]
    path, again, one, two, joint = (tmp_path / f"{k}.g2o" for k in ("a", "b", "c", "d", "e"))
    path.write_text("".join(lines + priors))
    instance = certpgo.read(path, quiet=True)
    assert instance.num_measurements == 8
    assert instance.measurements.are(Kind.ATTITUDE).sum() == 2
    certpgo.write(again, instance)
    assert sum(line.startswith("EDGE") for line in again.read_text().splitlines()) == 8
    cost = solve(instance.graph, cost="chordal").cost
    there = certpgo.read(again, quiet=True)
    assert solve(there.graph, cost="chordal").cost == pytest.approx(cost, rel=1e-9)
    assert there.known_numbers.tolist() == [*range(8), -1]
    for name in ("chordal", "g2o"):
        both = [certpgo.solve(k, cost=name).cost for k in (instance, there)]
        assert both[0] == pytest.approx(both[1], rel=1e-9)
    one.write_text("".join(lines[:2] + priors[:1]))
    two.write_text("".join(lines[3:5] + priors[1:]))
    joint.write_text("".join([lines[2], lines[5]]))
    maps = [certpgo.read(k, quiet=True) for k in (one, two, joint)]
    merged = certpgo.merge(maps[:2], maps[2])
    assert merged.answer.cost == pytest.approx(certpgo.solve(instance).cost, rel=1e-9)
    assert merged.instance.num_measurements == 8
    assert len(merged.between) == 2
    assert merged.instance.graph.information is not None
    certificate = certpgo.certify(instance, certpgo.solve(instance, cost="chordal").estimate)
    proven = certpgo.write_proof(tmp_path / "p", path, instance, certificate.best, certificate)
    assert proven.lower == pytest.approx(certificate.lower_bound, rel=1e-3)

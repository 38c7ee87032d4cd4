"""Rejections under the costs of g2o and GTSAM."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from strategies import definite, pose_graph, rng_of

from certpgo import certify, merge, read, solve, solve_robustly
from certpgo.certify.certificate import Verdict
from certpgo.graph import PoseGraph, RotationGraph, matrix_weights
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import COSTS, Sum
from certpgo.objective.marginalized import isotropic_below
from certpgo.objective.quadratic import Quadratic


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("crossed", [True, False])
def test_isotropic_costs_are_below(cost, d, crossed):
    rng = rng_of(d)
    graph, *_ = pose_graph(rng, 40, d, extra=200)
    m, p = graph.num_edges, d * (d + 1) // 2
    information = definite(rng, m, p, condition=1e4) * np.exp(rng.normal(size=(m, 1, 1)))
    if not crossed:
        information[:, :d, d:] = information[:, d:, :d] = 0.0
    full = graph.with_information(information)
    posed = Sum(full, COSTS[cost])
    below = isotropic_below(full, posed.of_edges.turned_share)
    for size in (1e-3, 0.3, 3.0):
        E = so.exp(size * rng.standard_normal((m, so.tangent_dim(d))))
        Q = graph.rotations @ E
        v = graph.translations + size * rng.standard_normal((m, d))
        squares = ((Q - graph.rotations) ** 2).sum(axis=(1, 2))
        least = below.kappa * squares
        least += below.tau * ((v - graph.translations) ** 2).sum(axis=1)
        costs = posed.of_edges.costs(v, Q)
        assert (least <= costs * (1.0 + 1e-12)).all()
    assert (least > 0.0).all()


def test_wrong_loops_are_rejected_and_certified(dataset):
    clean, rng = dataset("kitti_00"), rng_of(0)
    graph = clean.graph
    loops = np.flatnonzero(np.abs(np.diff(graph.edges, axis=1)[:, 0]) > 1)
    bad = np.sort(rng.choice(loops, 15, replace=False))
    R, t = np.array(graph.rotations), np.array(graph.translations)
    R[bad] = so.random(rng, 15, 2)
    t[bad] += 5.0 * rng.standard_normal((15, 2))
    wrong = replace(clean, graph=replace(graph, rotations=R, translations=t))
    answer = solve_robustly(wrong, cost="g2o")
    assert np.array_equal(answer.solution.rejected, bad)
    assert answer.verdict is answer.rejection.verdict is Verdict.CERTIFIED
    again = certify(wrong, answer.estimate, cost="g2o", rejected=bad)
    assert again.verdict is Verdict.CERTIFIED
    assert again.objective.startswith("truncated cost, ")
    assert again.cost_upper == pytest.approx(
        answer.certificate.cost_upper + answer.rejection.prices.sum()
    )


def test_rejections_of_edges_with_matrix_weights_are_certified():
    graph, *_ = pose_graph(rng_of(0), 12, 3, extra=40, noise=0.01)
    R = np.array(graph.rotations)
    R[-1] = so.random(rng_of(1), 1, 3)[0]
    n, kappa = graph.num_nodes, 5000.0 * np.ones(graph.num_edges)
    whole = PoseGraph(RotationGraph(n, graph.edges, R, kappa), graph.translations, kappa)
    K = 5000.0 * np.tile(np.diag([1.0, 1.0, 1.1]), (graph.num_edges, 1, 1))
    general = matrix_weights.of_rotations(whole, K)
    assert isinstance(Quadratic(general), Quadratic)
    answer = solve_robustly(general)
    assert answer.solution.rejected.tolist() == [graph.num_edges - 1]
    rejection = answer.rejection
    assert rejection.verdict is Verdict.CERTIFIED
    # Of either choice, by descent: the price and the rest, or all of it.
    kept = general.with_edges(np.arange(graph.num_edges - 1))
    choices = solve(kept).cost + rejection.prices.sum(), solve(general).cost
    assert rejection.certificate.lower_bound <= min(choices) * (1.0 + 1e-12)
    assert rejection.certificate.cost_upper == pytest.approx(min(choices), rel=1e-9)


def drawn_as_g2o_states(path, seed, n=30, loops=30):
    """A g2o file in space whose noise is drawn from its matrices as g2o reads them, and residuals.

    The last loop closure is wrong. The (m, 6) residuals of the others are those at the truth.
    """
    rng = rng_of(seed)
    pairs = [(k, k + 1) for k in range(n - 1)]
    pairs += [sorted(rng.choice(n, 2, replace=False)) for _ in range(loops)]
    pairs[-1] = (3, n - 4)
    i, j = np.array(pairs).T
    R, t = Rotation.random(n, rng=rng), 3.0 * rng.normal(size=(n, 3))
    scale = np.array([20.0, 20.0, 20.0, 100.0, 100.0, 100.0])
    Omega = definite(rng, len(pairs), 6, condition=30.0) * scale[:, None] * scale
    covariance = np.linalg.inv(Omega)
    e = np.einsum("mab,mb->ma", np.linalg.cholesky(covariance), rng.normal(size=(len(pairs), 6)))
    # y = R~^T (v - t~) and b, the vector part of R~^T Q.
    b = e[:, 3:]
    E = Rotation.from_quat(np.column_stack([b, np.sqrt(1.0 - (b**2).sum(axis=1))]))
    measured = R[i].inv() * R[j] * E.inv()
    v = R[i].inv().apply(t[j] - t[i])
    moved = v - measured.apply(e[:, :3])
    quats = measured.as_quat()
    quats[-1], moved[-1] = Rotation.random(rng=rng).as_quat(), moved[-1] + 10.0
    upper = Omega[:, *np.triu_indices(6)]
    rows = np.column_stack([moved, quats, upper])
    lines = [f"EDGE_SE3:QUAT {a} {c} " for a, c in zip(i, j, strict=True)]
    text = (line + " ".join(map(repr, row.tolist())) for line, row in zip(lines, rows, strict=True))
    path.write_text("\n".join(text) + "\n")
    return np.einsum("ma,mab,mb->m", e, Omega, e)[:-1]


@pytest.mark.parametrize("seed", range(5))
def test_one_wrong_loop_is_rejected_alone_where_noise_is_as_g2o_states_it(tmp_path, seed):
    """Whatever F was told that the rotational information is of."""
    path = tmp_path / "spatial.g2o"
    stated = drawn_as_g2o_states(path, seed)
    assert stated.max() < chi2.isf(0.01 / (len(stated) + 1), 6)  # so that none but that is wrong
    found = []
    for about in ("tangent", "quaternion"):
        instance = read(path, rotation_information=about, quiet=True)
        answer = solve_robustly(instance, cost="g2o")
        assert answer.solution.rejected.tolist() == [len(stated)]
        assert answer.rejection.scale == 1.0
        assert answer.rejection.prices == pytest.approx(
            chi2.isf(0.01 / instance.num_measurements, 6)
        )
        found.append(answer.rejection.certificate.cost_upper)
    assert found[0] == pytest.approx(found[1], rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_one_wrong_measurement_between_maps_is_left_out_alone(tmp_path, seed):
    path, n = tmp_path / "whole.g2o", 30
    drawn_as_g2o_states(path, seed, n)
    lines = path.read_text().splitlines(keepends=True)
    sides = [[int(end) >= n // 2 for end in line.split()[1:3]] for line in lines]
    instances = []
    for name, sought in (("a", [False, False]), ("b", [True, True]), ("between", [False, True])):
        part = tmp_path / f"{name}.g2o"
        part.write_text("".join(k for k, of in zip(lines, sides, strict=True) if of == sought))
        instances.append(read(part, quiet=True))
    first, second, between = instances
    merged = merge([first, second], between, robust=True)
    assert merged.disagreeing.tolist() == merged.between[-1:].tolist()
    assert merged.left_out
    assert merged.tails[-1] < 1e-20
    assert merged.tails[:-1].min() > 1e-4

"""Conventions of measured poses and of their weights: each mistake is named first."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.planted import N, changed, inverted, walk, weighed, with_positions

import certpgo
from certpgo import RotationGraph
from certpgo.diagnosis import weights
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.meanings import OF_QUATERNIONS, OTHERS, orders
from certpgo.io.datasets.synthetic import random_graph
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so

ALL = np.arange(N - 1 + 30)
CLOSURES = ALL[N - 1 :]


def first(instance):
    return certpgo.diagnose(instance).findings[0]


def transposed(instance):
    return changed(instance, rotations=np.swapaxes(instance.graph.rotations, 1, 2))


def with_w_first(instance):
    q = np.roll(quaternion.to_write(instance.graph.rotations), 1, axis=1)
    return changed(instance, rotations=quaternion.rotations(q))


def in_other_frame(instance):
    graph = instance.graph
    t = np.einsum("mba,mb->ma", graph.rotations, graph.translations)
    return changed(instance, translations=t)


def mirrored(instance):
    return changed(instance, translations=instance.graph.translations * [1.0, 1.0, -1.0])


def in_degrees(instance):
    R = instance.graph.rotations
    degrees = np.degrees(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    turns = np.where(np.abs(degrees) < 180.0, degrees, 0.0)
    return changed(instance, rotations=quaternion.planar_rotations(turns))


READINGS = {
    "inverted-edges": lambda one: inverted(one, ALL),
    "inverted-closures": lambda one: inverted(one, CLOSURES),
    "inverted-odometry": lambda one: inverted(one, ALL[: N - 1]),
    "transposed-rotations": transposed,
    "translations-in-other-frame": in_other_frame,
    "edges-w-first": with_w_first,
    "mirrored-edges": mirrored,
}
OF_SPACE = {"edges-w-first", "mirrored-edges"}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", READINGS)
def test_readings_are_told_by_the_best_fit(kind, d):
    if d == 2 and kind in OF_SPACE:
        pytest.skip("of space")
    found = first(READINGS[kind](walk(d)))
    assert found.kind == kind
    assert "as it stands" in found.said
    assert found.cost < 0.1 * found.cost_as_given
    assert found.next


@pytest.mark.parametrize("d", [2, 3])
def test_readings_are_told_by_the_nodes(d):
    right = walk(d, nodes=True)
    best = replace(right, initial=certpgo.solve(right).estimate)
    found = first(inverted(best, ALL))
    assert found.kind == "inverted-edges"
    assert "the file's own poses cost" in found.said
    longer = changed(best, translations=1e3 * right.graph.translations)
    assert first(longer).kind == "edges-millimetres"
    assert certpgo.diagnose(best).findings == ()


@pytest.mark.parametrize("d", [2, 3])
def test_lengths_are_told_by_positions(d):
    right = walk(d)
    t = certpgo.solve(right).estimate.translations
    feet = changed(right, translations=right.graph.translations / 0.3048)
    found = first(with_positions(feet, t + 0.1, 0.1))
    assert found.kind == "edges-feet"
    assert "0.3048" in found.next


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("unit", "kind"), [(1 / 0.3048, "distances-feet"), (1.0, None)])
def test_the_unit_of_distances_is_told_by_the_edges(unit, kind, d):
    instance, rng = walk(d), np.random.default_rng(d)
    t = certpgo.solve(instance).estimate.translations
    edges = np.array([rng.choice(N, 2, replace=False) for _ in range(25)])
    lengths = np.linalg.norm(t[edges[:, 1]] - t[edges[:, 0]], axis=1)
    distances = unit * np.abs(lengths + 0.05 * rng.standard_normal(25))
    ranges = certpgo.Ranges(N, edges, distances, np.full(25, 400.0))
    found = certpgo.diagnose(replace(instance, graph=instance.graph.with_blocks(ranges))).findings
    assert [finding.kind for finding in found[:1]] == ([kind] if kind else [])


def test_degrees_are_read_again_from_the_file(tmp_path):
    graph = walk(2).graph
    lines = []
    for (i, j), R, t in zip(graph.edges, graph.rotations, graph.translations, strict=True):
        angle = float(np.degrees(np.arctan2(R[1, 0], R[0, 0])))
        lines.append(f"EDGE_SE2 {i} {j} {t[0]} {t[1]} {angle} 400 0 0 400 0 10000\n")
    path = tmp_path / "degrees.g2o"
    path.write_text("".join(lines))
    assert first(path).kind == "edges-in-degrees"


def of_cholesky(M):
    return np.tile(np.linalg.cholesky(M[0]).T, (len(M), 1, 1))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", ["covariance", "square-root"])
def test_meanings_of_weights(kind, d):
    right = walk(d)
    M = right.graph.information_matrices
    found = first(weighed(right, np.linalg.inv(M) if kind == "covariance" else of_cholesky(M)))
    assert found.kind == kind
    assert "--weights-are" in found.next


def test_rotation_before_translation():
    right = walk(3)
    M = right.graph.information_matrices
    axes = [3, 4, 5, 0, 1, 2]
    found = first(weighed(right, M[:, axes][:, :, axes]))
    assert found.kind == "information-order"
    assert "GTSAM" in found.said


def test_information_about_tangents():
    right = walk(3)
    unit = np.repeat([1.0, 0.5], 3)
    found = first(weighed(right, right.graph.information_matrices * np.outer(unit, unit)))
    assert found.kind == "quaternion-information"


def test_orders_with_which_no_matrix_is_definite(tmp_path):
    line = "EDGE_SE2 {} {} 1 0 1.5707963 400 0 400 10000 0 0\n"
    path = tmp_path / "toro.g2o"
    path.write_text("".join(line.format(k, (k + 1) % 4) for k in range(4)))
    found = first(certpgo.read(path, quiet=True))
    assert found.kind == "information-order"
    assert "TORO" in found.said
    assert "4 information matrices of 4" in found.said


def test_orders_are_permutations():
    for d, p in ((2, 3), (3, 6)):
        rng = np.random.default_rng(d)
        A = rng.standard_normal((2, p, p))
        M = A + np.swapaxes(A, 1, 2)
        row, column = np.triu_indices(p)
        for order in orders(d):
            read = order.read(M)
            np.testing.assert_array_equal(read, np.swapaxes(read, 1, 2))
            for one, other in zip(read, M, strict=True):
                assert sorted(one[row, column]) == sorted(other[row, column])


@pytest.mark.parametrize("d", [2, 3])
def test_no_meaning_gains_more_than_it_may(d):
    """Of 9 matrices; what is left out at once leaves chi^2 that is far from usual."""
    instance, rng = walk(d), np.random.default_rng(d)
    M = instance.graph.information_matrices
    p, counts = M.shape[1], []
    mixed = np.eye(p) + 0.15 * rng.standard_normal((9, p, p))
    mixed = mixed[np.arange(len(M)) % 9]
    M = np.swapaxes(mixed, 1, 2) @ M @ mixed
    examined = Examined(weighed(instance, 0.5 * (M + np.swapaxes(M, 1, 2))))
    for meaning in (*OTHERS, *orders(d), *(OF_QUATERNIONS.values() if d == 3 else ())):
        change = weights._Change.of(examined, examined.first, meaning)
        most, found = change.gain_at_most, examined.first.under(change.weights)
        counts.append(most > -np.inf)
        if found is not None and counts[-1]:
            assert examined.first.surprise - found.surprise <= most
        elif found is not None and (np.linalg.eigvalsh(change.matrices) > 0.0).all():
            assert not weights._is_plausible(found.fit.chi2, found.fit.freedom)
    assert any(counts)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_clean_graphs(seed, d):
    found = certpgo.diagnose(walk(d, seed, nodes=seed % 2 == 1))
    assert found.findings == ()
    assert found.tried > 3


def test_readings_of_rotations_are_told_though_a_quarter_is_wrong():
    """As of photo collections: weights state nothing, and wrong ones hide what fits."""
    rng = np.random.default_rng(0)
    right = random_graph(24, 14.0, 0.02, rng).graph
    R, wrong = right.rotations.copy(), rng.random(right.num_edges) < 0.25
    R[wrong] = so.random(rng, int(wrong.sum()), 3)
    graph = RotationGraph(24, right.edges, R, np.ones(right.num_edges))
    swapped = RotationGraph(24, right.edges[:, ::-1], R, graph.kappa)
    [told] = certpgo.diagnose(swapped, time_limit=1.0).findings
    assert told.kind == "inverted-edges"
    assert told.cost < 0.1 * told.cost_as_given
    [told] = certpgo.diagnose(graph).findings
    assert told.kind == "wrong-measurement"
    assert told.edges == tuple(np.flatnonzero(wrong).tolist())

"""The thesis' synthetic data: counts, the law of the noise, outliers, wished connectivities."""

from dataclasses import replace

import numpy as np
import pytest

from certpgo.errors import GraphError, InputError, SpecError
from certpgo.graph import RotationGraph
from certpgo.graph.components import component, rotations_alone
from certpgo.io.datasets import edges, thesis
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from reports.harness.experiments.instances import load_row
from reports.harness.experiments.spec import Row


def rng(seed=5):
    return np.random.default_rng(seed)


def noise(instance):
    """E_ij of each measured rotation E_ij R_ij."""
    graph = rotations_alone(instance).graph
    i, j = graph.edges.T
    R = instance.truth.rotations
    return graph.rotations @ np.swapaxes(R[j], 1, 2) @ R[i]


def test_the_scene_of_the_thesis_has_its_counts(dataset_path):
    dataset_path("Notre_Dame.mat")
    instance = thesis.langevin_scene("Notre_Dame.mat", 5.0, rng(), outliers=0.1)
    assert (instance.graph.num_nodes, instance.graph.num_edges) == (553, 103932)
    assert np.all(instance.graph.kappa == 1.0)
    assert instance.outliers.mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 103932))
    v = so.log(noise(instance))[~instance.outliers]
    assert np.degrees(v.std()) == pytest.approx(5 / np.sqrt(2), rel=4 / np.sqrt(2 * v.size) + 3e-3)
    angles = so.angle(noise(instance))[instance.outliers]
    uniform = np.pi / 2 + 2 / np.pi  # mean angle of uniform rotations
    assert angles.mean() == pytest.approx(uniform, abs=4 * angles.std() / np.sqrt(len(angles)))


def test_readings_of_the_scene_turn_outliers_and_widen_the_noise(dataset_path):
    dataset_path("Notre_Dame.mat")
    reading = {"outliers": 0.1, "per_axis": True, "turned": True}
    instance = thesis.langevin_scene("Notre_Dame.mat", 5.0, rng(), **reading)
    v = so.log(noise(instance))[~instance.outliers]
    assert np.degrees(v.std()) == pytest.approx(5.0, rel=4 / np.sqrt(2 * v.size) + 6e-3)
    angles = so.angle(noise(instance))[instance.outliers]  # uniform in [0, pi]
    allowed = 4.0 * np.pi / np.sqrt(12.0 * len(angles))
    assert angles.mean() == pytest.approx(np.pi / 2.0, abs=allowed)
    assert angles.std() == pytest.approx(np.pi / np.sqrt(12.0), rel=0.02)


def test_a_spherical_path_from_the_origin_is_the_same_path_moved():
    there, here = (
        thesis.spherical_path(0.9, 1.0, 0.01, rng(), n=100, from_origin=moved)
        for moved in (False, True)
    )
    assert np.all(here.truth.translations[0] == 0.0)
    shift = there.truth.translations - here.truth.translations
    np.testing.assert_allclose(shift, there.truth.translations[:1].repeat(100, axis=0), atol=1e-12)
    assert np.linalg.norm(shift[0]) == pytest.approx(100.0)
    np.testing.assert_array_equal(here.graph.rotations, there.graph.rotations)
    np.testing.assert_allclose(here.graph.translations, there.graph.translations, atol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_outliers_are_marked_and_all_else_is_exact_without_noise(d):
    instance = thesis.langevin_graph(40, 4.0, 0.0, rng(), outliers=0.3, d=d)
    angles = so.angle(noise(instance))
    assert angles[~instance.outliers].max() < 1e-12
    assert angles[instance.outliers].min() > 1e-3


def test_outliers_replace_measurements_and_leave_the_others_alone():
    clean, dirty = (
        thesis.langevin_graph(40, 4.0, 2.0, rng(), outliers=p).graph for p in (0.0, 0.3)
    )
    same = np.all(clean.rotations == dirty.rotations, axis=(1, 2))
    np.testing.assert_array_equal(clean.edges, dirty.edges)
    assert 0.5 < same.mean() < 0.9


def test_outliers_stay_with_their_edges_in_a_component():
    instance = thesis.langevin_graph(30, 3.0, 1.0, rng(), outliers=0.5)
    part = component(instance, 0)
    np.testing.assert_array_equal(part.outliers, instance.outliers)
    graph = instance.graph
    cut = np.asarray((graph.edges < 12).all(axis=1) | (graph.edges >= 12).all(axis=1))
    apart = RotationGraph(30, graph.edges[cut], graph.rotations[cut], graph.kappa[cut])
    split = type(instance)("x", apart, np.arange(30), outliers=instance.outliers[cut])
    labels = range(len(apart.component_sizes))
    parts = [component(split, k) for k in labels if apart.component_sizes[k] > 1]
    assert len(parts) >= 2
    for part in parts:
        for edge, R, wrong in zip(
            part.ids[part.graph.edges], part.graph.rotations, part.outliers, strict=True
        ):
            (e,) = np.flatnonzero((graph.edges == edge).all(axis=1))
            np.testing.assert_array_equal(graph.rotations[e], R)
            assert instance.outliers[e] == wrong


def test_outliers_are_one_read_only_flag_an_edge_and_outlast_the_translations():
    path = thesis.spherical_path(0.5, 1.0, 0.1, rng(), n=20)
    assert path.outliers is None
    marked = replace(path, outliers=np.arange(path.graph.num_edges) % 2)
    assert marked.outliers.dtype == bool
    with pytest.raises(ValueError, match="read-only"):
        marked.outliers[0] = True
    np.testing.assert_array_equal(rotations_alone(marked).outliers, marked.outliers)
    with pytest.raises(GraphError, match="95 flags, one per edge"):
        replace(path, outliers=np.zeros(94))


def test_a_table_finds_the_families_by_name():
    arguments = {"missing": 0.9, "sigma_deg": 1.0, "sigma_t": 0.01, "n": 40}
    row = Row(generator="spherical_path", arguments=arguments)
    one, same = (load_row(row, None, np.random.SeedSequence(3)).graph for _ in range(2))
    np.testing.assert_array_equal(one.translations, same.translations)
    with pytest.raises(SpecError, match="generator"):
        load_row(Row(generator="edges_of_connectivity"), None, None)


@pytest.mark.parametrize(("n", "fiedler"), [(20, 0.1), (60, 2.0), (60, 20.0), (200, 7.0), (60, 60)])
def test_random_graphs_have_the_wished_fiedler_value(n, fiedler):
    graph = thesis.langevin_graph(n, fiedler, 1.0, rng()).graph
    assert graph.is_connected
    assert graph.without_parallel_edges("first").num_edges == graph.num_edges
    values = np.linalg.eigvalsh(Quadratic(graph).laplacian.toarray())
    assert values[1] == pytest.approx(fiedler, rel=0.03)


def test_a_graph_seed_fixes_the_graph_and_not_the_noise():
    one, other = (thesis.langevin_graph(30, 3.0, 1.0, rng(k), graph_seed=9).graph for k in (1, 2))
    np.testing.assert_array_equal(one.edges, other.edges)
    assert np.abs(one.rotations - other.rotations).max() > 0.1


@pytest.mark.parametrize("missing", [0.5, 0.8, 0.95])
def test_a_spherical_path_has_its_counts_and_stays_connected(missing):
    instance = thesis.spherical_path(missing, 1.0, 0.01, rng(), n=100)
    graph = instance.graph
    assert graph.num_edges == round((1 - missing) * 4950)
    assert graph.without_parallel_edges("first").num_edges == graph.num_edges
    pairs = {tuple(edge) for edge in graph.edges.tolist()}
    assert {(k, k + 1) for k in range(99)} <= pairs
    assert np.all(graph.tau == 1.0)
    assert np.all(graph.kappa == 1.0)


def test_a_spherical_path_goes_from_pole_to_pole_and_looks_ahead():
    instance = thesis.spherical_path(0.99, 0.0, 0.0, rng())
    R, t = instance.truth.rotations, instance.truth.translations
    assert Quadratic(instance.graph).cost(instance.truth) < 1e-20
    assert instance.graph.num_edges == 4995  # "one still needs to run a registration 4995 times"
    np.testing.assert_allclose(t[[0, -1]], [[0, 0, 100], [0, 0, -100]], rtol=0, atol=1e-9)
    np.testing.assert_allclose(t, 100 * R[:, :, 2], rtol=0, atol=1e-12)
    assert so.worst_defect(R)[1] < 1e-14
    step = np.linalg.norm(np.diff(t, axis=0), axis=1)
    assert step.max() < 1.1 * step.min()
    assert np.einsum("na,na->n", R[1:-2, :, 0], np.diff(t, axis=0)[1:-1]).min() > 0.9 * step.min()


def test_noise_of_a_spherical_path_has_the_stated_deviations():
    instance = thesis.spherical_path(0.8, 2.0, 0.05, rng(), n=300)
    v = np.degrees(so.log(noise(instance)))
    assert v.std() == pytest.approx(2.0 / np.sqrt(2), rel=4 / np.sqrt(2 * v.size) + 1e-3)
    t, R, (i, j) = instance.truth.translations, instance.truth.rotations, instance.graph.edges.T
    off = instance.graph.translations - np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    assert off.std() == pytest.approx(0.05, rel=4 / np.sqrt(2 * off.size))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: edges.edges_of_connectivity(20, 30.0, rng()), "the nearest of 25 has 20"),
        (lambda: edges.edges_of_connectivity(20, 0.01, rng()), "Fiedler value within 3 percent"),
        (lambda: thesis.langevin_graph(9, 2.0, -1.0, rng()), "sigma_R must not be negative"),
        (lambda: thesis.langevin_graph(9, 2.0, 1.0, rng(), outliers=1.5), "probability"),
        (lambda: thesis.langevin_graph(1, 2.0, 1.0, rng()), "at least 2"),
        (lambda: thesis.spherical_path(0.999, 1.0, 0.1, rng()), "cannot omit 0.999"),
        (lambda: thesis.spherical_path(-0.1, 1.0, 0.1, rng()), "cannot omit -0.1"),
        (lambda: thesis.spherical_path(0.5, 1.0, -0.1, rng()), "sigma_t must not be negative"),
    ],
)
def test_impossible_wishes_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certpgo
from certpgo.errors import InputError
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic

ROUNDING = 1e-12  # relative, or absolute where the exact value is zero


def rng():
    return np.random.default_rng(7)


@given(
    n=st.integers(3, 40),
    theta=st.floats(-3.0, 3.0),
    winding=st.integers(-2, 2),
    d=st.sampled_from([2, 3]),
)
def test_winding_cycle_has_its_closed_form(n, theta, winding, d):
    instance, estimate = synthetic.winding_cycle(n, theta, winding, d)
    problem = Quadratic(instance.graph)
    residual = (theta + 2 * np.pi * winding) / n
    cost = 8 * n * np.sin(residual / 2) ** 2
    assert problem.cost(estimate) == pytest.approx(cost, rel=1e-9, abs=ROUNDING)
    assert problem.stationarity(estimate) < ROUNDING
    folded = abs((residual + np.pi) % (2 * np.pi) - np.pi)
    np.testing.assert_allclose(
        problem.residual_angles(estimate), np.full(n, folded), rtol=1e-9, atol=1e-9
    )


def test_the_truth_of_a_winding_cycle_is_the_unwound_one():
    instance, estimate = synthetic.winding_cycle(12, 0.4, 0)
    np.testing.assert_array_equal(instance.truth.rotations, estimate.rotations)


FAMILIES = {
    "cycle": lambda sigma: synthetic.cycle(12, sigma, rng()),
    "cycle in the plane": lambda sigma: synthetic.cycle(12, sigma, rng(), d=2),
    "orbital": lambda sigma: synthetic.orbital(12, sigma, rng()),
    "orbital with closures": lambda sigma: synthetic.orbital(12, sigma, rng(), closures=4),
    "complete": lambda sigma: synthetic.complete(9, sigma, rng()),
    "random": lambda sigma: synthetic.random_graph(40, 5.0, sigma, rng()),
    "random in the plane": lambda sigma: synthetic.random_graph(40, 5.0, sigma, rng(), d=2),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_without_noise_the_truth_costs_nothing(family):
    instance = FAMILIES[family](0.0)
    assert Quadratic(instance.graph).cost(instance.truth) < ROUNDING


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_seed_gives_the_same_graph_and_noise_moves_it(family):
    first, again, exact = FAMILIES[family](0.1), FAMILIES[family](0.1), FAMILIES[family](0.0)
    np.testing.assert_array_equal(first.graph.edges, again.graph.edges)
    np.testing.assert_array_equal(first.graph.rotations, again.graph.rotations)
    assert Quadratic(exact.graph).cost(exact.truth) < Quadratic(first.graph).cost(first.truth)


def test_rotation_noise_has_the_stated_deviation_per_axis():
    instance = synthetic.complete(120, 0.1, rng())
    i, j = instance.graph.edges.T
    R = instance.truth.rotations
    noise = so.log(np.swapaxes(np.swapaxes(R[i], 1, 2) @ R[j], 1, 2) @ instance.graph.rotations)
    standard_error = 0.1 / np.sqrt(2 * noise.size)
    assert noise.std() == pytest.approx(0.1, abs=4 * standard_error)


def test_orbital_cameras_go_once_around_and_noise_is_an_angle_of_the_stated_deviation():
    instance = synthetic.orbital(4000, 0.1, rng())
    i, j = instance.graph.edges.T
    R = instance.truth.rotations
    steps = np.swapaxes(R[i], 1, 2) @ R[j]
    np.testing.assert_allclose(so.log(steps), [[0, 0, 2 * np.pi / 4000]] * 4000, atol=1e-9)
    noise = so.angle(np.swapaxes(steps, 1, 2) @ instance.graph.rotations)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.1, rel=4 / np.sqrt(2 * 4000))


def test_simulated_rotations_on_a_viewing_graph(dataset_path):
    dataset_path("Ellis_Island.mat")
    graph = synthetic.viewing_graph("Ellis_Island.mat", 0.0, rng()).graph
    assert (graph.num_nodes, graph.num_edges) == (247, 20297)
    assert np.abs(graph.rotations - np.eye(3)).max() > 1.0


def test_a_viewing_graph_that_is_not_here_is_refused(monkeypatch):
    monkeypatch.setattr("certpgo.io.datasets.lookup.find", lambda entry, data: None)
    with pytest.raises(InputError, match="file not here"):
        synthetic.viewing_graph("Ellis_Island.mat", 0.1, rng())


@given(n=st.integers(2, 30), data=st.data())
def test_random_graphs_are_connected_and_simple_with_the_asked_edges(n, data):
    m = data.draw(st.integers(n - 1, n * (n - 1) // 2))
    graph = synthetic.random_graph(n, 2 * m / n, 0.1, rng()).graph
    assert graph.is_connected
    assert graph.num_edges == m
    assert graph.without_parallel_edges("first").num_edges == m


def test_counts_of_the_helix_and_of_the_grid():
    helix = synthetic.helix(10, rng()).graph
    assert (helix.num_nodes, helix.num_edges) == (100, 99 + 90)
    grid = synthetic.grid3d(5, rng()).graph
    assert (grid.num_nodes, grid.num_edges) == (125, round(0.95 * 300))
    assert helix.is_connected
    assert grid.is_connected
    assert np.all(helix.kappa == 1250.0)
    assert np.all(grid.tau == pytest.approx(100.0))


def test_steps_of_the_helix_and_of_the_grid_have_unit_length():
    helix = synthetic.helix(40, rng(), translation_noise=1e-9).graph
    np.testing.assert_allclose(np.linalg.norm(helix.translations, axis=1), 1.0, rtol=2e-3, atol=0)
    grid = synthetic.grid3d(4, rng(), translation_noise=1e-9).graph
    np.testing.assert_allclose(np.linalg.norm(grid.translations, axis=1), 1.0, rtol=1e-7, atol=0)


def test_cameras_on_a_sphere_look_outward_and_ahead_is_to_their_right():
    instance = synthetic.sphere(10, rng())
    assert (instance.graph.num_nodes, instance.graph.num_edges) == (200, 199 + 180)
    R, t = instance.truth.rotations, instance.truth.translations
    assert so.rotation_defect(R) < ROUNDING
    np.testing.assert_allclose(R[:, :, 2], t * np.pi / 10, atol=ROUNDING)
    ahead = np.einsum("kab,ka->kb", R[:-1], np.diff(t, axis=0))
    assert np.all(ahead[:, 0] > 0.0)
    above = np.linalg.norm(t[20:] - t[:-20], axis=1)
    np.testing.assert_allclose(above, 1.0, rtol=5e-3)


def test_a_corridor_costs_a_hundred_billionth_of_its_weight():
    instance = synthetic.corridor(1316, rng())
    graph = instance.graph
    assert (graph.num_nodes, graph.num_edges) == (1316, 1315 + 1316 - 263)
    assert graph.is_connected
    # 2 kappa angle^2 and tau |step|^2: 2 x 1 and 2 terms an edge.
    weight = graph.kappa.sum() + graph.tau @ np.sum(graph.translations**2, axis=1)
    assert weight == pytest.approx(2.5e7, rel=0.1)
    cost = Quadratic(graph).cost(instance.truth)
    assert cost == pytest.approx(4 * 9e3 * 3e-6**2 * graph.num_edges, rel=0.1)
    steps = np.linalg.norm(np.diff(instance.truth.translations, axis=0), axis=1)
    assert steps.max() < 0.4 + 2 * np.hypot(0.3, 0.3)


POSES = {
    "grid": lambda: synthetic.grid3d(9, rng(), rotation_noise=0.02, translation_noise=0.3),
    "helix": lambda: synthetic.helix(35, rng(), rotation_noise=0.05, translation_noise=0.01),
    "uneven helix": lambda: synthetic.helix(35, rng(), uneven=True, translation_noise=0.5),
    "sphere": lambda: synthetic.sphere(25, rng(), rotation_noise=0.03, translation_noise=0.1),
    "corridor": lambda: synthetic.corridor(1500, rng(), information=400.0, noise=0.05),
}


@pytest.mark.parametrize("family", POSES)
def test_at_the_truth_terms_are_those_of_the_stated_noise(family):
    instance = POSES[family]()
    graph, R, t = instance.graph, instance.truth.rotations, instance.truth.translations
    (i, j), d, rotation = graph.edges.T, graph.d, graph.rotations_alone
    turned = ((R[j] - R[i] @ rotation.rotations) ** 2).sum(axis=(1, 2))
    moved = t[j] - t[i] - np.einsum("mab,mb->ma", R[i], graph.translations)
    # d numbers of translations. Of rotations 3 in space; in the plane 1, which kappa counts twice.
    error = 4.0 / np.sqrt(graph.num_edges)  # four standard errors of each mean, or more
    assert np.mean(rotation.kappa * turned) == pytest.approx(d, rel=error)
    assert np.mean(graph.tau * (moved**2).sum(axis=1)) == pytest.approx(d, rel=error)


def test_a_written_grid_fits_as_its_weights_state(tmp_path):
    certpgo.write(tmp_path / "grid.g2o", synthetic.grid3d(6, np.random.default_rng(0)))
    fit = certpgo.solve(tmp_path / "grid.g2o", cost="chordal").fit
    assert fit.freedom == 6 * (513 - 215)
    assert fit.chi2 / fit.freedom == pytest.approx(1.0, abs=4 * np.sqrt(2 / fit.freedom))
    assert fit.warning == ""


def test_a_grid_may_be_as_thin_as_a_tree():
    tree = synthetic.grid3d(3, rng(), fraction=26 / 54).graph
    assert tree.num_edges == 26
    assert tree.is_connected


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: synthetic.cycle(2, 0.1, rng()), "at least 3"),
        (lambda: synthetic.orbital(9, 0.1, rng(), closures=1, reach=1), "half of the 9 cameras"),
        (lambda: synthetic.orbital(9, 0.1, rng(), closures=-1), "closures must not be negative"),
        (lambda: synthetic.helix(2, rng()), "at least 3"),
        (lambda: synthetic.sphere(2, rng()), "at least 3"),
        (lambda: synthetic.complete(1, 0.1, rng()), "at least 2"),
        (lambda: synthetic.random_graph(10, 1.0, 0.1, rng()), "mean degree of 1.8 to 9"),
        (lambda: synthetic.random_graph(10, 10.0, 0.1, rng()), "mean degree of 1.8 to 9"),
        (lambda: synthetic.corridor(30, rng()), "at least 8"),
        (lambda: synthetic.corridor(30, rng(), laps=0), "at least 1"),
        (lambda: synthetic.grid3d(3, rng(), fraction=0.2), "connected grid"),
        (lambda: synthetic.grid3d(3, rng(), fraction=1.2), "connected grid"),
    ],
)
def test_impossible_sizes_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()

"""g2o's and Ceres' optimizers: their chi^2 is ours, and they end at optima that we certify."""

import sys

import numpy as np
import pytest

from certpgo import registry, solve
from certpgo.errors import InputError, MissingDependency, NumericalError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status

PACKAGES = {
    "g2o_gauss_newton": "g2opy",
    "g2o_levenberg_marquardt": "g2opy",
    "ceres_levenberg_marquardt": "pyceres",
}
NAMES = tuple(PACKAGES)
#: Where the problem is stated to the program.
STATED = {"g2opy": "_g2o", "pyceres": "ceres_levenberg_marquardt"}
SETS = ("MIT", "intel", "smallGrid3D", "tinyGrid3D")


def solver(name, **settings):
    pytest.importorskip(PACKAGES[name], reason=f"{PACKAGES[name]} is not installed")
    return registry.get_solver(name)(**settings)


def with_gtsam(name, **settings):
    pytest.importorskip("gtsam", reason="the gtsam wheel is not installed, where they begin")
    return solver(name, **settings)


def chi_squared(name, problem, estimate):
    solver(name)
    module = sys.modules[f"certpgo_baselines.{STATED[PACKAGES[name]]}"]
    return module.built(problem, estimate).chi_squared


def measured(d, seed=0):
    """A ring with chords, with full information matrices, parallel and reversed edges."""
    rng, n = np.random.default_rng(seed), 9
    R, t = so.random(rng, n, d), rng.uniform(-3, 3, (n, d))
    k = np.arange(n)
    edges = np.r_[np.c_[k, (k + 1) % n], np.c_[k, (k + 4) % n], [[4, 2], [0, 1], [1, 0]]]
    (i, j), m = edges.T, len(edges)
    turns = so.exp(0.05 * rng.standard_normal((m, so.tangent_dim(d))))
    rotations = np.swapaxes(R[i], 1, 2) @ R[j] @ turns
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + 0.05 * rng.standard_normal((m, d))
    root = rng.standard_normal((m, p := d * (d + 1) // 2, p)) + 3.0 * np.eye(p)
    graph = PoseGraph(RotationGraph(n, edges, rotations, rng.uniform(1, 9, m)), steps, np.ones(m))
    stated = Information.of(np.swapaxes(root, 1, 2) @ root)
    return graph.with_information(stated), Estimate(R, t)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", ["g2o_gauss_newton", "ceres_levenberg_marquardt"])
def test_chi_squared_is_ours_at_any_estimate(name, d, seed):
    graph, truth = measured(d, seed)
    problem, rng = objective_of(graph, "g2o"), np.random.default_rng(seed + 100)
    anywhere = Estimate(so.random(rng, problem.n, d), rng.uniform(-5, 5, (problem.n, d)))
    for estimate in (truth, anywhere):
        theirs = chi_squared(name, problem, estimate)
        assert theirs == pytest.approx(problem.cost(estimate), rel=1e-12)


@pytest.mark.parametrize("name", ["g2o_gauss_newton", "ceres_levenberg_marquardt"])
def test_with_isotropic_weights_chi_squared_is_f_in_space_and_near_it_in_the_plane(name):
    for d, rel in ((3, 1e-12), (2, 0.2)):
        graph, truth = measured(d)
        problem = Quadratic(graph)
        assert chi_squared(name, problem, truth) == pytest.approx(problem.cost(truth), rel=rel)
    turned = Quadratic(measured(2)[0].with_weights(1.0, 1e-9))  # 2 a^2 against 8 sin^2(a / 2)
    best = solve(turned).estimate
    assert chi_squared(name, turned, best) == pytest.approx(turned.cost(best), rel=1e-2)


@pytest.mark.parametrize("dataset_name", SETS)
@pytest.mark.parametrize("name", ["g2o_gauss_newton", "ceres_levenberg_marquardt"])
def test_chi_squared_of_public_sets_is_ours(name, dataset_name, dataset):
    instance = dataset(dataset_name)
    problem, estimate = objective_of(instance, "g2o"), solve(instance, cost="chordal").estimate
    theirs = chi_squared(name, problem, estimate)
    assert theirs == pytest.approx(problem.cost(estimate), rel=1e-9)


@pytest.mark.parametrize("name", ["intel", "smallGrid3D"])
def test_g2o_reads_the_file_as_we_do(name, dataset, dataset_path):
    g2o = pytest.importorskip("g2opy", reason="g2opy is not installed")
    instance = dataset(name)
    problem, optimizer = objective_of(instance, "g2o"), g2o.SparseOptimizer()
    assert optimizer.load(str(dataset_path(name)))
    optimizer.initialize_optimization()
    optimizer.compute_active_errors()
    assert optimizer.active_chi2() == pytest.approx(problem.cost(instance.initial), rel=1e-8)


@pytest.mark.parametrize("dataset_name", SETS)
@pytest.mark.parametrize("name", NAMES)
def test_they_end_at_the_optimum_that_we_certify(name, dataset_name, dataset):
    instance = dataset(dataset_name)
    best = solve(instance, cost="g2o")
    assert best.verdict.value == "CERTIFIED"
    start = solve(instance, cost="chordal").estimate
    search = solver(name, tolerance=1e-13, max_iterations=1000)
    found = search.solve(objective_of(instance, "g2o"), initial=start)
    assert found.cost == pytest.approx(best.cost, rel=1e-6)
    assert found.cost >= best.certificate.lower_bound
    assert found.note.endswith("with full information")


@pytest.mark.gtsam
@pytest.mark.parametrize("name", NAMES)
def test_they_begin_where_gtsam_does(name):
    graph = synthetic.grid3d(3, np.random.default_rng(0)).graph
    problem = Quadratic(graph)
    found = with_gtsam(name).solve(problem)
    start = registry.get_solver("gtsam_chordal")().solve(problem)
    again = solver(name).solve(problem, initial=start.estimate)
    assert found.cost == pytest.approx(again.cost, rel=1e-12)
    assert found.status is Status.CONVERGED
    assert found.iterations == again.iterations > 0
    assert found.cost == pytest.approx(solve(graph).cost, rel=1e-5)
    assert "minimises F itself" in found.note


@pytest.mark.parametrize("name", NAMES)
def test_ceres_says_what_python_takes(name):
    graph, start = measured(2)
    found = solver(name).solve(objective_of(graph, "g2o"), initial=start)
    assert ("evaluate" in found.seconds) == name.startswith("ceres")
    assert min(found.seconds.values()) >= 0.0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
def test_the_first_pose_stays(name, d):
    graph, start = measured(d)
    found = solver(name).solve(objective_of(graph, "g2o"), initial=start).estimate
    np.testing.assert_allclose(found.rotations[0], start.rotations[0], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found.translations[0], start.translations[0])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
def test_prepared_runs_the_same_step_each_time(name, d):
    graph, start = measured(d)
    problem = objective_of(graph, "g2o")
    step = solver(name).prepared(problem, start)
    first, second = (step().estimate for _ in range(2))
    np.testing.assert_array_equal(first.rotations, second.rotations)
    np.testing.assert_array_equal(first.translations, second.translations)
    assert problem.cost(first) == solver(name).solve(problem, initial=start).cost


@pytest.mark.parametrize("name", NAMES)
def test_an_iteration_limit_is_told(name):
    graph, start = measured(3)
    rng = np.random.default_rng(1)
    far = Estimate(so.random(rng, graph.num_nodes, 3), start.translations)
    found = solver(name, max_iterations=1).solve(objective_of(graph, "g2o"), initial=far)
    assert found.status in {Status.ITERATION_LIMIT, Status.STALLED}
    assert found.iterations == 1


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "settings", [{"tolerance": 0.0}, {"tolerance": 2.0}, {"max_iterations": 0}]
)
def test_settings_are_validated_at_construction(name, settings):
    with pytest.raises(SpecError, match=r"between 0 and 1|at least 1"):
        registry.get_solver(name)(**settings)


@pytest.mark.parametrize("name", NAMES)
def test_other_costs_and_measurements_are_refused(name):
    graph, start = measured(2)
    with pytest.raises(InputError, match="does not minimise"):
        registry.get_solver(name)().solve(objective_of(graph, "gtsam"), initial=start)
    turns = Quadratic(synthetic.cycle(5, 0.1, np.random.default_rng(0)).graph)
    with pytest.raises(InputError, match="takes pose graphs, not rotations alone"):
        registry.get_solver(name)().solve(turns)


def test_what_is_not_finite_is_an_error():
    pytest.importorskip("g2opy", reason="g2opy is not installed")
    graph, start = measured(2)
    model = sys.modules["certpgo_baselines._g2o"].built(objective_of(graph, "g2o"), start)
    model.vertices[1].set_estimate_data(np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(NumericalError, match="not finite"):
        model.estimate(model.vertices)


@pytest.mark.parametrize("name", NAMES)
def test_without_the_package_the_message_says_how_to_get_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, PACKAGES[name], None)
    graph, start = measured(2)
    with pytest.raises(MissingDependency, match=f"pip install '?{PACKAGES[name]}"):
        registry.get_solver(name)().solve(objective_of(graph, "g2o"), initial=start)


@pytest.mark.parametrize("name", NAMES)
def test_without_gtsam_a_given_estimate_is_needed(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    graph, start = measured(2)
    problem = objective_of(graph, "g2o")
    assert solver(name).solve(problem, initial=start).iterations > 0
    with pytest.raises(MissingDependency, match="GTSAM is not installed: pip install 'gtsam"):
        solver(name).solve(problem)

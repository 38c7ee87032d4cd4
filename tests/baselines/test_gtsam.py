import dataclasses
import sys

import numpy as np
import pytest

from certpgo import registry
from certpgo.errors import InputError, MissingDependency, NumericalError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status

NAMES = ("gtsam_chordal", "gtsam_fastsync", "gtsam_gauss_newton", "gtsam_levenberg_marquardt")
ITERATIVE = ("gtsam_gauss_newton", "gtsam_levenberg_marquardt")

pytestmark = pytest.mark.gtsam


def rng():
    return np.random.default_rng(11)


@pytest.fixture
def gtsam():
    return pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")


def solver(name, **settings):
    return registry.get_solver(name)(**settings)


def poses(d, n=12, noise=0.02, parallel=False):
    """A ring with chords whose kappa and tau differ from edge to edge, and its truth."""
    generator = rng()
    truth = Estimate(so.random(generator, n, d), generator.uniform(-3, 3, (n, d)))
    k = np.arange(n)
    edges = np.concatenate(
        [np.stack([k, (k + 1) % n], 1), np.stack([k, (k + 3) % n], 1), [[4, 2]]]
        + ([np.stack([k, (k + 1) % n], 1), [[1, 0], [1, 0]]] if parallel else [])
    )
    m = len(edges)
    i, j = edges.T
    R, t = truth.rotations, truth.translations
    turn = so.exp(noise * generator.standard_normal((m, so.tangent_dim(d))))
    rotations = np.swapaxes(R[i], 1, 2) @ R[j] @ turn
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + noise * generator.standard_normal((m, d))
    kappa, tau = generator.uniform(50, 200, (2, m))
    graph = PoseGraph(RotationGraph(n, edges, rotations, kappa), steps, tau)
    return Quadratic(graph), truth


# Golden costs: GTSAM's own run on the files' full information, evaluated by SE-Sync's objective.
FULL_INFORMATION = [
    ("gtsam_chordal", "sphere2500", 4463.0627),
    ("gtsam_gauss_newton", "sphere2500", 1729.9776),
    ("gtsam_chordal", "torus3D", 24767.788),
    ("gtsam_gauss_newton", "torus3D", 24227.0486),
    ("gtsam_chordal", "parking-garage", 942.87057),
    ("gtsam_gauss_newton", "parking-garage", 1.2660808),
    ("gtsam_levenberg_marquardt", "parking-garage", 1.2660808),
    ("gtsam_chordal", "smallGrid3D", 3165.3030),
    ("gtsam_gauss_newton", "smallGrid3D", 1025.4959),
    ("gtsam_levenberg_marquardt", "smallGrid3D", 1025.4959),
]

#: With isotropic information the optimum is F's own, up to log against chordal residuals.
ISOTROPIC = [
    ("gtsam_fastsync", "sphere2500", 444908.06),
    ("gtsam_fastsync", "parking-garage", 10037.136),
    ("gtsam_gauss_newton", "sphere2500", 1687.0058),
    ("gtsam_gauss_newton", "parking-garage", 1.2625244),
    ("gtsam_gauss_newton", "intel", 52.34823),
    ("gtsam_gauss_newton", "city10000", 638.62462),
]


@pytest.mark.parametrize(("method", "name", "cost"), FULL_INFORMATION)
def test_golden_costs_with_the_files_information(gtsam, dataset, dataset_path, method, name, cost):
    problem = Quadratic(dataset(name).graph)
    solution = solver(method, source=str(dataset_path(name))).solve(problem)
    assert solution.cost == pytest.approx(cost, rel=1e-6)
    assert "full information" in solution.note


@pytest.mark.parametrize(("method", "name", "cost"), ISOTROPIC)
def test_golden_costs_with_isotropic_information(gtsam, dataset, method, name, cost):
    solution = solver(method).solve(Quadratic(dataset(name).graph))
    assert solution.cost == pytest.approx(cost, rel=1e-6)
    assert "full information" not in solution.note


@pytest.mark.parametrize("method", ["gtsam_chordal", *ITERATIVE])
def test_gtsam_gives_up_on_the_indefinite_information_of_cubicle(
    gtsam, dataset, dataset_path, method
):
    problem = Quadratic(dataset("cubicle").graph)
    with pytest.raises(NumericalError, match=r"GTSAM: Indeterminate linear system") as caught:
        solver(method, source=str(dataset_path("cubicle"))).solve(problem)
    assert "\n" not in str(caught.value)


def test_a_file_that_gtsam_half_reads_is_not_used(gtsam, dataset, dataset_path):
    instance = dataset("stonewall")
    source = str(dataset_path("stonewall"))
    solution = solver("gtsam_chordal", source=source).solve(Quadratic(instance.graph))
    assert "it finds 2 nodes and 1 edges" in solution.note


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("parallel", [False, True])
def test_exact_measurements_give_the_truth(gtsam, name, d, parallel):
    problem, truth = poses(d, noise=0.0, parallel=parallel)
    solution = solver(name).solve(problem)
    assert solution.cost < 1e-9
    moved = solution.estimate.anchored(0, like=truth)
    np.testing.assert_allclose(moved.rotations, truth.rotations, rtol=0, atol=1e-6)
    np.testing.assert_allclose(moved.translations, truth.translations, rtol=0, atol=1e-5)


@pytest.mark.parametrize("d", [2, 3])
def test_gtsams_error_is_half_our_cost_to_first_order(gtsam, d):
    problem, truth = poses(d, noise=1e-4, parallel=True)
    registry.get_solver("gtsam_chordal")  # loads the folder as a package
    model = sys.modules["certpgo_baselines._gtsam"].isotropic_model(problem)
    error = model.graph.error(model.values(truth))
    assert 2 * error == pytest.approx(problem.cost(truth), rel=1e-4)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
def test_solutions_are_complete(gtsam, name, d):
    problem, _ = poses(d)
    solution = solver(name).solve(problem)
    assert solution.cost == problem.cost(solution.estimate)
    assert {"build", "solve"} <= set(solution.seconds)
    assert solution.note.startswith("GTSAM with")
    iterative = name in ITERATIVE
    assert (solution.status is Status.CONVERGED) == iterative
    assert (solution.iterations > 0) == iterative


@pytest.mark.parametrize("d", [2, 3])
def test_fastsync_takes_rotations_alone(gtsam, d):
    instance = synthetic.random_graph(30, 6.0, 0.0, rng(), d=d)
    problem = Quadratic(instance.graph)
    solution = solver("gtsam_fastsync").solve(problem)
    assert solution.cost < 1e-9
    assert solution.estimate.translations is None


@pytest.mark.parametrize("name", ["gtsam_chordal", *ITERATIVE])
def test_the_others_refuse_rotations_alone(gtsam, name):
    problem = Quadratic(synthetic.cycle(5, 0.1, rng()).graph)
    with pytest.raises(InputError, match="takes pose graphs"):
        solver(name).solve(problem)


@pytest.mark.parametrize("name", ITERATIVE)
def test_a_given_start_is_used(gtsam, name):
    problem, _ = poses(3)
    optimum = solver(name).solve(problem)
    again = solver(name).solve(problem, initial=optimum.estimate)
    assert again.iterations <= 1
    # Every node moves from where it was by rounding only: the prior holds the given place.
    np.testing.assert_allclose(
        again.estimate.translations, optimum.estimate.translations, rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("name", NAMES)
def test_prepared_runs_the_same_step_each_time(gtsam, name):
    problem, _ = poses(3)
    step = solver(name).prepared(problem)
    first, second = step(), step()
    assert first.values.equals(second.values, 1e-12)
    expected = solver(name).solve(problem).estimate.translations
    np.testing.assert_allclose(
        [first.values.atPose3(k).translation() for k in range(problem.n)],
        expected,
        rtol=0,
        atol=1e-9,
    )


def test_an_iteration_limit_is_told(gtsam):
    problem, _ = poses(3)
    solution = solver("gtsam_gauss_newton", max_iterations=1).solve(problem)
    assert (solution.status, solution.iterations) == (Status.ITERATION_LIMIT, 1)


def test_a_step_that_raises_the_error_is_a_stall(gtsam, dataset, dataset_path):
    problem = Quadratic(dataset("torus3D").graph)
    search = solver("gtsam_gauss_newton", source=str(dataset_path("torus3D")), start="file")
    solution = search.solve(problem)
    assert (solution.status, solution.iterations) == (Status.STALLED, 1)
    assert solution.cost == pytest.approx(7262059.6, rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("edges", [[[1, 0]], [[0, 1], [0, 1]], [[2, 1], [0, 2]]])
def test_the_smallest_graphs(gtsam, name, d, edges):
    edges = np.array(edges)
    m, n = len(edges), edges.max() + 1
    rotation = RotationGraph(n, edges, np.broadcast_to(np.eye(d), (m, d, d)), np.ones(m))
    solution = solver(name).solve(Quadratic(PoseGraph(rotation, np.ones((m, d)), np.ones(m))))
    assert solution.cost < 1e-9
    assert solution.status in {Status.CLOSED_FORM, Status.CONVERGED}


SE3_FILE = """\
VERTEX_SE3:QUAT 40 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 7 1 0 0 0 0 0 1
VERTEX_SE3:QUAT -3 1 1 0 0 0 0 1
EDGE_SE3:QUAT 40 7 1 0 0 0 0 0 1 {information}
EDGE_SE3:QUAT 7 -3 0 1 0 0 0 0 1 {information}
EDGE_SE3:QUAT -3 40 -1 -1 0.1 0 0 0 1 {information}
EDGE_SE3:QUAT -3 40 -1 -1 0.1 0 0 0 1 {information}
"""

SE2_FILE = """\
VERTEX_SE2 40 0 0 0
VERTEX_SE2 7 1 0 0.1
VERTEX_SE2 -3 1 1 0.2
EDGE_SE2 40 7 1 0 0 {information}
EDGE_SE2 7 -3 0 1 0 {information}
EDGE_SE2 -3 40 -1 -1 0.1 {information}
"""


def triangle(information, tmp_path):
    # Nodes in the order of their ids: -3, 7, 40.
    edges = np.array([[2, 1], [1, 0], [0, 2]])
    R = so.exp(np.array([[0.0], [0.0], [0.1]]))
    t = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, -1.0]])
    graph = PoseGraph(RotationGraph(3, edges, R, np.full(3, 4.0)), t, np.full(3, 2.0))
    path = tmp_path / "triangle.g2o"
    path.write_text(SE2_FILE.format(information=information))
    return Quadratic(graph), str(path)


def test_arbitrary_ids_in_the_file_are_the_nodes_in_their_order(gtsam, tmp_path):
    problem, path = triangle("2 0 0 2 0 8", tmp_path)
    for name in ("gtsam_chordal", *ITERATIVE):
        of_file = solver(name, source=path).solve(problem)
        isotropic = solver(name).solve(problem)
        assert "full information" in of_file.note
        assert of_file.cost == pytest.approx(isotropic.cost, rel=1e-4)


def test_arbitrary_ids_in_space_with_parallel_edges(gtsam, tmp_path):
    information = "2 0 0 0 0 0 2 0 0 0 0 2 0 0 0 8 0 0 8 0 8"
    path = tmp_path / "triangle.g2o"
    path.write_text(SE3_FILE.format(information=information))
    edges = np.array([[2, 1], [1, 0], [0, 2], [0, 2]])
    t = np.array([[1.0, 0, 0], [0, 1, 0], [-1, -1, 0.1], [-1, -1, 0.1]])
    rotation = RotationGraph(3, edges, np.broadcast_to(np.eye(3), (4, 3, 3)), np.full(4, 4.0))
    problem = Quadratic(PoseGraph(rotation, t, np.full(4, 2.0)))
    for name in ("gtsam_chordal", *ITERATIVE):
        of_file = solver(name, source=str(path)).solve(problem)
        isotropic = solver(name).solve(problem)
        assert "full information" in of_file.note
        assert of_file.cost == pytest.approx(isotropic.cost, rel=1e-4)


def test_lago_refuses_correlations_and_the_optimizers_start_without_them(gtsam, tmp_path):
    problem, path = triangle("2 0.5 0.1 2 0 8", tmp_path)
    with pytest.raises(NumericalError, match="diagonal noise model"):
        solver("gtsam_chordal", source=path).solve(problem)
    for name in ITERATIVE:
        assert "full information" in solver(name, source=path).solve(problem).note


def test_lago_does_without_odometry(gtsam):
    problem, _ = poses(2, noise=0.0)
    graph = problem.graph
    shuffled = rng().permutation(problem.n)
    relabelled = PoseGraph(
        RotationGraph(problem.n, shuffled[graph.edges], graph.rotations, graph.kappa),
        graph.translations,
        graph.tau,
    )
    assert solver("gtsam_chordal").solve(Quadratic(relabelled)).cost < 1e-9


def test_a_start_from_the_file(gtsam, tmp_path):
    problem, path = triangle("2 0 0 2 0 8", tmp_path)
    from_file = solver("gtsam_gauss_newton", source=path, start="file").solve(problem)
    assert from_file.cost == pytest.approx(
        solver("gtsam_gauss_newton", source=path).solve(problem).cost, rel=1e-4
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": "chordale"}, "did you mean chordal"),
        ({"start": "file"}, "needs source"),
        ({"max_iterations": 0}, "at least 1"),
    ],
)
def test_settings_are_validated_at_construction(settings, message):
    for name in ITERATIVE:
        with pytest.raises(SpecError, match=message):
            solver(name, **settings)


def test_a_source_that_is_not_there_is_an_error(gtsam):
    problem, _ = poses(3)
    with pytest.raises(InputError, match="no such file"):
        solver("gtsam_chordal", source="/nowhere/graph.g2o").solve(problem)


def test_an_initial_estimate_of_another_graph_is_refused(gtsam):
    problem, _ = poses(3)
    _, other = poses(3, n=13)
    with pytest.raises(InputError, match="13 nodes"):
        solver("gtsam_gauss_newton").solve(problem, initial=other)


@pytest.mark.parametrize("name", NAMES)
def test_without_gtsam_the_message_says_how_to_get_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    problem, _ = poses(3)
    with pytest.raises(MissingDependency, match="pip install 'gtsam"):
        solver(name).solve(problem)


@pytest.mark.parametrize("name", NAMES)
def test_settings_are_frozen(name):
    assert dataclasses.is_dataclass(registry.get_solver(name))
    with pytest.raises(dataclasses.FrozenInstanceError):
        solver(name).source = "elsewhere"

"""GTSAM's two staircases for rotation averaging, Shonan and the Riemannian one, beside ours."""

import dataclasses
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import certpgo
from certpgo import registry
from certpgo.certify import Verdict
from certpgo.errors import InputError, MissingDependency, NumericalError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status

NAMES = ("gtsam_shonan", "gtsam_staircase")
STARTS = ("fastsync", "chordal", "random")

#: Above the optimum, relatively: Shonan stops where GTSAM's Levenberg-Marquardt does.
ACCURACY = {"gtsam_shonan": 1e-5, "gtsam_staircase": 1e-7}

pytestmark = pytest.mark.gtsam


def rng():
    return np.random.default_rng(5)


@pytest.fixture
def gtsam():
    return pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")


def solver(name, **settings):
    return registry.get_solver(name)(**settings)


def module(name):
    for method in NAMES:
        registry.get_solver(method)  # loads the folder as a package
    return sys.modules[f"certpgo_baselines.{name}"]


def problem_in(d):
    """A random graph whose kappa differ from edge to edge."""
    graph = synthetic.random_graph(20, 5.0, 0.1, rng(), d=d).graph
    return Quadratic(graph.with_weights(rng().uniform(0.5, 200.0, graph.num_edges)))


def pose_problem():
    rotation = problem_in(3).graph
    m = rotation.num_edges
    return Quadratic(PoseGraph(rotation, rng().standard_normal((m, 3)), np.ones(m)))


def wound_up(n, d=3):
    """A cycle without noise, and its stationary estimate that turns once too often."""
    instance, estimate = synthetic.winding_cycle(n, 0.0, 1, d)
    return Quadratic(instance.graph), estimate


@pytest.mark.parametrize("name", NAMES)
def test_the_optimum_of_small_grid(gtsam, name, dataset):
    problem = Quadratic(dataset("smallGrid3D").graph.rotations_alone)
    solution = solver(name).solve(problem)
    assert solution.cost == pytest.approx(484.976072679, rel=ACCURACY[name])
    assert solution.cost == problem.cost(solution.estimate)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("start", STARTS)
def test_they_agree_with_the_certified_optimum(gtsam, name, d, start):
    problem = problem_in(d)
    best = certpgo.solve(problem.graph)
    assert best.verdict is Verdict.CERTIFIED
    solution = solver(name, start=start, rank=d + 1).solve(problem)
    assert solution.cost == pytest.approx(best.cost, rel=ACCURACY[name])
    assert solution.status is Status.CONVERGED
    assert solution.iterations > 0
    assert {"build", "start", "solve"} == set(solution.seconds)
    assert f": certified at p = {d + 1}, smallest eigenvalue -" in solution.note


@pytest.mark.parametrize("d", [2, 3])
def test_shonans_cost_is_ours_and_its_certificate_matrix_twice_ours(gtsam, d):
    problem = problem_in(d)
    estimate = Estimate(so.random(rng(), problem.n, d))
    shonan = module("gtsam_shonan")
    averaging = shonan._averaging(problem)
    values = module("_gtsam").isotropic_model(problem).values(estimate)
    assert averaging.cost(values) == pytest.approx(problem.cost(estimate), rel=1e-12)
    theirs = averaging.computeA_(shonan._lifted(estimate.rotations, d))
    ours = problem.certificate_matrix(problem.multipliers(estimate)).toarray()
    # Their multipliers leave out the degrees, which cancel.
    np.testing.assert_allclose(theirs, 2.0 * ours, rtol=0, atol=1e-10 * np.abs(theirs).max())


@pytest.mark.parametrize("d", [2, 3])
def test_the_staircases_cost_is_ours(gtsam, d):
    problem = problem_in(d)
    model = module("_gtsam").isotropic_model(problem)
    estimate = Estimate(so.random(rng(), problem.n, d))
    graph = module("gtsam_staircase")._frobenius(model)
    assert graph.error(model.values(estimate)) == pytest.approx(problem.cost(estimate), rel=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_shonan_climbs_as_its_own_run_does(gtsam, d):
    problem, start = wound_up(50, d)
    model = module("_gtsam").isotropic_model(problem)
    averaging = module("gtsam_shonan")._averaging(problem)
    values, eigenvalue = averaging.run(model.values(start), d, 10)
    solution = solver("gtsam_shonan").solve(problem, initial=start)
    assert f"at p = {d + 1}," in solution.note
    assert solution.note.endswith(f"{eigenvalue:.1e}")
    np.testing.assert_array_equal(solution.estimate.rotations, model.estimate(values).rotations)


def test_fastsync_is_where_gtsams_own_run_starts(gtsam):
    problem = problem_in(3)
    values, _ = module("gtsam_shonan")._averaging(problem).run(3, 10)
    expected = module("_gtsam").isotropic_model(problem).estimate(values)
    solution = solver("gtsam_shonan").solve(problem)
    found = solution.estimate.rotations
    np.testing.assert_allclose(found, expected.rotations, rtol=0, atol=1e-12)


def test_gtsam_calls_a_wound_up_cycle_optimal_and_we_refute_it(gtsam):
    problem, wound = wound_up(100)
    S = problem.certificate_matrix(problem.multipliers(wound)).toarray()
    expected = 2.0 * np.cos(2.0 * np.pi / 100) - 2.0  # -3.95e-3
    assert np.linalg.eigvalsh(S)[0] == pytest.approx(expected, rel=1e-9)

    optimal, eigenvalue = module("gtsam_shonan").calls_optimal(problem, wound)
    assert optimal
    assert abs(eigenvalue) < 1e-5
    certificate = certpgo.certify(problem, wound)
    assert certificate.verdict is Verdict.REFUTED
    assert certificate.better_cost < 1e-12

    # Shonan from there stays there.
    solution = solver("gtsam_shonan").solve(problem, initial=wound)
    assert solution.note.startswith("Shonan: certified at p = 3")
    assert solution.cost == pytest.approx(8 * 100 * np.sin(np.pi / 100) ** 2)


def test_gtsam_and_we_agree_where_the_eigenvalue_is_large(gtsam):
    problem, wound = wound_up(30)
    judge = module("gtsam_shonan").calls_optimal
    optimal, eigenvalue = judge(problem, wound)
    assert not optimal
    assert eigenvalue == pytest.approx(2.0 * (2.0 * np.cos(2.0 * np.pi / 30) - 2.0), rel=1e-3)
    assert certpgo.certify(problem, wound).verdict is Verdict.REFUTED
    assert judge(problem, certpgo.solve(problem.graph).estimate)[0]


def test_calls_optimal_looks_at_the_rotations_of_poses(gtsam):
    problem = pose_problem()
    rotations = certpgo.solve(problem.rotation.graph).estimate
    judge = module("gtsam_shonan").calls_optimal
    optimal, eigenvalue = judge(problem, problem.complete(rotations.rotations))
    assert optimal
    assert (optimal, eigenvalue) == judge(problem.rotation, rotations)


def test_shonan_without_a_level_left_is_an_error(gtsam):
    problem, wound = wound_up(30)
    message = "GTSAM: Shonan::run did not converge for given max_p: at p = 3, smallest eigenvalue"
    with pytest.raises(NumericalError, match=message):
        solver("gtsam_shonan", max_rank=3).solve(problem, initial=wound)


@pytest.mark.parametrize("d", [2, 3])
def test_the_staircase_climbs_out_of_a_wound_up_cycle(gtsam, d):
    problem, wound = wound_up(30, d)
    solution = solver("gtsam_staircase").solve(problem, initial=wound)
    assert solution.cost < 1e-12
    assert solution.iterations > 1
    assert "staircase: certified" in solution.note


@pytest.mark.parametrize("d", [2, 3])
def test_a_staircase_without_a_level_left_says_so(gtsam, d):
    problem, wound = wound_up(30, d)
    solution = solver("gtsam_staircase", max_rank=d).solve(problem, initial=wound)
    assert (solution.status, solution.iterations) == (Status.ITERATION_LIMIT, 1)
    found = solution.estimate.anchored(0).rotations
    np.testing.assert_allclose(found, wound.rotations, rtol=0, atol=1e-5)
    assert f"staircase: not certified at p = {d}, smallest eigenvalue" in solution.note


def test_the_staircases_parameters(gtsam):
    parameters = module("gtsam_staircase")._parameters(range(3, 6))
    inner = parameters.getAlmParams()
    assert (parameters.pMin, parameters.pMax) == (3, 5)
    assert (inner.maxIterations, inner.absoluteViolationTolerance) == (100, 1e-8)


def staircase_result(blocks, **attributes):
    """What RiemannianStaircaseOptimizer returns, with transposed blocks (n, p, d) as values."""
    values = SimpleNamespace(atMatrix=lambda key: blocks[key].T)
    defaults = {
        "certified": True,
        "finalRank": blocks.shape[1],
        "minEigenvalue": -1e-3,
        "values": values,
        "hasRoundedSolution": lambda: True,
        "roundedValues": lambda: values,
        "getRanksVisited": lambda: [blocks.shape[1]],
    }
    return SimpleNamespace(**(defaults | attributes))


@pytest.mark.parametrize("d", [2, 3])
def test_values_of_the_staircase_that_are_no_rotations_are_made_so(gtsam, d):
    problem = problem_in(d)
    R = so.random(rng(), problem.n, d)
    stretch = 1.0 + 0.02 * rng().uniform(0, 1, (problem.n, 1, 1))
    mirror = np.r_[-1.0, np.ones(d - 1)][:, None]
    model = module("_gtsam").isotropic_model(problem)
    outcome = module("gtsam_staircase")._outcome(staircase_result(stretch * mirror * R), model)
    found = model.estimate(outcome.values)
    assert problem.cost(found) == pytest.approx(problem.cost(Estimate(R)), rel=1e-9)
    defect = (stretch**2 - 1.0).max()
    worst = f"{-(stretch.max() ** d):.6f} to {-(stretch.min() ** d):.6f}"
    assert outcome.verdict.endswith(f"orthogonal up to {defect:.1e}, determinants {worst}")


def test_values_of_the_staircase_that_are_not_finite_are_an_error(gtsam):
    problem = problem_in(3)
    model = module("_gtsam").isotropic_model(problem)
    result = staircase_result(np.full((problem.n, 3, 3), np.nan))
    with pytest.raises(NumericalError, match="not finite"):
        module("gtsam_staircase")._outcome(result, model)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("edges", [[[1, 0]], [[0, 1], [0, 1]], [[2, 1], [0, 2]]])
@pytest.mark.parametrize("start", STARTS)
def test_the_smallest_graphs(gtsam, name, d, edges, start):
    edges = np.array(edges)
    measured = so.exp(np.full((len(edges), so.tangent_dim(d)), 0.4))
    graph = RotationGraph(edges.max() + 1, edges, measured, np.ones(len(edges)))
    solution = solver(name, start=start).solve(Quadratic(graph))
    assert solution.cost < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_random_starts_are_those_of_their_seed(gtsam, name):
    problem = problem_in(3)

    def costs(seed):
        return solver(name, start="random", seed=seed).solve(problem).cost

    assert costs(1) == costs(1)
    assert costs(1) != costs(2)


@pytest.mark.parametrize("name", NAMES)
def test_prepared_runs_the_same_step_each_time(gtsam, name):
    problem = problem_in(3)
    step = solver(name).prepared(problem)
    first, second = step(), step()
    assert first.values.equals(second.values, 1e-12)
    expected = solver(name).solve(problem).estimate.rotations
    found = [first.values.atRot3(k).matrix() for k in range(problem.n)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_poses_are_refused(gtsam, name):
    with pytest.raises(InputError, match="takes rotations alone, not pose graphs"):
        solver(name).solve(pose_problem())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": "chordale"}, "did you mean chordal"),
        ({"rank": 0}, "no ranks"),
        ({"rank": 5, "max_rank": 4}, "no ranks of at least 2 from 5 to 4"),
        ({"max_rank": 1}, "no ranks"),
        ({"seed": -1}, "seed must not be negative"),
    ],
)
@pytest.mark.parametrize("name", NAMES)
def test_settings_are_validated_at_construction(name, settings, message):
    with pytest.raises(SpecError, match=message):
        solver(name, **settings)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("settings", [{"rank": 2}, {"max_rank": 2}])
def test_ranks_below_the_dimension_are_refused(gtsam, name, settings):
    assert solver(name, **settings).solve(problem_in(2)).cost > 0.0
    with pytest.raises(SpecError, match="no ranks of at least 3"):
        solver(name, **settings).solve(problem_in(3))


@pytest.mark.parametrize("name", NAMES)
def test_without_gtsam_the_message_says_how_to_get_it(name, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    problem, wound = wound_up(5)
    with pytest.raises(MissingDependency, match="pip install 'gtsam"):
        solver(name).solve(problem)
    with pytest.raises(MissingDependency):
        module("gtsam_shonan").calls_optimal(problem, wound)


@pytest.mark.parametrize("name", NAMES)
def test_settings_are_frozen(name):
    with pytest.raises(dataclasses.FrozenInstanceError):
        solver(name).rank = 5

"""Pymanopt's trust region on our objective."""

import sys

import numpy as np
import pytest

import certpgo
from certpgo import registry
from certpgo.certify import Verdict
from certpgo.errors import InputError, MissingDependency, SpecError
from certpgo.graph import PoseGraph
from certpgo.graph.relaxed_point import Lift
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status

NAME = "pymanopt_trust_region"


def rng():
    return np.random.default_rng(5)


@pytest.fixture
def pymanopt():
    return pytest.importorskip("pymanopt")


def solver(**settings):
    return registry.get_solver(NAME)(**settings)


def problem_in(d, kind):
    """A random graph whose weights differ from edge to edge."""
    instance = synthetic.random_graph(15, 5.0, 0.1, rng(), d=d)
    kappa, tau = rng().uniform(0.5, 20.0, (2, instance.graph.num_edges))
    rotation = instance.graph.with_weights(kappa)
    if kind == "rotations":
        return Quadratic(rotation)
    i, j = rotation.edges.T
    R, t = instance.truth.rotations, 3.0 * rng().standard_normal((rotation.num_nodes, d))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    return Quadratic(PoseGraph(rotation, steps + 0.1 * rng().standard_normal(steps.shape), tau))


@pytest.mark.parametrize(("kind", "cost"), [("rotations", 484.976072679), ("poses", 1025.398056)])
def test_the_optima_of_small_grid(pymanopt, dataset, kind, cost):
    graph = dataset("smallGrid3D").graph
    problem = Quadratic(graph if kind == "poses" else graph.rotations_alone)
    solution = solver(min_gradient_norm=1e-3).solve(problem)
    assert solution.cost == pytest.approx(cost, rel=1e-9)
    assert solution.cost == problem.cost(solution.estimate)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", ["rotations", "poses"])
@pytest.mark.parametrize("more", [0, 1, 3])
def test_it_agrees_with_the_certified_optimum(pymanopt, d, kind, more, capsys):
    problem = problem_in(d, kind)
    best = certpgo.solve(problem.graph)
    assert best.verdict is Verdict.CERTIFIED
    solution = solver(rank=d + more).solve(problem)
    assert solution.cost == pytest.approx(best.cost, rel=1e-9)
    assert solution.status is Status.CONVERGED
    assert solution.note.startswith(f"rank {d + more}, pymanopt: Terminated - min grad norm")
    assert {"start", "solve", "round"} == set(solution.seconds)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", ["rotations", "poses"])
def test_its_derivatives_are_those_of_its_cost(pymanopt, d, kind):
    solver()
    problem = problem_in(d, kind)
    stated = sys.modules[f"certpgo_baselines.{NAME}"]._stated(problem, d + 1)
    Y, V, W = rng().standard_normal((3, problem.n, d + 1, d))
    # F is a quadratic form: central differences are exact but for rounding.
    slope = 0.5 * (stated.cost(Y + V) - stated.cost(Y - V))
    assert np.vdot(stated.euclidean_gradient(Y), V) == pytest.approx(slope, rel=1e-9)
    turned = 0.5 * (stated.euclidean_gradient(Y + V) - stated.euclidean_gradient(Y - V))
    hessian = stated.euclidean_hessian(Y, V)
    np.testing.assert_allclose(hessian, turned, rtol=0, atol=1e-9 * np.abs(turned).max())
    assert np.vdot(hessian, W) == pytest.approx(np.vdot(stated.euclidean_hessian(Y, W), V))


def test_the_translations_are_the_best_ones(pymanopt):
    solver()
    problem = problem_in(3, "poses")
    stated = sys.modules[f"certpgo_baselines.{NAME}"]._stated(problem, 4)
    Y = rng().standard_normal((problem.n, 4, 3))
    for _ in range(5):
        t = rng().standard_normal((problem.n, 4))
        assert stated.cost(Y) < problem.cost(Lift(Y, t))


def test_a_stationary_start_is_where_it_ends(pymanopt):
    instance, wound = synthetic.winding_cycle(40, 0.0, 1)
    problem = Quadratic(instance.graph)
    for start, verdict in ((wound, Verdict.REFUTED), (instance.truth, Verdict.CERTIFIED)):
        solution = solver().solve(problem, initial=start)
        assert (solution.status, solution.iterations) == (Status.CONVERGED, 1)
        assert solution.cost == pytest.approx(problem.cost(start))
        assert certpgo.certify(problem, solution.estimate).verdict is verdict


@pytest.mark.parametrize("d", [2, 3])
def test_exact_measurements_are_fitted(pymanopt, d):
    instance = synthetic.random_graph(12, 4.0, 0.0, rng(), d=d)
    solution = solver().solve(Quadratic(instance.graph))
    assert solution.cost < 1e-9


def test_an_iteration_limit_is_told(pymanopt):
    problem = problem_in(3, "poses")
    start = problem.complete(so.random(rng(), problem.n, 3))
    solution = solver(max_iterations=2).solve(problem, initial=start)
    assert (solution.status, solution.iterations) == (Status.ITERATION_LIMIT, 2)
    assert "max iterations reached" in solution.note
    assert solution.cost < problem.cost(start)


@pytest.mark.parametrize(
    "settings", [{"rank": 1}, {"max_iterations": 0}, {"min_gradient_norm": 0.0}]
)
def test_settings_are_validated_at_construction(settings):
    with pytest.raises(SpecError):
        solver(**settings)


def test_a_rank_below_the_dimension_is_refused(pymanopt):
    assert solver(rank=2).solve(problem_in(2, "rotations")).cost > 0.0
    with pytest.raises(SpecError, match="at least 3"):
        solver(rank=2).solve(problem_in(3, "rotations"))


def test_an_initial_estimate_of_another_graph_is_refused(pymanopt):
    problem = problem_in(3, "poses")
    with pytest.raises(InputError, match="15 nodes in 2D"):
        solver().solve(problem, initial=problem_in(2, "poses").complete(so.random(rng(), 15, 2)))


def test_without_pymanopt_the_message_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymanopt", None)
    with pytest.raises(MissingDependency, match="pip install 'pymanopt"):
        solver().solve(problem_in(3, "rotations"))

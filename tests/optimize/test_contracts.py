"""What every method promises, run for each one that is registered, without naming any."""

import dataclasses

import numpy as np
import pytest

from certpgo import certify, registry
from certpgo.errors import CertPGOError, GraphError, MissingDependency, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Solution, Status
from certpgo.registry import build, defaults

NAMES = registry.solver_names()
SAME_COST = 1e-12  # relative: one formula, evaluated twice


def planar_poses():
    rng = np.random.default_rng(3)
    space = synthetic.helix(3, rng).graph
    graph = space.rotations_alone
    angles = rng.normal(0.0, 0.02, graph.num_edges)
    turns = np.moveaxis(
        np.array([[np.cos(angles), -np.sin(angles)], [np.sin(angles), np.cos(angles)]]), 2, 0
    )
    flat = RotationGraph(graph.num_nodes, graph.edges, turns, graph.kappa)
    return PoseGraph(flat, space.translations[:, :2], space.tau)


MICRO = {
    "poses in 3D": lambda: synthetic.grid3d(2, np.random.default_rng(1)).graph,
    "poses in 2D": planar_poses,
    "rotations in 3D": lambda: synthetic.random_graph(8, 3.0, 0.1, np.random.default_rng(2)).graph,
    "many rotations in 3D": lambda: synthetic.complete(10, 0.1, np.random.default_rng(3)).graph,
    "a cycle in 3D": lambda: synthetic.cycle(7, 0.2, np.random.default_rng(4)).graph,
}


def arrays(graph):
    yield from (graph.edges, graph.rotations, graph.kappa, graph.translations, graph.tau)


def applicable(name, problem):
    solver = registry.get_solver(name)
    if not (solver.poses if problem.has_positions else solver.rotations):
        pytest.skip(f"{name} is not for such problems")
    return solver()


def solved(solver, problem):
    try:
        return solver.solve(problem)
    except (MissingDependency, GraphError) as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", NAMES)
def test_a_method_that_refuses_graphs_answers_some(name):
    solver = registry.get_solver(name)
    problems = [Quadratic(graph()) for graph in MICRO.values()]
    taken = [p for p in problems if (solver.poses if p.has_positions else solver.rotations)]
    refused = 0
    for problem in taken:
        try:
            solver().solve(problem)
        except GraphError:
            refused += 1
        except MissingDependency as error:
            pytest.skip(str(error))
    assert refused < len(taken)


@pytest.mark.parametrize("graph", MICRO.values(), ids=MICRO.keys())
@pytest.mark.parametrize("name", NAMES)
def test_solve_keeps_the_contract(name, graph):
    problem = Quadratic(graph())
    solver = applicable(name, problem)
    before = [array.copy() for array in arrays(problem.graph)]
    solution = solved(solver, problem)

    assert isinstance(solution, Solution)
    assert isinstance(solution.status, Status)
    n, d = problem.n, problem.d
    R = solution.estimate.rotations
    assert R.shape == (n, d, d)
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(d)).max() <= 1e-10
    assert np.linalg.det(R).min() > 0.0
    t = solution.estimate.translations
    assert (t is not None and t.shape == (n, d)) == problem.has_positions
    cost = problem.cost(solution.estimate)
    assert abs(solution.cost - cost) <= SAME_COST * max(cost, problem.scale)
    assert all(seconds >= 0.0 for seconds in solution.seconds.values())
    for array, original in zip(arrays(problem.graph), before, strict=True):
        np.testing.assert_array_equal(array, original)


@pytest.mark.parametrize("graph", MICRO.values(), ids=MICRO.keys())
@pytest.mark.parametrize("name", NAMES)
def test_no_answer_is_below_the_proven_bound(name, graph):
    problem = Quadratic(graph())
    solver = applicable(name, problem)
    solution = solved(solver, problem)
    certificate = certify(problem, solution.estimate)
    assert np.isfinite(certificate.lower_bound)
    assert certificate.lower_bound <= solution.cost * (1.0 + SAME_COST)


@pytest.mark.parametrize("name", NAMES)
def test_settings_are_a_frozen_documented_dataclass(name):
    solver = registry.get_solver(name)
    settings = solver()
    assert solver.__doc__
    assert solver.poses or solver.rotations
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.anything = 1
    for key in defaults(solver):
        assert key in solver.__doc__ or "settings" in solver.__doc__, key


@pytest.mark.parametrize(
    ("name", "key"), [(name, key) for name in NAMES for key in defaults(registry.get_solver(name))]
)
def test_settings_are_validated_at_construction(name, key):
    default = defaults(registry.get_solver(name))[key]
    if isinstance(default, bool) or default is None:
        pytest.skip(f"{key}: any value of its type is allowed")
    # Where negative values are usual, one beyond all bounds.
    wrong = "no such choice" if isinstance(default, str) else -1 if default >= 0 else -1e9
    with pytest.raises(CertPGOError):
        build(name, {key: wrong})


@pytest.mark.parametrize(
    ("name", "key"), [(name, key) for name in NAMES for key in defaults(registry.get_solver(name))]
)
def test_settings_of_another_type_are_refused(name, key):
    default = defaults(registry.get_solver(name))[key]
    if default is None or isinstance(default, str):
        pytest.skip(f"{key}: several types are allowed")
    wrong = 2.5 if type(default) is int else "text"
    with pytest.raises(SpecError, match=f"{key} must be"):
        build(name, {key: wrong})


@pytest.mark.parametrize("name", NAMES)
def test_an_initial_estimate_is_used_unless_the_method_takes_none(name):
    graphs = [graph() for graph in MICRO.values()]
    problem = next(p for p in map(Quadratic, graphs) if _takes(name, p))
    rng = np.random.default_rng(5)
    R = so.random(rng, problem.n, problem.d)
    t = rng.standard_normal((problem.n, problem.d)) if problem.has_positions else None
    solver = applicable(name, problem)
    own = solved(solver, problem)
    given = solver.solve(problem, initial=Estimate(R, t))
    same = own.cost == given.cost and own.iterations == given.iterations
    assert same != getattr(solver, "takes_initial", True)


def _takes(name, problem):
    solver = registry.get_solver(name)
    if not (solver.poses if problem.has_positions else solver.rotations):
        return False
    try:
        solver().solve(problem)
    except GraphError:
        return False
    except MissingDependency as error:
        pytest.skip(str(error))
    return True


@pytest.mark.parametrize("name", NAMES)
def test_an_unknown_setting_is_refused(name):
    with pytest.raises(SpecError, match=f"unknown setting of {name} 'no_such'"):
        build(name, {"no_such": 1})

"""The ladder of bounds: ordered, told apart, and true."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, rng_of, rotation_graph, seeds

from certpgo import registry
from certpgo.datasets import synthetic
from certpgo.errors import InputError
from certpgo.estimate import Estimate
from certpgo.harness import ladder as ladder_of
from certpgo.harness.ladder import PROGRAM, ladder
from certpgo.problem import RotationProblem, problem_of
from certpgo.solution import Relaxation, Solution, Status


def rungs(problem, *arguments, **options):
    return {rung.key: rung for rung in ladder(problem, *arguments, **options).rungs}


@settings(max_examples=25)
@given(seeds, dimensions)
def test_no_rung_is_above_the_optimum_and_angles_hold_at_optima_alone(seed, d):
    rng = rng_of(seed)
    graph, truth = rotation_graph(rng, 7, d, noise=0.3)
    found = ladder(RotationProblem(graph), Estimate(truth))
    optimum = found.certificate.refined_cost
    for rung in found.rungs:
        if rung.about == "cost" and rung.value is not None:
            assert rung.value <= found.cost * (1 + 1e-9)
            assert rung.holds is (found.cost - rung.value <= 1e-6 * found.cost)
        elif rung.value is not None and rung.holds:
            assert found.certificate.lower_bound >= optimum * (1 - 1e-4)


def test_a_cycle_has_its_own_rungs():
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    found = rungs(RotationProblem(instance.graph), point)
    assert list(found) == [
        "spectral",
        "alpha_max",
        "normalized",
        "rows",
        "cycle",
        "cycle_sum",
        "sdp",
        "proven",
    ]
    assert found["cycle"].value == pytest.approx(np.pi / 12)
    assert found["cycle"].against == pytest.approx(0.7 / 12)
    assert found["cycle_sum"].against == pytest.approx(0.7)
    assert found["cycle"].holds is True
    assert found["cycle_sum"].holds is True
    assert found["proven"].holds is True


def test_nothing_holds_for_a_wound_up_cycle():
    instance, point = synthetic.winding_cycle(12, 0.7, 1)
    found = rungs(RotationProblem(instance.graph), point)
    assert not any(rung.holds for rung in found.values())
    assert "above the best" in found["proven"].says


def test_poses_have_the_bound_with_translations_eliminated():
    graph = synthetic.grid3d(3, np.random.default_rng(0)).graph
    found = rungs(problem_of(graph))
    assert found["spectral"].value < found["spectral_poses"].value
    assert found["spectral_poses"].value < found["proven"].value
    assert found["proven"].holds is True


def test_an_estimate_of_another_graph_is_refused():
    graph = synthetic.cycle(5, 0.1, np.random.default_rng(0)).graph
    with pytest.raises(InputError, match="the estimate has 3 nodes"):
        ladder(RotationProblem(graph), Estimate(np.tile(np.eye(3), (3, 1, 1))))


class Program:
    """Stands for a semidefinite program's method: its value is what it is told."""

    value, error = 0.5, None

    def solve(self, problem):
        if self.error:
            raise InputError(self.error)
        point = Estimate(np.tile(np.eye(problem.d), (problem.n, 1, 1)))
        return Solution(point, 1.0, Status.CONVERGED, relaxation=Relaxation(self.value, "optimal"))


@pytest.fixture
def program(monkeypatch):
    monkeypatch.setattr(registry, "solver_names", lambda: (PROGRAM,))
    monkeypatch.setattr(registry, "get_solver", lambda name: Program)
    monkeypatch.setattr(ladder_of, "setting_fields", lambda solver: {})
    monkeypatch.setattr(ladder_of, "build", lambda name, settings: Program())
    return Program


def test_the_program_is_solved_when_asked_for(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    problem = RotationProblem(instance.graph)
    assert rungs(problem, point)["sdp"].value is None
    monkeypatch.setattr(program, "value", problem.cost(point))
    assert rungs(problem, point, sdp=True)["sdp"].holds is True


def test_a_program_that_is_not_solved_is_a_rung_with_its_reason(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    monkeypatch.setattr(program, "error", "too large\nby far")
    rung = rungs(RotationProblem(instance.graph), point, sdp=True)["sdp"]
    assert (rung.value, rung.holds, rung.says) == (None, None, "not solved: too large by far")


def test_a_program_without_a_method_is_a_rung_with_its_reason(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    monkeypatch.setattr(registry, "solver_names", tuple)
    rung = rungs(RotationProblem(instance.graph), point, sdp=True)["sdp"]
    assert rung.says == f"not solved: there is no method {PROGRAM} here"

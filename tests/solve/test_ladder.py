"""The ladder of bounds: ordered, told apart, and true."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, rng_of, rotation_graph, seeds

from certpgo import registry
from certpgo.certify import Verdict
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.solution import Relaxation, Solution, Status
from certpgo.solve import bounds_table as ladder_of
from certpgo.solve.bounds_table import PROGRAM, ladder
from certpgo.solve.solving import solve


def rungs(problem, *arguments, **options):
    return {rung.key: rung for rung in ladder(problem, *arguments, **options).rungs}


@settings(max_examples=15)
@given(seeds, dimensions)
def test_no_rung_is_above_the_optimum_and_angles_hold_at_optima_alone(seed, d):
    rng = rng_of(seed)
    graph, truth = rotation_graph(rng, 7, d, noise=0.3)
    best = solve(graph)
    found = ladder(Quadratic(graph), Estimate(truth), sdp=True)
    for rung in found.rungs:
        if rung.about == "cost":
            assert rung.value <= best.cost * (1 + 1e-12)
            assert rung.holds is (found.cost - rung.value <= 1e-6 * found.cost)
        elif rung.value is not None and rung.holds:
            assert found.certificate.refined_cost <= best.cost * (1 + 1e-9)
            assert best.verdict is Verdict.CERTIFIED


def test_the_rungs_of_the_optimum_are_not_above_it():
    above = 0
    for seed in range(6):
        rng = rng_of(seed)
        graph, _ = rotation_graph(rng, 7, 3, noise=0.1)
        problem = Quadratic(graph.with_weights(10.0 ** rng.uniform(-4, 4, graph.num_edges)))
        best = solve(problem.graph)
        found = rungs(problem, best.estimate, sdp=True)
        assert best.verdict is Verdict.CERTIFIED
        for key in ("spectral", "sdp", "proven"):
            assert 0.0 <= found[key].value <= best.cost * (1 + 1e-12)
        above += float(found["sdp"].says.split()[-2]) > best.cost * (1 + 1e-9)
    assert above  # what the program calls its value


def test_a_cycle_has_its_own_rungs():
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    found = rungs(Quadratic(instance.graph), point)
    assert list(found) == [
        "spectral",
        "alpha_max",
        "normalized",
        "rows",
        "cycle",
        "cycle_sum",
        "cycles",
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
    found = rungs(Quadratic(instance.graph), point)
    assert not any(rung.holds for rung in found.values())
    assert found["proven"].says.startswith("proven: this estimate costs at most 96.8 times")


def test_poses_have_the_bound_with_translations_eliminated():
    graph = synthetic.grid3d(3, np.random.default_rng(0)).graph
    found = rungs(Quadratic(graph))
    assert found["spectral"].value < found["spectral_poses"].value
    assert found["spectral_poses"].value < found["proven"].value
    assert found["proven"].holds is True


@pytest.mark.parametrize("seed", [0, 3])
def test_the_proven_rung_is_the_best_proof_in_hand_where_the_relaxation_is_loose(seed):
    graph = synthetic.random_graph(8, 4.0, 2.0, rng_of(seed)).graph
    best = solve(graph)
    assert best.verdict is Verdict.BOUNDED
    for point in (None, best.estimate):
        found = rungs(Quadratic(graph), point)
        assert found["proven"].value == pytest.approx(best.certificate.lower_bound, rel=1e-6)
        assert found["proven"].value > found["spectral"].value


def test_a_rung_below_an_earlier_one_says_that_it_adds_nothing():
    graph = synthetic.grid3d(2, np.random.default_rng(0)).graph
    found = rungs(Quadratic(graph), sdp=True)
    assert found["sdp"].value < found["spectral_poses"].value
    higher = "the bound by eigenvalues, translations eliminated is higher"
    assert found["sdp"].says.endswith(higher)
    assert "higher" not in found["proven"].says


def test_an_estimate_of_another_graph_is_refused():
    graph = synthetic.cycle(5, 0.1, np.random.default_rng(0)).graph
    with pytest.raises(InputError, match="the estimate has 3 nodes"):
        ladder(Quadratic(graph), Estimate(np.tile(np.eye(3), (3, 1, 1))))


class Program:
    """Stands for a semidefinite program's method: its bound and value are what it is told."""

    bound, value, error = 0.5, 0.5, None

    def solve(self, problem):
        if self.error:
            raise InputError(self.error)
        point = Estimate(np.tile(np.eye(problem.d), (problem.n, 1, 1)))
        relaxation = Relaxation(self.value, "optimal_inaccurate")
        return Solution(point, 1.0, Status.STALLED, lower_bound=self.bound, relaxation=relaxation)


@pytest.fixture
def program(monkeypatch):
    monkeypatch.setattr(registry, "solver_names", lambda: (PROGRAM,))
    monkeypatch.setattr(registry, "build", lambda name, settings: Program())
    return Program


def test_the_program_is_solved_when_asked_for():
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    problem = Quadratic(instance.graph)
    assert rungs(problem, point)["sdp"].value is None
    found = rungs(problem, point, sdp=True)["sdp"]
    assert found.holds is True
    assert found.value == pytest.approx(8 * 12 * np.sin(0.7 / 24) ** 2, rel=1e-7)
    assert found.value <= problem.cost(point)


def test_the_programs_own_value_is_no_bound(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    problem = Quadratic(instance.graph)
    cost = problem.cost(point)
    for value in (2.0 * cost, cost):
        monkeypatch.setattr(program, "value", value)
        monkeypatch.setattr(program, "bound", 0.5 * cost)
        rung = rungs(problem, point, sdp=True)["sdp"]
        assert rung.value == 0.5 * cost
        assert rung.holds is False
        assert f"the solver's value is {value:.10g} (optimal_inaccurate)" in rung.says
        monkeypatch.setattr(program, "bound", None)
        rung = rungs(problem, point, sdp=True)["sdp"]
        assert (rung.value, rung.holds) == (None, None)
        assert rung.says.startswith("no bound from it: stalled; the solver's value is")


def test_what_is_above_the_cost_is_no_bound(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    problem = Quadratic(instance.graph)
    monkeypatch.setattr(program, "bound", problem.cost(point) * (1 + 1e-9))
    rung = rungs(problem, point, sdp=True)["sdp"]
    assert (rung.value, rung.holds) == (None, None)
    assert rung.says.startswith("not a bound: the computed value")


@pytest.mark.parametrize(
    ("where", "name", "lost"),
    [
        (spectral, "smallest_eigenpairs", {"spectral"}),
        (spectral, "eliminated_eigenpairs", {"spectral_poses"}),
        (ladder_of, "fiedler_value", {"alpha_max"}),
        (ladder_of, "normalized_fiedler_value", {"normalized", "rows"}),
    ],
)
def test_a_rung_that_fails_leaves_the_others(where, name, lost, monkeypatch):
    problem = Quadratic(synthetic.grid3d(2, np.random.default_rng(0)).graph)
    point = solve(problem.graph).estimate

    def failing(*arguments, **options):
        raise NumericalError("no factor")

    monkeypatch.setattr(where, name, failing)
    found = rungs(problem, point)
    for key, rung in found.items():
        if key in lost:
            assert (rung.value, rung.holds, rung.says) == (None, None, "not computed: no factor")
        else:
            assert rung.value is not None or key == "sdp"


def test_a_program_that_is_not_solved_is_a_rung_with_its_reason(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    monkeypatch.setattr(program, "error", "too large\nby far")
    rung = rungs(Quadratic(instance.graph), point, sdp=True)["sdp"]
    assert (rung.value, rung.holds, rung.says) == (None, None, "not solved: too large by far")


def test_a_program_without_a_method_is_a_rung_with_its_reason(program, monkeypatch):
    instance, point = synthetic.winding_cycle(12, 0.7, 0)
    monkeypatch.setattr(registry, "solver_names", tuple)
    rung = rungs(Quadratic(instance.graph), point, sdp=True)["sdp"]
    assert rung.says == f"not solved: no method {PROGRAM} here"

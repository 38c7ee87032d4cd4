"""Newton's method: golden optima, quadratic convergence, monitors."""

import io
import itertools
import math
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo.errors import SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import compiled, factor, multifrontal
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.descent_loop import Gain
from certpgo.optimize.initialization import start_of
from certpgo.optimize.monitor import Iteration, Stopwatch, TableMonitor, silent
from certpgo.optimize.riemannian_newton import NewtonSettings, _Model, _NewtonSteps, newton
from certpgo.optimize.solution import Status

#: DESIGN section 5: SE-Sync's weights, poses and rotations alone.
OPTIMA = {
    "smallGrid3D": (1025.398056, None),
    "sphere2500": (1687.005814, 885.362701),
    "torus3D": (24227.045558, 12188.386283),
    "parking-garage": (1.262524428, 0.001732578),
    "sphere_bignoise_vertex3": (2961756.490288, 2951513.234140),
    "cubicle": (717.125990742, 108.439655767),
    "intel": (52.3482, None),
    "MIT": (61.1541, None),
    "kitti_05": (276.5144, None),
    "manhattan": (6431.391387, None),
}


@pytest.mark.parametrize("name", OPTIMA)
def test_the_published_optima(name, dataset):
    problem = Quadratic(dataset(name).graph)
    poses, rotations = OPTIMA[name]
    V = spectral.smallest_eigenpairs(problem.rotation).vectors
    start = problem.complete(spectral.round_to_rotations(V, problem.d))
    solution = newton(problem, start)
    assert solution.cost == pytest.approx(poses, rel=1e-6)
    assert problem.stationarity(solution.estimate) < 1e-10
    if rotations is not None:
        solution = newton(problem.rotation, Estimate(start.rotations))
        assert solution.cost == pytest.approx(rotations, rel=2e-7)
        assert solution.status is Status.CONVERGED


@settings(max_examples=30)
@given(seeds, dimensions)
def test_descends_to_a_stationary_point_and_never_up(seed, d):
    rng = rng_of(seed)
    graph, R, _ = pose_graph(rng, 8, d)
    problem = Quadratic(graph)
    off = R @ so.exp(0.3 * rng.standard_normal((8, so.tangent_dim(d))))
    solution = newton(problem, Estimate(off, 5.0 * rng.standard_normal((8, d))))
    assert solution.status in (Status.CONVERGED, Status.STALLED)
    assert problem.stationarity(solution.estimate) < 1e-10
    costs = [step.cost for step in solution.trace]
    assert all(b <= a * (1 + 1e-13) for a, b in itertools.pairwise(costs))
    assert solution.cost == problem.cost(solution.estimate)


def test_starts_far_away_are_damped_into_a_minimum():
    rng = np.random.default_rng(3)
    graph, _, _ = pose_graph(rng, 20, 3)
    problem = Quadratic(graph.rotations_alone)
    for _ in range(5):
        solution = newton(
            problem, Estimate(so.random(rng, 20, 3)), NewtonSettings(max_iterations=300)
        )
        assert problem.stationarity(solution.estimate) < 1e-10


def test_an_old_factor_does_not_lead_in_tiny_steps():
    """Weights over 12 decades: a step whose gradient is small by an old factor gains nothing."""
    rng = rng_of(613)
    graph, _, _ = pose_graph(rng, 6, 2, extra=5)
    m, turns = graph.num_edges, graph.rotations_alone
    kappa, tau = 10.0 ** rng.uniform(-6, 6, (2, m))
    weighted = RotationGraph(6, graph.edges, turns.rotations, kappa)
    problem = Quadratic(PoseGraph(weighted, graph.translations, tau))
    start = start_of(problem).estimate
    solution = newton(problem, start, NewtonSettings(tolerance=1e-11, enough=1e-12), near=True)
    assert solution.status is Status.CONVERGED
    assert solution.iterations < 20


@pytest.mark.parametrize("damping", [0.0, 1e-9])
def test_a_factor_of_a_damped_hessian_serves_no_other_step(damping):
    graph, R, _ = pose_graph(rng_of(0), 8, 3)
    problem = Quadratic(graph)
    steps = _NewtonSteps(problem, NewtonSettings(), exact=True)
    steps._damping = damping
    here = _Model(problem, problem.complete(R), steps.metric)
    proposal = steps.propose(here)
    there = here.moved(proposal.step)
    ratio = (here.cost - there.cost) / proposal.predicted
    steps.accepted(here, there, Gain(proposal, ratio, here.stationarity, there.stationarity))
    assert steps._damping == 0.0  # less than the smallest
    assert (steps._chord is None) == (damping > 0.0)


def test_noise_free_graph_reaches_zero():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3, noise=0.0)
    problem = Quadratic(graph)
    turned = R @ so.exp(np.random.default_rng(1).normal(0, 0.2, (10, 3)))
    solution = newton(problem, Estimate(turned, t))
    assert solution.cost < 1e-20 * problem.scale


def test_iteration_limit_and_interruption():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3)
    problem = Quadratic(graph)
    limited = newton(problem, Estimate(R, t), NewtonSettings(max_iterations=1))
    assert (limited.status, limited.iterations) == (Status.ITERATION_LIMIT, 1)
    stopped = newton(problem, Estimate(R, t), monitor=lambda step: step.number == 1)
    assert (stopped.status, stopped.iterations) == (Status.INTERRUPTED, 1)
    assert stopped.cost < problem.cost(Estimate(R, t))


def test_the_trace_says_how_well_the_model_predicted_each_step():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3)
    solution = newton(Quadratic(graph), Estimate(R, t))
    first, *steps = solution.trace
    assert first.gain is None
    seen = [step.gain for step in steps if step.gain is not None]
    assert len(seen) >= len(steps) - 2  # the last ones change F by less than its rounding
    assert min(seen) > NewtonSettings().min_gain
    assert all(step.accepted for step in steps)
    assert seen[-1] == pytest.approx(1.0, abs=0.1)  # near a minimum the model is F


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"min_gain": 0.8}, "min_gain < good_gain"),
        ({"tightest": 0.5}, "tightest <= loosest"),
        ({"largest_damping": 1e-9}, "largest_damping the largest"),
        ({"largest_damping": math.inf}, "must be positive and finite"),
        ({"near": -1.0}, "near must not be negative"),
        ({"max_iterations": 0}, "max_iterations at least 1"),
        ({"max_iterations": 2.5}, "max_iterations must be an integer, not 2.5"),
        ({"tolerance": math.inf}, "must not be negative or infinite"),
        *(
            ({field.name: math.nan}, "required|must")
            for field in fields(NewtonSettings)
            if field.type == "float"
        ),
    ],
)
def test_settings_that_make_no_sense_are_refused(changed, message):
    with pytest.raises(SpecError, match=message):
        NewtonSettings(**changed)


def test_the_monitor_prints_gains_and_rejected_steps():
    stream = io.StringIO()
    monitor = TableMonitor(stream)
    monitor(Iteration(0, 4.0, 1.0, 0.0, 0.0))
    monitor(Iteration(1, 4.0, 1.0, 0.5, 0.1, gain=-0.25, accepted=False))
    _, _, first, second = stream.getvalue().splitlines()
    assert "rejected" not in first
    assert second.split()[4:] == ["-0.25", "0.100", "rejected"]


def test_table_monitor_prints_one_line_an_iteration():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3)
    stream = io.StringIO()
    solution = newton(Quadratic(graph), Estimate(R, t), monitor=TableMonitor(stream))
    lines = stream.getvalue().splitlines()
    assert len(lines) == solution.iterations + 3
    assert lines[0] == "the chordal cost F"
    assert "gradient" in lines[1]
    assert silent(Iteration(0, 1.0, 1.0, 0.0, 0.0)) is False


def test_the_table_names_each_cost_and_leaves_out_what_a_method_does_not_know():
    stream = io.StringIO()
    monitor = TableMonitor(stream)
    for number, objective in enumerate(["F", "F", "another", "F"]):
        monitor(Iteration(number, 4.0, np.inf, 0.0, 0.0, objective=objective))
    words = [line.split() for line in stream.getvalue().splitlines()]
    firsts = " ".join(line[0] for line in words)
    assert firsts == "the it 0 1 another it 2 the it 3"
    assert words[2] == ["0", "4", "0.00e+00", "0.000"]


def test_the_total_of_a_stopwatch_includes_running_phases(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("certpgo.optimize.monitor.time.perf_counter", lambda: now[0])
    watch = Stopwatch()
    with watch.phase("outer"):
        now[0] = 1.0
        with watch.phase("inner"):
            now[0] = 3.0
            assert watch.total == 3.0
        now[0] = 4.0
        assert watch.total == 4.0
        with watch.phase("inner"):
            now[0] = 5.0
            assert watch.total == 5.0
    now[0] = 9.0
    assert watch.total == 5.0
    assert watch.seconds == {"outer": 2.0, "inner": 3.0}


def test_stopwatch_counts_nested_phases_once():
    watch = Stopwatch()
    with watch.phase("outer"), watch.phase("inner"):
        sum(range(100_000))
    assert set(watch.seconds) == {"outer", "inner"}
    assert watch.seconds["outer"] < watch.seconds["inner"]
    assert watch.total == pytest.approx(sum(watch.seconds.values()))


@pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")
@pytest.mark.parametrize("heavy", [False, True])
@pytest.mark.parametrize("stiff", [1.0, 1e9])
def test_steps_from_factors_in_single_precision(heavy, stiff, monkeypatch):
    """Where single precision does not suffice, double follows; heavy factors are kept in single."""
    graph, R, t = pose_graph(rng_of(0), 40, 3, extra=20)
    kappa = graph.kappa * np.where(np.arange(graph.num_edges) % 2, stiff, 1.0)
    problem = Quadratic(graph.with_weights(kappa=kappa))
    used, original = [], multifrontal.Fronts.factor_kept_single
    direct = multifrontal.Fronts.factor

    def kept_single(self, *args, mixed=False):
        found = original(self, *args, mixed=mixed)
        used.append(("mixed" if mixed else "single", found is not None))
        return found

    def double(self, data):
        used.append(("double", self.size == 6 * problem.n))
        return direct(self, data)

    monkeypatch.setattr(multifrontal.Fronts, "factor_kept_single", kept_single)
    monkeypatch.setattr(multifrontal.Fronts, "factor", double)
    monkeypatch.setattr(factor, "HEAVY", 0.0 if heavy else np.inf)
    found = newton(problem, Estimate(R, t), NewtonSettings(single_from=1))
    assert found.status is Status.CONVERGED
    assert ("single", True) in used
    if heavy:
        assert ("double", True) not in used
    if stiff == 1.0:
        assert "mixed" not in dict(used)
    monkeypatch.setenv("CERTPGO_ENGINE", "superlu")
    other = newton(Quadratic(problem.graph), Estimate(R, t))
    assert found.cost == pytest.approx(other.cost, rel=1e-9)


@pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")
def test_products_are_worth_more_the_more_a_factor_costs():
    worth = []
    for n, extra in ((30, 0), (30, 100), (200, 2000)):
        problem = Quadratic(pose_graph(rng_of(0), n, 3, extra=extra)[0])
        worth.append(problem.symbolic(problem.matrix).products)
    assert 1.0 < worth[0] < worth[1] < worth[2] < 100.0


@pytest.mark.parametrize("seed", [4, 7, 13, 17, 18])
def test_a_descent_does_not_depend_on_what_the_nodes_are_called(seed):
    """Far from a minimum, where a damped step depends on which pose fixes the gauge."""
    graph, _ = rotation_graph(rng_of(seed), 10, 3, noise=1.5, extra=6)
    called, start = rng_of(seed).permutation(10), so.random(rng_of(seed + 1), 10, 3)
    renamed = RotationGraph(10, called[graph.edges], graph.rotations, graph.kappa)
    ends = [
        newton(Quadratic(g), Estimate(R)).cost
        for g, R in ((graph, start), (renamed, start[np.argsort(called)]))
    ]
    assert ends[1] == pytest.approx(ends[0], rel=1e-9)

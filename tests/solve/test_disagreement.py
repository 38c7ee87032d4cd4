"""Measurements that disagree with the rest: who they are, and who is no such."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import rng_of

import certpgo
from certpgo.certify import Verdict
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.initialization import start_of
from certpgo.optimize.methods.graduated_non_convexity import GraduatedNonConvexity
from certpgo.optimize.riemannian_newton import newton
from certpgo.solve import metrics
from certpgo.solve.outliers import (
    Disagreement,
    agrees,
    disagreement,
    noise_scale,
    select,
    states_noise,
)


def fitted(problem):
    """The fit to all measurements: where the first descent ends."""
    start = start_of(problem)
    return newton(problem, start.estimate, near=start.near).estimate


def ladder(rng, n, d, sigma, closures=3):
    """A chain of n poses with closures of 2 to 1 + closures steps; weights state the noise."""
    R = so.random(rng, n, d)
    t = 3.0 * rng.standard_normal((n, d))
    edges = np.concatenate(
        [np.stack([np.arange(n - k), np.arange(k, n)], axis=1) for k in range(1, closures + 2)]
    )
    i, j = edges.T
    noise = so.exp(sigma * rng.standard_normal((len(edges), so.tangent_dim(d))))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    steps += sigma * rng.standard_normal((len(edges), d))
    kappa = np.full(len(edges), (1.0 if d == 2 else 0.5) / sigma**2)
    rotation = RotationGraph(n, edges, np.swapaxes(R[i], 1, 2) @ R[j] @ noise, kappa)
    return PoseGraph(rotation, steps, np.full(len(edges), sigma**-2)), Estimate(R, t)


def spoilt(graph, rng, count):
    """The graph with as many closures replaced by random rotations, and which."""
    wrong = np.zeros(graph.num_edges, dtype=bool)
    closures = np.arange(graph.num_nodes, graph.num_edges)
    wrong[rng.choice(closures, count, replace=False)] = True
    measured = np.array(graph.rotations)
    measured[wrong] = so.random(rng, count, graph.d)
    rotation = RotationGraph(graph.num_nodes, graph.edges, measured, graph.kappa)
    return PoseGraph(rotation, graph.translations, graph.tau), wrong


def bundle(count, kappa, angle):
    """Parallel exact measurements of the identity, and a last one that is off by an angle."""
    R = np.tile(np.eye(2), (count + 1, 1, 1))
    R[-1] = so.exp(np.array([[angle]]))[0]
    edges = np.tile([0, 1], (count + 1, 1))
    return Quadratic(RotationGraph(2, edges, R, np.full(count + 1, kappa)))


def test_a_single_wrong_measurement_is_told_where_taking_it_costs_more_than_its_price():
    # The residual is 8 kappa sin^2(angle / 2), and twice a chi-square variable of one dimension is
    # above 2 * 10.83 once in 1000: the quantile of 1 - 0.01 / 10.
    limit = math.sqrt(2.0 * 10.828 / 2.0)  # times kappa^(-1/2), for small angles
    # A fit to ten with it costs 9 / 10 of that.
    paid = math.sqrt(10.0 / 9.0) * limit
    still = Estimate(np.tile(np.eye(2), (2, 1, 1)))
    for angle, expected in ((0.999 * paid, []), (1.001 * paid, [9])):
        problem = bundle(9, 1e6, 1e-3 * angle)
        for factor, within in ((0.999, True), (1.001, False)):
            assert agrees(bundle(9, 1e6, 1e-3 * factor * limit), still) is within
        found = disagreement(problem, still, refit=True)
        assert ([] if found is None else found.edges.tolist()) == expected


def test_the_sentence_counts():
    one, more = np.array([3]), np.arange(148)
    assert str(Disagreement(more, 1501, math.radians(155.0))) == (
        "148 of 1501 measurements disagree with the rest, by up to 155 degrees"
    )
    assert str(Disagreement(one, 6, math.pi)).startswith("1 of 6 measurements disagrees with")


@pytest.mark.parametrize("d", [2, 3])
def test_weights_state_noise_unless_no_angle_contradicts_them(d):
    graph, _ = ladder(rng_of(1), 5, d, 0.1)
    assert states_noise(Quadratic(graph))
    assert states_noise(Quadratic(graph.rotations_alone))
    assert not states_noise(Quadratic(graph.with_weights(1.0, 1.0)))
    assert not states_noise(Quadratic(graph.rotations_alone.with_weights(1.0)))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("unit", [1e-4, 1.0, 30.0])
def test_the_noise_is_measured_whatever_the_weights_say(d, unit):
    graph, _ = ladder(rng_of(2), 150, d, 0.02)
    scaled = graph.with_weights(unit**2 * graph.kappa, unit**2 * graph.tau)
    for given_graph in (scaled, scaled.rotations_alone):
        problem = Quadratic(given_graph)
        scale = noise_scale(problem, problem.edge_costs(fitted(problem)))
        assert scale == pytest.approx(unit, rel=0.15)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([2, 3]), st.sampled_from([1e-4, 0.01, 0.1, 0.3]))
def test_clean_graphs_raise_no_alarm(seed, d, sigma):
    graph, _ = ladder(rng_of(seed), 20, d, sigma)
    unit = graph.with_weights(1.0, 1.0)
    for clean in (graph, unit, graph.rotations_alone, unit.rotations_alone):
        problem = Quadratic(clean)
        assert disagreement(problem, fitted(problem), refit=True) is None


@pytest.mark.parametrize("sigma", [0.5, 1.0, 3.0])
def test_noise_up_to_uniform_is_no_disagreement(sigma):
    graph = synthetic.complete(20, sigma, rng_of(4)).graph
    for weights in (1.0, 0.5 / sigma**2):
        problem = Quadratic(graph.with_weights(weights))
        assert disagreement(problem, fitted(problem)) is None


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("weights", ["stated", "unit", "too large"])
def test_wrong_closures_are_told(d, weights):
    graph, _ = ladder(rng_of(5), 40, d, 0.02)
    graph, wrong = spoilt(graph, rng_of(6), 8)
    if weights == "unit":
        graph = graph.with_weights(1.0, 1.0)
    elif weights == "too large":
        graph = graph.with_weights(400.0 * graph.kappa, 400.0 * graph.tau)
    problem = Quadratic(graph)
    chosen = select(problem)
    turned = problem.residual_angles(chosen.estimate) > 0.3  # random may be nearly right
    assert (chosen.rejected == wrong)[turned | ~wrong].all()
    assert chosen.scale == pytest.approx(
        {"stated": 1.0, "unit": 2 * 0.02 * 2**0.5}.get(weights, 40), rel=0.3
    )
    found = disagreement(problem, fitted(problem), refit=True)
    assert set(found.edges) <= set(np.flatnonzero(wrong))
    assert len(found.edges) >= 0.8 * wrong.sum()
    assert found.worst_angle > 1.0


def test_one_gross_error_does_not_leave_a_tree_alone():
    graph, _ = ladder(rng_of(7), 30, 2, 0.01)
    far = np.array(graph.translations)
    far[-1] += 1e6
    problem = Quadratic(PoseGraph(graph.rotations_alone, far, graph.tau))
    found = GraduatedNonConvexity().solve(problem)
    assert found.weights[-1] == 0.0
    assert found.kept > 0.9 * graph.num_edges
    assert np.flatnonzero(select(problem).rejected).tolist() == [graph.num_edges - 1]


def test_solving_tells_before_it_climbs_and_with_its_answer():
    graph, _ = ladder(rng_of(5), 60, 3, 0.02)
    clean = certpgo.solve(graph)
    assert clean.disagreement is None
    graph, wrong = spoilt(graph, rng_of(6), 12)
    told = []
    answer = certpgo.solve(graph, on_disagreement=told.append, max_rank=3)
    assert told == [answer.disagreement]
    assert set(answer.disagreement.edges) <= set(np.flatnonzero(wrong))


def test_a_certified_answer_may_have_its_doubts():
    problem = bundle(20, 1e4, math.pi)
    answer = certpgo.solve(problem.graph)
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.disagreement.edges.tolist() == [20]
    assert math.degrees(answer.disagreement.worst_angle) > 179.0
    told = []
    listened = certpgo.solve(problem.graph, on_disagreement=told.append)
    assert told == [listened.disagreement]
    assert told[0].edges.tolist() == [20]


def test_solving_robustly_certifies_what_is_kept():
    graph, true = ladder(rng_of(8), 60, 3, 0.02)
    graph, wrong = spoilt(graph, rng_of(9), 12)
    problem = Quadratic(graph)
    answer = certpgo.solve_robustly(graph)
    assert answer.verdict is Verdict.CERTIFIED
    assert answer.disagreement is None
    assert answer.solution.rejected.tolist() == np.flatnonzero(wrong).tolist()
    assert answer.solution.kept == graph.num_edges - 12
    kept = answer.solution.judged(problem)
    assert answer.certificate.cost_upper == pytest.approx(kept.cost(answer.estimate), rel=1e-9)
    assert answer.cost == problem.cost(answer.estimate) > 10.0 * answer.certificate.cost_upper
    assert metrics.position_errors(answer.estimate, true).worst < 0.5
    assert "chosen by graduated_non_convexity" in answer.solution.note


def test_a_clean_graph_is_solved_robustly_as_it_is():
    graph, _ = ladder(rng_of(10), 30, 2, 0.05)
    plain, robust = certpgo.solve(graph), certpgo.solve_robustly(graph)
    assert robust.solution.rejected.tolist() == []
    assert robust.cost == pytest.approx(plain.cost, rel=1e-9)
    said = " ".join(robust.summary().split())
    assert f"kept {graph.num_measurements} measurements: none is rejected" in said


def test_robust_solving_stops_where_it_is_told():
    graph, _ = ladder(rng_of(5), 30, 3, 0.02)
    graph, _ = spoilt(graph, rng_of(6), 5)
    stopped = certpgo.solve_robustly(graph, monitor=lambda iteration: True)
    assert stopped.solution.status.value == "interrupted"
    late = certpgo.solve_robustly(graph, time_limit=0.0)
    assert late.solution.status.value == "time limit"
    with pytest.raises(certpgo.InputError, match="time limit"):
        certpgo.solve_robustly(graph, time_limit=-1.0)
    hurried = certpgo.SolveSettings(time_limit=100.0, max_rank=6)
    assert certpgo.solve_robustly(graph, hurried).settings == hurried


#: Public sets whose residuals are as their weights say, or as those of the rest.
CLEAN = [
    "M3500a", "MIT", "ais2klinik", "burghers", "cubicle", "cycle20_0.5_SO3", "drone",
    "inputGrid3D-noOutliers", "intel", "kitti_00", "kitti_05", "manhattan", "parking-garage",
    "parking-garage_SO3", "pose3example-grid", "ring", "smallGrid3D", "smallGrid3D_SO3",
    "sphere2500", "sphere2500_isam", "sphere400", "sphere_bignoise_vertex3", "sphere_smallnoise",
    "stonewall", "tinyGrid3D", "torus3D", "toyExample", "w100",
]  # fmt: skip


@pytest.mark.parametrize("name", CLEAN)
def test_public_sets_without_outliers_raise_no_alarm(dataset, name):
    problem = Quadratic(dataset(name).graph)
    assert disagreement(problem, fitted(problem)) is None


@pytest.mark.parametrize("share", [10, 30, 50])
def test_labelled_loop_closures_are_told(dataset, share):
    instance = dataset(f"grid1000_{share}p_outliers")
    problem = Quadratic(instance.graph)
    found = disagreement(problem, fitted(problem), refit=True)
    assert found.edges.tolist() == np.flatnonzero(instance.outliers).tolist()


@pytest.mark.parametrize("scene", ["Ellis_Island", "Madrid_Metropolis", "Tower_of_London"])
def test_scenes_with_residuals_of_180_degrees_are_hinted_at(dataset, scene):
    from certpgo.graph.components import connected_parts

    answer = certpgo.solve(connected_parts(dataset(scene), "largest")[0].graph)
    assert answer.verdict is Verdict.CERTIFIED
    assert len(answer.disagreement.edges) > 1000
    assert math.degrees(answer.disagreement.worst_angle) > 179.0


def test_the_wrong_measurement_of_sphinx_is_told(dataset):
    instance = dataset("sphinx_SO3")
    found = certpgo.solve(instance.graph).disagreement
    assert len(found.edges) == 1
    # Of its true rotations it is off by 24 degrees, where the median is 0.3.
    angles = Quadratic(instance.graph).residual_angles(instance.truth)
    assert math.degrees(angles[found.edges[0]]) > 24.0

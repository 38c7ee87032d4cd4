"""Verdicts: closed forms, public optima, laws; no wound-up cycle is ever certified."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import certify
from certpgo.certify import Tier, Verdict
from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.riemannian_newton import NewtonSettings, newton


def winding(n, theta, k, d=3, scale=1.0):
    instance, estimate = winding_cycle(n, theta, k, d)
    graph = instance.graph.with_weights(scale)
    return Quadratic(graph), estimate


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("theta", [0.0, 0.5])
@pytest.mark.parametrize("n", [6, 20, 60, 200, 2000])
def test_winding_cycles(n, theta, d):
    for k in (0, 1, 2, -1):
        problem, estimate = winding(n, theta, k, d)
        expected = 8 * n * math.sin((theta + 2 * math.pi * k) / (2 * n)) ** 2
        assert problem.cost(estimate) == pytest.approx(expected, rel=1e-9, abs=1e-20)
        certificate = certify(problem, estimate)
        if k == 0:
            assert certificate.verdict is Verdict.CERTIFIED
            assert certificate.lower_bound <= expected + 1e-12
        else:
            assert certificate.verdict is Verdict.REFUTED
            assert certificate.better_cost == pytest.approx(
                8 * n * math.sin(theta / (2 * n)) ** 2, rel=1e-6, abs=1e-12
            )


@pytest.mark.parametrize("n", [6, 60, 600])
@pytest.mark.parametrize("power", [-40, 40])
def test_wound_cycles_are_refused_at_any_scale(n, power):
    problem, estimate = winding(n, 0.1, 1, scale=2.0**power)
    assert certify(problem, estimate).verdict is Verdict.REFUTED
    unrefined = certify(problem, estimate, refine=False)
    assert unrefined.verdict in (Verdict.BOUNDED, Verdict.UNDECIDED)


@pytest.mark.parametrize("engine", ["superlu", "multifrontal"])
def test_every_engine_gives_the_same_verdicts(engine, monkeypatch):
    if engine not in factor.engines():
        pytest.skip("not compiled")
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    good, wound = winding(50, 0.3, 0), winding(50, 0.3, 1)
    assert certify(*good).verdict is Verdict.CERTIFIED
    assert certify(*good).engine == engine
    assert certify(*wound).verdict is Verdict.REFUTED
    graph, R, t = pose_graph(np.random.default_rng(0), 20, 3)
    problem = Quadratic(graph)
    optimum = newton(problem, Estimate(R, t)).estimate
    assert certify(problem, optimum).verdict is Verdict.CERTIFIED


GOLDEN = {
    "smallGrid3D": 1025.398056,
    "sphere2500": 1687.005814,
    "torus3D": 24227.045558,
    "parking-garage": 1.262524428,
    "sphere_bignoise_vertex3": 2961756.490288,
    "intel": 52.3482,
    "kitti_05": 276.5144,
}


@pytest.mark.parametrize("name", GOLDEN)
def test_public_optima_are_certified(name, dataset):
    problem = Quadratic(dataset(name).graph)
    V = spectral.smallest_eigenpairs(problem.rotation).vectors
    start = problem.complete(spectral.round_to_rotations(V, problem.d))
    first = certify(problem, start)
    assert first.verdict is Verdict.BOUNDED
    assert first.basin_is_global
    second = certify(problem, first.refined)
    assert second.verdict is Verdict.CERTIFIED
    assert second.lower_bound <= GOLDEN[name] * (1 + 1e-6)
    assert second.cost_upper == pytest.approx(GOLDEN[name], rel=1e-6)
    assert second.relative_gap < 1e-5
    rotations = certify(
        problem.rotation, newton(problem.rotation, Estimate(start.rotations)).estimate
    )
    assert rotations.verdict is Verdict.CERTIFIED


@settings(max_examples=60)
@given(seeds, dimensions, st.booleans())
def test_lower_bounds_are_below_every_cost_in_sight(seed, d, poses):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 7, d, noise=0.4)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    truth = Estimate(R, t if poses else None)
    certificate = certify(problem, truth)
    assert certificate.cost_upper >= problem.cost(truth)
    assert certificate.lower_bound <= problem.cost(certificate.refined)
    for _ in range(5):
        other = problem.complete(so.random(rng, 7, d))
        local = newton(problem, other, NewtonSettings(max_iterations=200))
        assert certificate.lower_bound <= local.cost * (1 + 1e-12)
        if certificate.verdict is Verdict.CERTIFIED:
            assert local.cost >= certificate.cost_upper - certificate.tolerance


@settings(max_examples=25)
@given(seeds, dimensions)
def test_invariances_of_the_verdict(seed, d):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 8, d, noise=0.2)
    x = newton(Quadratic(graph), Estimate(R, t)).estimate
    reference = certify(Quadratic(graph), x)

    scaled = graph.with_weights(2.0**40 * graph.kappa, 2.0**40 * graph.tau)
    certificate = certify(Quadratic(scaled), x)
    assert certificate.verdict is reference.verdict
    assert certificate.lower_bound == pytest.approx(2.0**40 * reference.lower_bound, rel=1e-8)

    moved = x.moved(so.random(rng, 1, d)[0], rng.standard_normal(d))
    assert certify(Quadratic(graph), moved).verdict is reference.verdict

    kilometres = PoseGraph(graph.rotations_alone, graph.translations / 1024, graph.tau * 1024.0**2)
    smaller = Estimate(x.rotations, x.translations / 1024)
    assert certify(Quadratic(kilometres), smaller).verdict is reference.verdict

    order = rng.permutation(8)
    place = np.argsort(order)
    rotation = graph.rotations_alone
    renamed = PoseGraph(
        RotationGraph(8, place[rotation.edges], rotation.rotations, rotation.kappa),
        graph.translations,
        graph.tau,
    )
    certificate = certify(Quadratic(renamed), x.subset(order))
    assert certificate.verdict is reference.verdict
    assert certificate.lower_bound == pytest.approx(reference.lower_bound, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("poses", [True, False])
def test_noise_free_graphs_are_certified_at_zero(poses, scale):
    graph, R, t = pose_graph(np.random.default_rng(5), 30, 3, noise=0.0)
    graph = graph.with_weights(scale * graph.kappa, scale * graph.tau)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    certificate = certify(problem, Estimate(R, t if poses else None))
    assert certificate.verdict is Verdict.CERTIFIED
    assert abs(certificate.lower_bound) < 1e-9 * problem.scale


@pytest.mark.parametrize("n", [2, 3, 10])
def test_trees_and_single_edges(n):
    rng = np.random.default_rng(1)
    graph, R, _t = pose_graph(rng, n, 3, extra=0, noise=0.5)
    for problem in (Quadratic(graph), Quadratic(graph.rotations_alone)):
        solution = newton(problem, problem.complete(R))
        certificate = certify(problem, solution.estimate)
        assert certificate.verdict is Verdict.CERTIFIED, certificate.reason
        assert certificate.cost_upper < 1e-15 * problem.scale


def test_screen_never_certifies_and_needs_no_more_than_the_standard_tier():
    problem, estimate = winding(30, 0.2, 0)
    certificate = certify(problem, estimate, tier="screen")
    assert certificate.tier is Tier.SCREEN
    assert certificate.verdict is not Verdict.CERTIFIED
    assert not certificate.basin_is_global
    standard = certify(problem, estimate, tier=Tier.STANDARD)
    assert certificate.lower_bound >= standard.lower_bound


def test_noise_beyond_tightness_is_bounded_with_a_proven_gap():
    verdicts = set()
    for seed in range(20):
        graph, _R = rotation_graph(np.random.default_rng(seed), 8, 3, noise=1.5)
        problem = Quadratic(graph)
        best = min(
            (
                newton(
                    problem,
                    Estimate(so.random(np.random.default_rng(k), 8, 3)),
                    NewtonSettings(max_iterations=300),
                )
                for k in range(8)
            ),
            key=lambda s: s.cost,
        )
        certificate = certify(problem, best.estimate)
        assert certificate.lower_bound <= best.cost
        verdicts.add(certificate.verdict)
    assert Verdict.BOUNDED in verdicts or Verdict.UNDECIDED in verdicts


def test_refinement_can_be_turned_off():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3)
    problem = Quadratic(graph)
    raw = certify(problem, Estimate(R, t), refine=False)
    assert raw.better is None
    np.testing.assert_array_equal(raw.refined.rotations, R)
    refined = certify(problem, Estimate(R, t))
    assert refined.lower_bound >= raw.lower_bound


def test_bad_arguments():
    graph, R, t = pose_graph(np.random.default_rng(0), 5, 3)
    problem = Quadratic(graph)
    with pytest.raises(SpecError, match="did you mean standard"):
        certify(problem, Estimate(R, t), tier="standart")
    with pytest.raises(InputError, match="tolerances"):
        certify(problem, Estimate(R, t), rtol=-1.0)
    with pytest.raises(InputError, match="4 nodes"):
        certify(problem, Estimate(R[:4], t[:4]))


def test_tolerances_decide_and_are_kept():
    graph, R, t = pose_graph(np.random.default_rng(0), 10, 3)
    problem = Quadratic(graph)
    optimum = newton(problem, Estimate(R, t)).estimate
    turned = problem.complete(
        optimum.rotations @ so.exp(np.full((10, 3), 1e-3) * np.arange(10)[:, None])
    )
    strict = certify(problem, turned)
    assert strict.verdict is Verdict.BOUNDED
    assert "right basin" in strict.reason.lower()
    loose = certify(problem, turned, rtol=0.5)
    assert (loose.verdict, loose.rtol, loose.atol) == (Verdict.CERTIFIED, 0.5, 1e-12)
    assert loose.tolerance >= loose.gap
    assert strict.tolerance < strict.gap

"""Similarities from GTSAM and to it."""

from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo import InputError
from certpgo.io.datasets.monocular import random_maps
from certpgo.objective.quadratic import Quadratic

gtsam = pytest.importorskip("gtsam")
if not hasattr(gtsam, "BetweenFactorSimilarity2"):
    pytest.skip("this GTSAM has no Similarity2", allow_module_level=True)


def problem_and_truth(d, noise=0.0, seed=0):
    graph, truth = random_maps(np.random.default_rng(seed), d, turn=noise, scale=noise, move=noise)
    return Quadratic(graph.with_unknown_scales(np.ones(8, dtype=bool))), truth


@pytest.mark.parametrize("d", [2, 3])
def test_exact_measurements_have_no_error_in_gtsam(d):
    problem, truth = problem_and_truth(d)
    graph, values = certpgo.to_gtsam(problem, truth)
    assert graph.error(values) < 1e-20
    assert problem.cost(truth) < 1e-20


@pytest.mark.parametrize("d", [2, 3])
def test_what_goes_to_gtsam_comes_back(d):
    problem, truth = problem_and_truth(d, 0.1)
    back, estimate = certpgo.from_gtsam(*certpgo.to_gtsam(problem, truth))
    assert back.cost(estimate) == pytest.approx(problem.cost(truth), rel=1e-9)
    assert back.graph.scales == pytest.approx(problem.graph.scales)
    assert back.graph.tau == pytest.approx(problem.graph.tau)
    assert back.graph.kappa == pytest.approx(problem.graph.kappa)
    assert certpgo.solve(back).verdict == "CERTIFIED"


@pytest.mark.parametrize("d", [2, 3])
def test_small_errors_near_scale_one_are_half_of_f(d):
    problem, truth = problem_and_truth(d, 1e-5)
    units = problem.graph.in_units_of(truth.scales)
    there = replace(truth, scales=np.ones(8))
    graph, values = certpgo.to_gtsam(Quadratic(units), there)
    assert 2.0 * graph.error(values) == pytest.approx(Quadratic(units).cost(there), rel=1e-3)


def test_graphs_and_problems_serve_alike():
    problem, truth = problem_and_truth(3, 0.02)
    graph, values = certpgo.to_gtsam(problem.graph, truth)
    back, _ = certpgo.from_gtsam(graph, values)
    assert certpgo.fit_logarithms(back).cost == pytest.approx(
        certpgo.fit_logarithms(problem.graph).cost, rel=1e-9
    )
    assert certpgo.reweigh(back, rounds=1).rounds == 1


def test_priors_fix_the_frame_and_other_factors_are_refused():
    problem, truth = problem_and_truth(3, 0.1)
    graph, values = certpgo.to_gtsam(problem, truth)
    noise = gtsam.noiseModel.Isotropic.Sigma(7, 1.0)
    graph.add(gtsam.PriorFactorSimilarity3(0, values.atSimilarity3(0), noise))
    back, estimate = certpgo.from_gtsam(graph, values)
    assert back.cost(estimate) == pytest.approx(problem.cost(truth))
    graph.add(gtsam.PriorFactorSimilarity3(1, values.atSimilarity3(1), noise))
    with pytest.raises(InputError, match="2 priors: one fixes the frame"):
        certpgo.from_gtsam(graph, values)
    graph, values = certpgo.to_gtsam(problem, truth)
    pose = gtsam.noiseModel.Isotropic.Sigma(6, 1.0)
    graph.add(gtsam.BetweenFactorPose3(0, 1, gtsam.Pose3(), pose))
    with pytest.raises(InputError, match="a BetweenFactorPose3 cannot be certified"):
        certpgo.from_gtsam(graph, values)
    held, _ = random_maps(np.random.default_rng(0))
    with pytest.raises(InputError, match="all have an unknown scale"):
        certpgo.to_gtsam(Quadratic(held), truth)

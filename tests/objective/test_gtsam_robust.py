"""GTSAM's robust noise models: the weighted or truncated cost that a verdict is about."""

import numpy as np
import pytest

import certpgo
from certpgo import InputError, certify
from certpgo.objective.truncated_cost import TruncatedCost

gtsam = pytest.importorskip("gtsam")
KERNELS = {"Huber": 1.345, "Cauchy": 1.0, "GemanMcClure": 1.0, "DCS": 1.0, "Tukey": 4.7}


def robust(name, parameter):
    return getattr(gtsam.noiseModel.mEstimator, name).Create(parameter)


def optimum(kernel, n=12):
    """A ring with loops of robust noise, one of them wrong, and where GTSAM ends."""
    rng, graph, values = np.random.default_rng(0), gtsam.NonlinearFactorGraph(), gtsam.Values()
    base = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    noise = gtsam.noiseModel.Robust.Create(kernel, base)
    turns = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    poses = [gtsam.Pose2(np.cos(turn), np.sin(turn), turn) for turn in turns]
    for k, step in ((k, step) for k in range(n) for step in (1, 2)):
        moved = gtsam.Pose2(*(0.05 * rng.normal(size=3)))
        measured = poses[k].between(poses[(k + step) % n]).compose(moved)
        own = base if step == 1 else noise
        graph.add(gtsam.BetweenFactorPose2(k, (k + step) % n, measured, own))
    graph.add(gtsam.BetweenFactorPose2(0, n // 2, gtsam.Pose2(3.0, 3.0, 2.0), noise))
    for k, pose in enumerate(poses):
        values.insert(k, pose)
    held = gtsam.NonlinearFactorGraph(graph)
    held.add(gtsam.PriorFactorPose2(0, poses[0], gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-14)
    settings.setAbsoluteErrorTol(1e-14)
    return graph, gtsam.LevenbergMarquardtOptimizer(held, values, settings).optimize()


@pytest.mark.parametrize("name", KERNELS)
def test_the_cost_with_the_weights_of_an_optimum_is_stationary_there(name):
    graph, values = optimum(robust(name, KERNELS[name]))
    problem, estimate = certpgo.from_gtsam(graph, values, robust="weights")
    assert problem.stationarity(estimate) < 1e-6
    found = certify(problem, estimate)
    assert found.verdict.value == "CERTIFIED"
    assert found.objective.endswith(f"with the weights of {name} at the given values")
    # The wrong loop counts for less, if at all.
    assert found.cost_upper < 2.0 * graph.error(values)


@pytest.mark.parametrize("name", ["Huber", "Cauchy", "GemanMcClure"])
def test_a_kernel_is_the_cost_itself_with_a_scale_for_each_factor(name):
    graph, values = optimum(robust(name, KERNELS[name]))
    problem, estimate = certpgo.from_gtsam(graph, values)
    scale = problem.kernel.kernel.scale
    assert np.isinf(scale).sum() == 12
    assert scale[np.isfinite(scale)] == pytest.approx(KERNELS[name], rel=1e-9)
    assert problem.cost(estimate) == pytest.approx(2.0 * graph.error(values), rel=1e-12)
    assert problem.stationarity(estimate) < 1e-6
    found = certify(problem, estimate)
    # Poses have bounds where other measurements hold them, and no false ones.
    assert found.verdict.value in ("BOUNDED", "UNDECIDED")
    assert found.lower_bound <= found.cost_upper
    if name != "Cauchy":
        assert found.lower_bound > 0.9 * found.cost_upper
    best = certpgo.solve(problem, time_limit=10.0)
    assert found.lower_bound <= best.cost <= problem.cost(estimate) * (1.0 + 1e-9)


def test_kernels_that_are_mixed_or_unknown_become_weights():
    graph, values = optimum(robust("Huber", 1.0))
    key = gtsam.Pose2(1.0, 0.0, 0.1)
    base = gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    other = gtsam.noiseModel.Robust.Create(robust("Cauchy", 1.0), base)
    graph.add(gtsam.BetweenFactorPose2(0, 1, key, other))
    problem, _ = certpgo.from_gtsam(graph, values)
    assert problem.kernel is None
    assert problem.title.endswith("with the weights of Cauchy and Huber at the given values")
    with pytest.raises(InputError, match="robust is 'kernel' or 'weights', not 'none'"):
        certpgo.from_gtsam(graph, values, robust="none")


def test_truncated_least_squares_is_the_truncated_cost():
    graph, values = optimum(robust("TruncatedLeastSquares", 4.0))
    problem, estimate = certpgo.from_gtsam(graph, values)
    assert isinstance(problem, TruncatedCost)
    assert problem.prices[problem.rejected] == pytest.approx([16.0])
    assert problem.cost(estimate) == pytest.approx(2.0 * graph.error(values), rel=1e-9)
    found = certify(problem, estimate)
    assert (found.verdict.value, found.rejected) == ("CERTIFIED", 1)
    assert found.objective.startswith("truncated cost")


def test_what_is_not_cut_off_is_gtsams_cost():
    graph, values = optimum(robust("TruncatedLeastSquares", 1e4))
    problem, estimate = certpgo.from_gtsam(graph, values)
    assert not isinstance(problem, TruncatedCost)
    assert problem.cost(estimate) == pytest.approx(2.0 * graph.error(values), rel=1e-9)
    assert "weights of" not in problem.title


def test_both_kinds_of_kernels_go_together():
    graph, values = optimum(robust("TruncatedLeastSquares", 4.0))
    noise = gtsam.noiseModel.Robust.Create(
        robust("Huber", 1.0), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    )
    graph.add(gtsam.BetweenFactorPose2(1, 4, gtsam.Pose2(9.0, 0.0, 0.0), noise))
    problem, _ = certpgo.from_gtsam(graph, values)
    assert isinstance(problem, TruncatedCost)
    assert "weights of Huber" in problem.title
    assert problem.rejected.tolist() == [24]


def test_constrained_noise_is_still_refused():
    graph, values = optimum(robust("Huber", 1.0))
    noise = gtsam.noiseModel.Constrained.All(3)
    graph.add(gtsam.BetweenFactorPose2(1, 4, gtsam.Pose2(), noise))
    with pytest.raises(InputError, match="Constrained"):
        certpgo.from_gtsam(graph, values)


@pytest.mark.parametrize("name", ["Huber", "Cauchy", "GemanMcClure"])
def test_a_robust_prior_gets_a_weight(name):
    """A kernel leaves what is measured from the world as it is: that would be another cost."""
    graph, values = optimum(robust(name, KERNELS[name]))
    noise = gtsam.noiseModel.Robust.Create(
        robust(name, KERNELS[name]), gtsam.noiseModel.Isotropic.Sigma(3, 0.05)
    )
    for k in (0, 5):
        graph.add(gtsam.PriorFactorPose2(k, gtsam.Pose2(k, 1.0, 0.0), noise))
    problem, _ = certpgo.from_gtsam(graph, values)
    assert problem.kernel is None
    assert problem.title.endswith(f"with the weights of {name} at the given values")


def test_a_kernel_is_not_written():
    problem, estimate = certpgo.from_gtsam(*optimum(robust("Huber", 1.345)))
    with pytest.raises(InputError, match="to_gtsam takes costs without a kernel"):
        certpgo.to_gtsam(problem, estimate)

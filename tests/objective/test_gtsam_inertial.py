"""Inertial factors of GTSAM: steps at their biases, what is certified, and what is refused."""

import numpy as np
import pytest

import certpgo
from certpgo import InputError
from certpgo.io.gtsam_inertial import Inertial
from certpgo.linalg import rotations as so

gtsam = pytest.importorskip("gtsam")
N, H, STEPS = 5, 0.02, 20
X, V, B = ([gtsam.symbol(name, k) for k in range(N)] for name in "xvb")
BIAS = np.array([0.05, -0.02, 0.01, 0.01, 0.02, -0.01])
SIX = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01] * 3 + [0.02] * 3))


def flown(*, combined=False, prior=True, hat=0.0, noise=1.0):
    """A flight with two loops, integrated at a share of the bias, and the true values."""
    rng = np.random.default_rng(0)
    kind = "Combined" if combined else ""
    params = getattr(gtsam, f"Preintegration{kind}Params").MakeSharedU(9.81)
    params.setAccelerometerCovariance(1e-3 * np.eye(3))
    params.setGyroscopeCovariance(1e-5 * np.eye(3))
    params.setIntegrationCovariance(1e-8 * np.eye(3))
    made = getattr(gtsam, f"Preintegrated{kind or 'Imu'}Measurements")
    bias, at = (gtsam.imuBias.ConstantBias(b[:3], b[3:]) for b in (BIAS, hat * BIAS))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    R, p, v, g = np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81])
    poses = []
    for k in range(N):
        poses.append(gtsam.Pose3(gtsam.Rot3(R), p))
        values.insert(X[k], poses[k])
        values.insert(V[k], v)
        if combined or k == 0:
            values.insert(B[k], bias)
        if k == N - 1:
            break
        measured = made(params, at)
        for m in range(STEPS):
            t = (k * STEPS + m) * H
            w = np.array([0.2 * np.sin(t), 0.3 * np.cos(t), 0.4])
            a = np.array([np.cos(t), np.sin(2.0 * t), 0.3])
            spread = noise * rng.standard_normal((2, 3)) * np.sqrt([[1e-3 / H], [1e-5 / H]])
            sensed = np.stack([R.T @ (a - g) + BIAS[:3], w + BIAS[3:]]) + spread
            measured.integrateMeasurement(*sensed, H)
            p, v = p + v * H + 0.5 * a * H**2, v + a * H
            R = R @ so.exp(w[None] * H)[0]
        ends = X[k], V[k], X[k + 1], V[k + 1]
        if combined:
            graph.add(gtsam.CombinedImuFactor(*ends, B[k], B[k + 1], measured))
        else:
            graph.add(gtsam.ImuFactor(*ends, B[0], measured))
    for i, j in ((0, N - 1), (1, N - 2)):
        off = gtsam.Pose3.Expmap(noise * 0.01 * rng.standard_normal(6))
        between = poses[i].between(poses[j]).compose(off)
        graph.add(gtsam.BetweenFactorPose3(X[i], X[j], between, SIX))
    graph.add(gtsam.PriorFactorConstantBias(B[0], bias, gtsam.noiseModel.Isotropic.Sigma(6, 0.1)))
    if prior:
        graph.add(gtsam.PriorFactorPose3(X[0], gtsam.Pose3(), SIX))
    return graph, values


@pytest.mark.parametrize("combined", [False, True])
def test_steps_are_those_of_the_factor_at_the_bias(combined):
    """Where the rotation fits, GTSAM's residual is that of the steps, in another frame."""
    graph, values = flown(combined=combined)
    inertial = Inertial(graph, values)
    for step in inertial.steps:
        factor, (xi, vi, xj, vj) = graph.at(step.number), step.keys
        pose = values.atPose3(xi)
        R, p, v = pose.rotation().matrix(), pose.translation(), values.atVector(vi)
        there = values.atPose3(xj).translation()
        fitted = gtsam.Pose3(gtsam.Rot3(R @ step.rotation), there)
        biases = [values.atConstantBias(B[0])] * (2 if combined else 1)
        e = factor.evaluateError(pose, v, fitted, values.atVector(vj), *biases)
        dt, g = step.seconds, step.gravity
        of_p = R.T @ (there - p - v * dt - 0.5 * g * dt**2) - step.position
        of_v = R.T @ (values.atVector(vj) - v - g * dt) - step.velocity
        assert e[:3] == pytest.approx(np.zeros(3), abs=1e-9)
        assert np.linalg.norm(e[3:6]) == pytest.approx(np.linalg.norm(of_p), rel=1e-6)
        assert np.linalg.norm(e[6:9]) == pytest.approx(np.linalg.norm(of_v), rel=1e-6)
        assert g == pytest.approx([0.0, 0.0, -9.81], abs=1e-9)


@pytest.mark.parametrize("hat", [0.0, 1.0])
def test_flights_are_certified(hat):
    graph, values = flown(hat=hat)
    problem, estimate = certpgo.from_gtsam(graph, values)
    # Nearly GTSAM's: noise is white, and rotations are known well.
    assert problem.cost(estimate) == pytest.approx(2.0 * graph.error(values), rel=0.2)
    answer = certpgo.solve(problem)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost < problem.cost(estimate)
    block = problem.measured.blocks[0]
    there = answer.estimate.anchored(problem.n - 1)
    assert block.velocities(estimate)[1] == pytest.approx(
        np.array([values.atVector(key) for key in V]), abs=1e-12
    )
    assert block.velocities(there)[1] == pytest.approx(block.velocities(estimate)[1], abs=0.2)
    assert certpgo.certify_values(graph, values).lower_bound <= answer.cost


def test_without_noise_the_truth_is_the_answer():
    graph, values = flown(hat=1.0, noise=0.0)
    problem, estimate = certpgo.from_gtsam(graph, values)
    assert problem.cost(estimate) < 0.05  # of the integration's first order
    instance = certpgo.from_gtsam(graph)
    assert "fixed biases" in " ".join(instance.notices)
    assert certpgo.solve(instance).cost < 1e-6


def test_a_body_at_rest():
    graph, values = flown()
    before = certpgo.from_gtsam(graph, values)[0]
    rest = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    graph.add(gtsam.PriorFactorVector(V[2], np.zeros(3), rest))
    problem, estimate = certpgo.from_gtsam(graph, values)
    more = 2.0 * graph.at(graph.size() - 1).error(values)
    cost = before.cost(certpgo.from_gtsam(flown()[0], values)[1])
    assert problem.cost(estimate) == pytest.approx(cost + more, rel=1e-9)
    assert certpgo.solve(problem).verdict.value == "CERTIFIED"


def test_what_is_refused_is_said():
    with pytest.raises(InputError, match="gravity is one of the world"):
        certpgo.from_gtsam(*flown(prior=False))
    graph, values = flown()
    graph.add(gtsam.PriorFactorVector(V[0], np.ones(3), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)))
    with pytest.raises(InputError, match="velocity v0 is not zero"):
        certpgo.from_gtsam(graph, values)
    graph, values = flown(combined=True)
    values.update(B[1], gtsam.imuBias.ConstantBias())
    with pytest.raises(InputError, match="two different biases"):
        certpgo.from_gtsam(graph, values)
    graph, values = flown()
    values.erase(B[0])
    with pytest.raises(InputError, match="no bias at key b0"):
        certpgo.from_gtsam(graph, values)
    problem, estimate = certpgo.from_gtsam(*flown())
    with pytest.raises(InputError, match="to_gtsam takes relative poses"):
        certpgo.to_gtsam(problem, estimate)

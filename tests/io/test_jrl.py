"""JSON Robot Logs."""

import json
from contextlib import suppress

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, InputError, InputNotice, io
from certpgo.graph.phrases import reading_sentence

A, B = ord("a") << 56, ord("b") << 56
HALF = float(np.sqrt(0.5))
#: Variances of the rotation, then of the translation.
COVARIANCE = np.diag([0.01, 0.01, 0.02, 0.04, 0.04, 0.04]).ravel().tolist()


def pose(x, y, turned=False):
    rotation = [HALF, 0, 0, HALF] if turned else [1, 0, 0, 0]
    return {"type": "Pose3", "translation": [x, y, 0], "rotation": rotation}


def between(i, j, measured, covariance=COVARIANCE):
    kind = "BetweenFactor" + measured["type"]
    return {
        "type": kind,
        "key1": i,
        "key2": j,
        "measurement": measured,
        "covariance": covariance,
    }


def log(*of_a, of_b=(), **others):
    entries = {
        "a": [{"stamp": k, "measurements": [one]} for k, one in enumerate(of_a)],
        "b": [{"stamp": 9, "measurements": list(of_b)}],
    }
    return {"name": "two", "robots": ["a", "b"], "measurements": entries, **others}


@pytest.fixture
def write(tmp_path):
    def writes(content, name="log.jrl"):
        path = tmp_path / name
        path.write_text(json.dumps(content))
        return path

    return writes


STEPS = [between(A, A + 1, pose(1, 0, True)), between(A + 1, B, pose(1, 0))]
LOOP = between(A, B, pose(1, 1.2, True))


def test_robots_share_one_graph_under_gtsams_cost(write):
    truth = {
        "a": [{"key": A, **pose(0, 0)}, {"key": A + 1, **pose(1, 0, True)}],
        "b": [{"key": B, **pose(1, 1, True)}],
    }
    content = log(*STEPS, of_b=[LOOP], groundtruth=truth, outlier_factors={"b": [[0, 0]]})
    instance = io.read(write(content), quiet=True)
    assert instance.ids.tolist() == [A, A + 1, B]
    assert instance.graph.edges.tolist() == [[0, 1], [1, 2], [0, 2]]
    quarter = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(instance.graph.rotations[0], quarter, atol=1e-15)
    assert instance.graph.tau[0] == pytest.approx(25.0)
    assert instance.graph.kappa[0] == pytest.approx(3 / (2 * 0.04))
    np.testing.assert_allclose(
        np.diag(instance.graph.information_matrices[0]), [25, 25, 25, 100, 100, 50], rtol=1e-12
    )
    np.testing.assert_array_equal(instance.truth.translations[2], [1, 1, 0])
    assert instance.outliers.tolist() == [False, False, True]
    assert "weights from the file's covariances" in reading_sentence(instance.options)
    answer = certpgo.solve(instance)
    assert "GTSAM's error" in answer.certificate.objective
    assert answer.verdict.value == "CERTIFIED"
    # 0.2 m are shared by three steps, and nothing turns.
    assert answer.cost == pytest.approx(25 * 0.2**2 / 3, rel=1e-9)


def test_truth_and_outliers_are_kept_or_said_to_be_lost(write, tmp_path):
    truth = {"a": [{**pose(k, 0), "key": A + k} for k in range(2)], "b": [{**pose(1, 1), "key": B}]}
    content = log(*STEPS, of_b=[LOOP], groundtruth=truth, outlier_factors={"b": [[0, 0]]})
    instance = io.read(write(content), quiet=True)
    with pytest.warns(InputNotice) as said:
        io.write(tmp_path / "g.g2o", instance)
    notices = " ".join(str(one.message) for one in said)
    assert "g2o files hold no ground truth: it is not written" in notices
    assert "g2o files do not say which measurements are outliers" in notices
    io.write(tmp_path / "g.npz", instance)
    again = io.read(tmp_path / "g.npz", quiet=True)
    assert again.outliers.tolist() == instance.outliers.tolist()
    np.testing.assert_array_equal(again.truth.translations, instance.truth.translations)


def test_planes_priors_and_what_is_skipped(write):
    C = np.diag([0.04, 0.04, 0.01]).ravel().tolist()
    step = between(A, A + 1, {"type": "Pose2", "x": 1, "y": 0, "theta": 0.5}, C)
    prior = {"type": "PriorFactorPose2", "key": A, "prior": step["measurement"], "covariance": C}
    ranged = {"type": "RangeFactorPose2", "key1": A, "key2": B, "measurement": 1.0}
    path = write(log(step, prior, ranged))
    with pytest.raises(FormatError, match="--skip RangeFactorPose2 leaves such measurements out"):
        io.read(path)
    instance = io.read(path, skip=["RangeFactorPose2"], quiet=True)
    assert "1 RangeFactorPose2 measurement skipped" in instance.notices
    assert instance.graph.edges.tolist() == [[0, 1], [2, 0]]
    np.testing.assert_allclose(instance.graph.kappa, 100.0)
    assert io.read(path, skip="RangeFactorPose2", priors=False, quiet=True).world is None


def test_results_are_estimates(write):
    solutions = {"a": [{"key": A, **pose(0, 0)}], "b": [{"key": B, **pose(1, 2, True)}]}
    path = write({"robots": ["a", "b"], "solutions": solutions}, "result.jrr")
    estimate = io.read_estimate(path)
    assert estimate.keys.ids.tolist() == [A, B]
    np.testing.assert_array_equal(estimate.translations[1], [1, 2, 0])
    with pytest.raises(InputError, match="an estimate, not a graph"):
        io.read(path)


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (between(A, A, pose(1, 0)), "is measured from itself"),
        (between(A, 2**64 - 1, pose(1, 0)), "a key of 63 bits"),
        (between(A, B, pose(1, 0), [1.0]), "covariance: 36 finite numbers"),
        (between(A, B, pose(1, 0), [0.0] * 36), "covariance: a positive definite matrix"),
        (between(A, B, {**pose(1, 0), "rotation": [0, 0, 0, 0]}), "not zero"),
        (between(A, B, {**pose(1, 0), "translation": [None, 0, 0]}), "3 finite numbers"),
        ({"type": "BetweenFactorPose3", "key1": A, "key2": B}, "measurement: an object"),
        ("", "an object expected"),
    ],
)
def test_what_cannot_be_read_is_named(write, step, said):
    with pytest.raises(FormatError, match=said):
        io.read(write(log(*STEPS, step)))


def test_damaged_logs_are_refused_or_read(write):
    rng = np.random.default_rng(1)
    path = write(log(*STEPS, of_b=[LOOP]))
    text = path.read_bytes()
    for _ in range(200):
        damaged = bytearray(text)
        damaged[rng.integers(0, len(damaged))] = rng.choice(list(b'019-,:"[]{}enA\xff'))
        path.write_bytes(bytes(damaged))
        with suppress(FormatError):
            io.read(path, quiet=True)

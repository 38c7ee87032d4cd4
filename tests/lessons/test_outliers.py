"""What the lesson on outliers says is so."""

import numpy as np
import pytest


@pytest.fixture
def taught(lesson):
    return lesson("outliers")


def test_one_wrong_measurement_has_the_say_of_hundreds(taught):
    assert taught["outweighed"] == pytest.approx(394.2, abs=0.1)  # sin^2(60) / sin^2(2.5), degrees


def test_least_squares_gives_in_and_is_certified_nevertheless(taught):
    squares = taught["errors"]["least_squares"]
    assert 1.7 < squares[1] / squares[0] < 2.3
    verdicts = [run[2].verdict.value for run in taught["runs"].values()]
    assert verdicts == ["CERTIFIED"] * 4 + ["BOUNDED"] * 4


@pytest.mark.parametrize("name", ["eigen_rao", "adaptive_trimming", "graduated_non_convexity"])
def test_robust_methods_hold_until_about_half_is_wrong(taught, name):
    errors = dict(zip(taught["SHARES"], taught["errors"][name], strict=True))
    assert max(errors[share] for share in (0.0, 0.05, 0.1, 0.2, 0.3, 0.4)) < 2.5
    assert errors[0.6] > 10.0
    precision, recall = taught["scores"][name]
    assert min(precision, recall) > 0.95


def test_one_wrong_closure_multiplies_the_error_and_all_are_found(taught):
    closures = taught["closures"]
    assert closures[1][0] > 3.0 * closures[0][0]
    assert closures[1][3] == "CERTIFIED"
    assert all(robust < 0.15 for _, robust, _, _ in closures.values())
    assert all(caught == count for count, (_, _, caught, _) in closures.items())


def test_what_was_kept_is_certified(taught):
    verdicts = {name: c.verdict.value for name, c in taught["kept"].items()}
    assert verdicts == {
        "eigen_rao": "BOUNDED",
        "adaptive_trimming": "CERTIFIED",
        "graduated_non_convexity": "CERTIFIED",
    }
    assert taught["kept"]["eigen_rao"].relative_gap < 1e-4


def test_the_majority_wins_right_or_wrong_and_is_certified(taught):
    alike = taught["alike"]
    assert {verdict for _, verdict, *_ in alike.values()} == {"CERTIFIED"}
    assert all(error < 2.0 for count, (error, *_) in alike.items() if count < 10)
    assert all(error == pytest.approx(45.0, abs=1.0) for c, (error, *_) in alike.items() if c > 10)
    assert taught["truncated"]["wrong estimate"] < taught["truncated"]["right estimate"]


def test_exercises(taught):
    assert taught["badly_error"] > 10.0
    assert taught["badly_verdict"] == "CERTIFIED"
    assert taught["badly_scores"][0] < 0.5
    precision, recall = (np.array([s[k] for s in taught["scaled"].values()]) for k in (0, 1))
    assert precision[0] < 0.7 < 0.95 < precision[1:3].min()
    assert recall[:3].min() > 0.95
    assert recall[3] == 0.0
    assert taught["believed"].weights[-1] > 0.0
    assert taught["bridge_residual"] < 1e-9
    assert taught["lonely_error"] > 40.0

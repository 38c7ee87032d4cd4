"""What the lesson *From images to a proof* says: which checks notice a wrong trajectory."""

import pytest

pytest.importorskip("cv2")
pytest.importorskip("small_gicp")


@pytest.fixture
def taught(lesson):
    return lesson("images_to_a_proof")


def test_right_and_wrong_trajectories_are_certified(taught):
    scores = taught["scores"]
    assert {score["verdict"] for score in scores.values()} == {"CERTIFIED"}
    for name in ("neither", "consistent"):
        assert 0.2 < scores[name]["metres"] < 1.0
        assert scores[name]["degrees"] == pytest.approx(45.0, abs=1.0)
        assert scores[name]["wrong kept"] > 0
        assert scores[name]["steps rejected"] > 0
    for name in ("trust", "gate"):
        assert scores[name]["metres"] < 0.005
        assert scores[name]["wrong kept"] == 0


def test_measured_consistency_does_not_tell_them_apart(taught):
    wrong, right = taught["scores"]["neither"], taught["scores"]["trust"]
    assert wrong["chi2"] < 1.0
    assert wrong["chi2"] < 2.0 * right["chi2"]
    assert wrong["inliers"] == pytest.approx(right["inliers"], abs=0.1)
    assert taught["squares"]["neither"] < taught["squares"]["trust"]


def test_exercises(taught):
    few = taught["few"]
    assert few[0][0] < 1.0
    assert few[6][0] > 40.0
    assert {verdict for _, verdict in few.values()} == {"CERTIFIED"}
    assert taught["scaled"].verdict.value == "CERTIFIED"
    assert taught["scaled"].cost == pytest.approx(taught["plain"].cost, rel=1e-7)
    assert taught["growth"] == pytest.approx(1.1, rel=1e-6)
    assert all(turn == pytest.approx(90.0, abs=1.0) for turn in taught["turns"])

"""The ladder of bounds: all of them true, the top ones tight, whichever graph was here."""

import numpy as np
import pytest

NAME = "from_eigenvectors_to_sdp"
#: Rounding of dense eigenvalues, relative to F.
ROUNDING = 1e-9


def bounds(lesson):
    return {name: bound for name, (bound, _) in lesson(NAME)["rungs"].items()}


def test_no_bound_is_above_the_certified_cost(lesson):
    F = lesson(NAME)["F"]
    for name, bound in bounds(lesson).items():
        assert bound <= (1 + ROUNDING) * F, name
    for bound, cost in lesson(NAME)["off"].values():
        assert bound <= F <= cost
    assert all(bound <= F for bound in lesson(NAME)["powers"].values())


def test_the_rungs_rise_to_the_optimum(lesson):
    F, found = lesson(NAME)["F"], bounds(lesson)
    assert 0.8 * F < found["eigenvalues"] < found["weighted, dense"] < 0.999 * F
    assert found["SDP"] == pytest.approx(F, rel=1e-7)
    assert found["certificate"] == pytest.approx(F, rel=1e-8)
    assert found["proof"] == pytest.approx(F, rel=1e-9)


def test_the_inequality_agrees_with_the_package(lesson):
    names = lesson(NAME)
    by_hand = names["lower_bound"](names["nothing"], names["alike"])
    assert by_hand == pytest.approx(names["eigen"].lower_bound, rel=1e-5)
    assert by_hand >= names["eigen"].lower_bound
    assert names["by_inequality"] == pytest.approx(names["F"], rel=1e-8)


def test_the_inequality_holds_for_any_multipliers(lesson):
    names = lesson(NAME)
    rng = np.random.default_rng(0)
    n, d = names["n"], names["d"]
    A = names["F"] / n * rng.standard_normal((n, d, d))
    bound = names["lower_bound"](A + np.swapaxes(A, 1, 2), rng.uniform(0.5, 2.0, n))
    assert bound < names["F"]


def test_the_relaxation_is_tight_here(lesson):
    names = lesson(NAME)
    assert names["sdp"].relaxation.rank == names["d"]
    assert names["sdp"].cost == pytest.approx(names["F"], rel=1e-6)


def test_stationary_poses_without_rotation_residuals_may_be_far_from_optimal(lesson):
    names = lesson(NAME)
    facing, same = names["facing"], names["same"]
    assert facing.cost(same) == pytest.approx(2.0, rel=1e-12)
    assert facing.stationarity(same) < 1e-12
    assert facing.residual_angles(same).max() < 1e-12
    assert facing.cost(names["opposed"]) == pytest.approx(0.016, rel=1e-12)


def test_the_golden_numbers_of_mit(lesson, dataset):
    dataset("MIT")  # skips where it is not here
    names, found = lesson(NAME), bounds(lesson)
    assert names["instance"].name == "MIT"
    assert names["F"] == pytest.approx(38.81092046782, rel=1e-11)
    assert found["eigenvalues"] == pytest.approx(35.5206, abs=1e-3)
    assert found["weighted, dense"] == pytest.approx(35.600206, abs=1e-5)
    # Slow on long chains, as the lesson says.
    assert found["block descent"] < found["eigenvalues"]
    assert names["climbed"].cost == pytest.approx(61.1541155, rel=1e-8)

"""What *Three cameras* says, held against closed forms."""

import numpy as np
import pytest


@pytest.fixture
def shown(lesson):
    return lesson("three_cameras")


def test_cost_of_the_point_that_shares_the_closing_error_out(shown):
    # theta = 120 degrees, residuals of 40: 24 sin^2 20 degrees.
    assert shown["F"] == pytest.approx(24.0 * np.sin(np.radians(20.0)) ** 2, rel=1e-12)
    assert shown["by_edges"] == pytest.approx(shown["by_matrix"], rel=1e-12)
    assert np.abs(shown["problem"].matrix.toarray() - shown["L"]).max() < 1e-15


def test_weak_duality_in_a_thousand_draws(shown):
    assert 0.0 < max(shown["dual_values"]) <= shown["F"] <= min(shown["primal_values"])


def test_strong_duality(shown):
    assert shown["dual_value"] == pytest.approx(shown["F"], rel=1e-6)
    assert shown["trace"] == pytest.approx(shown["F"], rel=1e-12)
    assert shown["certificate"].verdict.value == "CERTIFIED"


def test_eigenvalues_of_the_certificate_matrix(shown):
    a = np.radians(40.0)
    low, high = (3.0 * np.cos(a) + sign * np.sqrt(3.0) * np.sin(a) for sign in (-1.0, 1.0))
    assert shown["eigenvalues"] == pytest.approx([0, 0, low, low, high, high], abs=1e-12)
    assert sorted(shown["eigenvalues3"]) == pytest.approx(
        [0, 0, 0, low, low, 3, 3, high, high], abs=1e-12
    )


def test_the_sign_changes_where_theorem_4_1_says(shown):
    assert np.degrees(shown["zero"]) == pytest.approx(60.0, abs=1e-9)
    assert np.degrees(shown["triangle_bound"]) == pytest.approx(60.0, abs=1e-6)
    computed, guaranteed = shown["smallest"], shown["guaranteed"]
    assert (computed >= guaranteed - 1e-12).all()
    assert (np.diff(computed) < 0.0).all()
    assert shown["off"] < 1e-12


def test_beyond_it_the_point_is_refuted_by_its_rival(shown):
    refuted = shown["judged"]
    assert refuted.verdict.value == "REFUTED"
    # Residuals of 70 degrees one way are residuals of 50 the other.
    assert refuted.cost_upper == pytest.approx(24.0 * np.sin(np.radians(35.0)) ** 2, rel=1e-9)
    assert refuted.better_cost == pytest.approx(24.0 * np.sin(np.radians(25.0)) ** 2, rel=1e-9)


def test_dual_values_follow_the_better_point(shown):
    best = np.minimum(shown["point"], shown["rival"])
    assert shown["own_bound"] == pytest.approx(best, abs=1e-9)
    a = np.minimum(shown["solved_at"], 2.0 * np.pi / 3.0 - shown["solved_at"])
    assert shown["dual_curve"] == pytest.approx(24.0 * np.sin(a / 2.0) ** 2, abs=1e-5)


def test_complete_graphs_fall_to_the_limit(shown):
    bounds = list(shown["complete_bounds"].values())
    assert bounds[0] == pytest.approx(60.0, abs=1e-6)
    assert all(np.diff(bounds) < 0.0)
    assert bounds[-1] > shown["limit"] == pytest.approx(42.9414, abs=1e-4)


def test_exercises(shown):
    assert shown["turned_cost"] > 0.0 > shown["negative"]
    assert shown["turned_bound"] <= 0.0
    assert (shown["zeros"], shown["mixture_rank"]) == (4, 4)

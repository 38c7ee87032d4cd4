"""Reading the spectrum: repeated, moved by at most the bound, and the conjecture refuted."""

import numpy as np
import pytest

NAME = "reading_the_spectrum"


def test_perfect_measurements_repeat_the_spectrum(lesson):
    repeated = lesson(NAME)["repeated"]
    assert repeated.differences.max() < 1e-9
    assert repeated.graph[0] == 0.0
    assert repeated.graph[1] == pytest.approx(3.0, rel=0.03)


def test_no_eigenvalue_moves_further_than_weyl_allows(lesson):
    weyl = lesson(NAME)["weyl"]
    assert weyl[0.0] == pytest.approx((0.0, 0.0), abs=1e-9)
    for sigma, (moved, bound) in weyl.items():
        assert moved <= bound + 1e-9
        assert sigma == 0.0 or 0.0 < moved < 0.2 * bound  # generous, as the lesson says


def test_eigenra_by_hand_is_the_package_s(lesson):
    names = lesson(NAME)
    by_hand = names["measured"](names["sparse"], 10.0).cost(names["by_hand"])
    assert by_hand == pytest.approx(names["packaged"].cost, rel=1e-6)


def test_the_sandwich_opens_as_noise_grows(lesson):
    found = lesson(NAME)["eigenra"]
    for bound, best, cost in found.values():
        assert bound <= best <= cost * (1 + 1e-12)
    gaps = [(cost - bound) / best for bound, best, cost in found.values()]
    assert np.all(np.diff(gaps) > 0.0)
    assert gaps[0] < 1e-3 < 0.05 < gaps[-1]


def test_the_ratio_of_random_graphs_rises_and_levels_off_below_one(lesson):
    for row in lesson(NAME)["ratios"].values():
        assert row[0] < 1e-9
        assert np.all(np.diff(row[:6]) > 0.0)
        assert np.all((row[6:] > 0.9) & (row[6:] < 0.95))


def test_random_measurements_do_not_reach_the_fiedler_value(lesson):
    names = lesson(NAME)
    assert names["uniform"].mean() + 10.0 * names["mean_error"] < 1.0
    assert names["uniform"].max() < 1.0


def test_two_cliques_refute_it(lesson):
    names = lesson(NAME)
    spectra = names["spectra"]
    # Of vectors that change their sign with the side: the smaller root of x^2 - 22 x + 2.
    assert spectra.graph[1] == pytest.approx(11 - np.sqrt(119), abs=1e-8)
    assert spectra.graph[1] <= names["cut_bound"] == pytest.approx(0.1)
    assert spectra.measured[0, 0] >= names["apart"] > 10.0
    assert spectra.inconsistency > 100.0
    assert np.all(names["of_cliques"][2:] > 1.0)


def test_what_replaces_the_fiedler_value(lesson):
    names = lesson(NAME)
    assert names["against_fiedler"] > 0.5
    assert names["against_random"] < 0.01


def test_a_bridge_moves_the_spectrum_and_not_the_optimum(lesson):
    names = lesson(NAME)
    first, second = names["optima"]
    assert first == pytest.approx(second, rel=1e-9)
    assert abs(names["before"] - names["after"]).max() > 1e-3


def test_the_other_exercises(lesson):
    names = lesson(NAME)
    assert names["ring_bound"] == pytest.approx(names["ring_optimum"], rel=1e-9)
    first, second, third = names["wrong_values"]
    assert first == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < second == pytest.approx(third)
    assert 20 * (first + second + third) <= 8.0

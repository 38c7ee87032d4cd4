"""What rounding does: the false certificates are false, and the forged proofs are refused."""

import numpy as np
import pytest

NAME = "what_rounding_does"


def test_the_two_points_in_closed_form(lesson):
    names = lesson(NAME)
    assert names["computed"] == pytest.approx(names["smallest_at_wound"](200), abs=1e-12)
    assert names["smallest_at_wound"](200) == pytest.approx(-8.92646e-4, rel=1e-5)


def test_lanczos_rests_at_zero_before_it_finds_the_negative_eigenvalue(lesson):
    ritz = lesson(NAME)["ritz"]
    values, residuals = ritz.T
    assert abs(values[9:60]).max() < 2e-6
    assert residuals[59] < 1e-4
    assert values[-1] == pytest.approx(-8.926e-4, rel=0.02)
    assert values[0] > 1e-3  # a start beside the null space, not in it


def test_a_fixed_tolerance_accepts_long_rings_and_ours_none(lesson):
    names = lesson(NAME)
    said, sizes = names["said"], names["SIZES"]
    assert [said["se_sync_rule", n] for n in sizes] == [False, False, False, True, True]
    assert not any(said["cora_rule", n] for n in sizes)
    assert {names["verdicts"][n] for n in sizes} == {"REFUTED"}


@pytest.mark.gtsam
def test_gtsam_accepts_them_too(lesson):
    pytest.importorskip("gtsam")
    said = lesson(NAME)["said"]
    assert said["gtsam_shonan", 100]
    assert said["gtsam_staircase", 300]


def test_what_was_accepted_proves_nothing(lesson):
    names = lesson(NAME)
    assert names["F"] == pytest.approx(0.238647, rel=1e-5)
    assert names["F"] < names["problem_"].d * names["problem_"].n * names["eta"]


def test_a_shift_is_worth_something_only_below_the_price(lesson):
    names = lesson(NAME)
    price = dict(zip(names["numbers"], names["price"], strict=True))
    assert price[1000] < 1e-3 < price[10]
    assert all(shift < 1e-11 for _, shift in names["ours"])


def test_units_change_the_rules_verdicts_and_not_ours(lesson):
    said = lesson(NAME)["in_units"]
    for rule in ("se_sync_rule", "cora_rule"):
        assert said[rule, "right"] == ["optimal", "optimal", "optimal", "no"]
        assert said[rule, "wound-up"] == ["optimal", "no", "no", "no"]
    assert set(said["certpgo", "right"]) == {"CERTIFIED"}
    assert set(said["certpgo", "wound-up"]) == {"REFUTED"}


def test_the_bound_by_hand(lesson):
    names = lesson(NAME)
    optimum = names["optimum"]
    assert optimum == pytest.approx(240 * np.sin(0.005) ** 2, rel=1e-15)
    assert (1 - 1e-7) * optimum < names["bound"] < optimum
    assert (1 - 1e-7) * optimum < names["certificate"].lower_bound < optimum
    assert names["first"] == pytest.approx(0.1)  # above 0.039, minus the smallest eigenvalue
    assert names["attempts"][names["first"]] < 0.0


def test_the_honest_proof_and_the_forged_ones(lesson):
    names = lesson(NAME)
    honest, optimum = names["honest"], names["optimum"]
    assert honest.relative_gap < 1e-9
    assert names["higher_bound"].startswith("refused: the certificate matrix")
    assert "SHA-256" in names["other_graph"]
    forged = names["wound_estimate"]
    assert forged.lower == honest.lower <= optimum
    assert forged.upper == pytest.approx(240 * np.sin((2 * np.pi - 0.3) / 60) ** 2, rel=1e-9)


def test_the_proof_by_hand(lesson):
    names = lesson(NAME)
    w, turned = (3 + 4j) / 5, 2.0 * np.eye(6, dtype=complex)
    for k in range(6):
        turned[(k + 1) % 6, k] -= w
        turned[k, (k + 1) % 6] -= w.conjugate()
    by_numpy = np.linalg.det(70 * turned - np.eye(6)).real * 5**6
    assert names["closed"] == pytest.approx(by_numpy, rel=1e-9)
    assert all(minor > 0 for minor in names["minors"][1:6])
    assert names["closed"] == 4475383515625
    assert 12 / 70 < 12 * np.linalg.eigvalsh(turned)[0] < 12 / 69


def test_the_exercises(lesson):
    names = lesson(NAME)
    assert names["threshold"] == 199
    assert names["repaired"] == {"right": True, "wound up": False}
    assert names["longer"].lower == names["honest"].lower
    assert names["honest"].lower - names["weaker"].lower == pytest.approx(1e-6, rel=1e-6)

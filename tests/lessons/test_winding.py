"""What *Winding* says, held against closed forms."""

import numpy as np
import pytest

import certpgo
from certpgo.io.datasets.synthetic import winding_cycle


@pytest.fixture
def shown(lesson):
    return lesson("winding")


def test_costs_are_the_closed_form(shown):
    n, theta = shown["n"], shown["theta"]
    assert (n, np.degrees(theta)) == (24, pytest.approx(20.0))
    for k, cost in shown["costs"].items():
        share = (theta + 2.0 * np.pi * k) / n
        assert cost == pytest.approx(8.0 * n * np.sin(share / 2.0) ** 2, rel=1e-10)
        assert shown["problem"].stationarity(shown["points"][k]) < 1e-12
    assert min(shown["costs"], key=shown["costs"].get) == 0


def test_windings_below_a_right_angle_are_local_minima(shown):
    # |20 + 360 k| < 24 * 90 degrees
    assert shown["minima"] == list(range(-6, 6))
    assert shown["second"][1][1] == pytest.approx(shown["slope"], rel=1e-9)
    assert shown["second"][6][0] < -1e-3


def test_random_starts_end_wound_up(shown):
    assert sum(shown["ended"].values()) == 200
    assert 0 < shown["ended"][0] < 150
    assert set(shown["ended"]) <= set(shown["minima"])


def test_the_certificate_matrix_refuses_all_but_winding_0(shown):
    n, theta = shown["n"], shown["theta"]
    for k, eigenvalue in shown["smallest"].items():
        expected = 2.0 * np.cos((theta + 2.0 * np.pi * k) / n) - 2.0 * np.cos(theta / n)
        assert eigenvalue == pytest.approx(expected, abs=1e-10)
        assert (eigenvalue < -1e-3) == (k != 0)


def test_winding_1_is_refuted_by_winding_0(shown):
    certificate = shown["certificate"]
    assert certificate.verdict.value == "REFUTED"
    assert certificate.better_cost == pytest.approx(shown["costs"][0], rel=1e-6)
    assert shown["winding_of"](certificate.better) == 0


def test_winding_1_is_caught_at_rank_3_and_freed_at_rank_4(shown):
    # About half of one full turn, which exactly it is without a closing error (the exercise).
    assert shown["caught"].cost == pytest.approx(shown["half_cost"], rel=0.01)
    assert shown["at_caught"][0] > -1e-7
    assert (np.abs(shown["at_caught"]) < 1e-7).sum() == 4
    assert shown["eigenvalue"] < -0.01
    assert shown["freed"].cost == pytest.approx(shown["costs"][0], rel=1e-6)


def test_winding_2_is_freed_at_rank_3(shown):
    assert shown["straight"].cost == pytest.approx(shown["costs"][0], rel=1e-6)
    falling = [found.cost for found in (*shown["twice"], shown["straight"])]
    assert all(np.diff([shown["costs"][2], *falling]) < 0.0)


def test_the_pipeline_leaves_winding_1(shown):
    answer = shown["answer"]
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(shown["costs"][0], rel=1e-9)
    assert [level.rank for level in answer.levels][:2] == [2, 3]


def test_exercises(shown):
    assert shown["first"] == 199
    # Of weights 1/1000, the rule accepts from 7 nodes on.
    accepted = (2.0 * np.cos(2.0 * np.pi / shown["sizes"]) - 2.0) * 1e-3 > -1e-3 * (1.0 - 1e-9)
    assert shown["sizes"][accepted][0] == 7
    assert accepted[4:].all()
    assert shown["large_verdicts"] == ["REFUTED", "CERTIFIED"]
    n = shown["n"]
    assert shown["half_cost"] == pytest.approx(4.0 * n * np.sin(np.pi / n) ** 2, rel=1e-12)
    assert shown["full_cost"] == pytest.approx(2.0 * shown["half_cost"], rel=1e-12)
    assert np.abs(shown["left_over"]).max() < 1e-12
    assert shown["weak_certificate"].verdict.value == "CERTIFIED"
    assert shown["weak_angles"].max() > np.pi / n
    assert shown["weak_angles"].sum() == pytest.approx(np.pi / 2.0, rel=1e-9)
    assert shown["space_minima"] == [-1, 0]


@pytest.mark.parametrize(("size", "closing"), [(3, 95.0), (3, 175.0), (4, 10.0), (9, 100.0)])
def test_two_windings_are_strict_local_minima_in_space(shown, size, closing):
    theta = np.radians(closing)
    ring = certpgo.Quadratic(winding_cycle(size, theta, 0, d=3)[0].graph)
    costs = []
    for k in (0, -1):
        point = shown["stationary_point"](ring.graph, k)
        found = shown["hessian_eigenvalues"](ring, point)
        expected = shown["by_the_formula"](size, (theta + 2.0 * np.pi * k) / size)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
        # three zeros are rotations of the world
        assert np.abs(found[:3]).max() < 1e-12
        assert found[3] > 1e-3
        assert ring.stationarity(point) < 1e-12
        costs.append(ring.cost(point))
    assert abs(costs[0] - costs[1]) > 1e-3


def test_three_cameras_are_no_counterexample_outside_the_range(shown):
    expected = shown["by_the_formula"](3, np.radians((85.0 - 360.0) / 3.0))
    assert expected[0] < -1e-3

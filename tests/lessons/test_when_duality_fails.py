"""What *When duality fails* says: closed forms, ranks, and what implies what."""

import numpy as np
import pytest
from scipy.sparse.csgraph import laplacian


@pytest.fixture
def shown(lesson):
    return lesson("when_duality_fails")


@pytest.fixture
def levels(shown):
    return shown["levels"]


def tight(level):
    return level["verdict"] == "CERTIFIED"


def test_angle_bounds_are_those_of_the_graph(shown):
    graph = shown["clean"].graph
    adjacency = np.zeros((10, 10))
    adjacency[tuple(graph.edges.T)] = adjacency[tuple(graph.edges.T[::-1])] = 1.0
    degree = adjacency.sum(axis=1).max()
    for name, connectivity in (
        ("alpha", np.linalg.eigvalsh(laplacian(adjacency))[1] / degree),
        ("normalized", np.linalg.eigvalsh(laplacian(adjacency, normed=True))[1]),
    ):
        sine = np.sqrt(0.25 + connectivity / 2.0) - 0.5
        assert shown[name] == pytest.approx(2.0 * np.degrees(np.arcsin(sine)), abs=1e-5)


def test_tight_up_to_some_noise_and_loose_beyond(levels):
    verdicts = [level["verdict"] for level in levels]
    first = verdicts.index("BOUNDED")
    assert verdicts == ["CERTIFIED"] * first + ["BOUNDED"] * (len(levels) - first)
    assert 0 < first < len(levels)


def test_rank_is_three_exactly_where_the_relaxation_is_tight(levels):
    assert all((level["rank"] == 3) == tight(level) for level in levels)


def test_the_gap_opens_with_the_rank(levels):
    for level in levels:
        assert abs(level["gap"]) < 1e-6 if tight(level) else level["gap"] > 0.01
        # The proven bound is as good as the relaxation, and never above it.
        assert level["proven"] == pytest.approx(level["gap"], abs=1e-5)


def test_the_eigenvalue_falls_to_zero_where_tightness_ends(levels):
    eigenvalues = [level["eigenvalue"] for level in levels]
    assert all(
        (value > 0.0) == tight(level) for value, level in zip(eigenvalues, levels, strict=True)
    )
    falling = [value for value in eigenvalues if value > 0.0]
    assert all(np.diff(falling) < 0.0)


def test_each_bound_ends_before_the_next(shown):
    ends = shown["ends"]
    assert list(ends) == ["alpha_max", "normalized", "rows", "certificate"]
    assert all(np.diff(list(ends.values())) > 0.1)
    last = max(s for s, level in zip(shown["noise"], shown["levels"], strict=True) if tight(level))
    assert last <= ends["certificate"] <= last + 5.0


def test_frames_of_higher_rank_are_cheaper_than_rotations(shown):
    assert shown["relaxation"].rank > 3
    assert shown["lifted_cost"] == pytest.approx(shown["relaxation"].value, rel=1e-6)
    assert shown["lifted_cost"] < 0.95 * shown["best_cost"]


def test_random_starts_improve_on_no_answer(shown, levels):
    assert shown["improved"] == []
    assert any(level["verdict"] == "BOUNDED" for level in levels)


def test_the_ladder_between_two_bounds(shown):
    rungs = shown["rungs"]
    assert not rungs["alpha_max"].holds
    assert all(rungs[key].holds for key in ("normalized", "rows", "sdp", "proven"))


def test_exercises(shown):
    # K_10: lambda_2 / d_max = 10 / 9.
    bound = 2.0 * np.arcsin(np.sqrt(0.25 + 5.0 / 9.0) - 0.5)
    assert (shown["dense_alpha"], shown["dense_normalized"]) == pytest.approx((bound, bound))
    assert shown["dense_last"] > shown["ends"]["certificate"]
    assert shown["singular"][-1] > 0.1
    assert abs(shown["zeros"][shown["r"] - 1]) < 1e-6 < 0.1 < shown["zeros"][shown["r"]]
    assert shown["wrong_answer"].verdict.value == "CERTIFIED"
    assert shown["wrong_angles"].argmax() == 7
    assert shown["wrong_angles"].max() > 5.0 * shown["normalized"]


def test_rank_d_is_not_tight_where_determinants_differ(shown):
    assert shown["reflected"].rank == 3
    assert shown["reflected"].value == pytest.approx(12.0, abs=1e-6)
    assert shown["determinants"].prod() == pytest.approx(-1.0, abs=1e-6)
    assert shown["mirrored_answer"].cost == pytest.approx(16.0, rel=1e-9)
    assert shown["mirrored_answer"].verdict.value == "BOUNDED"
    # The lesson's own graph is not of that kind.
    tight = shown["program"].solve(shown["noisy"](20)).relaxation
    assert abs(np.linalg.det(tight.rows).sum()) == pytest.approx(10.0, abs=1e-4)

"""Rotational terms that are the Mahalanobis distances of a file's information."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo import io, solve
from certpgo.errors import InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.mahalanobis import mahalanobis
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from tests.strategies import rng_of

SQUARE = "EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 {0}\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 {0}\n"


@pytest.mark.parametrize(
    ("name", "options", "cost"),
    [
        ("sphere2500", {}, 1351.215697),
        ("smallGrid3D", {}, 1025.398056),
        ("parking-garage", {}, 1.2683844),  # lowered on 750 edges
        # g2o's own: rotational information is isotropic here, and residuals are small.
        ("sphere2500", {"rotation_information": "quaternion"}, 727.1496672),
    ],
)
def test_the_files_rotational_information(name, options, cost, dataset):
    instance = dataset(name, mahalanobis=True, **options)
    answer = solve(instance)
    assert answer.certificate.verdict.value == "CERTIFIED"
    assert answer.certificate.cost_upper == pytest.approx(cost, rel=5e-7)


def one_edge(omega, R):
    """A graph of one edge whose information has the rotational part omega, and a point on it."""
    d = len(R)
    rotation = RotationGraph(2, np.array([[0, 1]]), np.eye(d)[None], np.ones(1))
    graph = PoseGraph(rotation, np.zeros((1, d)), np.ones(1))
    whole = np.eye(d + len(omega))
    whole[d:, d:] = omega
    point = Estimate(np.stack([np.eye(d), R]), np.zeros((2, d)))
    return mahalanobis(graph, Information(whole[None], np.zeros(1, dtype=int))), point


@given(st.integers(0, 10**6), st.floats(0.0, 8.0))
def test_terms_are_mahalanobis_distances_or_below(seed, decades):
    rng = rng_of(seed)
    U = so.exp(rng.normal(size=(1, 3)))[0]
    values = 10.0 ** rng.uniform(-decades, 0.0, 3)
    omega = U @ np.diag(values) @ U.T
    omega = 0.5 * (omega + omega.T)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(0.0, np.pi)
    weighted, point = one_edge(omega, so.exp(angle * axis[None])[0])
    exact = 4.0 * np.sin(angle / 2.0) ** 2 * (axis @ omega @ axis)
    cost = Quadratic(weighted.graph).cost(point)
    assert cost <= exact + 1e-14 * values.max()
    values.sort()
    slack = (values[0] + values[1] - values[2]) / values[1]
    assert weighted.clipped == (slack < 0.0) or 0.0 <= slack < 1e-5
    if not weighted.clipped:
        assert cost == pytest.approx(exact, rel=1e-9, abs=1e-14 * values.max())


def test_lowered_weights_keep_the_other_axes():
    omega = np.diag([1.0, 2.0, 5.0])
    for k, kept in ((0, 1.0), (1, 2.0), (2, 3.0)):
        axis = np.eye(3)[k]
        weighted, point = one_edge(omega, so.exp(0.3 * axis[None])[0])
        assert weighted.clipped == 1
        expected = 4.0 * np.sin(0.15) ** 2 * kept
        assert Quadratic(weighted.graph).cost(point) == pytest.approx(expected, rel=1e-5)


def test_the_plane_has_half_of_kappa(file):
    path = file(SQUARE.format(7))
    half, whole = io.read(path, mahalanobis=True), io.read(path)
    assert half.graph.kappa.tolist() == [3.5, 3.5]
    assert half.graph.tau.tolist() == whole.graph.tau.tolist()
    assert half.options["weights"] == "mahalanobis"
    assert half.graph.information is None
    assert not half.graph.is_general


SPACE = """PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 2 0 0 3 0 4
EDGE_SE3_TRACKXYZ 0 2 0 0 1 1 1 0 0 1 0 1
EDGE_SE3_TRACKXYZ 1 2 0 -1 1 1 1 0 0 1 0 1
EDGE_SE3_PRIOR 0 0 0 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 2 0 0 3 0 4
EDGE_SE3_XYZPRIOR 1 0 1 0 0.5 1 0 0 1 0 1
"""


def test_positions_in_space_keep_their_weights(file):
    """Sightings and GPS have no rotational information to weigh."""
    instance = io.read(file(SPACE), mahalanobis=True, quiet=True)
    kappa = instance.graph.kappa
    assert kappa.tolist() == pytest.approx([1.5, 0.0, 0.0, 1.5, 0.0])
    assert instance.graph.tau.tolist() == [1.0] * 5
    answer = solve(instance)
    assert answer.verdict.value == "CERTIFIED"
    # Half a metre in height that rotations spread: below 0.5^2 for the last line alone.
    assert 0.0 < answer.cost < 0.25


def test_what_has_no_rotational_information_is_refused(file, tmp_path):
    bare = file("EDGE_SE2 0 1 1 0 0.1\nEDGE_SE2 0 1 1 0 0\n")
    with pytest.raises(InputError, match="need poses with rotational information"):
        io.read(bare, mahalanobis=True, quiet=True)
    path = tmp_path / "helix.npz"
    io.write(path, helix(3, rng_of(0)))
    with pytest.raises(InputError, match=r"helix\.npz: Mahalanobis weights"):
        io.read(path, mahalanobis=True, quiet=True)


@pytest.mark.parametrize("other", [{"kappa": 1.0}, {"tau": 2.0}, {"unit_weights": True}])
def test_one_choice_of_weights(other, file):
    with pytest.raises(InputError, match="Mahalanobis weights exclude"):
        io.read(file(SQUARE.format(7)), mahalanobis=True, **other)

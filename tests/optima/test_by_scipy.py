"""Costs of the register, recomputed without the package's code."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certpgo.optima import Register
from reports.studies import optima_by_scipy as study

REGISTER = Register()
#: Ten of F, and of g2o's cost where it exists.
SAMPLE = (
    "Klaus3",
    "MIT",
    "inputGrid3D-noOutliers",
    "kitti_07",
    "noisyToyGraph",
    "pose2example",
    "pose3example",
    "pose3example-grid",
    "ring",
    "smallGrid3D",
    "tinyGrid3D",
)


@pytest.mark.parametrize("name", SAMPLE)
def test_costs_of_kept_estimates_are_what_the_register_says(name):
    found = study.candidates(REGISTER, [name])
    if not found:
        pytest.skip(f"{name}: file not here")
    assert {entry.cost for entry, _ in found} == {"chordal", "g2o"}
    for entry, path in found:
        R, t = study.estimate_in(REGISTER.proof(entry))
        cost = (study.RESIDUALS[entry.cost](study.read_g2o(path), R, t) ** 2).sum()
        assert cost == pytest.approx(entry.upper, rel=1e-9)
        assert cost >= entry.lower * (1.0 - 1e-9)


@pytest.mark.parametrize("name", ["noisyToyGraph", "pose2example", "tinyGrid3D"])
def test_least_squares_finds_nothing_better(name):
    for entry, path in study.candidates(REGISTER, [name]):
        if entry.cost == "chordal":
            R, t = study.estimate_in(REGISTER.proof(entry))
            least = study.minimised(study.read_g2o(path), "chordal", R, t)
            assert entry.lower * (1.0 - 1e-9) <= least <= entry.upper * (1.0 + 1e-6)


def test_a_cost_in_closed_form(tmp_path):
    path = tmp_path / "two.g2o"
    path.write_text(
        "EDGE_SE3:QUAT 3 7 1 2 3 0 0 0 1 " + "4 0 0 0 0 0 4 0 0 0 0 4 0 0 0 9 0 0 9 0 9\n"
    )
    edges = study.read_g2o(path)
    turn = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()
    R, t = np.array([np.eye(3), turn]), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 4.0]])
    # tau 4, kappa 9 / 2, |turn - I|^2 = 8 sin^2 0.1; the vector part is sin 0.1.
    assert (study.chordal(edges, R, t) ** 2).sum() == pytest.approx(4.0 + 36.0 * np.sin(0.1) ** 2)
    assert (study.g2o(edges, R, t) ** 2).sum() == pytest.approx(4.0 + 9.0 * np.sin(0.1) ** 2)

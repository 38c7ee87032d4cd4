"""What `reports.studies.scale_drift` begins with: keyframes, odometry, and GTSAM's FastSync."""

import numpy as np
import pytest

from certpgo import Estimate
from certpgo.io.datasets.monocular import drifting, keyframes, odometry, random_maps
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from reports.studies import scale_drift


def test_without_drift_or_noise_odometry_along_keyframes_is_the_truth():
    angles = 0.3 * np.arange(9)
    plane = Estimate(so.exp(angles[:, None]), np.stack([np.sin(angles), np.cos(angles)], axis=1))
    edges = np.array([[0, 1], [1, 2], [8, 0], [4, 0], [5, 1], [3, 2]])
    truth, loops = keyframes(plane, edges, 2)
    assert loops.tolist() == [[0, 2], [0, 4]]  # (4, 0) and (5, 1) are the same
    assert truth.translations[:, :2].tolist() == plane.translations[::2].tolist()
    rng, none = np.random.default_rng(0), 1e-12
    graph, _ = drifting(truth, loops, rng, walk=none, turn=none, move=none, matched=none)
    found = odometry(graph)
    assert found.scales.tolist() == [1.0] * 5
    assert scale_drift.error(found, truth) < 1e-10


@pytest.mark.parametrize("unit", [1.0, 100.0])
def test_fastsync_finds_the_map_of_measurements_without_noise(unit):
    """So a map that is off is not one of other conventions."""
    pytest.importorskip("gtsam")
    graph, truth = random_maps(np.random.default_rng(0), turn=0.0, scale=0.0, move=0.0)
    problem = Quadratic(graph.with_unknown_scales(np.ones(8, dtype=bool)))
    found = scale_drift.fast_sync(problem.graph, unit)
    assert problem.cost(found) < 1e-12
    assert found.scales == pytest.approx(truth.scales / truth.scales[0] * found.scales[0])

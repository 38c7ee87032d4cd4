"""Public reports of wrong maps, rebuilt in `tests/data/reports`: what is named, and at what costs.

The head of each file names the report. Figures are those of the guide's table.
"""

from pathlib import Path

import pytest

import certpgo
from certpgo.diagnosis import KnownTruth
from certpgo.io.estimates import true_poses
from certpgo.io.matching import Matching
from certpgo.io.timestamps import timed

DATA = Path(__file__).parents[1] / "data" / "reports"


def diagnosed(graph, estimate=None):
    given = None if estimate is None else DATA / estimate
    return certpgo.diagnose(certpgo.read(DATA / graph, quiet=True), given)


@pytest.mark.parametrize(
    ("files", "kind", "cost", "as_given"),
    [
        # Open3D 137: each node is the last registration
        (("uncomposed.g2o", "uncomposed_nodes.g2o"), "relative-poses", 467.959, 2044759.23),
        # Open3D 3254: all nodes are the identity, and half of them are turned by 180 degrees
        (("half_turn.g2o", "half_turn_nodes.g2o"), "no-initialization", 47.7427, 4797680.83),
        # COLMAP 2313: images.txt with its columns in another order
        (("colmap.g2o", "colmap.tum"), "inverse-poses", 148.406, 1133140.36),
        # python-graphslam 95: closures map the source to the target
        (("loops_from_target.g2o",), "inverted-closures", 0.0305845, 108.526),
        # GTSAM 704: the derivative of positions lacks the rotation
        (("wrong_jacobian.g2o", "wrong_jacobian_result.g2o"), "stopped-early", 3.68336e-5, 21.5559),
        # lidar_graph_slam 17: odometry of 5 cm, stated as 1 mm; chi^2 and its degrees of freedom
        (("stiff_odometry.g2o",), "noise-too-small", 69.4839, 36228.4),
    ],
)
def test_the_cause_of_a_report_is_named_first(files, kind, cost, as_given):
    first = diagnosed(*files).findings[0]
    assert first.kind == kind
    assert first.cost == pytest.approx(cost, rel=1e-4)
    assert first.cost_as_given == pytest.approx(as_given, rel=1e-4)


def test_square_roots_explain_what_noise_explains_as_well():
    """g2o 47: 44.7 is stated where 2000 is meant."""
    [either] = diagnosed("square_roots.g2o").findings
    assert either.kind == "square-root"
    assert "its information by 55.9" in either.next  # 44.7 is within its interval
    assert either.said.endswith("residuals do not tell which")
    assert (either.cost, either.cost_as_given) == pytest.approx((95.9706, 2.14597), rel=1e-4)


def test_nine_equations_for_twelve_unknowns():
    """GTSAM 1179: one relative pose and one position leave a rotation free."""
    [found] = diagnosed("nine_equations.g2o").findings
    assert found.kind == "undetermined"
    assert "no measurement determines the rotation of the world" in found.said


def test_no_information_is_refused_where_it_stands():
    """g2opy 79: chi^2 is zero, and nothing moves."""
    with pytest.raises(certpgo.InputError, match="g2o:6: the information is zero"):
        diagnosed("no_information.g2o")


def test_a_threshold_of_one_sigma_is_no_mistake_of_the_graph():
    """rtabmap_ros 280: chi^2 is as usual, and the costs are said."""
    found = diagnosed("one_sigma.g2o")
    assert not found.findings
    assert found.costs.is_optimal
    assert found.costs.best == pytest.approx(7.21799, rel=1e-5)
    assert "explains anything here: the optimum costs 7.217988" in found.headline


def test_clocks_that_begin_at_zero_each():
    """evo 346: the estimate begins 3 s after the truth."""
    instance = timed(certpgo.read(DATA / "own_zero.g2o", quiet=True), DATA / "own_zero_times.tum")
    poses = true_poses(DATA / "own_zero_truth.txt")
    truth = KnownTruth.of(poses, instance, Matching())
    [found] = certpgo.diagnose(instance, truth=truth).findings
    assert found.kind == "shifted-times"
    assert found.next == "add --truth-offset -3.045"
    assert (found.cost, found.cost_as_given) == pytest.approx((0.0312534, 0.623), rel=1e-3)


def test_intel_from_its_own_nodes(dataset_path):
    """GTSAM 846: Gauss and Newton stop at once, the solution of others is garbage."""
    path = dataset_path("input_INTEL_g2o")
    [found] = certpgo.diagnose(path, path).findings
    assert found.kind == "wrong-basin"
    assert (found.cost, found.cost_as_given) == pytest.approx((215.830234947, 5149721.04), rel=1e-5)

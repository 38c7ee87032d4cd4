"""g2o files of other programs: tags of rtabmap and Vertigo, and tags that are left out."""

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, io
from certpgo.io.dialect import pose_texts
from certpgo.linalg import rotations as so

INFORMATION = "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400"
STEP = f"{{}} {{}} {{}} 0 0 0 0 0 1 {INFORMATION}\n"
POSES = "EDGE_SE3:QUAT " + STEP.format(1, 2, 1) + "EDGE_SE3:QUAT " + STEP.format(2, 3, 1)


def test_gps_of_rtabmap(file):
    """The optimum is scipy's, of the same file with EDGE_SE3_XYZPRIOR and a sensor."""
    turn = f"EDGE_SE3:QUAT 3 4 0 1 0 0 0 0 1 {INFORMATION}\n"
    fixes = "1 0.1 0 0", "3 2.2 0.1 0", "4 2.1 1.1 0"
    lines = [f"EDGE_POINTXYZ_PRIOR {fix} 1 0 0 1 0 1\n" for fix in fixes]
    answer = certpgo.solve(io.read(file(POSES + turn + "".join(lines)), quiet=True))
    assert answer.cost == pytest.approx(0.005195833242, abs=1e-12)
    assert answer.verdict.value == "CERTIFIED"


def test_switchable_loop_closures_are_loop_closures(file):
    switch = "VERTEX_SWITCH 4 1\nEDGE_SWITCH_PRIOR 4 1 1.0\n"
    for tag in ("EDGE_SE3_SWITCHABLE", "EDGE_SE3:QUAT_SWITCHABLE"):
        loop = f"{tag} " + STEP.format("1 3", 4, 2.1)
        instance = io.read(file(POSES + switch + loop), quiet=True)
        assert instance.ids.tolist() == [1, 2, 3]
        assert instance.graph.edges.tolist() == [[0, 1], [1, 2], [0, 2]]
        assert certpgo.solve(instance).cost == pytest.approx(1 / 3, rel=1e-9)
        assert any("1 loop closure with a switch" in said for said in instance.notices)
        assert any("--robust" in said for said in instance.notices)
    plane = "EDGE_SE2 1 2 1 0 0 4 0 0 4 0 9\nEDGE_SE2_SWITCHABLE 1 2 7 1 0 0.5 4 0 0 4 0 9\n"
    assert io.read(file(plane), quiet=True).graph.edges.tolist() == [[0, 1], [0, 1]]
    with pytest.raises(FormatError, match="takes 3 ids and 3 numbers"):
        io.read(file(plane.replace("1 2 7", "1 2")))


def test_lines_that_are_left_out_are_named(file):
    path = file(POSES + "EDGE_SE3_PLANE 1 9 0 0 1 0\n" * 2)
    with pytest.raises(FormatError, match="--skip EDGE_SE3_PLANE leaves such lines out"):
        io.read(path)
    instance = io.read(path, skip=["EDGE_SE3_PLANE"], quiet=True)
    assert instance.graph.num_edges == 2
    assert instance.options["skip"] == "EDGE_SE3_PLANE"
    assert instance.notices[0].startswith("2 EDGE_SE3_PLANE lines skipped: left out as chosen")


def test_decimal_commas_are_named(file):
    with pytest.raises(FormatError, match=r":1: .*'0,5' \(a decimal comma"):
        io.read(file("EDGE_SE2 1 2 0,5 0 0\n"))


def test_poses_of_cameras(file):
    """What g2o writes for world-to-camera poses T_i is T_i^-1, and T_i T_j^-1 between two."""
    rng = np.random.default_rng(0)
    T = so.random(rng, 3, 3), rng.standard_normal((3, 3))
    X = np.swapaxes(T[0], 1, 2), -(np.swapaxes(T[0], 1, 2) @ T[1][:, :, None])[:, :, 0]
    # Rotation before translation.
    weights = "400 0 0 0 0 0 400 0 0 0 0 400 0 0 0 100 0 0 100 0 100"
    poses = pose_texts(*X)
    text = "".join(f"VERTEX_SE3:EXPMAP {k} {pose} 1 1 0 0 0.5 \n" for k, pose in enumerate(poses))
    for i, j in ((0, 1), (1, 2), (0, 2)):
        turn = T[0][i] @ X[0][j]
        (measured,) = pose_texts(turn[None], (T[0][i] @ X[1][j] + T[1][i])[None])
        text += f"EDGE_SE3:EXPMAP {i} {j} {measured} {weights}\n"
    instance = io.read(file(text), quiet=True)
    assert instance.graph.kappa.tolist() == [200.0] * 3
    assert instance.graph.tau.tolist() == [100.0] * 3
    assert instance.graph.information is None
    np.testing.assert_allclose(instance.initial.translations, X[1], atol=1e-15)
    problem = certpgo.Quadratic(instance.graph)
    assert problem.cost(instance.initial) == pytest.approx(0.0, abs=1e-25)
    short = text.replace(weights, "1 2 3")
    with pytest.raises(FormatError, match="takes 2 ids and 7 numbers, then 21"):
        io.read(file(short))

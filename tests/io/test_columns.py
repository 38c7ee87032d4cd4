"""Trajectories with named columns, and of Ceres."""

from contextlib import suppress

import numpy as np
import pytest

from certpgo import FormatError, io
from certpgo.linalg import rotations as so

EUROC = """\
#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v
1403636580838555648,0.0,0.0,0.0,1,0,0,0,0.1
1403636580843555328,1.0333,0.5,0.0,0.9238795325112867,0.3826834323650898,0,0,0.1
"""
EIGHTH = np.radians([45.0, 0, 0])  # about x
TIMES = [1403636580838555648, 1403636580843555328]


def columns(text, count, separator=","):
    """The first columns of a text, with another separator."""
    rows = [line.split(",")[:count] for line in text.splitlines()]
    return "".join(separator.join(row) + "\n" for row in rows)


@pytest.mark.parametrize(
    "text",
    [
        EUROC,
        columns(EUROC, 8),  # TUM-VI
        columns(EUROC, 8, "  "),  # whose header alone says that w comes first
        "\n".join(EUROC.splitlines()[1:]),
        EUROC.replace("\n", "\r\n"),
    ],
)
def test_w_comes_first_and_nanoseconds_stay(file, text):
    estimate = io.read_estimate(file(text, "data.txt"))
    assert estimate.keys.times_ns.tolist() == TIMES
    np.testing.assert_allclose(so.log(estimate.rotations), [np.zeros(3), EIGHTH], atol=1e-12)
    np.testing.assert_array_equal(estimate.translations[1], [1.0333, 0.5, 0])


def test_ids_beside_times(file):
    rtabmap = "#timestamp x y z qx qy qz qw id\n10.5 0 0 0 0 0 0 1 7\n10.6 1 0 0 0 0 1 0 3\n"
    mcd = "num,t,x,y,z,qx,qy,qz,qw\n7,10.5,0,0,0,0,0,0,1\n3,10.6,1,0,0,0,0,1,0\n"
    for text in (rtabmap, mcd):
        estimate = io.read_estimate(file(text, "poses.txt"))
        assert estimate.keys.ids.tolist() == [3, 7]
        assert estimate.keys.times_ns.tolist() == [10_600_000_000, 10_500_000_000]
        np.testing.assert_allclose(estimate.rotations[0], np.diag([-1.0, -1, 1]), atol=1e-15)


def test_planar_poses_of_ceres(file):
    text = "0 0 0 0\n4 1.5 -2 1.5707963267948966\n"
    estimate = io.read_estimate(file(text, "poses_optimized.txt"))
    assert estimate.keys.ids.tolist() == [0, 4]
    np.testing.assert_allclose(estimate.rotations[1], [[0, -1], [1, 0]], atol=1e-15)
    np.testing.assert_array_equal(estimate.translations[1], [1.5, -2])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 0 0 0 0 0 0 1\n2 NaN NaN NaN NaN NaN NaN NaN\n", r":2: .*\(NaN\) has no line"),
        ("1 0 0 0 0 0 0 1\n2 1,5 0 0 0 0 0 1\n", r":2: .*a decimal comma"),
        ("1 0 0 0 0 0 0 1\n2,1,0,0,0,0,0,1\n", r":2: .*separated by commas"),
        ("1,2,3,4,5\n", "5 columns separated by commas: a trajectory has timestamp"),
        (EUROC + "1,2,3\n", r":4: 9 columns, t, x, .*; 3 found"),
        (EUROC + "1,nan,0,0,1,0,0,0,0\n", r":4: .*NaN"),
        (EUROC + "1,0,0,0,0,0,0,0,0\n", r":4: .*must not be zero"),
        (EUROC + "x,0,0,0,1,0,0,0,0\n", r":4: timestamps in seconds"),
        ("num,t,x,y,z,qx,qy,qz,qw\n1,1,0,0,0,0,0,0,1\n1,2,0,0,0,0,0,0,1\n", ":3: node 1 appears"),
        ("num,x,y,z,qx,qy,qz,qw\n1.5,0,0,0,0,0,0,1\n", "whole numbers expected as ids"),
        (EUROC.splitlines()[0] + "\n", "no rows of"),
        ("0 0 0 0\n0 1 0 0\n", ":2: node 0 appears twice"),
    ],
)
def test_what_cannot_be_read_is_named(file, text, said):
    with pytest.raises(FormatError, match=said):
        io.read_estimate(file(text, "poses.txt"))


@pytest.mark.parametrize(
    ("name", "said"), [("map.pbstream", "Cartographer"), ("map.posegraph", "slam_toolbox")]
)
def test_containers_name_their_program(tmp_path, name, said):
    (tmp_path / name).write_bytes(b"\x16\0\0\0archive")
    with pytest.raises(FormatError, match=rf"{said}.*as g2o, or its trajectory as TUM"):
        io.read(tmp_path / name)


def test_damaged_files_are_refused_or_read(file):
    """Any byte may be another: one line or an answer."""
    rng = np.random.default_rng(3)
    for text in (EUROC, "#timestamp x y z qx qy qz qw id\n10.5 0 0 0 0 0 0 1 7\n"):
        for _ in range(150):
            damaged = bytearray(text.encode())
            for place in rng.integers(0, len(damaged), 2):
                damaged[place] = rng.choice(list(b"09,.-# nae\n\0\xff"))
            path = file("", "damaged.csv")
            path.write_bytes(bytes(damaged))
            with suppress(FormatError):
                io.read_estimate(path)

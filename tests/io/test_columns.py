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


#: Of a pose turned by 45 degrees about x, at (1, 2, 3).
Q, P = "0.3826834323650898,0,0,0.9238795325112867", "1,2,3"


@pytest.mark.parametrize(
    ("header", "row", "time", "node"),
    [
        ("ns,pose_index,qx,qy,qz,qw,tx,ty,tz", f"1665777891914299904,7,{Q},{P}", 1914299904, 7),
        ("pose_index,qx,qy,qz,qw,tx,ty,tz", f"7,{Q},{P}", None, 7),
        ("#sec,nsec,x,y,z,qx,qy,qz,qw", f"1665777891,914299904,{P},{Q}", 1914299904, None),
        ("nsec,sec,x,y,z,qx,qy,qz,qw", f"914299904,1665777891,{P},{Q}", 1914299904, None),
        ("timestamp_ns x y z qx qy qz qw", f"1665777891914299904,{P},{Q}", 1914299904, None),
        ("timestamp [ms],x,y,z,qx,qy,qz,qw", f"1665777891914.25,{P},{Q}", 1914250000, None),
        ("timestamp_us,x,y,z,qx,qy,qz,qw", f"1665777891914250,{P},{Q}", 1914250000, None),
        ("timestamp [s],x,y,z,qx,qy,qz,qw", f"1665777891.914299904,{P},{Q}", 1914299904, None),
        (
            "time,pose.position.x,pose.position.y,pose.position.z,pose.orientation.x,"
            "pose.orientation.y,pose.orientation.z,pose.orientation.w,pose_max",
            f"1665777891.914299904,{P},{Q},5",
            1914299904,
            None,
        ),
        ("t,p_x,p_y,p_z,q_x,q_y,q_z,q_w,t_max,prefix_x", f"1665777891.5,{P},{Q},8,9", 15e8, None),
    ],
)
def test_columns_are_known_by_their_whole_names(file, header, row, time, node):
    separator = "," if "," in header else " "
    text = f"{header}\n{row.replace(',', separator)}\n"
    estimate = io.read_estimate(file(text, "poses.txt"))
    keys = estimate.keys
    start = 1665777890 * 10**9
    assert (None if time is None else start + int(time)) == (keys.times_ns and keys.times_ns[0])
    assert node is None or keys.ids.tolist() == [node]
    np.testing.assert_array_equal(estimate.translations, [[1, 2, 3]])
    np.testing.assert_allclose(so.log(estimate.rotations)[0], EIGHTH, atol=1e-12)


def test_small_nanoseconds_are_not_seconds(file):
    text = f"timestamp [ns],x,y,z,qx,qy,qz,qw\n0,{P},{Q}\n50000000,{P},{Q}\n"
    estimate = io.read_estimate(file(text, "data.csv"))
    assert estimate.keys.times_ns.tolist() == [0, 50_000_000]
    assert estimate.keys.ids.tolist() == [0, 50_000_000]


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("t,x,y,z,qx,qy,qz,qw,tx", "two columns are x: which is meant is not known"),
        ("time,x,y,z,qx,qy,qz,qw,stamp", "two columns are times"),
        ("time,x,y,z,qx,qy,qz,qw,ns", "two columns are times"),
        ("index,x,y,z,qx,qy,qz,qw,id", "two columns are ids"),
        ("t,a,b,c,d,e,f,g,h", "9 columns separated by commas"),
        ("sec,x,y,z,qx,qy,qz,qw,nsec", ":2: whole seconds, and nanoseconds below a second"),
    ],
)
def test_columns_that_are_not_certain_are_refused(file, header, said):
    row = "1.5,1,2,3,0,0,0,1,7\n"
    with pytest.raises(FormatError, match=said):
        io.read_estimate(file(f"{header}\n{row}", "poses.txt"))
    if "9 columns" in said:
        return  # no header at all is EuRoC's order
    with pytest.raises(FormatError, match=said):
        io.read_estimate(file(f"# {header}\n{row}", "poses.txt"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("5 0 0 0 1 9 1 0\n7 0.6 0 0 0.8 9 1 0\n", ":1: a unit .* 5 to 8, not one of norm 9.11"),
        ("5 0 0 0 1 9 1 0\n", "columns 2 to 5 are one, as in qx qy qz qw x y z or qw qx qy qz x y"),
        ("5,0,0,0,1,9,1,0\n", "columns 2 to 5 are one, as in qx qy qz qw x y z or qw qx qy qz x y"),
        ("1 9 1 0 0 0 0 1\n2 9 1 0 0 0 0 3\n", ":2: a unit quaternion .* not one of norm 3$"),
        (
            "t,qx,qy,qz,qw,x,y,z\n1,4,5,6,0,0,0,1\n",
            ":2: .* columns 2 to 5.*; columns 5 to 8 are one, as in x y z qx qy qz qw or x y z qw",
        ),
    ],
)
def test_a_quaternion_far_from_norm_1_is_other_columns(file, text, said):
    with pytest.raises(FormatError, match=said):
        io.read_estimate(file(text, "poses.txt"))


def test_rounded_quaternions_are_read(file):
    estimate = io.read_estimate(file("1 0 0 0 0.7 0 0 0.7\n", "e.tum"))
    np.testing.assert_allclose(so.log(estimate.rotations)[0], [np.pi / 2, 0, 0], atol=1e-12)


def matrices():
    """Poses of a walk that turns, (4, 4, 4)."""
    M = np.tile(np.eye(4), (4, 1, 1))
    M[:, :3, :3] = so.exp(np.arange(4.0)[:, None] * np.array([[0.1, -0.2, 0.3]]))
    M[:, :3, 3] = np.arange(4.0)[:, None] * np.array([1.0, 0.5, 0.1])
    return M


def numbers(*columns):
    """Rows of numbers separated by commas."""
    rows = zip(*(column.reshape(len(column), -1).tolist() for column in columns), strict=True)
    return "".join(",".join(repr(x) for part in row for x in part) + "\n" for row in rows)


def test_matrices_of_mulran_with_times(file):
    M, times = matrices(), 1403636580838555648 + 10**8 * np.arange(4)
    found = io.read_estimate(file(numbers(times, M[:, :3]), "global_pose.csv"))
    assert found.keys.times_ns.tolist() == times.tolist()
    np.testing.assert_allclose(found.rotations, M[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(found.translations, M[:, :3, 3], atol=1e-12)


def test_a_comma_at_the_end_of_rows_of_vins(file):
    rows = EUROC.splitlines()[1:]
    text = "".join(f"{row},0.2,0.3,\n" for row in rows)
    found = io.read_estimate(file(text, "vins_result_loop.csv"))
    assert found.keys.times_ns.tolist() == TIMES
    np.testing.assert_allclose(so.log(found.rotations)[1], EIGHTH, atol=1e-12)


def test_names_of_maplab(file):
    names = "timestamp [ns], position x [m], position y [m], position z [m]"
    names += ", quaternion x, quaternion y, quaternion z, quaternion w\n"
    text = f"{names}{TIMES[0]}, 1, 2, 3, 0, 0, 0, 1\n{TIMES[1]}, 2, 2, 3, 0, 0, 1, 0\n"
    found = io.read_estimate(file(text, "vertex_poses.csv"))
    assert found.keys.times_ns.tolist() == TIMES
    assert found.translations.tolist() == [[1.0, 2.0, 3.0], [2.0, 2.0, 3.0]]
    np.testing.assert_allclose(found.rotations[1], np.diag([-1.0, -1.0, 1.0]), atol=1e-15)


def test_sixteen_numbers_and_arrays(file, tmp_path):
    M = matrices()
    text = "".join(" ".join(map(repr, row)) + "\n" for row in M.reshape(4, 16).tolist())
    found = [io.read_estimate(file(text, "poses.txt"))]
    for name, array in (("a.npy", M), ("b.npy", M[:, :3])):
        np.save(tmp_path / name, array)
        found.append(io.read_estimate(tmp_path / name))
    for estimate in found:
        np.testing.assert_allclose(estimate.rotations, M[:, :3, :3], atol=1e-12)
        np.testing.assert_array_equal(estimate.translations, M[:, :3, 3])
    for name, wrong in (("c.npy", M[0]), ("d.npy", M.astype(int)), ("e.npy", M[:, :2])):
        np.save(tmp_path / name, wrong)
        with pytest.raises(FormatError, match=r"poses \(n, 4, 4\) or \(n, 3, 4\) expected"):
            io.read_estimate(tmp_path / name)
    np.save(tmp_path / "f.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(FormatError, match="no array of numbers"):
        io.read_estimate(tmp_path / "f.npy")


@pytest.mark.parametrize(("d", "angles"), [(2, "0 0 0.1"), (3, "0.2 -0.3 0.1")])
def test_relations_between_times(file, d, angles):
    """Poses of the second time in the first; R = Rz(yaw) Ry(pitch) Rx(roll)."""
    text = f"976052857.25 976052858 1 2 0 {angles}\n976052859.5 976052858 3 4 0 {angles}\n"
    instance = io.read(file(text, "intel.relations"), quiet=True)
    assert instance.times_ns.tolist() == [976052857250000000, 976052858 * 10**9, 976052859500000000]
    assert instance.pairs.tolist() == [[0, 1], [2, 1]]
    assert instance.graph.d == d
    assert not instance.states_noise
    np.testing.assert_array_equal(instance.graph.translations[:, :2], [[1.0, 2.0], [3.0, 4.0]])
    roll, pitch, yaw = map(float, angles.split())
    expected = so.exp(np.array([[0.0, 0.0, yaw]])) @ so.exp(np.array([[0.0, pitch, 0.0]]))
    expected = (expected @ so.exp(np.array([[roll, 0.0, 0.0]])))[0, :d, :d]
    np.testing.assert_allclose(instance.graph.rotations[0], expected, atol=1e-15)
    same = f"976052858 976052858 1 2 0 {angles}\n"
    with pytest.raises(FormatError, match="measured from itself"):
        io.read(file(same, "loop.relations"))

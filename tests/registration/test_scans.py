"""Scan files: what is written is read, and each malformed file is one line."""

import numpy as np
import pytest

from certpgo.errors import FormatError, InputError
from certpgo.io.surfaces import Surface, read_surface, write_surface
from certpgo.linalg import rotations as so
from certpgo.registration.scans import Scan, read_initial, read_scan

POINTS = np.array([[0.5, -1.25, 3.0], [1.0, 2.0, -0.125], [0.0, 0.0, 4.0]])
COLOURS = np.array([[0, 127, 255], [1, 2, 3], [9, 8, 7]], np.uint8)

ASCII_PLY = """ply
format ascii 1.0
obj_info num_cols 512
element camera 1
property float view
element vertex 3
property float x
property float y
property float z
property float scalar_intensity
element range_grid 2
property list uchar int vertex_indices
end_header
7
0.5 -1.25 3 1
1 2 -0.125 1
0 0 4 1
1 0
0
"""

PCD = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS rgb x y z
SIZE 4 4 4 4
TYPE U F F F
COUNT 1 1 1 1
WIDTH 3
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 3
"""


def test_what_is_written_is_read_back(tmp_path):
    faces = np.array([[0, 1, 2]])
    for surface in (Surface(POINTS, COLOURS, faces), Surface(POINTS, COLOURS), Surface(POINTS)):
        write_surface(tmp_path / "mesh.ply", surface)
        read = read_surface(tmp_path / "mesh.ply")
        np.testing.assert_array_equal(read.points, surface.points)
        np.testing.assert_array_equal(read.faces, surface.faces)
        assert (read.colours is None) == (surface.colours is None)
        if read.colours is not None:
            np.testing.assert_array_equal(read.colours, COLOURS)


@pytest.mark.parametrize("order", ["little", "big"])
def test_both_byte_orders_are_read(tmp_path, order):
    header = ASCII_PLY.replace("ascii", f"binary_{order}_endian").partition("end_header\n")
    table = np.hstack([POINTS, np.ones((3, 1))]).astype("<f4" if order == "little" else ">f4")
    path = tmp_path / "scan.ply"
    path.write_bytes("".join(header[:2]).encode() + b"\0\0\0\0" + table.tobytes() + b"\0\0")
    np.testing.assert_array_equal(read_scan(path).points, POINTS)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.ply", ASCII_PLY),
        ("a.ply", ASCII_PLY.replace("\n", "\r\n")),
        ("a.pcd", PCD + "DATA ascii\n0 0.5 -1.25 3\n0 1 2 -0.125\n0 0 0 4\n"),
        ("a.xyz", "# x y z\n0.5 -1.25 3 9 9\n\n1 2 -0.125 9 9\n0 0 4 9 9\nnan nan nan 0 0\n"),
    ],
)
def test_text_files_are_read(tmp_path, name, text):
    path = tmp_path / name
    path.write_bytes(text.encode())
    scan = read_scan(path)
    assert scan.name == name
    np.testing.assert_array_equal(scan.points, POINTS)


def test_a_binary_pcd_is_read(tmp_path):
    table = np.zeros(3, [("rgb", "<u4"), ("p", "<f4", 3)])
    table["p"] = POINTS
    path = tmp_path / "a.pcd"
    path.write_bytes((PCD + "DATA binary\n").encode() + table.tobytes())
    np.testing.assert_array_equal(read_scan(path).points, POINTS)


MALFORMED = [
    (ASCII_PLY.replace("1 2 -0.125", "1 two -0.125"), None, "a complete PLY file expected"),
    (ASCII_PLY.replace("1 2 -0.125 1", "1 2"), None, "a complete PLY file expected"),
    (ASCII_PLY.partition("0 0 4")[0], None, "3 vertices announced, 2 found"),
    (ASCII_PLY.replace("float y", "float w"), None, "x, y and z"),
    (
        ASCII_PLY.replace("element vertex 3", "element vertex x"),
        None,
        "element vertex and end_header",
    ),
    (ASCII_PLY.partition("end_header")[0], None, "element vertex and end_header"),
    (ASCII_PLY.replace("vertex", "point"), None, "element vertex and end_header"),
    (PCD + "DATA binary_compressed\n", 11, "DATA ascii or binary expected"),
    (PCD + "DATA binary\n1234", None, "3 points announced, 0 found"),
    (PCD + "DATA ascii\n0 1 2 x\n", 12, "rgb x y z expected"),
    (PCD.replace("FIELDS rgb x", "FIELDS rgb a") + "DATA ascii\n", 11, "FIELDS with x y z"),
    (PCD, None, "no DATA"),
    ("1 2 3\n\n1 2 x\n", 3, "3 numbers expected, x y z first, as on line 1$"),
    ("a 2 3\n1 2 3\n", 1, "3 numbers expected, x y z first$"),
    ("# empty\n", None, "no points"),
    ("1 2\n", 1, "x y z expected"),
    ("nan nan nan\n", None, "no points"),
]


@pytest.mark.parametrize(("text", "line", "message"), MALFORMED)
def test_malformed_files_are_one_line(tmp_path, text, line, message):
    path = tmp_path / "scan"
    path.write_bytes(text.encode())
    with pytest.raises(FormatError, match=message) as caught:
        read_scan(path)
    assert caught.value.line == line
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.ply: cannot be read"):
        read_scan(tmp_path / "nowhere.ply")
    with pytest.raises(InputError, match="finite"):
        Scan("made", np.full((3, 3), np.inf))


def test_stanfords_quaternions_are_of_the_inverse(tmp_path):
    path = tmp_path / "a.conf"
    path.write_text(
        "camera 0 0 0 0 0 0 1\nbmesh a.ply 1 2 3 0 0 0.6 0.8\nbmesh b.ply 0 0 0 0 0 0 1\n"
    )
    estimate = read_initial(path, ["b.ply", "a.ply"])
    np.testing.assert_allclose(estimate.translations, [[0, 0, 0], [1, 2, 3]])
    turned = so.exp(np.array([0.0, 0.0, -2 * np.arcsin(0.6)]))
    np.testing.assert_allclose(estimate.rotations, [np.eye(3), turned], atol=1e-15)


def test_unusable_initial_poses_are_refused(tmp_path):
    path = tmp_path / "a.conf"
    path.write_text("bmesh a.ply 1 2 3\n")
    with pytest.raises(FormatError, match="bmesh NAME") as caught:
        read_initial(path, ["a.ply"])
    assert caught.value.line == 1
    path.write_text("bmesh a.ply 1 2 3 0 0 0 1\n")
    with pytest.raises(InputError, match=r"no line bmesh b\.ply"):
        read_initial(path, ["b.ply"])
    trajectory = tmp_path / "a.tum"
    trajectory.write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="2 poses expected"):
        read_initial(trajectory, ["a.ply", "b.ply"])


CSV = "0.5,-1.25,3,9\n1,2,-0.125,9\n0,0,4,9\n"
VTK = """# vtk DataFile Version 3.0
File created by another program
ASCII
DATASET POLYDATA
POINTS 3 float
0.5 -1.25 3
1 2 -0.125
0 0 4
VERTICES 3 6
1 0
1 1
1 2
"""
DOUBLES = VTK.replace("ASCII", "BINARY").partition("POINTS")[0].encode() + b"POINTS 3 double\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scan.csv", b"0.5 -1.25 3\n1 2 -0.125\n0 0 4\n"),
        ("scan.csv", CSV.encode()),
        ("scan.csv", b"x,y,z,intensity\r\n" + CSV.replace("\n", "\r\n").encode()),
        ("scan.csv", b'"time","z","x","y"\n' + b"1,3,0.5,-1.25\n2,-0.125,1,2\n\n3,4,0,0\n"),
        ("scan.txt", b"//X,Y,Z\n" + CSV.encode()),
        ("scan.vtk", VTK.encode()),
        ("scan.vtk", DOUBLES + POINTS.astype(">f8").tobytes() + b"\nVERTICES 0 0\n"),
        ("0000000000.bin", np.pad(POINTS, ((0, 0), (0, 1))).astype("<f4").tobytes()),
    ],
)
def test_files_of_other_programs(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    np.testing.assert_array_equal(read_scan(path).points, POINTS)


@pytest.mark.parametrize(
    ("name", "content", "line", "said"),
    [
        ("a.csv", b"a,b,c\n1,2,3\n", 1, "columns called x, y and z expected"),
        ("a.csv", b"x,y,z\n1,2,3\n1,2\n", 3, "x, y, z expected, separated by commas"),
        ("a.csv", b"x,y,z\n1,2,3\n1,2,?\n", 3, "x, y, z expected, separated by commas"),
        ("a.csv", b"x,y,z\n", None, "no points"),
        ("a.vtk", VTK.replace("POINTS 3", "POINTS 9").encode(), 5, "9 points expected after"),
        ("a.vtk", VTK.partition("0 0 4")[0].encode(), 5, "3 points announced, 2 found"),
        ("a.vtk", VTK.replace("POINTS", "CELLS").encode(), None, "POINTS n float or double"),
        ("a.vtk", DOUBLES + b"\n2345678" * 4 + b"1", 5, "3 points announced"),
        ("a.bin", b"1234" * 5, None, "20 bytes are no whole number"),
    ],
)
def test_what_is_wrong_with_them(tmp_path, name, content, line, said):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FormatError, match=said) as error:
        read_scan(path)
    assert error.value.line == line

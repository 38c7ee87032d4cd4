"""COLMAP's databases as rotation graphs: frames, names, weights, what is left out, broken files."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest

import certpgo
from certpgo.errors import FormatError, InputError, InputNotice
from certpgo.io.exact.quaternion import to_write
from certpgo.io.format import format_of
from certpgo.linalg import rotations as so

#: Multiplied with the first image of a pair.
MAX_IMAGES = 2**31 - 1
IMAGES = "CREATE TABLE images (image_id INTEGER PRIMARY KEY, name TEXT, camera_id INTEGER)"
GEOMETRIES = (
    "CREATE TABLE two_view_geometries (pair_id INTEGER PRIMARY KEY, rows INTEGER, cols INTEGER, "
    "data BLOB, config INTEGER, F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB)"
)
CALIBRATED, WATERMARK = 2, 7


def doubles(values):
    return np.asarray(values, dtype="<f8").tobytes()


def geometry(i, j, R, t=(0, 0, 1), inliers=50, config=CALIBRATED):
    """The row of a pair: what maps the camera of i to that of j."""
    q = to_write(np.asarray(R)[None])[0][[3, 0, 1, 2]]
    return MAX_IMAGES * i + j, inliers, config, doubles(q), doubles(t)


@pytest.fixture
def database(tmp_path):
    """Writes a database, and returns its path."""

    def write(names, geometries, *, images=IMAGES, table=GEOMETRIES, name="database.db"):
        path = tmp_path / name
        with closing(sqlite3.connect(path)) as made, made:
            made.execute(images)
            made.execute(table)
            made.executemany("INSERT INTO images (image_id, name) VALUES (?, ?)", names.items())
            if not geometries:
                return path
            made.executemany(
                "INSERT INTO two_view_geometries (pair_id, rows, config, qvec, tvec) "
                "VALUES (?, ?, ?, ?, ?)",
                geometries,
            )
        return path

    return write


NAMES = {1: "a.jpg", 2: "b/c.jpg", 5: "d.jpg"}


def world_to_camera(seed=0):
    """Rotations by image id."""
    return dict(zip(NAMES, so.random(np.random.default_rng(seed), 3, 3), strict=True))


def exact(cameras, inliers=(50, 60, 70)):
    pairs = ((1, 2), (1, 5), (2, 5))
    return [
        geometry(i, j, cameras[j] @ cameras[i].T, inliers=count)
        for (i, j), count in zip(pairs, inliers, strict=True)
    ]


def test_pairs_are_rotations_between_named_images_weighed_by_inliers(database):
    cameras = world_to_camera()
    path = database(NAMES, exact(cameras))
    assert format_of(path).name == "colmap-database"
    found = certpgo.read(path, quiet=True)
    assert found.ids.tolist() == [1, 2, 5]
    assert found.names == ("a.jpg", "b/c.jpg", "d.jpg")
    assert found.graph.kappa.tolist() == [50.0, 60.0, 70.0]
    assert "weights are numbers of inliers" in str(found)
    # Our rotations are from camera to world, and fit exactly.
    R = np.swapaxes(np.array(list(cameras.values())), 1, 2)
    assert certpgo.Quadratic(found.graph).cost(certpgo.Estimate(R)) < 1e-25
    assert certpgo.read(path, unit_weights=True, quiet=True).graph.kappa.tolist() == [1.0] * 3


def test_the_answer_goes_to_colmap_and_back_by_names(database, tmp_path):
    cameras = world_to_camera()
    found = certpgo.read(database(NAMES, exact(cameras)), quiet=True)
    answer = certpgo.solve(found)
    assert answer.verdict == "CERTIFIED"
    path = tmp_path / "rotations.txt"
    certpgo.write(path, answer, format="glomap")
    first = path.read_text().splitlines()[0].split()
    q = np.array(first[1:], dtype=float)[[1, 2, 3, 0]]
    assert first[0] == "a.jpg"
    # Up to the frame of the first camera: the identity, world to camera.
    assert np.abs(np.abs(q) - [0, 0, 0, 1]).max() < 1e-12
    again = certpgo.read_estimate(path, found)
    relative = np.swapaxes(again.rotations[1], 0, 1) @ again.rotations[2]
    assert np.abs(relative - cameras[2] @ cameras[5].T).max() < 1e-7


def test_what_has_no_pose_is_left_out_and_named(database):
    cameras = world_to_camera()
    names = {**NAMES, 8: "e.jpg"}
    rows = [
        *exact(cameras),
        geometry(1, 8, np.eye(3), t=(0, 0, 0)),  # what COLMAP stores where it computed none
        geometry(2, 8, cameras[1], config=WATERMARK),
        (MAX_IMAGES * 5 + 8, 20, CALIBRATED, None, None),
    ]
    found = certpgo.read(database(names, rows), quiet=True)
    assert found.graph.num_edges == 3
    assert set(found.notices) == {
        "translation directions are ignored",
        "2 pairs without a stored relative pose left out",
        "1 pair without a verified geometry left out",
        "1 image in no pair left out",
    }


def test_a_database_without_poses_says_how_to_make_them(database):
    rows = [geometry(1, 2, np.eye(3), t=(0, 0, 0))]
    with pytest.raises(FormatError, match=r"TwoViewGeometry\.compute_relative_pose 1"):
        certpgo.read(database(NAMES, rows))
    old = GEOMETRIES.replace(", qvec BLOB, tvec BLOB", "")
    path = database(NAMES, [], table=old, name="old.db")
    with pytest.raises(FormatError, match="no column qvec"):
        certpgo.read(path)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ((MAX_IMAGES + 2, 9, 2, b"short", doubles([0, 0, 1])), "images 1 and 2: qvec: 4 doubles"),
        ((MAX_IMAGES + 2, 9, 2, doubles([0] * 4), doubles([0, 0, 1])), "qvec: a quaternion expect"),
        ((MAX_IMAGES + 2, 9, 2, doubles([1, 0, 0, np.nan]), doubles([0] * 3)), "qvec: finite numb"),
        ((MAX_IMAGES + 3, 9, 2, doubles([1, 0, 0, 0]), doubles([0, 0, 1])), "images 1 and 3: ima"),
        ((MAX_IMAGES + 2, 9, 2, "text", doubles([0, 0, 1])), "qvec: 4 doubles"),
    ],
)
def test_a_malformed_pair_is_refused(database, row, expected):
    with pytest.raises(FormatError, match=expected):
        certpgo.read(database(NAMES, [row]))


def test_other_databases_are_refused(database, tmp_path):
    path = tmp_path / "notes.db"
    with closing(sqlite3.connect(path)) as made, made:
        made.execute("CREATE TABLE notes (text TEXT)")
    with pytest.raises(FormatError, match="no known format"):
        certpgo.read(path)
    with pytest.raises(FormatError, match="image_id, name in table images"):
        certpgo.read(path, format="colmap-database")
    broken = tmp_path / "broken.db"
    broken.write_bytes(b"SQLite format 3\0" + b"\0" * 100)
    with pytest.raises(FormatError, match=r"broken\.db: a database of COLMAP expected"):
        certpgo.read(broken)


def test_glomap_needs_names(tmp_path):
    estimate = certpgo.Estimate(np.eye(3)[None])
    with pytest.raises(InputError, match="have no names"):
        certpgo.write(tmp_path / "out.txt", estimate, format="glomap")


def test_it_is_what_pycolmap_writes(tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap is not installed")
    cameras = world_to_camera()
    path = tmp_path / "database.db"
    with pycolmap.Database.open(path) as made:
        model = pycolmap.CameraModelId.SIMPLE_PINHOLE
        of = made.write_camera(pycolmap.Camera.create_from_model_id(1, model, 100.0, 640, 480))
        ids = [made.write_image(pycolmap.Image(name=name, camera_id=of)) for name in NAMES.values()]
        for a, b in ((0, 1), (2, 0), (1, 2)):
            R = [list(cameras.values())[k] for k in (a, b)]
            both = pycolmap.TwoViewGeometry()
            both.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            turn = pycolmap.Rotation3d(R[1] @ R[0].T)
            both.cam2_from_cam1 = pycolmap.Rigid3d(turn, np.array([0.0, 0.6, 0.8]))
            both.inlier_matches = np.array([[k, k] for k in range(20)], dtype=np.uint32)
            made.write_two_view_geometry(ids[a], ids[b], both)
    with pytest.warns(InputNotice, match="directions are ignored"):
        found = certpgo.read(path)
    R = np.swapaxes(np.array(list(cameras.values())), 1, 2)
    assert certpgo.Quadratic(found.graph).cost(certpgo.Estimate(R)) < 1e-20
    assert found.graph.kappa.tolist() == [20.0] * 3

"""Reconstructions of OpenMVG."""

import json

import numpy as np
import pytest

from certpgo import FormatError, io

TURN = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def view(name, pose):
    return {"key": pose, "value": {"ptr_wrapper": {"data": {"filename": name, "id_pose": pose}}}}


def content(**changes):
    """Two cameras, the second a quarter turn to the left of the world, at (1, 2, 3)."""
    poses = [(4, np.eye(3).tolist(), [0, 0, 0]), (7, TURN, [1.0, 2.0, 3.0])]
    return {
        "sfm_data_version": "0.3",
        "root_path": "/images",
        "views": [view("a.jpg", 4), view("b.jpg", 7), view("c.jpg", 9)],
        "extrinsics": [{"key": key, "value": {"rotation": R, "center": C}} for key, R, C in poses],
        **changes,
    }


def test_poses_are_camera_to_world(file):
    estimate = io.read_estimate(file(json.dumps(content()), "sfm_data.json"))
    assert estimate.keys.names == ("a.jpg", "b.jpg")
    assert estimate.keys.ids.tolist() == [4, 7]
    assert estimate.rotations[1].tolist() == np.transpose(TURN).tolist()
    assert estimate.translations[1].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"extrinsics": []}, "at least one expected"),
        ({"extrinsics": [{"key": 0, "value": {"rotation": TURN}}]}, "center"),
        ({"extrinsics": [{"key": 0, "value": {"rotation": [[1]], "center": [1]}}]}, "3 x 3"),
        (
            {"extrinsics": [{"key": 0, "value": {"rotation": [[1.0] * 3] * 3, "center": [0] * 3}}]},
            "a rotation matrix",
        ),
        ({"views": 3}, "views expected"),
        ({"extrinsics": content()["extrinsics"] * 2}, "a key each"),
    ],
)
def test_what_is_no_reconstruction_is_one_line(file, changes, said):
    with pytest.raises(FormatError, match=said):
        io.read_estimate(file(json.dumps(content(**changes)), "sfm_data.json"))


def test_no_json_is_named_with_its_line(file):
    text = json.dumps(content(), indent=1).replace('"views"', "views", 1)
    with pytest.raises(FormatError, match="JSON expected") as error:
        io.read_estimate(file(text, "sfm_data.json"))
    assert error.value.line == 4

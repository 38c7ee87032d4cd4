"""COLMAP's images.txt, also written by GLOMAP: the poses of a reconstruction.

Two lines per image, the second may be empty:

    IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME
    X Y POINT3D_ID ...

The pose maps world to camera; our R_i is its transpose, and the camera's centre is -R^T t.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from certpgo.errors import FormatError
from certpgo.io.chunks import first_words, is_number, text_lines
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses

_HEADER = b"IMAGE_ID, QW, QX, QY, QZ"
_IMAGE = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
_POINTS = "X Y POINT3D_ID ... or an empty line"


def _recognises(path: Path, head: bytes) -> bool:
    if _HEADER in head:
        return True
    first = first_words(head)
    return _is_image(first) and first[0].isdigit() and first[8].isdigit()


def _is_image(words: list[bytes]) -> bool:
    """Whether these may be an image's words: nine numbers and a name that is not a number."""
    return len(words) >= 10 and not is_number(words[-1]) and all(map(is_number, words[:9]))


class Image(NamedTuple):
    """An image: where it is in its file, its id, QW QX QY QZ TX TY TZ, and its name."""

    place: int
    id: int
    pose: list[float]
    name: str


def _read_poses(path: Path) -> LabelledPoses:
    return poses_of_images(path, _parsed(path))


def poses_of_images(path: Path, images: Iterable[Image]) -> LabelledPoses:
    """The poses of images, camera to world; a FormatError for what is no pose or there twice."""
    ids: dict[int, int] = {}
    rows, names = [], []
    for place, image, pose, name in images:
        if not np.isfinite(pose).all() or not any(pose[:4]):
            raise FormatError(path, place, f"{_IMAGE} expected, the quaternion not zero")
        if not 0 <= image < 2**63:
            raise FormatError(path, place, "image ids must fit 64-bit signed integers")
        if image in ids:
            raise FormatError(path, place, f"image {image} appears twice")
        ids[image] = place
        rows.append(pose)
        names.append(name)
    if not rows:
        raise FormatError(path, None, f"no images ({_IMAGE})")
    numbers = np.array(rows)
    R = np.swapaxes(quaternion.rotations(numbers[:, [1, 2, 3, 0]]), 1, 2)
    t = -np.einsum("nab,nb->na", R, numbers[:, 4:])
    return LabelledPoses(R, t, ids=np.array(list(ids), dtype=np.intp), names=tuple(names))


def _parsed(path: Path) -> Iterator[Image]:
    for line, text in _images(path):
        words = text.split(None, 9)
        try:
            image, pose = int(words[0]), [float(word) for word in words[1:8]]
            int(words[8])
            name = words[9].strip().decode("utf-8", "replace")
        except (ValueError, IndexError):
            raise FormatError(path, line, f"{_IMAGE} expected") from None
        yield Image(line, image, pose, name)


def _images(path: Path) -> Iterator[tuple[int, bytes]]:
    """The first line of each image, with its number; the second is only checked."""
    lines = text_lines(path)
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith(b"#"):
            continue
        yield number, line
        number, points = next(lines, (number + 1, b""))
        words = points.split()
        if len(words) % 3 or (words and not (is_number(words[0]) and is_number(words[-1]))):
            raise FormatError(path, number, f"{_POINTS} expected after each image's line")


def _pose_words(words: list[bytes]) -> list[bytes]:
    return words[1:8] if _is_image(words) else []


FORMAT = Format(
    name="colmap",
    suffixes=(),
    recognises=_recognises,
    holds="a reconstruction",
    read_poses=_read_poses,
    chart=Chart("quaternion", _pose_words, world_to_camera=True),
)

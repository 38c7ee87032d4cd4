"""COLMAP's models: a folder with images.bin or images.txt, and images.bin itself.

All numbers are little-endian, as in COLMAP's scripts/python/read_write_model.py:

    number of images: uint64; of each
        IMAGE_ID uint32, QW QX QY QZ TX TY TZ doubles, CAMERA_ID uint32, NAME ending in a zero byte
        number of points: uint64; of each X Y doubles, POINT3D_ID int64

Poses are as in `certpgo.io.formats.colmap`; cameras and points are not read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from certpgo.errors import FormatError
from certpgo.io.compressed import opened, uncompressed_name
from certpgo.io.format import Format, LabelledPoses
from certpgo.io.formats.colmap import FORMAT as TEXT
from certpgo.io.formats.colmap import Image, poses_of_images

_BINARY, _TEXT = "images.bin", "images.txt"
_COUNT = struct.Struct("<Q")
_POSE = struct.Struct("<I7dI")
#: Bytes of a point in an image.
_POINT = 24


def _recognises(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return any((path / name).is_file() for name in (_BINARY, _TEXT))
    return uncompressed_name(path).name == _BINARY


def _read_poses(path: Path) -> LabelledPoses:
    if not path.is_dir():
        return poses_of_images(path, _images(path))
    if (path / _BINARY).is_file() or TEXT.read_poses is None:
        return _read_poses(path / _BINARY)
    return TEXT.read_poses(path / _TEXT)


def _images(path: Path) -> Iterator[Image]:
    """The images of a binary file, which are numbered from 1 in messages."""
    with opened(path) as file:
        data = file.read()
    try:
        (count,), at = _COUNT.unpack_from(data), _COUNT.size
        for number in range(1, count + 1):
            image, *pose, _ = _POSE.unpack_from(data, at)
            begin = at + _POSE.size
            end = data.index(b"\0", begin)
            (points,) = _COUNT.unpack_from(data, end + 1)
            at = end + 1 + _COUNT.size + _POINT * points
            if at > len(data):
                raise ValueError
            yield Image(number, image, pose, data[begin:end].decode("utf-8", "replace"))
    except (struct.error, ValueError):
        raise FormatError(path, None, "COLMAP's binary images expected; this ends early") from None
    if at != len(data):
        raise FormatError(path, None, f"{count} images of COLMAP expected, and nothing after them")


FORMAT = Format(
    name="colmap-model",
    suffixes=(),
    recognises=_recognises,
    holds="a reconstruction",
    read_poses=_read_poses,
)

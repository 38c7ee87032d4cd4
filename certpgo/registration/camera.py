"""Pinhole cameras, and the noise of depth cameras.

Camera frames are right-handed: x to the right, y down, z forward, metres. Pixel centres are at
integer coordinates. A depth image holds z, not the distance along the ray.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError, in_file
from certpgo.linalg.arrays import FloatArray

#: Standard deviation of structured light's depth: base + growth (z - nearest)^2, metres (Nguyen,
#: Izadi, Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 2012).
BASE, GROWTH, NEAREST = 0.0012, 0.0019, 0.4
#: Standard deviation of a keypoint's position, pixels.
PIXEL = 0.6
#: What a file of intrinsics may hold.
KNOWN = "fx, fy, cx, cy, a 3x3 matrix, or Open3D's JSON with intrinsic_matrix"


@dataclass(frozen=True)
class Camera:
    """A pinhole camera.

    Attributes
    ----------
    fx, fy : focal lengths, pixels; fy is negative where images are upside down (ICL-NUIM)
    cx, cy : principal point, pixels
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy)
        if not (all(map(math.isfinite, values)) and self.fx > 0.0 and self.fy != 0.0):
            raise InputError(f"a camera needs fx,fy,cx,cy with fx > 0 and fy not 0, not {values}")

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(..., 3) points at depth 1 m of pixels (..., 2), which are columns and rows."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def pixels(self, points: FloatArray) -> FloatArray:
        """(..., 2) columns and rows where points (..., 3) with z > 0 are seen."""
        over = points[..., :2] / points[..., 2:]
        return np.asarray(over * (self.fx, self.fy) + (self.cx, self.cy))

    def cloud(self, depth: NDArray[np.float32], step: int = 1) -> FloatArray:
        """(k, 3) points of a depth image (h, w), metres, 0 for none; every ``step`` pixels."""
        rows, columns = np.nonzero(depth[::step, ::step])
        pixels = np.stack([columns, rows], axis=1) * float(step)
        z = depth[::step, ::step][rows, columns].astype(np.float64)
        return np.asarray(self.rays(pixels.astype(np.float64)) * z[:, None])

    def scaled(self, factor: float) -> Camera:
        """The camera with other focal lengths."""
        return replace(self, fx=factor * self.fx, fy=factor * self.fy)

    def covariances(self, points: FloatArray) -> FloatArray:
        """(k, 3, 3) covariances of keypoints (k, 3) in the camera's frame, m^2.

        `PIXEL` across the ray, `depth_noise` along it.
        """
        z = points[:, 2]
        ray = points / z[:, None]
        outer = ray[:, :, None] * ray[:, None, :] * (depth_noise(z) ** 2)[:, None, None]
        across = np.diag([PIXEL / self.fx, PIXEL / self.fy, 0.0]) ** 2
        return np.asarray(outer + across * (z**2)[:, None, None])


def depth_noise(z: FloatArray) -> FloatArray:
    """Standard deviation of depths z, metres."""
    return BASE + GROWTH * np.maximum(z - NEAREST, 0.0) ** 2


def camera_of(text: str) -> Camera:
    """The camera of a file, or of ``"fx,fy,cx,cy"``.

    Raises
    ------
    InputError
        Neither four numbers nor a file; FormatError for a file that holds no intrinsics.

    Examples
    --------
    >>> from certpgo.registration.camera import camera_of
    >>> camera_of("525,525,319.5,239.5")
    Camera(fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    """
    words = text.split(",")
    if len(words) == 4:
        try:
            return Camera(*map(float, words))
        except ValueError:
            pass
    if not Path(text).is_file():
        raise InputError(f"{text}: a camera is fx,fy,cx,cy in pixels, or a file with {KNOWN}")
    return read_camera(Path(text))


def read_camera(path: Path) -> Camera:
    """The intrinsics in a file.

    Parameters
    ----------
    path : fx, fy, cx, cy on one or four lines; a 3x3 matrix; or Open3D's JSON, whose
        ``intrinsic_matrix`` is by columns. Lines from # on are comments

    Raises
    ------
    FormatError
        It holds none of these.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = _of_json(text) if path.suffix == ".json" else _numbers(text)
    except (ValueError, TypeError, KeyError):
        raise FormatError(path, None, f"intrinsics expected: {KNOWN}") from None
    with in_file(path):
        if len(values) == 9:
            K = np.reshape(values, (3, 3))
            if K[2].tolist() != [0.0, 0.0, 1.0] or K[1, 0] != 0.0:
                raise InputError("the last row of a camera's matrix is 0 0 1")
            return Camera(*map(float, (K[0, 0], K[1, 1], K[0, 2], K[1, 2])))
        if len(values) == 4:
            return Camera(*values)
    raise FormatError(path, None, f"intrinsics expected: {KNOWN}; not {len(values)} numbers")


def _numbers(text: str) -> list[float]:
    lines = (line.partition("#")[0].replace(",", " ") for line in text.splitlines())
    return [float(word) for line in lines for word in line.split()]


def _of_json(text: str) -> list[float]:
    columns = json.loads(text)["intrinsic_matrix"]
    return [float(value) for value in np.reshape(columns, (3, 3)).T.ravel()]

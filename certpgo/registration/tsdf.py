"""Fusion of depth frames in a truncated signed distance field, and its surface as a mesh.

Curless, Levoy, "A volumetric method for building complex models from range images", SIGGRAPH 1996:
each voxel near a surface holds the mean of its signed distances along the cameras' axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import InputError, MissingDependency
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.camera import Camera

Colour = NDArray[np.uint8]

#: Voxels along the edge of a block; memory is taken by blocks near surfaces.
BLOCK = 16
#: Every so many pixels, rows and columns, are asked which blocks they see.
SPARSE = 4
#: Gigabytes that all blocks may take: a voxel has a distance, a weight and a colour, in floats.
MOST = 1.0
VOXEL_BYTES = 4 * 5


@dataclass(frozen=True, eq=False)
class Block:
    """The sums of a cube of voxels.

    Attributes
    ----------
    distance : (b, b, b) mean signed distance, positive before the surface, in truncations
    weight : (b, b, b) number of frames
    colour : (b, b, b, 3) mean colour, 0 to 255
    """

    distance: NDArray[np.float32]
    weight: NDArray[np.float32]
    colour: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Volume:
    """A truncated signed distance field.

    Attributes
    ----------
    voxel, truncation : edge of a voxel, and the distance that counts as far, metres
    blocks : by their place in the grid of blocks, whose first has its corner at the world's origin
    """

    voxel: float
    truncation: float
    blocks: dict[tuple[int, int, int], Block]


def integrate(
    frames: Iterable[tuple[Colour, FloatArray]],
    poses: Estimate,
    camera: Camera,
    *,
    voxel: float,
    truncation: float | None = None,
) -> Volume:
    """Fuse depth frames.

    Parameters
    ----------
    frames : colours (h, w, 3) of 8 bits and depths (h, w) along the camera's axis, metres; where
        nothing was seen, 0 or not finite
    poses : camera to world, one for each frame, metres
    camera : of all frames
    voxel : edge of a voxel, metres
    truncation : distance from a surface at which voxels are free or unknown; by default 4 voxels

    Raises
    ------
    InputError
        Lengths that are not positive, a truncation below a voxel, fewer poses than frames, images
        of different sizes, or surfaces that need more than `MOST` gigabytes.
    """
    truncation = 4.0 * voxel if truncation is None else truncation
    if not 0.0 < voxel <= truncation < np.inf:
        raise InputError(f"0 < voxel <= truncation expected, not {voxel:g} and {truncation:g} m")
    if poses.translations is None or poses.d != 3:
        raise InputError("poses in space with translations are expected")
    volume = Volume(voxel, truncation, {})
    for number, (colour, depth) in enumerate(frames):
        depth = np.asarray(depth, dtype=np.float64)
        if number >= poses.num_nodes:
            raise InputError(f"frame {number} has no pose: there are {poses.num_nodes}")
        if depth.ndim != 2 or np.shape(colour) != (*depth.shape, 3):
            raise InputError(f"frame {number}: depth and colour of one size are expected")
        seen = np.where(np.isfinite(depth), depth, 0.0)
        R, t = poses.rotations[number], poses.translations[number]
        for place in _touched(volume, seen, camera, R, t):
            _update(volume, place, seen, np.asarray(colour), camera, R, t)
    return volume


def _touched(
    volume: Volume, depth: FloatArray, camera: Camera, R: FloatArray, t: FloatArray
) -> list[tuple[int, int, int]]:
    """The blocks within the truncation of a seen point."""
    # Blocks between these pixels are neighbours of those that they see.
    v, u = SPARSE * np.array(np.nonzero(depth[::SPARSE, ::SPARSE] > 0.0))
    z, ray = depth[v, u], camera.rays(np.stack([u, v], axis=1).astype(np.float64))
    edge, found = BLOCK * volume.voxel, [np.empty((0, 3), dtype=np.int64)]
    # Steps along the ray of at most half a block, and the cubes around them.
    steps = np.linspace(-1.0, 1.0, 2 * int(np.ceil(2.0 * volume.truncation / edge)) + 1)
    for step in steps:
        point = (ray * (z + step * volume.truncation)[:, None]) @ R.T + t
        found.append(np.unique(np.floor(point / edge).astype(np.int64), axis=0))
    near = np.unique(np.concatenate(found), axis=0)
    around = np.array(list(product((-1, 0, 1), repeat=3)))
    places = np.unique((near[:, None] + around).reshape(-1, 3), axis=0)
    return [(int(a), int(b), int(c)) for a, b, c in places]


def _update(
    volume: Volume,
    place: tuple[int, int, int],
    depth: FloatArray,
    colour: Colour,
    camera: Camera,
    R: FloatArray,
    t: FloatArray,
) -> None:
    """Average a frame's distances into a block, which is made if it sees any."""
    b, (height, width) = BLOCK, depth.shape
    corner = (np.array(place) * b * volume.voxel - t) @ R
    # Points R^T (p - t) of a grid: three families of equal steps.
    step = R * volume.voxel
    k = np.arange(b)[:, None]
    x, y, z = np.moveaxis(
        corner
        + (k * step[0])[:, None, None]
        + (k * step[1])[None, :, None]
        + (k * step[2])[None, None, :],
        -1,
        0,
    )
    ahead = np.where(z > volume.voxel, z, np.inf)
    u, v = camera.fx * x / ahead + camera.cx, camera.fy * y / ahead + camera.cy
    inside = (z > volume.voxel) & (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    if not inside.any():
        return
    column, row = np.rint(u[inside]).astype(np.intp), np.rint(v[inside]).astype(np.intp)
    seen = depth[row, column]
    distance = (seen - z[inside]) / volume.truncation
    met = (seen > 0.0) & (distance >= -1.0)
    if not (np.abs(distance[met]) < 1.0).any() and place not in volume.blocks:
        return
    block = volume.blocks.get(place) or _new_block(volume, place)
    which = tuple(index[met] for index in np.nonzero(inside))
    weight = block.weight[which]
    share = 1.0 / (weight + 1.0)
    new = np.minimum(distance[met], 1.0).astype(np.float32)
    block.distance[which] += (new - block.distance[which]) * share
    painted = colour[row[met], column[met]].astype(np.float32)
    block.colour[which] += (painted - block.colour[which]) * share[:, None]
    block.weight[which] = weight + 1.0


def _new_block(volume: Volume, place: tuple[int, int, int]) -> Block:
    needed = (len(volume.blocks) + 1) * BLOCK**3 * VOXEL_BYTES
    if needed > MOST * 1e9:
        raise InputError(
            f"voxels of {volume.voxel:g} m need more than {MOST:g} GB: take larger ones"
        )
    shape = (BLOCK,) * 3
    block = Block(
        np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros((*shape, 3), np.float32)
    )
    volume.blocks[place] = block
    return block


def mesh(volume: Volume) -> tuple[FloatArray, IntArray, Colour]:
    """The surface where the distance is zero, by marching cubes.

    Returns
    -------
    vertices (n, 3) in the world, metres; faces (k, 3), counterclockwise seen from outside; colours
    (n, 3)

    Raises
    ------
    InputError
        There is no surface.
    MissingDependency
        scikit-image is not installed.
    """
    try:
        from skimage.measure import marching_cubes
    except ModuleNotFoundError:
        raise MissingDependency("scikit-image, which makes meshes,", "mesh") from None

    vertices, faces, colours = [np.empty((0, 3))], [np.empty((0, 3), np.intp)], list[FloatArray]()
    count = 0
    for place in sorted(volume.blocks):
        distance, weight, colour = _with_border(volume, place)
        cubes = _whole_cubes(weight > 0.0)
        near = distance[weight > 0.0]
        if not cubes.any() or near.min() >= 0.0 or near.max() <= 0.0:
            continue
        mask = np.zeros(distance.shape, dtype=bool)
        mask[1:, 1:, 1:] = cubes  # scikit-image's cube ends at its voxel
        try:
            found, triangles, _, _ = marching_cubes(  # type: ignore[no-untyped-call]
                distance, 0.0, mask=mask, gradient_direction="descent", allow_degenerate=False
            )
        except (RuntimeError, ValueError):  # no surface among the whole cubes
            continue
        vertices.append(volume.voxel * (found + BLOCK * np.array(place)))
        faces.append(triangles + count)
        nearest = np.rint(found).astype(np.intp)
        colours.append(colour[tuple(nearest.T)])
        count += len(found)
    if not count:
        raise InputError("the volume holds no surface")
    return _welded(np.concatenate(vertices), np.concatenate(faces), np.concatenate(colours))


def _with_border(
    volume: Volume, place: tuple[int, int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Distance, weight and colour of a block and of the voxels right after it."""
    b = BLOCK + 1
    distance, weight = np.ones((b, b, b), np.float32), np.zeros((b, b, b), np.float32)
    colour = np.zeros((b, b, b, 3), np.float32)
    for after in product((0, 1), repeat=3):
        i, j, k = (p + a for p, a in zip(place, after, strict=True))
        other = volume.blocks.get((i, j, k))
        if other is not None:
            to = tuple(slice(BLOCK, b) if a else slice(0, BLOCK) for a in after)
            of = tuple(slice(0, 1) if a else slice(0, BLOCK) for a in after)
            distance[to], weight[to], colour[to] = (
                other.distance[of],
                other.weight[of],
                other.colour[of],
            )
    return distance, weight, colour


def _whole_cubes(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(b - 1, b - 1, b - 1) which cubes have eight known corners."""
    whole = known
    for axis in range(3):
        first, last = [slice(None)] * 3, [slice(None)] * 3
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        whole = whole[tuple(first)] & whole[tuple(last)]
    return whole


def _welded(
    vertices: FloatArray, faces: IntArray, colours: FloatArray
) -> tuple[FloatArray, IntArray, Colour]:
    """Blocks share the vertices on their borders, which become one."""
    scale = np.ptp(vertices, axis=0).max()
    key = np.rint(vertices / (1e-7 * scale)).astype(np.int64) if scale else np.zeros_like(faces)
    _, first, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    joined = number.ravel()[faces]
    a, b, c = joined.T
    proper = (a != b) & (b != c) & (c != a)
    return vertices[first], joined[proper], np.rint(colours[first]).astype(np.uint8)

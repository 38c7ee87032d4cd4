"""An embedded RGB-D sensor: a textured room with furniture, an orbit that closes, and the truth.

Rays are cast from each pixel to the inside of a box, the room, and to boxes in it. Textures are
sums of smooth noise of several wavelengths, looked up in tables by the coordinates on each face.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.camera import Camera, depth_noise
from certpgo.registration.sequences import Frame, FrameSequence

#: Half the sides of the room, metres.
ROOM = np.array([2.2, 1.8, 1.3])
#: Texels of a metre, and of a face's side.
TEXELS, SIDE = 150, 700
#: Wavelengths of the textures, texels.
WAVELENGTHS = (2.0, 5.0, 12.0, 40.0)
#: The repeated wallpaper's tile, texels: 0.6 m.
TILE = 90
#: Disparity, DISPARITY / z, is a multiple of 1/STEPS of the sensor's pixels, pixels times metres.
STEPS, DISPARITY = 8.0, 580.0 * 0.075
#: Pixels without depth at random, and beside jumps of depth by this share.
DROPOUTS, JUMP = 0.01, 0.05
#: Turns of the orbit: it closes, and overlaps itself.
TURNS = 1.1


@dataclass(frozen=True, eq=False, kw_only=True)
class SyntheticSequence(FrameSequence):
    """Frames that are made when they are needed.

    Attributes
    ----------
    room : what is seen
    poses : (n,) of the camera
    size : width and height, pixels
    numbers : (n,) by which noise is drawn
    """

    room: Room
    poses: Estimate
    size: tuple[int, int]
    numbers: IntArray

    def frame(self, k: int) -> Frame:
        """The k-th frame."""
        R, t = self.poses.rotations[k], self.poses.translations
        at = np.zeros(3) if t is None else t[k]
        z, colour = self.room.seen(self.camera, self.size, R, at)
        rng = np.random.default_rng([self.room.seed, int(self.numbers[k])])
        shade = colour + rng.normal(0.0, 2.0, colour.shape)
        return Frame(np.clip(np.rint(shade), 0, 255).astype(np.uint8), _measured(z, rng))

    def key(self, k: int) -> str:
        """What the k-th frame is made of."""
        made = (self.room, self.camera, self.size, int(self.numbers[k]), self.poses.rotations[k])
        return repr((made, None if self.poses.translations is None else self.poses.translations[k]))

    def _of_frames(self, kept: list[int]) -> dict[str, Any]:
        return {"poses": self.poses.subset(np.array(kept)), "numbers": self.numbers[kept]}


def synthetic_sequence(
    n: int = 120, *, seed: int = 0, size: tuple[int, int] = (320, 240), wallpaper: bool = False
) -> SyntheticSequence:
    """Frames of a room that exists only here, with the true poses.

    The camera moves on an ellipse around the middle, looking outwards, and comes back to where it
    has begun. Depth has the noise of structured light, steps of disparity, and holes.

    Parameters
    ----------
    n : number of frames
    seed : of the room, the orbit and the noise
    size : width and height, pixels
    wallpaper : whether walls repeat one tile of 0.6 m: most of what looks equal is not

    Examples
    --------
    >>> from certpgo.registration.synthetic import synthetic_sequence
    >>> frames = synthetic_sequence(4, size=(64, 48))
    >>> frame = frames.frame(0)
    >>> frame.colour.shape, frame.depth.shape, frames.truth.num_nodes
    ((48, 64, 3), (48, 64), 4)
    """
    width, height = size
    focal = 0.82 * width
    poses = _orbit(n, np.random.default_rng([seed, 1]))
    return SyntheticSequence(
        name=f"synthetic-{n}{'-wallpaper' if wallpaper else ''}",
        names=tuple(f"frame {k}" for k in range(n)),
        times=np.arange(n, dtype=np.float64),
        camera=Camera(focal, focal, (width - 1) / 2.0, (height - 1) / 2.0),
        truth=poses,
        room=Room(seed, wallpaper),
        poses=poses,
        size=size,
        numbers=np.arange(n),
    )


def _orbit(n: int, rng: np.random.Generator) -> Estimate:
    """Poses on an ellipse, looking outwards, with smooth sway."""
    share = np.arange(n) / max(n - 1, 1)
    angle = 2.0 * np.pi * TURNS * share * min(1.0, n / 60.0) + rng.uniform(0.0, 2.0 * np.pi)
    phases = rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    sway = np.sin(2.0 * angle[:, None] + phases[:, 0]) + 0.5 * np.sin(3.0 * angle[:, None])
    t = np.stack([0.5 * np.cos(angle), 0.4 * np.sin(angle), 0.08 * sway[:, 0]], axis=1)
    forward = np.stack([np.cos(angle), np.sin(angle), 0.12 * sway[:, 1] - 0.1], axis=1)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    R = np.stack([right, np.cross(forward, right), forward], axis=2)
    roll = np.zeros((n, 3))
    roll[:, 2] = 0.05 * sway[:, 2]
    return Estimate(so.project(R @ so.exp(roll)), t)


@dataclass(frozen=True)
class Room:
    """A textured box with boxes in it.

    Attributes
    ----------
    seed : of textures and furniture
    wallpaper : whether faces repeat one tile
    """

    seed: int
    wallpaper: bool = False

    @cached_property
    def boxes(self) -> FloatArray:
        """(b, 2, 3) lowest and highest corners: of the room first, then of what stands in it."""
        rng = np.random.default_rng([self.seed, 2])
        found = [np.stack([-ROOM, ROOM])]
        for k in range(8):
            angle = 2.0 * np.pi * (k + rng.uniform(0.2, 0.8)) / 8.0
            half = rng.uniform(0.12, 0.35, 3)
            place = np.array([1.75 * np.cos(angle), 1.4 * np.sin(angle), rng.uniform(-1.0, 0.5)])
            found.append(np.stack([place - half, place + half]))
        return np.array(found)

    @cached_property
    def textures(self) -> NDArray[np.uint8]:
        """(6 b, side, side, 3) colours of the faces, by box, axis and side; or of one tile."""
        rng = np.random.default_rng([self.seed, 3])
        faces = 6 * len(self.boxes)
        if self.wallpaper:
            return _texture(rng, TILE)[None]
        atlas = [_texture(rng, SIDE) for _ in range(6)]
        # What stands in the room is cut from one more texture, each at another place.
        cut = _texture(rng, SIDE)
        shifts = rng.integers(SIDE, size=(faces - 6, 2))
        atlas += [np.roll(cut, shift.tolist(), axis=(0, 1)) for shift in shifts]
        return np.array(atlas)

    def seen(
        self, camera: Camera, size: tuple[int, int], R: FloatArray, t: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Exact depths (h, w), metres, and colours (h, w, 3) from a pose."""
        width, height = size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=2)
        # By coordinates, as operations over the last axis are fast where that is long.
        rays = R @ camera.rays(grid.reshape(-1, 2).astype(np.float64)).T
        rays[rays == 0.0] = 1e-12
        z = np.full(rays.shape[1], np.inf)
        face = np.zeros(rays.shape[1], dtype=np.intp)
        everywhere, squares = np.arange(rays.shape[1]), (rays * rays).sum(axis=0)
        inverse = 1.0 / rays
        for number, (low, high) in enumerate(self.boxes):
            # Rays that miss the ball around a box miss the box.
            towards = 0.5 * (low + high) - t
            along, far = towards @ rays, towards @ towards - 0.25 * ((high - low) ** 2).sum()
            near = (along > 0.0) & (along**2 >= far * squares)
            few = everywhere if number == 0 else np.flatnonzero(near)
            slopes = inverse if number == 0 else inverse[:, few]
            ends = (low - t)[:, None] * slopes, (high - t)[:, None] * slopes
            enter, leave = np.minimum(*ends), np.maximum(*ends)
            # Of the room, where rays leave it; of a box, where they enter it.
            x, y, w = leave if number == 0 else -enter
            reached = np.minimum(np.minimum(x, y), w)
            axis = np.where(reached == x, 0, np.where(reached == y, 1, 2))
            depth = np.abs(reached)
            hit = (enter.max(axis=0) < leave.min(axis=0)) & (depth < z[few])
            seen, turned = few[hit], axis[hit]
            z[seen] = depth[hit]
            face[seen] = 6 * number + 2 * turned + (rays[turned, seen] > 0.0)
        colours = self._colours(t[:, None] + z * rays, face)
        return z.reshape(height, width), colours.reshape(height, width, 3)

    def _colours(self, places: FloatArray, face: IntArray) -> FloatArray:
        """(k, 3) colours at places (3, k) on faces, between texels."""
        axis = face % 6 // 2
        u = TEXELS * (places + 2.0 * ROOM[0])
        across, up = np.where(axis == 0, u[1], u[0]), np.where(axis == 2, u[1], u[2])
        x, y = np.floor(across).astype(np.intp), np.floor(up).astype(np.intp)
        fx, fy = (across - x).astype(np.float32), (up - y).astype(np.float32)
        T = self.textures
        period = T.shape[1]
        first = np.zeros_like(face) if self.wallpaper else face * period
        x0, x1 = x % period, (x + 1) % period
        low, high = ((first + rows % period) * period for rows in (y, y + 1))
        texels = T.reshape(-1, 3)
        colours = np.zeros((len(face), 3), dtype=np.float32)
        for row, column, share in (
            (low, x0, (1.0 - fx) * (1.0 - fy)),
            (low, x1, fx * (1.0 - fy)),
            (high, x0, (1.0 - fx) * fy),
            (high, x1, fx * fy),
        ):
            colours += share[:, None] * texels.take(row + column, axis=0)
        return colours.astype(np.float64)


def _texture(rng: np.random.Generator, side: int) -> NDArray[np.uint8]:
    """(side, side, 3) smooth noise of several wavelengths, periodic."""
    noise = 0.5 * rng.standard_normal((side, side, 3)) + rng.standard_normal((side, side, 1))
    squares = np.add.outer(np.fft.fftfreq(side) ** 2, np.fft.rfftfreq(side) ** 2)
    # Gaussian filters of equal power.
    widths = np.pi * np.array(WAVELENGTHS)
    powers = [width * np.exp(-0.5 * width**2 * squares) for width in widths]
    spectrum = np.fft.rfft2(noise, axes=(0, 1)) * np.sum(powers, axis=0)[:, :, None]
    smooth = np.fft.irfft2(spectrum, s=(side, side), axes=(0, 1))
    shade = np.clip(128.0 + 56.0 * smooth / smooth.std(), 0, 255)
    return np.asarray(shade, dtype=np.uint8)


def _measured(z: FloatArray, rng: np.random.Generator) -> NDArray[np.float32]:
    """Depths as structured light measures them."""
    noisy = z + depth_noise(z) * rng.standard_normal(z.shape)
    disparity = np.rint(STEPS * DISPARITY / noisy) / STEPS
    steps = DISPARITY / np.maximum(disparity, 1.0 / STEPS)
    jump = ndimage.maximum_filter(z, 3) - ndimage.minimum_filter(z, 3) > JUMP * z
    steps[jump | (rng.random(z.shape) < DROPOUTS)] = 0.0
    return steps.astype(np.float32)

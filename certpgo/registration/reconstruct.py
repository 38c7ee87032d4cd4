"""From RGB-D frames to a certified trajectory and the scene."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np

from certpgo.errors import FormatError, InputError, InputNotice, SpecError
from certpgo.graph import Estimate, Instance
from certpgo.io.plural import counted
from certpgo.linalg.arrays import IntArray
from certpgo.registration import features as keypoints
from certpgo.registration.averaging import Averaged, averaged, composed
from certpgo.registration.features import ColourCamera, Features
from certpgo.registration.fuse import GRID, ColouredCloud, VoxelGrid, denoised, voxel_means
from certpgo.registration.loops import DeadReckoning, adjacent, overlapping, retrieved
from certpgo.registration.pairs import VOXEL, Clouds, Pair, View, measure, restored, stored
from certpgo.registration.ransac import RansacSettings
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.stages import Arrays, Cache, Progress, digest, each, silent
from certpgo.solvers.certified.pipeline import CertifiedSolution

#: Pixels of which a cloud takes one, of images this wide.
STEP, WIDE = 2, 640
#: Keypoints with a depth from which on a frame can be matched.
FEWEST = 30
#: Neighbours in the grid of a point of the scene, at least, where frames overlap.
SEEN_TWICE = 2


@dataclass(frozen=True)
class ReconstructSettings:
    """How frames are reconstructed.

    Attributes
    ----------
    cutoff : largest depth that is used, metres
    grid : edge of the scene's voxels, metres
    dense : whether clouds are added to keypoints, by generalized ICP
    gate : whether loops that contradict dead reckoning are left out
    ransac : when two frames match
    """

    cutoff: float = 4.0
    grid: float = GRID
    dense: bool = True
    gate: bool = True
    ransac: RansacSettings = RansacSettings()

    def __post_init__(self) -> None:
        if not (0.0 < self.cutoff < np.inf and 0.0 < self.grid < np.inf):
            raise SpecError("cutoff and grid are metres, positive")


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A trajectory with its certificate, and the scene.

    Attributes
    ----------
    frames : the sequence
    nodes : (n,) numbers of the frames whose poses are estimated
    pairs : (m) the measured edges, odometry first
    odometry : how many of them are odometry
    averaged : the graph, its certified solution, and the rejected edges
    dead_reckoning : poses by odometry alone, composed
    skipped : frames that could not be used, each with the reason
    scene : the fused cloud, in the frame of the first pose
    """

    frames: FrameSequence
    nodes: IntArray
    pairs: tuple[Pair, ...]
    odometry: int
    averaged: Averaged
    dead_reckoning: Estimate
    skipped: tuple[str, ...]
    scene: ColouredCloud

    @property
    def instance(self) -> Instance:
        """The pose graph of all edges; ids are numbers of frames."""
        return self.averaged.instance

    @property
    def answer(self) -> CertifiedSolution:
        """The certified solution for the edges that were kept."""
        return self.averaged.answer

    @property
    def estimate(self) -> Estimate:
        """Poses of the frames ``nodes``; the first is the identity."""
        return self.averaged.estimate


def reconstruct(
    frames: FrameSequence,
    settings: ReconstructSettings | None = None,
    *,
    colour: ColourCamera | None = None,
    cache: str | Path | None = None,
    progress: Progress = silent,
) -> Reconstruction:
    """The trajectory of a camera and the scene that it saw."""
    chosen = settings or ReconstructSettings()
    work = _Work(frames, chosen, colour, Cache(None if cache is None else Path(cache)), progress)
    views, skipped, size = work.views()
    steps = work.measured("odometry", adjacent(len(frames)))
    if not steps:
        raise InputError(f"{frames.name}: no frame matches the next one: they do not overlap")
    nodes, reckoning = composed(steps, frames.names, frames.name)
    reckoned = DeadReckoning(nodes, reckoning, steps)
    plausible = partial(filter, None if not chosen.gate else reckoned.allows)
    tried = set(adjacent(len(frames)))
    alike = retrieved([view and view.features for view in views], np.random.default_rng(0))
    pairs = [*steps, *plausible(work.measured("loops", alike))]
    first = averaged(pairs, frames.names, frames.name, reckoning)
    clouds = {k: views[k].cloud for k in first.nodes.tolist()}
    overlaps = overlapping(clouds, first.estimate, frames.camera, size, tried | set(alike))
    pairs += plausible(work.measured("overlaps", overlaps))
    final = averaged(pairs, frames.names, frames.name, first.estimate)
    scene = work.scene(final)
    return Reconstruction(
        frames, final.nodes, tuple(pairs), len(steps), final, reckoning, skipped, scene
    )


class _Work:
    """The stages over frames and pairs, with what they share."""

    def __init__(
        self,
        frames: FrameSequence,
        settings: ReconstructSettings,
        colour: ColourCamera | None,
        cache: Cache,
        progress: Progress,
    ) -> None:
        self.frames, self.settings, self.colour = frames, settings, colour
        self.cache, self.progress = cache, progress
        self._views: list[View | None] = []
        self._keys: list[str] = []

    def views(self) -> tuple[list[View | None], tuple[str, ...], tuple[int, int]]:
        """What is kept of each frame, why others are left out, and the size of images."""
        found = each("frames", self._view, range(len(self.frames)), self.progress)
        self._views = [view for view, _, _, _ in found]
        self._keys = [key for _, key, _, _ in found]
        skipped = tuple(reason for _, _, reason, _ in found if reason)
        for reason in skipped:
            warnings.warn(f"frame left out: {reason}", InputNotice, stacklevel=3)
        sizes = {size for *_, size in found if size is not None}
        if not any(self._views):
            raise InputError(f"{self.frames.name}: no usable frame: {skipped[0]}")
        if len(sizes) > 1:
            raise InputError(f"{self.frames.name}: images of several sizes: {sorted(sizes)}")
        return self._views, skipped, sizes.pop()

    def _view(self, k: int) -> tuple[View | None, str, str, tuple[int, int] | None]:
        key = digest(self.frames.key(k), self.settings.cutoff, self.colour)
        try:
            arrays = self.cache.arrays(("view", key), lambda: self._seen(k))
        except FormatError as error:
            return None, key, str(error), None
        width, height = arrays["size"].tolist()
        features = Features(arrays["pixels"], arrays["points"], arrays["descriptors"])
        if len(features) < FEWEST:
            found = counted(len(features), "keypoint{s} with a depth")
            return None, key, f"{self.frames.names[k]}: {found}, {FEWEST} needed", (width, height)
        return View(features, arrays["cloud"]), key, "", (width, height)

    def _seen(self, k: int) -> Arrays:
        frame, camera = self.frames.frame(k), self.frames.camera
        cutoff = self.settings.cutoff
        found = keypoints.place(
            *keypoints.detect(frame), frame.depth, camera, colour=self.colour, cutoff=cutoff
        )
        height, width = frame.depth.shape
        near = np.where(frame.depth <= cutoff, frame.depth, np.float32(0.0))
        cloud = camera.cloud(near, step=STEP if width >= WIDE else 1)
        return {
            "size": np.array([width, height]),
            "pixels": found.pixels,
            "points": found.points,
            "descriptors": found.descriptors,
            "cloud": voxel_means(cloud, VOXEL).astype(np.float32),
        }

    def measured(self, stage: str, candidates: list[tuple[int, int]]) -> list[Pair]:
        """The pairs that match, in the order of the candidates."""
        usable = [(i, j) for i, j in candidates if self._views[i] and self._views[j]]
        clouds = Clouds(self._views) if self.settings.dense else None
        work = partial(self._pair, clouds)
        return [pair for pair in each(stage, work, usable, self.progress) if pair]

    def _pair(self, clouds: Clouds | None, ends: tuple[int, int]) -> Pair | None:
        i, j = ends
        a, b = self._views[i], self._views[j]
        if a is None or b is None:
            return None
        camera = self.frames.camera if self.colour is None else self.colour.camera
        settings = self.settings.ransac
        key = ("pair", i, j, self._keys[i], self._keys[j], settings, clouds is not None)
        arrays = self.cache.arrays(
            key,
            lambda: stored(measure(i, j, a.features, b.features, camera, settings, clouds)),
        )
        return restored(i, j, arrays)

    def scene(self, final: Averaged) -> ColouredCloud:
        """All clouds in the frame of the first pose, as means over voxels."""
        grid, lock = VoxelGrid(self.settings.grid), Lock()
        estimate, camera = final.estimate, self.frames.camera

        def add(node: int) -> None:
            frame = self.frames.frame(int(final.nodes[node]))
            near = np.where(frame.depth <= self.settings.cutoff, frame.depth, np.float32(0.0))
            step = STEP if near.shape[1] >= WIDE else 1
            points = camera.cloud(near, step)
            colours = frame.colour[::step, ::step][near[::step, ::step] > 0.0]
            if estimate.translations is not None:
                points = points @ estimate.rotations[node].T + estimate.translations[node]
            with lock:
                grid.add(points, colours)

        each("fusion", add, range(len(final.nodes)), self.progress)
        return denoised(grid.cloud(SEEN_TWICE))

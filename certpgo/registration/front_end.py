"""The stages of a reconstruction over frames and over pairs of them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from certpgo.errors import FormatError, InputError, InputNotice
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray
from certpgo.registration import features as keypoints
from certpgo.registration.features import ColourCamera, Features
from certpgo.registration.fuse import STEP, WIDE, voxel_means
from certpgo.registration.judging import about_depths, judge_depths
from certpgo.registration.pairs import VOXEL, Clouds, FramePair, Keyframe, measure, restored, stored
from certpgo.registration.ransac import RansacSettings
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.stages import Arrays, Cache, Progress, digest, each

#: Keypoints with a depth from which on a frame can be matched.
FEWEST = 30


@dataclass(frozen=True)
class FrontEndSettings:
    """How frames are looked at and compared.

    Attributes
    ----------
    colour : the colour camera; None if depth is registered to colour
    cutoff : largest depth that is used, metres
    dense : whether clouds are added to keypoints
    scaled : whether the depths of each frame have an unknown factor
    ransac : when two frames match
    """

    colour: ColourCamera | None
    cutoff: float
    dense: bool
    scaled: bool
    ransac: RansacSettings


class _Looked(NamedTuple):
    """A frame's view or the reason why there is none, its key, size, and what its depths are."""

    view: Keyframe | None
    key: str
    reason: str
    size: tuple[int, int] | None = None
    depths: FloatArray | None = None


class FrontEnd:
    """The stages over frames and pairs, with what they share."""

    def __init__(
        self, frames: FrameSequence, settings: FrontEndSettings, cache: Cache, progress: Progress
    ) -> None:
        self.frames, self.settings = frames, settings
        self.cache, self.progress = cache, progress
        self.kept: list[Keyframe | None] = []
        self._keys: list[str] = []

    def views(self) -> tuple[list[Keyframe | None], tuple[str, ...], tuple[int, int]]:
        """What is kept of each frame, why others are left out, and the size of images."""
        found = each("frames", self._view, range(len(self.frames)), self.progress)
        self.kept = [one.view for one in found]
        self._keys = [one.key for one in found]
        skipped = tuple(one.reason for one in found if one.reason)
        known = [one.depths for one in found if one.depths is not None]
        if not self.settings.scaled:
            judge_depths(self.frames.name, known, self.settings.cutoff)
        for reason in skipped:
            warnings.warn(f"frame left out: {reason}", InputNotice, stacklevel=3)
        sizes = {one.size for one in found if one.size is not None}
        if not any(self.kept):
            raise InputError(f"{self.frames.name}: no usable frame: {skipped[0]}")
        if len(sizes) > 1:
            raise InputError(f"{self.frames.name}: images of several sizes: {sorted(sizes)}")
        return self.kept, skipped, sizes.pop()

    def _view(self, k: int) -> _Looked:
        key = digest(self.frames.key(k), self.settings.cutoff, self.settings.colour)
        try:
            arrays = self.cache.arrays(("view", key), lambda: self._seen(k))
        except FormatError as error:
            return _Looked(None, key, str(error))
        width, height = arrays["size"].tolist()
        features = Features(arrays["pixels"], arrays["points"], arrays["descriptors"])
        found: tuple[tuple[int, int], FloatArray] = (width, height), arrays["depths"]
        if len(features) < FEWEST:
            few = counted(len(features), "keypoint{s} with a depth")
            return _Looked(None, key, f"{self.frames.names[k]}: {few}, {FEWEST} needed", *found)
        return _Looked(Keyframe(features, arrays["cloud"]), key, "", *found)

    def _seen(self, k: int) -> Arrays:
        frame, camera = self.frames.frame(k), self.frames.camera
        cutoff = self.settings.cutoff
        found = keypoints.place(
            *keypoints.detect(frame),
            frame.depth,
            camera,
            colour=self.settings.colour,
            cutoff=cutoff,
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
            "depths": about_depths(frame.depth, cutoff),
        }

    def measured(self, stage: str, candidates: list[tuple[int, int]]) -> list[FramePair]:
        """The pairs that match, in the order of the candidates."""
        usable = [(i, j) for i, j in candidates if self.kept[i] and self.kept[j]]
        clouds = Clouds(self.kept) if self.settings.dense else None
        work = partial(self._pair, clouds)
        return [pair for pair in each(stage, work, usable, self.progress) if pair]

    def _pair(self, clouds: Clouds | None, ends: tuple[int, int]) -> FramePair | None:
        i, j = ends
        a, b = self.kept[i], self.kept[j]
        if a is None or b is None:
            return None
        colour, settings = self.settings.colour, self.settings.ransac
        camera = self.frames.camera if colour is None else colour.camera
        scaled = self.settings.scaled
        key = ("pair", i, j, self._keys[i], self._keys[j], settings, clouds is not None, scaled)
        both = a.features, b.features

        def made() -> Arrays:
            return stored(measure(i, j, *both, camera, settings, clouds, scaled=scaled))

        return restored(i, j, self.cache.arrays(key, made))

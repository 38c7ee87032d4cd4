"""Scenes of trajectories without measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, GraphError, InputError
from certpgo.graph import Estimate
from certpgo.graph.keys import SECOND
from certpgo.io.format import LabelledPoses, format_of
from certpgo.io.matching import Matching, nearest
from certpgo.io.surfaces import Surface
from certpgo.linalg.arrays import IntArray
from certpgo.view.placements import aligned, in_space, placement
from certpgo.view.scene import AT_POSITIONS, Placement, Scene


def scene_of_trajectories(
    estimates: Sequence[tuple[str, Path | Estimate]],
    surfaces: Sequence[tuple[str, Surface]],
    truth: str | Path | Estimate | None,
    how: Matching,
    truth_offset: float,
) -> Scene:
    """Trajectories without measurements, aligned with the last where they share poses.

    They are matched by time where all have times, and otherwise by ids.

    Raises
    ------
    InputError
        There is nothing to draw, or rotations alone.
    FormatError
        A file cannot be read, or holds no trajectory.
    """
    named: list[tuple[str, Path | Estimate]] = [*estimates]
    if truth is not None:
        named.append(("truth", Path(truth) if isinstance(truth, str) else truth))
    poses = [(name, _poses(what)) for name, what in named]
    by_time = all(of.times_ns is not None for _, of in poses) and how.timestamps is None
    tracks = [_track(name, of, by_time) for name, of in poses]
    if truth is not None and by_time:
        tracks[-1] = tracks[-1].later(truth_offset)
    if not tracks and not surfaces:
        raise InputError("nothing to show: a graph, an estimate, a cloud or a mesh expected")
    scaled = any(track.estimate.scales is not None for track in tracks)
    if len({track.estimate.d for track in tracks}) > 1:
        tracks = [replace(track, estimate=in_space(track.estimate)) for track in tracks]
    none = np.zeros(0, dtype=np.intp)
    keys = np.unique(np.concatenate([none, *(track.keys for track in tracks)]))
    within = how.max_difference if by_time else 0.0
    placed = [
        track.placed(keys, tracks[len(estimates) - 1], within, scaled=scaled) for track in tracks
    ]
    last = len(placed) if truth is None else len(placed) - 1
    whole, rest = np.divmod(keys, SECOND)
    unit = "units" if scaled else "m"
    return Scene(
        ", ".join(name for name, _ in [*estimates, *surfaces]) or "truth",
        tracks[0].estimate.d if tracks else 3,
        keys if not by_time else np.arange(len(keys)) if rest.any() else whole,
        none.reshape(0, 2),
        none,
        none.astype(bool),
        np.zeros(len(keys), dtype=bool),
        tuple(placed[:last]),
        placed[-1] if truth is not None else None,
        surfaces=tuple(surfaces),
        sentence=AT_POSITIONS[unit],
        length_unit=unit,
    )


@dataclass(frozen=True, eq=False)
class _Track:
    """A trajectory; ``keys`` (k,) are ids, nanoseconds or places of its poses, ascending."""

    name: str
    keys: IntArray
    estimate: Estimate

    def later(self, seconds: float) -> _Track:
        """The track with this added to its times."""
        return replace(self, keys=self.keys + round(seconds * SECOND))

    def placed(self, keys: IntArray, like: _Track, within: float, *, scaled: bool) -> Placement:
        """The placement among the poses of all trajectories, aligned with another."""
        moved = self.estimate
        if self is not like:
            mine = nearest(like.keys, self.keys, within)
            others = np.flatnonzero(mine >= 0)
            moved = aligned(moved, like.estimate, mine[others], others, scaled=scaled)
        return placement(self.name, np.searchsorted(keys, self.keys), moved)


def _track(name: str, poses: LabelledPoses, by_time: bool) -> _Track:
    """The track of poses by their times, or by ids where they have some."""
    keys = poses.times_ns if by_time or poses.ids is None else poses.ids
    if keys is None:
        keys = np.arange(len(poses.rotations))
    keys, first = np.unique(keys, return_index=True)
    if poses.translations is None:
        raise InputError(f"{name}: rotations without positions are drawn with their graph alone")
    scales = None if poses.scales is None else poses.scales[first]
    try:
        R, t = poses.rotations[first], poses.translations[first]
        return _Track(name, keys, Estimate(R, t, scales=scales))
    except GraphError as error:
        raise InputError(f"{name}: {error}") from None


def _poses(what: Path | Estimate) -> LabelledPoses:
    if isinstance(what, Estimate):
        return LabelledPoses.of(what).without_points()
    form = format_of(what)
    if form.read_poses is None:
        raise FormatError(what, None, f"a trajectory expected, not {form.holds}")
    return form.read_poses(what).without_points()

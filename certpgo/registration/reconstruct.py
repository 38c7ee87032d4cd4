"""From RGB-D frames to a certified trajectory and the scene."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from certpgo.errors import InputError, SpecError, require
from certpgo.graph import Estimate, Instance
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.averaging import Averaged, averaged, averaged_scales, composed
from certpgo.registration.calibration import colour_camera
from certpgo.registration.depth_scales import (
    MEDIAN,
    ScaledSequence,
    agreed_scales,
    of_one_median,
    with_factors,
)
from certpgo.registration.features import ColourCamera
from certpgo.registration.front_end import FrontEnd, FrontEndSettings
from certpgo.registration.fuse import GRID, ColouredCloud, fused
from certpgo.registration.judging import judge_steps
from certpgo.registration.loops import DeadReckoning, adjacent, consistent, overlapping, retrieved
from certpgo.registration.pairs import FramePair, in_units_of
from certpgo.registration.ransac import RansacSettings
from certpgo.registration.sequences import FrameSequence, read_sequence
from certpgo.registration.stages import Cache, Progress, silent
from certpgo.solve.result import CertifiedSolution

#: What is said beside every verdict.
UNPROVEN = (
    "that images were matched to the right places: repeated patterns that agree with one another "
    "are certified too"
)


@dataclass(frozen=True)
class ReconstructSettings:
    """How frames are reconstructed.

    Attributes
    ----------
    cutoff : largest depth that is used, metres
    grid : edge of the scene's voxels, metres
    dense : whether clouds are added to keypoints, by generalized ICP
    gate : whether loops that contradict dead reckoning are left out
    trust : whether the robust fit begins at odometry and takes its steps for right; if not, they
        are measurements like others
    consistent : whether only loops are kept that agree with one another in pairs
    calibrate : whether the colour camera is estimated from the frames, if it is not given; by
        default where depth images are not registered to colour
    scales : whether the depths of each frame have an unknown factor: a scale is estimated for each,
        by keypoints alone. Lengths in metres are then in the unit in which the median depth of
        frames is 2, in the geometric mean
    ransac : when two frames match
    """

    cutoff: float = 4.0
    grid: float = GRID
    dense: bool = True
    gate: bool = True
    trust: bool = True
    consistent: bool = False
    calibrate: bool | None = None
    scales: bool = False
    ransac: RansacSettings = field(default_factory=RansacSettings)

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
    colour : the colour camera, given or estimated; None if depth is taken for registered
    factors : (n,) by which depths of the nodes are multiplied to be in the map's unit, where depths
        have an unknown factor; ``frames`` are those with depths in that unit. Else None
    """

    frames: FrameSequence
    nodes: IntArray
    pairs: tuple[FramePair, ...]
    odometry: int
    averaged: Averaged
    dead_reckoning: Estimate
    skipped: tuple[str, ...]
    scene: ColouredCloud
    colour: ColourCamera | None = None
    factors: FloatArray | None = None

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
        return self.averaged.poses

    @property
    def rejected(self) -> tuple[FramePair, ...]:
        """The pairs that disagree with the rest, and the certificate is not about."""
        return tuple(self.pairs[k] for k in self.averaged.rejected.tolist())

    def named(self, pair: FramePair) -> str:
        """A pair in words, with its images."""
        names = self.frames.names
        agreeing = f"{pair.inliers} of {pair.matches} matches agree"
        return f"{names[pair.i]} and {names[pair.j]}, {agreeing}"

    def rejected_named(self) -> list[str]:
        """The rejected pairs in words."""
        return [self.named(pair) for pair in self.rejected]

    def consistency(self) -> list[tuple[str, str]]:
        """What a certificate does not say: how well images, loops and odometry agree."""
        a, n = self.averaged, len(self.frames)
        steps = a.chosen < self.odometry
        loops, kept = int((~steps).sum()), int((a.kept & ~steps).sum())
        shares = np.array([self.pairs[k].share for k in a.chosen[a.kept].tolist()])
        return [
            ("frames", f"{len(self.nodes)} of {n}"),
            *([] if self.colour is None else [("colour camera", str(self.colour))]),
            ("edges", f"{int(a.kept.sum())} of {len(a.kept)} kept, {int(steps.sum())} of odometry"),
            ("loops", f"{kept} of {loops} agree with the rest"),
            *a.said_of_fit(),
            *self._scales(),
            ("inliers", f"{100.0 * np.median(shares):.0f} % of the matches of a kept edge, median"),
            *self._disagreement(),
            ("not proven", UNPROVEN),
        ]

    def _scales(self) -> list[tuple[str, str]]:
        """The range of the factors, and what the certified cost and the map's unit are."""
        if self.factors is None:
            return []
        low, high = self.factors.min(), self.factors.max()
        return [
            ("depth factors", f"{low:.4g} to {high:.4g}"),
            ("unit", f"that in which median depths are {MEDIAN:g}, in the geometric mean"),
            ("weights", "in the frames' own units, at the estimate"),
        ]

    def _disagreement(self) -> list[tuple[str, str]]:
        """What was measured of the agreement of keypoints and clouds, if both were used."""
        kept = [self.pairs[k] for k in self.averaged.chosen[self.averaged.kept].tolist()]
        excess = [pair.excess for pair in kept if pair.dense]
        if not excess:
            return []
        said = f"{np.sqrt(np.median(excess)):.2g} times the difference expected from their noise"
        return [("keypoints, clouds", f"motions differ by {said}, median; weights allow for it")]


def reconstruct(
    frames: FrameSequence | str | Path,
    settings: ReconstructSettings | None = None,
    *,
    colour: ColourCamera | None = None,
    cache: str | Path | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """The trajectory of a camera with its certificate, and the scene that it saw.

    Neighbouring frames are registered by keypoints (SIFT, RANSAC) and generalized ICP, which are
    weighed by how far they disagree; then frames that look alike, and those that overlap at the
    estimate so far. Loops that contradict dead reckoning are left out, a robust fit rejects others,
    and the rest is solved and certified under g2o's cost, with the full information matrices. The
    verdict is about these measurements: it does not say that images were matched to the right
    places.

    Parameters
    ----------
    frames : such as `certpgo.read_sequence` reads, or the folder that it would read
    settings : see `ReconstructSettings`
    colour : the colour camera, if depth images are not registered to colour
    cache : folder in which what is computed of frames and pairs is kept, by content, so that an
        interrupted run resumes; None to keep nothing
    progress : is called with the stage, and how many of how many items are done

    Raises
    ------
    InputError
        No usable frame, frames that do not overlap, depths that are nearly all past the cutoff.
    MissingDependency
        opencv-python-headless or small_gicp is not installed.

    Warns
    -----
    InputNotice
        Frames that are left out, each with its file; frames that nothing joins; signs of a wrong
        camera or depth scale.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.registration.synthetic import synthetic_sequence
    >>> found = certpgo.reconstruct(synthetic_sequence(30).chosen(range(4)))
    >>> found.answer.verdict.value, found.estimate.num_nodes
    ('CERTIFIED', 4)
    """
    if isinstance(frames, str | os.PathLike):
        frames = read_sequence(frames)
    require(frames, FrameSequence, "a sequence of frames, or its folder,")
    chosen, progress = settings or ReconstructSettings(), progress or silent
    require(chosen, ReconstructSettings, "ReconstructSettings")
    kept = Cache(None if cache is None else Path(cache))
    given, factors = frames, None
    if chosen.scales:
        frames = of_one_median(given, progress)
    average = averaged_scales if chosen.scales else averaged
    if colour is None:
        colour = colour_camera(frames, chosen.calibrate, kept, progress, scaled=chosen.scales)
    looks = FrontEndSettings(
        colour, chosen.cutoff, chosen.dense and not chosen.scales, chosen.scales, chosen.ransac
    )
    work = FrontEnd(frames, looks, kept, progress)
    views, skipped, size = work.views()
    neighbours = adjacent(len(frames))
    steps = work.measured("odometry", neighbours)
    if not steps:
        raise InputError(f"{frames.name}: no frame matches the next one: they do not overlap")
    alike = retrieved([view.features if view else None for view in views], np.random.default_rng(0))
    loops = work.measured("loops", alike)
    scales = agreed_scales([*steps, *loops], len(frames)) if chosen.scales else np.ones(len(frames))
    steps, loops = in_units_of(scales, steps), in_units_of(scales, loops)
    nodes, reckoning = composed(steps, frames.names, frames.name)
    reckoned = DeadReckoning(nodes, reckoning, steps)
    pairs = [*steps, *_plausible(loops, reckoned, chosen)]
    first = average(pairs, frames.names, frames.name, reckoning, trust=chosen.trust)
    clouds = {k: scales[k] * view.cloud for k in first.nodes.tolist() if (view := views[k])}
    overlaps = overlapping(clouds, first.poses, frames.camera, size, {*neighbours, *alike})
    more = in_units_of(scales, work.measured("overlaps", overlaps))
    pairs = [*steps, *_plausible([*loops, *more], reckoned, chosen)]
    final = average(pairs, frames.names, frames.name, first.poses, trust=chosen.trust)
    if isinstance(frames, ScaledSequence) and final.scales is not None:
        scales[final.nodes] *= final.scales
        frames = with_factors(given, frames.factors * scales)
        factors = frames.factors[final.nodes]
    scene = fused(
        frames,
        final.nodes,
        final.poses,
        grid=chosen.grid,
        cutoff=chosen.cutoff,
        colour=colour,
        progress=progress,
    )
    found = Reconstruction(
        frames,
        final.nodes,
        tuple(pairs),
        len(steps),
        final,
        reckoning,
        skipped,
        scene,
        colour,
        factors,
    )
    missing = len(frames) - len(found.nodes) - len(skipped)
    judge_steps(frames.name, steps, missing, scaled=chosen.scales)
    return found


def _plausible(
    loops: list[FramePair], reckoned: DeadReckoning, settings: ReconstructSettings
) -> list[FramePair]:
    """The loops to believe, by the settings."""
    if settings.gate:
        loops = [pair for pair in loops if reckoned.allows(pair)]
    return consistent(loops, reckoned) if settings.consistent else loops

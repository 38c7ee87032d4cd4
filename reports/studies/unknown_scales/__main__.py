"""Factors of depths and scales of sub-maps, recovered from hidden ones.

    python -m reports.studies.unknown_scales [room] [redwood5] [seven_scenes] [bunny] [--cache DIR]

The depth of each frame, or each scan, is multiplied by a hidden factor between .5 and 2. Errors of
factors are those of their logarithms, about their mean; those of positions are root mean squares
after the best similarity. Two checks say why factors are wrong: how well the measured ratios agree
on one factor for each frame, and how much of the errors a tilt of all depths explains. Where depth
is not registered to colour, a tilt is estimated from loops as well, and frames are reconstructed
again with straight depths. Data are looked for in the folders ``rgbd`` and ``scans`` of
CERTPGO_DATA. What is computed of frames and pairs is kept in DIR.
"""

import argparse
import os
import warnings
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import certpgo
from certpgo.graph import Estimate
from certpgo.registration.camera import Camera
from certpgo.registration.depth_scales import with_factors
from certpgo.registration.features import Features, detect, match, place
from certpgo.registration.ransac import RansacSettings, refine
from certpgo.registration.reconstruct import Reconstruction, ReconstructSettings
from certpgo.registration.scans import Scan, read_initial, read_scan
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.submaps import ScanMatches, register_submaps
from certpgo.registration.synthetic import synthetic_sequence
from certpgo.solve.metrics import position_errors
from reports.studies.unknown_scales.depth_tilt import (
    StraightenedSequence,
    depth_tilt,
    straightened,
)

DATA = Path(os.environ.get("CERTPGO_DATA", "."))
#: Matches of two scans of the bunny, how many of them are wrong, and how near points are, metres.
MATCHES, WRONG, NEAR = 300, 100, 0.0005
#: A small tilt of depths, and when matches of a kept pair are looked at again with it.
SMALL, LOOSE = 0.003, RansacSettings(share=0.0)
SCALES = ReconstructSettings(scales=True)


def hidden_factors(n: int) -> np.ndarray:
    """(n,) between .5 and 2, uniform in their logarithms."""
    return np.exp(np.random.default_rng(0).uniform(np.log(0.5), np.log(2.0), n))


def trajectory_error(estimate: Estimate, truth: Estimate) -> float:
    """Root mean square of positions after the best similarity, millimetres."""
    return 1e3 * position_errors(estimate, truth, scaled=True).rmse


def scale_errors(found: np.ndarray, hidden: np.ndarray) -> str:
    """Errors of logarithms of factors: root mean square, and the largest, per cent."""
    off = np.log(found * hidden)
    off = 100.0 * (off - off.mean())
    return f"factors off by {off.std():.3f} %, at most {np.abs(off).max():.3f} %"


def ratio_errors(found: Reconstruction, hidden: np.ndarray) -> str:
    """Errors of the logarithms of measured ratios, root mean squares, per cent.

    Those of steps and of loops, and what remains about the factors that fit them all best.
    """
    graph, factors = found.instance.graph, np.log(found.factors * hidden[found.nodes])
    i, j = graph.edges.T
    off = 100.0 * (np.log(graph.scales) - factors[i] + factors[j])
    off, i, j = (values[found.averaged.kept] for values in (off, i, j))
    difference = np.eye(graph.num_nodes)[j] - np.eye(graph.num_nodes)[i]
    rest = off - difference @ np.linalg.lstsq(difference, off)[0]
    steps = np.abs(found.nodes[j] - found.nodes[i]) <= 2
    said = [
        f"{np.sqrt(np.mean(off[chosen] ** 2)):.2f} ({np.sqrt(np.mean(rest[chosen] ** 2)):.2f})"
        for chosen in (steps, ~steps)
        if chosen.any()
    ]
    return f"kept ratios of steps and loops off by {' and '.join(said)} % (about the best factors)"


def tilt_of_factors(found: Reconstruction, hidden: np.ndarray) -> str:
    """The tilt of depths, of all that pairs tell of it or not, that explains the factors best.

    Depths z are z (1 + a u + b v) at rays (u, v, 1). Ratios of kept pairs, and so the factors that
    fit them best, change with a and b; those are chosen for which errors of factors are least.
    """
    graph, camera, views = found.instance.graph, camera_of(found), views_of(found)
    ratios, edges = [], []
    for e in np.flatnonzero(found.averaged.kept).tolist():
        i, j = graph.edges[e].tolist()
        m, n = match(views[i], views[j])
        p, q = views[i].points[m], views[j].points[n]
        noise = camera.covariances(p), camera.covariances(q)
        start = graph.rotations[e], graph.translations[e], float(graph.scales[e])
        motions = [
            refine(straightened(p, tilt), straightened(q, tilt), noise, start, LOOSE, scaled=True)
            for tilt in ((0.0, 0.0), (SMALL, 0.0), (0.0, SMALL))
        ]
        if all(motions):
            ratios.append([np.log(motion.scale) for motion in motions])
            edges.append((i, j))
    i, j = np.array(edges).T
    difference = np.eye(graph.num_nodes)[j] - np.eye(graph.num_nodes)[i]
    logs = np.linalg.lstsq(difference, np.array(ratios))[0]
    slopes = (logs[:, 1:] - logs[:, :1]) / SMALL
    errors = np.log(found.factors * hidden[found.nodes])
    errors -= errors.mean()
    best = np.linalg.lstsq(slopes, -errors)[0]
    rest = 100.0 * (errors + slopes @ best)
    a, b = best
    return (
        f"with a tilt of {a:.4f} and {b:.4f}, by the hidden factors, off by {rest.std():.3f} %, "
        f"at most {np.abs(rest).max():.3f} %"
    )


def tilt_of_loops(
    found: Reconstruction, frames: FrameSequence, hidden: np.ndarray, cache: str | None
) -> str:
    """The tilt that loops tell, and errors of factors once depths are straightened by it."""
    views = dict(zip(found.nodes.tolist(), views_of(found), strict=True))
    loops = [pair for pair in found.pairs[found.odometry :] if {pair.i, pair.j} <= views.keys()]
    tilt = depth_tilt(loops, views, camera_of(found))
    said = f"with a tilt of {tilt[0]:.4f} and {tilt[1]:.4f}, by loops"
    if not any(tilt):
        return said
    straight = StraightenedSequence.of(frames, tilt)
    again = certpgo.reconstruct(straight, SCALES, colour=found.colour, cache=cache)
    return f"{said}, {scale_errors(again.factors, hidden[again.nodes])}"


def camera_of(found: Reconstruction) -> Camera:
    """The camera of keypoints."""
    return found.frames.camera if found.colour is None else found.colour.camera


def views_of(found: Reconstruction) -> list[Features]:
    """Keypoints of the nodes, in the map's unit."""
    views, frames = [], found.frames
    for k in found.nodes.tolist():
        frame = frames.frame(k)
        where = {"colour": found.colour, "cutoff": np.inf}
        views.append(place(*detect(frame), frame.depth, frames.camera, **where))
    return views


def row(name: str, cache: str | None) -> str:
    """The line of a sequence: true depths with clouds and without, then hidden factors."""
    folder, errors = DATA / "rgbd" / name, []
    frames = synthetic_sequence() if name == "room" else certpgo.read_sequence(folder)
    for dense in (True, False):
        found = certpgo.reconstruct(frames, ReconstructSettings(dense=dense), cache=cache)
        errors.append(trajectory_error(found.estimate, frames.truth.subset(found.nodes)))
    hidden = hidden_factors(len(frames))
    scaled = with_factors(frames, hidden)
    found = certpgo.reconstruct(scaled, SCALES, cache=cache)
    truth = frames.truth.subset(found.nodes)
    own = trajectory_error(found.estimate, truth)
    # As --depth-factors does: depths as they are, times the factors.
    known = with_factors(scaled.chosen(found.nodes.tolist()), found.factors)
    again = certpgo.reconstruct(known, cache=cache)
    rigid = trajectory_error(again.estimate, known.truth.subset(again.nodes))
    tilts = [tilt_of_factors(found, hidden)]
    if found.colour is not None:
        tilts.insert(0, tilt_of_loops(found, scaled, hidden, cache))
    return (
        f"{name:14}true depth {errors[0]:.3f} mm, by keypoints alone {errors[1]:.3f} mm; hidden "
        f"factors {own:.3f} mm, {own / errors[0]:.2f} and {own / errors[1]:.2f} times; "
        f"with the factors found, by clouds too {rigid:.3f} mm, {rigid / errors[0]:.2f} times; "
        f"{scale_errors(found.factors, hidden[found.nodes])}; "
        f"{ratio_errors(found, hidden)}; {'; '.join(tilts)}; "
        f"{found.answer.verdict.value}, {len(found.nodes)} of {len(frames)} frames"
    )


def bunny() -> str:
    """The line of the bunny's scans: a third of the matches wrong, the others nearest points."""
    folder = DATA / "scans" / "bunny"
    names = sorted(path.name for path in folder.glob("*.ply"))
    scans = [read_scan(folder / name) for name in names]
    where = read_initial(folder / "bun.conf", names)
    poses = zip(scans, where.rotations, where.translations, strict=True)
    world = [scan.points @ R.T + t for scan, R, t in poses]
    rng, matches = np.random.default_rng(0), []
    for i, j in combinations(range(len(scans)), 2):
        distance, nearest = cKDTree(world[i]).query(world[j], distance_upper_bound=NEAR)
        met = np.flatnonzero(np.isfinite(distance))
        if len(met) < 2000:
            continue
        chosen = rng.choice(met, MATCHES, replace=False)
        rows = np.stack([nearest[chosen], chosen], axis=1)
        rows[:WRONG, 0] = rng.integers(len(world[i]), size=WRONG)
        matches.append(ScanMatches(i, j, rows))
    hidden = hidden_factors(len(scans))
    scaled = [Scan(s.name, f * s.points) for s, f in zip(scans, hidden, strict=True)]
    found = register_submaps(scaled, matches)
    agreeing = sum(len(pair.p) for pair in found.pairs)
    return (
        f"bunny         {len(scans)} scans, {agreeing} of {found.total.sum()} matches agree; "
        f"{scale_errors(found.estimate.scales, hidden)}; {found.solution.verdict.value}"
    )


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    known = ("bunny", "redwood5", "room", "seven_scenes")
    parser.add_argument("parts", nargs="*", default=known)
    parser.add_argument("--cache")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    for part in asked.parts:
        print(bunny() if part == "bunny" else row(part, asked.cache), flush=True)


if __name__ == "__main__":
    main()

"""Factors of depths and scales of sub-maps, recovered from hidden ones.

    python -m reports.studies.unknown_scales [room] [redwood5] [seven_scenes] [bunny] [--cache DIR]

The depth of each frame, or each scan, is multiplied by a hidden factor between .5 and 2. Errors of
factors are those of their logarithms, about their mean; those of positions are root mean squares
after the best similarity. Data are looked for in the folders ``rgbd`` and ``scans`` of
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
from certpgo.registration.depth_scales import with_factors
from certpgo.registration.procrustes import extended_procrustes
from certpgo.registration.reconstruct import Reconstruction, ReconstructSettings
from certpgo.registration.scans import Scan, read_initial, read_scan
from certpgo.registration.submaps import ScanMatches, register_submaps
from certpgo.registration.synthetic import synthetic_sequence

DATA = Path(os.environ.get("CERTPGO_DATA", "."))
#: Matches of two scans of the bunny, how many of them are wrong, and how near points are, metres.
MATCHES, WRONG, NEAR = 300, 100, 0.0005


def hidden_factors(n: int) -> np.ndarray:
    """(n,) between .5 and 2, uniform in their logarithms."""
    return np.exp(np.random.default_rng(0).uniform(np.log(0.5), np.log(2.0), n))


def trajectory_error(estimate: Estimate, truth: Estimate) -> float:
    """Root mean square of positions after the best similarity, millimetres."""
    t, true = estimate.translations, truth.translations
    [R], [shift], [s] = extended_procrustes(true[None], t[None])
    return float(1e3 * np.sqrt(((s * t @ R.T + shift - true) ** 2).sum(axis=1).mean()))


def scale_errors(found: np.ndarray, hidden: np.ndarray) -> str:
    """Errors of logarithms of factors: root mean square, and the largest, per cent."""
    off = np.log(found * hidden)
    off = 100.0 * (off - off.mean())
    return f"factors off by {off.std():.3f} %, at most {np.abs(off).max():.3f} %"


def ratio_errors(found: Reconstruction, hidden: np.ndarray) -> str:
    """Errors of the logarithms of measured ratios, root mean squares, per cent."""
    graph, factors = found.instance.graph, np.log(found.factors * hidden[found.nodes])
    i, j = graph.edges.T
    off = 100.0 * (np.log(graph.scales) - factors[i] + factors[j])
    steps = np.diff(found.nodes[graph.edges], axis=1)[:, 0] <= 2
    said = [
        f"{np.sqrt(np.mean(off[chosen] ** 2)):.2f}" for chosen in (steps, ~steps) if chosen.any()
    ]
    return f"ratios of steps and loops off by {' and '.join(said)} %"


def row(name: str, cache: str | None) -> str:
    """The line of a sequence: true depths with clouds and without, then hidden factors."""
    folder, errors = DATA / "rgbd" / name, []
    frames = synthetic_sequence() if name == "room" else certpgo.read_sequence(folder)
    for dense in (True, False):
        found = certpgo.reconstruct(frames, ReconstructSettings(dense=dense), cache=cache)
        errors.append(trajectory_error(found.estimate, frames.truth.subset(found.nodes)))
    hidden = hidden_factors(len(frames))
    settings = ReconstructSettings(scales=True)
    found = certpgo.reconstruct(with_factors(frames, hidden), settings, cache=cache)
    own = trajectory_error(found.estimate, frames.truth.subset(found.nodes))
    return (
        f"{name:14}true depth {errors[0]:.3f} mm, by keypoints alone {errors[1]:.3f} mm; hidden "
        f"factors {own:.3f} mm, {own / errors[0]:.2f} and {own / errors[1]:.2f} times; "
        f"{scale_errors(found.factors, hidden[found.nodes])}; "
        f"{ratio_errors(found, hidden)}; {found.answer.verdict.value}, "
        f"{len(found.nodes)} of {len(frames)} frames"
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

"""Scans registered from ever farther off: the Stanford bunny and a LiDAR pair.

    python -m reports.studies.scans [FOLDER]

FOLDER holds ``bunny`` and ``lidar``; by default that is ``scans`` in the folder that CERTPGO_DATA
names. Each scan of the bunny is turned about its centre by an angle about a random axis, for every
seed, and registered by either method. Prints rows of Markdown: how far points are from where
bun.conf puts them (itself an alignment, not truth), rms after the best common motion, before and
after; whether global ICP met the rule of its end; the verdict; and CPU seconds. "about" is the
origin for the last rows: scans are then misplaced by a quarter of the bunny, which is too far.

For the LiDAR pair: errors against its transformation, in metres and degrees.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np

from certpgo import Estimate, register
from certpgo.errors import CertPGOError
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.scans import Scan, read_initial, read_scan

HEADER = (
    "| method | turned | about | seed | before, mm | after, mm | met | verdict | gap / F | CPU s |"
)
METHODS = ("global_icp", "pose_graph")
BUNNY = [f"bun{k:03}.ply" for k in (0, 45, 90, 180, 270, 315)]
BUNNY += ["top2.ply", "top3.ply", "chin.ply", "ear_back.ply"]


def turned(
    scans: list[Scan], truth: Estimate, degrees: float, seed: int, *, centred: bool = True
) -> Estimate:
    """Each scan turned about its centre, or the origin of its own frame."""
    axes = np.random.default_rng(seed).standard_normal((len(scans), 3))
    axes *= np.radians(degrees) / np.linalg.norm(axes, axis=1, keepdims=True)
    R = truth.rotations @ so.exp(axes)
    centres = np.array([centred * scan.points.mean(axis=0) for scan in scans])
    shift = np.einsum("nab,nb->na", truth.rotations - R, centres)
    return Estimate(R, truth.translations + shift)


def point_rms(scans: list[Scan], estimate: Estimate, truth: Estimate) -> float:
    """Distance of points from where the truth puts them, rms, metres."""
    here, there = (centred(scans, e) for e in (estimate, truth))
    S = so.project((there.T @ here)[None])[0]
    return float(np.sqrt(np.mean(np.sum((here @ S.T - there) ** 2, axis=1))))


def centred(scans: list[Scan], estimate: Estimate) -> FloatArray:
    """Every tenth point of all scans, about their centre."""
    poses = zip(scans, estimate.rotations, estimate.translations, strict=True)
    points = np.concatenate([scan.points[::10] @ R.T + t for scan, R, t in poses])
    return points - points.mean(axis=0)


def bunny(folder: Path, seeds: int) -> None:
    """The rows of the bunny."""
    scans = [read_scan(folder / name) for name in BUNNY]
    conf = read_initial(folder / "bun.conf", BUNNY)
    print(HEADER, "|---|---|---|---|---|---|---|---|---|---|", sep="\n")
    cases = [(angle, seed, True) for angle in (5, 10, 20) for seed in range(seeds)]
    cases += [(angle, 0, False) for angle in (5, 10, 20)]
    for method in METHODS:
        for angle, seed, about in cases:
            begin = turned(scans, conf, angle, seed, centred=about)
            row = f"| {method} | {angle} | {'centre' if about else 'origin'} | {seed} "
            row += f"| {1e3 * point_rms(scans, begin, conf):.2f} "
            start = time.process_time()
            try:
                found = register(scans, begin, method=method)
            except CertPGOError as error:
                print(f"{row}| {error} |", flush=True)
                continue
            seconds = time.process_time() - start
            after, solved = 1e3 * point_rms(scans, found.estimate, conf), found.solution
            verdict = "" if solved is None else solved.verdict.value
            gap = "" if solved is None else f"{solved.certificate.gap / solved.cost:.1e}"
            met = "yes" if found.coarse.converged else "no"
            print(f"{row}| {after:.3f} | {met} | {verdict} | {gap} | {seconds:.1f} |", flush=True)


def lidar(folder: Path) -> None:
    """The rows of the LiDAR pair."""
    T = np.loadtxt(folder / "T_target_source.txt")
    print(
        "\n| method | off, cm | off, degrees | met | verdict | CPU s |\n|---|---|---|---|---|---|"
    )
    for method in METHODS:
        start = time.process_time()
        found = register([folder / "target.ply", folder / "source.ply"], method=method)
        seconds = time.process_time() - start
        R, t = found.estimate.rotations[1], found.estimate.translations[1]
        verdict = "" if found.solution is None else found.solution.verdict.value
        angle = np.degrees(so.angle(so.project(T[None, :3, :3])[0].T @ R))
        met = "yes" if found.coarse.converged else "no"
        shift = 100 * np.linalg.norm(t - T[:3, 3])
        print(f"| {method} | {shift:.2f} | {angle:.3f} | {met} | {verdict} | {seconds:.1f} |")


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTPGO_DATA", ".")) / "scans"
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    bunny(arguments.folder / "bunny", arguments.seeds)
    lidar(arguments.folder / "lidar")


if __name__ == "__main__":
    main()

"""The figures of the front end: rooms, a repeated wallpaper, real frames, and RANSAC.

    python -m reports.studies.registration [rooms] [wallpaper] [redwood5] [seven_scenes] [ransac]

Real frames are looked for in the folder ``rgbd`` of CERTPGO_DATA. Seconds are of the processor.
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np

import certpgo
from certpgo.linalg import rotations as so
from certpgo.registration.ransac import register
from certpgo.registration.reconstruct import ReconstructSettings
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.synthetic import synthetic_sequence
from certpgo.solve.metrics import angular_errors, position_errors

#: An edge is wrong beyond this: metres, degrees.
WRONG = 0.1, 3.0
SEEDS = range(10)


def row(frames: FrameSequence, **options: object) -> str:
    """The line of a sequence."""
    begin = time.process_time()
    found = certpgo.reconstruct(frames, ReconstructSettings(**options))
    seconds = time.process_time() - begin
    R, t = frames.truth.rotations, frames.truth.translations
    truth, wrong = frames.truth.subset(found.nodes), 0
    for k in found.averaged.chosen[found.averaged.kept]:
        pair = found.pairs[k]
        angle = np.degrees(so.angle(pair.R.T @ R[pair.i].T @ R[pair.j]))
        shift = np.linalg.norm(R[pair.i].T @ (t[pair.j] - t[pair.i]) - pair.t)
        wrong += bool(shift > WRONG[0] or angle > WRONG[1])
    errors = []
    for estimate in (found.dead_reckoning, found.estimate):
        if estimate.num_nodes != truth.num_nodes:
            errors.append("-")
            continue
        off = position_errors(estimate, truth).rmse, angular_errors(estimate, truth).rmse_deg
        errors.append(f"{1e3 * off[0]:.2f} mm {off[1]:.3f} deg")
    kept = f"{int(found.averaged.kept.sum())}/{len(found.averaged.kept)}"
    verdict = found.answer.verdict.value
    return (
        f"{frames.name:24}{verdict:10}{len(found.nodes):5}/{len(frames):<5}{kept:>9}{wrong:4} "
        f"wrong  odometry {errors[0]:20} certified {errors[1]:20} {seconds:6.1f} s"
    )


def ransac() -> str:
    """Inliers found among 60 % outliers, and milliseconds, over 1000 trials."""
    shares, begin, noise = [], time.process_time(), np.tile(2e-6 * np.eye(3), (300, 1, 1))
    for seed in range(1000):
        rng = np.random.default_rng(seed)
        R, t = so.random(rng, 1, 3)[0], rng.uniform(-2, 2, 3)
        q = rng.uniform([-1, -1, 1], [1, 1, 3], (300, 3))
        p = q @ R.T + t + 0.002 * rng.standard_normal((300, 3))
        p[:180] += rng.uniform(-1, 1, (180, 3))
        motion = register(p, q, (noise, noise), rng)
        shares.append(0.0 if motion is None else motion.inliers[180:].mean())
    ms = time.process_time() - begin
    least = f"{np.mean(np.array(shares) >= 0.95):.1%} of the trials find 95 %"
    return f"ransac: {np.mean(shares):.2%} of the inliers on average, {least}; {ms:.1f} ms a trial"


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    known = ("rooms", "wallpaper", "redwood5", "seven_scenes", "ransac")
    parser.add_argument("parts", nargs="*", default=known)
    parts = parser.parse_args().parts
    warnings.simplefilter("ignore")
    for seed in SEEDS if "rooms" in parts else ():
        print(seed, row(synthetic_sequence(seed=seed)), flush=True)
    for seed in SEEDS if "wallpaper" in parts else ():
        print(seed, row(synthetic_sequence(seed=seed, wallpaper=True)), flush=True)
    if "wallpaper" in parts:
        print("no gate:", row(synthetic_sequence(wallpaper=True), gate=False), flush=True)
    for name in ("redwood5", "seven_scenes"):
        if name in parts:
            folder = Path(os.environ.get("CERTPGO_DATA", ".")) / "rgbd" / name
            print(row(certpgo.read_sequence(folder)), flush=True)
    if "ransac" in parts:
        print(ransac())


if __name__ == "__main__":
    main()

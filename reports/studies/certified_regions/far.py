"""An estimate of MIT that is certified, and metres from the optimum: what is said of it."""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import certpgo
from certpgo.io import datasets
from reports.studies.certified_regions.public import Moves, in_turn, moved, solved

NAME, REFERENCE = "MIT", 0
#: What the estimate costs more than the optimum, of the optimum: less than verdicts allow.
EXCESS = 0.95e-5
#: Runs of the command.
COMMANDS = 3


def row() -> dict[str, Any]:
    """How far it is, how far it is said to be, and how long that takes."""
    answer = solved(NAME, "chordal")
    best, distance = answer.certificate.best, answer.certificate.distance_from(REFERENCE)
    node = distance.node
    region = answer.certificate.region(node, REFERENCE, excess=1.0)
    _, along, _ = Moves(answer, REFERENCE).of(node, region.shape)
    far = moved(best, np.sqrt(EXCESS * answer.cost) * along)
    problem = certpgo.Quadratic(datasets.load(NAME).graph)

    def verdict() -> certpgo.Certificate:
        return certpgo.certify(problem, far)

    alone, both = in_turn(verdict, lambda: verdict().distance_from(REFERENCE))
    judged = verdict()
    t = [x.translations - x.translations[REFERENCE] for x in (best, far)]
    u = t[0] @ best.rotations[REFERENCE] - t[1] @ far.rotations[REFERENCE]
    return {
        "verdict": str(judged.verdict),
        "relative gap": judged.relative_gap,
        "metres off": float(np.linalg.norm(u, axis=1).max()),
        "proven metres": judged.distance_from(REFERENCE).largest[0],
        "verdict ms": 1e3 * median(alone),
        "verdict and distance ms": 1e3 * median(both),
        "command s": _command(far),
    }


def _command(far: certpgo.Estimate) -> float:
    """Process seconds of the whole command."""
    took = []
    source = datasets.dataset(NAME).path()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "far.g2o"
        certpgo.write(path, far)
        asked = ("certify", source, path, "--cost", "chordal", "--reference", REFERENCE)
        for _ in range(COMMANDS):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            command = [sys.executable, "-m", "certpgo", *map(str, asked)]
            subprocess.run(command, check=True, capture_output=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            took.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return float(median(took))

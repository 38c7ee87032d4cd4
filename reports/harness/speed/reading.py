"""Reading: the first file of a process, one after another, and a million edges."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from certpgo.graph import Graph, PoseGraph, RotationGraph
from certpgo.io import datasets, write
from certpgo.linalg import rotations as so
from reports.harness.speed.measuring import Comparison, Group, Lap, Timer, Timers
from reports.harness.speed.programs import python

SECTION = "reading"
#: Reads a file so many times, and prints what the last time took; NumPy and SciPy are there.
CERTPGO = """
import sys, time, warnings
import numpy, scipy.sparse, scipy.linalg
import certpgo
warnings.simplefilter("ignore")
for _ in range(int(sys.argv[2])):
    start = time.process_time()
    certpgo.read(sys.argv[1])
print(time.process_time() - start)
"""
GTSAM = """
import sys, time
import gtsam
for _ in range(int(sys.argv[2])):
    start = time.process_time()
    gtsam.readG2o(sys.argv[1], sys.argv[3] == "3")
print(time.process_time() - start)
"""
FIRST, WARM, THEIRS = "first reading of a process", "third reading", "GTSAM's third reading"
ONCE, THEIRS_ONCE = "reading", "GTSAM's reading"
#: Nodes of the graph of a million edges, and of the quick one.
LARGE, SMALL = (400_000, 1_000_000), (400, 1_000)


def groups(quick: bool) -> Iterator[Group]:
    """Public files, and files that are made."""
    comparisons = (
        Comparison(FIRST, WARM, 1.5),
        Comparison(WARM, THEIRS, 1.0),
    )
    for name, d in (("intel", 2), ("sphere2500", 3), ("torus3D", 3))[: 1 if quick else 3]:
        timers = functools.partial(_public, name, d)
        yield Group(SECTION, name, timers, comparisons, rounds=1 if quick else 5)
    n, m = SMALL if quick else LARGE
    timers = functools.partial(_made, n, m)
    once = (Comparison(ONCE, THEIRS_ONCE, 1.0),)
    yield Group(SECTION, f"{m:,} random edges", timers, once, rounds=1 if quick else 2)


@contextmanager
def _public(name: str, d: int) -> Iterator[Timers]:
    path = datasets.fetch(name, download=False)
    yield {
        FIRST: _printed(CERTPGO, path, 1),
        WARM: _printed(CERTPGO, path, 3),
        THEIRS: _printed(GTSAM, path, 3, d),
    }


@contextmanager
def _made(n: int, m: int) -> Iterator[Timers]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.g2o"
        write(path, random_graph(n, m))
        yield {ONCE: _printed(CERTPGO, path, 1), THEIRS_ONCE: _printed(GTSAM, path, 1, 3)}


def _printed(script: str, path: Path, *arguments: int) -> Timer:
    """A timer of a script that prints its own seconds."""
    step = python("-c", script, str(path), *map(str, arguments))
    megabytes = path.stat().st_size / 1e6

    def lap() -> Lap:
        seconds = float(step())
        return Lap(seconds, f"{megabytes / seconds:.0f} MB/s")

    return lap


def random_graph(n: int, m: int, d: int = 3) -> Graph:
    """A chain of n poses with random further edges, m in all."""
    rng = np.random.default_rng(0)
    i = np.r_[np.arange(n - 1), rng.integers(0, n, m - n + 1)]
    j = np.r_[np.arange(1, n), (i[n - 1 :] + rng.integers(1, n, m - n + 1)) % n]
    rotation = RotationGraph(n, np.c_[i, j], so.random(rng, m, d), np.ones(m))
    return PoseGraph(rotation, rng.standard_normal((m, d)), np.ones(m))

"""Processes: what starting Python and a whole command take, and SE-Sync where it is built."""

from __future__ import annotations

import functools
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from certpgo.errors import CertPGOError
from certpgo.io import datasets
from reports.harness.experiments.absence import Absence, Missing
from reports.harness.speed.measuring import Comparison, Group, Lap, Timer, Timers, processor

SECTION = "processes"
#: What our imports rest on.
FOUNDATIONS = "import numpy, scipy.sparse, scipy.linalg"
#: GTSAM reads a file and optimises it from the file's own initial values.
GTSAM_SOLVES = """
import sys, gtsam
graph, values = gtsam.readG2o(sys.argv[1], False)
noise = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)
graph.add(gtsam.PriorFactorPose2(0, values.atPose2(0), noise))
gtsam.GaussNewtonOptimizer(graph, values).optimize()
"""
EMPTY, IMPORTS, GTSAM = "python -c pass", "import of NumPy and SciPy", "GTSAM's script"


#: The environment variable with the path of a build of SE-Sync, which prints its own seconds.
SE_SYNC_VARIABLE = "CERTPGO_SESYNC"
_SE_SYNC_SECONDS = re.compile(r"Total elapsed computation time: ([0-9.e+-]+)")


def se_sync(path: Path) -> Timer | Missing:
    """A timer of SE-Sync's own seconds for a file, without reading, where there is a build."""
    named = os.environ.get(SE_SYNC_VARIABLE)
    if not named:
        said = f"SE-Sync is not here: {SE_SYNC_VARIABLE} names the program of a build"
        return Missing(Absence.MISSING_PACKAGE, said)
    if (found := shutil.which(named)) is None:
        return Missing(Absence.FAILED, f"{SE_SYNC_VARIABLE}: {named} is no program")

    def lap() -> Lap:
        times = _SE_SYNC_SECONDS.findall(run([found, str(path)]))
        if not times:
            raise CertPGOError(f"SE-Sync printed no seconds for {path.name}")
        return Lap(float(times[-1]))

    return lap


def run(command: Sequence[str]) -> str:
    """What a process prints, run in an empty folder of its own.

    Raises
    ------
    CertPGOError
        It fails.
    """
    # Compiled modules are kept, as they are for a user.
    variables = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            command,
            cwd=folder,
            env=variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
    if done.returncode:
        said = [line.strip() for line in done.stdout.splitlines() if line.strip()][-1:]
        ended = f"{Path(command[0]).name} ended with code {done.returncode}"
        raise CertPGOError(": ".join([ended, *said]))
    return done.stdout


def python(*arguments: str) -> Callable[[], str]:
    """A step that runs this Python with arguments."""
    return functools.partial(run, [sys.executable, *arguments])


def groups(quick: bool) -> Iterator[Group]:
    """Start-up, and whole commands on one public graph."""
    rounds = 1 if quick else 5
    ours = ("import certpgo", "certpgo --version", "certpgo --help")
    comparisons = (
        Comparison(ours[0], IMPORTS, 1.3),
        *(Comparison(name, EMPTY) for name in ours),
        Comparison(IMPORTS, EMPTY),
    )
    yield Group(SECTION, "start-up", _start_up, comparisons, rounds)
    name = "intel"
    commands = tuple(
        comparison
        for what, goal in (("solve", 1.5), ("info", 1.2))
        for comparison in (
            Comparison(f"certpgo {what}", IMPORTS, goal),
            Comparison(f"certpgo {what}", GTSAM),
        )
    )
    yield Group(SECTION, name, functools.partial(_commands, name), commands, rounds)


@contextmanager
def _start_up() -> Iterator[Timers]:
    yield {
        "import certpgo": processor(python("-c", "import certpgo")),
        "certpgo --version": processor(python("-m", "certpgo", "--version")),
        "certpgo --help": processor(python("-m", "certpgo", "--help")),
        EMPTY: processor(python("-c", "pass")),
        IMPORTS: processor(python("-c", FOUNDATIONS)),
    }


@contextmanager
def _commands(name: str) -> Iterator[Timers]:
    path = str(datasets.fetch(name, download=False))
    yield {
        "certpgo solve": processor(python("-m", "certpgo", "solve", path)),
        "certpgo info": processor(python("-m", "certpgo", "info", path)),
        IMPORTS: processor(python("-c", FOUNDATIONS)),
        GTSAM: processor(python("-c", GTSAM_SOLVES, path)),
    }

"""Provenance of a result: versions, machine, engine and commit."""

from __future__ import annotations

import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path

#: Kibibytes in a gigabyte.
KIB = 1024 / 1e9
#: Distributions whose versions are recorded.
DISTRIBUTIONS = ("certpgo", "numpy", "scipy", "gtsam", "g2opy", "pyceres")

#: Variables that limit the threads of NumPy's linear algebra, the one that prevails first.
THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")


def provenance(engine: str, root: Path | None) -> dict[str, str]:
    """The software and the machine behind a result.

    Parameters
    ----------
    engine : factorization engine
    root : checkout whose commit is recorded, or None
    """
    return {
        "versions": ", ".join(_versions()),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "engine": engine,
        "threads": next((os.environ[name] for name in THREADS if name in os.environ), "default"),
        "commit": _commit(root),
        "date": datetime.now(UTC).strftime("%Y-%m-%dT%H:%MZ"),
    }


def peak_memory() -> float:
    """Gigabytes that this process has held at most; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:
        return math.nan
    unit = 1e-9 if sys.platform == "darwin" else KIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _versions() -> Iterator[str]:
    for name in DISTRIBUTIONS:
        try:
            yield f"{name} {metadata.version(name)}"
        except metadata.PackageNotFoundError:
            continue


@cache
def _commit(root: Path | None) -> str:
    if root is None or not (root / ".git").exists():
        return "unknown"
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude=*"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()

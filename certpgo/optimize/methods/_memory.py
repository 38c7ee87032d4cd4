"""Refusing problems that would not fit into memory, before the solver is killed.

With N = dn, m the scalars of the program and T(k) = k (k + 1)/2, peak memory is about

    Clarabel       55 sum T(k)^2 + 170 N^2    bytes, over the sides k of its cones
    SCS            800 N^2
    CVXOPT         (12 N^2 + 24 m) m
    others         24 m^2 + 400 N^2           not measured

A cone is the whole matrix or, if Clarabel decomposes it, a maximal clique of its chordal extension.
Measured with Clarabel 0.11, SCS 3.3 and CVXOPT 1.3 on CVXPY 1.9, which itself needs about 170 N^2;
accurate to a factor of two from 50 MB on, for random graphs, cycles and grids.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.objective.quadratic import Quadratic

GIGA = 1e9
#: Where Linux reports memory, and limits of control groups.
PROC, CGROUP = Path("/proc"), Path("/sys/fs/cgroup")


def bytes_needed(program: str, N: int, scalars: int, cones: Iterable[int]) -> float:
    """Approximate peak memory of a program.

    Parameters
    ----------
    program : the solver's name in CVXPY
    N : side of the semidefinite matrix
    scalars : unknowns of the program
    cones : sides of the semidefinite cones that an interior-point method keeps dense
    """
    square, m = float(N) ** 2, float(scalars)
    if program == "CLARABEL":
        return 55.0 * sum((k * (k + 1) / 2.0) ** 2 for k in cones) + 170.0 * square
    if program == "SCS":
        return 800.0 * square
    if program == "CVXOPT":
        return (12.0 * square + 24.0 * m) * m
    return 24.0 * m**2 + 400.0 * square


def refuse(needed: float, what: str, instead: str = "", others: float = math.inf) -> None:
    """Raise an InputError if ``what`` needs more bytes than are available.

    Parameters
    ----------
    instead, others : an alternative, and the bytes it needs; suggested if it fits
    """
    available = available_bytes()
    if available is not None and needed > available:
        smaller = f"; {instead} would take {others / GIGA:.1f} GB" if others < available else ""
        raise InputError(
            f"{what} would take about {needed / GIGA:.1f} GB for this graph, and "
            f"{available / GIGA:.1f} GB are free{smaller}; to try anyway, force it: "
            "force=True, solve --set force=true, bounds --force"
        )


def available_bytes() -> float | None:
    """Memory available without swapping; all memory if only that is known; or None.

    At most what is left of the process's control group, as in containers.
    """
    known = [found for found in (_machine_bytes(), *_group_bytes()) if found is not None]
    return min(known, default=None)


def _machine_bytes() -> float | None:
    try:
        for line in (PROC / "meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return None


def _group_bytes() -> Iterator[float]:
    """What is left within the limits of the control group and its parents, version 2 and 1."""
    try:
        lines = (PROC / "self" / "cgroup").read_text().splitlines()
    except OSError:  # not Linux
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = CGROUP, ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):
            root, names = CGROUP / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        group = root / path.lstrip("/")
        for folder in (group, *group.parents):
            with suppress(OSError, ValueError):  # not here, or "max"
                limit, used = (float((folder / name).read_text()) for name in names)
                yield max(limit - used + _cached_bytes(folder), 0.0)
            if folder == root:
                break


def _cached_bytes(folder: Path) -> float:
    """The file cache, which is freed when memory is short."""
    entries = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    return float(entries.get("total_inactive_file", entries.get("inactive_file", 0)))


def clique_sizes(problem: Quadratic) -> list[int]:
    """Nodes in each maximal clique of the chordal extension by the fill-reducing order."""
    place = np.argsort(problem.order)
    later: list[set[int]] = [set() for _ in range(problem.n)]
    for i, j in place[problem.graph.edges].tolist():
        later[min(i, j)].add(max(i, j))
    for front in later:
        if front:
            parent = min(front)
            later[parent] |= front - {parent}
    maximal = [True] * problem.n
    for front in later:
        if front and len(front) > len(later[min(front)]):  # all of the parent's clique
            maximal[min(front)] = False
    return [1 + len(front) for front, kept in zip(later, maximal, strict=True) if kept]

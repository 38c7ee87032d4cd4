"""Refusing what would not fit into memory, before a solver is killed for it."""

from __future__ import annotations

import os
from pathlib import Path

from certpgo.errors import InputError
from certpgo.linalg.arrays import IntArray
from certpgo.problem import RotationProblem

GIGA = 1e9


def refuse(needed: float, what: str) -> None:
    """Refuse a computation that takes more bytes than there are.

    Raises
    ------
    InputError
        Too many.
    """
    available = available_bytes()
    if available is not None and needed > available:
        raise InputError(
            f"{what} would take about {needed / GIGA:.3g} GB for this graph, and "
            f"{available / GIGA:.3g} GB are free; force=True (--set force=true) tries anyway"
        )


def available_bytes() -> float | None:
    """Memory that can be had without swapping; all there is where no more is known; or None."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # no such call, as on Windows
        return None


def clique_sizes(problem: RotationProblem) -> list[int]:
    """Numbers of nodes of the maximal cliques that eliminating the nodes in order makes."""
    pattern, order = problem.pattern, problem.order
    place = order.argsort()
    later: list[set[int]] = [set() for _ in range(problem.n)]
    i, j = place[problem.graph.edges.T]
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        later[min(a, b)].add(max(a, b))
    maximal = [True] * problem.n
    for node, front in enumerate(later):
        if front:
            parent = min(front)
            before = len(later[parent])
            later[parent] |= front - {parent}
    return [1 + len(front) for front in later]

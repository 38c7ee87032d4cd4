"""The SLAM sets of Appendix C: the thesis' reading of them, and its estimates."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from certpgo import Estimate, PoseProblem
from certpgo.solvers.eigen_ma import EigenMA

from . import _scenes
from ._maps import SETS

ABSENT_NOTE = (
    "The thesis has six sets; grid3D and rim are fetched on their own and can be far larger, and "
    "are left out."
)


def problems(quick: bool, data: Path | None) -> Iterator[tuple[str, PoseProblem, EigenMA]]:
    """The sets here, by the thesis' names, every edge weighing 1, with EigenMA as it had it.

    Raises
    ------
    InputError
        None is here.
    """
    names = _scenes.here(tuple(SETS), data)
    for name in names[:1] if quick else names:
        title, reading, anchor = SETS[name]
        graph = _scenes.load(name, data, unit_weights=True, **reading).graph
        yield title, PoseProblem(graph), EigenMA(translations="thesis", anchor=anchor, tol=1e-10)


def eigen_ma(problem: PoseProblem, method: EigenMA) -> Estimate:
    """EigenMA's estimate."""
    return method.solve(problem).estimate

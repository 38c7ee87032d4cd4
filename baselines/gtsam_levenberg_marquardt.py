"""GTSAM's Levenberg-Marquardt optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ._local_search import LocalSearch


@dataclass(frozen=True)
class LevenbergMarquardt(LocalSearch):
    """GTSAM's Levenberg-Marquardt from its chordal initialization; settings as `LocalSearch`."""

    optimizer: ClassVar[str] = "LevenbergMarquardt"


SOLVER = LevenbergMarquardt

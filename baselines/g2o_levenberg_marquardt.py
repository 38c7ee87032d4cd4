"""g2o's Levenberg-Marquardt optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ._g2o import Optimizer


@dataclass(frozen=True)
class LevenbergMarquardt(Optimizer):
    """g2o's Levenberg-Marquardt from GTSAM's chordal initialization; settings as `ChiSquared`."""

    algorithm: ClassVar[str] = "Levenberg"


SOLVER = LevenbergMarquardt

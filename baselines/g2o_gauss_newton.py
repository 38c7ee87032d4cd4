"""g2o's Gauss-Newton optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ._g2o import Optimizer


@dataclass(frozen=True)
class GaussNewton(Optimizer):
    """g2o's Gauss-Newton from GTSAM's chordal initialization; settings as `ChiSquared`."""

    algorithm: ClassVar[str] = "GaussNewton"


SOLVER = GaussNewton

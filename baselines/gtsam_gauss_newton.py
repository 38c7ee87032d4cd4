"""GTSAM's Gauss-Newton optimizer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ._local_search import LocalSearch


@dataclass(frozen=True)
class GaussNewton(LocalSearch):
    """GTSAM's Gauss-Newton from its chordal initialization; see `LocalSearch` for the settings."""

    optimizer: ClassVar[str] = "GaussNewton"


SOLVER = GaussNewton

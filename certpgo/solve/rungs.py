"""What `certpgo.solve.bounds_table` says of a graph: a rung for each bound."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from certpgo.certify import Certificate
from certpgo.certify.cycles import CycleProof
from certpgo.graph.phrases import bound_shown

About = Literal["cost", "angle", "ratio", "stiffness"]


@dataclass(frozen=True)
class Rung:
    """One bound.

    Attributes
    ----------
    key, title : identifier and name
    about : the bounded quantity: the ``"cost"`` F from below; the residual ``"angle"`` of optimal
        stationary rotations, or the sum of these, radians; the ``"ratio"`` of a node's residuals
        to its weight; or the share of each edge's ``"stiffness"`` that cycles ask for
    value : the bound; None if there is none, for the reason in ``says``
    against : the value compared with it: F, the largest residual angle (or sum), the largest ratio
    holds : whether it shows the estimate (the stationary rotations near it) to be optimal; for
        lower bounds up to `TIGHT`; None without a value
    needs : what its computation requires
    seconds : run time
    says : its implication for the estimate
    """

    key: str
    title: str
    about: About
    value: float | None
    against: float
    holds: bool | None
    needs: str
    seconds: float
    says: str

    @property
    def shown(self) -> str:
        """The value with its unit, or a dash if there is none."""
        if self.value is None:
            return "-"
        if self.about == "angle":
            return f"{math.degrees(self.value):.4g} deg"
        if self.about == "stiffness":
            return f"{self.value:.4g} of the stiffness"
        return (
            bound_shown(self.value) if self.about == "cost" else f"{self.value:.4g} of its weight"
        )


@dataclass(frozen=True, eq=False)
class Ladder:
    """The bounds of a connected graph, cheapest first.

    Attributes
    ----------
    cost : F of the estimate
    given : whether the estimate was given; otherwise the certified pipeline found it
    largest : its largest residual angle, radians
    settled : largest residual angle of the stationary rotations near it, radians, for the
        residual-angle bounds; None where descent reached none
    certificate : certificate of the estimate
    rungs : the bounds
    cycles : what cycles prove of the stationary rotations; None if it was not tried
    """

    cost: float
    given: bool
    largest: float
    settled: float | None
    certificate: Certificate
    rungs: tuple[Rung, ...]
    cycles: CycleProof | None

"""What keeps the gap of a certificate open."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from certpgo.optimize.solution import Status


class LimitedBy(StrEnum):
    """What limits a proven gap.

    Attributes
    ----------
    TIGHT : nothing: the optimum is known, up to the tolerance
    LOOSE : the relaxation, whose optimum is below that of all estimates, as far as is known
    ROUNDING : rounding alone; the proof tier has less of it
    STOPPED : the time: a limit, the monitor or Ctrl-C ended the search
    NO_MINORANT : measurements that have no minorant at the estimate, under another program's cost
    AMBIGUOUS : rejected measurements that the estimate's uncertainty may explain

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph).certificate.limited_by.value
    'tight'
    """

    TIGHT = "tight"
    LOOSE = "loose"
    ROUNDING = "rounding"
    STOPPED = "stopped"
    NO_MINORANT = "no minorant"
    AMBIGUOUS = "ambiguous"


@dataclass(frozen=True)
class Obstacle:
    """What limits a gap, with the numbers that belong to it.

    Attributes
    ----------
    kind : see `LimitedBy`
    searched : whether the relaxation was searched, not only tested at one point
    rank : of the last point of the relaxation, if it was searched
    stopped : what ended the search before it was through; None for its own limit
    patience : seconds after a first bound that its own limit allowed; None if that did not end it
    of_distances : whether the relaxation is that of measured distances
    missing, edge : number of measurements without a minorant, and the nodes of one
    ambiguous : indices of the rejected measurements whose prices are not proven
    mirrored : where positions lie whose mirror image fits as well, or perhaps; None if it does not
    """

    kind: LimitedBy = LimitedBy.TIGHT
    searched: bool = False
    rank: int | None = None
    stopped: Status | None = None
    patience: float | None = None
    of_distances: bool = False
    missing: int = 0
    edge: tuple[int, int] | None = None
    ambiguous: tuple[int, ...] = ()
    mirrored: Literal["line", "plane", "perhaps"] | None = None

    @property
    def ended_early(self) -> bool:
        """Whether a limit, the monitor or Ctrl-C ended the search before it was through."""
        return self.stopped is not None or self.patience is not None

    @property
    def is_final(self) -> bool:
        """Whether the relaxation is solved and not tight, so that no search closes the gap."""
        return self.of_distances and self.searched


#: The gap is closed, up to the tolerance.
NOTHING = Obstacle()

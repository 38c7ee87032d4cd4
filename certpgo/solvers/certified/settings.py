"""Everything that can be set of the certified pipeline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from certpgo.certify import Tier
from certpgo.certify.case import ATOL, RTOL
from certpgo.errors import InputError, SpecError
from certpgo.optimize.newton import NewtonSettings


@dataclass(frozen=True)
class SolveSettings:
    """Limits, tolerances and tuning of `certpgo.solve`.

    Attributes
    ----------
    time_limit : seconds after which to return the best estimate so far; what is under way, such
        as a factorization, is finished first. None: the staircase climbs for no more than
        ``patience`` once a first bound is in hand; `math.inf` lets it go on to the end
    max_rank : dimensions at which the staircase ends; by default d + 7
    try_own_start : where descent from a given initial estimate is not certified, descend from an
        initialization of our own before climbing; the better one counts, and the answer says which
    tier : what the certificate may trust, see `Tier`; by default the standard tier is asked, and
        the proof tier where rounding is all that the former lacks
    rtol, atol : CERTIFIED means gap <= rtol F + atol W
    patience : seconds
    lifted_tolerance : stationarity asked of points of higher rank, over the typical residual
    rank_steps : steps of low-rank optimization at each rank
    rounds : rounds of random roundings in vain, at most, before the answer stands
    round_nodes : nodes in all of these rounds, for at least two
    few : nodes that each further round takes, at least
    negligible : of the tolerance, what is not worth another rank
    same_cost : relative difference of costs that are the same
    hope : steps in which a descent must be able to reach the best answer, at its last step's pace
    newton : of the descents at rank d

    Raises
    ------
    InputError
        A limit or tolerance out of its range.
    SpecError
        Another setting out of its range, an unknown tier.

    Examples
    --------
    >>> from certpgo import SolveSettings
    >>> SolveSettings(time_limit=10.0).rtol
    1e-05
    """

    time_limit: float | None = None
    max_rank: int | None = None
    try_own_start: bool = True
    tier: Tier | str | None = None
    rtol: float = RTOL
    atol: float = ATOL
    patience: float = 30.0
    lifted_tolerance: float = 1e-5
    rank_steps: int = 100
    rounds: int = 10
    round_nodes: int = 1_000
    few: int = 8
    negligible: float = 0.1
    same_cost: float = 1e-9
    hope: float = 20.0
    newton: NewtonSettings = field(
        default_factory=lambda: NewtonSettings(tolerance=1e-11, max_iterations=200)
    )

    def __post_init__(self) -> None:
        if self.time_limit is not None and not self.time_limit >= 0.0:
            raise InputError(f"the time limit must not be negative: {self.time_limit}")
        if not self.patience >= 0.0:
            raise SpecError(f"patience must not be negative: {self.patience}")
        positive = ("lifted_tolerance", "rank_steps", "rounds", "round_nodes", "few", "negligible")
        for name in (*positive, "hope"):
            if not getattr(self, name) > 0:
                raise SpecError(f"{name} must be positive, not {getattr(self, name)}")
        if not 0.0 <= self.same_cost < 1.0:
            raise SpecError(f"same_cost must lie between 0 and 1, not {self.same_cost}")

    def changed(self, options: Mapping[str, Any]) -> SolveSettings:
        """These settings with some replaced.

        Raises
        ------
        SpecError
            An unknown setting.
        """
        known = [f.name for f in fields(self)]
        for name in options:
            if name not in known:
                raise SpecError.unknown("setting of solve", name, known)
        return replace(self, **options)

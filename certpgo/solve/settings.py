"""Settings of the certified pipeline."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from certpgo.certify import Tier
from certpgo.certify.certificate import tier_called
from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.errors import InputError, SpecError, require, require_numbers
from certpgo.optimize.iterative import refuse_mistyped
from certpgo.optimize.riemannian_newton import NewtonSettings

#: Patience, in seconds, with a graph of which many measurements disagree with the rest: the optimum
#: of all of them is hardly worth more.
OUTLIERS_PATIENCE = 2.0
#: Of the descents at rank d: they end as close to the minimum as a certificate can tell.
DESCENTS = NewtonSettings(tolerance=1e-11, max_iterations=200, enough=1e-13)


@dataclass(frozen=True)
class SolveSettings:
    """Limits, tolerances and tuning of `certpgo.solve`.

    Attributes
    ----------
    time_limit : seconds after which to return the best estimate so far, once the current step (such
        as a factorization) is finished. None: the staircase climbs for at most ``patience`` after
        its first bound; `math.inf` removes this limit too
    max_rank : highest rank of the staircase, at least d; by default d + 7
    try_own_start : if descent from a given initial estimate is not certified, also descend from a
        computed initialization before climbing; the better result is used, as its note tells
    try_file_start : descend from the initial values of the instance too, before climbing, if there
        are any and the first descent is not certified; the better result is used
    tier : what the certificate trusts, see `Tier`; by default the standard tier, and the proof tier
        if only rounding prevents CERTIFIED
    rtol, atol : CERTIFIED means gap <= rtol F + atol W, of which the latter is at most 0.001 F
    patience : seconds of climbing after a first bound; ignored if ``time_limit`` is set. Where
        many measurements disagree with the rest, it is at most `OUTLIERS_PATIENCE`. Under the cost
        of another program, the chordal search before it has half of this
    lifted_tolerance : stationarity required at higher ranks, relative to the typical residual, but
        no smaller an angle than ``newton.tolerance``
    rank_steps : steps of low-rank optimization at each rank
    rounds : maximal number of unsuccessful rounds of random roundings
    round_nodes : total number of nodes in all these rounds, which are at least two
    few : number of nodes for each additional round
    negligible : decrease that is not worth another rank, relative to the tolerance
    same_cost : relative difference below which costs count as equal
    hope : number of steps, each as good as the last, within which a descent must be able to reach
        the best cost
    newton : settings of the descents at rank d; ``loosest`` and ``tightest`` are also those of
        low-rank optimization

    Raises
    ------
    InputError
        A limit or tolerance out of its range.
    SpecError
        Another setting out of its range, or an unknown tier.

    Examples
    --------
    >>> from certpgo import SolveSettings
    >>> SolveSettings(time_limit=10.0).rtol
    1e-05
    """

    time_limit: float | None = None
    max_rank: int | None = None
    try_own_start: bool = True
    try_file_start: bool = True
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
    newton: NewtonSettings = DESCENTS

    def __post_init__(self) -> None:
        refuse_mistyped(self)
        if self.tier is not None:
            tier_called(self.tier)
        require_numbers(time_limit=self.time_limit, max_rank=self.max_rank)
        require_numbers(rtol=self.rtol, atol=self.atol)
        if not self.patience >= 0.0:
            raise SpecError(f"patience must not be negative: {self.patience}")
        positive = ("lifted_tolerance", "rank_steps", "rounds", "round_nodes", "few", "negligible")
        for name in (*positive, "hope"):
            if not getattr(self, name) > 0:
                raise SpecError(f"{name} must be positive, not {getattr(self, name)}")
        if self.lifted_tolerance == math.inf:
            raise SpecError("lifted_tolerance must be finite")
        if not 0.0 <= self.same_cost < 1.0:
            raise SpecError(f"same_cost must lie between 0 and 1, not {self.same_cost}")

    def changed(self, options: Mapping[str, Any]) -> SolveSettings:
        """These settings with some replaced.

        Raises
        ------
        SpecError
            An unknown setting.
        """
        if not options:
            return self
        known = [f.name for f in fields(self)]
        for name in options:
            if name not in known:
                raise SpecError.unknown("setting of solve", name, known)
        return replace(self, **options)


#: What `certpgo.solve` uses unless something else is asked for.
DEFAULT = SolveSettings()


def settings_from(settings: SolveSettings | None, options: Mapping[str, Any]) -> SolveSettings:
    """The settings that a function was given, or the default ones, with single ones replaced."""
    if settings is None:
        return DEFAULT.changed(options)
    if isinstance(settings, str):
        raise InputError(f"SolveSettings expected, not {settings!r}: a cost is given as cost=...")
    require(settings, SolveSettings, "SolveSettings")
    return settings.changed(options)

"""What differs between the searches under different costs: numbers, flags and a few functions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

from certpgo.certify.certificate import Certificate
from certpgo.certify.obstacle import Obstacle
from certpgo.graph import Estimate
from certpgo.optimize.initialization import Start
from certpgo.optimize.solution import Status


@dataclass(frozen=True, eq=False)
class Plan:
    """How a cost is searched. Functions take the `certpgo.solve.search_loop.Search`.

    Attributes
    ----------
    starts : computed initializations
    roundings : for each point of the relaxation, estimates near it, where descents begin
    finish : looks for better estimates and bounds after the last of these points
    obstacle : what keeps the gap open
    climbs : what the search climbs or minimises, for its note
    tries_own_start : whether computed initializations follow a given estimate
    descends_from_own_start : whether descents begin there, too; else the first is an answer
    begins_at_file : whether a file's values begin the search, where no estimate is given
    given_share : share of the remaining time for descents from given estimates; None: no limit
    bounds_estimates : whether estimates have bounds of their own that are worth their time
    sharp : whether bounds of estimates are sharpened beyond what suffices
    climbs_cost : whether the staircase is that of the cost, not of surrogates, from rank d on
    limits : what ends some time after a first bound, if there is no time limit
    outliers : when to look for measurements that disagree with the rest, if at all
    limited_by_outliers : whether many of these limit the time after a first bound
    descended, settled : what is said of the best estimate, see `LocalMinimum`; how its descent ends
    """

    starts: tuple[Callable[[Any], Start], ...]
    roundings: Callable[[Any], Iterator[Iterable[Estimate]]]
    finish: Callable[[Any], None]
    obstacle: Callable[[Any, Certificate], Obstacle]
    climbs: Literal["staircase", "relaxation", "surrogates"] = "staircase"
    tries_own_start: bool = False
    descends_from_own_start: bool = True
    begins_at_file: bool = False
    given_share: float | None = None
    bounds_estimates: bool = True
    sharp: bool = False
    climbs_cost: bool = False
    limits: Literal["climb", "search"] | None = None
    outliers: Literal["first", "last"] | None = None
    limited_by_outliers: bool = False
    descended: bool = True
    settled: frozenset[Status] = frozenset({Status.CONVERGED, Status.STALLED})

"""The truncated cost of certpgo certify --rejected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from certpgo.cli._show import notice
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.objective.choose_cost import Judged


def posing(
    instance: Instance,
    cost: str,
    rejected: Path | None,
    quantile: float | None,
    kernel: str | None = None,
) -> Callable[[Sequence[Instance]], list[tuple[Instance, Judged]]]:
    """From parts of an instance to these and their problems, truncated if a list names some.

    Raises
    ------
    FormatError
        The list is not of measurements of the instance.
    """
    from certpgo.graph.phrases import counted
    from certpgo.io.rejections import read_rejected
    from certpgo.objective.choose_cost import CHORDAL, objective_of
    from certpgo.objective.truncated_cost import rejecting

    if rejected is None:
        return lambda parts: [(part, objective_of(part, cost, kernel)) for part in parts]
    choice = read_rejected(rejected, instance)
    of_cost = choice.of_cost or CHORDAL
    priced = quantile is None and cost == of_cost
    if choice.prices is not None and quantile is None and not priced:
        of, here = ("F" if one == CHORDAL else one for one in (of_cost, cost))
        notice(f"the prices in {rejected} are of {of}: those of {here} are the default quantile")

    def truncated(parts: Sequence[Instance]) -> list[tuple[Instance, Judged]]:
        if len(parts) > 1:
            one = "--rejected lists measurements of one component"
            raise InputError(f"{one}: --components largest, not each")
        [part] = parts
        edges, prices = choice.among(part)
        if elsewhere := len(choice.numbers) - len(edges):
            said = counted(elsewhere, "rejected measurement{s}")
            notice(f"{part.name}: {said} of {len(choice.numbers)} not between its nodes")
        if elsewhere and not len(edges):
            return [(part, objective_of(part, cost))]
        prices = prices if priced else None
        return [(part, rejecting(objective_of(part, cost), edges, quantile, prices=prices))]

    return truncated

"""What to do after a verdict, as commands that can be typed."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from certpgo.cli._reading import Reading

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Instance
    from certpgo.solve.outliers import Disagreement


class Asked(NamedTuple):
    """What was asked: names as typed, the cost that judges, and how the graph was read.

    ``writes_best`` is whether the better estimate is written anyway, ``judging`` the options of
    ``certify`` beyond these.
    """

    graph: str
    cost: str
    reading: Reading
    estimate: str = ""
    writes_best: bool = False
    judging: tuple[str, ...] = ()


def steps_after(
    certificate: Certificate,
    part: Instance,
    asked: Asked,
    *,
    searched: bool = False,
    disagreement: Disagreement | None = None,
) -> list[str]:
    """What to do after the verdict, with commands; nothing if the estimate is good.

    Parameters
    ----------
    searched : whether the certified search found the estimate
    disagreement : measurements that disagree with the rest
    """
    from certpgo.cli._paging import arguments
    from certpgo.view.advice import advice

    steps = advice(
        certificate,
        part,
        asked.graph,
        asked.estimate,
        reading=list(arguments(asked.reading)),
        judging=asked.judging,
        cost=asked.cost,
        searched=searched,
        disagreeing=disagreement is not None,
    )
    return [
        f"{sentence.removesuffix('.')}: {command}" if command else sentence
        for sentence, command in steps
        if not (asked.writes_best and "--best" in command.split())
    ]

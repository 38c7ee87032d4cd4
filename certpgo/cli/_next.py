"""What to do after a verdict, as commands that can be typed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from certpgo.cli._reading import Reading

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Instance
    from certpgo.solve.assessment import Assessment
    from certpgo.solve.outliers import Disagreement


class Asked(NamedTuple):
    """What was asked: names as typed, the cost that judges, and how the graph was read.

    ``writes_best`` is whether the better estimate is written anyway, ``judging`` the
    options with which ``certify`` matches and judges the estimate.
    """

    graph: str
    cost: str
    reading: Reading
    estimate: str = ""
    writes_best: bool = False
    judging: Mapping[str, Any] | None = None
    kernel: str | None = None

    @property
    def known_cost(self) -> str | None:
        """The cost, if registers may know optima under it."""
        return None if self.kernel else self.cost

    def judged_again(self, instance: Instance) -> Iterator[str]:
        """The options on the command line that judge so, but the cost."""
        from certpgo.io.matching import MAX_DIFFERENCE

        options = self.judging or {}
        usual = {"max-difference": MAX_DIFFERENCE}
        for name, value in options.items():
            if value is not None and value != usual.get(name):
                yield from (f"--{name}", str(value))


def steps_after(
    certificate: Certificate,
    part: Instance,
    asked: Asked,
    *,
    searched: bool = False,
    robust: bool = False,
    disagreement: Disagreement | None = None,
) -> list[str]:
    """What to do after the verdict, with commands; nothing if the estimate is good.

    Parameters
    ----------
    searched : whether the certified search found the estimate
    robust : whether a robust fit has rejected measurements before
    disagreement : measurements that disagree with the rest
    """
    import shlex

    from certpgo.cli._paging import arguments
    from certpgo.view.advice import advice, cost_options

    if robust:
        cost = cost_options(part, asked.cost)
        words = ("certpgo", "diagnose", asked.graph, *cost, *arguments(asked.reading))
        is_good = certificate.verdict.value == "CERTIFIED"
        return [] if is_good else [f"See which mistake explains it: {shlex.join(words)}"]
    steps = advice(
        certificate,
        part,
        asked.graph,
        asked.estimate,
        reading=list(arguments(asked.reading)),
        judging=list(asked.judged_again(part)),
        cost=asked.cost,
        kernel=asked.kernel,
        searched=searched,
        disagreeing=disagreement is not None,
    )
    return [
        f"{sentence.removesuffix('.')}: {command}" if command else sentence
        for sentence, command in steps
        if not (asked.writes_best and "--best" in command.split())
    ]


def is_better_known(found: Assessment, json: bool) -> bool:
    """Whether a better estimate was found that no printed step says how to write."""
    c = found.certificate
    said = c.proves_optimal(found.best_cost) or c.basin_is_global or c.verdict.value == "REFUTED"
    return found.excess > c.tolerance and (json or not said)

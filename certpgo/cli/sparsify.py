"""certpgo sparsify: loop closures that connect a graph well, and what the others were worth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import CostOption, GraphName, Json, chosen_cost, note_distances_uncounted
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import facts, working

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.solve.sparsifying import Sparsified


EXAMPLES = ("certpgo sparsify graph.g2o --keep 0.5 -o sparse.g2o",)


class By(StrEnum):
    """What loop closures are chosen by."""

    CONNECTIVITY = "connectivity"
    SPECTRUM = "spectrum"


def amount(text: str) -> float:
    """A number of loop closures, or a fraction of them: ``500``, ``0.2`` or ``20%``."""
    try:
        if text.endswith("%"):
            return float(text[:-1]) / 100.0
        return int(text) if text.isdigit() else float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number, a fraction or a percentage") from None


@takes_reading
@tells_unwritten("out")
def command(
    graph: GraphName,
    keep: Annotated[
        float,
        typer.Option(
            "--keep",
            parser=amount,
            metavar="K",
            help="Loop closures to keep: a number such as 500, or a share such as 0.2 or 20%.",
        ),
    ],
    by: Annotated[
        By,
        typer.Option(
            "--by",
            help="Where loop closures are (connectivity), or also what they measure (spectrum), "
            "which leaves out wrong ones.",
        ),
    ] = By.CONNECTIVITY,
    cost: CostOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Write the sparse graph and its estimate.",
        ),
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Keep loop closures that connect a graph well, and show what is lost.

    They are chosen by algebraic connectivity, with a bound on every other choice of as many, or by
    the spectrum of what they measure. The whole and the sparse graph are solved and certified.
    Parallel edges are all read.
    """
    from certpgo.solve.sparsifying import sparsify

    outputs = Outputs(estimate=out, json=json)
    outputs.refuse()
    source = reading.resolve(graph)
    outputs.refuse(source, *reading.others)
    instance = reading.open(source, operation=None)
    note_distances_uncounted(instance)
    chosen = chosen_cost(cost, instance)
    with working(f"sparsifying {instance.name}"):
        found = sparsify(instance, keep, cost=chosen, by=by.value)
    return emit([_Sparsified(found.answer.certificate, instance, found, by)], [outputs])


@dataclass(frozen=True)
class _Sparsified(Result):
    """A graph, and what is left of it."""

    whole: Instance
    found: Sparsified
    by: By

    def write(self, outputs: Outputs) -> None:
        from certpgo.io.frames import with_answer

        outputs.write(with_answer(self.found.instance, self.found.answer.estimate))

    def show(self, outputs: Outputs) -> None:
        typer.echo(str(self.found))
        if outputs.estimate is not None:
            facts([("written", str(outputs.estimate))])

    def notices(self, outputs: Outputs) -> list[str]:
        return _verdict.warnings(self.found.fit)

    def report(self, outputs: Outputs) -> dict[str, Any]:
        whole, found = self.whole, self.found
        return {
            "graph": whole.name,
            "by": self.by,
            "loop_closures": found.loops,
            "kept": whole.pairs[found.chosen].tolist(),
            "connectivity": found.connectivity,
            "connectivity_bound": found.bound,
            "connectivity_of_all": found.full,
            "cost_of_all": found.cost,
            "loss": found.loss,
            "moved": asdict(found.moved),
            "whole": _verdict.in_short(found.whole.certificate),
            "sparse": _verdict.in_short(found.answer.certificate),
        }

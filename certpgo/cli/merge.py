"""certpgo merge: maps in one frame, with the certificate of all measurements together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._completion import graphs
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import CostOption, Json
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import table

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.solve.merging import Merged


EXAMPLES = ("certpgo merge first.g2o second.g2o --between loops.g2o -o map.g2o",)


@takes_reading
@tells_unwritten("out")
def command(
    maps: Annotated[
        list[str],
        typer.Argument(
            metavar="MAP MAP...", autocompletion=graphs, help="Graphs: files or dataset names."
        ),
    ],
    between: Annotated[
        str, typer.Option("--between", help="Graph with the measurements between the maps.")
    ],
    offset: Annotated[
        int | None,
        typer.Option(
            "--offset",
            min=1,
            help="Raise the ids of the second map by this, those of the third by twice this, and "
            "so on; --between has the raised ids.",
        ),
    ] = None,
    cost: CostOption = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Leave out measurements between maps that disagree."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Write the merged graph and its estimate.",
        ),
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Merge maps whose relative poses are unknown, and prove how good the result is.

    Each map is certified alone, then all measurements together. The measurements between maps are
    listed with their terms of the cost, the largest first.
    """
    from certpgo.solve.merging import merge

    outputs = Outputs(estimate=out, json=json)
    outputs.refuse()
    sources = [reading.resolve(name) for name in maps]
    joints = reading.resolve(between)
    outputs.refuse(*sources, joints, *reading.others)
    read = [reading.open(source, operation=None) for source in sources]
    joint = reading.open(joints, operation=None)
    merged = merge(read, joint, cost=cost, offset=offset, robust=robust)
    names = [one.name for one in read]
    return emit([_Merged(merged.answer.certificate, merged, names, joint)], [outputs])


#: Measurements between maps that are listed.
SHOWN = 10


@dataclass(frozen=True)
class _Merged(Result):
    """Maps in one frame, with their names, and the measurements between them."""

    merged: Merged
    names: list[str]
    between: Instance

    def write(self, outputs: Outputs) -> None:
        from certpgo.io.frames import with_answer

        outputs.write(with_answer(self.merged.kept, self.merged.answer.estimate))

    def _worst(self) -> list[tuple[int, list[int], float, float, bool]]:
        """Measurements between maps: number in their file, nodes, term, tail, if it disagrees."""
        merged, rows = self.merged, self.merged.between
        wrong = set(merged.disagreeing.tolist())
        order = (-merged.terms).argsort(kind="stable").tolist()
        edges = merged.instance.measurements.edges[rows].tolist()
        numbers = self.between.known_numbers.tolist()
        return [
            (numbers[k], edges[k], merged.terms[k], merged.tails[k], rows[k] in wrong)
            for k in order
        ]

    def report(self, outputs: Outputs) -> dict[str, Any]:
        merged, ids = self.merged, self.merged.instance.ids
        return {
            **_verdict.in_short(merged.answer.certificate),
            "raised": merged.raised,
            "maps": [
                {"name": name, "verdict": part.verdict.value, "cost": part.cost}
                for name, part in zip(self.names, merged.parts, strict=True)
            ],
            "between": [
                {
                    "edge": edge,
                    "ids": ids[nodes].tolist(),
                    "term": term,
                    "tail": tail,
                    "disagrees": disagrees,
                    "left_out": merged.left_out and disagrees,
                }
                for edge, nodes, term, tail, disagrees in self._worst()
            ],
        }

    def show(self, outputs: Outputs) -> None:
        from certpgo.graph.labels import shown

        labels = self.merged.instance.labels
        mark = "left out" if self.merged.left_out else "disagrees"
        rows = [
            [
                "-".join(shown(labels[node]) for node in nodes),
                *(f"{term:.4g}", f"{tail:.2g}", mark if disagrees else ""),
            ]
            for _, nodes, term, tail, disagrees in self._worst()[:SHOWN]
        ]
        typer.echo(f"{self.merged}\n")
        table("Between the maps", ["nodes", "term", "probability", ""], rows)

    def notices(self, outputs: Outputs) -> list[str]:
        from certpgo.graph.phrases import counted

        merged, said = self.merged, list(_verdict.warnings(self.merged.fit))
        if outputs.estimate is not None and merged.left_out:
            count = counted(len(merged.disagreeing), "measurement{s}")
            said.append(f"{outputs.estimate} is without the {count} left out")
        return said

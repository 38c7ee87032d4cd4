"""certpgo convert: convert a graph or an estimate to another format."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._completion import formats, inputs
from certpgo.cli._options import MaxDifference, Timestamps
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import noticing
from certpgo.errors import InputError, NoMeasurements

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.io.datasets.source import Source


EXAMPLES = (
    "certpgo convert graph.g2o graph.npz",
    "certpgo convert solution.g2o solution.tum --estimate",
    "certpgo convert estimate.tum estimate.g2o --graph graph.g2o",
    "certpgo convert graph.g2o held.npz --constraints",
)


class Anchor(StrEnum):
    """The frame for an estimate, which is determined only up to a rigid motion."""

    FILE = "file"
    IDENTITY = "identity"
    PRIOR = "prior"
    NONE = "none"


@takes_reading
def command(
    source: Annotated[
        str,
        typer.Argument(
            metavar="IN", autocompletion=inputs, help="Graph or estimate: a file or dataset."
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write.")],
    format: Annotated[
        str | None,
        typer.Option(
            "--format", autocompletion=formats, help="Format of OUT; by default from its suffix."
        ),
    ] = None,
    estimate: Annotated[
        bool, typer.Option("--estimate", help="Convert the poses even if IN also has measurements.")
    ] = False,
    graph: Annotated[
        str | None,
        typer.Option("--graph", help="Graph of the estimate, for node ids and initial values."),
    ] = None,
    anchor: Annotated[
        Anchor | None,
        typer.Option(
            "--anchor",
            help="Frame of the poses: the first one as in the file, the first one at the identity, "
            "the fixed pose (prior), or as it comes (none).",
        ),
    ] = None,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    isotropic: Annotated[
        bool,
        typer.Option("--isotropic", help="Write the weights of F, not full information matrices."),
    ] = False,
    constraints: Annotated[
        bool,
        typer.Option(
            "--constraints",
            help="Write fixed nodes as the constraints that hold them (.npz), for proofs.",
        ),
    ] = False,
    *,
    reading: Reading,
) -> None:
    """Convert a graph (to g2o, npz, PyFG) or an estimate (those, TUM, KITTI, rots)."""
    from certpgo.io import read_estimate
    from certpgo.io.format import format_of, format_to_write
    from certpgo.io.timestamps import file_of_times

    outputs = Outputs(estimate=target, format=format)
    outputs.refuse()
    given, of_graph = reading.resolve(source), reading.resolve(graph)
    outputs.refuse(given, *reading.others, of_graph, file_of_times(timestamps))
    out = format_to_write(target, format)
    path = given.path()
    if not estimate and out.write_graph is not None and format_of(path).read_graph is not None:
        with suppress(NoMeasurements):
            converted = _as_written(given, reading)
            if constraints:
                # Without what it was before, it is written as it is.
                held = reading.open(given, notices=False, operation=None)
                converted = replace(held, released=None)
            for name, value in (("--anchor", anchor), ("--graph", graph)):
                if value is not None:
                    raise InputError(
                        f"{name} is about estimates, and {path} has measurements; --estimate "
                        "converts its poses"
                    )
            if isotropic and converted.graph.has_positions:
                converted = replace(converted, graph=converted.graph.with_information(None))
            outputs.write(converted)
            return
    if isotropic:
        raise InputError(f"--isotropic is about measurements, and {path} is converted as poses")
    instance = None if of_graph is None else reading.open(of_graph, operation=None)
    with noticing():
        poses = read_estimate(
            path,
            instance,
            timestamps=timestamps,
            max_difference=max_difference,
            topic=reading.topic_of(given),
        )
    frame = None if anchor is None else anchor.value
    outputs.write(poses, instance=instance, anchor=frame, timestamps=timestamps)


def _as_written(given: Source, reading: Reading) -> Instance:
    """The graph with fixed nodes as its file has them, not as constraints."""
    found = replace(reading, fixed=False).open(given, notices=False, operation=None)
    if found.graph.has_scales and reading.fixed:
        # Of similarities they are no constraints, but one states the unit.
        found = reading.open(given, notices=False, operation=None)
    reading.tell(found)
    return found

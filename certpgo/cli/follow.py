"""certpgo follow: an estimate and its certificate that keep up with a stream of measurements."""

from __future__ import annotations

import sys
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._options import Json
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, notice, noticing, working
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo import Session, Standing
    from certpgo.datasets.source import Source
    from certpgo.graph import Graph

#: The name of a graph that comes from a pipe.
PIPE = "-"


@takes_reading
def command(
    graph: Annotated[
        str, typer.Argument(metavar="GRAPH|-", help="Graph file or dataset name; - for a pipe.")
    ],
    every: Annotated[
        int,
        typer.Option("--every", min=1, help="Refresh the certificate after so many measurements."),
    ] = 100,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Put aside measurements that disagree with the rest."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write the last estimate to this file.")
    ] = None,
    time_limit: Annotated[
        float | None,
        typer.Option("--time-limit", metavar="SECONDS", min=0.0, help="For each certificate."),
    ] = None,
    trace: Annotated[
        bool, typer.Option("--trace", help="Print a line at each certificate.")
    ] = False,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Keep the best estimate of a growing graph, with a certificate.

    Measurements come as a robot makes them: from a pipe in the order of its lines, from a file by
    their later node. The last line is about all of them; Ctrl-C ends with what is proven so far.
    """
    from certpgo import RobustSession, Session, SolveSettings
    from certpgo.io.format import format_to_write

    if out is not None:
        format_to_write(out, None)
    refuse_unwritable(out)
    source = None if graph == PIPE else reading.resolve(graph)
    refuse_overwriting([out], [source])
    settings = SolveSettings(time_limit=time_limit)
    session = (RobustSession if robust else Session)(settings, every=None)
    followed = _Followed(session, graph, trace and not json)
    try:
        with working("waiting for measurements") as status:
            for part, names in _parts(source, every, reading):
                session.add(part, names)
                if followed.is_due(every):
                    followed.refresh(status)
            followed.end(status)
    except KeyboardInterrupt:
        return followed.tell(json, interrupted=True)
    if out is not None:
        _write(out, session)
    return followed.tell(json)


class _Followed:
    """A session, and what was proven at its last certificate."""

    def __init__(self, session: Session, name: str, trace: bool) -> None:
        self.session, self.name, self.trace = session, name, trace
        self.standing: Standing | None = None
        self.rejected = 0

    def is_due(self, every: int) -> bool:
        """Whether so many measurements are new."""
        return self.session.pending >= every

    def refresh(self, status: Any) -> None:
        """Renew the certificate, and say where the verdict turned."""
        before = self.standing
        self.standing = self.session.refresh()
        self._note()
        status.update(self.sentence)
        if self.trace:
            typer.echo(self.sentence)
        turned = before is not None and before.verdict.value == "CERTIFIED"
        if turned and self.standing.verdict.value != "CERTIFIED" and not self._is_robust:
            self.warn()

    def end(self, status: Any) -> None:
        """The certificate of the whole, and a warning of what disagrees in it."""
        from certpgo import RobustSession

        if not self.session.nodes:
            return
        status.update(f"{self.name}: the certificate of the whole")
        if isinstance(self.session, RobustSession):
            self.standing = self.session.settle()
            self._note()
        else:
            self.standing = self.session.refresh()
            self.warn()

    def warn(self) -> None:
        """Name what disagrees, with both certificates."""
        found = self.session.suspicion()
        if found is not None:
            notice(f"{found}; --robust puts such measurements aside")

    def tell(self, json: bool, *, interrupted: bool = False) -> int:
        """Print the last line; returns the exit code."""
        standing = self.standing
        if json:
            document(self._report(interrupted))
        elif standing is None:
            typer.echo(f"{self.name}: nothing is proven yet")
        else:
            typer.echo(f"{'interrupted; so far: ' if interrupted else ''}{self.sentence}")
        if interrupted:
            return _verdict.INTERRUPTED
        return 0 if standing is None else _verdict.weakest([standing.verdict.value])

    @property
    def sentence(self) -> str:
        """What is proven, in a line."""
        from certpgo.graph.wording import counted

        s = self.standing
        if s is None:
            return ""
        aside = f"; {self.rejected} put aside" if self.rejected else ""
        size = f"{counted(s.nodes, 'node{s}')}, {counted(s.edges, 'measurement{s}')}"
        return f"{s.verdict.value}: F {s.cost:.10g}, at most {s.gap:.2g} above F*; {size}{aside}"

    @property
    def _is_robust(self) -> bool:
        return hasattr(self.session, "rejected")

    def _note(self) -> None:
        self.rejected = len(getattr(self.session, "rejected", ()))

    def _report(self, interrupted: bool) -> dict[str, Any]:
        from dataclasses import asdict

        proven = {} if self.standing is None else asdict(self.standing)
        return {"graph": self.name, **proven, "rejected": self.rejected, "interrupted": interrupted}


def _parts(
    source: Source | None, every: int, reading: Reading
) -> Iterator[tuple[Graph, Sequence[Hashable]]]:
    """The measurements as they come, with the ids of their nodes."""
    from certpgo.graph.components import rotations_alone
    from certpgo.graph.streaming import streamed
    from certpgo.io.piped import piped

    if source is not None:
        parts = reading.parts(reading.open(source))
        if len(parts) != 1:
            raise InputError("follow takes one component: --components largest")
        yield from streamed(parts[0], every)
        return
    if reading.keep.value != "all":
        raise InputError(f"--keep {reading.keep.value} is for files: a pipe keeps all measurements")
    for part in piped(sys.stdin.buffer, every, **reading.options):
        piece = rotations_alone(part) if reading.rotations else part
        yield piece.graph, piece.ids.tolist()


def _write(out: Path, session: Session) -> None:
    import numpy as np

    from certpgo.graph import Instance
    from certpgo.io import write

    ids = np.array(session.nodes)
    order = np.argsort(ids)
    instance = Instance("followed", session.graph.subgraph(order), ids[order])
    with noticing():
        write(out, session.estimate.subset(order), instance=instance)

"""certpgo follow: an estimate and its certificate that keep up with a stream of measurements."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._completion import graphs
from certpgo.cli._following import PIPE, Followed, Stream
from certpgo.cli._interrupting import tell_interrupted, tells_unwritten
from certpgo.cli._options import CostOption, Json, time_limit_option
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import notice, working

if TYPE_CHECKING:
    from certpgo.view.scene import Scene

EXAMPLES = (
    "certpgo follow graph.g2o --every 50",
    "robot | certpgo follow - -o newest.g2o",
)


@takes_reading
@tells_unwritten("out")
def command(
    graph: Annotated[
        str,
        typer.Argument(
            metavar="GRAPH|-",
            autocompletion=graphs,
            help="Graph file or dataset name; - for a pipe.",
        ),
    ],
    every: Annotated[
        int,
        typer.Option("--every", min=1, help="Renew the certificate after this many measurements."),
    ] = 100,
    cost: CostOption = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Put aside measurements that disagree with the rest."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Write the last estimate to this file.",
        ),
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Show the map in the browser as it grows, until Ctrl-C.")
    ] = False,
    port: Annotated[
        int,
        typer.Option(
            "--port", min=1, max=65535, help="Port of --view; the next free one if it is taken."
        ),
    ] = 8080,
    time_limit: Annotated[
        float | None,
        time_limit_option("For each certificate."),
    ] = None,
    trace: Annotated[
        bool,
        typer.Option(
            "--trace", help="Print a line at each certificate, with where the newest pose can be."
        ),
    ] = False,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Keep the best estimate of a growing graph, with a certificate.

    Measurements come as a robot makes them: from a pipe in the order of its lines, from a file by
    their later pose. The last line is about all of them, and says how far the newest pose can be
    from every optimum. Ctrl-C or SIGTERM ends with what is proven and estimated so far.
    """
    from certpgo import RobustSession, Session, SolveSettings

    outputs = Outputs(estimate=out)
    outputs.refuse()
    source = None if graph == PIPE else reading.resolve(graph)
    outputs.refuse(source, *reading.others)
    stream = Stream.of(source, every, reading, cost)
    limits = SolveSettings(time_limit=time_limit)
    session = (RobustSession if robust else Session)(limits, every=None, cost=stream.cost)
    followed = Followed(session, graph, stream.whole, stream.cost, trace and not json)
    with _shown(port) if view else _unseen() as followed.on_refresh:
        interrupted = _fed(followed, stream, every)
        if interrupted:
            nothing = [] if session.nodes else [out]
            tell_interrupted("the estimate so far stands, with its last certificate", nothing)
        if out is not None and session.nodes:
            instance, estimate = followed.best()
            outputs.write(estimate, instance=instance)
        code = followed.report(json, interrupted=interrupted)
        for sentence in stream.totals():
            notice(sentence)
        if view and not interrupted:
            _wait()
    return code


def _fed(followed: Followed, stream: Stream, every: int) -> bool:
    """Give all measurements to a session; whether Ctrl-C ended that."""
    try:
        with working("waiting for measurements") as status:
            for part, names in stream.parts:
                followed.add(part, names, every, status)
            followed.end(status)
    except KeyboardInterrupt:
        return True
    return False


@contextmanager
def _unseen() -> Iterator[Callable[[Followed], object]]:
    yield lambda followed: None


@contextmanager
def _shown(port: int) -> Iterator[Callable[[Followed], object]]:
    """Show the map at each certificate while the block runs."""
    from certpgo.view.live import growing
    from certpgo.view.load_scene import scene_of

    with growing(port=port) as screen:
        notice(f"{screen.address} shows the map; Ctrl-C ends")

        def draw(followed: Followed) -> None:
            def scene() -> Scene:
                instance, estimate = followed.best()
                return scene_of(instance, ("so far", estimate))

            screen.show(scene, followed.sentence, last=followed.ended)

        yield draw


def _wait() -> None:
    """Until Ctrl-C."""
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        typer.echo()

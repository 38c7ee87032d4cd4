"""certpgo view: look at graphs, estimates, clouds and meshes in the browser."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._help import MATCHING
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import Data, HtmlOut, MaxDifference, Timestamps
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Reading
from certpgo.cli._rules import Rule
from certpgo.cli._show import notice, noticing, working
from certpgo.cli._truth import TruthOffset

if TYPE_CHECKING:
    from certpgo.io.datasets.source import Source
    from certpgo.solve.result import CertifiedSolution
    from certpgo.view.scene import Scene


EXAMPLES = (
    "certpgo view graph.g2o",
    "certpgo view graph.g2o estimate.tum --html scene.html",
)


class Colour(StrEnum):
    """The numbers that colour edges."""

    DEGREES = "degrees"
    METRES = "metres"
    UNITS = "units"
    ROTATION = "rotation-weight"
    TRANSLATION = "translation-weight"


RULES = (
    Rule("--play is for pages; the live view has a box to play", "play", without="out|html"),
    Rule("--robust chooses what is rejected: not with --rejected", "robust", "rejected"),
)


@tells_unwritten("out", "html")
def command(
    files: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE...",
            help="At most one graph, its estimates in the order before, after; or trajectories; "
            "PLY clouds and meshes. Dataset names too.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="Write a page that works offline, .html, or a picture: .png, .pdf or .svg.",
        ),
    ] = None,
    html: HtmlOut = None,
    solve: Annotated[
        bool,
        typer.Option(
            "--solve", help="Solve the graph, and show before and after, and how sure it is."
        ),
    ] = False,
    robust: Annotated[
        bool, typer.Option("--robust", help="Solve it robustly, and show what is rejected.")
    ] = False,
    rejected: Annotated[
        Path | None,
        typer.Option(
            "--rejected",
            metavar="CSV",
            help="Draw these measurements as rejected, as certpgo outliers writes them.",
        ),
    ] = None,
    colour: Annotated[
        Colour | None,
        typer.Option("--colour", help="Residuals or weights that colour edges."),
    ] = None,
    dark: Annotated[
        bool | None,
        typer.Option(
            "--dark/--light",
            show_default="pages as the reader's system is, else light",
            help="Draw on a dark or a light background.",
        ),
    ] = None,
    play: Annotated[
        bool, typer.Option("--play", help="In the page, walk along the trajectory.")
    ] = False,
    port: Annotated[
        int, typer.Option("--port", min=1, max=65535, help="Port to serve at; else the next ones.")
    ] = 8080,
    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            rich_help_panel=MATCHING,
            help="Ground truth to compare with.",
        ),
    ] = None,
    truth_offset: TruthOffset = 0.0,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    data: Data = None,
) -> None:
    """Look at graphs, trajectories, clouds and meshes: live in the browser, or as a file.

    Without -o or --html the scene is live at the printed address, on this machine, until Ctrl-C.
    """
    from certpgo.io.timestamps import file_of_times
    from certpgo.view.show import View, form_of

    for path in (out, html):
        if path is not None:
            form_of(path, play=play)
    outputs, reading = Outputs(scene=out, html=html), Reading(data=data)
    outputs.refuse()
    sources = [reading.resolve(name) for name in files]
    outputs.refuse(*sources, truth, file_of_times(timestamps), rejected)
    matching = {
        "truth": truth,
        "timestamps": timestamps,
        "max_difference": max_difference,
        "truth_offset": truth_offset,
    }
    scene = _scene(sources, matching, rejected, solve=solve, robust=robust)
    view = View(scene, dark, None if colour is None else colour.value.replace("-", " "))
    if outputs.files:
        for path in outputs.files:
            with working(f"drawing {scene.name}"):
                view.save(path, play=play)
            notice(f"scene written to {path}")
        return
    with view.serve(port=port) as address:
        typer.echo(f"{address} shows {scene.name}; Ctrl-C ends")
        try:
            while True:
                time.sleep(1.0)
        except KeyboardInterrupt:
            typer.echo()


def _kept(answer: CertifiedSolution) -> str:
    """What of the measurements the verdict is about, if not all."""
    kept, rejected = answer.graph.num_measurements, len(answer.solution.rejected)
    return f" of {kept} measurements kept, {rejected} rejected" if rejected else ""


def _scene(
    sources: list[Source],
    matching: dict[str, Any],
    rejected: Path | None,
    *,
    solve: bool,
    robust: bool,
) -> Scene:
    """The scene of the files, with an answer if one is asked for."""
    import certpgo
    from certpgo.io.rejections import read_rejected
    from certpgo.view.load_scene import scene_of

    with noticing():
        if not (solve or robust or rejected is not None):
            return scene_of(*sources, **matching)
        instance = sources[0].graph(quiet=True)
        if rejected is not None:
            matching |= {"rejected": read_rejected(rejected, instance).among(instance)[0]}
        if not (solve or robust):
            return scene_of(instance, *sources[1:], **matching)
        with working(f"solving {instance.name}"):
            answer = certpgo.solve_robustly(instance) if robust else certpgo.solve(instance)
        notice(f"{instance.name}: {answer.certificate.in_brief}{_kept(answer)}")
        return scene_of(instance, *sources[1:], answer, **matching)

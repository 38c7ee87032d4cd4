"""certpgo reconstruct: RGB-D frames to a certified trajectory and the scene."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._fusing import NAMED, Fused, fused_at, write_reconstruction, write_scene
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import HtmlOut, Json
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._rules import Rule, without_known_scale
from certpgo.cli._show import facts, notice, noticing, working

if TYPE_CHECKING:
    from certpgo.linalg.arrays import FloatArray
    from certpgo.registration.reconstruct import Reconstruction
    from certpgo.registration.sequences import FrameSequence
    from certpgo.registration.stages import Progress

EXAMPLES = (
    "certpgo reconstruct frames/ -o scene.ply",
    "certpgo reconstruct frames/ -o scene.ply --trajectory poses.tum",
)
_EITHER = "give a folder of frames, or --synthetic"
RULES = (
    Rule(_EITHER, "folder", "synthetic"),
    Rule(_EITHER, without="folder|synthetic"),
    Rule("--wallpaper needs --synthetic", "wallpaper", without="synthetic"),
    Rule("--cache and --no-cache exclude each other", "cache", "no_cache"),
    Rule(
        "global_icp moves scans that nearly all overlap, and begins near the answer, which frames "
        "of a moving camera do not: certpgo register SCANS --method global_icp is for scans",
        "method=global_icp",
    ),
    Rule("no method {method!r}: pose_graph is known here", "method"),
    Rule("{out}: the scene is written as .ply", "out", without="out=?*.ply"),
    Rule("--mesh needs --out", "mesh", without="out"),
    Rule(
        "--frames takes the poses of a graph: without --graph and --every",
        "of_graph",
        "graph|every",
    ),
    Rule(
        "--depth-factors says factors: not with --unknown-depth-scale or --frames",
        "depth_factors",
        "unknown_depth_scale|of_graph",
    ),
    Rule(
        "--frames takes the poses of a graph, with depths of known scale: not with "
        "--unknown-depth-scale",
        "of_graph",
        "unknown_depth_scale",
    ),
    Rule(
        "--depth-scale says what --unknown-depth-scale is to find: give one",
        "depth_scale",
        "unknown_depth_scale",
    ),
    without_known_scale("unknown_depth_scale"),
    Rule("--factors needs --unknown-depth-scale", "factors", without="unknown_depth_scale"),
    Rule(
        "--camera and --depth-scale are for frames in a folder",
        "camera|depth_scale",
        without="folder|of_graph",
    ),
)


@tells_unwritten("out", "trajectory", "graph", "html", "factors")
def command(
    folder: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FOLDER]",
            help="Frames of TUM, ICL-NUIM, Open3D or 7-Scenes; with --frames, a pose graph.",
        ),
    ] = None,
    of_graph: Annotated[
        Path | None,
        typer.Option(
            "--frames", metavar="FOLDER", help="Fuse these frames at the poses of a given graph."
        ),
    ] = None,
    synthetic: Annotated[
        bool, typer.Option("--synthetic", help="Use frames of a computed room.")
    ] = False,
    wallpaper: Annotated[
        bool, typer.Option("--wallpaper", help="With --synthetic: one pattern on all walls.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="OUT",
            help="Write the scene to this .ply file.",
        ),
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option("--trajectory", help="Write the poses, by default as .tum.")
    ] = None,
    graph: Annotated[
        Path | None,
        typer.Option(
            "--graph",
            help="Write all measured edges to this .g2o file; .npz with --unknown-depth-scale.",
        ),
    ] = None,
    html: HtmlOut = None,
    mesh: Annotated[
        bool, typer.Option("--mesh", help="Write a mesh to --out instead of points.")
    ] = False,
    camera: Annotated[
        str | None, typer.Option("--camera", help="fx,fy,cx,cy in pixels, or a file of them.")
    ] = None,
    depth_scale: Annotated[
        float | None,
        typer.Option("--depth-scale", help="Depth units per metre.", show_default=False),
    ] = None,
    unknown_depth_scale: Annotated[
        bool,
        typer.Option(
            "--unknown-depth-scale",
            help="Estimate an unknown factor of each frame's depth. Metres are then units of a map "
            "in which median depths are 2 in the geometric mean.",
        ),
    ] = False,
    factors: Annotated[
        Path | None,
        typer.Option(
            "--factors", metavar="CSV", help="Write the factor of each frame's depth to this file."
        ),
    ] = None,
    depth_factors: Annotated[
        Path | None,
        typer.Option(
            "--depth-factors",
            metavar="CSV",
            help="Multiply depths by the factors that --factors wrote; other frames are left out.",
        ),
    ] = None,
    every: Annotated[int, typer.Option("--every", min=1, help="Use every K-th frame.")] = 1,
    cutoff: Annotated[
        float, typer.Option("--cutoff", metavar="M", help="Largest depth used, metres.")
    ] = 4.0,
    grid: Annotated[
        float | None,
        typer.Option(
            "--grid", metavar="M", help="Voxel size of the scene, metres.", show_default="0.01"
        ),
    ] = None,
    gate: Annotated[
        bool,
        typer.Option("--gate/--no-gate", help="Reject loops that contradict dead reckoning."),
    ] = True,
    consistent: Annotated[
        bool,
        typer.Option("--consistent", help="Keep only loops that agree with each other pairwise."),
    ] = False,
    calibrate: Annotated[
        bool | None,
        typer.Option(
            "--calibrate/--no-calibrate",
            help="Estimate the colour camera from the frames.",
            show_default="for frames of 7-Scenes",
        ),
    ] = None,
    method: Annotated[
        str, typer.Option("--method", help="pose_graph; scans have global_icp in certpgo register.")
    ] = "pose_graph",
    cache: Annotated[
        Path | None,
        typer.Option(
            "--cache", help="Folder of results to resume from (default: the user's cache)."
        ),
    ] = None,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Keep no results.")] = False,
    json: Json = False,
) -> int:
    """Reconstruct a scene from RGB-D frames, and certify the trajectory.

    Frames are registered in pairs, and the pose graph is solved with a certificate. It does not say
    that images were matched to the right places: see how well loops agree.

    With --frames, FOLDER is a pose graph. It is solved and certified, and frames are fused at its
    poses. Node ids are frame numbers.

    With --unknown-depth-scale, similarities of frames are measured by keypoints, and the verdict is
    about the cost F over similarities, with weights in the frames' own units.
    """
    from certpgo.registration.depth_scales import with_factors_of
    from certpgo.registration.fuse import GRID
    from certpgo.registration.reconstruct import ReconstructSettings, reconstruct
    from certpgo.registration.stages import user_cache

    format = "tum" if trajectory is not None and trajectory.suffix in ("", ".txt") else None
    outputs = Outputs(
        scene=out,
        estimate=trajectory,
        graph=graph,
        csv=factors,
        html=html,
        format=format,
        json=json,
    )
    camera_file = None if camera is None else Path(camera)
    outputs.refuse(folder, of_graph, camera_file, depth_factors)
    frames = _frames(folder if of_graph is None else of_graph, wallpaper, camera, depth_scale)
    if every > 1:
        frames = frames.chosen(range(0, len(frames), every))
    if depth_factors is not None:
        frames = with_factors_of(depth_factors, frames)
    kept = None if no_cache or (synthetic and cache is None) else cache or user_cache()
    settings = ReconstructSettings(
        cutoff=cutoff,
        grid=GRID if grid is None else grid,
        gate=gate,
        consistent=consistent,
        calibrate=calibrate,
        scales=unknown_depth_scale,
    )
    found: Reconstruction | Fused
    with noticing(), _reporting() as progress:
        if of_graph is None or folder is None:
            found = reconstruct(frames, settings, cache=kept, progress=progress)
        else:
            found = fused_at(folder, frames, settings, kept, progress)
    certificate, source = found.averaged.answer.certificate, graph if of_graph is None else folder
    return emit([_Reconstructed(certificate, found, cutoff, mesh, source)], [outputs])


@dataclass(frozen=True)
class _Reconstructed(Result):
    """A scene, its points up to a cutoff or as a mesh, and the file of its pose graph, if any."""

    found: Reconstruction | Fused
    cutoff: float
    mesh: bool
    graph: Path | None

    def write(self, outputs: Outputs) -> None:
        from certpgo.io import write

        found = self.found
        if outputs.scene is not None:
            write_scene(outputs.scene, found, self.cutoff, mesh=self.mesh)
        outputs.write(found.averaged.poses, ids=found.averaged.nodes)
        if outputs.graph is not None:
            write(outputs.graph, found.averaged.instance)
        if outputs.csv is not None:
            _write_factors(outputs.csv, found)
        if outputs.html is not None:
            write_reconstruction(outputs.html, found, self.graph)

    def show(self, outputs: Outputs) -> None:
        from certpgo.certify.wording import named_cost
        from certpgo.graph.phrases import cost_shown

        found, certificate = self.found, self.found.averaged.answer.certificate
        cost = named_cost(certificate.objective)
        _verdict.headline(certificate)
        facts(
            [
                ("cost", f"{cost_shown(certificate.cost_upper)}  ({cost} of the kept edges)"),
                *found.consistency(),
                *(("written", str(path)) for path in outputs.files),
            ]
        )
        rejected = found.rejected_named()
        for pair in rejected[:NAMED]:
            notice(f"rejected: {pair}")
        if len(rejected) > NAMED:
            notice(f"and {len(rejected) - NAMED} more rejected edges: --json lists all")

    def report(self, outputs: Outputs) -> dict[str, Any]:
        found, averaged = self.found, self.found.averaged
        answer, instance, kept = averaged.answer, averaged.instance, averaged.kept
        certificate = answer.certificate
        numbers = instance.ids[instance.graph.edges[~kept]]
        return {
            "schema": 1,
            "sequence": found.frames.name,
            "frames": len(found.frames),
            "used": averaged.nodes.tolist(),
            "skipped": list(found.skipped),
            "verdict": certificate.verdict.value,
            "reason": certificate.reason,
            "cost": answer.cost,
            "lower_bound": certificate.lower_bound,
            "objective": _objective(found),
            "edges": len(kept),
            "odometry": found.odometry,
            "fit": None if answer.fit is None else _verdict.fit_as_json(answer.fit),
            "consistency": dict(found.consistency()),
            "rejected": [
                {"frames": pair, "names": [found.frames.names[k] for k in pair]}
                for pair in numbers.tolist()
            ],
            "points": len(found.scene),
            "depth_factors": None if (factors := _factors(found)) is None else factors.tolist(),
        }

    def notices(self, outputs: Outputs) -> list[str]:
        averaged = self.found.averaged
        robust = averaged.robust.solution
        return _verdict.warnings(averaged.answer.fit, len(robust.rejected), robust.kept or 0)


def _frames(
    folder: Path | None, wallpaper: bool, camera: str | None, depth_scale: float | None
) -> FrameSequence:
    from certpgo.registration.sequences import read_sequence
    from certpgo.registration.synthetic import synthetic_sequence

    if folder is None:
        return synthetic_sequence(wallpaper=wallpaper)
    return read_sequence(folder, camera=camera, depth_scale=depth_scale)


def _objective(found: Reconstruction | Fused) -> str:
    """The name of the certified cost."""
    if _factors(found) is not None:
        return found.averaged.answer.certificate.objective
    return "F" if found.averaged.instance.graph.information is None else "g2o"


def _factors(found: Reconstruction | Fused) -> FloatArray | None:
    """(n,) factors of the depths of the frames that are used; None where they are known."""
    return getattr(found, "factors", None)


def _write_factors(out: Path, found: Reconstruction | Fused) -> None:
    """Write number, name and factor of each frame that is used."""
    from certpgo.io.csv_files import write_csv

    factors, numbers = _factors(found), found.averaged.nodes.tolist()
    if factors is not None:
        names = [found.frames.names[k] for k in numbers]
        rows = zip(numbers, names, factors.tolist(), strict=True)
        write_csv(out, ["frame", "name", "factor"], rows)


@contextmanager
def _reporting() -> Iterator[Progress]:
    """A spinner on a terminal, and a line at the end of each stage elsewhere."""
    with working("reading frames") as status:

        def progress(stage: str, done: int, total: int) -> None:
            status.update(f"{stage}: {done} of {total}")
            if done == total and not sys.stderr.isatty():
                notice(f"{stage}: {total}")

        yield progress

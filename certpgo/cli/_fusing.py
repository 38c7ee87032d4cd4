"""Scenes from a given pose graph, and what a reconstruction writes: points, mesh and page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from certpgo.cli._paging import origin_of, write_page
from certpgo.cli._reading import Reading
from certpgo.cli._show import working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.registration.averaging import Averaged
    from certpgo.registration.features import ColourCamera
    from certpgo.registration.fuse import ColouredCloud
    from certpgo.registration.reconstruct import Reconstruction, ReconstructSettings
    from certpgo.registration.sequences import FrameSequence
    from certpgo.registration.stages import Progress

#: Voxels of a mesh, metres.
MESH = 0.02
#: Rejected edges that are named; the others are counted.
NAMED = 10


@dataclass(frozen=True, eq=False)
class Fused:
    """Frames fused at the poses of a given graph; as a `Reconstruction`, without its pairs."""

    frames: FrameSequence
    averaged: Averaged
    scene: ColouredCloud
    colour: ColourCamera | None
    skipped: tuple[str, ...] = ()

    @property
    def odometry(self) -> int:
        """How many edges are between neighbouring frames."""
        a = self.averaged
        numbers = a.instance.ids[a.instance.graph.edges]
        return int((abs(numbers[:, 1] - numbers[:, 0]) == 1).sum())

    def rejected_named(self) -> list[str]:
        """The rejected edges, by their images."""
        a, names = self.averaged, self.frames.names
        ends = a.instance.ids[a.instance.graph.edges[~a.kept]].tolist()
        return [f"{names[i]} and {names[j]}" for i, j in ends]

    def consistency(self) -> list[tuple[str, str]]:
        """What was measured of how well edges agree, and what is not proven."""
        from certpgo.registration.reconstruct import UNPROVEN

        a = self.averaged
        return [
            ("frames", f"{len(a.nodes)} of {len(self.frames)}"),
            ("edges", f"{int(a.kept.sum())} of {len(a.kept)} kept, {self.odometry} of odometry"),
            *a.said_of_fit(),
            ("not proven", UNPROVEN),
        ]


def fused_at(
    graph: Path,
    frames: FrameSequence,
    settings: ReconstructSettings,
    cache: Path | None,
    progress: Progress,
) -> Fused:
    """The frames at the certified poses of a graph's file.

    Raises
    ------
    InputError
        A node whose id is no number of a frame, or nodes of unknown scale.
    """
    from certpgo.io import read
    from certpgo.registration.averaging import averaged_graph
    from certpgo.registration.calibration import colour_camera
    from certpgo.registration.fuse import fused
    from certpgo.registration.stages import Cache

    instance = read(graph)
    if instance.graph.has_scales:
        raise InputError(
            f"{graph}: nodes of unknown scale, and --frames fuses depths of known scale: fuse the "
            "frames with --unknown-depth-scale --out SCENE, or solve the graph with certpgo solve"
        )
    last = len(frames) - 1
    outside = [node for node in instance.ids.tolist() if not 0 <= node <= last]
    if outside:
        raise InputError(
            f"{graph}: node {outside[0]} is no frame: {frames.name} has frames 0 to {last}"
        )
    averaged = averaged_graph(instance, instance.initial)
    colour = colour_camera(frames, settings.calibrate, Cache(cache), progress)
    scene = fused(
        frames,
        averaged.nodes,
        averaged.estimate,
        grid=settings.grid,
        cutoff=settings.cutoff,
        colour=colour,
        progress=progress,
    )
    return Fused(frames, averaged, scene, colour)


def write_scene(out: Path, found: Reconstruction | Fused, cutoff: float, *, mesh: bool) -> None:
    """Write the points, or a mesh of the frames, as PLY."""
    import numpy as np

    from certpgo.io.surfaces import Surface, write_surface

    if not mesh:
        write_surface(out, Surface(found.scene.points.astype(float), found.scene.colours))
        return
    from certpgo.registration import tsdf

    def seen() -> Iterator[tuple[Any, Any]]:
        for k in found.averaged.nodes.tolist():
            frame, lens = found.frames.frame(k), found.colour
            colours = frame.colour if lens is None else lens.seen(frame, found.frames.camera)
            yield colours, np.where(frame.depth <= cutoff, frame.depth, 0.0)

    with working("fusing the mesh"):
        volume = tsdf.integrate(seen(), found.averaged.poses, found.frames.camera, voxel=MESH)
        vertices, faces, colours = tsdf.mesh(volume)
    write_surface(out, Surface(vertices, colours, faces))


def write_reconstruction(out: Path, found: Reconstruction | Fused, graph: Path | None) -> None:
    """Write the page of the certificate, with the points and the rejected edges."""
    from certpgo.io.surfaces import Surface
    from certpgo.solve.assessment import assess

    averaged, answer = found.averaged, found.averaged.answer
    given, problem, kept = averaged.instance, answer.problem, averaged.kept
    instance = given.with_edges(kept)
    assessment = assess(
        problem,
        averaged.estimate,
        answer.certificate,
        instance=instance,
        fitting=answer.fit_at,
    )
    remarks = [f"{name}: {said}." for name, said in found.consistency()]
    if rejected := found.rejected_named():
        more = f"; and {len(rejected) - NAMED} more" if len(rejected) > NAMED else ""
        remarks.append(f"Rejected: {'; '.join(rejected[:NAMED])}{more}.")
    origin = origin_of(
        found.frames.name if graph is None else str(graph),
        Reading(),
        method="certified",
        remarks=remarks,
        partial=not kept.all(),
        settings=answer.settings,
    )
    write_page(
        out,
        instance,
        problem,
        averaged.estimate,
        assessment,
        origin,
        cloud=Surface(found.scene.points.astype(float), found.scene.colours),
        rejected=given.graph.edges[~kept],
    )

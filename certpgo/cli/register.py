"""certpgo register: bring scans of one scene into one frame, with a certificate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import Json
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._show import facts, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.registration.register import Registration
    from certpgo.registration.scans import Scan

#: What the verdict leaves open.
LIMITS = (
    "the verdict says that no poses fit the measured pairs better, not that the right surfaces "
    "were matched"
)


@tells_unwritten("out", "graph", "trajectory")
def command(
    scans: Annotated[
        list[Path],
        typer.Argument(
            metavar="SCANS...", help="Point clouds: PLY, PCD, VTK, CSV, XYZ or KITTI .bin files."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="OUT", help="Write all points to this PLY file, in one frame."
        ),
    ],
    initial: Annotated[
        Path | None,
        typer.Option(
            "--initial", help="Approximate pose of each scan: bun.conf, or a trajectory (TUM)."
        ),
    ] = None,
    method: Annotated[
        str, typer.Option("--method", help="pose_graph, or global_icp without a certificate.")
    ] = "pose_graph",
    voxel: Annotated[
        float | None,
        typer.Option(
            "--voxel",
            metavar="METRES",
            show_default="about 10,000 points a scan",
            help="Voxel size; points in a voxel are averaged.",
        ),
    ] = None,
    reach: Annotated[
        float | None,
        typer.Option(
            "--reach",
            metavar="METRES",
            show_default="20 voxels",
            help="Largest initial displacement of points.",
        ),
    ] = None,
    graph: Annotated[
        Path | None, typer.Option("--graph", help="Write the pose graph to this g2o file.")
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option("--trajectory", help="Write the poses to this TUM file.")
    ] = None,
    json: Json = False,
) -> int:
    """Bring overlapping scans of one scene into one frame.

    Global ICP moves all scans at once; generalized ICP measures each pair that overlaps; the pose
    graph of these measurements is solved and certified. Ctrl-C ends the command, and nothing is
    written.
    """
    from certpgo import register
    from certpgo.registration.scans import read_initial, read_scan

    outputs = Outputs(scene=out, graph=graph, estimate=trajectory, json=json)
    outputs.refuse()
    outputs.refuse_overwriting(*scans, initial)
    if graph is not None and method == "global_icp":
        raise InputError("global_icp has no pose graph: not with --graph")
    with working("reading scans") as status:
        read = [read_scan(path) for path in scans]
        start = None if initial is None else read_initial(initial, [scan.name for scan in read])
        found = register(
            read,
            start,
            method=method,  # type: ignore[arg-type] # refused there
            voxel=voxel,
            reach=reach,
            told=status.update,
        )
    certificate = None if found.solution is None else found.solution.certificate
    return emit([_Registered(certificate, read, found)], [outputs])


@dataclass(frozen=True)
class _Registered(Result):
    """Scans in one frame."""

    scans: list[Scan]
    found: Registration

    def write(self, outputs: Outputs) -> None:
        from certpgo import write

        with working("writing"):
            if outputs.scene is not None:
                _write_cloud(outputs.scene, self.scans, self.found)
            if outputs.graph is not None and self.found.instance is not None:
                write(outputs.graph, self.found.instance)
            outputs.write(self.found.estimate)

    def notices(self, outputs: Outputs) -> Iterator[str]:
        if not self.found.coarse.converged:
            yield "global ICP reached its limit of rounds: look at the scene"
        if self.found.solution is None:
            yield "global ICP proves nothing: --method pose_graph does"
            return
        yield LIMITS
        yield from _verdict.warnings(self.found.fit)

    def show(self, outputs: Outputs) -> None:
        scans, found = self.scans, self.found
        count = sum(len(scan.points) for scan in scans)
        coarse = found.coarse
        lines = [
            ("scans", f"{len(scans)}, of {count} points"),
            ("voxel", f"{found.voxel:.3g} m"),
            (
                "global ICP",
                f"{coarse.rounds} rounds, {coarse.groups} groups, rms {coarse.rmse:.2g} m",
            ),
        ]
        if found.disagreement is not None:
            shares = [pair.found.overlap for pair in found.pairs]
            overlaps = [f"{share:.0%}" for share in (min(shares), max(shares))]
            rmse = max(pair.found.rmse for pair in found.pairs)
            lines += [
                ("pairs", f"{len(found.pairs)} kept, {len(found.sliding)} contradict the others"),
                ("overlap", f"{' to '.join(dict.fromkeys(overlaps))} of the smaller scan"),
                ("surfaces", f"at most {rmse:.2g} m apart, rms of a pair"),
                (
                    "disagreement",
                    f"at most {found.disagreement.max():.2g} m, between a pair and the poses",
                ),
            ]
        if found.solution is not None:
            _verdict.headline(found.solution.certificate)
        facts([*lines, ("written", str(outputs.scene))])
        if found.solution is not None and found.instance is not None:
            typer.echo()
            _verdict.show(found.solution.certificate, found.instance, fit=found.fit)

    def report(self, outputs: Outputs) -> dict[str, Any]:
        found = self.found
        names = [scan.name for scan in self.scans]
        solved, instance = found.solution, found.instance
        verdict: dict[str, Any] = {"verdict": None}
        if solved is not None and instance is not None:
            verdict = _verdict.as_json(instance, solved.certificate, solved.cost, fit=found.fit)
        disagreement = [] if found.disagreement is None else found.disagreement.tolist()
        return {
            **verdict,
            "registration": {
                "scans": names,
                "voxel": found.voxel,
                "converged": found.coarse.converged,
                "rounds": found.coarse.rounds,
                "pairs": [
                    {
                        "scans": [names[pair.i], names[pair.j]],
                        "overlap": pair.found.overlap,
                        "rmse": pair.found.rmse,
                        "disagreement": metres,
                    }
                    for pair, metres in zip(found.pairs, disagreement, strict=True)
                ],
                "sliding": [[names[pair.i], names[pair.j]] for pair in found.sliding],
                "limits": LIMITS,
                "written": str(outputs.scene),
            },
        }


def _write_cloud(out: Path, scans: list[Scan], found: Registration) -> None:
    """All points in the world, in their own colours, or in one for each scan."""
    import colorsys

    import numpy as np

    from certpgo.io.surfaces import Surface, write_surface

    points, colours = [], []
    translations = found.estimate.translations
    if translations is None:
        raise InputError("an estimate of scans has translations")
    for k, (scan, R, t) in enumerate(
        zip(scans, found.estimate.rotations, translations, strict=True)
    ):
        points.append(scan.points @ R.T + t)
        own = np.rint(255 * np.array(colorsys.hsv_to_rgb(k / len(scans), 0.5, 0.9)))
        painted = np.tile(own.astype(np.uint8), (len(scan.points), 1))
        colours.append(painted if scan.colours is None else scan.colours)
    write_surface(out, Surface(np.concatenate(points), np.concatenate(colours)))

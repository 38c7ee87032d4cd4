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
from certpgo.cli._rules import Rule, without_known_scale
from certpgo.cli._show import facts, working
from certpgo.errors import InputError, SpecError

if TYPE_CHECKING:
    from certpgo.graph import Estimate
    from certpgo.registration.register import Registration
    from certpgo.registration.scans import Scan
    from certpgo.registration.submaps import SubmapRegistration

EXAMPLES = (
    "certpgo register scans/*.ply -o scene.ply",
    "certpgo register scans/*.pcd -o scene.ply --graph scans.g2o",
)
#: What the verdict leaves open.
LIMITS = (
    "the verdict says that no poses fit the measured pairs better, not that the right surfaces "
    "were matched"
)
METHODS = ("pose_graph", "global_icp")
RULES = (
    Rule(
        "--{option} is for scans in one unit, aligned by ICP: not with --scale",
        "initial|voxel|reach",
        "scale",
    ),
    Rule("global_icp takes scans in one unit: not with --scale", "method=global_icp", "scale"),
    without_known_scale("scale"),
    Rule("--{option} needs --scale", "matches|scales", without="scale"),
    Rule("{out}: the points are written as .ply", "out", without="out=?*.ply"),
    Rule(
        "--scale needs --matches: alignment of clouds does not tell their scales",
        "scale",
        without="matches",
    ),
    Rule("global_icp has no pose graph: not with --graph", "method=global_icp", "graph"),
)


@tells_unwritten("out", "graph", "trajectory", "scales")
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
    scale: Annotated[
        bool,
        typer.Option(
            "--scale", help="Estimate an unknown scale of each scan, from the points of --matches."
        ),
    ] = False,
    matches: Annotated[
        Path | None,
        typer.Option(
            "--matches",
            help="With --scale: matched points, lines SCAN POINT SCAN POINT; points count from 0.",
        ),
    ] = None,
    scales: Annotated[
        Path | None,
        typer.Option("--scales", metavar="CSV", help="With --scale: write the scale of each scan."),
    ] = None,
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
        Path | None,
        typer.Option(
            "--graph", help="Write the pose graph to this g2o file; with --scale to .npz."
        ),
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

    With --scale, scans are sub-maps whose units of length are unknown. Points of theirs that were
    matched, some of them wrongly, make the cost: the squared distances of those that agree in
    pairs, F over similarities. The first scan stays as it is, and its unit is that of the result.
    """
    from certpgo import register
    from certpgo.registration.scans import read_initial, read_scan

    if method not in METHODS:
        raise SpecError.unknown("method", method, METHODS)
    outputs = Outputs(scene=out, graph=graph, estimate=trajectory, csv=scales, json=json)
    outputs.refuse(*scans, initial, matches)
    if matches is not None:
        return _scaled(scans, matches, outputs)
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
                _write_cloud(outputs.scene, self.scans, self.found.estimate)
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
        facts([*lines, *(("written", str(path)) for path in outputs.files)])
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


def _scaled(scans: list[Path], matches: Path, outputs: Outputs) -> int:
    """Register sub-maps of unknown scale by matched points."""
    from certpgo.registration.scans import read_scan
    from certpgo.registration.submaps import read_matches, register_submaps

    with working("reading scans"):
        read = [read_scan(path) for path in scans]
        matched = read_matches(matches, read)
    with working("solving"):
        found = register_submaps(read, matched)
    return emit([_Submaps(found.solution.certificate, read, found)], [outputs])


@dataclass(frozen=True)
class _Submaps(Result):
    """Sub-maps in one frame and unit."""

    scans: list[Scan]
    found: SubmapRegistration

    @property
    def scales(self) -> list[float]:
        """Units of the first scan that one of each scan is."""
        scales = self.found.estimate.scales
        return [] if scales is None else scales.tolist()

    def write(self, outputs: Outputs) -> None:
        from certpgo import Estimate, write
        from certpgo.io.csv_files import write_csv

        estimate = self.found.estimate
        with working("writing"):
            if outputs.scene is not None:
                _write_cloud(outputs.scene, self.scans, estimate)
            if outputs.graph is not None:
                write(outputs.graph, self.found.instance)
            if outputs.csv is None:
                outputs.write(estimate)
            else:
                outputs.write(Estimate(estimate.rotations, estimate.translations))
                names = [scan.name for scan in self.scans]
                write_csv(outputs.csv, ["scan", "scale"], zip(names, self.scales, strict=True))

    def notices(self, outputs: Outputs) -> Iterator[str]:
        yield LIMITS
        for i, j in self.found.left_out:
            names = f"{self.scans[i].name} and {self.scans[j].name}"
            yield f"left out: no similarity agrees with enough matches of {names}"

    def show(self, outputs: Outputs) -> None:
        from certpgo.certify.wording import named_cost

        scans, found = self.scans, self.found
        agreeing = sum(len(pair.p) for pair in found.pairs)
        names = [scan.name for scan in scans]
        _verdict.headline(found.solution.certificate)
        facts(
            [
                ("cost", f"{named_cost(found.solution.certificate.objective)}, of matched points"),
                ("scans", f"{len(scans)}, of {sum(len(scan.points) for scan in scans)} points"),
                (
                    "matches",
                    f"{agreeing} of {found.total.sum()} agree, in {len(found.pairs)} pairs",
                ),
                (
                    "disagreement",
                    f"at most {found.residuals.max():.3g} times the noise that a pair alone shows",
                ),
                *(
                    ("scale", f"{scale:.6g}, of {name}")
                    for name, scale in zip(names, self.scales, strict=True)
                ),
                *(("written", str(path)) for path in outputs.files),
            ]
        )

    def report(self, outputs: Outputs) -> dict[str, Any]:
        found = self.found
        names, certificate = [scan.name for scan in self.scans], found.solution.certificate
        rows = zip(found.pairs, found.total.tolist(), found.residuals.tolist(), strict=True)
        return {
            "verdict": certificate.verdict.value,
            "reason": certificate.reason,
            "cost": found.solution.cost,
            "lower_bound": certificate.lower_bound,
            "objective": found.solution.certificate.objective,
            "registration": {
                "scans": names,
                "scales": self.scales,
                "pairs": [
                    {
                        "scans": [names[pair.i], names[pair.j]],
                        "matches": total,
                        "inliers": len(pair.p),
                        "residual": residual,
                    }
                    for pair, total, residual in rows
                ],
                "left_out": [[names[i], names[j]] for i, j in found.left_out],
                "limits": LIMITS,
                "written": str(outputs.scene),
            },
        }


def _write_cloud(out: Path, scans: list[Scan], estimate: Estimate) -> None:
    """All points in the world, in their own colours, or in one for each scan."""
    import colorsys

    import numpy as np

    from certpgo.io.surfaces import Surface, write_surface

    points, colours = [], []
    translations = estimate.translations
    if translations is None:
        raise InputError("an estimate of scans has translations")
    scales = np.ones(len(scans)) if estimate.scales is None else estimate.scales
    placed = zip(scans, scales, estimate.rotations, translations, strict=True)
    for k, (scan, s, R, t) in enumerate(placed):
        points.append(s * scan.points @ R.T + t)
        own = np.rint(255 * np.array(colorsys.hsv_to_rgb(k / len(scans), 0.5, 0.9)))
        painted = np.tile(own.astype(np.uint8), (len(scan.points), 1))
        colours.append(painted if scan.colours is None else scan.colours)
    write_surface(out, Surface(np.concatenate(points), np.concatenate(colours)))

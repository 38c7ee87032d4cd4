"""Files of how sure each node is: covariances, and regions of all estimates of low cost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from certpgo.cli._show import notice
from certpgo.cli._verdict import pose_called

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Estimate, Instance
    from certpgo.objective.choose_cost import Certifiable


def write_covariances(
    out: Path, part: Instance, problem: Certifiable, estimate: Estimate, *, quiet: bool
) -> None:
    """Write the covariances of all nodes."""
    import numpy as np

    from certpgo.graph.phrases import few, shown_id
    from certpgo.io.covariances import write_covariances
    from certpgo.io.frames import in_file_frame
    from certpgo.optimize.marginals import Marginals

    world, ids, whole = part.world, part.ids, problem.tangent_layout.whole
    # Covariances of points are in the frame of the estimate, so that is the written one.
    framed = in_file_frame(estimate, part) if world is None else estimate.anchored(world)
    anchor = int(world or (part.held or whole)[0])
    marginals = Marginals(problem, framed, anchor, part.held)
    rotations = framed.translations is None
    written = slice(world)  # without the world, the last node
    points = np.ones(len(ids), dtype=bool)
    points[whole] = False
    covariances = marginals.covariances[written]
    write_covariances(out, covariances, ids[written], points[written], rotations=rotations)
    if not quiet:
        fixed = "the world" if world else f"node {shown_id(int(ids[marginals.anchor]))}"
        if held := [int(ids[k]) for k in part.held if k != anchor]:
            fixed += f" and {few([f'node {shown_id(k)}' for k in held])}"
        frames = "each node's frame"
        if points.any():
            frames = "each pose's frame, and of points in the world's"
        typer.echo(f"covariances: {out}, in {frames}, with {fixed} fixed")


def write_regions(
    out: Path,
    part: Instance,
    problem: Certifiable,
    certificate: Certificate | None,
    *,
    reference: int | None,
    level: float | None,
    quiet: bool,
) -> bool:
    """Write how far each node is in all estimates of low cost; False if that is not known.

    Parameters
    ----------
    reference : the id of the pose that they are seen from
    """
    from certpgo.io.regions import write_regions
    from certpgo.solve.likelihood import LEVEL, excesses

    level = LEVEL if level is None else level
    known, excess = certificate and certificate.regions, excesses(problem, level)
    found = known and known.distance(pose_called(reference, part), excess)
    if not found:
        notice(f"no regions are written to {out}: nothing is proven of them")
        return False
    write_regions(out, found.metres, found.degrees, part.ids, part.world)
    if not quiet:
        seen = part.named(found.reference)
        typer.echo(f"regions: {out}, seen from {seen}, at a level of {level:g}")
    return True

"""Accuracy with respect to ground truth (--truth)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._show import noticing

if TYPE_CHECKING:
    from certpgo.assess.metrics import TrajectoryErrors
    from certpgo.cli._reading import Reading
    from certpgo.graph import Estimate, Instance
    from certpgo.linalg.arrays import IntArray

TruthFile = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="Ground truth of the poses, by node id, a file or dataset: print the absolute and "
        "relative trajectory errors (ATE, RPE).",
    ),
]


@dataclass(frozen=True)
class KnownPoses:
    """Ground truth of some poses of a graph: ``nodes`` (k,), ascending, and their ``poses``."""

    nodes: IntArray
    poses: Estimate

    @classmethod
    def of(cls, path: Path | None, part: Instance, reading: Reading) -> KnownPoses | None:
        """The truth in a file or dataset, of the poses of a graph; None without a file.

        Raises
        ------
        FormatError
            The file cannot be read, or is of another graph.
        """
        import numpy as np

        from certpgo.io import read_truth

        if path is None:
            return None
        path = reading.resolve(str(path)).path()
        with noticing():
            nodes, poses = read_truth(path, part, topic=reading.topic_of(path))
        of_poses = np.isin(nodes, part.poses)
        return cls(nodes[of_poses], poses.subset(np.flatnonzero(of_poses)))

    def errors(self, estimate: Estimate) -> TrajectoryErrors:
        """The errors of an estimate of the graph, in the order of node ids."""
        from certpgo.assess.metrics import trajectory_errors

        known = estimate.subset(self.nodes)
        if self.poses.translations is None:
            known = known.with_translations(None)
        return trajectory_errors(known, self.poses)

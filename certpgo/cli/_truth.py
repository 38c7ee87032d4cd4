"""Accuracy with respect to ground truth (--truth)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._help import MATCHING
from certpgo.cli._rules import Rule
from certpgo.cli._show import notice

if TYPE_CHECKING:
    from certpgo.cli._reading import Reading
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.matching import Matching
    from certpgo.linalg.arrays import IntArray
    from certpgo.solve.metrics import TrajectoryErrors

TruthFile = Annotated[
    str | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        rich_help_panel=MATCHING,
        help="Ground truth of the poses, a file or dataset: print the absolute and relative "
        "trajectory errors (ATE, RPE). Matched by time where the nodes' times are known "
        "(--timestamps FILE), else by node id.",
    ),
]
TruthOffset = Annotated[
    float,
    typer.Option(
        "--truth-offset",
        metavar="SECONDS",
        rich_help_panel=MATCHING,
        help="Added to the timestamps of the truth.",
    ),
]
OF_TRUTH = Rule("--truth-offset is about --truth", "truth_offset", without="truth")


@dataclass(frozen=True)
class KnownPoses:
    """Ground truth of some poses of a graph: ``nodes`` (k,), ascending, and their ``poses``.

    Errors are after the best similarity if estimates are ``unscaled``: without any known scale.
    """

    nodes: IntArray
    poses: Estimate
    unscaled: bool = False

    @classmethod
    def of(
        cls, source: Source | None, part: Instance, reading: Reading, how: Matching
    ) -> KnownPoses | None:
        """The truth in a file or dataset, of the poses of a graph; None without a file.

        A notice says how many of these there are, and how they were matched.

        Raises
        ------
        FormatError
            The file cannot be read, or is of another graph.
        """
        import numpy as np

        from certpgo.io.estimates import matched_truth, truth_in_words

        if source is None:
            return None
        path = source.path()
        nodes, poses, found = matched_truth(path, part, how, topic=reading.topic_of(source))
        notice(f"{path}: {truth_in_words(found, part)}")
        of_poses = np.isin(nodes, part.poses)
        known = poses.subset(np.flatnonzero(of_poses))
        return cls(nodes[of_poses], known, part.graph.in_mean_unit)

    def errors(self, estimate: Estimate) -> TrajectoryErrors:
        """The errors of an estimate of the graph, in the order of node ids."""
        from certpgo.solve.metrics import trajectory_errors

        known = estimate.subset(self.nodes)
        if self.poses.translations is None:
            known = known.with_translations(None)
        return trajectory_errors(known, self.poses, scaled=self.unscaled)

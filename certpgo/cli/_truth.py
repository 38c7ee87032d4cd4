"""Accuracy with respect to ground truth (--truth)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._completion import inputs
from certpgo.cli._help import MATCHING
from certpgo.cli._rules import Rule
from certpgo.cli._show import notice
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.cli._reading import Reading
    from certpgo.diagnosis import KnownTruth
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.format import LabelledPoses
    from certpgo.io.matching import Matching
    from certpgo.linalg.arrays import IntArray
    from certpgo.solve.metrics import TrajectoryErrors

TruthFile = Annotated[
    str | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        autocompletion=inputs,
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
    ``read`` are all poses of the file, and ``how`` they were matched.
    """

    nodes: IntArray
    poses: Estimate
    unscaled: bool
    read: LabelledPoses
    how: Matching

    @classmethod
    def of(
        cls, source: Source | None, part: Instance, reading: Reading, how: Matching
    ) -> KnownPoses | None:
        """The truth in a file or dataset, of the poses of a graph; None without a file.

        A notice says how many of these there are, and how they were matched.

        Raises
        ------
        FormatError
            The file cannot be read, or is of another graph, or its clock is.
        """
        import numpy as np

        from certpgo.errors import in_file
        from certpgo.io.estimates import true_poses, truth_among, truth_in_words

        if source is None:
            return None
        path = source.path()
        read = true_poses(path, topic=reading.topic_of(source))
        with in_file(path):
            try:
                nodes, poses, found = truth_among(read, part, how)
            except InputError as refusal:
                from certpgo.diagnosis.truth import offset_by_start

                said = filter(None, (str(refusal), offset_by_start(read, part, how)))
                raise InputError("; ".join(said)) from None
        notice(f"{path}: {truth_in_words(found, part)}")
        of_poses = np.isin(nodes, part.poses)
        known = poses.subset(np.flatnonzero(of_poses))
        return cls(nodes[of_poses], known, part.graph.in_mean_unit, read, how)

    def explained(self, part: Instance) -> KnownTruth:
        """The same with the clock of the file, to be explained."""
        from certpgo.diagnosis import KnownTruth
        from certpgo.diagnosis.examined import Clock

        return KnownTruth(self.nodes, self.poses, Clock.of(self.read, part, self.how))

    def errors(self, estimate: Estimate) -> TrajectoryErrors:
        """The errors of an estimate of the graph, in the order of node ids."""
        from certpgo.solve.metrics import trajectory_errors

        known = estimate.subset(self.nodes)
        if self.poses.translations is None:
            known = known.with_translations(None)
        return trajectory_errors(known, self.poses, scaled=self.unscaled)

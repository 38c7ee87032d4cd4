"""What other readings of an estimate leave of the cost of some measured poses, all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.graph import Estimate
from certpgo.graph.information import Information
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL

#: Measurements that are enough.
SAMPLED = 300
#: Squared correlation of steps with measured ones from which a scale is one.
ALIKE = 0.8


@dataclass(frozen=True, eq=False)
class Sample:
    """Some measured poses, of the whole of a map.

    Attributes
    ----------
    examined : the map
    rows : (k,) which measurements
    nodes : (l,) their nodes
    ends : (k, 2) the places of each one's nodes among these
    """

    examined: Examined
    rows: IntArray
    nodes: IntArray
    ends: IntArray

    @classmethod
    def of(cls, examined: Examined) -> Self | None:
        """Those of a map; None where no poses are measured."""
        rows = np.flatnonzero(examined.whole)
        if not len(rows):
            return None
        rows = rows[np.linspace(0, len(rows) - 1, min(SAMPLED, len(rows))).astype(np.intp)]
        edges = examined.instance.graph.edges[rows]
        nodes, ends = np.unique(edges, return_inverse=True)
        return cls(examined, rows, nodes, ends.reshape(edges.shape))

    def shares(
        self, given: Estimate, readings: Sequence[Estimate], known: Sequence[BoolArray | None]
    ) -> FloatArray:
        """(r,) what readings leave of the cost of an estimate, in the unit that fits best.

        Residuals are weighed as the cost does for small ones.

        Parameters
        ----------
        given, readings : of the sample's nodes
        known : (l,) which of these have a pose in a reading; None for all
        """
        counts = np.ones((len(readings) + 1, len(self.rows)))
        for row, has_pose in zip(counts[1:], known, strict=True):
            if has_pose is not None:
                row[:] = has_pose[self.ends].all(axis=1)
        e, moves = self._residuals([given, *readings])
        d, W = moves.shape[2], self._weights
        heavy = (W @ e[..., None])[..., 0]
        still, along = (heavy * e).sum(axis=2), (heavy[..., :d] * moves).sum(axis=2)
        size = (moves * (W[:, :d, :d] @ moves[..., None])[..., 0]).sum(axis=2)
        stated = (e[0, :, :d] * (W[:, :d, :d] @ e[0, :, :d, None])[..., 0]).sum(axis=1)
        as_given = counts[1:] @ (still + 2.0 * along + size)[0]
        still, along, size = ((counts * of).sum(axis=1)[1:] for of in (still, along, size))
        left = still + 2.0 * along + size
        scales = (along < 0.0) & (along**2 > ALIKE * size * (counts[1:] @ stated))
        scaled = still - along**2 / np.where(scales, size, 1.0)
        left = np.where(scales, np.minimum(left, scaled), left)
        return np.asarray(left / np.where(as_given > 0.0, as_given, 1.0))

    def _residuals(self, estimates: Sequence[Estimate]) -> tuple[FloatArray, FloatArray]:
        """(r, k, p) residuals if nodes stood at one point, and (r, k, d) what positions add.

        In the frame that each measured pose has.
        """
        graph, (i, j) = self.examined.instance.graph, self.ends.T
        M = np.swapaxes(graph.rotations[self.rows], 1, 2)
        R = np.stack([one.rotations for one in estimates])
        back = M @ np.swapaxes(R[:, i], 2, 3)
        turned = so.log(back @ R[:, j]).reshape(len(R), len(i), -1)
        if not graph.has_positions:
            return turned, np.zeros((len(R), len(i), 0))
        t = np.stack([one.translations for one in estimates if one.translations is not None])
        moves = (back @ (t[:, j] - t[:, i])[..., None])[..., 0]
        measured = (M @ graph.translations[self.rows][:, :, None])[:, :, 0]
        return np.concatenate([np.broadcast_to(-measured, moves.shape), turned], axis=2), moves

    @cached_property
    def _weights(self) -> FloatArray:
        """(k, p, p) about tangents."""
        problem = self.examined.problem
        graph = problem.measured
        stated = None if problem.cost_name == CHORDAL else graph.information
        if stated is None:
            tau = graph.tau if graph.has_positions else np.zeros_like(graph.kappa)
            stated = Information.isotropic(graph.kappa, tau, graph.d)
        matrices = stated[self.rows].about_tangents().matrices
        return matrices if graph.has_positions else matrices[:, graph.d :, graph.d :]

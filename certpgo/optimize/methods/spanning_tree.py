"""Composing measurements along a spanning tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

Tree = Literal["breadth_first", "odometry", "earliest", "maximum_weight"]


@dataclass(frozen=True)
class SpanningTree(Settings):
    """The simplest initialization: exact on the tree's edges, ignoring all others.

    Attributes
    ----------
    tree : ``"breadth_first"`` from node 0; ``"odometry"`` prefers edges between close node numbers,
        hence the chain of consecutive poses if there is one; ``"earliest"`` prefers edges in their
        order, as most files list odometry before loop closures; ``"maximum_weight"`` prefers large
        kappa

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("spanning_tree")(tree="odometry").solve(problem)
    >>> print(problem.residual_angles(solution.estimate).round(6))  # all on the last edge
    [0.  0.  0.  0.  0.  0.3]
    """

    tree: Tree = "breadth_first"

    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses, or rotations, with the first node at the identity."""
        watch = Stopwatch()
        lengths = self._lengths(problem.rotation.graph)
        with watch.phase("tree"):
            estimate = compose(problem.graph, spanning_tree(problem.graph, lengths))
        return Solution(estimate, problem.cost(estimate), Status.CLOSED_FORM, seconds=watch.seconds)

    def _lengths(self, graph: Graph) -> FloatArray | None:
        if self.tree == "breadth_first":
            return None
        if self.tree == "odometry":
            return np.abs(np.diff(graph.edges, axis=1)[:, 0]).astype(np.float64)
        if self.tree == "earliest":
            return np.arange(1.0, graph.num_edges + 1.0)
        # Only the order of lengths matters for a minimum spanning tree.
        return np.asarray(np.unique(-graph.kappa, return_inverse=True)[1] + 1, dtype=np.float64)


SOLVER = SpanningTree

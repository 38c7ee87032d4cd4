"""From measured pairs of frames to a certified trajectory, under the cost of their information.

The graph keeps the full information matrices, in g2o's convention. A robust fit under the isotropic
weights rejects wrong loops, with the steps of odometry as known inliers; the rest is solved and
certified under g2o's cost, which weighs with the matrices themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from certpgo.costs import InformationProblem
from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.registration.pairs import FramePair
from certpgo.solvers.certified.interface import solve
from certpgo.solvers.certified.pipeline import CertifiedSolution
from certpgo.solvers.certified.robust import solve_robustly

#: Residuals of g2o over tangents (rotation, translation): a quaternion's vector is half the angle,
#: and the translation comes first.
_TO_G2O = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])[:, [3, 4, 5, 0, 1, 2]]


@dataclass(frozen=True, eq=False)
class Averaged:
    """A trajectory averaged from pairs, with its certificate.

    Attributes
    ----------
    instance : the graph of all pairs of the nodes, with their information matrices
    nodes : (n,) numbers of the frames
    chosen : (m,) indices of the graph's edges into the pairs
    kept : (m,) which edges the certificate is about
    robust : the robust fit under the isotropic cost, from which rejected edges are
    answer : the certified solution for the kept edges
    """

    instance: Instance
    nodes: IntArray
    chosen: IntArray
    kept: BoolArray
    robust: CertifiedSolution
    answer: CertifiedSolution

    @property
    def estimate(self) -> Estimate:
        """Poses of the nodes; the first is the identity."""
        return self.answer.estimate.anchored(0)

    @property
    def rejected(self) -> IntArray:
        """The pairs that were rejected, ascending."""
        return np.asarray(self.chosen[~self.kept])

    def squares(self) -> FloatArray:
        """(k,) squared residuals of the kept edges, each over its 6 degrees of freedom."""
        if not isinstance(self.answer.problem, InformationProblem):
            return np.empty(0)
        return self.answer.problem.edge_costs(self.answer.estimate) / 6.0


def pose_graph(
    pairs: Sequence[FramePair], names: Sequence[str], name: str
) -> tuple[Instance, IntArray]:
    """The graph of the frames that most pairs join, and the indices of its pairs.

    Parameters
    ----------
    pairs : measured edges
    names : of all frames, by their numbers
    name : of the graph
    """
    ends = np.array([(p.i, p.j) for p in pairs])
    covariances = np.array([p.covariance for p in pairs])
    # Variances of the mean axis: F weighs |R - R'|^2, twice the squared angle.
    kappa = 1.5 / np.trace(covariances[:, :3, :3], axis1=1, axis2=2)
    tau = 3.0 / np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2)
    R, t = np.array([p.R for p in pairs]), np.array([p.t for p in pairs])
    whole = PoseGraph(RotationGraph(len(names), ends, R, kappa), t, tau)
    largest = int(np.argmax(np.bincount(whole.components)))
    nodes = np.flatnonzero(whole.components == largest)
    chosen = np.flatnonzero(whole.components[ends[:, 0]] == largest)
    information = np.linalg.inv(_TO_G2O @ covariances[chosen] @ _TO_G2O.T)
    information = 0.5 * (information + np.swapaxes(information, 1, 2))
    instance = Instance(
        name,
        whole.subgraph(nodes),
        nodes,
        information=Information(information, np.arange(len(chosen)), "g2o"),
    )
    return instance, chosen


def composed(
    pairs: Sequence[FramePair], names: Sequence[str], name: str
) -> tuple[IntArray, Estimate]:
    """The frames that pairs join, and their poses composed along the chain of steps."""
    instance, _ = pose_graph(pairs, names, name)
    edges = instance.ids[instance.graph.edges]
    # A tree of the shortest steps is the chain, with longer ones across gaps.
    lengths = 1.0 + (edges[:, 1] - edges[:, 0]).astype(np.float64)
    tree = spanning_tree(instance.graph, lengths)
    return instance.ids, compose(instance.graph, tree)


def averaged(
    pairs: Sequence[FramePair], names: Sequence[str], name: str, initial: Estimate | None = None
) -> Averaged:
    """The certified trajectory of the frames that most pairs join.

    Parameters
    ----------
    initial : poses of these frames, from which the robust fit begins
    """
    instance, chosen = pose_graph(pairs, names, name)
    graph = instance.graph
    if not isinstance(graph, PoseGraph) or instance.information is None:
        raise InputError(f"{name}: no poses")
    steps = np.array([pairs[k].j - pairs[k].i == 1 for k in chosen.tolist()])
    start = initial if initial is not None and initial.num_nodes == graph.num_nodes else None
    robust = solve_robustly(graph, initial=start, trusted=np.flatnonzero(steps))
    weights = robust.solution.weights
    kept = np.ones(len(chosen), dtype=bool) if weights is None else weights > 0.0
    certified = replace(
        instance,
        graph=graph.with_edges(kept),
        information=instance.information.subset(kept),
    )
    answer = solve(certified, initial=robust.estimate)
    return Averaged(instance, instance.ids, chosen, kept, robust, answer)

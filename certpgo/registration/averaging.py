"""From measured pairs of frames to a certified trajectory, under the cost of their information.

The graph keeps the full information matrices, in g2o's convention. A robust fit under the isotropic
weights rejects wrong loops, with the steps of odometry as known inliers; the rest is solved and
certified under g2o's cost, which weighs with the matrices themselves. Where the scale of each frame
is unknown, it is F over similarities, with weights in the frames' own units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph, SimilarityGraph
from certpgo.graph.graph import require_connected
from certpgo.graph.information import Information
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import Sum
from certpgo.registration.pairs import FramePair
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.reweighing import reweigh
from certpgo.solve.robust import solve_robustly
from certpgo.solve.solving import solve

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
    scales : (n,) lengths in the map over those that the pairs have in each frame, where these are
        unknown; of geometric mean 1. The graph is in units so much larger, and the answer's scales
        are near 1
    """

    instance: Instance
    nodes: IntArray
    chosen: IntArray
    kept: BoolArray
    robust: CertifiedSolution
    answer: CertifiedSolution
    scales: FloatArray | None = None

    @property
    def estimate(self) -> Estimate:
        """Poses of the nodes, with scales where they are unknown; the first is the identity."""
        return self.answer.estimate.anchored(0)

    @property
    def poses(self) -> Estimate:
        """The same without scales."""
        found = self.estimate
        return Estimate(found.rotations, found.translations, found.keys)

    @property
    def rejected(self) -> IntArray:
        """The pairs that were rejected, ascending."""
        return np.asarray(self.chosen[~self.kept])

    def said_of_fit(self) -> list[tuple[str, str]]:
        """chi^2 of the kept edges in words, where their noise is stated."""
        fit = self.answer.fit
        return [] if fit is None else [("chi^2", f"{fit}, of the kept edges")]

    def squares(self) -> FloatArray:
        """(k,) squared residuals of the kept edges, each over its 6 degrees of freedom."""
        if not isinstance(self.answer.problem, Sum):
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
    tau = 3.0 / np.trace(covariances[:, 3:6, 3:6], axis1=1, axis2=2)
    R, t = np.array([p.R for p in pairs]), np.array([p.t for p in pairs])
    whole = PoseGraph(RotationGraph(len(names), ends, R, kappa), t, tau)
    largest = int(np.argmax(np.bincount(whole.components)))
    nodes = np.flatnonzero(whole.components == largest)
    chosen = np.flatnonzero(whole.components[ends[:, 0]] == largest)
    information = np.linalg.inv(_TO_G2O @ covariances[chosen, :6, :6] @ _TO_G2O.T)
    information = 0.5 * (information + np.swapaxes(information, 1, 2))
    graph = whole.subgraph(nodes).with_information(Information.of(information, "g2o", "quaternion"))
    return Instance(name, graph, nodes), chosen


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
    pairs: Sequence[FramePair],
    names: Sequence[str],
    name: str,
    initial: Estimate | None = None,
    *,
    trust: bool = True,
) -> Averaged:
    """The certified trajectory of the frames that most pairs join.

    Parameters
    ----------
    initial : poses of these frames, from which the robust fit begins
    trust : whether the steps to the next frame are known to be right; if not, the robust fit begins
        at the least squares of all pairs
    """
    instance, chosen = pose_graph(pairs, names, name)
    start = initial if initial is not None and initial.num_nodes == len(instance.ids) else None
    return averaged_graph(instance, start, trust=trust, chosen=chosen)


def averaged_scales(
    pairs: Sequence[FramePair],
    names: Sequence[str],
    name: str,
    initial: Estimate | None = None,
    *,
    trust: bool = True,
) -> Averaged:
    """The certified trajectory, and the scales, of the frames that most pairs join.

    A robust fit of poses rejects pairs, so the units of frames must be about equal. The others are
    solved as similarities by `reweigh`: the certificate is about F with the last weights.

    Parameters
    ----------
    pairs : with scales
    initial, trust : as in `averaged`
    """
    rigid = averaged(pairs, names, name, initial, trust=trust)
    graph = _similarities(rigid.instance.graph, [pairs[k] for k in rigid.chosen.tolist()])
    kept = replace(rigid.instance, graph=graph).with_edges(rigid.kept)
    found = reweigh(kept).estimate.scales
    scales = np.ones(graph.num_nodes) if found is None else found
    scales = scales / np.exp(np.log(scales).mean())
    units = graph.in_units_of(scales)
    answer = solve(units.with_edges(rigid.kept))
    instance = replace(rigid.instance, graph=units)
    return replace(rigid, instance=instance, answer=answer, scales=scales)


def _similarities(graph: Graph, pairs: Sequence[FramePair]) -> Graph:
    """The graph of poses with the scales of its pairs, all unknown."""
    ends, R, t = graph.edges, np.array([p.R for p in pairs]), np.array([p.t for p in pairs])
    C = np.array([p.covariance for p in pairs])
    turns, shifts = (np.trace(C[:, k : k + 3, k : k + 3], axis1=1, axis2=2) for k in (0, 3))
    # |A - A'|^2 is twice the squared angle and 3 times that of log scale: 4 degrees of freedom.
    kappa = 4.0 / (2.0 * turns + 3.0 * C[:, 6, 6])
    rotation = RotationGraph(graph.num_nodes, ends, R, kappa)
    scales = np.array([p.scale for p in pairs])
    return SimilarityGraph(rotation, t, 3.0 / shifts, scales=scales)


def averaged_graph(
    instance: Instance,
    initial: Estimate | None = None,
    *,
    trust: bool = True,
    chosen: IntArray | None = None,
) -> Averaged:
    """The certified trajectory of a pose graph whose ids are numbers of frames.

    Parameters
    ----------
    instance : the graph; certified under g2o's cost if it has information matrices, else under F
    initial, trust : as in `averaged`
    chosen : (m,) what its edges are called; their indices by default

    Raises
    ------
    InputError
        No graph of poses in space.
    GraphError
        It is not connected.
    """
    graph = instance.graph
    if not graph.has_positions or graph.d != 3:
        raise InputError(f"{instance.name}: no poses in space")
    require_connected(graph)
    start, trusted = initial, None
    if trust:
        numbers = instance.ids[graph.edges]
        trusted = np.flatnonzero(np.abs(numbers[:, 1] - numbers[:, 0]) == 1)
    else:
        start = solve(graph, cost="chordal").estimate
    robust = solve_robustly(graph, initial=start, trusted=trusted)
    weights = robust.solution.weights
    kept = np.ones(graph.num_edges, dtype=bool) if weights is None else weights > 0.0
    answer = solve(instance.with_edges(kept), initial=robust.estimate)
    edges = np.arange(graph.num_edges) if chosen is None else chosen
    return Averaged(instance, instance.ids, edges, kept, robust, answer)

"""Data for the view of a trajectory: positions, edges and their residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo.assess.assessment import measured_parts, residual_lengths
from certpgo.costs import InformationProblem
from certpgo.graph import Estimate, PoseGraph
from certpgo.io.plural import counted
from certpgo.linalg import so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.problem import Problem

#: Edges drawn at most: the costliest, and the others sampled evenly.
EDGES = 20_000
#: Share of these reserved for the costliest.
COSTLIEST = 0.1
#: Quantile of the residuals that gets the last colour; larger residuals share it.
TOP = 0.98
#: The residual, in data, of what an edge does not measure.
NOT_MEASURED = -1.0
#: Kinds of edges, in data.
BETWEEN, SIGHTING, PRIOR = 0, 1, 2

Data = dict[str, Any]


def scene(
    problem: Problem | InformationProblem,
    estimate: Estimate,
    ids: IntArray,
    *,
    world: int | None = None,
    limit: int = EDGES,
) -> Data:
    """Positions, edges and residuals for the view's script.

    A rotation graph has no positions: nodes are drawn at their rotation vectors in the frame of
    their mean, in 2D on the unit circle. The world is not drawn, and the view is in its frame; what
    is measured from it is a mark at the pose.

    Parameters
    ----------
    ids : (n,) node ids
    world : the node from which priors are measured, the last one; None for none
    limit : maximal number of edges drawn

    Returns
    -------
    ``dimensions``; ``points`` (k, 2 or 3) with ``ids``; ``edges`` (e, 2) into these, with their
    ``numbers`` in the graph and whether each is a ``loop`` closure (between nodes whose ids are not
    consecutive); ``measures``, each with ``unit``, ``values`` (e,), `NOT_MEASURED` for what an
    edge does not measure, and the ``top`` of its colours; ``sentences`` on what is shown. Where
    there are landmarks or a world, ``landmarks`` (k,) flags, and ``kinds`` (e,) of edges: the ends
    of a `PRIOR` are both the measured node.
    """
    edges, landmarks, kinds = _kinds(problem, world)
    measures = _residuals(problem, estimate)
    drawn = _chosen(problem.edge_costs(estimate), limit)
    nodes = np.unique(edges[drawn])
    count = len(ids) if world is None else world
    if count <= limit:
        nodes = np.arange(count)
    points, sentence = _positions(estimate if world is None else estimate.anchored(world))
    sentences = [sentence, *_said(kinds, landmarks)]
    if len(drawn) < len(edges):
        sentences.append(
            f"{len(drawn):,} of {len(edges):,} edges are drawn: the {int(COSTLIEST * limit):,} "
            "costliest, and the others sampled evenly."
        )
    if len(nodes) < count:
        sentences.append(f"Of {count:,} nodes, the {len(nodes):,} at these edges are drawn.")
    ends = edges[drawn]
    more = {"landmarks": landmarks[nodes].astype(int).tolist(), "kinds": kinds[drawn].tolist()}
    return {
        **(more if kinds.any() else {}),
        "dimensions": estimate.d,
        "points": _rounded(points[nodes]),
        "ids": ids[nodes].tolist(),
        "edges": np.searchsorted(nodes, ends).tolist(),
        "numbers": drawn.tolist(),
        "loop": (np.abs(ids[ends[:, 0]] - ids[ends[:, 1]]) != 1).astype(int).tolist(),
        "measures": [
            {
                "unit": unit,
                "values": [float(f"{value:.4g}") for value in values[drawn].tolist()],
                "top": float(f"{_top(values):.3g}"),
            }
            for unit, values in measures
        ],
        "sentences": sentences,
    }


def _kinds(
    problem: Problem | InformationProblem, world: int | None
) -> tuple[IntArray, BoolArray, IntArray]:
    """Edges (m, 2) as drawn, which nodes are landmarks (n,), and the kinds of edges (m,)."""
    graph = (problem.chordal if isinstance(problem, InformationProblem) else problem).graph
    edges, landmarks = graph.edges, np.zeros(graph.num_nodes, dtype=bool)
    if isinstance(graph, PoseGraph) and graph.points is not None:
        landmarks = graph.points
    kinds = np.where(landmarks[edges[:, 1]], SIGHTING, BETWEEN)
    if world is not None:
        kinds[edges[:, 0] == world] = PRIOR
        edges = np.where((kinds == PRIOR)[:, None], edges[:, 1:], edges)
    return edges, landmarks, kinds


def _residuals(
    problem: Problem | InformationProblem, estimate: Estimate
) -> list[tuple[str, FloatArray]]:
    """Units, and (m,) residuals of what edges measure."""
    turned, moved = measured_parts(problem)
    angles = np.degrees(problem.residual_angles(estimate))
    measures = [("degrees", np.where(turned, angles, NOT_MEASURED))]
    lengths = residual_lengths(problem, estimate)
    if lengths is not None:
        measures.append(("metres", np.where(moved, lengths, NOT_MEASURED)))
    return measures if turned.any() else measures[1:]


def _said(kinds: IntArray, landmarks: BoolArray) -> list[str]:
    """How landmarks and priors are drawn, where there are any."""
    said = []
    if landmarks.any():
        seen = counted(int((kinds == SIGHTING).sum()), "sighting{s}")
        points = counted(int(landmarks.sum()), "landmark{s}")
        said.append(f"Drawn as dots: {points}; as faint lines: {seen}.")
    if (kinds == PRIOR).any():
        priors = counted(int((kinds == PRIOR).sum()), "prior{s}")
        said.append(f"Drawn as rings, at the nodes that they measure: {priors}.")
    return said


def _chosen(costs: FloatArray, limit: int) -> IntArray:
    """Indices of the drawn edges, ascending."""
    m = len(costs)
    if m <= limit:
        return np.arange(m)
    order = np.argsort(-costs, kind="stable")
    worst = int(COSTLIEST * limit)
    others = np.sort(order[worst:])
    evenly = others[np.linspace(0, len(others) - 1, limit - worst).round().astype(int)]
    return np.sort(np.concatenate([order[:worst], evenly]))


def _positions(estimate: Estimate) -> tuple[FloatArray, str]:
    if estimate.translations is not None:
        return estimate.translations, "Nodes are drawn at their positions, in metres."
    mean = so.project(estimate.rotations.sum(axis=0)[None])[0]
    turned = so.log(mean.T @ estimate.rotations)
    if estimate.d == 3:
        return turned, "Nodes are drawn at their rotation vectors from the mean, in radians."
    angle = turned.reshape(-1)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1), "Nodes are drawn at their angles."


def _rounded(points: FloatArray) -> list[list[float]]:
    """Points rounded to about 1e-5 of their extent."""
    extent = float(np.ptp(points, axis=0).max(initial=0.0))
    decimals = 5 - int(np.floor(np.log10(extent))) if extent > 0.0 else 5
    rows: list[list[float]] = (np.round(points, decimals) + 0.0).tolist()
    return rows


def _top(values: FloatArray) -> float:
    """The residual with the last colour, not dominated by a few outliers."""
    finite = values[np.isfinite(values) & (values >= 0.0)]
    return float(np.quantile(finite, TOP)) or float(finite.max()) if len(finite) else 0.0

"""Data for the view of a trajectory: positions, edges and their residuals."""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo.assess.assessment import residual_lengths
from certpgo.costs import InformationProblem
from certpgo.graph import Estimate
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.problem import Problem

#: Edges drawn at most: the costliest, and the others sampled evenly.
EDGES = 20_000
#: Share of these reserved for the costliest.
COSTLIEST = 0.1
#: Quantile of the residuals that gets the last colour; larger residuals share it.
TOP = 0.98

Data = dict[str, Any]


def scene(
    problem: Problem | InformationProblem,
    estimate: Estimate,
    ids: IntArray,
    *,
    limit: int = EDGES,
) -> Data:
    """Positions, edges and residuals for the view's script.

    A rotation graph has no positions: nodes are drawn at their rotation vectors in the frame of
    their mean, in 2D on the unit circle.

    Parameters
    ----------
    ids : (n,) node ids
    limit : maximal number of edges drawn

    Returns
    -------
    ``dimensions``; ``points`` (k, 2 or 3) with ``ids``; ``edges`` (e, 2) into these, with their
    ``numbers`` in the graph and whether each is a ``loop`` closure (between nodes whose ids are not
    consecutive); ``measures``, each with ``unit``, ``values`` (e,) and the ``top`` of its colours;
    ``sentences`` on what is shown.
    """
    angles = np.degrees(problem.residual_angles(estimate))
    measures = [("degrees", angles)]
    lengths = residual_lengths(problem, estimate)
    if lengths is not None:
        measures.append(("metres", lengths))
    edges = problem.graph.edges
    drawn = _chosen(problem.edge_costs(estimate), limit)
    nodes = np.unique(edges[drawn])
    if len(ids) <= limit:
        nodes = np.arange(len(ids))
    points, sentence = _positions(estimate)
    sentences = [sentence]
    if len(drawn) < len(edges):
        sentences.append(
            f"{len(drawn):,} of {len(edges):,} edges are drawn: the {int(COSTLIEST * limit):,} "
            "costliest, and the others sampled evenly."
        )
    if len(nodes) < len(ids):
        sentences.append(f"Of {len(ids):,} nodes, the {len(nodes):,} at these edges are drawn.")
    ends = edges[drawn]
    return {
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
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, TOP)) or float(finite.max()) if len(finite) else 0.0

"""Bounds on the rounding of the certificate matrix's entries."""

from __future__ import annotations

import math

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg import compiled
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.operators import degrees
from certpgo.objective.quadratic import Quadratic


def assembly_errors(
    problem: Quadratic, multipliers: FloatArray, w: FloatArray, is_rotation: BoolArray
) -> FloatArray:
    """(N,) row sums of the rounding in S's entries, weighted by w; 0 where S is a stored number.

    An entry that sums k products is off by at most k + 4 units of rounding of the sum of their
    sizes, the problem's own ``roundings``, and the distance of measured rotations from SO(d). Row
    sums of d x d rotations are at most sqrt(d); the bound follows by the triangle inequality.
    """
    if problem.takes_scales:
        return problem.scales.entry_errors(problem.pattern, multipliers, w)
    n, d = problem.n, problem.d
    graph = problem.rotation.graph
    sums = (np.bincount(graph.edges.ravel(), minlength=n) + 4.0 + problem.roundings) * U
    root = math.sqrt(d)
    if graph.is_general:
        # Couplings are stored as they are, and the nuclear norm bounds all of an edge's blocks.
        nuclear = np.trace(graph.polar[1], axis1=1, axis2=2)
        turn = 2.1 * root * sums * degrees(graph.edges, nuclear, n)
    else:
        defect = rotation_defect(graph.rotations)
        turn = (sums + defect) * problem.rotation.node_weights * (1.0 + root)
    turn = turn + sums * np.abs(multipliers).sum(axis=2).max(axis=1)
    if not problem.has_positions:
        return np.repeat(turn, d)
    w_t = float(w[~is_rotation][0])
    out, spread, across, degree = _lever_sums(problem.graph)
    turn = turn + sums * (spread + 2.0 * out * w_t)
    move = 2.0 * degree * w_t + 2.0 * out + across
    layout = problem.pattern.layout_of(problem.matrix)
    of_positions = int(layout.sizes.max()) - d
    rows = [sums * move] * of_positions + [turn] * d
    return layout.pack(np.stack(rows, axis=1))


def _lever_sums(graph: Graph) -> FloatArray:
    """(4, n) sums, in any order, of the sizes of levers b from i to j, and of arms a at j.

    With 1-norms: of tau |b| at i and tau |a| at j, of these times |a| + |b|, of tau |b| at j and
    tau |a| at i, and of tau at both.
    """
    n, (i, j), rotation = graph.num_nodes, graph.edges.T, graph.rotations_alone
    if compiled.AVAILABLE:
        measured = rotation.rotations, None, rotation.kappa, graph.tau, graph.translations
        sums = np.zeros((n, 4))
        compiled.kernel.lever_sums((graph.edges, *measured, graph.arms), graph.d, sums)
        return np.ascontiguousarray(sums.T)
    tau, b = np.abs(graph.tau), np.abs(graph.translations).sum(axis=1)
    a = np.zeros_like(b) if graph.arms is None else np.abs(graph.arms).sum(axis=1)
    at_i = np.stack([tau * b, tau * b * (a + b), tau * a, tau], axis=1)
    at_j = np.stack([tau * a, tau * a * (a + b), tau * b, tau], axis=1)
    return np.ascontiguousarray((scatter_sum(i, at_i, n) + scatter_sum(j, at_j, n)).T)

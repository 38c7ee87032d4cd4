"""Where descents begin if F has no terms for what joins some nodes.

With inertial measurements that is at averaged rotations, for which residuals are linear in
positions, velocities and gravity, whose length alone is a constraint: they are solved for without
it, and gravity is turned to where it came out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from certpgo.graph import Estimate, Graph
from certpgo.graph.capabilities import FEATURES
from certpgo.graph.edges import components_of
from certpgo.graph.preintegrated import VA, VB, A, B, W
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.families.preintegrated import Preintegration
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.initialization import Start, start_of

#: Weight of a position where it is, over the mean of all: what else determines them decides.
FAINT = 1e-12


def joint_start(problem: Quadratic | Sum) -> Start:
    """Averaged rotations, and what is best for them, with inertial measurements; else a tree."""
    if FEATURES["inertial"].is_in(problem.measured):
        return _inertial_start(problem)
    return Start(tree_initialization(problem.graph), "a tree of measurements")


def _inertial_start(problem: Any) -> Start:
    R = _rotations(problem.measured)
    [term] = [term for _, term in problem.terms if isinstance(term, Preintegration)]
    t, g = _linear(problem.measured, term, R)
    w, first = np.unique(term.block.nodes[:, W], return_index=True)
    for node, given in zip(w, term.block.gravity[first], strict=True):
        measured = problem.measured.measures_rotation & (problem.measured.edges == node).any(axis=1)
        if not measured.any() and given.any() and g.any():
            towards = g / np.linalg.norm(g)
            R[node] = so.aligning(given[None] / np.linalg.norm(given), towards)[0]
    return Start(Estimate(R, t), "averaged rotations and linear equations")


def _rotations(graph: Graph) -> FloatArray:
    """(n, d, d) rotations averaged where edges join them; the identity of other nodes."""
    turned = graph.with_blocks().with_edges(graph.measures_rotation)
    part, R = (
        components_of(graph.num_nodes, turned.edges),
        np.tile(np.eye(3), (graph.num_nodes, 1, 1)),
    )
    for label in np.unique(part[turned.edges[:, 0]]):
        nodes = np.flatnonzero(part == label)
        alone = turned.subgraph(nodes).rotations_alone
        R[nodes] = start_of(Quadratic(alone)).estimate.rotations
    return R


def _linear(graph: Graph, term: Preintegration, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) positions and (3,) gravity, without its length, that are best for these rotations."""
    block, n = term.block, graph.num_nodes
    moved = np.flatnonzero(graph.measures_translation)
    (i, j), root = graph.edges[moved].T, np.sqrt(graph.tau[moved])
    steps = (R[i] @ graph.translations[moved][:, :, None])[:, :, 0]
    if graph.arms is not None:
        steps -= (R[j] @ graph.arms[moved][:, :, None])[:, :, 0]
    rows = np.arange(len(moved))
    of_edges = _matrix([rows, rows], [i, j], [-root, root], (len(moved), n + 1))
    (m, h), c, w = term.levers, term.coefficients, np.sqrt(block.weights)
    k = len(c)
    of_each = np.arange(2 * k).reshape(k, 2)
    columns = block.nodes[:, [A, VA, B, VB]]
    lengths = np.maximum(np.linalg.norm(block.gravity, axis=1), np.finfo(float).tiny)
    share = np.einsum("kra,ka->kr", h, block.gravity) / lengths[:, None] ** 2
    of_steps = _matrix(
        [of_each] * 5,
        [*(np.tile(columns[:, [at]], (1, 2)) for at in range(4)), np.full((k, 2), n)],
        [*(w * c[:, :, at] for at in range(4)), -w * share],
        (2 * k, n + 1),
    )
    system = sp.csr_array(sp.vstack([of_edges, of_steps]))
    turned = m @ np.swapaxes(R[block.nodes[:, A]], 1, 2)
    rhs = np.concatenate([root[:, None] * steps, (w[..., None] * turned).reshape(-1, 3)])
    H = sp.csc_array(system.T @ system)
    # The moves of everything cost nothing.
    diagonal = H.diagonal()
    x = spla.spsolve(H + FAINT * sp.diags_array(diagonal + float(diagonal.mean())), system.T @ rhs)
    return x[:n], x[n]


def _matrix(
    rows: list[IntArray], columns: list[IntArray], values: list[FloatArray], shape: tuple[int, int]
) -> sp.csr_array:
    flat = [np.concatenate([part.ravel() for part in parts]) for parts in (values, rows, columns)]
    return sp.csr_array(sp.coo_array((flat[0], (flat[1], flat[2])), shape=shape))

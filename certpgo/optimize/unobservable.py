"""What measurements leave open at an estimate, and which others would determine it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import Layout, add_to_diagonal, divided, pinned
from certpgo.optimize.marginals import Measured

#: Of the Gauss-Newton matrix scaled to a unit diagonal: eigenvalues below which a motion costs
#: nothing, and what is added before it is factorized.
FREE, SHIFT = 1e-13, 1e-14
#: Motions looked for at most, and steps of the inverse iteration.
MOST, STEPS = 12, 4
#: Part of the largest entry of a motion below which a number does not move.
STILL = 1e-6
#: What determines a node, and how many nodes a sentence names.
KINDS, SHOWN = ("rotation", "position"), 3


@dataclass(frozen=True)
class Undetermined:
    """Motions of nodes, relative to an anchor, that no measurement notices.

    Attributes
    ----------
    motions : how many independent ones; `MOST` stands for that many or more
    nodes : (k,) nodes that move or turn, ascending
    cures : measurements relative to the anchor that would determine all, as pairs of
        ``"rotation"`` or ``"position"`` and a node
    anchor : node that is fixed
    """

    motions: int
    nodes: tuple[int, ...]
    cures: tuple[tuple[str, int], ...]
    anchor: int

    def in_words(self, named: Callable[[int], str] = "node {}".format) -> str:
        """One sentence; ``named`` says what a node is called."""
        move = f"{_listed(self.nodes, named)} move{'s' * (len(self.nodes) == 1)} freely"
        many = f"{self.motions} ways or more" if not self.cures else counted(self.motions, "way{s}")
        said = f"{move} relative to {named(self.anchor)}, in {many}"
        if not self.cures:
            return said
        by_kind = {kind: [node for name, node in self.cures if name == kind] for kind in KINDS}
        cures = " and ".join(
            f"the {kind}{'s' * (len(nodes) > 1)} of {_listed(nodes, named)}"
            for kind, nodes in by_kind.items()
            if nodes
        )
        return f"{said}: measurements of {cures} would determine all"


def _listed(nodes: Sequence[int], named: Callable[[int], str]) -> str:
    known = [named(node) for node in nodes[: SHOWN if len(nodes) > SHOWN + 1 else None]]
    if len(known) < len(nodes):
        known.append(f"{len(nodes) - len(known)} more")
    *first, last = known
    return f"{', '.join(first)} and {last}" if first else last


def undetermined(problem: Measured, estimate: Estimate, anchor: int) -> Undetermined | None:
    """What the measurements leave open at an estimate; None if they determine all nodes.

    Parameters
    ----------
    problem : with measurements that join all nodes
    estimate : at which they are linearized
    anchor : a pose, relative to which the others move

    Examples
    --------
    Positions of two poses only, in space: all turns about the line between them.

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> made = helix(3, np.random.default_rng(0))
    >>> fixes = made.truth.translations[[0, 8]]
    >>> graph = certpgo.with_priors(made.graph, [0, 8], translations=fixes, tau=25.0)
    >>> answer = certpgo.solve(graph)
    >>> print(undetermined(answer.problem, answer.estimate, 9).cures)
    (('rotation', 0),)
    """
    layout = problem.tangent_layout
    fixed = layout.rows_of(anchor)
    H = pinned(problem.gauss_newton(estimate), fixed)
    basis = _kernel(problem, H)
    if not basis.shape[1]:
        return None
    moves = np.linalg.norm(basis, axis=1)
    moved = layout.unpack(np.where(moves > STILL * moves.max(), moves, 0.0))
    nodes = tuple(np.flatnonzero(moved.any(axis=1)).tolist())
    cures = () if basis.shape[1] >= MOST else _cures(layout, basis, estimate)
    return Undetermined(basis.shape[1], nodes, cures, anchor)


def _kernel(problem: Measured, H: CSC) -> FloatArray:
    """(N, k) motions that cost nothing, k up to `MOST`, of which columns are orthogonal if scaled.

    By inverse iteration on the matrix scaled to a unit diagonal.
    """
    diagonal = H.diagonal()
    root = np.sqrt(np.where(diagonal > 0.0, diagonal, diagonal.max()))
    A = divided(H, root)
    shifted = add_to_diagonal(A, SHIFT)
    factor = problem.symbolic(shifted).factor(shifted)
    if factor is None:
        return np.zeros((len(root), 0))
    V = np.random.default_rng(0).standard_normal((len(root), min(MOST, len(root))))
    for _ in range(STEPS):
        V = np.linalg.qr(factor.solve(V))[0]
    values, turn = np.linalg.eigh(V.T @ (A @ V))
    return np.asarray((V @ turn[:, values < FREE]) / root[:, None])


def _cures(layout: Layout, basis: FloatArray, estimate: Estimate) -> tuple[tuple[str, int], ...]:
    """Measurements of single nodes that leave none of the motions: rotations first."""
    d, cures = estimate.rotations.shape[1], list[tuple[str, int]]()
    for kind, part in zip(KINDS, (slice(d, None), slice(d)), strict=True):
        while basis.shape[1]:
            rows = np.stack([layout.unpack(column)[:, part] for column in basis.T], axis=2)
            size = np.linalg.norm(rows, axis=(1, 2))
            node = int(np.argmax(size > 0.5 * size.max()))  # the first of the most mobile
            if not size[node] > STILL * np.linalg.norm(basis, axis=1).max():
                break
            _, values, right = np.linalg.svd(rows[node])
            rank = int((values > STILL * values[0]).sum())
            cures.append((kind, node))
            basis = basis @ right[rank:].T
    return tuple(cures)

"""Exhaustive search: branch and bound over the angles of at most four rotations in the plane.

With f_e = 4 kappa (1 - cos delta_e) and delta_e the residual angle, a cell of half-width h around c
satisfies F >= F(c) - h |grad F(c)|_1 - 2 h^2 sum kappa w^2, where w is how many of an edge's two
angles vary, and edges whose cosine stays positive in the cell need no second-order term.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic

#: Nodes that a search takes, and cells that it holds at once.
MOST_NODES, MOST_CELLS = 4, 200_000
#: Below the best value found, relative to it and to W, where a cell is not looked into.
RELATIVE, ABSOLUTE = 1e-7, 2e-13
#: The doubles' own rounding, relative to W.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class SearchedOptimum:
    """The best estimate of a search, and what F* is at least."""

    best: Estimate
    lower: float


def minimum(problem: Quadratic) -> SearchedOptimum | None:
    """The optimum; None when the cells become too many.

    Raises
    ------
    InputError
        Rotations in space, or more nodes than four.
    """
    if problem.d != 2 or problem.n > MOST_NODES:
        raise InputError("an exhaustive search takes at most four rotations in the plane")
    field, free = _Field(problem), problem.n - 1
    half = math.pi / 4.0
    centres = np.array(list(itertools.product(half * np.arange(-3, 4, 2), repeat=free)))
    best, value, lower = centres[0], math.inf, math.inf
    scale = problem.scale
    while len(centres):
        if len(centres) > MOST_CELLS:
            return None
        values, floors = field.at(centres, half)
        if values.min() < value:
            best, value = centres[np.argmin(values)], float(values.min())
        enough = value - RELATIVE * value - ABSOLUTE * scale
        dropped = floors >= enough
        lower = min(lower, float(floors[dropped].min(initial=math.inf)))
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=free)))
        centres = (centres[~dropped][:, None] + half * corners).reshape(-1, free)
        half /= 2.0
    angles = np.concatenate([[0.0], best])
    return SearchedOptimum(Estimate(so.exp(angles[:, None])), min(lower, value) - ROUNDING * scale)


class _Field:
    """F and its lower bounds on cells of angles."""

    def __init__(self, problem: Quadratic) -> None:
        graph = problem.graph
        self.i, self.j = graph.edges.T
        self.measured = so.log(graph.rotations)[:, 0]
        self.kappa = graph.kappa
        self.varying = (self.i > 0).astype(float) + (self.j > 0)
        self.incidence = np.zeros((graph.num_edges, problem.n))
        rows = np.arange(graph.num_edges)
        self.incidence[rows, self.j] += 1.0
        self.incidence[rows, self.i] -= 1.0

    def at(self, centres: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
        """Values at the centres (c, n - 1) and lower bounds over the cells, (c,) each."""
        phi = np.concatenate([np.zeros((len(centres), 1)), centres], axis=1)
        delta = phi @ self.incidence.T - self.measured
        values = 8.0 * np.sin(0.5 * delta) ** 2 @ self.kappa
        gradient = (4.0 * self.kappa * np.sin(delta)) @ self.incidence[:, 1:]
        reach = self.varying * half
        # cos is 1-Lipschitz, so it stays above this in the cell.
        bending = np.clip(reach - np.cos(delta), 0.0, 1.0)
        second = 2.0 * (bending * self.kappa * reach**2).sum(axis=1)
        return values, values - half * np.abs(gradient).sum(axis=1) - second

"""Minorants of a sum of terms at points of any rank, where distances alone have tangents."""

from __future__ import annotations

import numpy as np

from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.objective.families.distances import Distances
from certpgo.objective.minorants import Minorants
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.terms import minorants_of


def tangents_at(problem: Sum, point: Point, found: Minorants | None = None) -> Minorants:
    """The minorants, with tangents of distances at a point in place of theirs.

    Parameters
    ----------
    found : of the other measurements; by default those at any point, which are of F
    """
    v, Q = np.zeros((problem.graph.num_edges, problem.d)), problem.graph.rotations
    distances = [(rows, term) for rows, term in problem.terms if type(term) is Distances]
    for rows, term in distances:
        (i, j), t = term.edges.T, translations_of(point)
        v[rows, 0] = np.linalg.norm(t[j] - t[i], axis=1)
    here = found if found is not None else minorants_of(problem.terms, v, Q)
    for rows, term in distances:
        chosen = np.isin(np.arange(len(v)), rows)
        here = here.replaced(chosen, term.minorants(v[rows], Q[rows]))
    return here


def quadratic_of(problem: Sum, minorants: Minorants) -> Quadratic:
    """The problem that all minorants add up to, without their constants."""
    return problem.form_of_sums.of_same_edges(problem.summed(minorants, minorants.exist)[0])

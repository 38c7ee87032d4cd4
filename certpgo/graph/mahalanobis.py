"""Weights of rotations by all of their information."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from certpgo.graph.edges import symmetric
from certpgo.graph.graph import Graph
from certpgo.graph.information import Information
from certpgo.graph.matrix_weights import of_rotations

#: How far K stays from singular where it is clipped, relative to O's second eigenvalue.
_MARGIN = 2.0**-20


def mahalanobis(graph: Graph, information: Information) -> Mahalanobis:
    """The graph whose rotational terms are the Mahalanobis distances of the information.

    A term tr(E K E^T), E = R_j - R_i R_ij, is 4 sin^2(theta/2) n^T O n for a residual angle theta
    about n and K = tr(O)/2 I - O in space, K = O/2 I in the plane: theta^2 n^T O n to second order.
    K is positive definite if the largest eigenvalue of O is less than the sum of the others. It is
    lowered to that elsewhere, so that each term, and every bound, is below that of O.

    Parameters
    ----------
    graph : the measurements, with kappa and tau, which is kept
    information : of its edges, about tangents
    """
    omega, d = information.distinct[:, graph.d :, graph.d :], graph.d
    if d == 2:
        return Mahalanobis(graph.with_weights(0.5 * omega[information.index, 0, 0]), 0)
    values, axes = np.linalg.eigh(omega)
    # The smallest eigenvalue of K is then the margin.
    most = values[:, 0] + values[:, 1] - 2.0 * np.minimum(_MARGIN * values[:, 1], values[:, 0] / 4)
    clipped = values[:, 2] > most
    values[:, 2] = np.minimum(values[:, 2], most)
    K = 0.5 * (values.sum(axis=1)[:, None] - 2.0 * values)
    weights = symmetric((axes * K[:, None, :]) @ np.swapaxes(axes, 1, 2))[information.index]
    general = of_rotations(graph, weights)
    return Mahalanobis(general, int(np.count_nonzero(clipped[information.index])))


class Mahalanobis(NamedTuple):
    """A graph with Mahalanobis weights, and on how many edges they are lowered."""

    graph: Graph
    clipped: int

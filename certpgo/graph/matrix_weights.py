"""Graphs whose edges have matrix weights: anisotropic terms, or registrations of point clouds."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from certpgo.errors import GraphError, InputError
from certpgo.graph.edges import check_weights, edge_name, symmetric
from certpgo.graph.graph_data import GraphData
from certpgo.linalg.arrays import FloatArray

AnyGraph = TypeVar("AnyGraph", bound=GraphData)


def of_rotations(graph: AnyGraph, K: FloatArray) -> AnyGraph:
    """The same measurements, whose rotations have terms tr(E K E^T), E = R_j - R_i R_ij.

    Weights act on the right, in the frame of node j. With tangent information O_R, that is
    4 sin^2(theta/2) n^T O_R n for a residual angle theta about n, for K = tr(O_R)/2 I - O_R.

    Parameters
    ----------
    K : (m, d, d) symmetric positive definite matrices; or zeros for edges of kappa = 0

    Raises
    ------
    GraphError
        One is not.
    """
    K = np.asarray(K, dtype=np.float64)
    if K.shape != graph.rotations.shape or (np.swapaxes(K, 1, 2) != K).any():
        raise GraphError(f"matrix weights must be {graph.rotations.shape} and symmetric")
    unmeasured = ~graph.measures_rotation & ~K.any(axis=(1, 2))
    indefinite = np.asarray(~(np.linalg.eigvalsh(K)[:, 0] > 0.0) & ~unmeasured)
    if indefinite.any():
        raise GraphError(f"{edge_name(graph.edges, indefinite)}: K is not positive definite")
    kappa = np.trace(K, axis1=1, axis2=2) / graph.d
    return replace(graph, kappa=kappa, couplings=graph.rotations @ K, information=None)


def of_poses(graph: AnyGraph, W: FloatArray) -> AnyGraph:
    """The same measurements with terms tr(E W E^T), E = X_j - X_i [[1, 0], [t_ij, R_ij]].

    X = [t R] interleaved: the translation comes first. A positive semidefinite W is the second
    moment of a point cloud, and the term its point-to-point registration.

    Parameters
    ----------
    W : (m, d + 1, d + 1) symmetric positive definite matrices

    Raises
    ------
    GraphError
        One is not.
    InputError
        There are scales.
    """
    if graph.has_scales:
        raise InputError("similarities have isotropic weights, no matrix weights")
    W, d = np.asarray(W, dtype=np.float64), graph.d
    if W.shape != (graph.num_edges, d + 1, d + 1) or (np.swapaxes(W, 1, 2) != W).any():
        raise GraphError(f"matrix weights must be {(graph.num_edges, d + 1, d + 1)}, symmetric")
    tau, k = W[:, 0, 0], W[:, 0, 1:]
    check_weights("tau", tau, graph.edges)
    # tau |E_t + E_R k / tau|^2 + tr(E_R (K - k k^T / tau) E_R^T)
    arms = k / tau[:, None]
    general = of_rotations(graph, symmetric(W[:, 1:, 1:] - k[:, :, None] * arms[:, None, :]))
    # Arms move the measured points at both ends; those that the graph has are replaced.
    moved = arms if graph.arms is None else arms - graph.arms
    turned = (graph.rotations @ moved[:, :, None])[:, :, 0]
    return replace(general, translations=graph.translations + turned, tau=tau, arms=arms)

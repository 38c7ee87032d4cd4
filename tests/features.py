"""Small graphs, each with one feature of the table of capabilities."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
from strategies import definite, pose_graph, rng_of

from certpgo import PoseGraph, Preintegrated, Ranges
from certpgo.graph import RotationGraph, SimilarityGraph
from certpgo.graph.constructors import of_couplings

_FILE = Path(__file__).parent / "data" / "observations" / "heights.py"
_SPEC = importlib.util.spec_from_file_location("heights", _FILE)
added = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(added)

N = 6


def plain():
    """Poses in space, each measured relative to several others, in metres."""
    graph, _, _ = pose_graph(rng_of(0), N, 3, extra=12, noise=0.05)
    return graph


def having(name):
    """Poses with a feature."""
    graph, m = plain(), plain().num_edges
    pairs, ones = np.array([[0, 2], [1, 4]]), np.ones(2)
    if name == "distances":
        return graph.with_ranges(Ranges(N, pairs, 3.0 * ones, ones))
    if name == "own kinds":
        up = np.tile([0.0, 0.0, 1.0], (2, 1))
        return graph.with_blocks(added.Heights(N, pairs, up, 0.5 * ones, ones))
    if name == "inertial":
        nodes, dt, g = np.array([[0, 3, 1, 4, 5]]), np.ones(1), np.array([[0.0, 0.0, -9.81]])
        steps = dt, 2.0 * dt, 0.0 * dt, -g, -0.5 * g, g, np.ones((1, 2))
        return graph.with_blocks(Preintegrated(N, nodes, *steps))
    if name == "scales":
        rotation = graph.rotations_alone
        return SimilarityGraph(
            rotation, graph.translations, graph.tau, scales=np.ones(m), free=np.arange(N) > 0
        )
    if name == "partial edges":
        kappa = graph.kappa.copy()
        kappa[-2:] = 0.0
        rotation = RotationGraph(N, graph.edges, graph.rotations, kappa)
        return PoseGraph(rotation, graph.translations, graph.tau)
    if name == "matrix weights":
        N_of_K = graph.rotations @ definite(rng_of(1), m, 3)
        rotation = of_couplings(N, graph.edges, graph.rotations, N_of_K)
        return PoseGraph(rotation, graph.translations, graph.tau)
    return replace(graph, arms=np.full((m, 3), 0.1))

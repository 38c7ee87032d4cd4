"""Measurements and estimates: graphs, their trees, cycles and bridges."""

from __future__ import annotations

from certpgo.graph.constructors import PoseGraph, RotationGraph, SimilarityGraph
from certpgo.graph.dataset import Instance
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph

__all__ = ["Estimate", "Graph", "Instance", "PoseGraph", "RotationGraph", "SimilarityGraph"]

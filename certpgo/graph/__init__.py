"""Measurements and estimates: graphs, their trees, cycles and bridges."""

from __future__ import annotations

from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph, Instance, PoseGraph, RotationGraph

__all__ = ["Estimate", "Graph", "Instance", "PoseGraph", "RotationGraph"]

"""Measured rotations alone, of which some may be wrong: what agrees with a robust fit.

Wrong matches are a large share of a photo collection's pairs, and weights seldom state the noise.
The least cost is theirs under every convention, so half of the residuals are compared instead.
"""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from certpgo.diagnosis.edge_readings import READINGS, EdgeReading
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.errors import CertPGOError
from certpgo.graph import Graph, RotationGraph
from certpgo.graph.phrases import counted
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.outliers import UNREMARKABLE, select, states_noise

#: Readings that differ for rotations; transposed ones are inverses.
KINDS = ("inverted-edges", "edges-w-first", "edges-of-other-handedness")
#: Median residual over that of what is given from which a reading explains it.
EXPLAINS = 0.2


def found(examined: Examined) -> Finding | None:
    """The convention under which half of the rotations agree far better, or those that disagree.

    The latter where weights do not state the noise, by which `certpgo.diagnosis.judged` judges.
    """
    graph = examined.instance.graph
    if graph.has_positions or graph.has_couplings or graph.blocks:
        return None
    problem, fit = Quadratic(graph), examined.fit
    stated = states_noise(problem)
    if stated and fit is not None and not fit.is_unusually_large:
        return None
    chosen = select(problem)
    angles = problem.residual_angles(chosen.estimate)
    given, wrong = float(np.median(angles)), np.flatnonzero(chosen.rejected)
    if given > UNREMARKABLE:
        return _of_convention(examined, given)
    if stated or not len(wrong):
        return None
    verb = "disagrees" if len(wrong) == 1 else "disagree"
    few = f"{len(wrong)} of {counted(len(angles), 'measurement{s}')} {verb} with the rest"
    said = f"{few}, by up to {_shown(angles.max())}; half of all are within {_shown(given)}"
    next = "certpgo solve --robust leaves them out; certpgo outliers says what is proven"
    rows = tuple(examined.instance.known_numbers[wrong].tolist())
    return Finding("wrong-measurement", said, next, strength=1.0, edges=rows)


def _of_convention(examined: Examined, given: float) -> Finding | None:
    graph, read = examined.instance.graph, dict[EdgeReading, float]()
    for reading in READINGS:
        if reading.kind in KINDS and graph.d in reading.dimensions:
            examined.trying(reading.kind)
            with suppress(CertPGOError, np.linalg.LinAlgError):
                read[reading] = _median(_so_read(graph, reading))
    best = min(read, key=read.__getitem__, default=None)
    if best is None or not read[best] < EXPLAINS * given:
        return None
    within = f"half of them are within {_shown(read[best])} of a robust fit"
    said = f"all edges are {best.said}: so read {within}, as they stand {_shown(given)}"
    return Finding(best.kind, said, best.next, read[best], given)


def _so_read(graph: Graph, reading: EdgeReading) -> Graph:
    edges, R, _ = reading.read(graph.edges, graph.rotations, graph.translations)
    return RotationGraph(graph.num_nodes, edges, R, graph.kappa)


def _median(graph: Graph) -> float:
    """The median residual at a robust fit, radians."""
    problem = Quadratic(graph)
    return float(np.median(problem.residual_angles(select(problem).estimate)))


def _shown(angle: float) -> str:
    return f"{math.degrees(angle):.3g} degrees"

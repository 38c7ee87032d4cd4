"""Diagnostics of an instance before anything is solved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from certpgo.certify.bounds import alpha_max, fiedler_value, normalized_fiedler_value
from certpgo.errors import GraphError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.bridges import bridges
from certpgo.graph.kinds import Kind
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import rotations as so
from certpgo.linalg.factor import default_engine, engines
from certpgo.objective.choose_cost import CHORDAL, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.methods.eigen_ma import EigenMA
from certpgo.optimize.unobservable import undetermined
from certpgo.solve import metrics
from certpgo.solve.consistency import inconsistency


@dataclass(frozen=True)
class Structure:
    """Counts and connectivity of an instance.

    Attributes
    ----------
    kind : ``"poses"`` or ``"rotations"``
    d, nodes, edges : dimension and counts
    first_id, last_id, consecutive : node ids of the source
    component_sizes : nodes in each component of all measurements, largest first
    points : nodes that are points
    sightings, priors : edges that lead to points from poses; edges that leave the world
    parallel_edges : edges after the first between the same two nodes
    measurements : how many of each kind, by the names of `certpgo.graph.kinds.Kind`
    bridges : pairs of nodes whose measurement is in no cycle of measurements
    kappa, tau : smallest and largest concentration; tau in 1/m^2, None for rotations
    misclosure_degrees : the angle by which the only cycle of a graph misses; None if it has more,
        or none
    """

    kind: str
    d: int
    nodes: int
    edges: int
    first_id: int
    last_id: int
    consecutive: bool
    component_sizes: tuple[int, ...]
    points: int
    sightings: int
    priors: int
    parallel_edges: int
    measurements: dict[str, int]
    bridges: int
    kappa: tuple[float, float]
    tau: tuple[float, float] | None
    misclosure_degrees: float | None


@dataclass(frozen=True)
class Spectrum:
    """Eigenvalues of a connected graph under one set of weights; angles in radians.

    Attributes
    ----------
    smallest : the d smallest eigenvalues of the connection Laplacian
    fiedler : second smallest eigenvalue of the graph Laplacian
    inconsistency : first of ``smallest`` over ``fiedler``; see `certpgo.solve.consistency`
    alpha_max : residual angle up to which stationary rotations are optimal, by the largest degree
    normalized_alpha_max : likewise by the normalized Laplacian, never smaller
    """

    smallest: tuple[float, ...]
    fiedler: float
    inconsistency: float
    alpha_max: float
    normalized_alpha_max: float


@dataclass(frozen=True)
class Symmetry:
    """Edges' symmetry at the closed form of the poses; thesis section 4.4.

    Near 1 it supports the hypothesis (4.1.1) by which rotations are averaged first, without the
    translations.

    Attributes
    ----------
    mean : over the edges
    share : of edges at `SYMMETRIC` or above
    least, edge : the smallest, and the ids of the edge's nodes
    """

    mean: float
    share: float
    least: float
    edge: tuple[int, int]


#: Symmetry from which on an edge is counted as symmetric: the thesis leaves its tolerance open.
SYMMETRIC = 0.9


def structure(instance: Instance) -> Structure:
    """Counts and connectivity of an instance."""
    graph, ids = instance.graph, instance.ids
    measured, kappa = instance.measurements, graph.kappa
    points, sightings, priors = instance.kinds
    edges = instance.pairs[: graph.num_edges][instance.is_measured]
    simple = len(np.unique(np.sort(edges, axis=1), axis=0))
    return Structure(
        kind=graph.kind,
        d=graph.d,
        nodes=graph.num_nodes,
        edges=len(edges),
        first_id=int(ids.min()),
        last_id=int(ids.max()),
        consecutive=int(ids.max()) - int(ids.min()) + 1 == len(ids),
        component_sizes=tuple(sorted(measured.component_sizes, reverse=True)),
        points=points,
        sightings=sightings,
        priors=priors,
        parallel_edges=len(edges) - simple,
        measurements={kind.name.lower(): count for kind, count in measured.counts.items()},
        bridges=len(bridges(measured.without(Kind.HELD, Kind.ASSUMED))),
        kappa=(float(kappa.min()), float(kappa.max())),
        tau=(float(graph.tau.min()), float(graph.tau.max())) if graph.has_positions else None,
        misclosure_degrees=_misclosure(graph),
    )


def _misclosure(graph: Graph) -> float | None:
    independent = graph.num_edges - graph.num_nodes + 1
    if independent != 1 or not (graph.measures_rotation.all() and graph.is_connected):
        return None
    alone = graph.rotations_alone
    along_tree = tree_initialization(alone)
    return math.degrees(Quadratic(alone).residual_angles(along_tree).max())


def kinds_in_words(instance: Instance) -> list[str]:
    """Numbers of points, of sightings of these, and of priors, where there are any."""
    return instance.kinds_in_words


def open_in_words(instance: Instance) -> str | None:
    """What the measurements leave open wherever the nodes are; None if nothing, or not joined.

    None, too, where scales are unknown. They are linearized at random poses, at which as much is
    determined as anywhere.
    """
    graph = instance.graph
    measured = instance.measurements
    if not graph.has_positions or graph.has_scales or not measured.is_connected:
        return None
    if not measured.without(Kind.BETWEEN, Kind.PRIOR).counts:
        return None
    try:
        problem = objective_of(instance, CHORDAL)
    except GraphError as error:
        return str(error)
    rng = np.random.default_rng(0)
    turns = rng.standard_normal((graph.num_nodes, so.tangent_dim(graph.d)))
    estimate = Estimate(so.exp(turns), rng.standard_normal((graph.num_nodes, graph.d)))
    anchor = int(graph.pose_nodes[0]) if instance.world is None else instance.world
    found = undetermined(problem, estimate, anchor)
    return None if found is None else found.in_words(instance.named)


def spectra(graph: Graph) -> Mapping[str, Spectrum]:
    """Eigenvalues with unit weights and with the graph's own.

    None if some edges measure no rotation, or rotations do not connect the nodes.

    Raises
    ------
    NumericalError
        An eigenvalue computation failed.
    """
    if not (graph.measures_rotation.all() and graph.is_connected):
        return {}
    weighted = Quadratic(graph.rotations_alone)
    return {"unit": _spectrum(weighted.with_unit_weights()), "weighted": _spectrum(weighted)}


def symmetry(instance: Instance) -> Symmetry | None:
    """The test of section 4.4 of the thesis, edge by edge, at EigenMA's estimate.

    None if not all measurements are relative poses, in one unit, that connect the nodes.

    Raises
    ------
    NumericalError
        An eigenvalue computation failed.
    """
    graph = instance.graph
    if not graph.has_positions or not graph.num_edges or not graph.is_connected:
        return None
    of_others = instance.measurements.without(Kind.BETWEEN).counts
    if of_others or graph.has_scales:
        return None
    each = metrics.symmetry(graph, EigenMA().solve(Quadratic(graph)).estimate)
    worst = int(each.argmin())
    i, j = (int(instance.ids[node]) for node in graph.edges[worst])
    return Symmetry(
        mean=float(each.mean()),
        share=float((each >= SYMMETRIC).mean()),
        least=float(each[worst]),
        edge=(i, j),
    )


def engines_in_words() -> str:
    """The factorization engine in use, and those installed."""
    return f"{default_engine()} (installed: {', '.join(engines())})"


def _spectrum(problem: Quadratic) -> Spectrum:
    fiedler = fiedler_value(problem)
    smallest = tuple(float(x) for x in spectral.smallest_eigenpairs(problem).values)
    return Spectrum(
        smallest=smallest,
        fiedler=fiedler,
        inconsistency=inconsistency(smallest[0], fiedler),
        alpha_max=alpha_max(fiedler / float(problem.node_weights.max())),
        normalized_alpha_max=alpha_max(normalized_fiedler_value(problem)),
    )

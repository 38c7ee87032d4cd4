"""What nodes are, and what measurements measure: kinds of those are inferred here alone."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Protocol

import numpy as np

from certpgo.graph.edges import Pairs
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import BoolArray, IntArray


class Node(IntEnum):
    """What a node is."""

    POSE = 0  #: a rotation and a position
    ROTATION = 1  #: a rotation alone, as all nodes of its graph
    POINT = 2  #: a position alone, such as a landmark
    SCALED = 3  #: a pose whose unit of length is unknown


#: What nodes are called. One of a kind of its own has the next number: a row here, and one in
#: `certpgo.objective.manifolds.MANIFOLDS`.
NODES: dict[int, str] = {
    Node.POSE: "pose{s}",
    Node.ROTATION: "rotation{s}",
    Node.POINT: "point{s}",
    Node.SCALED: "pose{s} of unknown scale",
}


class Kind(IntEnum):
    """What a measurement is of.

    Examples
    --------
    >>> from certpgo.graph.kinds import Kind
    >>> Kind.RANGE.name, Kind.RANGE.phrase
    ('RANGE', 'distance{s}')
    """

    BETWEEN = 0  #: a pose in the frame of another
    ROTATION = 1  #: a rotation alone, between two poses
    TRANSLATION = 2  #: a translation alone, between two poses
    SIGHTING = 3  #: a point in the frame of a pose
    PRIOR = 4  #: a pose in the world
    POSITION = 5  #: a position in the world, of a pose or a point
    ATTITUDE = 6  #: a rotation in the world, or one of its directions
    RANGE = 7  #: a distance between two nodes
    HELD = 8  #: nothing: a constraint between nodes that the source fixes
    ASSUMED = 9  #: nothing: where a world is whose position nothing measures
    OTHER = 10  #: of a kind of its own, see `certpgo.graph.observations`
    INERTIAL = 11  #: a change of velocity or position, see `certpgo.graph.preintegrated`
    PRODUCT = 12  #: nothing: a product of two nodes in the cost of a measurement of more

    @property
    def phrase(self) -> str:
        """What it is called; ``{s}`` marks the plural."""
        return _PHRASES[self]

    @property
    def plural(self) -> str:
        """The same, of several."""
        return self.phrase.format(s="s")


#: Kinds of measurements between two poses.
RELATIVE = (Kind.BETWEEN, Kind.ROTATION, Kind.TRANSLATION)
#: Kinds of measurements from the world, a node that is no pose of the source.
PRIORS = (Kind.PRIOR, Kind.POSITION, Kind.ATTITUDE)

_PHRASES = {
    Kind.BETWEEN: "relative pose{s}",
    Kind.ROTATION: "relative rotation{s}",
    Kind.TRANSLATION: "relative translation{s}",
    Kind.SIGHTING: "sighting{s}",
    Kind.PRIOR: "pose prior{s}",
    Kind.POSITION: "position prior{s}",
    Kind.ATTITUDE: "attitude prior{s}",
    Kind.RANGE: "distance{s}",
    Kind.HELD: "constraint{s} of fixed nodes",
    Kind.ASSUMED: "assumed position{s} of the world",
    Kind.OTHER: "other measurement{s}",
    Kind.INERTIAL: "preintegrated step{s}",
    Kind.PRODUCT: "product{s} of nodes",
}


class Measuring(Protocol):
    """A graph, by what kinds are inferred from."""

    @property
    def edges(self) -> IntArray:
        """(m, 2) node pairs."""

    @property
    def is_point(self) -> BoolArray:
        """(n,) which nodes are points."""

    @property
    def measures_rotation(self) -> BoolArray:
        """(m,) which edges measure a rotation."""

    @property
    def measures_translation(self) -> BoolArray:
        """(m,) which edges measure a translation."""

    @property
    def assumed(self) -> BoolArray | None:
        """(m,) which edges are no measurements; None for none."""


def kinds_of(graph: Measuring, from_world: BoolArray) -> IntArray:
    """(m,) the `Kind` of each edge, given which of them (m,) measure from a world."""
    turned, moved = graph.measures_rotation, graph.measures_translation
    of_world = np.select([turned & moved, moved], [Kind.PRIOR, Kind.POSITION], Kind.ATTITUDE)
    of_poses = np.select([turned & moved, moved], [Kind.BETWEEN, Kind.TRANSLATION], Kind.ROTATION)
    seen = graph.is_point[graph.edges].any(axis=1)
    return np.where(from_world, of_world, np.where(seen, Kind.SIGHTING, of_poses))


def places_world(graph: Measuring) -> BoolArray:
    """(m,) which edges put a world somewhere that nothing measures, see `certpgo.with_priors`.

    Other edges that are no measurements hold nodes: they determine rotations, or points.
    """
    if graph.assumed is None:
        return np.zeros(len(graph.edges), dtype=bool)
    return graph.assumed & ~graph.measures_rotation & ~graph.is_point[graph.edges[:, 1]]


@dataclass(frozen=True, eq=False)
class Measurements(Pairs):
    """All measurements, a row each: the edges of a graph, then those of other kinds.

    Attributes
    ----------
    num_nodes : number n of nodes
    edges : (m + k, 2) node pairs
    kinds : (m + k,) a `Kind` each

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Instance, PoseGraph, Ranges, RotationGraph
    >>> rotation = RotationGraph(3, [[0, 1], [1, 2]], [np.eye(2)] * 2, kappa=np.ones(2))
    >>> graph = PoseGraph(rotation, np.ones((2, 2)), tau=np.ones(2))
    >>> graph = graph.with_ranges(Ranges(3, [[0, 2]], [2.8], [1.0]))
    >>> chain = Instance("chain", graph, np.arange(3))
    >>> chain.measurements.in_words
    ['2 relative poses', '1 distance']
    """

    num_nodes: int
    edges: IntArray
    kinds: IntArray

    def are(self, *kinds: Kind) -> BoolArray:
        """(m + k,) which measurements are of one of these kinds."""
        return np.isin(self.kinds, kinds)

    def without(self, *kinds: Kind) -> Measurements:
        """Those of all other kinds."""
        kept = ~self.are(*kinds)
        return Measurements(self.num_nodes, self.edges[kept], self.kinds[kept])

    @cached_property
    def counts(self) -> dict[Kind, int]:
        """How many there are of each kind that occurs."""
        found, counts = np.unique(self.without(Kind.PRODUCT).kinds, return_counts=True)
        return dict(zip(map(Kind, found.tolist()), counts.tolist(), strict=True))

    @property
    def in_words(self) -> list[str]:
        """The same, such as ``["200 relative poses", "572 distances"]``."""
        return [counted(count, kind.phrase) for kind, count in self.counts.items()]

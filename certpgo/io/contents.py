"""What files of tagged lines contain, with their own ids."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from certpgo.errors import InputError
from certpgo.graph.information import Information
from certpgo.linalg.arrays import FloatArray, IntArray

#: No sensor's id.
BODY = -(2**63)
#: A rotation (d, d) and a translation (d,).
Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Priors:
    """Measurements of single poses.

    Attributes
    ----------
    nodes : (k,) ids
    rotations, translations : (k, d, d) and (k, d) in the world
    kappa, tau : (k,) weights; kappa is 0 for positions
    information : matrices; None where they lack any
    sensors : (k,) ids of the sensors whose poses are measured; `BODY` for the body's own
    """

    nodes: IntArray
    rotations: FloatArray
    translations: FloatArray
    kappa: FloatArray
    tau: FloatArray
    information: Information | None
    sensors: IntArray


@dataclass(frozen=True)
class Sightings:
    """Measurements of where points are, seen from poses.

    Attributes
    ----------
    pairs : (k, 2) ids of a pose and of a point
    positions : (k, d) of the points in the frame of the sensor, metres
    tau : (k,) weights
    information : (k, d, d) matrices, or None where some lack it
    sensors : (k,) ids of the sensors; `BODY` for the body itself
    apart : whether points may be numbered apart, so that poses have the same numbers
    """

    pairs: IntArray
    positions: FloatArray
    tau: FloatArray
    information: FloatArray | None
    sensors: IntArray
    apart: bool


@dataclass
class TaggedLines:
    """The contents of a file; lists have one array per chunk.

    Priors and sightings have tags of several kinds, and an array for each: the numbers of their
    lines tell the order of the file.
    """

    d: int
    edges: list[IntArray] = field(default_factory=list)
    measured: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    weights: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    information: list[Information | None] = field(default_factory=list)
    priors: list[Priors] = field(default_factory=list)
    prior_lines: list[IntArray] = field(default_factory=list)
    sightings: list[Sightings] = field(default_factory=list)
    sighting_lines: list[IntArray] = field(default_factory=list)
    sensors: dict[int, Pose] = field(default_factory=dict)  # on their bodies
    vertices: list[IntArray] = field(default_factory=list)
    values: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    points: list[tuple[IntArray, FloatArray]] = field(default_factory=list)  # ids and positions
    fixed: list[int] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def extend(self, other: TaggedLines) -> None:
        """Append the next chunk."""
        self.counts.update(other.counts)
        self.d = other.d or self.d
        for sensor, pose in other.sensors.items():
            self.add_sensor(sensor, pose)
        lists = ("edges", "measured", "weights", "information", "vertices", "values", "fixed")
        for name in (*lists, "points", "priors", "prior_lines", "sightings", "sighting_lines"):
            getattr(self, name).extend(getattr(other, name))

    def add_sensor(self, sensor: int, pose: Pose) -> None:
        """Note where a sensor is on its body.

        Raises
        ------
        InputError
            It is elsewhere already.
        """
        known = self.sensors.setdefault(sensor, pose)
        if any((one != other).any() for one, other in zip(known, pose, strict=True)):
            raise InputError(f"sensor {sensor} has two different poses")

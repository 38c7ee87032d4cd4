"""Placements of estimates: their positions, residuals and alignment."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Instance
from certpgo.graph.graph import length_unit
from certpgo.graph.ranges import Ranges
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.solve import metrics
from certpgo.view.scene import NOT_MEASURED, Measure, Placement


def placement(
    name: str,
    nodes: IntArray,
    estimate: Estimate,
    places: FloatArray | None = None,
    measures: tuple[Measure, ...] = (),
) -> Placement:
    """Where an estimate (k,) puts ``nodes`` (k,), at ``places`` (n, 3) if it has no positions."""
    there = in_space(estimate)
    positions = there.translations
    if positions is None or places is not None:
        positions = np.zeros((len(nodes), 3)) if places is None else places[nodes]
    return Placement(name, nodes, positions, there.rotations, measures)


def in_space(estimate: Estimate) -> Estimate:
    """An estimate in 3D; a planar one lies at z = 0."""
    t = quaternion.embedded_translations(estimate.translations)
    return Estimate(quaternion.embedded(estimate.rotations), t)


def residuals(instance: Instance, estimate: Estimate) -> tuple[Measure, ...]:
    """Residual angles, degrees, and lengths, in the map's unit, of edges, then of distances.

    Unlike those of a problem, they need no connected graph.
    """
    graph, ranges = instance.graph, instance.graph.ranges
    R, (i, j) = estimate.rotations, graph.edges.T
    angles = np.degrees(so.angle(np.swapaxes(R[j], 1, 2) @ R[i] @ graph.rotations))
    found = []
    if graph.measures_rotation.any():
        angles = np.where(graph.measures_rotation, angles, NOT_MEASURED)
        found.append(Measure("degrees", _followed(angles, ranges)))
    if graph.has_positions and estimate.translations is not None:
        steps = np.einsum("mab,mb->ma", R[i], graph.translations)
        if estimate.scales is not None:
            steps *= estimate.scales[i, None]
        if graph.arms is not None:
            steps -= np.einsum("mab,mb->ma", R[j], graph.arms)
        t = estimate.translations
        lengths = np.linalg.norm(t[j] - t[i] - steps, axis=1)
        lengths = np.where(graph.measures_translation, lengths, NOT_MEASURED)
        errors = None if ranges is None else np.abs(ranges.distances - ranges.lengths(t))
        unit = "metres" if length_unit(graph) == "m" else length_unit(graph)
        found.append(Measure(unit, _followed(lengths, ranges, errors)))
    return tuple(found)


def weights(instance: Instance) -> tuple[Measure, ...]:
    """The weights of edges and of distances, where they differ."""
    graph, ranges = instance.graph, instance.graph.ranges
    listed = [("rotation weight", graph.kappa)]
    if graph.has_positions:
        listed.append(("translation weight", graph.tau))
    found = [
        Measure(name, _followed(np.where(values > 0.0, values, NOT_MEASURED), ranges))
        for name, values in listed
        if np.ptp(values) > 0.0
    ]
    if ranges is not None and np.ptp(ranges.weights) > 0.0:
        none = np.full(graph.num_edges, NOT_MEASURED)
        found.append(Measure("distance weight", _followed(none, ranges, ranges.weights)))
    return tuple(found)


def _followed(
    values: FloatArray, ranges: Ranges | None, of_ranges: FloatArray | None = None
) -> FloatArray:
    """Values of measurements (m,), then those of distances, if there are any."""
    if ranges is None:
        return values
    none = np.full(ranges.num_edges, NOT_MEASURED)
    return np.concatenate([values, none if of_ranges is None else of_ranges])


def aligned(
    estimate: Estimate,
    like: Estimate,
    common: IntArray,
    in_like: IntArray,
    *,
    scaled: bool = False,
) -> Estimate:
    """An estimate moved to where it is nearest to another.

    Parameters
    ----------
    common, in_like : (c,) nodes of the one and of the other that are the same poses
    scaled : whether the scale changes, too, as that of the estimate means nothing
    """
    given, target = estimate.subset(common), like.subset(in_like)
    if not len(common):
        return estimate
    return estimate.moved(*metrics.alignment(given, target, scaled=scaled))

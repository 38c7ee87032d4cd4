"""Mistakes in measurements: conventions of poses, then weights, then single ones.

An edge (i, j) is read as the pose of j in i. A reading of all edges, or of loop closures or of
odometry alone, undoes one other convention. Witnesses are the poses in the same file, whose cost a
right reading makes small; and the best fit, of the readings under which loops close better.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certpgo.diagnosis import ids, judged, noise, rotation_readings, sensors, weights, wrong
from certpgo.diagnosis.edge_readings import IN_DEGREES, READINGS, EdgeReading
from certpgo.diagnosis.estimates import HARDLY, LIKELY, SHARE, UNITS
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.loops import Loops
from certpgo.diagnosis.screening import SAMPLED
from certpgo.diagnosis.standing import stiff, undefined
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.kinds import Kind
from certpgo.graph.phrases import cost_shown
from certpgo.io.build_graph import instance_from_lines
from certpgo.io.exact import quaternion
from certpgo.io.format import ReadOptions, format_of
from certpgo.io.formats import g2o, toro
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_floats,
    frozen_indices,
)
from certpgo.objective.choose_cost import Certifiable, objective_of
from certpgo.objective.edge_sums import EdgeSums
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import start_of
from certpgo.solve.fit import fit_of

#: Measured poses of which a convention is told.
FEWEST = 4
#: Readings that are fitted at most, and share of loops' costs that these leave.
FITTED, BETTER = 3, 0.7
#: Costs of poses in the file that are not asked about: times the best fit's.
WELL = 3.0
#: Readings that the file's poses explain may fit this many times worse than what is given.
CONTRADICTED = 30.0
#: A best fit of this share of the given one explains it if its noise is then as stated.
ORDINARY = 0.4
#: Ratio of units that is asked about, and how closely a rough one meets one.
RESCALED, ABOUT = 1.5, 1.4
#: Angles, radians, by which degrees are told from radians, and mean cosine of what they are off by
#: in degrees: that of noise of 1.8 degrees; of radians it is about zero.
TURNED, AGREEING = 0.01, 0.2
#: Formats whose angles can be read in degrees.
DIALECTS = {"g2o": g2o.DIALECT, "toro": toro.DIALECT}
#: Readings that have names of their own where they are of some edges alone.
NAMES = {
    ("inverted-edges", "closures"): "inverted-closures",
    ("inverted-edges", "odometry"): "inverted-odometry",
}
SCOPES = {
    "all": "all edges",
    "closures": "all loop closures",
    "odometry": "all odometry edges",
    "positions": "all measured positions",
    "distances": "all distances",
}


@dataclass(frozen=True, eq=False)
class _Trial:
    """A reading of some edges, or of the distances.

    Attributes
    ----------
    scope : of which, a key of `SCOPES`
    rows : (m,) these
    in_degrees : (m, 2, 2) rotations of all edges by angles in degrees, if they are to be read so
    """

    reading: EdgeReading
    scope: str
    rows: BoolArray
    in_degrees: FloatArray | None = None

    def of(self, graph: Graph, among: IntArray | slice = slice(None)) -> Graph:
        """Measurements so read, of which the graph may have some alone: those ``among`` all."""
        if self.scope == "distances":
            ranges, metres = graph.ranges, self.reading.metres
            others = (block for block in graph.blocks if block is not ranges)
            longer = ranges and replace(ranges, distances=metres * ranges.distances)
            return graph.with_blocks(*others, longer)
        rows = self.rows[among]
        columns = [getattr(graph, name).copy() for name in ("edges", "rotations", "translations")]
        given = [column[rows] for column in columns]
        if self.in_degrees is not None:
            given[1] = self.in_degrees[among][rows]
        for column, values in zip(columns, self.reading.read(*given), strict=True):
            column[rows] = values
        # Rotations remain rotations, and checks would take longer than trials.
        E, R, t = columns
        return graph._with(
            edges=frozen_indices(E), rotations=frozen_floats(R), translations=frozen_floats(t)
        )


# --- The check ------------------------------------------------------------------------------------


def found(examined: Examined) -> Iterator[Finding]:
    """The convention of measurements that explains them best; else wrong ones, and the noise."""
    if (order := undefined(examined.instance.graph, examined.trying)) is not None:
        yield order
        return
    if examined.instance.graph.has_scales:
        return
    single = judged.single(examined)
    if single is None and (told := ids.used_twice(examined)) is not None:
        yield told
        return
    told = convention(examined, single is None) or rotation_readings.found(examined)
    if told is not None:
        yield told
        return
    examined.trying("stiff-edge")
    yield from stiff(examined.instance)
    sensor = sensors.found(examined) if single is None else None
    if sensor is not None and sensor.leaves_noise:
        yield sensor.finding
        return
    suspects, meaning = judged.judged(examined) if single is None else single, None
    if suspects is None:
        return
    gain, unusual = noise.found(examined, suspects.fit)
    # The noise has a number more to fit, and is more often misstated.
    bar = gain - math.log(suspects.fit.fit.freedom) if unusual else -weights.RARER
    if single is None or single.fit.fit.is_unusual:  # else there is nothing else to explain
        least = max(bar - weights.RARER, suspects.gain(examined.best))
        meaning = weights.other_meaning(examined, least)
    if sensor is not None:
        others = [gain, suspects.gain(examined.best), 0.0 if meaning is None else meaning[0]]
        if sensor.gain > max(others) + weights.RARER:
            yield sensor.finding
            return
    if meaning is not None:
        if meaning[0] - bar > weights.RARER:
            yield meaning[1]  # all else is as if measured so
            return
        if not suspects.wrong.any():
            yield weights.either(meaning[1], unusual)
            return
    yield from wrong.found(examined, suspects)
    yield from unusual


def convention(examined: Examined, by_fit: bool) -> Finding | None:
    """The reading of measured poses that explains the file's poses, or fits far better."""
    graph = examined.instance.graph
    if not graph.has_positions or graph.has_couplings or examined.whole.sum() < FEWEST:
        return None
    nodes, fit = examined.instance.initial, examined.fit
    if nodes is not None and nodes.translations is not None:
        given = examined.problem.cost(nodes)
        if given > WELL * examined.best and (told := _by_nodes(examined, nodes, given)) is not None:
            return told
    if by_fit and (fit is None or fit.is_unusually_large):
        return _by_fit(examined)
    return None


def _trials(examined: Examined, nodes: Estimate | None = None) -> Iterator[_Trial]:
    """All readings of all scopes, but for those that the file's poses exclude."""
    instance, steps, whole = examined.instance, examined.steps, examined.whole
    d, scopes = instance.graph.d, {"all": whole}
    if (whole & steps).any() and (whole & ~steps).any():
        scopes |= {"closures": whole & ~steps, "odometry": whole & steps}
    in_degrees = None
    if d in IN_DEGREES.dimensions and (nodes is None or _may_be_in_degrees(examined, nodes)):
        in_degrees = _by_degrees(instance)
    for scope, rows in scopes.items():
        for reading in READINGS:
            if d in reading.dimensions:
                examined.trying(reading.kind)
                if reading is IN_DEGREES and in_degrees is None:
                    continue
                yield _Trial(reading, scope, rows, in_degrees if reading is IN_DEGREES else None)


def _posed(examined: Examined, graph: Graph) -> Certifiable:
    """The same cost of other measurements."""
    return objective_of(replace(examined.instance, graph=graph), examined.problem.cost_name)


def _finding(trial: _Trial, costs: str, cost: float, given: float) -> Finding:
    reading, scope = trial.reading, trial.scope
    kind = NAMES.get((reading.kind, scope), reading.kind)
    return Finding(kind, f"{SCOPES[scope]} are {reading.said}: {costs}", reading.next, cost, given)


# --- By the poses in the file ---------------------------------------------------------------------


def _by_nodes(examined: Examined, nodes: Estimate, given: float) -> Finding | None:
    """The reading that explains the poses of the file."""
    trials, graph = (
        [*_trials(examined, nodes), *_in_unit_of(examined, nodes)],
        examined.instance.graph,
    )
    rows = np.flatnonzero(examined.whole)
    some = rows[np.linspace(0, len(rows) - 1, min(SAMPLED, len(rows))).astype(np.intp)]
    few = graph.with_blocks().with_information(None).with_edges(some)
    as_given = float(EdgeSums(few).terms(nodes).sum())
    costs = [float(EdgeSums(one.of(few, some)).terms(nodes).sum()) for one in trials]
    least = min(costs)
    if not least < LIKELY * as_given:
        return None
    trial = next(one for one, cost in zip(trials, costs, strict=True) if cost <= HARDLY * least)
    with suppress(CertPGOError, np.linalg.LinAlgError):
        problem = _posed(examined, trial.of(graph))
        cost = problem.cost(nodes)
        fitted = descend(problem, nodes, monitor=examined.monitor).cost
        agrees = trial.reading.metres != 1.0 or fitted < CONTRADICTED * examined.best
        if cost < SHARE * given and agrees:
            costs_read = f"the file's own poses cost {cost_shown(cost)} so read"
            return _finding(trial, f"{costs_read}, {cost_shown(given)} as it stands", cost, given)
    return None


def _in_unit_of(examined: Examined, nodes: Estimate) -> Iterator[_Trial]:
    """Translations in another unit than the positions of the file."""
    graph, whole, t = examined.instance.graph, examined.whole, nodes.translations
    if t is None:
        return
    i, j = graph.edges[whole].T
    v = np.einsum("mba,mb->ma", nodes.rotations[i], t[j] - t[i])
    tau, measured = graph.tau[whole], graph.translations[whole]
    along, size = float(tau @ (measured * v).sum(axis=1)), float(tau @ (measured**2).sum(axis=1))
    if along > 0.0 and size > 0.0:
        yield from _in_unit(examined, along / size, "those of the file's poses")


def _in_unit(
    examined: Examined,
    factor: float,
    others: str,
    scope: str = "all",
    rows: BoolArray | None = None,
) -> Iterator[_Trial]:
    """Lengths times a factor that turns them into metres, if that is another unit."""
    if abs(math.log(factor)) < math.log(RESCALED):
        return
    near = (name for name, metres in UNITS.items() if 1 / ABOUT < factor / metres < ABOUT)
    unit = next(near, "scaled")
    if rows is not None and unit not in UNITS:
        return  # of some measurements alone: see `certpgo.diagnosis.sensors`
    factor = UNITS.get(unit, factor)
    said = f"in {unit}" if unit in UNITS else f"{1.0 / factor:.4g} times as long"
    whose, lengths = ("edges", "their translations") if scope == "all" else (scope, "them")
    reading = EdgeReading(
        f"{whose}-{unit}",
        f"{said}, if {others} are in metres",
        f"multiply {lengths} by {factor:.4g}",
        lambda E, R, t: (E, R, factor * t),
        metres=factor,
    )
    examined.trying(reading.kind)
    yield _Trial(reading, scope, examined.whole if rows is None else rows)


# --- By the best fit ------------------------------------------------------------------------------


def _by_fit(examined: Examined) -> Finding | None:
    """The reading that fits far better, among those under which loops close better."""
    loops = Loops.of(examined)
    shares = [(loops.share(trial.of(loops.part, loops.rows)), trial) for trial in _trials(examined)]
    closing = sorted((one for one in shares if one[0] < BETTER), key=lambda one: one[0])
    given, best = examined.best, None
    for trial in (*_by_others(examined, loops), *(trial for _, trial in closing[:FITTED])):
        with suppress(CertPGOError, np.linalg.LinAlgError):
            read = trial.of(examined.instance.graph)
            cost, is_usual = _fitted(examined, read)
            explains = cost < (ORDINARY if is_usual else SHARE) * given
            # What shrinks to a point fits anything.
            explains &= trial.reading.metres >= 1.0 or cost < SHARE * _size(read)
            if explains and (best is None or HARDLY * cost < best[1]):
                best = trial, cost
    if best is None:
        return None
    said = f"so read the best fit costs {cost_shown(best[1])}, as it stands {cost_shown(given)}"
    return _finding(best[0], said, best[1], given)


def _size(graph: Graph) -> float:
    """The cost of a map in one point, of lengths alone."""
    return float(graph.tau @ (graph.translations**2).sum(axis=1))


def _fitted(examined: Examined, graph: Graph) -> tuple[float, bool]:
    """The least cost of other measurements, and whether their noise is then as stated."""
    problem = _posed(examined, graph)
    start = start_of(problem.chordal).estimate
    found = descend(problem, start, monitor=examined.monitor)
    fit = fit_of(replace(examined.instance, graph=graph), problem, found.estimate)
    return found.cost, fit is not None and not fit.is_unusually_large


def _by_others(examined: Examined, loops: Loops) -> Iterator[_Trial]:
    """Translations in another unit than positions or distances that were measured otherwise."""
    instance, graph = examined.instance, examined.instance.graph
    t, place = loops.composed.translations, np.full(graph.num_nodes, -1)
    place[loops.nodes] = np.arange(len(loops.nodes))
    if t is None:
        return
    kinds, (_, j) = instance.measurements.kinds[: graph.num_edges], graph.edges.T
    rows = np.isin(kinds, (Kind.POSITION, Kind.PRIOR)) & (place[j] >= 0)
    if rows.sum() > 2:
        sets = t[place[j[rows]]], graph.translations[rows]
        own, other = (float(np.linalg.norm(x - x.mean(axis=0))) for x in sets)
        if min(own, other) > 0.0:
            yield from _in_unit(examined, other / own, "measured positions")
            yield from _in_unit(examined, own / other, "the edges", "positions", rows)
    if (ranges := graph.ranges) is not None:
        i, j = place[ranges.edges].T
        both = (i >= 0) & (j >= 0)
        lengths = np.linalg.norm(t[i[both]] - t[j[both]], axis=1)
        known = lengths > 0.0
        if known.sum() > 2:
            factor = float(np.median(ranges.distances[both][known] / lengths[known]))
            if factor > 0.0:
                yield from _in_unit(examined, 1.0 / factor, "the edges", "distances")
                yield from _in_unit(examined, factor, "measured distances")


# --- Angles ---------------------------------------------------------------------------------------


def _may_be_in_degrees(examined: Examined, nodes: Estimate) -> bool:
    """Whether the angles between poses of the file, in degrees, are about those that were read.

    These are known but for full turns of two pi.
    """
    graph, whole = examined.instance.graph, examined.whole
    i, j = graph.edges[whole].T
    theta = so.log(np.swapaxes(nodes.rotations[i], 1, 2) @ nodes.rotations[j])[:, 0]
    off = np.degrees(theta) - so.log(graph.rotations[whole])[:, 0]
    turned = np.abs(theta) > TURNED
    return turned.sum() < FEWEST or bool(np.cos(off[turned]).mean() > AGREEING)


def _by_degrees(instance: Instance) -> FloatArray:
    """(m, 2, 2) the edges' rotations by angles in degrees, of the file if it can be read again.

    Angles beyond pi are wrapped where they are read as radians.
    """
    R = instance.graph.rotations
    with suppress(CertPGOError, OSError):
        name = format_of(Path(instance.source)).name if instance.source else ""
        if name in DIALECTS and instance.stated is None:
            dialect = replace(DIALECTS[name], poses=_in_degrees)
            again = instance_from_lines(dialect, Path(instance.source), ReadOptions())
            if np.array_equal(again.pairs, instance.pairs):
                return again.graph.rotations
    return quaternion.planar_rotations(np.radians(np.arctan2(R[:, 1, 0], R[:, 0, 0])))


def _in_degrees(d: int, numbers: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    return quaternion.planar_rotations(np.radians(numbers[:, 2])), numbers[:, :d], 0

"""What errors of a sensor fit the map of all other measured poses best: where large ones begin.

A closed form for each kind: linear least squares for a unit and a place, given a turn; for turns
all permutations of axes, and that which fits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from certpgo.diagnosis.conventions import FORMS, W_FIRST, Convention, quarter_turns
from certpgo.diagnosis.edge_readings import Columns, EdgeReading
from certpgo.diagnosis.estimates import HARDLY, UNITS
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.systematic import Systematic, problem_at
from certpgo.diagnosis.truth import mounting
from certpgo.graph import Estimate
from certpgo.graph.edges import components_of
from certpgo.graph.relaxed_point import translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.procrustes import procrustes
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import start_of

#: Measurements of which an error is told.
FEWEST = 6
#: Radius of the earth, metres, and degrees that the fixes of a map span at most.
EARTH, SPAN = 6_371_000.0, 2.0


def _mirrored(d: int) -> EdgeReading:
    """Positions of the other hand; in space as NED and ENU differ but for a turn of the world."""
    order = [1, 0, 2][:d]
    said = "have x and y swapped" if d == 2 else "have x and y swapped, or z of the other sign"
    next = "swap x and y of their positions" + (" (or negate z)" if d == 3 else "")
    return EdgeReading("mirrored", said, next, lambda E, R, t: (E, R, t[:, order]))


def _of_degrees(first: str, order: tuple[int, int], origin: FloatArray) -> EdgeReading:
    """Latitudes and longitudes, less an origin, that were taken for metres."""

    def read(E: IntArray, R: FloatArray, t: FloatArray) -> Columns:
        latitude, longitude = (np.radians(t[:, k] + origin[k]) for k in order)
        middle = float(latitude.mean())
        east = EARTH * math.cos(middle) * (longitude - longitude.mean())
        north = EARTH * (latitude - middle)
        return E, R, np.concatenate([np.stack([east, north], axis=1), t[:, 2:]], axis=1)

    said = f"are degrees, {first} first, not metres"
    next = "convert latitude and longitude to metres, such as east, north, up around their mean"
    return EdgeReading("degrees", said, next, read)


@dataclass(frozen=True, eq=False)
class Others:
    """A map of measured poses without those of one sensor."""

    place: IntArray
    estimate: Estimate

    def at(self, nodes: IntArray) -> tuple[FloatArray, FloatArray]:
        """Rotations and positions of nodes that are in it."""
        at = self.place[nodes]
        return self.estimate.rotations[at], translations_of(self.estimate)[at]


@dataclass(frozen=True, eq=False)
class SensorStart:
    """An error that may be, and how well it fits the map of all other measured poses.

    Attributes
    ----------
    left : what it leaves of squares, to compare those of one kind
    world : (d, d) rotation of the world in that map; None where nothing is measured in the world
    """

    left: float
    error: Systematic
    world: FloatArray | None = None


def from_others(
    examined: Examined, error: Systematic, known: dict[bytes, Others | None]
) -> Iterator[tuple[Systematic, Estimate]]:
    """The error that fits the map of all other measured poses best, and an estimate with it."""
    if error.of not in _STARTS:
        return
    graph = examined.instance.graph
    rows = examined.whole & ~error.rows[: graph.num_edges]
    key = rows.tobytes()
    if key not in known:
        known[key] = _map_of(examined, rows)
    others = known[key]
    if others is None:
        return
    own = np.flatnonzero(error.rows[: graph.num_edges])
    of_poses = ~error.carried[own] | (others.place[graph.edges[own]] >= 0)
    own = own[of_poses.all(axis=1)]
    if len(own) < FEWEST:
        return
    trials = [*_STARTS[error.of](examined, error, others, own)]
    least = min((one.left for one in trials), default=math.inf)
    if least < math.inf:
        best = next(one for one in trials if one.left <= HARDLY * least)
        yield best.error, _near(examined, others, best)


def _near(examined: Examined, others: Others, at: SensorStart) -> Estimate:
    """The map of the others, with all other nodes where measurements without the error say."""
    chordal = problem_at(examined, at.error).chordal
    graph, world, known = examined.instance.graph, examined.world, others.place >= 0
    turned = np.tile(np.eye(graph.d), (graph.num_nodes, 1, 1))
    turned[known] = others.estimate.rotations[others.place[known]]
    if world is not None and at.world is not None:
        turned[world] = at.world
    if (known | graph.is_point | (np.arange(graph.num_nodes) == world)).all():
        return chordal.settled(Estimate(turned))
    return start_of(chordal).estimate


def _map_of(examined: Examined, rows: BoolArray) -> Others | None:
    """The map of some measured poses, of their largest component."""
    graph = examined.instance.graph
    labels = components_of(graph.num_nodes, graph.edges[rows])
    nodes = np.flatnonzero(labels == np.argmax(np.bincount(labels)))
    if len(nodes) < FEWEST:
        return None
    few = graph.with_blocks().with_information(None).with_edges(np.flatnonzero(rows))
    problem = Quadratic(few.subgraph(nodes))
    place = np.full(graph.num_nodes, -1)
    place[nodes] = np.arange(len(nodes))
    end = descend(problem, start_of(problem).estimate, monitor=examined.monitor)
    return Others(place, end.estimate)


def _of_sightings(
    examined: Examined, error: Systematic, others: Others, own: IntArray
) -> Iterator[SensorStart]:
    """R_i (s C y + a) + t_i is the same point, from whichever pose it is seen."""
    graph = examined.instance.graph
    on_first = error.carried[own, 0]
    i, j = graph.edges[own].T
    pose: IntArray = np.where(on_first, i, j)
    _, point = np.unique(np.where(on_first, j, i), return_inverse=True)
    R, t = others.at(pose)
    counts = np.bincount(point)[:, None]

    def apart(x: FloatArray) -> FloatArray:
        sums = np.zeros((len(counts), x.shape[1]))
        np.add.at(sums, point, x)
        return (x - (sums / counts)[point]).ravel()

    arms = np.stack([apart(R[:, :, k]) for k in range(graph.d)], axis=1)
    right = -apart(t)
    for before in (None, _reflected(graph.d)):
        y = graph.translations[own]
        if before is not None:
            _, _, y = before.read(graph.edges[own], graph.rotations[own], y)
        entries = [
            apart(R[:, :, a] * y[:, b, None]) for a in range(graph.d) for b in range(graph.d)
        ]
        affine = np.linalg.lstsq(np.column_stack([*entries, arms]), right, rcond=1e-6)[0]
        M = np.asarray(affine[: graph.d**2], dtype=np.float64).reshape(graph.d, graph.d)
        for C in _turns(so.project(M[None])[0]):
            column = apart((R @ (y @ C.T)[:, :, None])[:, :, 0])
            yield _start(error, before, C, np.column_stack([column, arms]), right)


def _of_closures(
    examined: Examined, error: Systematic, others: Others, own: IntArray
) -> Iterator[SensorStart]:
    """C R C^T, s C t + (1 - C R C^T) a are the motions between the poses of the others."""
    graph = examined.instance.graph
    i, j = graph.edges[own].T
    (A, t), (B, u) = others.at(i), others.at(j)
    back = np.swapaxes(A, 1, 2)
    R, v = back @ B, (back @ (u - t)[:, :, None])[:, :, 0]
    M, w = graph.rotations[own], graph.translations[own]
    d = graph.d
    arms = (np.eye(d) - R).reshape(-1, d)
    if d == 3:
        fitting = so.project((so.log(R).T @ so.log(M))[None])[0]
    else:
        turned = np.stack([w, np.stack([-w[:, 1], w[:, 0]], axis=1)], axis=2).reshape(-1, 2)
        c, s = np.linalg.lstsq(np.column_stack([turned, arms]), v.ravel(), rcond=1e-6)[0][:2]
        fitting = so.project(np.asarray([[[c, -s], [s, c]]], dtype=np.float64))[0]
    scale = float((graph.kappa[own] / np.maximum(graph.tau[own], 1e-300)).mean())
    for C in _turns(fitting):
        off = scale * float(((C @ M @ C.T - R) ** 2).sum())
        start = _start(error, None, C, np.column_stack([(w @ C.T).ravel(), arms]), v.ravel())
        yield replace(start, left=start.left + off)


def _of_positions(
    examined: Examined, error: Systematic, others: Others, own: IntArray
) -> Iterator[SensorStart]:
    """Positions in the world, which may be turned and moved as a whole."""
    graph = examined.instance.graph
    node, p = graph.edges[own, 1], graph.translations[own]
    _, t = others.at(node)
    readings: list[EdgeReading | None] = [None, _mirrored(graph.d)]
    zero = np.zeros(graph.d) if examined.instance.origin is None else examined.instance.origin
    if np.ptp(p[:, :2], axis=0).max() < SPAN and np.abs(p + zero)[:, :2].max() < 360.0:
        orders = (("latitude", (0, 1)), ("longitude", (1, 0)))
        readings += [_of_degrees(first, order, zero) for first, order in orders]
    for before in readings:
        x = p if before is None else before.read(graph.edges[own], graph.rotations[own], p)[2]
        [S], [shift], [s] = procrustes(t[None], x[None], scaled=True)
        if not s > 0.0:
            continue
        off = t - s * x @ S.T - shift
        so_read = replace(error, before=before, metres=_rounded(float(s)))
        yield SensorStart(float((off**2).sum()), so_read, S)


def _of_priors(
    examined: Examined, error: Systematic, others: Others, own: IntArray
) -> Iterator[SensorStart]:
    """Poses in the world, of a frame that is fixed to each."""
    graph = examined.instance.graph
    node = graph.edges[own, 1]
    R, t = others.at(node)
    readings: list[EdgeReading | None] = [None, _mirrored(graph.d)]
    for one in (*FORMS, *([W_FIRST] if graph.d == 3 else [])):
        readings.append(_of_convention(one))
    for before in readings:
        M, p = graph.rotations[own], graph.translations[own]
        if before is not None:
            _, M, p = before.read(graph.edges[own], M, p)
        [_], [_], [s] = procrustes(t[None], p[None], scaled=True)
        if not s > 0.0:
            continue
        s = _rounded(float(s))
        C, a = mounting(Estimate(R, t), Estimate(M, s * p))
        u = s * p - (M @ a[:, None])[:, :, 0]
        [S], [shift], _ = procrustes(t[None], u[None])
        off = ((t - u @ S.T - shift) ** 2).sum()
        size = float(((t - t.mean(axis=0)) ** 2).mean())
        off += size * ((S @ M @ C.T - R) ** 2).sum()
        so_read = replace(error, before=before, metres=s, turn=C, arm=C @ a)
        yield SensorStart(float(off), so_read, S)


def _of_convention(one: Convention) -> EdgeReading:
    """A convention of poses, of those that are measured in the world."""

    def read(E: IntArray, R: FloatArray, t: FloatArray) -> Columns:
        turned, moved = one.read(R, t)
        return E, turned, t if moved is None else moved

    said = one.said.format(it="they", its="their")
    return EdgeReading(one.kind, f"are so that {said}", one.next, read)


_STARTS = {
    "sightings": _of_sightings,
    "loop closures": _of_closures,
    "position priors": _of_positions,
    "pose priors": _of_priors,
}


def _reflected(d: int) -> EdgeReading:
    """One axis of the sensor the other way round: the first, whichever it is but for a turn."""
    signs = np.where(np.arange(d) == 0, -1.0, 1.0)
    return EdgeReading(
        "mirrored",
        "are of the other handedness, mirrored in x",
        "negate x of their positions",
        lambda E, R, t: (E, R, signs * t),
    )


def _turns(fitting: FloatArray) -> Iterator[FloatArray]:
    """Rotations that a sensor may have: none, quarter turns, and one that fits."""
    d = len(fitting)
    yield np.eye(d)
    yield from quarter_turns(d)
    yield fitting


def _start(
    error: Systematic,
    before: EdgeReading | None,
    C: FloatArray,
    columns: FloatArray,
    right: FloatArray,
) -> SensorStart:
    """What the best unit and place leave of a turn C."""
    x = np.linalg.lstsq(columns, right, rcond=1e-6)[0]
    if not x[0] > 0.0:
        return SensorStart(math.inf, error)
    off = columns @ x - right
    start = replace(
        error,
        before=before,
        turn=C,
        metres=_rounded(float(x[0])),
        arm=np.asarray(x[1:], dtype=np.float64),
    )
    return SensorStart(float((off**2).sum()), start)


def _rounded(s: float) -> float:
    """A unit if a factor is near to one."""
    return next((u for u in (1.0, *UNITS.values()) if abs(math.log(s / u)) < 0.1), s)

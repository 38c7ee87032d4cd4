"""One sensor's unit, frame, place or drift, of which its measurements alone are wrong.

Each kind of measurement is one sensor's. Its error is estimated with the map: from none, where the
score test says that it may explain what is seen; or, where it may be large, from what fits the map
of all other measurements best. What then is not needed is left out, so that the simplest error
remains that explains all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from certpgo.diagnosis.conventions import FORMS, W_FIRST, Convention, axes_of, quarter_turns
from certpgo.diagnosis.edge_readings import Columns, EdgeReading
from certpgo.diagnosis.estimates import HARDLY, SHARE, UNITS, unit_of
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.noise import kinds_of
from certpgo.diagnosis.study import Study
from certpgo.diagnosis.systematic import (
    ARM,
    BIAS,
    METRES,
    TURN,
    Fitted,
    Systematic,
    fitted,
    score,
)
from certpgo.diagnosis.truth import mounting
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.edges import components_of
from certpgo.graph.phrases import cost_shown
from certpgo.graph.relaxed_point import translations_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.procrustes import procrustes
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import start_of
from certpgo.solve.fit import fit_of

#: Share of chi^2 that the score test may leave of an error that is worth a fit, and fits at most.
LIKELY, FITTED = 0.7, 2
#: chi^2 over its degrees of freedom from which an error may be large.
LARGE = 25.0
#: Measurements of which an error is told.
FEWEST = 6
#: Twice the logarithm of likelihoods' ratio by which what is left out would have to be needed, and
#: its share of chi^2.
NEEDED, SLIGHT = 16.0, 0.02
#: The same that an error has to gain at all.
GAINED = 25.0
#: Radius of the earth, metres, and degrees that the fixes of a map span at most.
EARTH, SPAN = 6_371_000.0, 2.0
#: Angle to a permutation of axes from which a turn is one, degrees.
QUARTER = 3.0
#: Names of kinds in findings.
NAMES = {
    "odometry": "odometry",
    "loop closures": "closures",
    "pose priors": "priors",
    "position priors": "positions",
    "sightings": "sightings",
}


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
class _Others:
    """A map of measured poses without those of one sensor."""

    place: IntArray
    estimate: Estimate

    def at(self, nodes: IntArray) -> tuple[FloatArray, FloatArray]:
        """Rotations and positions of nodes that are in it."""
        at = self.place[nodes]
        return self.estimate.rotations[at], translations_of(self.estimate)[at]


@dataclass(frozen=True)
class SensorError:
    """The error of one sensor.

    Attributes
    ----------
    gain : twice the log of how much likelier it makes the measurements
    leaves_noise : whether what is left is a small part, and as the noise is stated
    """

    gain: float
    leaves_noise: bool
    finding: Finding


def found(examined: Examined) -> SensorError | None:
    """The error of one sensor that explains a map whose chi^2 is too large."""
    graph, first, fit = examined.instance.graph, examined.first, examined.fit
    if first is None or not graph.has_positions or graph.has_couplings or graph.has_scales:
        return None
    if graph.arms is not None or (fit is not None and not fit.is_unusually_large):
        return None
    best: Fitted | None = None
    for error in _likely(examined, first):
        near = None if error.before or error.metres != 1.0 or error.arm.any() else first.estimate
        trial = fitted(examined, error, near)
        if trial is not None and (best is None or trial.chi2 < best.chi2):
            best = trial
    if best is None or not first.fit.chi2 - best.chi2 > GAINED + len(best.error.free):
        return None
    share, usual = best.chi2 / first.fit.chi2, _is_usual(examined, best)
    if not (share < SHARE or usual):
        return None
    best = _simplified(examined, best)
    gain = first.fit.chi2 - best.chi2
    return SensorError(gain, share < SHARE and usual, _told(examined, best))


def _is_usual(examined: Examined, of: Fitted) -> bool:
    """Whether no more is left than noise as it is stated."""
    instance = replace(examined.instance, graph=of.read)
    fit = fit_of(instance, of.fit.problem, of.fit.estimate)
    return fit is not None and not fit.is_unusually_large


# --- Errors that may be ---------------------------------------------------------------------------


def _likely(examined: Examined, first: Study) -> list[Systematic]:
    """The errors that may explain the map, the likeliest first."""
    graph = examined.instance.graph
    errors = [*_errors(examined)]
    lefts = []
    for error in errors:
        examined.trying(f"{NAMES[error.of]}-systematic")
        with suppress(np.linalg.LinAlgError):
            lefts.append((score(error, first, graph).left, error))
    chosen = [one for one in lefts if one[0] < LIKELY * first.fit.chi2]
    found = [error for _, error in sorted(chosen, key=lambda one: one[0])[:FITTED]]
    if first.fit.chi2 > LARGE * first.fit.freedom:
        others: dict[bytes, _Others | None] = {}
        for error in errors:
            with suppress(CertPGOError, np.linalg.LinAlgError):
                found += [*_from_others(examined, error, others)]
    return found


def _errors(examined: Examined) -> Iterator[Systematic]:
    """Of each kind, no error, of which all is free that its measurements may show."""
    instance = examined.instance
    graph, measured = instance.graph, instance.measurements
    d, q = graph.d, so.tangent_dim(graph.d)
    world = graph.world if instance.world is None else instance.world
    carries = np.ones(graph.num_nodes, dtype=bool) & ~graph.is_point
    if world is not None:
        carries[world] = False
    kinds = {name: rows for name, rows in kinds_of(examined).items() if name in NAMES}
    moved = np.zeros(len(measured.edges), dtype=bool)
    moved[: graph.num_edges] = graph.measures_translation
    moved[graph.num_edges :] = True
    i, j = measured.edges.T
    place = examined.order.places
    backward = np.zeros(len(i), dtype=bool)
    backward[: graph.num_edges] = (place[i] > place[j])[: graph.num_edges]
    for name, rows in kinds.items():
        if rows.sum() < FEWEST or not (moved & ~rows).any():
            continue
        of_steps = name == "odometry"
        carried = carries[measured.edges] & (rows & (not of_steps))[:, None]
        free = (METRES, BIAS) if of_steps else (METRES, TURN, ARM)
        if name == "position priors":
            free = (METRES, ARM)
        yield Systematic(name, rows, carried, np.eye(d), np.zeros(d), np.zeros(q), backward, free)


# --- From the map of all others -------------------------------------------------------------------


def _from_others(
    examined: Examined, error: Systematic, known: dict[bytes, _Others | None]
) -> Iterator[Systematic]:
    """The error that fits the map of all other measured poses best."""
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
    least = min((left for left, _ in trials), default=math.inf)
    if least < math.inf:
        yield next(one for left, one in trials if left <= HARDLY * least)


def _map_of(examined: Examined, rows: BoolArray) -> _Others | None:
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
    return _Others(place, end.estimate)


Start = tuple[float, Systematic]


def _of_sightings(
    examined: Examined, error: Systematic, others: _Others, own: IntArray
) -> Iterator[Start]:
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
    examined: Examined, error: Systematic, others: _Others, own: IntArray
) -> Iterator[Start]:
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
        left, start = _start(error, None, C, np.column_stack([(w @ C.T).ravel(), arms]), v.ravel())
        yield left + off, start


def _of_positions(
    examined: Examined, error: Systematic, others: _Others, own: IntArray
) -> Iterator[Start]:
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
        yield float((off**2).sum()), replace(error, before=before, metres=_rounded(float(s)))


def _of_priors(
    examined: Examined, error: Systematic, others: _Others, own: IntArray
) -> Iterator[Start]:
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
        yield float(off), replace(error, before=before, metres=s, turn=C, arm=C @ a)


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
) -> Start:
    """What the best unit and place leave of a turn C."""
    x = np.linalg.lstsq(columns, right, rcond=1e-6)[0]
    if not x[0] > 0.0:
        return math.inf, error
    off = columns @ x - right
    start = replace(
        error,
        before=before,
        turn=C,
        metres=_rounded(float(x[0])),
        arm=np.asarray(x[1:], dtype=np.float64),
    )
    return float((off**2).sum()), start


def _rounded(s: float) -> float:
    """A unit if a factor is near to one."""
    return next((u for u in (1.0, *UNITS.values()) if abs(math.log(s / u)) < 0.1), s)


# --- The simplest that remains --------------------------------------------------------------------


def _simplified(examined: Examined, rich: Fitted) -> Fitted:
    """The same without what is not needed."""
    best = rich
    for simpler in (_in_round_unit, _unturned, _unmoved, _unbiased):
        for error in simpler(best.error):
            trial = fitted(examined, error, best.fit.estimate)
            if trial is not None and trial.chi2 < best.chi2 + max(NEEDED, SLIGHT * best.chi2):
                best = trial
                break
    return best


def _without(error: Systematic, name: str) -> tuple[str, ...]:
    return tuple(one for one in error.free if one != name)


def _in_round_unit(error: Systematic) -> Iterator[Systematic]:
    if METRES in error.free:
        free = _without(error, METRES)
        yield replace(error, metres=1.0, free=free)
        unit, _ = unit_of(error.metres)
        if unit in UNITS:
            yield replace(error, metres=UNITS[unit], free=free)


def _unturned(error: Systematic) -> Iterator[Systematic]:
    if TURN in error.free:
        free, d = _without(error, TURN), len(error.arm)
        yield replace(error, turn=np.eye(d), free=free)
        near = max(quarter_turns(d), key=lambda Q: float(np.trace(Q.T @ error.turn)))
        if _degrees(near.T @ error.turn) < QUARTER:
            yield replace(error, turn=near, free=free)


def _unmoved(error: Systematic) -> Iterator[Systematic]:
    if ARM in error.free:
        yield replace(error, arm=0.0 * error.arm, free=_without(error, ARM))


def _unbiased(error: Systematic) -> Iterator[Systematic]:
    if BIAS in error.free:
        yield replace(error, bias=0.0 * error.bias, free=_without(error, BIAS))


def _degrees(C: FloatArray) -> float:
    return math.degrees(float(so.angle(C[None])[0]))


# --- In words -------------------------------------------------------------------------------------


def _told(examined: Examined, of: Fitted) -> Finding:
    """The error as a finding."""
    error, given, cost = of.error, examined.best, of.cost
    parts = [*_parts(error)]
    whose = "odometry edges" if error.of == "odometry" else error.of
    costs = f"so read the best fit costs {cost_shown(cost)}, as it stands {cost_shown(given)}"
    said, next = (", and ".join(part[k] for part in parts) for k in (1, 2))
    kind = f"{NAMES[error.of]}-{parts[0][0]}"
    return Finding(kind, f"{whose} {said}: {costs}", next, cost, given)


def _parts(error: Systematic) -> Iterator[tuple[str, str, str]]:
    """What is off: its name, what is said of the measurements, and what to do."""
    d = len(error.arm)
    if error.before is not None:
        yield error.before.kind, error.before.said, error.before.next
    if error.metres != 1.0:
        unit, factor = unit_of(error.metres)
        is_unit = unit in UNITS
        longer = f"have lengths {1.0 / error.metres:.4g} times those of all else"
        yield (
            unit,
            f"are in {unit}" if is_unit else longer,
            f"multiply their translations by {factor}",
        )
    if not np.array_equal(error.turn, np.eye(d)):
        exact = _degrees(error.turn)
        quarter = any(np.array_equal(error.turn, Q) for Q in quarter_turns(d))
        how = f": {axes_of(error.turn)}" if quarter else _axis_in_words(error.turn)
        yield (
            "turned",
            f"are of a sensor that is turned by {exact:.4g} degrees from the poses{how}",
            "give the turn of the sensor on the pose (in g2o's format PARAMS_SE3OFFSET)",
        )
    if error.arm.any():
        at = ", ".join(f"{x:.3g}" for x in error.arm)
        yield (
            "lever-arm",
            f"are of a point {np.linalg.norm(error.arm):.3g} m from the poses, at ({at}) in their "
            "frames",
            f"give the place of the sensor on the pose, ({at}) (in g2o's format PARAMS_SE3OFFSET)",
        )
    if error.bias.any():
        turns = ", ".join(f"{x:.3g}" for x in np.degrees(error.bias))
        yield (
            "turn-bias",
            f"turn too far from each pose to the next, by ({turns}) degrees, as a gyroscope with "
            "a bias",
            "subtract that from each turn, or calibrate the gyroscope",
        )


def _axis_in_words(C: FloatArray) -> str:
    axis = so.log(C[None])[0]
    if len(axis) == 1:
        return ""
    named = ", ".join(f"{x:.3g}" for x in axis / np.linalg.norm(axis))
    return f" about ({named})"

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

from certpgo.diagnosis.conventions import axes_of, quarter_turns
from certpgo.diagnosis.estimates import SHARE, UNITS, unit_of
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.sensor_starts import FEWEST, Others, from_others
from certpgo.diagnosis.study import Study
from certpgo.diagnosis.systematic import (
    ARM,
    BIAS,
    METRES,
    TURN,
    Fitted,
    Systematic,
    at_error,
    fitted,
    score,
)
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import objective_of
from certpgo.optimize.descent import descend

#: Share of chi^2 that the score test may leave of an error that is worth a fit, and fits at most.
LIKELY, FITTED = 0.7, 2
#: chi^2 over its degrees of freedom from which an error may be large.
LARGE = 25.0
#: Twice the logarithm of likelihoods' ratio by which what is left out would have to be needed, and
#: its share of chi^2.
NEEDED, SLIGHT = 16.0, 0.02
#: What the rise of chi^2 may be off by to first order.
FAR = 5.0
#: Twice the logarithm that an error has to gain at all.
GAINED = 25.0
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
    best = _best(examined, first)
    if best is None or not first.fit.chi2 - best.chi2 > GAINED + len(best.error.free):
        return None
    share, usual = best.chi2 / first.fit.chi2, _is_usual(best)
    if not (share < SHARE or usual):
        return None
    best = _simplified(examined, best)
    gain = first.fit.chi2 - best.chi2
    return SensorError(gain, share < SHARE and usual, _told(examined, best))


def _best(examined: Examined, first: Study) -> Fitted | None:
    """The error with which the measurements fit best, of those that may explain the map."""
    fits = [at_error(examined, *one) for one in _likely(examined, first)]
    likely = sorted((one for one in fits if one is not None), key=lambda one: one.score.left)
    best: Fitted | None = None
    for one in likely:
        if best is not None and not one.score.left < best.chi2:
            break  # no step makes it the better one
        if best is not None and best.error.of == one.error.of and _is_usual(best):
            continue  # there is nothing left to explain
        found = fitted(examined, one)
        if best is None or found.chi2 < best.chi2:
            best = found
    return best


def _is_usual(of: Fitted) -> bool:
    """Whether no more is left than noise as it is stated."""
    return not of.fit.fit.is_unusually_large


# --- Errors that may be ---------------------------------------------------------------------------


def _likely(examined: Examined, first: Study) -> Iterator[tuple[Systematic, Estimate]]:
    """The errors that may explain the map, and an estimate with each: the likeliest first."""
    errors, lefts = [*_errors(examined)], []
    for error in errors:
        examined.trying(f"{NAMES[error.of]}-systematic")
        with suppress(np.linalg.LinAlgError):
            left = score(error, first, first.problem.measured).left
            if left < LIKELY * first.fit.chi2:
                lefts.append((left, error))
    for _, error in sorted(lefts, key=lambda one: one[0])[:FITTED]:
        yield error, first.estimate
    if first.fit.chi2 > LARGE * first.fit.freedom:
        others: dict[bytes, Others | None] = {}
        for error in errors:
            with suppress(CertPGOError, np.linalg.LinAlgError):
                yield from from_others(examined, error, others)


def _errors(examined: Examined) -> Iterator[Systematic]:
    """Of each kind, no error, of which all is free that its measurements may show."""
    instance = examined.instance
    graph, measured = instance.graph, instance.measurements
    d, q = graph.d, so.tangent_dim(graph.d)
    carries = ~graph.is_point & (np.arange(graph.num_nodes) != examined.world)
    kinds = {name: rows for name, rows in examined.kinds.items() if name in NAMES}
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


# --- The simplest that remains --------------------------------------------------------------------


def _simplified(examined: Examined, rich: Fitted) -> Fitted:
    """The same without what is not needed."""
    best = rich
    for name in rich.error.free:
        for error, off in _SIMPLER[name](best.error):
            allowed = max(NEEDED, SLIGHT * best.chi2)
            chosen = best.error.places(name)
            if best.score.costs_at_least(off, chosen) > FAR * allowed:
                continue
            simpler = replace(error, free=tuple(one for one in error.free if one != name))
            trial = at_error(examined, simpler, best.fit.estimate)
            trial = trial and fitted(examined, trial)
            if trial is not None and trial.chi2 < best.chi2 + allowed:
                best = trial
                break
    return best


Simpler = Iterator[tuple[Systematic, FloatArray]]


def _in_round_unit(error: Systematic) -> Simpler:
    unit, _ = unit_of(error.metres)
    for metres in (1.0, *([UNITS[unit]] if unit in UNITS else [])):
        yield replace(error, metres=metres), np.array([math.log(metres / error.metres)])


def _unturned(error: Systematic) -> Simpler:
    d = len(error.arm)
    near = max(quarter_turns(d), key=lambda Q: float(np.trace(Q.T @ error.turn)))
    turns = [np.eye(d), *([near] if _degrees(near.T @ error.turn) < QUARTER else [])]
    for turn in turns:
        yield replace(error, turn=turn), so.log((turn @ error.turn.T)[None])[0]


def _unmoved(error: Systematic) -> Simpler:
    yield replace(error, arm=0.0 * error.arm), -error.arm


def _unbiased(error: Systematic) -> Simpler:
    yield replace(error, bias=0.0 * error.bias), -error.bias


#: What each may be instead, and the step there.
_SIMPLER = {METRES: _in_round_unit, TURN: _unturned, ARM: _unmoved, BIAS: _unbiased}


def _degrees(C: FloatArray) -> float:
    return math.degrees(float(so.angle(C[None])[0]))


# --- In words -------------------------------------------------------------------------------------


def _told(examined: Examined, of: Fitted) -> Finding:
    """The error as a finding."""
    error, given = of.error, examined.best
    cost = _cost(examined, of)
    parts = [*_parts(error)]
    whose = "odometry edges" if error.of == "odometry" else error.of
    costs = f"so read the best fit costs {cost_shown(cost)}, as it stands {cost_shown(given)}"
    said, next = (", and ".join(part[k] for part in parts) for k in (1, 2))
    kind = f"{NAMES[error.of]}-{parts[0][0]}"
    return Finding(kind, f"{whose} {said}: {costs}", next, cost, given)


def _cost(examined: Examined, of: Fitted) -> float:
    """The least cost of the measurements without the error."""
    graph = of.error.read(examined.instance.graph)
    problem = objective_of(replace(examined.instance, graph=graph), examined.problem.cost_name)
    return descend(problem, problem.settled(of.fit.estimate), monitor=examined.monitor).cost


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

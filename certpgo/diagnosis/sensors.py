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
from certpgo.diagnosis.noise import kinds_of
from certpgo.diagnosis.sensor_starts import FEWEST, Others, from_others
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
from certpgo.errors import CertPGOError
from certpgo.graph.phrases import cost_shown
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.solve.fit import fit_of

#: Share of chi^2 that the score test may leave of an error that is worth a fit, and fits at most.
LIKELY, FITTED = 0.7, 2
#: chi^2 over its degrees of freedom from which an error may be large.
LARGE = 25.0
#: Twice the logarithm of likelihoods' ratio by which what is left out would have to be needed, and
#: its share of chi^2.
NEEDED, SLIGHT = 16.0, 0.02
#: The same that an error has to gain at all.
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
        others: dict[bytes, Others | None] = {}
        for error in errors:
            with suppress(CertPGOError, np.linalg.LinAlgError):
                found += [*from_others(examined, error, others)]
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

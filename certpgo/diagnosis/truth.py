"""Why an estimate is far from the truth: conventions, frames, units and times of the truth.

A reading of the truth is judged by what is left of the errors after the best rigid motion: root
mean squares of positions, metres, and of angles, degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from certpgo.diagnosis import conventions, estimates
from certpgo.diagnosis.blamed_truth import contradicting
from certpgo.diagnosis.examined import Clock, Examined, KnownTruth
from certpgo.diagnosis.finding import Finding
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Instance
from certpgo.io.format import LabelledPoses
from certpgo.io.matching import Matching
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.procrustes import procrustes
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.costs import CHORDAL
from certpgo.optimize.initialization import start_of
from certpgo.solve.metrics import alignment, trajectory_errors

#: Errors that are not asked about: of positions over their spread, and of angles, degrees.
NEAR, TURNED = 0.02, 5.0
#: A reading explains errors if it leaves at most this share of them.
SHARE = 0.25
#: Signed permutations are taken for such up to this angle, degrees.
QUARTER = 10.0
#: Alternations between a motion and what is fitted with it.
ROUNDS = 20
#: Offsets of times that are tried, in median steps to either side, refinements of the best, and
#: offsets that each tries.
OFFSETS, REFINED, TRIED = 200, 10, 9
#: Nodes by which offsets are found, and the fewest; rounds until a drift is found.
SOME, FEWEST, DRIFTS = 100, 4, 3


def found(examined: Examined) -> Iterator[Finding]:
    """What explains the errors against the truth, if they are not small."""
    truth = examined.truth
    if truth is None:
        return
    if truth.clock is not None:
        yield from _of_units_of_time(truth.clock)
    given = examined.answer.estimate if examined.estimate is None else examined.estimate
    if len(truth.nodes) < 3:
        if truth.clock is not None:
            yield from _of_offset(examined, given, truth, truth.clock)
        return
    estimate, poses = given.subset(truth.nodes), truth.poses
    if poses.translations is None:
        estimate = estimate.with_translations(None)
    elif estimate.translations is None:
        return
    errors = _Errors.of(estimate, poses)
    if errors.size < 1.0:
        return
    trials = [_read(examined, estimate, poses, one) for one in _conventions(estimate.d)]
    trials += [*_of_frames(examined, estimate, poses, errors)]
    if poses.translations is not None:
        trials += [*_of_scale(examined, estimate, poses)]
    best = min((trial.errors.size for trial in trials), default=math.inf)
    chosen = next((one for one in trials if one.errors.size <= 1.05 * best), None)
    causes = []
    if chosen is not None and errors.are_explained(chosen.errors):
        causes.append(chosen.finding(errors))
    if truth.clock is not None:
        causes += _of_offset(examined, given, truth, truth.clock)
    if not causes and (wrong := contradicting(examined, truth)) is not None:
        causes.append(wrong)
    yield from causes


@dataclass(frozen=True)
class _Errors:
    """Root mean squares after the best rigid motion; None for what is not known."""

    metres: float | None
    degrees: float | None
    spread: float

    @staticmethod
    def of(estimate: Estimate, truth: Estimate) -> _Errors:
        found = trajectory_errors(estimate, truth)
        t = truth.translations
        spread = 0.0 if t is None else _spread(t)
        return _Errors(found.ate_m, found.ate_deg, spread)

    @property
    def size(self) -> float:
        """The larger of both over what is small."""
        moved = 0.0 if not self.metres or not self.spread else self.metres / self.spread
        return max(moved / NEAR, (self.degrees or 0.0) / TURNED)

    def are_explained(self, left: _Errors) -> bool:
        """Whether a reading that leaves others explains these."""
        return left.size < (SHARE if left.size > 1.0 else 2.0 * SHARE) * self.size

    def __str__(self) -> str:
        named = ((self.metres, "m"), (self.degrees, "degrees"))
        return " and ".join(f"{x:.3g} {unit}" for x, unit in named if x is not None)


@dataclass(frozen=True)
class _Trial:
    kind: str
    said: str
    next: str
    errors: _Errors

    def finding(self, given: _Errors) -> Finding:
        off = f"so read it is off by {self.errors}, as it stands by {given}"
        said = f"{estimates.in_words(self.said, 'the truth')}: {off}"
        return Finding(self.kind, said, self.next, self.errors.size, given.size)


# --- Conventions and frames -----------------------------------------------------------------------


def _conventions(d: int) -> Iterator[conventions.Convention]:
    """Those of positions and of whole poses; turns of the body are fitted."""
    if d == 3:
        yield conventions.W_FIRST
    yield from conventions.FORMS
    yield from conventions.of_axes(d)  # turns of the bodies are fitted


def _read(
    examined: Examined, estimate: Estimate, truth: Estimate, convention: conventions.Convention
) -> _Trial:
    examined.trying(f"truth {convention.kind}")
    read = conventions.read_by(truth, (convention,)).keyed(truth.keys)
    errors = _Errors.of(estimate, read)
    return _Trial(convention.kind, convention.said, convention.next, errors)


def _of_scale(examined: Examined, estimate: Estimate, truth: Estimate) -> Iterator[_Trial]:
    """The truth in the unit of the estimate."""
    examined.trying("truth scaled")
    _, _, s = alignment(estimate, truth, scaled=True)
    if s > 0.0 and abs(s - 1.0) > estimates.NEAR and truth.translations is not None:
        scaled = truth.with_translations(truth.translations / s)
        unit, factor = estimates.unit_of(1.0 / s)
        said = estimates.unit_in_words(unit, factor)
        errors = _Errors.of(estimate, scaled)
        yield _Trial(unit, said, f"multiply its positions by {factor}", errors)


def _of_frames(
    examined: Examined, estimate: Estimate, truth: Estimate, errors: _Errors
) -> Iterator[_Trial]:
    """The truth of another frame of the body: turned, and mounted elsewhere."""
    if truth.keys.are_positions:
        return
    examined.trying("truth other-frame")
    C, a = mounting(estimate, truth)
    R = truth.rotations @ C.T
    angle = math.degrees(float(so.angle(C[None])[0]))
    near = max(conventions.quarter_turns(estimate.d), key=lambda Q: float(np.trace(Q.T @ C)))
    off = math.degrees(float(so.angle((near.T @ C)[None])[0]))
    t = truth.translations
    turned = Estimate(R, t)
    if off < QUARTER:
        axes = conventions.axes_of(near)
        said = f"{{its}} bodies have other axes, {angle:.4g} degrees everywhere: {axes}"
        kind, next = "permuted-axes", "multiply each of its rotations by that permutation"
    else:
        said = f"{{it}} is of another frame of the body, turned by {angle:.4g} degrees everywhere"
        kind, next = "other-frame", "give the truth of the frame that the graph's poses have"
    if angle > TURNED:
        yield _Trial(kind, said, next, _Errors.of(estimate, turned))
    if t is not None and errors.metres is not None:
        moved = Estimate(R, t - np.einsum("nab,b->na", truth.rotations, a))
        length = float(np.linalg.norm(a))
        arm = ", ".join(f"{x:.3g}" for x in a)
        point = (
            f"{{it}} is of a point {length:.3g} m from that of the graph, at ({arm}) in its frame"
        )
        left = _Errors.of(estimate, moved)
        if left.metres is not None and left.metres < 2.0 * SHARE * errors.metres:
            is_turned = angle > TURNED
            said, kind = (f"{said}, and {point}", kind) if is_turned else (point, "lever-arm")
            yield _Trial(kind, said, next, left)


def mounting(estimate: Estimate, truth: Estimate) -> tuple[FloatArray, FloatArray]:
    """How the truth's body is mounted: C (d, d) and a (d,) with R' ~ S R C and t' ~ S t + R' a.

    By alternation between the common motion and these.
    """
    R, true, d = estimate.rotations, truth.rotations, estimate.d
    t, u = estimate.translations, truth.translations
    C, a = np.eye(d), np.zeros(d)
    for _ in range(ROUNDS):
        if t is None or u is None:
            S = so.project((true @ C.T @ np.swapaxes(R, 1, 2)).sum(axis=0)[None])[0]
        else:
            at = u - np.einsum("nab,b->na", true, a)
            [S], [shift], _ = procrustes(at[None], t[None])
            # Least squares over the shift, too, which the arm would take a part of.
            off = u - t @ S.T - shift
            mean = true.mean(axis=0)
            A = (true - mean).reshape(-1, d)
            a = np.linalg.lstsq(A, (off - off.mean(axis=0)).ravel(), rcond=1e-6)[0]
        C = so.project(np.einsum("nba,nbc->ac", S @ R, true)[None])[0]
    return C, a


# --- Times ----------------------------------------------------------------------------------------


def _of_units_of_time(clock: Clock) -> Iterator[Finding]:
    """Clocks of which one counts in other units."""
    known = np.sort(clock.nodes[np.isfinite(clock.nodes)])
    if len(known) < 2 or len(clock.times) < 2:
        return
    lengths = [float(times[-1] - times[0]) for times in (known, clock.times)]
    if not min(lengths) > 0.0:
        return
    ratio = lengths[1] / lengths[0]
    for factor in (1e3, 1e6, 1e9):
        for one, other, off in (
            ("truth's", "nodes'", ratio / factor),
            ("nodes'", "truth's", 1.0 / (ratio * factor)),
        ):
            if 0.2 < off < 5.0:
                both = f"{lengths[1]:.4g} seconds of truth, {lengths[0]:.4g} of nodes"
                said = f"the {one} times are {factor:g} times those of the {other[:-2]}: {both}"
                next = f"divide the {one} times by {factor:g}, or multiply the {other} by it"
                yield Finding("times-units", said, next, strength=8.0)


def _of_offset(
    examined: Examined, estimate: Estimate, truth: KnownTruth, clock: Clock
) -> Iterator[Finding]:
    """The offset of the truth's clock, by the errors that are left with it."""
    examined.trying("shifted-times")
    known = np.flatnonzero(np.isfinite(clock.nodes))
    t = estimate.translations
    if t is None or min(len(known), len(clock.times)) < FEWEST:
        return
    t, at = t[known], clock.nodes[known]
    given = float(_left(t, at, clock, np.zeros(1))[0])
    offset, left = best_offset(t, at, clock)
    drift = drift_of(t, at, clock, offset)
    near, matched = 5.0 * NEAR * _spread(t), len(truth.nodes) > 0 and given < math.inf
    as_it_stands = f"{given:.3g} m as it stands" if matched else "no times match as they stand"
    if not (left < SHARE * given and left < near and abs(offset) > clock.allowed):
        if matched and drift.left < min(SHARE * given, near):
            yield drift.finding(given, as_it_stands)
        return
    said = f"the truth's clock is {abs(offset):.4g} s {'late' if offset > 0.0 else 'early'}"
    said = f"{said}: with that undone positions are off by {left:.3g} m, {as_it_stands}"
    if drift.left < 0.5 * left:
        said = f"{said}; it drifts by {drift.seconds:.3g} s over the trajectory"
    yield Finding(
        "shifted-times",
        said,
        f"add {offset_option(offset)}",
        left,
        given if matched else None,
        strength=math.nan if matched else 6.0,
    )


def offset_option(offset: float) -> str:
    """The option that undoes the offset of the truth's clock."""
    return f"--truth-offset {-offset:.4g}"


def offset_by_start(poses: LabelledPoses, instance: Instance, how: Matching) -> str:
    """The option with which times of a truth match that do not, in a sentence; or empty.

    By averaged rotations, without a search.
    """
    clock = Clock.of(poses, instance, how)
    if clock is None:
        return ""
    with suppress(CertPGOError, np.linalg.LinAlgError):
        estimate = start_of(objective_of(instance, CHORDAL).chordal).estimate
        known = np.flatnonzero(np.isfinite(clock.nodes))
        if estimate.translations is not None and min(len(known), len(clock.times)) >= FEWEST:
            t = estimate.translations[known]
            offset, left = best_offset(t, clock.nodes[known], clock)
            if left < 5.0 * NEAR * _spread(t):
                return f"with {offset_option(offset)} positions are off by {left:.2g} m"
    return ""


def best_offset(t: FloatArray, at: FloatArray, clock: Clock) -> tuple[float, float]:
    """By how much the truth's clock is late, and the errors (metres) with that undone.

    Parameters
    ----------
    t : (k, d) positions
    at : (k,) their times
    """
    some = np.linspace(0, len(at) - 1, min(len(at), SOME)).astype(int)
    step = float(np.median(np.diff(clock.times)))
    starts = clock.times[0] - at.min(), clock.times[-1] - at.max()
    near = step * np.arange(-OFFSETS, OFFSETS + 1)
    tried = np.concatenate([near, 0.5 * sum(starts) + near, starts])
    offset = float(tried[int(np.argmin(_left(t[some], at[some], clock, tried)))])
    width = step
    for _ in range(REFINED):
        around = offset + width * np.linspace(-1.0, 1.0, TRIED)
        best = int(np.argmin(_left(t[some], at[some], clock, around)))
        is_inside = 0 < best < TRIED - 1
        offset, width = float(around[best]), width * (2.0 / (TRIED - 1) if is_inside else 1.0)
    return offset, float(_left(t, at, clock, np.array([offset]))[0])


def _left(t: FloatArray, at: FloatArray, clock: Clock, offsets: FloatArray) -> FloatArray:
    """(k,) errors of positions, root mean square, after the best motion for each offset (k,).

    Infinite where less than half of the nodes have a true position.
    """
    times = at + offsets[:, None]
    inside = (times >= clock.times[0]) & (times <= clock.times[-1])
    found = np.full(len(offsets), np.inf)
    enough = np.flatnonzero(inside.sum(axis=1) >= max(4, len(at) // 2))
    true = np.stack([np.interp(times[enough], clock.times, x) for x in clock.positions.T], axis=2)
    weights = inside[enough, :, None] / inside[enough].sum(axis=1)[:, None, None]
    own = np.broadcast_to(t, true.shape)
    x, y = (of - (weights * of).sum(axis=1, keepdims=True) for of in (true, own))
    S = so.project(np.swapaxes(weights * x, 1, 2) @ y)
    off = x - y @ np.swapaxes(S, 1, 2)
    found[enough] = np.sqrt((weights * off**2).sum(axis=(1, 2)))
    return found


@dataclass(frozen=True)
class Drift:
    """How fast the truth's clock runs: it gains ``rate`` seconds a second.

    Attributes
    ----------
    rate : seconds a second
    seconds : what it gains over the trajectory
    left : errors with that undone, metres; infinite where it is not known
    """

    rate: float = 0.0
    seconds: float = 0.0
    left: float = math.inf

    def finding(self, given: float, as_it_stands: str) -> Finding:
        """What it explains, of errors in metres."""
        gains = "gains" if self.seconds > 0.0 else "loses"
        said = f"the truth's clock drifts, it {gains} {abs(self.seconds):.3g} s over the trajectory"
        said = f"{said}: with that undone positions are off by {self.left:.3g} m, {as_it_stands}"
        next = f"divide the truth's times since the middle by {1.0 + self.rate:.8g}"
        return Finding("clock-drift", said, next, self.left, given)


def drift_of(t: FloatArray, at: FloatArray, clock: Clock, offset: float) -> Drift:
    """The drift of the truth's clock, by offsets of both halves of the nodes.

    Parameters
    ----------
    t : (k, d) positions
    at : (k,) their times
    offset : by how much the clock is late on the whole
    """
    middle, rate, left = float(np.median(at)), 0.0, math.inf
    halves = [at <= middle, at > middle]
    if min(half.sum() for half in halves) < FEWEST:
        return Drift()
    apart = float(at[halves[1]].mean() - at[halves[0]].mean())
    for _ in range(DRIFTS):
        warped = at + rate * (at - middle)
        near = replace(clock, times=clock.times - offset)
        first, second = (best_offset(t[half], warped[half], near)[0] for half in halves)
        rate, offset = rate + (second - first) / apart, offset + 0.5 * (first + second)
    warped = at + rate * (at - middle)
    left = float(_left(t, warped, clock, np.array([offset]))[0])
    return Drift(rate, rate * float(at.max() - at.min()), left)


def _spread(t: FloatArray) -> float:
    """The largest distance from the middle of positions (k, d)."""
    return float(np.linalg.norm(t - t.mean(axis=0), axis=1).max())

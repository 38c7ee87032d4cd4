"""By how much noise is stated, for each kind of measurement.

Variances of kinds are those with which each kind's squares are what they should be, by what the fit
leaves of each kind's noise in each kind's residuals (see `certpgo.diagnosis.study`), repeated with
these variances: the estimate of the restricted likelihood, which also says whether other variances
are needed at all. A kind's degrees of freedom are those that its variance is known by: numbers
measured, less what the fit takes, and less what cannot be told from the noise of other kinds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import OVERSTATED, Finding
from certpgo.diagnosis.study import Coupling, Study
from certpgo.graph import Instance
from certpgo.graph.kinds import RELATIVE, Kind
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import BoolArray, FloatArray

#: Ratios of standard deviations that are not remarked upon, and degrees of freedom that are enough.
USUAL, FEWEST = 1.4, 0.5
#: Probability of what is unusual, and twice the log of likelihoods' ratio that needs no more words.
UNLIKELY, NO_BETTER = 5e-5, 10.0
#: Rounds of the fixed point; change of variances that ends them, and degrees of freedom by which
#: these are known well enough whatever they were assumed to be.
ROUNDS, NEAR, PLENTY = 6, 1.2, 1000
#: Probability, over `UNLIKELY`, from which no other variances are looked for.
ORDINARY = 100.0
#: Variances relative to the last ones stay above this share, and that of the kind's own estimate.
LEAST, STEP = 1e-12, 0.2
#: Largest strength, where it is stated too small, and too large, which does no harm: mistakes that
#: explain more come first.
STRONGEST, HARMLESS = 0.9, 0.2


@dataclass(frozen=True)
class Noise:
    """The noise of measurements of one kind.

    Attributes
    ----------
    of : the kind, in words
    ratio : standard deviation over that stated
    freedom : degrees of freedom
    """

    of: str
    ratio: float
    freedom: float

    @property
    def interval(self) -> tuple[float, float]:
        """The ratio's interval at 95 %."""
        low, high = 2.0 * special.gammaincinv(0.5 * self.freedom, [0.975, 0.025])
        chi2 = self.ratio**2 * self.freedom
        return math.sqrt(chi2 / low), math.sqrt(chi2 / high)

    def __str__(self) -> str:
        low, high = self.interval
        freedom = counted(round(self.freedom), "degree{s}")
        return f"{self.ratio:.3g} times the stated noise ({low:.3g} to {high:.3g}, by {freedom})"


def kinds_of(examined: Examined) -> dict[str, BoolArray]:
    """(m,) which measurements are of which kind, in words."""
    measured = examined.instance.measurements
    relative = measured.are(*RELATIVE)
    steps = np.zeros(len(relative), dtype=bool)
    steps[: len(examined.steps)] = examined.steps
    closures = "loop closures" if (steps & relative).any() else "relative poses"
    found = {
        "odometry": relative & steps,
        closures: relative & ~steps,
        "pose priors": measured.are(Kind.PRIOR),
        "position priors": measured.are(Kind.POSITION),
        "attitude priors": measured.are(Kind.ATTITUDE),
        "sightings": measured.are(Kind.SIGHTING),
        "distances": measured.are(Kind.RANGE),
        "other measurements": measured.are(Kind.OTHER),
    }
    return {name: rows for name, rows in found.items() if rows.any()}


@dataclass(frozen=True, eq=False)
class Model:
    """Variances of kinds of which some are estimated, others as stated.

    Attributes
    ----------
    variances : (k,) relative to those that are stated
    freedoms : (k,) degrees of freedom that these are known by; 0 for those that are not estimated
    gain : twice the log of how much likelier they are than what is stated
    """

    variances: FloatArray
    freedoms: FloatArray
    gain: float


def fitted(
    first: Study, seen: Coupling, kinds: Sequence[BoolArray], free: BoolArray
) -> Model | None:
    """The variances of some kinds (k,), given the others; None if they cannot be told.

    Parameters
    ----------
    first : at the stated noise, of all measurements that are right
    seen : its coupling of the kinds
    """
    at, variances, gain = first, np.ones(len(kinds)), 0.0
    B, squares = seen
    if free.all():  # what is common to all changes no fit
        variances, gain = _together(seen)
        squares = squares / variances
    for number in range(ROUNDS):
        changes, freedoms = _changes(B, squares, free)
        if not (freedoms[free] > FEWEST).all():
            return None
        variances = variances * changes
        if np.abs(np.log(changes)).max() < math.log(NEAR) or freedoms[free].min() > PLENTY:
            gain += _gained(B, changes)
            break
        factors = np.ones(len(first.counts))
        for rows, variance in zip(kinds, variances.tolist(), strict=True):
            factors[rows] = 1.0 / variance
        again = at.under(factors)
        if again is None:
            return None
        at, gain = again, first.surprise - again.surprise
        if number < ROUNDS - 1:
            B, squares = at.coupling(kinds, roughly=True)
    return Model(variances, freedoms, gain)


def _together(seen: Coupling) -> tuple[FloatArray, float]:
    """(k,) the variance of all kinds if it is the same, and what that gains."""
    freedom, chi2 = float(seen.B.sum()), float(seen.squares.sum())
    ratio = max(chi2 / freedom, LEAST)
    return np.full(len(seen.B), ratio), chi2 - freedom * (math.log(ratio) + 1.0)


def _changes(B: FloatArray, squares: FloatArray, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(k,) variances of kinds over those assumed, without bias whatever these are; and freedoms."""
    inverse = np.linalg.pinv(B[np.ix_(free, free)], hermitian=True)
    changes, freedoms = np.ones(len(B)), np.zeros(len(B))
    changes[free] = inverse @ (squares - B[:, ~free].sum(axis=1))[free]
    # A difference of squares may be negative: then as if all kinds were off by the same.
    together = squares / np.maximum(B.sum(axis=1), FEWEST)
    changes[free] = np.maximum(changes, np.maximum(STEP * together, LEAST))[free]
    # Squares vary with the variances that are, not with those assumed.
    own = changes[free]
    varied = inverse @ (own[:, None] * B[np.ix_(free, free)] * own) @ inverse
    freedoms[free] = own**2 / np.maximum(np.diag(varied), LEAST)
    return changes, freedoms


def _gained(B: FloatArray, changes: FloatArray) -> float:
    """What variances near those assumed gain: to second order, and exactly for one kind alone."""
    off = changes - 1.0
    moved = off != 0.0
    r, curved = changes[moved], (off * (B @ off))[moved]
    return max(float((curved * (r - 1.0 - np.log(r)) / (r - 1.0) ** 2).sum()), 0.0)


# --- Findings -------------------------------------------------------------------------------------


def found(examined: Examined, first: Study) -> tuple[float, list[Finding]]:
    """Kinds of measurements whose noise is not as stated.

    Before these stands twice the log of how much likelier they make the measurements.

    Parameters
    ----------
    first : at the stated noise, of all measurements that are right
    """
    instance = examined.instance
    examined.trying("noise")
    nothing = states_nothing(instance)
    if not (nothing or instance.states_noise):
        return 0.0, []
    gain, unusual = _unusual(examined, first)
    if nothing and unusual:
        return gain, [_identity(unusual)]
    return gain, [_finding(noise) for noise in unusual]


def _finding(noise: Noise) -> Finding:
    chi2 = noise.ratio**2 * noise.freedom
    kind = "noise-too-small" if noise.ratio > 1.0 else OVERSTATED
    by = f"{noise.ratio:.3g}, its information by {noise.ratio**-2:.3g}"
    next = f"multiply the standard deviations of {noise.of} by {by}"
    most = STRONGEST if noise.ratio > 1.0 else HARMLESS
    strength = min(most, abs(math.log10(noise.ratio)))
    said = f"residuals of {noise.of} are {noise}"
    return Finding(kind, said, next, noise.freedom, chi2, strength)


def _unusual(examined: Examined, first: Study) -> tuple[float, list[Noise]]:
    """Noise that is not as stated, in the simplest words: of all, of one kind, or of each."""
    names = kinds_of(examined)
    kinds = [rows & first.counts for rows in names.values()]
    seen = first.coupling(kinds)
    freedom = float(seen.B.sum())
    if freedom < FEWEST:
        return 0.0, []
    ratios, gain = _together(seen)
    known = np.diag(seen.B) > FEWEST
    of_each = _gained(seen.B, _changes(seen.B, seen.squares, known)[0])
    if special.gammaincc(0.5 * len(kinds), 0.5 * max(gain, of_each)) > ORDINARY * UNLIKELY:
        return 0.0, []
    models = [(gain, [Noise("all measurements", math.sqrt(ratios[0]), freedom)])]
    choices = [known] if known.sum() > 1 else []
    singles = [np.arange(len(kinds)) == k for k in np.flatnonzero(known)]
    while choices:
        free = choices.pop()
        if (model := fitted(first, seen, kinds, free)) is None:
            if free is known:
                choices = singles
            continue
        each = zip(names, np.sqrt(model.variances).tolist(), model.freedoms.tolist(), strict=True)
        of_kinds = [Noise(*one) for one, chosen in zip(each, free, strict=True) if chosen]
        models.append((model.gain, of_kinds))
        if free is known and models[-1][0] > gain + NO_BETTER:  # one kind may be all that is off
            off = np.abs(np.log(model.variances)) > 2.0 * math.log(USUAL)
            choices = [one for one in singles if off[one].any()] if (off[known]).sum() == 1 else []
    most = max(gain for gain, _ in models)
    enough = [one for one in models if one[0] > most - NO_BETTER]
    gain, of_kinds = min(enough, key=lambda one: len(one[1]))
    if special.gammaincc(0.5 * len(of_kinds), 0.5 * max(gain, 0.0)) > UNLIKELY:
        return 0.0, []
    return gain, [one for one in of_kinds if not 1.0 / USUAL < one.ratio < USUAL]


def states_nothing(instance: Instance) -> bool:
    """Whether all weights are 1, as of a file that does not know the noise."""
    graph, information = instance.graph, instance.graph.information
    if information is not None:
        p = information.distinct.shape[1]
        return bool((information.distinct == np.eye(p)).all())
    return bool(instance.options) and bool((graph.tau == 1.0).all())


def _identity(of_kinds: list[Noise]) -> Finding:
    ratios = ", ".join(f"{noise.ratio:.3g} of {noise.of}" for noise in of_kinds)
    said = f"all information matrices are the identity, which states nothing: noise is {ratios}"
    next = "state information as inverse covariances; until then chi^2 and covariances mean nothing"
    return Finding("identity-information", said, next, strength=0.1)

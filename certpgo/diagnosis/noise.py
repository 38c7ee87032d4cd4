"""By how much noise is stated, for each kind of measurement.

Variances of kinds are those with which each kind's squares are what they should be, by what the fit
leaves of each kind's noise in each kind's residuals (see `certpgo.diagnosis.study`), repeated with
these variances: the estimate of the restricted likelihood, which also says whether other variances
are needed at all. A kind's degrees of freedom are those that its variance is known by: numbers
measured, less what the fit takes, and less what cannot be told from the noise of other kinds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.study import Coupling, Study, studied_problem, study
from certpgo.graph import Instance
from certpgo.graph.kinds import RELATIVE, Kind
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.sum import Sum

#: Ratios of standard deviations that are not remarked upon, and degrees of freedom that are enough.
USUAL, FEWEST = 1.4, 0.5
#: Ratio that a kind may have if others alone are said to be off.
SIMILAR = 1.3
#: Probability of what is unusual, and twice the log of likelihoods' ratio that needs no more words.
UNLIKELY, NO_BETTER = 5e-5, 10.0
#: Rounds of the fixed point, and change of a kind's variance relative to others' that ends them.
ROUNDS, STILL = 6, 1.2
#: Variances relative to the last ones stay above this share, and that of the kind's own estimate.
LEAST, STEP = 1e-12, 0.2
#: A weight is stiff that is this many times the next smaller one.
STIFF = 1e6
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
    surprise : of the study with these, see `Study`
    """

    variances: FloatArray
    freedoms: FloatArray
    surprise: float


def fitted(
    problem: Sum, first: Study, seen: Coupling, kinds: Sequence[BoolArray], free: BoolArray
) -> Model | None:
    """The variances of some kinds (k,), given the others; None if they cannot be told.

    Parameters
    ----------
    first : at the stated noise, of all measurements that are right
    seen : its coupling of the kinds
    """
    at, variances, freedoms = first, np.ones(len(kinds)), np.zeros(len(kinds))
    for number in range(ROUNDS):
        B, squares, _ = seen if number == 0 else at.coupling(kinds)
        if free.all() and number == 0:  # what is common to all changes no fit
            variances = np.full(len(kinds), max(squares.sum() / B.sum(), LEAST))
            squares = squares / variances
        inverse = np.linalg.pinv(B[np.ix_(free, free)], hermitian=True)
        freedoms[free] = 1.0 / np.diag(inverse)
        if not (freedoms[free] > FEWEST).all():
            return None
        changes = np.ones(len(kinds))
        changes[free] = inverse @ (squares - B[:, ~free].sum(axis=1))[free]
        # A difference of squares may be negative: then as if all kinds were off by the same.
        together = squares / np.maximum(B.sum(axis=1), FEWEST)
        changes[free] = np.maximum(changes, np.maximum(STEP * together, LEAST))[free]
        variances = variances * changes
        factors = np.ones(len(first.counts))
        for rows, variance in zip(kinds, variances.tolist(), strict=True):
            factors[rows] = 1.0 / variance
        again = study(problem, at.estimate, at.anchor, factors, first.counts)
        if again is None:
            return None
        at = again
        if np.abs(np.log(changes)).max() < math.log(STILL):
            break
    return Model(variances, freedoms, at.surprise)


# --- Findings -------------------------------------------------------------------------------------


def found(examined: Examined, first: Study, seen: Coupling) -> tuple[float, list[Finding]]:
    """Kinds of measurements whose noise is not as stated.

    Before these stands twice the log of how much likelier they make the measurements.

    Parameters
    ----------
    first : at the stated noise, of all measurements that are right
    seen : its coupling of all kinds
    """
    instance = examined.instance
    examined.trying("noise")
    nothing = states_nothing(instance)
    if not (nothing or instance.states_noise):
        return 0.0, []
    gain, unusual = _unusual(examined, first, seen)
    if nothing and unusual:
        return gain, [_identity(unusual)]
    return gain, [_finding(noise) for noise in unusual]


def _finding(noise: Noise) -> Finding:
    chi2 = noise.ratio**2 * noise.freedom
    kind = "noise-too-small" if noise.ratio > 1.0 else "noise-too-large"
    by = f"{noise.ratio:.3g}, its information by {noise.ratio**-2:.3g}"
    next = f"multiply the standard deviations of {noise.of} by {by}"
    most = STRONGEST if noise.ratio > 1.0 else HARMLESS
    strength = min(most, abs(math.log10(noise.ratio)))
    said = f"residuals of {noise.of} are {noise}"
    return Finding(kind, said, next, noise.freedom, chi2, strength)


def _unusual(examined: Examined, first: Study, seen: Coupling) -> tuple[float, list[Noise]]:
    """Noise that is not as stated, in the simplest words: of all, of one kind, or of each."""
    problem, names = studied_problem(examined.problem), kinds_of(examined)
    kinds = [rows & first.counts for rows in names.values()]
    freedom, chi2 = float(seen.B.sum()), float(seen.squares.sum())
    if problem is None or freedom < FEWEST:
        return 0.0, []
    ratio = max(chi2 / freedom, LEAST)
    gain = chi2 - freedom * (math.log(ratio) + 1.0)
    models = [(gain, [Noise("all measurements", math.sqrt(ratio), freedom)])]
    known = np.diag(seen.B) > FEWEST
    choices = [known] if known.sum() > 1 else []
    singles = [np.arange(len(kinds)) == k for k in np.flatnonzero(known)]
    while choices:
        free = choices.pop()
        if (model := fitted(problem, first, seen, kinds, free)) is None:
            if free is known:
                choices = singles
            continue
        each = zip(names, np.sqrt(model.variances).tolist(), model.freedoms.tolist(), strict=True)
        of_kinds = [Noise(*one) for one, chosen in zip(each, free, strict=True) if chosen]
        models.append((first.surprise - model.surprise, of_kinds))
        if free is known and models[-1][0] > gain + NO_BETTER:  # one kind may be all that is off
            off = np.abs(np.log(model.variances)) > 2.0 * math.log(SIMILAR)
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


def stiff(examined: Examined) -> Iterator[Finding]:
    """Measurements whose weights are beyond all others by many orders."""
    instance = examined.instance
    graph, measured = instance.graph, instance.is_measured
    examined.trying("stiff-edge")
    for weights, of in ((graph.tau, "1/m^2"), (graph.kappa, "1/rad^2")):
        rows = np.flatnonzero((weights > 0.0) & measured)
        rows = rows[np.argsort(weights[rows], kind="stable")]
        steps = weights[rows[1:]] / weights[rows[:-1]]
        if not len(steps) or not steps.max() > STIFF:
            continue
        first = int(np.argmax(steps)) + 1
        if len(rows) - first > first:
            continue
        heavy, others = rows[first:], rows[:first]
        names = ", ".join(f"{i}-{j}" for i, j in instance.pairs[heavy[:4]].tolist())
        most, rest = weights[heavy].max(), weights[others].max()
        verb = "weighs" if len(heavy) == 1 else "weigh"
        said = (
            f"{counted(len(heavy), 'measurement{s}')} ({names}{', ...' if len(heavy) > 4 else ''}) "
            f"{verb} up to {most:.3g} {of}, all others at most {rest:.3g}: rounding of "
            "such weights hides errors of the others"
        )
        edges = tuple(instance.known_numbers[heavy].tolist())
        next = f"use weights of at most {rest * STIFF:.1g}, or hold the nodes fixed"
        yield Finding("stiff-edge", said, next, strength=0.5, edges=edges)
        return

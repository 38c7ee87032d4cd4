"""By how much noise is stated, for each kind of measurement.

First by quadratic estimates: variances with which each kind's squares are what they should be, by
what the fit leaves of each kind's noise in each kind's residuals (see `certpgo.diagnosis.study`).
Where few degrees of freedom determine a variance, the likeliest ones are looked for from there (see
`certpgo.diagnosis.likelihood`). A kind's degrees of freedom are those that its variance is known
by: numbers measured, less what the fit takes, and less what cannot be told from the noise of other
kinds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import OVERSTATED, Finding
from certpgo.diagnosis.likelihood import Likelihood
from certpgo.diagnosis.study import Coupling, Study
from certpgo.graph import Instance
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import BoolArray, FloatArray

#: Ratios of standard deviations that are not remarked upon, and degrees of freedom that are enough.
USUAL, FEWEST = 1.4, 0.5
#: Probability of what is unusual, and twice the log of likelihoods' ratio that needs no more words.
UNLIKELY, NO_BETTER = 5e-5, 10.0
#: Steps to the likeliest variances, gain that is not worth another, and the largest change of a
#: logarithm; and degrees of freedom by which variances are known well enough without.
STEPS, LITTLE, FAR, PLENTY = 5, 0.1, 1.5, 1000
#: What variances below those stated gain at most, over what quadratic estimates say.
ABOUT = 2.0
#: Shares of a step that are tried until one is likelier.
SHORTER = (1.0, 0.25, 0.0625)
#: Probability, over `UNLIKELY`, from which no other variances are looked for.
ORDINARY = 100.0
#: Variances stay above this, and this share of what the kind's own squares say.
LEAST, SMALLEST = 1e-12, 0.2
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


def fitted(seen: Coupling, likelihood: Likelihood, free: BoolArray) -> Model | None:
    """The variances of some kinds (k,), given the others; None if they cannot be told.

    Parameters
    ----------
    seen : the coupling of the kinds at the stated noise
    likelihood : near the same fit
    """
    variances, freedoms = _changes(seen, free)
    if not (freedoms[free] > FEWEST).all():
        return None
    if freedoms[free].min() > PLENTY:
        return Model(variances, freedoms, _gained(seen, variances))
    return _likeliest(likelihood, variances, free)


def _likeliest(likelihood: Likelihood, start: FloatArray, free: BoolArray) -> Model | None:
    """The likeliest variances of some kinds, by Newton's method from a start."""
    stated = likelihood.at(np.ones(len(free)))
    best, own = likelihood.at(start), np.ix_(free, free)
    if stated is None or best is None:
        return None
    for _ in range(STEPS):
        curvature, pull = best.curvature[own], (best.squares - best.left)[free]
        if not np.linalg.eigvalsh(curvature)[0] > 0.0:
            return None
        step = np.zeros(len(free))
        step[free] = np.linalg.solve(curvature, pull)
        if 0.5 * float(pull @ step[free]) < LITTLE:
            break
        step = np.clip(step, -FAR, FAR)
        trials = (likelihood.at(best.variances * np.exp(share * step)) for share in SHORTER)
        there = next((one for one in trials if one and one.surprise < best.surprise), None)
        if there is None:
            break
        best = there
    else:
        return None  # it goes to nothing, or to infinity
    freedoms = np.zeros(len(free))
    freedoms[free] = 1.0 / np.diag(np.linalg.inv(curvature))
    if not (freedoms[free] > FEWEST).all():
        return None
    return Model(best.variances, freedoms, stated.surprise - best.surprise)


def _together(seen: Coupling) -> float:
    """The variance of all kinds if it is the same."""
    return max(float(seen.squares.sum() / seen.B.sum()), LEAST)


def _changes(seen: Coupling, free: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(k,) variances of kinds, without bias whatever they are; and their freedoms."""
    B, squares = seen
    inverse = np.linalg.pinv(B[np.ix_(free, free)], hermitian=True)
    changes, freedoms = np.ones(len(B)), np.zeros(len(B))
    changes[free] = inverse @ (squares - B[:, ~free].sum(axis=1))[free]
    # A difference of squares may be negative: then as if all kinds were off by the same.
    together = squares / np.maximum(B.sum(axis=1), FEWEST)
    changes[free] = np.maximum(changes, np.maximum(SMALLEST * together, LEAST))[free]
    # Squares vary with the variances that are, not with those assumed.
    own = changes[free]
    varied = inverse @ (own[:, None] * B[np.ix_(free, free)] * own) @ inverse
    freedoms[free] = own**2 / np.maximum(np.diag(varied), LEAST)
    return changes, freedoms


def _gained(seen: Coupling, variances: FloatArray) -> float:
    """What variances gain: exactly for what they have in common, for the rest to second order."""
    (B, squares), ratio = seen, _together(seen)
    if not (variances != 1.0).all():
        ratio = 1.0
    common = float(squares.sum()) * (1.0 - 1.0 / ratio) - float(B.sum()) * math.log(ratio)
    r = variances / ratio
    off = r - 1.0
    moved = off != 0.0
    curved = (off * (B @ off))[moved]
    rest = float((curved * (off[moved] - np.log(r[moved])) / off[moved] ** 2).sum())
    return max(min(common + max(rest, 0.0), _gained_at_most(seen, variances)), 0.0)


def _gained_at_most(seen: Coupling, variances: FloatArray) -> float:
    """What variances gain at most.

    log det H is convex in the logarithms of weights, and so not below its tangent at those stated.
    chi^2 is the largest (e^T y)^2 / y^T V y of all y that no motion changes, such as residuals e.
    """
    chi2, (B, squares) = float(seen.squares.sum()), seen
    least = chi2**2 / float(variances @ squares)
    return chi2 - least - float(B.sum(axis=1) @ np.log(variances))


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
    names = examined.kinds
    kinds = [rows & first.counts for rows in names.values()]
    seen = first.coupling(kinds)
    freedom, known = float(seen.B.sum()), np.diag(seen.B) > FEWEST
    if freedom < FEWEST:
        return 0.0, []
    same = np.full(len(kinds), _together(seen))
    gain, of_each = _gained(seen, same), _gained(seen, _changes(seen, known)[0])
    if special.gammaincc(0.5 * len(kinds), 0.5 * max(gain, of_each)) > ORDINARY * UNLIKELY:
        return 0.0, []
    likelihood = Likelihood(first, kinds)
    models = [(gain, [Noise("all measurements", math.sqrt(same[0]), freedom)])]
    choices = [known] if known.sum() > 1 else []
    singles = [np.arange(len(kinds)) == k for k in np.flatnonzero(known)]
    while choices:
        free = choices.pop()
        likely, _ = _changes(seen, free)
        if (likely <= 1.0).all() and ABOUT * _gained(seen, likely) < gain - NO_BETTER:
            continue
        if (model := fitted(seen, likelihood, free)) is None:
            if free is known:
                choices = singles
            continue
        variances = model.variances
        each = zip(names, np.sqrt(variances).tolist(), model.freedoms.tolist(), strict=True)
        of_kinds = [Noise(*one) for one, chosen in zip(each, free, strict=True) if chosen]
        models.append((model.gain, of_kinds))
        if free is known and model.gain > gain + NO_BETTER:  # one kind may be all that is off
            lost = model.freedoms * (variances - 1.0 - np.log(variances))
            choices = [one for one in singles if lost[~one].sum() < 2.0 * NO_BETTER]
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

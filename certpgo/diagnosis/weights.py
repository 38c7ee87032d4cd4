"""What the numbers after measured poses may be, if they are not information matrices as read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.meanings import OF_QUATERNIONS, OTHERS, Meaning, inverses, orders
from certpgo.diagnosis.studied_term import roots
from certpgo.diagnosis.study import Study, studied_problem, study
from certpgo.errors import CertPGOError
from certpgo.graph import Graph
from certpgo.graph.information import Information
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.objective.term import Term
from certpgo.solve.fit import Fit

#: Ratio of squares per number, of translations and rotations, that is even.
EVEN = 4.0
#: Degrees of freedom from which ordinary weights are this even, and no other meaning is tried.
PLENTY, EVENLY = 1000, 1.3
#: What chi^2 may be off by to first order, with plenty of degrees of freedom, and with few; and
#: what it hardly is.
LITTLE, MUCH, SAME = 1.05, 2.0, 0.01
#: Twice the logarithm of the ratio of likelihoods from which a meaning is by far the better one.
MORE = 16.0
#: The same of how much rarer other meanings are than misstated noise, before anything is measured.
RARER = 8.0
#: Strength of a factor of rotations.
WEAK = 0.3


def other_meaning(examined: Examined, least: float = 0.0) -> tuple[float, Finding] | None:
    """The meaning that is by far likelier than the given one, and with which chi^2 is ordinary.

    Before it stands twice the log of how much likelier.

    Parameters
    ----------
    least : below what that says nothing, as something else explains the residuals better
    """
    graph, fit, given = examined.instance.graph, examined.fit, examined.first
    if fit is None or given is None or graph.has_couplings:
        return None
    uneven = given.unevenness
    if not fit.is_unusual and fit.freedom > PLENTY and uneven < EVENLY:
        return None
    if (likeliest := _likeliest(examined, given, max(least, MORE))) is None:
        return None
    meaning, found = likeliest
    with suppress(CertPGOError, np.linalg.LinAlgError):
        if (settled := _settled(examined, meaning, found)) is not None:
            gain, after = given.surprise - settled.surprise, settled.fit
            if not after.is_unusual and gain > max(least, MORE) and settled.unevenness < EVEN:
                return gain, _finding(meaning, fit, after, uneven)
    return None


def _finding(meaning: Meaning, fit: Fit, after: Fit, uneven: float) -> Finding:
    costs = f"so read chi^2 is {after}, as it stands {fit}"
    offs = (abs(math.log10(one.chi2 / one.freedom)) for one in (fit, after))
    strength = WEAK + max(next(offs) - next(offs), math.log10(max(uneven, 1.0)) - 0.5, 0.0)
    if meaning.kind == "quaternion-information":
        strength = WEAK
    said = f"its information matrices {meaning.said}: {costs}"
    return Finding(meaning.kind, said, meaning.next, after.chi2, fit.chi2, strength)


def either(meaning: Finding, noise: Sequence[Finding]) -> Finding:
    """A meaning and misstated noise that explain residuals about as well."""
    said = "; or ".join([meaning.said, *(one.said for one in noise)])
    next = "; or ".join([meaning.next, *(one.next for one in noise)])
    return replace(
        meaning,
        said=f"{said}; residuals do not tell which",
        next=f"see which numbers the sensor states: {next}",
        strength=max(meaning.strength, *(one.strength for one in noise)),
    )


# --- Which is likeliest ---------------------------------------------------------------------------


def _likeliest(examined: Examined, given: Study, gain: float) -> tuple[Meaning, Study] | None:
    """The meaning that gains most by the fit to first order, with that; None if none gains more."""
    screened = []
    for meaning in meanings(examined):
        examined.trying(meaning.kind)
        change = _Change.of(examined, given, meaning)
        if (most := change.gain_at_most) > gain:
            screened.append((most, meaning, change))
    best = None
    for most, meaning, change in sorted(screened, key=lambda one: -one[0]):
        if not most > gain:
            break
        found = given.under(change.weights)
        if found is None or not _is_plausible(found.fit.chi2, found.fit.freedom):
            continue
        if (gained := given.surprise - found.surprise) > gain:
            gain, best = gained, (meaning, found)
    return best


def meanings(examined: Examined) -> Iterator[Meaning]:
    """What the numbers may be."""
    graph, fit, cost = examined.instance.graph, examined.fit, examined.problem.cost_name
    if fit is not None and fit.is_unusual:
        yield from OTHERS
    if graph.information is None:
        return
    yield from orders(graph.d)
    if graph.d == 3 and cost != CHORDAL:
        yield OF_QUATERNIONS[COSTS[cost].rotation_information]


@dataclass(frozen=True, eq=False)
class _Change:
    """Other weights at a fit, and what these may gain.

    Attributes
    ----------
    index : (m,) edges of one number have the same weights, before and after
    matrices : (m, p, p) information of the edges after
    """

    given: Study
    index: IntArray
    matrices: FloatArray

    @classmethod
    def of(cls, examined: Examined, given: Study, meaning: Meaning) -> Self:
        """With the numbers of another meaning."""
        information = _meant(examined, meaning)
        if given.problem is examined.problem:
            return cls(given, information.index, information.matrices)
        kappa, tau = _weights(examined, meaning, information)
        stated = Information.isotropic(kappa, tau, given.problem.d, about="quaternion")
        return cls(given, information.index, stated.matrices)

    @property
    def weights(self) -> list[FloatArray]:
        """Of each part (k, r, r)."""
        return [self._after(rows, term) for rows, term in self.given.problem.terms]

    def _after(self, rows: IntArray, term: Term) -> FloatArray:
        is_changed = rows[0] < len(self.matrices)
        return term.informed(self.matrices[rows]) if is_changed else term.weights

    @property
    def gain_at_most(self) -> float:
        """Twice the log of how much likelier they may be; nothing if chi^2 is not ordinary then.

        With weights C^T D C for those given C^T C: log det H is convex in log D (Cauchy and Binet),
        so nowhere below its tangent, along which it changes by the traces of P log D. chi^2 is at
        most that of the given residuals e, and at least (e^T e)^2 / e^T D^-1 e, as no motion
        changes e^T A x = 0.
        """
        fit, parts = self.given.fit, []
        for (rows, term), part, G in zip(
            self.given.problem.terms, self.given.parts, self.given.remaining, strict=True
        ):
            own = self.index[rows] if rows[0] < len(self.index) else np.arange(len(rows))
            _, first, index = np.unique(own, return_index=True, return_inverse=True)
            before, after = term.weights[first], self._after(rows, term)[first]
            stated = np.einsum("kaa->ka", before) > 0.0
            if (np.einsum("kaa->ka", after)[stated] <= 0.0).any():
                return -math.inf
            parts.append((index.reshape(-1), before, after, part, G))
        most = sum(_squared(part.errors, index, after) for index, _, after, part, _ in parts)
        if most < fit.freedom and not _is_plausible(most, fit.freedom):
            return -math.inf
        inverse = logs = 0.0
        for index, before, after, part, G in parts:
            root, _ = roots(before)
            try:
                back = np.linalg.inv(root)
            except np.linalg.LinAlgError:
                return math.inf  # some directions are not measured
            D, U = np.linalg.eigh(np.swapaxes(back, 1, 2) @ after @ back)
            if not (D > 0.0).all():
                return -math.inf
            inverse += _squared(part.residuals, index, (U / D[:, None, :]) @ np.swapaxes(U, 1, 2))
            left = scatter_sum(index, G, len(D))
            logs += float((np.log(D) * np.einsum("kai,kab,kbi->ki", U, left, U)).sum())
        least = fit.chi2**2 / inverse
        if least > fit.freedom and not _is_plausible(least, fit.freedom):
            return -math.inf
        return fit.chi2 - least + logs


def _squared(e: FloatArray, index: IntArray, W: FloatArray) -> float:
    """The sum of e^T W e, for the W (l, r, r) of each."""
    squares = scatter_sum(index, e[:, :, None] * e[:, None, :], len(W))
    return float((W * squares).sum())


def _is_plausible(chi2: float, freedom: int) -> bool:
    """Whether chi^2 is ordinary, or may be after all where it is known to first order."""
    off = LITTLE if freedom > PLENTY else MUCH
    return 1.0 / off < chi2 / freedom < off or not Fit(chi2, freedom).is_unusual


def _settled(examined: Examined, meaning: Meaning, found: Study) -> Study | None:
    """The fit with another meaning, which is known to first order."""
    instance = replace(examined.instance, graph=meant(examined, meaning))
    problem = studied_problem(objective_of(instance, examined.problem.cost_name))
    if problem is None:
        return None
    cost = problem.cost(found.estimate)
    if abs(cost - found.fit.chi2) < SAME * cost:
        return found
    return study(problem, found.estimate, examined.anchor)


# --- Their matrices -------------------------------------------------------------------------------


def meant(examined: Examined, meaning: Meaning) -> Graph:
    """The measurements with matrices of another meaning."""
    graph, information = examined.instance.graph, _meant(examined, meaning)
    kappa, tau = _weights(examined, meaning, information)
    kept = information if graph.information is not None else None
    return replace(graph, kappa=kappa, tau=tau, information=kept)


def _meant(examined: Examined, meaning: Meaning) -> Information:
    """The matrices with another meaning; those of positions alone have no other order."""
    graph = examined.instance.graph
    if (given := graph.information) is None:
        both = np.stack([graph.kappa, graph.tau], axis=1)
        pairs, index = np.unique(both, axis=0, return_inverse=True)
        kappa, tau = pairs.T
        given = Information.isotropic(kappa, tau, graph.d)[index.reshape(-1)]
    read = meaning.read(given.distinct)
    read = 0.5 * (read + np.swapaxes(read, 1, 2))
    rows = _is_read(examined, meaning)
    if rows.all():
        return replace(given, distinct=read)
    index = np.where(rows, len(read) + given.index, given.index)
    return replace(given, distinct=np.concatenate([given.distinct, read]), index=index)


def _is_read(examined: Examined, meaning: Meaning) -> BoolArray:
    """(m,) whose matrices have another meaning."""
    return examined.instance.graph.is_measured & (examined.whole | (meaning in OTHERS))


def _weights(
    examined: Examined, meaning: Meaning, information: Information
) -> tuple[FloatArray, FloatArray]:
    """(m,) kappa and tau of information matrices, as files are read."""
    graph, d, means = examined.instance.graph, examined.instance.graph.d, []
    M = information.distinct
    for block in (M[:, d:, d:], M[:, :d, :d]):
        stated = np.einsum("kaa->ka", block) != 0.0
        variances = np.einsum("kaa->k", inverses(block))
        known = variances > 0.0
        mean = np.where(known, stated.sum(axis=1) / np.where(known, variances, 1.0), 0.0)
        means.append(mean[information.index])
    unit = 1.0 if d == 2 else 0.5 if information.about == "tangent" else 0.125
    rows = _is_read(examined, meaning)
    return (
        np.where(rows & graph.measures_rotation, unit * means[0], graph.kappa),
        np.where(rows & graph.measures_translation, means[1], graph.tau),
    )

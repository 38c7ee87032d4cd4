"""What the numbers after measured poses may be, if they are not information matrices as read."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.meanings import OF_QUATERNIONS, OTHERS, Meaning, orders
from certpgo.diagnosis.study import Study, studied_problem, study
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph
from certpgo.graph.information import Information
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.choose_cost import Certifiable, objective_of
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.residuals import NONE
from certpgo.objective.sum import Sum
from certpgo.solve.fit import Fit

#: Ratio of squares per number, of translations and rotations, that is even.
EVEN = 4.0
#: Degrees of freedom from which ordinary weights are this even, and no other meaning is tried.
PLENTY, EVENLY = 1000, 1.3
#: Ratio of chi^2 and degrees of freedom from which no fit to other weights is tried, if it is too
#: small at the given one, and if it is too large.
TOO_SMALL, TOO_LARGE = 0.1, 1e5
#: What chi^2 may be off by to first order, with plenty of degrees of freedom, and with few.
LITTLE, MUCH = 1.05, 2.0
#: Twice the logarithm of the ratio of likelihoods from which a meaning is by far the better one.
MORE = 16.0
#: The same of how much rarer other meanings are than misstated noise, before anything is measured.
RARER = 8.0
#: Strength of a factor of rotations.
WEAK = 0.3


def other_meaning(examined: Examined) -> tuple[float, Finding] | None:
    """The meaning that is by far likelier than the given one, and with which chi^2 is ordinary.

    Before it stands twice the log of how much likelier.
    """
    graph, fit, given = examined.instance.graph, examined.fit, examined.first
    if fit is None or given is None or graph.has_couplings:
        return None
    uneven = given.unevenness
    if not fit.is_unusual and fit.freedom > PLENTY and uneven < EVENLY:
        return None
    best: tuple[float, Meaning, Fit] | None = None
    for meaning, near in _likeliest(examined, given):
        with suppress(CertPGOError, np.linalg.LinAlgError):
            instance = replace(examined.instance, graph=meant(examined, meaning))
            posed = objective_of(instance, examined.problem.cost_name)
            here = posed.cost(near) / fit.freedom
            if not TOO_SMALL < here < TOO_LARGE:
                continue  # a fit to it costs less
            if (found := _studied(examined, posed, near)) is None:
                continue
            gain, after = given.surprise - found.surprise, found.fit
            if after.is_unusual or not gain > (MORE if best is None else best[0]):
                continue
            if found.unevenness < EVEN:
                best = gain, meaning, after
    if best is None:
        return None
    gain, meaning, after = best
    costs = f"so read chi^2 is {after}, as it stands {fit}"
    offs = (abs(math.log10(one.chi2 / one.freedom)) for one in (fit, after))
    strength = WEAK + max(next(offs) - next(offs), math.log10(max(uneven, 1.0)) - 0.5, 0.0)
    if meaning.kind == "quaternion-information":
        strength = WEAK
    said = f"its information matrices {meaning.said}: {costs}"
    return gain, Finding(meaning.kind, said, meaning.next, after.chi2, fit.chi2, strength)


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


def _likeliest(examined: Examined, given: Study) -> Iterator[tuple[Meaning, Estimate]]:
    """The likeliest meaning by the fit to first order, with that; and those without."""
    best: tuple[float, Meaning, Estimate] | None = None
    off = LITTLE if given.fit.freedom > PLENTY else MUCH
    for meaning in meanings(examined):
        examined.trying(meaning.kind)
        if len(given.parts) > 1 or not isinstance(given.problem.terms[0].term, EdgeCost):
            yield meaning, examined.answer.estimate
        elif (weights := _edge_weights(examined, given, meaning)) is not None:
            found = given.under(weights=[weights])
            if found is None:
                continue
            if found.fit.is_unusual and not 1.0 / off < found.fit.ratio**2 < off:
                continue
            gain = given.surprise - found.surprise
            if gain > (0.0 if best is None else best[0]):
                best = gain, meaning, found.estimate
    if best is not None:
        yield best[1:]


def _edge_weights(examined: Examined, given: Study, meaning: Meaning) -> FloatArray | None:
    """(m, p, p) weights with another meaning; None if these are none, or far from the given fit."""
    graph, (part,) = examined.instance.graph, given.parts
    information = _meant(examined, meaning)
    values = np.linalg.eigvalsh(information.distinct)
    if (values[:, 0] < -NONE * values[:, -1]).any():
        return None
    if given.problem is examined.problem:
        weights = information.matrices
    else:
        kappa, tau = _weights(examined, meaning, information)
        weights = Information.isotropic(kappa, tau, graph.d, about="quaternion").matrices
    e = part.errors
    chi2 = float((e * (weights @ e[:, :, None])[:, :, 0]).sum())
    return weights if TOO_SMALL < chi2 / given.fit.freedom < TOO_LARGE else None


def meanings(examined: Examined) -> Iterator[Meaning]:
    """What the numbers may be."""
    problem, graph, fit = examined.problem, examined.instance.graph, examined.fit
    if fit is not None and fit.is_unusual:
        yield from OTHERS
    if graph.information is None:
        return
    yield from orders(graph.d)
    if graph.d == 3 and isinstance(problem, Sum):
        yield OF_QUATERNIONS[problem.between.rotation_information]


def _studied(examined: Examined, posed: Certifiable, near: Estimate) -> Study | None:
    """Measurements of the same poses at their fit, which is near an estimate."""
    problem = studied_problem(posed)
    return None if problem is None else study(problem, near, examined.anchor)


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
        variances = np.einsum("kaa->k", np.linalg.pinv(block, hermitian=True))
        known = variances > 0.0
        mean = np.where(known, stated.sum(axis=1) / np.where(known, variances, 1.0), 0.0)
        means.append(mean[information.index])
    unit = 1.0 if d == 2 else 0.5 if information.about == "tangent" else 0.125
    rows = _is_read(examined, meaning)
    return (
        np.where(rows & graph.measures_rotation, unit * means[0], graph.kappa),
        np.where(rows & graph.measures_translation, means[1], graph.tau),
    )

"""How well an estimate fits measurements that state their noise: chi^2, and how much is usual.

chi^2 is the sum of squared residuals, each over its variance. For noise as stated, its mean at the
best estimate is the degrees of freedom: numbers measured, less those that they determine. The costs
of g2o and GTSAM are chi^2 themselves. The terms of F are, for a small residual angle theta,

    kappa |R_j - R_i R_ij|^2 = 2 kappa theta^2,        tau |t_j - t_i - R_i t_ij|^2,

of means 2 kappa tr(Omega_R^-1) and tau tr(Omega_t^-1). As tau = d / tr(Omega_t^-1), the second is
d. In space kappa = 3 / (2 tr(Omega_R^-1)), and the first is 3. In the plane kappa = Omega_R, and it
is 2 for the one axis that is measured: it is halved here.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Instance
from certpgo.graph.held import displaced
from certpgo.graph.information import Information
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, Judged
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.residuals import NONE
from certpgo.objective.sum import Sum
from certpgo.objective.term import Term
from certpgo.optimize.unobservable import MOST, undetermined

#: Probability that chi^2 of the stated noise is further out, on one side.
RARE = 1e-6
#: chi^2 per degree of freedom beyond a factor of `FAR_OFF` of 1 is compared with that of square
#: roots of information, which is taken for right within a factor of `NEAR`.
FAR_OFF, NEAR = 3.0, 2.0
#: From and to which chi^2 is printed as a whole number.
WHOLE = (1e4, 1e12)


@dataclass(frozen=True)
class Fit:
    """chi^2 of an estimate, beside what is usual for noise as the measurements state it.

    Attributes
    ----------
    chi2 : squared residuals over their variances
    freedom : degrees of freedom, the mean of chi^2 for the best estimate
    spread : variance over that of a chi^2 variable; 1 unless weights average over directions
    as_roots : chi^2 at this estimate if the numbers of the file were square roots of information;
        None if that is not known
    of : the estimate, in words, where it is not the one that is asked about

    Examples
    --------
    >>> print(Fit(6252.0, 24))
    6252 at 24 degrees of freedom
    >>> Fit(30.0, 24).warning
    ''
    >>> Fit(90342.3, 1050).warning.partition(";")[0]
    'chi^2 is 90342 at 1050 degrees of freedom: residuals are 9.28 times the stated noise'
    """

    chi2: float
    freedom: int
    spread: float = 1.0
    as_roots: float | None = None
    of: str = ""

    def __str__(self) -> str:
        chi2 = f"{self.chi2:.0f}" if WHOLE[0] <= self.chi2 < WHOLE[1] else f"{self.chi2:.4g}"
        return f"{chi2} at {counted(self.freedom, 'degree{s}')} of freedom"

    @property
    def ratio(self) -> float:
        """Size of the residuals over the standard deviations that are stated, root mean square."""
        return math.sqrt(self.chi2 / self.freedom)

    @property
    def is_unusually_large(self) -> bool:
        """Whether the stated noise hardly ever gives as much."""
        return self._tails[1] < RARE

    @property
    def is_unusual(self) -> bool:
        """Whether it hardly ever gives as much, or as little."""
        return min(self._tails) < RARE

    @property
    def warning(self) -> str:
        """What is unusual, in a sentence; or empty."""
        which = f"chi^2 of {self.of}" if self.of else "chi^2"
        said = f"{which} is {self}: residuals are {self.ratio:.3g} times the stated noise"
        if self._fits_as_roots:
            return (
                f"{said}; the file's numbers may be square roots of information, with which it is "
                f"about {self.as_roots:.4g}: see --weights-are sqrt-information"
            )
        if self.is_unusually_large:
            return (
                f"{said}; measurements may be wrong, or the stated noise too small: no verdict "
                "excludes it"
            )
        if self.is_unusual:
            return (
                f"{said}, which is probably too large; verdicts do not depend on its scale, "
                "covariances do"
            )
        return ""

    @property
    def _fits_as_roots(self) -> bool:
        """Whether chi^2 is far from usual, and near it with square roots of information."""
        if self.as_roots is None or not (self.chi2 > 0.0 and self.as_roots > 0.0):
            return False
        off, left = (abs(math.log(chi2 / self.freedom)) for chi2 in (self.chi2, self.as_roots))
        return self.is_unusual and off > math.log(FAR_OFF) and left < math.log(NEAR)

    @property
    def _tails(self) -> tuple[float, float]:
        """Probabilities of a chi^2 that is at most this, and at least, or bounds below `RARE`.

        Where it is spread, of the gamma law with its mean and variance.
        """
        half, x = 0.5 * self.freedom / self.spread, 0.5 * self.chi2 / self.spread
        if 0.0 < x < math.inf:
            # Chernoff's bound, before SciPy's functions are loaded, which takes long.
            most = math.exp(min(half - x + half * math.log(x / half), 0.0))
            if most < RARE:
                return (most, 1.0) if x < half else (1.0, most)
        from scipy import special

        return float(special.gammainc(half, x)), float(special.gammaincc(half, x))


def fit_of(
    instance: Instance,
    problem: Judged,
    estimate: Estimate,
    weights: FloatArray | None = None,
) -> Fit | None:
    """The fit of an estimate to an instance's measurements.

    Parameters
    ----------
    problem : that the estimate is judged by
    weights : (m,) final factors of a robust method, whose problem has the edges that are not at 0

    Returns
    -------
    None where the source does not state the noise, of nodes of unknown scale, under a robust
    kernel, where held nodes are moved, where a robust method changed weights, where nothing is
    measured twice, or where numbers are beyond the range of doubles.
    """
    if not instance.states_noise or problem.takes_scales or problem.kernel is not None:
        return None
    if displaced(instance, estimate):
        return None
    if len(problem.rejected):
        kept = np.ones(problem.graph.num_edges)
        kept[problem.rejected] = 0.0
        return fit_of(instance, cast("Judged", problem.kept), estimate, kept)
    posed = cast("Quadratic | Sum", problem)
    if weights is not None:
        if not np.isin(weights, (0.0, 1.0)).all():
            return None
        instance = instance.with_edges(weights > 0.0)
    mahalanobis = instance.options.get("weights") == "mahalanobis"
    with np.errstate(all="ignore"), suppress(NumericalError, np.linalg.LinAlgError):
        fit = goodness_of_fit(posed, estimate, instance.graph.information, mahalanobis=mahalanobis)
        if fit is None or mahalanobis or "weights_are" in instance.options:
            return fit
        return replace(fit, as_roots=_as_roots(posed, estimate))
    return None


def _as_roots(problem: Quadratic | Sum, estimate: Estimate) -> float | None:
    """chi^2 if information were its square root; under F for multiples of the identity alone."""
    if problem.cost_name != CHORDAL:
        own = cast("Sum", problem)
        return math.fsum(_as_root(term, estimate) for _, term in own.terms)
    graph = problem.measured
    if not graph.has_positions or graph.blocks or graph.is_general:
        return None
    terms, _ = squares(problem, estimate)
    kappa = graph.kappa * (2.0 if problem.d == 3 else 1.0)
    return float((terms * np.stack([graph.tau, kappa], axis=1)).sum())


def _as_root(term: Term, estimate: Estimate) -> float:
    e = term.residuals(*term.relative(estimate))
    return float((np.einsum("mab,mb->ma", np.triu(term.weights), e) ** 2).sum())


def goodness_of_fit(
    problem: Quadratic | Sum,
    estimate: Estimate,
    information: Information | None = None,
    *,
    mahalanobis: bool = False,
) -> Fit | None:
    """The fit of an estimate to measurements whose weights state their noise.

    Parameters
    ----------
    information : of the edges, where kappa and tau average it
    mahalanobis : whether the rotational weights are those of `certpgo.read` with that name

    Returns
    -------
    None where the measurements leave no degree of freedom, or a free motion that is not counted.

    Examples
    --------
    A square of four poses, each step measured with a variance of 0.01 in each number:

    >>> import certpgo
    >>> from certpgo import PoseGraph, Quadratic, RotationGraph
    >>> turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    >>> rotation = RotationGraph(4, edges, np.array([turn] * 4), np.full(4, 100.0))
    >>> steps = np.array([[1.1, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0]])
    >>> graph = PoseGraph(rotation, steps, np.full(4, 100.0))
    >>> print(goodness_of_fit(Quadratic(graph), certpgo.solve(graph).estimate))
    0.2099 at 3 degrees of freedom
    """
    if problem.cost_name != CHORDAL:
        weights = [term.weights for _, term in cast("Sum", problem).terms]
        ranks = np.concatenate([_ranks(W) for W in weights])
        law = _Law(problem.cost(estimate), int(ranks.sum()), 1.0)
        partial = bool((ranks < max(W.shape[1] for W in weights)).any())
    else:
        law = _law(problem, estimate, information, mahalanobis)
        partial = problem.graph.is_general
    free = _determined(problem, estimate, partial)
    if free is None or law.numbers <= free or not np.isfinite(law.chi2):
        return None
    return Fit(law.chi2, law.numbers - free, law.spread)


@dataclass(frozen=True)
class _Law:
    """chi^2, how many numbers are measured, and the spread."""

    chi2: float
    numbers: int
    spread: float


def _law(
    problem: Quadratic | Sum,
    estimate: Estimate,
    information: Information | None,
    mahalanobis: bool,
) -> _Law:
    """Of the terms of F, each over its mean per number."""
    terms, numbers = squares(problem, estimate, mahalanobis=mahalanobis)
    if information is None or mahalanobis:
        return _Law(float(terms.sum()), int(numbers.sum()), 1.0)
    others = np.ones((len(terms) - len(information.index), 2))
    stretch, spread = (
        np.concatenate([of[information.index], others]) for of in _averages(information, problem.d)
    )
    total = int(numbers.sum())
    return _Law(float((terms / stretch).sum()), total, float((numbers * spread).sum()) / total)


def squares(
    problem: Quadratic | Sum, estimate: Estimate, *, mahalanobis: bool = False
) -> tuple[FloatArray, IntArray]:
    """(m, 2) squares of translations and rotations over their variances, and numbers measured.

    The variances are those that kappa and tau state. Measurements of other kinds come last, as
    translations.
    """
    form, m = problem.chordal, problem.measured.num_edges
    turning = form.rotation.edge_costs(estimate.with_translations(None))
    turned, moved = problem.numbers
    if not mahalanobis:
        turning = turning / problem.double
    moving = np.zeros_like(turning)
    if form.has_positions:
        moving = form.graph.tau * (form.translation_residuals(estimate) ** 2).sum(axis=1)
        moving[m:] = problem.edge_costs(estimate)[m:]
    return np.stack([moving, turning], axis=1), np.stack([moved, turned], axis=1)


def _averages(information: Information, d: int) -> tuple[FloatArray, FloatArray]:
    """(k, 2) means per number of the terms that average matrices, and their spreads.

    Of translations, then rotations. tau and kappa know the blocks of a matrix; what the numbers
    vary by is in the blocks of its inverse, which are larger where the two are correlated.
    """
    whole = information.distinct
    inverse = np.linalg.pinv(whole, hermitian=True)
    definite = np.linalg.eigvalsh(whole)[:, 0] > 0.0
    stretch, spread = np.ones((2, len(whole), 2))
    for k, block in enumerate((slice(0, d), slice(d, None))):
        alone = np.linalg.pinv(whole[:, block, block], hermitian=True)
        varied = np.where(definite[:, None, None], inverse[:, block, block], alone)
        stated, total = (np.trace(A, axis1=1, axis2=2) for A in (alone, varied))
        known = total > 0.0
        stretch[known, k] = (total / np.where(known, stated, 1.0))[known]
        squared = np.einsum("kab,kba->k", varied, varied) * varied.shape[1]
        spread[known, k] = (squared / np.where(known, total, 1.0) ** 2)[known]
    return stretch, spread


def _ranks(information: FloatArray) -> IntArray:
    """(m,) ranks of semidefinite matrices (m, p, p), whatever the units of their entries."""
    scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    unit = np.where(scale > 0.0, scale, 1.0)
    scaled = information / (unit[:, :, None] * unit[:, None, :])
    return np.asarray((np.linalg.eigvalsh(scaled) > NONE).sum(axis=1))


def _determined(problem: Quadratic | Sum, estimate: Estimate, partial: bool) -> int | None:
    """How many numbers the measurements determine, beside the world's frame; None if not known.

    Where some are ``partial``, they may leave motions open.
    """
    layout = problem.tangent_layout
    anchor = layout.still()
    found = undetermined(problem, estimate, anchor) if partial else None
    left_open = 0 if found is None else found.motions
    return None if left_open == MOST else layout.size - int(layout.sizes[anchor]) - left_open

"""What size of error a loop closure could hide: minimal detectable errors, as Baarda defined them.

A measurement with information W is tested against its prediction by all others. For the covariance
P of its relative pose, itself included, their difference has the covariance (W - W P W)^-1: an
error x moves chi^2 of that by x^T (W - W P W) x. The test is at 1 - 0.01 / m, as that which rejects
measurements; an error is detectable if it is seen with probability 0.8, whatever its direction.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import special

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.study import Study
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.bridges import bridges
from certpgo.graph.phrases import counted
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.chi_squared import FALSE_ALARMS
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.marginals import Marginals
from certpgo.solve.accuracy_wording import ends
from certpgo.solve.fit import goodness_of_fit

#: Probability with which a detectable error is seen.
POWER = 0.8
#: A closure is weak if it hides errors of so many times the median.
WEAK = 3.0
#: Part of a measurement's information below which others say nothing about it.
NOTHING = 1e-9
#: Noise, over that which weights say, of measurements that fit to rounding.
EXACT = 1e-6


@dataclass(frozen=True, eq=False)
class Detectable:
    """The errors of loop closures that would be seen.

    Attributes
    ----------
    closures : (k,) indices of the loop closures
    metres : (k,) the least error of a translation that is seen whatever its direction, infinite
        where nothing checks it; None of rotations alone
    degrees : (k,) the same of a rotation
    noise : standard deviation of the noise over that which the weights state
    """

    closures: IntArray
    metres: FloatArray | None
    degrees: FloatArray
    noise: float

    @property
    def weak(self) -> BoolArray:
        """(k,) which hide errors of far more than the usual size."""
        found = _far(self.degrees)
        return found if self.metres is None else found | _far(self.metres)

    def in_words(self, instance: Instance) -> str:
        """What would have been seen, and in which closures less; nodes are named by ids."""
        if not len(self.closures):
            return "no error would have been seen: no loop closure checks the measurements"
        weak, count = self.weak, len(self.closures)
        seen = f"would have been seen with probability {POWER:g}"
        if weak.all():
            said = f"no error of {counted(count, 'closure{s}')} {seen}: nothing checks them"
        else:
            of = f"any of {count} closures" if count > 1 else "the only closure"
            said = f"an error of {self._size(~weak)} in {of} {seen}"
            if weak.any():
                sizes = self.degrees if self.metres is None else self.metres
                worst = int(np.argmax(np.where(weak, sizes, -1.0)))
                named = ends(instance, *instance.pairs[self.closures[worst]].tolist())
                least = self._size(np.arange(count) == worst)
                said += f", but for {int(weak.sum())} (weakest: {named}, {least})"
        if self.noise == 1.0:
            return said
        return f"{said}; for noise of {self.noise:.3g} times what the weights say"

    def _size(self, chosen: BoolArray) -> str:
        """The largest of some sizes in words."""
        lengths = [] if self.metres is None else [(float(self.metres[chosen].max()), " m")]
        sizes = [*lengths, (float(self.degrees[chosen].max()), " degrees")]
        known = [f"{size:.2g}{unit}" for size, unit in sizes if size < _most(unit)]
        return " or ".join(known) or "any size"


def _most(unit: str) -> float:
    """From where a size says nothing."""
    return 180.0 if unit == " degrees" else math.inf


def _far(sizes: FloatArray) -> BoolArray:
    known = sizes[np.isfinite(sizes)]
    return sizes > WEAK * (np.median(known) if len(known) else 0.0)


def detectable(examined: Examined) -> Detectable | None:
    """The errors that would be seen in each loop closure; None where covariances do not exist."""
    instance, answer = examined.instance, examined.answer
    graph = instance.graph
    if graph.has_scales or answer.undetermined is not None:
        return None
    loops = np.flatnonzero(examined.whole & ~examined.steps)
    loops = loops[~_are_bridges(graph, loops)]  # nothing checks these
    if not len(loops):
        checks = bool(graph.blocks) or graph.num_measurements >= graph.num_nodes
        return None if checks else Detectable(loops, None, np.zeros(0), 1.0)
    noise = noise_of(examined)
    if noise < EXACT:
        return None
    with suppress(NumericalError, np.linalg.LinAlgError):
        fit, marginals = examined.first, examined.answer.marginals
        of_loops = by_marginals(marginals, loops) if fit is None else informations(fit, loops)
        return sizes_of(graph, loops, *of_loops, noise)
    return None


def noise_of(examined: Examined) -> float:
    """The noise over the stated one: as residuals say, where that is larger or none is stated."""
    fit = examined.fit
    if fit is not None:
        return max(fit.ratio, 1.0) if fit.warning else 1.0
    if examined.instance.states_noise:
        return 1.0
    return noise_at(examined.problem, examined.answer.estimate)


def noise_at(problem: Certifiable, estimate: Estimate) -> float:
    """The noise over that which weights say, by the residuals of a best estimate."""
    found = goodness_of_fit(problem, estimate)
    return found.ratio if found is not None and found.chi2 > 0.0 else 1.0


def sizes_of(
    graph: Graph, chosen: IntArray, W: FloatArray, checked: FloatArray, noise: float = 1.0
) -> Detectable:
    """The detectable errors of some measurements of a pose in the frame of another.

    Parameters
    ----------
    chosen : (k,) their indices
    W, checked : as `informations`
    noise : over that which the weights state
    """
    p, d = W.shape[1], graph.d
    level = special.chdtri(p, FALSE_ALARMS / graph.num_measurements)
    seen = noise**2 * float(special.chndtrinc(level, p, 1.0 - POWER))
    nothing = _are_bridges(graph, chosen)
    moved = p - so.tangent_dim(d)
    turned = _least(W, checked, slice(moved, p), nothing, seen)
    metres = _least(W, checked, slice(0, moved), nothing, seen) if moved else None
    return Detectable(chosen, metres, np.degrees(turned), noise)


def informations(fit: Study, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
    """Two (k, b, b): the information W of some measurements, and what is checked of it, W - W P W.

    In the tangent of the second pose: translations in metres, then turns in radians. With residuals
    that a motion of that pose moves by A, W = A^T A, and a fit leaves A^T (I - P) A of it.
    """
    d, b = fit.problem.d, fit.parts[0].slopes.shape[2] // 2
    both = np.zeros((2, len(fit.edges), b, b))
    for part, left in zip(fit.parts, fit.remaining, strict=True):
        A = part.slopes[:, :, b:].copy()
        A[:, :, :d] = A[:, :, :d] @ fit.estimate.rotations[fit.edges[part.rows, 1]]
        back = np.swapaxes(A, 1, 2)
        both[:, part.rows] = back @ A, back @ left @ A
    return both[0][chosen], both[1][chosen]


def by_marginals(marginals: Marginals, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
    """The same where residuals are not studied, such as those of rotations alone."""
    problem = cast("Certifiable", marginals.problem)
    pairs = problem.chordal.graph.edges[chosen]
    W = information_of(problem, marginals, chosen, pairs)
    return W, W - W @ marginals.relatives(pairs) @ W


def information_of(
    problem: Certifiable, marginals: Marginals, chosen: IntArray, pairs: IntArray
) -> FloatArray:
    """(k, b, b) information of some measurements about the second pose of a pair in the first.

    Parameters
    ----------
    pairs : (k, 2) their nodes, in either order
    """
    _, upper = problem.gauss_newton_blocks(marginals.estimate)
    upper, back = upper[chosen], problem.chordal.graph.edges[chosen, 0] != pairs[:, 0]
    upper = np.where(back[:, None, None], np.swapaxes(upper, 1, 2), upper)
    first, second = marginals.motions(pairs)
    W = np.linalg.solve(np.swapaxes(first, 1, 2), upper) @ np.linalg.inv(second)
    return np.asarray(0.5 * (W + np.swapaxes(W, 1, 2)))


def _least(
    W: FloatArray, checked: FloatArray, part: slice, nothing: BoolArray, seen: float
) -> FloatArray:
    """(k,) the least error that is seen in every direction; infinite where one is not checked."""
    weakest = np.linalg.eigvalsh(checked[:, part, part])[:, 0]
    known = (weakest > NOTHING * np.linalg.eigvalsh(W[:, part, part])[:, -1]) & ~nothing
    sizes = np.sqrt(seen / np.where(known, weakest, 1.0))
    return np.asarray(np.where(known, sizes, np.inf))


def _are_bridges(graph: Graph, chosen: IntArray) -> BoolArray:
    """(k,) which of some measurements nothing else checks."""
    alone, place = bridges(graph), np.array([graph.num_nodes, 1])
    return np.isin(np.sort(graph.edges[chosen], axis=1) @ place, alone @ place)

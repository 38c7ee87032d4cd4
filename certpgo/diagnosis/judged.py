"""Which measurements are wrong: those that are too far from what the others say."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.study import Study, study
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.solve.fit import Fit
from certpgo.solve.outliers import select

#: Probability that noise makes any right measurement look wrong.
LEVEL = 1e-4
#: Multiple of the noise's variance from which a measurement is wrong, where noise is as stated, and
#: where it is estimated: real residuals have heavier tails than normal ones.
WIDE, WIDER = 1.5, 4.0
#: Nodes up to which a robust fit is tried at the least suspicion, and rounds until it settles.
FEW, SETTLING = 1000, 3
#: Measurements that are left out one by one, before a robust fit is tried; and surprise of two, one
#: over the other, that may both be the wrong one.
LEFT_OUT, AS_LIKELY = 3, 0.98
#: Share of the largest surprise from which another one is the same but for rounding.
SAME = 0.999
#: Ratio of variances up to which noise is as stated, and from which it is seldom misstated.
STATED, HUGE = 1.5, 50.0
#: What is left out explains a map whose chi^2 is then as stated, or at most this share.
EXPLAINED = 0.5


@dataclass(frozen=True, eq=False)
class Judged:
    """Which measurements are wrong, and the fit to the others.

    Attributes
    ----------
    wrong : (m,) flags
    fit : of all others
    scales : (m,) variance of the noise over that stated, at least 1
    """

    wrong: BoolArray
    fit: Study
    scales: FloatArray

    @property
    def left(self) -> float:
        """chi^2 of the others."""
        return float(self.fit.squares[~self.wrong].sum())

    @property
    def cost(self) -> float:
        """The same, and what leaving the wrong ones out costs."""
        return self.left + float((self.scales * limit(self.fit.numbers))[self.wrong].sum())

    def explains(self, first: float) -> bool:
        """Whether little else is wrong with a map whose chi^2 is ``first``."""
        known = self.fit.fit.freedom - int(self.fit.numbers[self.wrong & self.fit.counts].sum())
        rest = Fit(self.left, max(known, 1))
        return self.left < EXPLAINED * first or not rest.is_unusually_large

    def gain(self, first: float) -> float:
        """How much less that is than chi^2 of all."""
        return first - self.cost if self.wrong.any() else 0.0

    @property
    def rows(self) -> IntArray:
        """(k,) the wrong measurements, the most surprising first."""
        rows = np.flatnonzero(self.wrong)
        return rows[np.argsort(-self.fit.surprises[rows], kind="stable")] if len(rows) else rows


def single(examined: Examined) -> Judged | None:
    """The one measurement without which chi^2 is not too large; None if there is none."""
    if examined.first is None or not (best := _judged(examined, examined.first)).wrong.any():
        return None
    with suppress(CertPGOError, np.linalg.LinAlgError):
        found = _without_few(examined, best, 1)
        return None if found is None or found.fit.fit.is_unusually_large else found
    return None


def judged(examined: Examined) -> Judged | None:
    """The wrong measurements: by their surprise at the fit to all, then at a robust one.

    None where nothing is known of residuals.
    """
    if examined.first is None:
        return None
    best = _judged(examined, examined.first)
    if not _is_suspicious(examined, best):
        return best
    with suppress(CertPGOError, np.linalg.LinAlgError):
        few = _without_few(examined, best, LEFT_OUT)
        if few is not None and not few.fit.fit.is_unusually_large:
            return few
        found = [one for one in (_robustly(examined), few) if one is not None]
        return min(found, key=lambda one: one.cost, default=best)
    return best


def _without_few(examined: Examined, at: Judged, most: int) -> Judged | None:
    """One after another left out, each the most surprising one; None if more are wrong then."""
    kept = np.ones(len(at.wrong), dtype=bool)
    for _ in range(most):
        surprises = np.where(kept, at.fit.surprises, 0.0)
        # Of two that are as likely, such as all that a node has, odometry is right.
        surprises[: len(examined.steps)][examined.steps] *= AS_LIKELY
        worst = int(np.argmax(surprises >= SAME * surprises.max()))
        kept[worst] = False
        found = _kept(examined, at.fit.estimate, kept)
        if found is None or (found.wrong == ~kept).all():
            return found
        at = found
    return None


def _robustly(examined: Examined) -> Judged | None:
    """Those that a robust fit rejects, until the choice settles."""
    chosen = select(examined.problem, fit=examined.answer.estimate, monitor=examined.monitor)
    found = _kept(examined, chosen.estimate, ~chosen.rejected)
    for _ in range(SETTLING):
        if found is None or (found.wrong == ~found.fit.counts).all():
            return found
        found = _kept(examined, found.fit.estimate, ~found.wrong)
    return None if found is None else replace(found, wrong=~found.fit.counts)


def _kept(examined: Examined, estimate: Estimate, kept: BoolArray) -> Judged | None:
    """The measurements at the fit to some of them; None where these leave nodes free."""
    if examined.studied is None:
        return None
    fit = study(examined.studied, estimate, examined.anchor, counts=kept)
    return None if fit is None else _judged(examined, fit)


def _is_suspicious(examined: Examined, first: Judged) -> bool:
    """Whether a robust fit may find wrong measurements, which a fit to all may spread and hide."""
    if first.wrong.any():
        return True
    if examined.instance.graph.num_nodes > FEW:
        return False
    # Residuals that are larger by one factor throughout are misstated noise, unless that is huge.
    fit, usual = first.fit, np.where(first.scales < HUGE, first.scales, 1.0)
    return bool((fit.surprises > usual * limit(fit.numbers)).any())


def _judged(examined: Examined, fit: Study) -> Judged:
    """Which measurements are too far from what the others say, and noise by their medians."""
    known = fit.checked > 0
    usual = 2.0 * special.gammaincinv(0.5 * np.maximum(fit.checked, 1), 0.5)
    scales = np.ones(len(known))
    for rows in examined.kinds.values():
        own = rows & known
        if own.any():
            scales[rows] = max(float(np.median(fit.surprises[own] / usual[own])), 1.0)
    wide = np.where(scales < STATED, WIDE, WIDER) * scales
    wrong = known & (fit.surprises > wide * limit(fit.checked))
    return Judged(wrong, fit, scales)


def limit(numbers: IntArray) -> FloatArray:
    """(m,) what surprises of right measurements hardly exceed."""
    tail = LEVEL / len(numbers)
    return np.asarray(2.0 * special.gammainccinv(0.5 * np.maximum(numbers, 1), tail))

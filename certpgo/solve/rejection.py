"""What is proven about the measurements that were rejected: the verdict on the truncated cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.verdict import verdict
from certpgo.certify.wording import meaning, reason_of
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.phrases import bound_shown, cost_shown
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.chi_squared import flagged_from, quantiles
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_cost import TruncatedCost, rejecting
from certpgo.optimize.monitor import Monitor, silent
from certpgo.solve import bounding
from certpgo.solve.minima import local_minimum
from certpgo.solve.settings import DEFAULT, SolveSettings


@dataclass(frozen=True, eq=False, repr=False)
class Rejection(Brief):
    """Rejected measurements, and what is proven about rejecting them.

    Attributes
    ----------
    problem : the truncated cost f_T: that of the kept measurements, and min(f_e, c_e) of each
        rejected one
    estimate : the estimate at which they are rejected
    certificate : of the estimate, about f_T; CERTIFIED means that no other estimate and no other
        choice of rejected measurements costs less
    quantile : of chi^2, that the prices c_e are
    scale : standard deviation of the noise over that stated by the weights
    numbers : (m,) what the measurements of the problem are called, as in a session; None for their
        indices
    """

    problem: TruncatedCost
    estimate: Estimate
    certificate: Certificate
    quantile: float
    scale: float = 1.0
    numbers: IntArray | None = None

    @property
    def edges(self) -> IntArray:
        """(k,) the rejected measurements, by number, ascending."""
        return self._called(self.problem.rejected)

    @property
    def prices(self) -> FloatArray:
        """(k,) their prices c_e, in units of F."""
        return self.problem.prices[self.problem.rejected]

    @property
    def prices_of_all(self) -> FloatArray:
        """(m,) what leaving any measurement out costs, by the same quantile."""
        return self.scale**2 * quantiles(self.problem.whole, self.quantile)

    @property
    def ambiguous(self) -> IntArray:
        """Rejected measurements whose prices are not proven, by number; empty if CERTIFIED."""
        return self._called(np.array(self.certificate.obstacle.ambiguous, dtype=np.intp))

    def _called(self, edges: IntArray) -> IntArray:
        return edges if self.numbers is None else self.numbers[edges]

    @property
    def verdict(self) -> Verdict:
        """The certificate's verdict."""
        return self.certificate.verdict

    @property
    def sentence(self) -> str:
        """What is proven, after the verdict."""
        said = meaning(self.certificate)
        if self.verdict is not Verdict.CERTIFIED:
            said = reason_of(self.certificate)
        return f"{self.verdict}: {said.removeprefix('Proven: ')}"

    @property
    def noise(self) -> str:
        """The noise that prices are of."""
        return (
            "noise as stated" if self.scale == 1.0 else f"{self.scale:.3g} times the stated noise"
        )

    def covers(self, certificate: Certificate) -> bool:
        """Whether the verdict stands for that about the kept measurements: both are CERTIFIED."""
        return self.verdict == certificate.verdict == Verdict.CERTIFIED

    def standing(self, certificate: Certificate) -> Certificate:
        """The certificate that stands for both: its own if it `covers` the other."""
        return self.certificate if self.covers(certificate) else certificate

    @property
    def whole(self) -> str:
        """The truncated cost in words."""
        count = len(self.edges)
        of_rejected = "the rejected one" if count == 1 else f"each of {count} rejected ones"
        return f"the kept, and {of_rejected} up to its price"

    def in_words(self, kept: Certificate | None = None) -> Iterator[tuple[str, str]]:
        """The verdict and its numbers, as names and values.

        Parameters
        ----------
        kept : about the kept measurements, if `headline` has been said of both
        """
        c, low, high = self.certificate, self.prices.min(), self.prices.max()
        each = f"{low:.4g}" if high < 1.0001 * low else f"{low:.4g} to {high:.4g}"
        if kept is None or not self.covers(kept):
            yield "rejections", self.sentence
        yield "truncated cost", f"{cost_shown(c.cost_upper)}  ({self.whole})"
        yield "", f"not below {bound_shown(c.lower_bound)}"
        rare = f"{1.0 - self.quantile:.3g}"
        yield (
            "price",
            f"{each}, which a correct one exceeds with probability {rare} (chi^2, {self.noise})",
        )


def headline(certificate: Certificate, rejection: Rejection | None = None) -> str:
    """What a verdict means, in sentences without the last stop.

    That about rejections stands for that about the kept measurements where both are CERTIFIED.
    """
    if rejection is None:
        return meaning(certificate)
    if rejection.covers(certificate):
        return meaning(rejection.certificate)
    kept = f"{meaning(certificate)}. That is about the kept measurements"
    return f"{kept}. Rejecting the others: {rejection.verdict}"


def certify_rejection(
    problem: Quadratic | Sum,
    estimate: Estimate,
    rejected: IntArray,
    *,
    quantile: float | None = None,
    scale: float = 1.0,
    settings: SolveSettings | None = None,
    monitor: Monitor = silent,
) -> Rejection:
    """The verdict on an estimate under the truncated cost; see `Rejection`.

    Parameters
    ----------
    problem : of all measurements
    rejected : (k,) indices
    quantile, scale : see `certpgo.objective.truncated_cost.rejecting`
    settings : tier, tolerances and time limit

    Raises
    ------
    InputError
        As `rejecting`; or edges with matrix weights.
    GraphError
        The measurements that are not rejected leave nodes free.
    """
    chosen = settings or DEFAULT
    tier = Tier.STANDARD if chosen.tier is None or problem.unprovable else chosen.tier
    truncated = rejecting(problem, rejected, quantile, scale=scale)
    normalized = NormalizedProblem.of(truncated, tier, chosen.rtol, chosen.atol, monitor)
    with normalized.stop.within(chosen.time_limit):
        own = bounding.raised(normalized, local_minimum(normalized, estimate))
        certificate = verdict(normalized, estimate, own)
    known = flagged_from(problem) if quantile is None else quantile
    return Rejection(truncated, estimate, certificate, known, scale)

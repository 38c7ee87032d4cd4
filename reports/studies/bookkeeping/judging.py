"""What is false in an answer, by the oracle."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from certpgo import Certificate, CertPGOError, Estimate, Standing
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Relative difference of the same cost in two programs.
SAME = 1e-9
#: CERTIFIED means a gap of at most RTOL F + min(ATOL W, SHARE F), or an exact fit.
RTOL, ATOL, SHARE = 1e-5, 1e-12, 1e-3
#: Roundings that a bound may be above, and that costs may differ by.
ROUNDINGS = 4.0


@dataclass
class Findings:
    """What was said about one draw, and what of it is false."""

    said: Counter[str] = field(default_factory=Counter)
    false: list[str] = field(default_factory=list)

    def require(self, holds: object, claim: str) -> None:
        """Record a false claim unless it holds."""
        if not holds:
            self.false.append(claim)

    @contextmanager
    def refusals(self, what: str = "") -> Iterator[None]:
        """Documented errors, of one line, end the block."""
        try:
            yield
        except CertPGOError as error:
            self.said[f"{what} refused: {type(error).__name__}".strip()] += 1
            self.require("\n" not in str(error), f"{what}: a message of several lines: {error}")


@dataclass(frozen=True)
class Claim:
    """What is claimed about an estimate.

    Attributes
    ----------
    estimate : as poses of the oracle; None where only numbers are known
    upper, lower : cost, rounded up, and bound
    tolerance : gap up to which it is optimal
    verdict : in words
    is_exact : whether all residuals are said to be rounding
    """

    name: str
    estimate: Poses | None
    upper: float
    lower: float
    tolerance: float
    verdict: str
    is_exact: bool = False

    @classmethod
    def of(cls, name: str, certificate: Certificate, estimate: Estimate | Poses | None) -> Claim:
        """What a certificate claims about an estimate."""
        c = certificate
        x = poses_of(estimate) if isinstance(estimate, Estimate) else estimate
        numbers = c.cost_upper, c.lower_bound, c.tolerance
        return cls(name, x, *numbers, c.verdict.value, c.is_exact_fit)


def standing(name: str, s: Standing, estimate: Poses | None) -> Claim:
    """What a session claims about its estimate; of an exact fit the whole cost is tolerated."""
    numbers = s.cost, s.lower_bound, s.tolerance
    return Claim(name, estimate, *numbers, s.verdict.value, s.tolerance >= s.cost)


def poses_of(estimate: Estimate) -> Poses:
    """An estimate for the oracle."""
    R, t = estimate.rotations, estimate.translations
    return R, np.zeros(R.shape[:2]) if t is None else t


def best_known(cost: Cost, claims: Sequence[Claim], starts: Sequence[Poses]) -> tuple[float, Poses]:
    """The least cost that descents from these reach."""
    given = [claim.estimate for claim in claims if claim.estimate is not None]
    return cost.best([*starts, *given])


def judge(
    found: Findings, cost: Cost, claims: Sequence[Claim], starts: Sequence[Poses] = ()
) -> float:
    """Judge claims about the same measurements; returns the least cost that is known.

    False are: a bound above a cost that is attained; a cost that is not that of the estimate;
    CERTIFIED where something better by more than the tolerance is attained.
    """
    best, where = best_known(cost, claims, [*starts, (cost.of.R, cost.of.t)])
    slack = ROUNDINGS * cost.rounding(where)
    for claim in claims:
        name = claim.name
        found.said[f"{name}: {claim.verdict}"] += 1
        found.require(claim.lower <= best + slack, f"{name}: bound {claim.lower!r} above {best!r}")
        own = claim.upper
        if claim.estimate is not None:
            own = cost.value(claim.estimate)
            off = SAME * own + ROUNDINGS * cost.rounding(claim.estimate)
            # Costs are rounded up by what is small beside the tolerance.
            fits = -off <= claim.upper - own <= off + 0.1 * max(claim.tolerance, ATOL * scale(cost))
            found.require(fits, f"{name}: cost {claim.upper!r}, but it is {own!r}")
        found.require(own >= best - slack, f"{name}: cost {own!r} below the least, {best!r}")
        if claim.verdict == "CERTIFIED":
            most = tolerance(cost, claim.upper)
            if claim.is_exact:
                most = max(most, cost.exact(claim.estimate or where))
            else:
                found.require(
                    claim.tolerance <= most * (1.0 + SAME),
                    f"{name}: the tolerance is {claim.tolerance!r}, not {most!r}",
                )
            # Where only a number is known, it is rounded up.
            up = 0.0 if claim.estimate is not None else 0.1 * ATOL * scale(cost)
            found.require(
                own - best <= min(claim.tolerance, most) + slack + up,
                f"{name}: CERTIFIED {own!r} within {claim.tolerance:.3g}, but {best!r} is attained",
            )
    return best


def tolerance(cost: Cost, upper: float) -> float:
    """Up to which gap an estimate of that cost is certified."""
    return RTOL * upper + min(ATOL * scale(cost), SHARE * upper)


def scale(cost: Cost) -> float:
    """W: the sum of kappa and of tau |t_ij|^2, or of mean information in their place.

    Of distances, the sum of w d^2 too.
    """
    of, d, squares = cost.of, cost.of.d, (cost.of.steps**2).sum(axis=1)
    if cost.name in ("g2o", "gtsam"):
        diagonal = np.diagonal(of.information, axis1=1, axis2=2)
        kappa, tau = diagonal[:, d:].mean(axis=1), diagonal[:, :d].mean(axis=1)
    elif cost.name == "mahalanobis":
        kappa, tau = np.trace(of.information[:, d:, d:], axis1=1, axis2=2), of.tau
    else:
        kappa, tau = of.kappa, of.tau
    return float(kappa.sum() + tau @ squares + of.precisions @ of.distances**2)

"""What explains an estimate that is not certified, or that is far from the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.cli._truth import KnownPoses
    from certpgo.diagnosis import Finding
    from certpgo.graph import Estimate, Instance
    from certpgo.objective.choose_cost import Certifiable, Judged
    from certpgo.optimize.monitor import Monitor
    from certpgo.solve.fit import Fit
    from certpgo.solve.result import CertifiedSolution


def cause_of(
    instance: Instance,
    problem: Judged,
    estimate: Estimate,
    certificate: Certificate | None,
    truth: KnownPoses | None,
) -> Finding | None:
    """The likeliest mistake, by what is known already; None if nothing is wrong, or none is.

    Parameters
    ----------
    problem : that the certificate is about
    """
    if certificate is None or certificate.rejected or problem.kernel is not None:
        return None
    if certificate.is_optimal and truth is None:
        return None
    from certpgo.diagnosis import Examined, first_finding

    known = None if truth is None else truth.explained(instance)
    cost, least = problem.cost_name, certificate.best_cost
    posed = cast("Certifiable", problem)  # nothing is rejected
    return first_finding(Examined(instance, estimate, known, cost, least, posed))


def cause_of_squares(answer: CertifiedSolution | None, fit: Fit | None) -> Finding | None:
    """What explains measurements that contradict one another beyond their noise."""
    if answer is None or answer.instance is None or fit is None or not fit.is_unusually_large:
        return None
    from certpgo.diagnosis import Examined, cause_in_measurements

    return cause_in_measurements(Examined(answer.instance, known=answer))


def cause_of_rejections(
    answer: CertifiedSolution, monitor: Monitor, *, cost: str, time_limit: float | None
) -> Finding | None:
    """What explains all measurements, where a robust answer rejects some or takes more noise."""
    if answer.instance is None or not (len(answer.solution.rejected) or answer.noise):
        return None
    from certpgo.diagnosis import Examined, cause_in_measurements

    return cause_in_measurements(
        Examined(answer.instance, cost=cost, time_limit=time_limit, monitor=monitor)
    )


def cause(found: Finding | None) -> Iterable[tuple[str, str]]:
    """The same as a fact."""
    if found is not None:
        yield "likely cause", str(found)


def remark_of(found: Finding | None) -> Iterable[str]:
    """The same as a remark on a page."""
    if found is not None:
        yield f"Likely cause: {found}."


def cause_as_json(found: Finding | None) -> dict[str, Any]:
    """The same as data: a list of at most one."""
    return {"findings": [] if found is None else [asdict(found)]}

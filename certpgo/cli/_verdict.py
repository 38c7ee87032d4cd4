"""A certificate in words, as JSON, and as an exit code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import typer

from certpgo.cli import _known
from certpgo.cli._show import facts, paragraph

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.certify.region import ProvenDistance
    from certpgo.graph import Instance
    from certpgo.linalg.arrays import IntArray
    from certpgo.solve.assessment import Assessment
    from certpgo.solve.fit import Fit
    from certpgo.solve.metrics import TrajectoryErrors
    from certpgo.solve.outliers import Disagreement
    from certpgo.solve.rejection import Rejection
    from certpgo.solve.result import CertifiedSolution

#: Exit codes by verdict, by increasing severity.
EXIT_CODES = {"CERTIFIED": 0, "ERROR": 1, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}
#: Share of rejected measurements from which on a warning is due.
MANY = 1.0 / 3.0


def weakest(verdicts: Iterable[str]) -> int:
    """The exit code of the weakest of these verdicts, which include ``ERROR``."""
    return max((EXIT_CODES[verdict] for verdict in verdicts), default=0)


def headline(certificate: Certificate, rejection: Rejection | None = None) -> None:
    """Print the verdict and what it means, alone."""
    from certpgo.solve.rejection import headline as meaning

    paragraph(f"{certificate.stated}. {meaning(certificate, rejection)}.")
    typer.echo()


def show(
    certificate: Certificate,
    part: Instance,
    assessment: Assessment | None = None,
    disagreement: Disagreement | None = None,
    *,
    more: Iterable[tuple[str, str]] = (),
    steps: Sequence[str] = (),
    fit: Fit | None = None,
    cost: str | None = None,
) -> None:
    """Print the numbers behind a verdict, ``more`` of them, what limits it, and what to do next.

    With the name of a ``cost``, also what the register knows of the graph under it.
    """
    from certpgo.certify.certificate import CHORDAL
    from certpgo.certify.wording import numbers, reasons, stated_objective, trusts
    from certpgo.graph.graph import length_unit
    from certpgo.solve import accuracy_wording as wording

    chordal = certificate.objective == CHORDAL
    farthest = None if assessment is None else assessment.farthest
    facts(
        [
            *numbers(certificate, farthest, length_unit(part.graph)),
            *reasons(certificate),
            *([] if fit is None else [("chi^2", f"{fit}{_of_best(assessment)}")]),
            *wording.redundancy(part),
            *more,
            *(
                []
                if disagreement is None
                else [("outliers?", wording.hint(disagreement, certificate))]
            ),
            *([] if assessment is None else wording.comparison(assessment, part)),
            *_known.fact(part, cost, certificate),
            *trusts(certificate),
            *([("objective", stated_objective(part.options, certificate))] if chordal else []),
            *wording.provenance(part, certificate),
            *(("" if k else "next", step) for k, step in enumerate(steps)),
        ]
    )


def _of_best(assessment: Assessment | None) -> str:
    """chi^2 of a better estimate, beside that of the one that is judged; empty without one."""
    best = None if assessment is None else assessment.best_fit
    return f"; that of {best.of} is {best.chi2:.4g}" if best is not None and best.of else ""


def pose_called(name: int | None, part: Instance) -> int | None:
    """The pose with an id; None if there is none."""
    return None if name is None else part.pose_called(name)


def distance_of(
    certificate: Certificate | None, reference: int | None, part: Instance
) -> ProvenDistance | None:
    """How far all optima can be, seen from the pose with an id; None where nothing is known."""
    if certificate is None:
        return None
    return certificate.stated_distance(pose_called(reference, part))


def distance(found: ProvenDistance | None, part: Instance) -> Iterable[tuple[str, str]]:
    """How far the estimate can be from every optimum, as names and values; nothing if unknown."""
    return () if found is None else found.in_words(part.named)


def distance_as_json(found: ProvenDistance | None, part: Instance) -> dict[str, Any]:
    """The same; null where there is no limit. Of nodes by their ids, or null for the world."""
    from certpgo.certify.region import limits

    metres, degrees = limits(found)
    nodes = [] if found is None else [found.node, found.reference]
    node, seen = [None if k == part.world else int(part.ids[k]) for k in nodes] or (None, None)
    return {
        "distance_m": metres,
        "distance_deg": degrees,
        "distance_node": node,
        "distance_reference": seen,
    }


def warnings(fit: Fit | None, rejected: int = 0, kept: int = 0) -> list[str]:
    """What a verdict does not say: an unusual chi^2, and many rejections."""
    said = ("" if fit is None else fit.warning, rejecting_many(rejected, kept))
    return [warning for warning in said if warning]


def rejecting_many(rejected: int, kept: int) -> str:
    """A warning if more than a third of the measurements are rejected; or empty."""
    total = rejected + kept
    if not rejected > MANY * total:
        return ""
    return (
        f"{rejected} of {total} measurements are rejected, more than a third; another choice may "
        "fit as well, and no verdict says which one is right"
    )


#: Version of the JSON documents of ``solve`` and ``certify``; raised when a key moves.
SCHEMA = 2


def as_json(
    part: Instance,
    certificate: Certificate | None,
    cost: float,
    *,
    disagreement: Disagreement | None = None,
    assessment: Assessment | None = None,
    accuracy: TrajectoryErrors | None = None,
    fit: Fit | None = None,
    best_fit: Fit | None = None,
    under: str | None = None,
) -> dict[str, Any]:
    """An estimate of a connected graph: the verdict first, then its details.

    Angles are in radians unless their names end with ``deg``.

    Parameters
    ----------
    certificate : the certificate, or None if none was requested
    cost : F of the estimate, as computed, for the certified measurements
    under : the name of the cost of all measurements, or None for another: what the register is
        asked for
    """
    from certpgo.certify.wording import objective

    c = certificate
    return {
        "schema": SCHEMA,
        "graph": part.name,
        "reading": dict(part.options),
        "objective": objective(part.options, certificate),
        "verdict": None if c is None else c.verdict.value,
        "reason": None if c is None else c.reason,
        "limited_by": None if c is None else c.limited_by.value,
        "tier": None if c is None else c.tier.value,
        "cost": cost,
        "lower_bound": None if c is None else c.lower_bound,
        "gap": None if c is None else c.gap,
        "relative_gap": None if c is None else c.relative_gap,
        "angles": "radians",
        "certificate": None if c is None else _details(c),
        "fit": None if fit is None else fit_as_json(fit, best_fit),
        "accuracy": None if accuracy is None else asdict(accuracy),
        "disagreement": None if disagreement is None else _disagreement(part, disagreement),
        "averaged": _averaged(part, certificate),
        "fixed_ids": [int(part.ids[node]) for node in part.fixed],
        "notices": list(part.notices),
        "register": _known.as_json(part, under, c),
        **({} if assessment is None else _assessment(assessment)),
    }


def in_short(certificate: Certificate) -> dict[str, Any]:
    """The verdict with the cost and its lower bound, as JSON."""
    return {
        "verdict": certificate.verdict.value,
        "cost": certificate.cost_upper,
        "lower_bound": certificate.lower_bound,
    }


def fit_as_json(fit: Fit, best: Fit | None = None) -> dict[str, Any]:
    """chi^2 with its degrees of freedom, and a warning, of the best estimate if given, or null."""
    return {
        "chi2": fit.chi2,
        "degrees_of_freedom": fit.freedom,
        "warning": (best or fit).warning or None,
    }


def edges_as_json(instance: Instance, edges: IntArray) -> list[dict[str, Any]]:
    """Edges, given by index, by their number in the source and node ids."""
    numbers, pairs = instance.known_numbers[edges].tolist(), instance.pairs[edges].tolist()
    return [{"edge": e, "ids": ids} for e, ids in zip(numbers, pairs, strict=True)]


def rejection_as_json(instance: Instance, found: Rejection | None) -> dict[str, Any] | None:
    """The verdict about the truncated cost; None if nothing was rejected."""
    if found is None:
        return None
    return {
        **in_short(found.certificate),
        "gap": found.certificate.gap,
        "sentence": found.sentence,
        "quantile": found.quantile,
        "prices": found.prices.tolist(),
        "ambiguous": edges_as_json(instance, found.ambiguous),
    }


def stated_noise_as_json(
    instance: Instance, found: CertifiedSolution | None
) -> dict[str, Any] | None:
    """What is rejected at the stated noise, where another is assumed; else None."""
    stated = None if found is None else found.at_stated_noise
    if stated is None:
        return None
    return {
        **in_short(stated.certificate),
        "rejected": edges_as_json(instance, stated.solution.rejected),
        "rejection": rejection_as_json(instance, stated.rejection),
    }


def _averaged(part: Instance, certificate: Certificate | None) -> dict[str, float] | None:
    """The largest ratios of precisions that kappa and tau average; None where they do not."""
    from certpgo.certify.certificate import CHORDAL

    information = part.graph.information
    if information is None or certificate is None or certificate.objective != CHORDAL:
        return None
    translation, rotation = information.anisotropy
    return {"translation": translation, "rotation": rotation}


def _details(certificate: Certificate) -> dict[str, Any]:
    """The fields of a certificate without arrays and those of the top level."""
    top = {"verdict", "reason", "limited_by", "tier", "lower_bound", "gap", "relative_gap"}
    return {name: value for name, value in certificate.as_data().items() if name not in top}


def _disagreement(instance: Instance, found: Disagreement) -> dict[str, Any]:
    return {
        "sentence": str(found),
        "count": len(found.edges),
        "total": found.total,
        "worst_angle": found.worst_angle,
        "edges": edges_as_json(instance, found.edges),
    }


def _assessment(a: Assessment) -> dict[str, Any]:
    written = a.rounding
    return {
        "best": {
            "cost_upper": a.best_cost,
            "is_optimal": a.best_is_optimal,
            "excess": a.excess,
            "relative_excess": a.relative_excess,
            **asdict(a.distance),
        },
        "costliest_edges": [asdict(edge) for edge in a.edges],
        "digits": None if written is None else {**asdict(written.digits), "cost": written.cost},
    }

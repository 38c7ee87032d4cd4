"""A certificate in words that need no paper, as JSON, and as an exit code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from certpgo.cli._show import facts
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.assess.assessment import Assessment
    from certpgo.certify import Certificate
    from certpgo.graph import Instance
    from certpgo.linalg.arrays import IntArray
    from certpgo.solvers.certified.disagreement import Disagreement

#: Exit code after Ctrl-C.
INTERRUPTED = 130
#: Exit codes by verdict, in the order of what a caller should act on.
EXIT_CODES = {"CERTIFIED": 0, "ERROR": 1, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}


def refuse_screening(tier: str | None) -> None:
    """Refuse a tier that proves nothing where a proof is asked for.

    Raises
    ------
    InputError
        It is the tier ``screen``.
    """
    if tier == "screen":
        raise InputError("--proof is judged at the proof tier, not with --tier screen")


def exit_code(certificates: Iterable[Certificate]) -> int:
    """The exit code of the weakest verdict."""
    return weakest(c.verdict.value for c in certificates)


def weakest(verdicts: Iterable[str]) -> int:
    """The exit code of the weakest of these verdicts, ``ERROR`` being one."""
    return max((EXIT_CODES[verdict] for verdict in verdicts), default=0)


def show(
    certificate: Certificate,
    reading: Mapping[str, str],
    assessment: Assessment | None = None,
    disagreement: Disagreement | None = None,
) -> None:
    """Print the verdict, its reason, the numbers behind it, and by which reading it is judged."""
    from certpgo.assess.wording import comparison, hint, judged_by, meaning, numbers, trusts

    facts(
        [
            (certificate.verdict.value, meaning(certificate)),
            ("because", certificate.reason),
            *numbers(certificate),
            *(() if disagreement is None else [("outliers?", hint(disagreement))]),
            *(() if assessment is None else comparison(assessment)),
            ("proof rests on", trusts(certificate)),
            ("judged by", f"{judged_by(reading)} (other tools minimise other errors)"),
        ]
    )


def edges_as_json(instance: Instance, edges: IntArray) -> list[dict[str, Any]]:
    """Edges by their numbers and the ids of their nodes."""
    pairs = instance.ids[instance.graph.edges[edges]].tolist()
    return [{"edge": e, "ids": ids} for e, ids in zip(edges.tolist(), pairs, strict=True)]


def disagreement_as_json(instance: Instance, found: Disagreement | None) -> dict[str, Any] | None:
    """The measurements that disagree; angles in radians."""
    if found is None:
        return None
    return {
        "sentence": str(found),
        "count": len(found.edges),
        "total": found.total,
        "worst_angle": found.worst_angle,
        "edges": edges_as_json(instance, found.edges),
    }


def comparison_as_json(a: Assessment) -> dict[str, Any]:
    """What `show` says beyond the certificate; angles of edges in radians."""
    d = a.distance
    return {
        "best": {
            "cost": a.best_cost,
            "is_optimal": a.best_is_optimal,
            "excess": a.excess,
            "relative_excess": a.relative_excess,
            "mean_deg": d.mean_deg,
            "worst_deg": d.worst_deg,
            "mean_m": d.mean_m,
            "worst_m": d.worst_m,
        },
        "costliest_edges": [
            {
                "edge": edge.edge,
                "ids": list(edge.ids),
                "cost": edge.cost,
                "share": edge.share,
                "angle": edge.angle,
                "metres": edge.metres,
            }
            for edge in a.edges
        ],
        "digits": None
        if a.rounding is None
        else {
            "count": a.rounding.digits.count,
            "decimals": a.rounding.digits.decimals,
            "cost": a.rounding.cost,
        },
    }


def as_json(certificate: Certificate) -> dict[str, Any]:
    """The certificate without its arrays; angles in radians."""
    return {
        "verdict": certificate.verdict.value,
        "reason": certificate.reason,
        "tier": certificate.tier.value,
        "cost": certificate.cost,
        "lower_bound": certificate.lower_bound,
        "gap": certificate.gap,
        "relative_gap": certificate.relative_gap,
        "rtol": certificate.rtol,
        "atol": certificate.atol,
        "scale": certificate.scale,
        "stationarity": certificate.stationarity,
        "max_residual_angle": certificate.max_residual_angle,
        "refined_cost": certificate.refined_cost,
        "basin_is_global": certificate.basin_is_global,
        "better_cost": certificate.better_cost,
        "engine": certificate.engine,
    }

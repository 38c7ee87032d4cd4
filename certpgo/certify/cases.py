"""Which certificates a problem's cost has: the one place that asks for the kind of a problem."""

from __future__ import annotations

from typing import Any

from certpgo.certify.certificate import Tier
from certpgo.certify.chordal_case import Case
from certpgo.certify.range_case import RangedCase
from certpgo.certify.similarity_case import SimilarCase
from certpgo.certify.surrogate_case import OwnCostCase
from certpgo.certify.truncated_case import TruncatedCase
from certpgo.errors import InputError, kind_of
from certpgo.objective.base import Objective
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.range_problem import RangeProblem
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.objective.truncated_problem import TruncatedProblem
from certpgo.optimize.monitor import Monitor, silent

_KINDS: tuple[tuple[type[Any], type[Case]], ...] = (
    (InformationProblem, OwnCostCase),
    (RangeProblem, RangedCase),
    (TruncatedProblem, TruncatedCase),
    (SimilarityProblem, SimilarCase),
    (Objective, Case),
)


def case_of(
    problem: object, tier: Tier | str, rtol: float, atol: float, monitor: Monitor = silent
) -> Case:
    """The normalized problem with the settings of its certificates; see `Case.of`.

    Raises
    ------
    InputError
        It is no problem; or as `Case.of`.
    """
    for of, kind in _KINDS:
        if isinstance(problem, of):
            return kind.of(problem, tier, rtol, atol, monitor)
    raise InputError(
        f"a PoseProblem(graph) or RotationProblem(graph) is judged, not {kind_of(problem)}"
    )

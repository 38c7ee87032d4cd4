"""The relaxation over complex numbers of poses in the plane, see `certpgo.objective.lifting`."""

from __future__ import annotations

from dataclasses import replace

from certpgo.objective.lifting import COMPLEX
from certpgo.objective.quadratic import Quadratic


def is_over_complex_numbers(problem: Quadratic) -> bool:
    """Whether the relaxation of a problem is."""
    return problem.lifting is COMPLEX


def over_complex_numbers(problem: Quadratic) -> Quadratic | None:
    """The same problem with a relaxation that is nowhere lower; None where none is known."""
    poses = problem.has_positions and problem.kinds.turn and not problem.graph.has_others
    if problem.d != 2 or not poses or is_over_complex_numbers(problem):
        return None
    other = replace(problem, lifting=COMPLEX)
    other.__dict__["analyses"] = problem.analyses
    return other

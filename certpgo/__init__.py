"""Certifiable pose-graph optimization and rotation averaging."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from certpgo import (
    _former_names,  # noqa: F401
    _start,  # noqa: F401 - first: Ctrl-C during the imports below
)

# `certify` is both a function and a subpackage: importing it first makes the function win.
from certpgo.certify import Certificate, Tier, Verdict, certify
from certpgo.errors import (
    CertPGOError,
    FormatError,
    GraphError,
    InputError,
    InputNotice,
    MissingDependency,
    NumericalError,
    SpecError,
)
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.labels import WORLD
from certpgo.graph.ranges import Ranges
from certpgo.objective.problem import PoseProblem, RotationProblem
from certpgo.optimize.marginals import Marginals
from certpgo.optimize.monitor import Iteration, Monitor
from certpgo.optimize.riemannian_newton import NewtonSettings
from certpgo.optimize.solution import Solution, Status
from certpgo.solve.outliers import Disagreement
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.robust import solve_robustly
from certpgo.solve.settings import SolveSettings
from certpgo.solve.solving import solve

if TYPE_CHECKING:
    from certpgo import plot as plot
    from certpgo.certify.proof_file import check, write_proof
    from certpgo.graph.priors import with_directions, with_priors
    from certpgo.io import read, read_estimate, write
    from certpgo.linalg.distributed.schedulers import scheduler
    from certpgo.objective.gtsam_graph import from_gtsam, to_gtsam
    from certpgo.registration.reconstruct import reconstruct
    from certpgo.registration.register import register
    from certpgo.registration.sequences import read_sequence
    from certpgo.registry import get_solver
    from certpgo.solve.assessment import certify_values
    from certpgo.solve.merging import Merged, merge
    from certpgo.solve.robust_session import RobustSession
    from certpgo.solve.session import Session
    from certpgo.solve.session_outliers import Suspicion
    from certpgo.solve.session_status import Standing
    from certpgo.solve.sparsifying import Sparsified, SuggestedLoops, sparsify, suggest_loops
    from certpgo.view.show import show

#: Imported on first use, to keep `import certpgo` fast.
_LATER = {
    "Merged": "solve.merging",
    "Sparsified": "solve.sparsifying",
    "SuggestedLoops": "solve.sparsifying",
    "RobustSession": "solve.robust_session",
    "Session": "solve.session",
    "Standing": "solve.session_status",
    "Suspicion": "solve.session_outliers",
    "check": "certify.proof_file",
    "certify_values": "solve.assessment",
    "from_gtsam": "objective.gtsam_graph",
    "to_gtsam": "objective.gtsam_graph",
    "read": "io",
    "read_estimate": "io",
    "read_sequence": "registration.sequences",
    "reconstruct": "registration.reconstruct",
    "write": "io",
    "write_proof": "certify.proof_file",
    "get_solver": "registry",
    "merge": "solve.merging",
    "sparsify": "solve.sparsifying",
    "suggest_loops": "solve.sparsifying",
    "register": "registration.register",
    "show": "view.show",
    "scheduler": "linalg.distributed.schedulers",
    "with_directions": "graph.priors",
    "with_priors": "graph.priors",
}

#: Subpackages to work with, imported on first use too.
_ROOMS = ("plot",)

__version__ = "0.1.0"

__all__ = [
    "WORLD",
    "CertPGOError",
    "Certificate",
    "CertifiedSolution",
    "Disagreement",
    "Estimate",
    "FormatError",
    "GraphError",
    "InputError",
    "InputNotice",
    "Instance",
    "Iteration",
    "Marginals",
    "Merged",
    "MissingDependency",
    "Monitor",
    "NewtonSettings",
    "NumericalError",
    "PoseGraph",
    "PoseProblem",
    "Ranges",
    "RobustSession",
    "RotationGraph",
    "RotationProblem",
    "Session",
    "Solution",
    "SolveSettings",
    "Sparsified",
    "SpecError",
    "Standing",
    "Status",
    "SuggestedLoops",
    "Suspicion",
    "Tier",
    "Verdict",
    "certify",
    "check",
    "certify_values",
    "from_gtsam",
    "to_gtsam",
    "get_solver",
    "merge",
    "read",
    "read_estimate",
    "read_sequence",
    "reconstruct",
    "register",
    "scheduler",
    "show",
    "solve",
    "solve_robustly",
    "sparsify",
    "suggest_loops",
    "with_directions",
    "with_priors",
    "write",
    "write_proof",
]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"certpgo.{name}")
    if name not in _LATER:
        raise AttributeError(f"module 'certpgo' has no attribute {name!r}")
    return getattr(importlib.import_module(f"certpgo.{_LATER[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS, "__version__", "__doc__"])

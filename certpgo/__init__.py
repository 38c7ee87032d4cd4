"""Certifiable pose-graph optimization and rotation averaging."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from certpgo import _start  # noqa: F401 - first: Ctrl-C during the imports below

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
from certpgo.optimize.newton import NewtonSettings
from certpgo.optimize.solution import Solution, Status
from certpgo.solvers.certified.disagreement import Disagreement
from certpgo.solvers.certified.interface import solve
from certpgo.solvers.certified.result import CertifiedSolution
from certpgo.solvers.certified.robust import solve_robustly
from certpgo.solvers.certified.settings import SolveSettings

if TYPE_CHECKING:
    from certpgo import plot as plot
    from certpgo.assess.assessment import certify_values
    from certpgo.assess.sparsifying import Sparsified, SuggestedLoops, sparsify, suggest_loops
    from certpgo.certify.proof_file import check, write_proof
    from certpgo.costs.gtsam_graph import from_gtsam, to_gtsam
    from certpgo.graph.priors import with_directions, with_priors
    from certpgo.io import read, read_estimate, write
    from certpgo.linalg.distributed.schedulers import scheduler
    from certpgo.registration.reconstruct import reconstruct
    from certpgo.registration.register import register
    from certpgo.registration.sequences import read_sequence
    from certpgo.registry import get_solver
    from certpgo.solvers.certified.merging import Merged, merge
    from certpgo.solvers.certified.rejecting import RobustSession
    from certpgo.solvers.certified.session import Session
    from certpgo.solvers.certified.standing import Standing
    from certpgo.solvers.certified.suspicion import Suspicion
    from certpgo.view.show import show

#: Imported on first use, to keep `import certpgo` fast.
_LATER = {
    "Merged": "solvers.certified.merging",
    "Sparsified": "assess.sparsifying",
    "SuggestedLoops": "assess.sparsifying",
    "RobustSession": "solvers.certified.rejecting",
    "Session": "solvers.certified.session",
    "Standing": "solvers.certified.standing",
    "Suspicion": "solvers.certified.suspicion",
    "check": "certify.proof_file",
    "certify_values": "assess.assessment",
    "from_gtsam": "costs.gtsam_graph",
    "to_gtsam": "costs.gtsam_graph",
    "read": "io",
    "read_estimate": "io",
    "read_sequence": "registration.sequences",
    "reconstruct": "registration.reconstruct",
    "write": "io",
    "write_proof": "certify.proof_file",
    "get_solver": "registry",
    "merge": "solvers.certified.merging",
    "sparsify": "assess.sparsifying",
    "suggest_loops": "assess.sparsifying",
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

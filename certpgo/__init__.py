"""Certifiable pose-graph optimization and rotation averaging."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from certpgo import _start  # noqa: F401 - first: Ctrl-C during the imports below
from certpgo._lazy import attributes
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

if TYPE_CHECKING:
    from certpgo import plot as plot
    from certpgo.certify import Certificate, Tier, Verdict
    from certpgo.certify.proof_file import check
    from certpgo.certify.region import ProvenDistance, Region
    from certpgo.diagnosis import Diagnosis, Finding, diagnose
    from certpgo.graph import (
        Estimate,
        Graph,
        Instance,
        PoseGraph,
        RotationGraph,
        SimilarityGraph,
    )
    from certpgo.graph.inertial import with_preintegrated
    from certpgo.graph.labels import WORLD
    from certpgo.graph.preintegrated import Preintegrated
    from certpgo.graph.priors import with_directions, with_priors
    from certpgo.graph.ranges import Ranges
    from certpgo.io import read, read_estimate, write
    from certpgo.objective.gtsam_graph import from_gtsam, to_gtsam
    from certpgo.objective.quadratic import Quadratic
    from certpgo.optimize.marginals import Marginals
    from certpgo.optimize.monitor import Iteration, Monitor
    from certpgo.optimize.riemannian_newton import NewtonSettings
    from certpgo.optimize.solution import Solution, Status
    from certpgo.registration.reconstruct import reconstruct
    from certpgo.registration.register import register
    from certpgo.registration.sequences import read_sequence
    from certpgo.registry import get_solver
    from certpgo.solve.assessment import certify_values
    from certpgo.solve.judging import certify
    from certpgo.solve.logarithms import LogarithmFit, fit_logarithms
    from certpgo.solve.many import certify_many, prove_many, solve_many
    from certpgo.solve.merging import Merged, merge
    from certpgo.solve.outliers import Disagreement
    from certpgo.solve.proving import write_proof
    from certpgo.solve.result import CertifiedSolution
    from certpgo.solve.reweighing import Reweighed, reweigh
    from certpgo.solve.robust import solve_robustly
    from certpgo.solve.robust_session import RobustSession
    from certpgo.solve.session import Session
    from certpgo.solve.session_outliers import Suspicion
    from certpgo.solve.session_status import Standing
    from certpgo.solve.settings import SolveSettings
    from certpgo.solve.solving import solve
    from certpgo.solve.sparsifying import Sparsified, sparsify
    from certpgo.solve.suggesting import SuggestedLoops, suggest_loops
    from certpgo.view.show import show

#: Where each public name is; it is imported on first use, to keep `import certpgo` fast.
_HOMES = {
    "certify": ("Certificate", "Tier", "Verdict"),
    "certify.proof_file": ("check",),
    "certify.region": ("ProvenDistance", "Region"),
    "diagnosis": ("Diagnosis", "Finding", "diagnose"),
    "graph": ("Estimate", "Graph", "Instance", "PoseGraph", "RotationGraph", "SimilarityGraph"),
    "graph.inertial": ("with_preintegrated",),
    "graph.labels": ("WORLD",),
    "graph.preintegrated": ("Preintegrated",),
    "graph.priors": ("with_directions", "with_priors"),
    "graph.ranges": ("Ranges",),
    "io": ("read", "read_estimate", "write"),
    "objective.gtsam_graph": ("from_gtsam", "to_gtsam"),
    "objective.quadratic": ("Quadratic",),
    "optimize.marginals": ("Marginals",),
    "optimize.monitor": ("Iteration", "Monitor"),
    "optimize.riemannian_newton": ("NewtonSettings",),
    "optimize.solution": ("Solution", "Status"),
    "registration.reconstruct": ("reconstruct",),
    "registration.register": ("register",),
    "registration.sequences": ("read_sequence",),
    "registry": ("get_solver",),
    "solve.assessment": ("certify_values",),
    "solve.judging": ("certify",),
    "solve.logarithms": ("LogarithmFit", "fit_logarithms"),
    "solve.many": ("certify_many", "prove_many", "solve_many"),
    "solve.merging": ("Merged", "merge"),
    "solve.outliers": ("Disagreement",),
    "solve.proving": ("write_proof",),
    "solve.result": ("CertifiedSolution",),
    "solve.reweighing": ("Reweighed", "reweigh"),
    "solve.robust": ("solve_robustly",),
    "solve.robust_session": ("RobustSession",),
    "solve.session": ("Session",),
    "solve.session_outliers": ("Suspicion",),
    "solve.session_status": ("Standing",),
    "solve.settings": ("SolveSettings",),
    "solve.solving": ("solve",),
    "solve.sparsifying": ("Sparsified", "sparsify"),
    "solve.suggesting": ("SuggestedLoops", "suggest_loops"),
    "view.show": ("show",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

#: Subpackages to work with, imported on first use too.
_ROOMS = ("plot",)

__version__ = "0.2.0"

__all__ = [
    "WORLD",
    "CertPGOError",
    "Certificate",
    "CertifiedSolution",
    "Diagnosis",
    "Disagreement",
    "Estimate",
    "Finding",
    "FormatError",
    "Graph",
    "GraphError",
    "InputError",
    "InputNotice",
    "Instance",
    "Iteration",
    "LogarithmFit",
    "Marginals",
    "Merged",
    "MissingDependency",
    "Monitor",
    "NewtonSettings",
    "NumericalError",
    "PoseGraph",
    "Preintegrated",
    "ProvenDistance",
    "Quadratic",
    "Ranges",
    "Region",
    "Reweighed",
    "RobustSession",
    "RotationGraph",
    "Session",
    "SimilarityGraph",
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
    "certify_many",
    "certify_values",
    "check",
    "diagnose",
    "fit_logarithms",
    "from_gtsam",
    "to_gtsam",
    "get_solver",
    "merge",
    "prove_many",
    "read",
    "read_estimate",
    "read_sequence",
    "reconstruct",
    "register",
    "reweigh",
    "show",
    "solve",
    "solve_many",
    "solve_robustly",
    "sparsify",
    "suggest_loops",
    "with_directions",
    "with_preintegrated",
    "with_priors",
    "write",
    "write_proof",
]


_found = attributes(__name__, _HOME)


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"certpgo.{name}")
    value = _found(name)
    setattr(sys.modules[__name__], name, value)
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *_ROOMS, "__version__", "__doc__"])


class _Package(ModuleType):
    """The package, in which the functions `certify` and `solve` win over subpackages."""

    def __setattr__(self, name: str, value: object) -> None:
        # Importing a subpackage would set the attribute to the module.
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

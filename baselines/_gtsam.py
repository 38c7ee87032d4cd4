"""Conversion of problems to GTSAM, and back.

GTSAM minimises half the sum of r^T Omega r over logarithmic residuals r. With Omega_R = 2 kappa I
and Omega_t = tau I that is F/2 to first order, in 2D and 3D. Its Pose3 tangent is (rotation,
translation), its Pose2 tangent (x, y, theta). A prior on the first node fixes the gauge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.gtsam_graph import factors_of
from certpgo.objective.quadratic import Quadratic

from ._programs import GTSAM, sentence

#: Information of the prior, whose residual is zero at the optimum.
PRIOR_PRECISION = 1e6

CHORDAL = "GTSAM minimises F itself, by chordal factors"
ISOTROPIC = "GTSAM with isotropic information from kappa and tau"
FILE = "GTSAM with the file's full information"
FULL = "GTSAM with full information"


library = GTSAM.library


@dataclass(frozen=True, eq=False)
class Model:
    """A problem in GTSAM.

    Attributes
    ----------
    kind : ``"Pose2"``, ``"Pose3"``, ``"Rot2"`` or ``"Rot3"``
    graph : NonlinearFactorGraph of the measurements, without a prior
    keys : GTSAM's key of each node
    note : which information the factors use
    file_values : Values of the file's vertices, or None
    """

    kind: str
    graph: Any
    keys: list[int]
    note: str
    file_values: Any = None

    def anchored(self, values: Any = None) -> Any:
        """The graph with a prior on the first node, at its value or the identity."""
        gtsam = library()
        element = getattr(gtsam, self.kind)
        prior = element() if values is None else self.element(values, self.keys[0])
        noise = gtsam.noiseModel.Isotropic.Precision(_dimension(self.kind), PRIOR_PRECISION)
        graph = self.graph.clone()
        graph.add(getattr(gtsam, f"PriorFactor{self.kind}")(self.keys[0], prior, noise))
        return graph

    def element(self, values: Any, key: int) -> Any:
        """The pose or rotation of one node."""
        return getattr(values, f"at{self.kind}")(key)

    def values(self, estimate: Estimate) -> Any:
        """The estimate as Values."""
        values = library().Values()
        for key, element in zip(self.keys, _elements(*_parts(self.kind, estimate)), strict=True):
            values.insert(key, element)
        return values

    def estimate(self, values: Any) -> Estimate:
        """Values as an estimate; NumericalError if they are not finite."""
        elements = [self.element(values, key) for key in self.keys]
        poses = self.kind.startswith("Pose")
        R = np.array([(e.rotation() if poses else e).matrix() for e in elements])
        t = np.array([e.translation() for e in elements]) if poses else None
        if not (np.isfinite(R).all() and (t is None or np.isfinite(t).all())):
            raise NumericalError("GTSAM: the result is not finite")
        return Estimate(so.project(R), t)


def isotropic_model(problem: Quadratic, note: str = ISOTROPIC) -> Model:
    """Factors with information diag(2 kappa I, tau I)."""
    rotation = 2.0 * problem.rotation.graph.kappa[:, None]
    precisions = np.repeat(rotation, so.tangent_dim(problem.d), axis=1)
    if problem.has_positions:
        translation = np.repeat(problem.graph.tau[:, None], problem.d, axis=1)
        order = [precisions, translation] if problem.d == 3 else [translation, precisions]
        precisions = np.concatenate(order, axis=1)
    return _built_model(problem, precisions, note)


def uniform_model(problem: Quadratic) -> Model:
    """Factors with information 2 kappa in every component, all that FastSync supports."""
    kind = _kind(problem)
    precisions = np.repeat(2.0 * problem.rotation.graph.kappa[:, None], _dimension(kind), axis=1)
    return _built_model(problem, precisions, "GTSAM with information 2 kappa I, tau unused")


def chordal_model(problem: Quadratic) -> Model:
    """Factors of the rotations alone, with objective F."""
    gtsam, kind, rotation = library(), f"Rot{problem.d}", problem.rotation.graph
    factor = getattr(gtsam, f"FrobeniusBetweenFactor{kind}")
    noise = gtsam.noiseModel.Isotropic.Precision
    graph = gtsam.NonlinearFactorGraph()
    measured = zip(
        rotation.edges.tolist(), _elements(rotation.rotations, None), rotation.kappa, strict=True
    )
    for (i, j), element, kappa in measured:
        graph.add(factor(i, j, element, noise(problem.d**2, 2.0 * float(kappa))))
    return Model(kind, graph, list(range(problem.n)), CHORDAL)


def model_of(problem: Quadratic | Sum, source: str | None) -> Model:
    """The problem's own factors under GTSAM's cost.

    For F, the file's own factors if GTSAM reads them all, isotropic ones otherwise.

    Keys are the file's node ids; in ascending order they are the problem's nodes.
    """
    if isinstance(problem, Sum):
        return Model(f"Pose{problem.d}", factors_of(problem), list(range(problem.n)), FULL)
    if source is None:
        return isotropic_model(problem)
    if not Path(source).is_file():
        raise InputError(f"{source}: no such file")
    try:
        graph, values = library().readG2o(str(source), problem.d == 3)
    except RuntimeError as error:
        return isotropic_model(problem, f"{ISOTROPIC} (it cannot read the file: {sentence(error)})")
    # Keys are unsigned: negative ids wrap around, and their order with them.
    keys = sorted(graph.keyVector(), key=lambda key: key - (key >> 63 << 64))
    m, n = problem.graph.num_edges, problem.n
    if (graph.nrFactors(), len(keys)) != (m, n):
        found = f"it finds {len(keys)} nodes and {graph.nrFactors()} edges in the file"
        return isotropic_model(problem, f"{ISOTROPIC} ({found}, the problem has {n} and {m})")
    complete = all(values.exists(key) for key in keys)
    return Model(_kind(problem), graph, keys, FILE, values if complete else None)


def initialization(model: Model) -> Callable[[], Any]:
    """GTSAM's chordal initialization as a function: InitializePose3, in 2D LAGO."""
    gtsam, graph = library(), model.anchored()
    if model.kind == "Pose3":
        return lambda: gtsam.InitializePose3.initialize(graph)
    # LAGO follows the odometry by default; without one it needs a spanning tree.
    odometry = _has_odometry(model)
    return lambda: gtsam.lago.initialize(graph, odometry)


def chordal_start(problem: Quadratic | Sum) -> Estimate:
    """The chordal initialization with isotropic weights as an estimate."""
    model = isotropic_model(problem.chordal)
    return model.estimate(initialization(model)())


def _built_model(problem: Quadratic, precisions: FloatArray, note: str) -> Model:
    gtsam, kind = library(), _kind(problem)
    factor = getattr(gtsam, f"BetweenFactor{kind}")
    noise = gtsam.noiseModel.Diagonal.Precisions
    t = problem.graph.translations if problem.has_positions else None
    measured = _elements(problem.rotation.graph.rotations, t)
    graph = gtsam.NonlinearFactorGraph()
    for (i, j), element, p in zip(problem.graph.edges.tolist(), measured, precisions, strict=True):
        graph.add(factor(i, j, element, noise(p)))
    return Model(kind, graph, list(range(problem.n)), note)


def _kind(problem: Quadratic) -> str:
    return f"{'Pose' if problem.has_positions else 'Rot'}{problem.d}"


def _dimension(kind: str) -> int:
    d = int(kind[-1])
    return so.tangent_dim(d) + (d if kind.startswith("Pose") else 0)


def _parts(kind: str, estimate: Estimate) -> tuple[FloatArray, FloatArray | None]:
    return estimate.rotations, estimate.translations if kind.startswith("Pose") else None


def _elements(R: FloatArray, t: FloatArray | None) -> list[Any]:
    gtsam = library()
    if R.shape[-1] == 3:
        rotations, pose = [gtsam.Rot3(r) for r in R], gtsam.Pose3
    else:
        rotations, pose = [gtsam.Rot2.fromCosSin(*r[:, 0]) for r in R], gtsam.Pose2
    if t is None:
        return rotations
    return [pose(r, x) for r, x in zip(rotations, t, strict=True)]


def _has_odometry(model: Model) -> bool:
    pairs = {tuple(model.graph.at(k).keys()) for k in range(model.graph.nrFactors())}
    first, n = model.keys[0], len(model.keys)
    return all((k, k + 1) in pairs for k in range(first, first + n - 1))

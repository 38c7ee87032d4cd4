"""What a cost of measured poses is made of: one residual per edge, and a minorant of its square.

An edge sees two poses only through v = R_i^T (t_j + R_j a - t_i), for its arm a if it has one, and
Q = R_i^T R_j. With the measured
(R~, t~), y = R~^T (v - t~) and E = R~^T Q are the translation and rotation of what the measurement
leaves unexplained, in the frame of the measured pose.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import GraphError
from certpgo.graph.display import Brief
from certpgo.graph.estimate import Estimate
from certpgo.graph.information import RotationAbout
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.relaxed_point import translations_of
from certpgo.graph.rotation_graph import RotationGraph
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.linalg.rotations import rotation_defect


@dataclass(frozen=True, eq=False, repr=False)
class Minorants(Brief):
    """Functions m_e(v, Q) = tau |v + Q a - b|^2 - 2 <N, Q> + constant, none above its edge's cost.

    They hold for all v and all rotations Q, for the stored doubles, despite rounding. They are
    linear in the Gram matrix of the poses, so their sum is a pose graph's cost plus a constant.

    Attributes
    ----------
    tau : (m,) weights: positive, 0 for rotations alone, negative for truncated costs
    a, b : (m, d) arms at the edge's second and first pose, metres
    N : (m, d, d) couplings of the rotations
    constant : (m,) rounded down; -inf where there is no minorant
    touching : (m, k) numbers from which the constants can be verified, see
        ``EdgeBounds`` in `certpgo.checker`; None if the checker does not know the cost
    """

    tau: FloatArray
    a: FloatArray
    b: FloatArray
    N: FloatArray
    constant: FloatArray
    touching: FloatArray | None = None

    @property
    def exist(self) -> BoolArray:
        """(m,) which edges have one."""
        return np.isfinite(self.constant)

    def subset(self, chosen: BoolArray) -> Minorants:
        """Those of some edges."""
        touching = None if self.touching is None else self.touching[chosen]
        arms = self.a[chosen], self.b[chosen]
        return Minorants(self.tau[chosen], *arms, self.N[chosen], self.constant[chosen], touching)

    def replaced(self, chosen: BoolArray, others: Minorants) -> Minorants:
        """The same with others, as many as are chosen, at the chosen edges."""
        both = []
        for name in ("tau", "a", "b", "N", "constant"):
            values = getattr(self, name).copy()
            values[chosen] = getattr(others, name)
            both.append(values)
        return Minorants(*both)

    def summed(
        self, measured: PoseGraph, kind: type[PoseGraph] = PoseGraph
    ) -> tuple[PoseGraph, float]:
        """The pose graph, of that kind, and the constant that add up to those of ``measured``."""
        rotation, constant = self.summed_rotations(measured.rotation)
        arms = self.a if measured.arms is None else self.a + measured.arms
        armed = arms if arms.any() else None
        return kind(rotation, self.b, self.tau, armed, measured.points), constant

    def summed_rotations(self, measured: RotationGraph) -> tuple[RotationGraph, float]:
        """The same of rotations alone; the constant is rounded down."""
        n, edges, R = measured.num_nodes, measured.edges, measured.rotations
        general = RotationGraph.of_couplings(n, edges, R, self.N)
        # Its cost has the traces of the polar factors as well.
        _, K, K_left = general.polar
        traces = np.concatenate([np.diagonal(A, axis1=1, axis2=2).ravel() for A in (K, K_left)])
        return general, math.nextafter(math.fsum(np.r_[self.constant, -traces]), -math.inf)


@dataclass(frozen=True, eq=False)
class EdgeCost(ABC):
    """A residual e(v, Q) of each edge with cost e^T W e.

    Attributes
    ----------
    graph : the measurements with their information matrices; a cost has no other weights, so that
        scaling and removing measurements need to know the graph alone

    Raises
    ------
    GraphError
        They have none, or entries beyond the range of weights.
    """

    graph: PoseGraph

    #: Name in options and reports.
    name: ClassVar[str]
    #: Whether the checker knows it.
    provable: ClassVar[bool] = False
    #: What its residual is called in the compiled kernel, for this class alone; "" if it has none.
    compiled_residual: ClassVar[str] = ""
    #: Whether residuals of translations do not depend on what is known of the rotation.
    decoupled: ClassVar[bool] = False
    #: What rotational information in space is of: a ``"tangent"`` vector, or the vector part of a
    #: ``"quaternion"``, which is half of it.
    rotation_information: ClassVar[RotationAbout] = "tangent"

    def __post_init__(self) -> None:
        if not (np.abs(self.graph.information_matrices) < FAR).all():
            raise GraphError(f"information must be finite, with entries below {FAR:.2g}")

    @property
    def turned_share(self) -> float:
        """The least ratio of the squared rotational residual to |Q - R|_F^2; 0 if not known.

        Where it is known, translational residuals are no shorter than y.
        """
        return 0.0

    @property
    @abstractmethod
    def title(self) -> str:
        """What it is, in the words of the program's users."""

    @property
    def weights(self) -> FloatArray:
        """(m, k, k) weights W of the residuals: by default the information."""
        return self.graph.information_matrices

    @cached_property
    def measured(self) -> Ball:
        """(m, d, d) the rotations nearest to the measured matrices, which are the data."""
        R = self.graph.rotations
        return Ball.within(R, rotation_defect(R))

    def unexplained(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Translations y (m, d) and rotations E (m, d, d) between measured and given poses."""
        back = np.swapaxes(self.graph.rotations, 1, 2)
        y = (back @ (v - self.graph.translations)[:, :, None])[:, :, 0]
        return y, back @ Q

    @abstractmethod
    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, k) residuals, in the order of the weights: translation, rotation."""

    @abstractmethod
    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (m, k) with their derivatives in v, (m, k, d), and in w, (m, k, q).

        Q moves to Q exp(w), as in `certpgo.linalg.rotations`.
        """

    @abstractmethod
    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""

    @abstractmethod
    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding."""

    def relaxed(self) -> Self | None:
        """A cost nowhere above this one that may have a bound where this one has none."""
        return None

    def on(self, graph: PoseGraph | None) -> Self | None:
        """The same cost on another graph, if there is one."""
        return None if graph is None else replace(self, graph=graph)

    def edge_enclosures(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """(m,) lower and upper bounds on the costs, with translations taken as stored."""
        i, j = self.graph.edges.T
        R = Ball.within(estimate.rotations, rotation_defect(estimate.rotations))
        t = Ball.exact(translations_of(estimate))
        v, Q = R.T[i].apply(t[j] - t[i]), R.T[i] @ R[j]
        if (arms := self.graph.arms) is not None:
            v = v + Q.apply(Ball.exact(arms))
        found = self.enclosures(v, Q)
        return found.lower, found.upper

    def enclosure(self, estimate: Estimate) -> tuple[float, float]:
        """Lower and upper bounds on the sum of the costs, with translations taken as stored."""
        try:
            low, high = map(math.fsum, self.edge_enclosures(estimate))
        except OverflowError:
            return -math.inf, math.inf
        return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)

    def costs(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m,) costs."""
        e = self.residuals(v, Q)
        return np.asarray(np.einsum("ma,mab,mb->m", e, self.weights, e))

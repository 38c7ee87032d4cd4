"""Functions below costs of measurements, which are linear in the Gram matrix of the poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph import Graph, PoseGraph
from certpgo.graph.constructors import of_couplings
from certpgo.graph.display import Brief
from certpgo.linalg.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Minorants(Brief):
    """Functions m_e = tau |t + Q a - b|^2 - 2 <N, Q> + constant, none above its edge's cost.

    Here t = R_i^T (t_j - t_i) and Q = R_i^T R_j. They hold for all t and all rotations Q, for the
    stored doubles, despite rounding. They are linear in the Gram matrix of the poses, so their sum
    is a pose graph's cost plus a constant.

    Attributes
    ----------
    tau : (m,) weights: positive, 0 for rotations alone, negative for truncated costs and distances
    a, b : (m, d) arms at the edge's second and first pose, metres; a is that of the measurement
        itself, and what a minorant has more
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
        both = {}
        for name in ("tau", "a", "b", "N", "constant"):
            both[name] = getattr(self, name).copy()
            both[name][chosen] = getattr(others, name)
        if self.touching is not None:
            both["touching"] = self.touching.copy()
            both["touching"][chosen] = 0.0 if others.touching is None else others.touching
        return Minorants(**both)

    def summed(self, measured: Graph, *, is_signed: bool = False) -> tuple[Graph, float]:
        """The graph of poses, and the constant, that add up to those of ``measured``.

        Parameters
        ----------
        is_signed : whether tau may be negative
        """
        rotation, constant = self.summed_rotations(measured)
        if not measured.has_positions:
            return rotation, constant
        armed = self.a if self.a.any() else None
        graph = PoseGraph(rotation, self.b, self.tau, armed, measured.is_point, is_signed=is_signed)
        return replace(graph, nodes=measured.nodes) if measured.has_others else graph, constant

    def summed_rotations(self, measured: Graph) -> tuple[Graph, float]:
        """The same of rotations alone; the constant is rounded down."""
        n, edges, R = measured.num_nodes, measured.edges, measured.rotations
        general = of_couplings(n, edges, R, self.N)
        # Its cost has the traces of the polar factors as well.
        _, K, K_left = general.polar
        traces = np.concatenate([np.diagonal(A, axis1=1, axis2=2).ravel() for A in (K, K_left)])
        return general, math.nextafter(math.fsum(np.r_[self.constant, -traces]), -math.inf)

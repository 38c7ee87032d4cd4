"""The costs of other programs on graphs in which some edges measure positions or rotations alone.

Where a point is seen from a pose, or a position is measured from the world, the residual is y =
v - m in every program, for a measured m, in the frame of the first node. For lam below the smallest
eigenvalue of the information T and any b, y^T T y - lam |v - b|^2 is smallest at
y = -lam (T - lam)^-1 (b - m), so minorants lam |v - b|^2 + constant are those of
`certpgo.objective.marginalized` without rotations. Where T = t I, the cost is one itself.

Where a rotation is measured alone, a minorant of the same cost with any translational information
is one of the rotation at y = 0, and without its first term, which is not negative, everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from certpgo.graph import PoseGraph
from certpgo.graph.information import unmeasured
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.edge_cost import EdgeCost, Minorants
from certpgo.objective.marginalized import blocks, is_isotropic, remainder

#: Share of the smallest eigenvalue of T that a minorant keeps.
SHARE = 0.99


@dataclass(frozen=True, eq=False)
class WithPositions(EdgeCost):
    """The cost of a program on edges between poses, and of positions on the others.

    Attributes
    ----------
    graph : the measurements; those with kappa = 0 are of positions, and the rotational part of
        their information is zero; those with tau = 0 are of rotations, and the rest is zero
    between : the program's cost of relative poses
    """

    between: type[EdgeCost]

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in options and reports."""
        return self.between.name

    @property
    def provable(self) -> bool:  # type: ignore[override]
        """Whether the checker knows it."""
        return self.between.provable

    @property
    def turned_share(self) -> float:
        """That of the cost of relative poses."""
        return self._poses.turned_share

    @property
    def title(self) -> str:
        """What it is, in the words of the program's users."""
        return f"{self.between(self.graph).title}, and of positions"

    @cached_property
    def _positions(self) -> BoolArray:
        """(m,) which edges measure positions."""
        return ~self.graph.rotation.measures_rotation

    @cached_property
    def _poses(self) -> EdgeCost:
        """The cost of the other edges."""
        return self.between(self.graph.with_edges(~self._positions))

    @cached_property
    def weights(self) -> FloatArray:
        """(m, k, k) weights of the residuals: for positions their information, then zeros."""
        of_poses = self._poses.weights
        T, _, _ = blocks(self.graph.information_matrices[self._positions], self.graph.d)
        rest = of_poses.shape[1] - self.graph.d
        return self._joined(of_poses, np.pad(T, ((0, 0), (0, rest), (0, rest))))

    def _joined(self, of_poses: FloatArray, of_positions: FloatArray) -> FloatArray:
        """(m, ...) values of all edges from those of both kinds."""
        kind = np.result_type(of_poses, of_positions)
        out = np.empty((len(self._positions), *of_poses.shape[1:]), dtype=kind)
        out[~self._positions], out[self._positions] = of_poses, of_positions
        return out

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, k) residuals; those beyond translations are zero for positions."""
        whole, here = ~self._positions, self._positions
        of_poses = self._poses.residuals(v[whole], Q[whole])
        rest = of_poses.shape[1] - self.graph.d
        y = v[here] - self.graph.translations[here]
        return self._joined(of_poses, np.pad(y, ((0, 0), (0, rest))))

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives; see `EdgeCost.linearized`."""
        whole, here = ~self._positions, self._positions
        of_poses = self._poses.linearized(v[whole], Q[whole])
        k, d, count = of_poses[0].shape[1], self.graph.d, int(here.sum())
        y = v[here] - self.graph.translations[here]
        of_positions = (
            np.pad(y, ((0, 0), (0, k - d))),
            np.tile(np.eye(k, d), (count, 1, 1)),
            np.zeros((count, *of_poses[2].shape[1:])),
        )
        e, in_v, in_w = (self._joined(*pair) for pair in zip(of_poses, of_positions, strict=True))
        return e, in_v, in_w

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""
        whole, here = ~self._positions, self._positions
        T, _, _ = blocks(self.graph.information_matrices[here], self.graph.d)
        y = v[here] - self.graph.translations[here]
        of_positions = y.dot(Ball.exact(T).apply(y))
        if here.all():
            return of_positions
        of_poses = self._poses.enclosures(v[whole], Q[whole])
        mid = self._joined(of_poses.mid, of_positions.mid)
        return Ball(mid, self._joined(of_poses.radius, of_positions.radius))

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding."""
        whole, here = ~self._positions, self._positions
        of_poses = self._minorants_of_poses(v[whole], Q[whole])
        if whole.all():
            return of_poses
        of_positions = _minorants_of_positions(self.graph.with_edges(here), v[here])
        names = ("tau", "a", "b", "N", "constant")
        joined = Minorants(
            *(self._joined(getattr(of_poses, name), getattr(of_positions, name)) for name in names)
        )
        if of_poses.touching is None:
            return joined
        none = np.zeros((int(here.sum()), of_poses.touching.shape[1]))
        return replace(joined, touching=self._joined(of_poses.touching, none))

    def _minorants_of_poses(self, v: FloatArray, Q: FloatArray) -> Minorants:
        graph = self._poses.graph
        alone = ~graph.measures_translation
        if not alone.any():
            return self._poses.minorants(v, Q)
        d, information = graph.d, graph.information_matrices.copy()
        information[alone, :d, :d] = np.eye(d)
        filled = self.between(graph.with_information(information))
        found = filled.minorants(np.where(alone[:, None], graph.translations, v), Q)
        nothing = alone & ~found.N.any(axis=(1, 2))
        return replace(
            found,
            tau=np.where(alone, 0.0, found.tau),
            a=np.where(alone[:, None], 0.0, found.a),
            b=np.where(alone[:, None], 0.0, found.b),
            constant=np.where(nothing, -np.inf, found.constant),
        )

    def relaxed(self) -> WithPositions | None:
        """Of the edges between poses, with all of the positions' information."""
        below = self._poses.relaxed()
        if below is None:
            return None
        information = self.graph.information_matrices.copy()
        information[~self._positions] = below.graph.information_matrices
        return WithPositions(self.graph.with_information(information), self.between)


def _minorants_of_positions(graph: PoseGraph, v: FloatArray) -> Minorants:
    d, m = graph.d, graph.translations
    T, _, _ = blocks(graph.information_matrices, d)
    even = is_isotropic(T)
    lam = np.where(even, T[:, 0, 0], SHARE * np.linalg.eigvalsh(T)[:, 0])
    partial = unmeasured(T).any(axis=1)
    lam = np.where(partial, 1.0, lam)
    y = v - m
    b = m + np.where(even[:, None], 0.0, y - (T @ y[:, :, None])[:, :, 0] / lam[:, None])
    # Positions are not measured in a turned frame, whatever rotation an edge holds.
    unturned = Ball.exact(np.tile(np.eye(d), (len(lam), 1, 1)))
    _, _, constant = remainder(graph, unturned, lam, b)
    found = np.where(np.isfinite(constant.radius) & ~partial, constant.lower, -np.inf)
    zeros = np.zeros_like(b)
    N = np.zeros_like(graph.rotations)
    return Minorants(lam, zeros, b, N, np.where(even, 0.0, found))

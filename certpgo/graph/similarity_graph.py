"""Graphs of relative similarities: poses whose unit of length is unknown, as in monocular maps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from certpgo.errors import GraphError, InputError
from certpgo.graph.edges import chosen_nodes, induced
from certpgo.graph.estimate import check_scales
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import counted
from certpgo.graph.pose_graph import PoseGraph
from certpgo.graph.rotation_graph import RotationGraph
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_flags, frozen_floats


@dataclass(frozen=True, eq=False, repr=False)
class SimilarityGraph(PoseGraph):
    """Relative similarities between nodes, some of which have an unknown scale.

    A node's transform to the world is x -> A_i x + t_i, A_i = s_i R_i, and s_i is how many units of
    the world one of its own is: 1 for ordinary poses. An edge measures s_ij ~ s_j / s_i with R_ij,
    and t_ij in the unit of node i. Its term of the cost is

        kappa |A_j - s_ij A_i R_ij|_F^2 + tau |t_j - t_i - A_i t_ij|^2,

    in the world's unit; see docs/concepts/similarities.md. Points measure no scale.

    Attributes
    ----------
    scales : (m,) measured s_ij, positive; by default ones
    free : (n,) which poses have an unknown scale; by default all. Then the unit of the map is the
        root mean square of the scales, and the cost is divided by its square: it is that of maps
        in any unit

    Raises
    ------
    GraphError
        As `PoseGraph`; or scales that are not (m,) and positive, or a point with a scale.

    Examples
    --------
    Three maps in a row, each with a unit twice as long as the last one's:

    >>> import numpy as np
    >>> import certpgo
    >>> rotation = certpgo.RotationGraph(3, [[0, 1], [1, 2]], [np.eye(3)] * 2, kappa=np.ones(2))
    >>> steps = np.array([[4.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    >>> graph = certpgo.SimilarityGraph(rotation, steps, np.ones(2), scales=np.array([2.0, 2.0]))
    >>> answer = certpgo.solve(graph)
    >>> answer.verdict.value, answer.estimate.scales.round(6).tolist()
    ('CERTIFIED', [1.0, 2.0, 4.0])
    """

    scales: FloatArray = field(default_factory=lambda: np.ones(0))
    free: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    has_scales: ClassVar[bool] = True
    _area: ClassVar[str] = "square unit"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.arms is not None or self.rotation.is_general:
            raise GraphError("similarities have isotropic weights, without arms and couplings")
        m, n = self.num_edges, self.num_nodes
        scales = frozen_floats(self.scales if np.size(self.scales) else np.ones(m))
        check_scales("edge", scales, m)
        object.__setattr__(self, "scales", scales)
        free = np.array(self.free) if np.size(self.free) else ~self.is_point
        if free.shape != (n,):
            raise GraphError(f"free must be {n} flags, one per node")
        if (free & self.is_point).any():
            node = int(np.argmax(free & self.is_point))
            raise GraphError(f"node {node}: a point has no scale")
        object.__setattr__(self, "free", frozen_flags(free))

    @property
    def in_mean_unit(self) -> bool:
        """Whether no pose has a known scale, and the unit is the root mean square of all."""
        return bool(self.free[self.pose_nodes].all())

    @property
    def size_in_words(self) -> str:
        """Such as ``20 poses, 34 edges, 3D, 19 scales unknown``."""
        unknown = int(self.free.sum())
        return f"{super().size_in_words}, {counted(unknown, 'unknown scale{s}')}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        *weights, connected, following = super()._facts()
        yield from weights
        low, high = self.scales.min(), self.scales.max()
        yield "scales", f"relative scales {low:.4g} to {high:.4g}"
        yield from (connected, following)

    def with_matrix_weights(self, W: FloatArray) -> PoseGraph:
        """Refused: weights of similarities are isotropic."""
        raise InputError("similarities have isotropic weights, no matrix weights")

    def held_at(self, node: int) -> SimilarityGraph:
        """The same measurements where one pose alone has a known scale.

        That is another cost: its unit is that of the node, and the weights stay as they are.
        """
        free = ~self.is_point
        free[node] = False
        return SimilarityGraph(
            self.rotation,
            self.translations,
            self.tau,
            None,
            self.points,
            self.assumed,
            self.absolute,
            scales=self.scales,
            free=free,
        )

    def in_units_of(self, scales: FloatArray) -> SimilarityGraph:
        """The measurements where node i has a unit s_i times its own, and kappa is in these units.

        Estimates of the two graphs differ by the scales alone. Of an estimate's scales, the unknown
        ones are then near 1, and a rotation's residual counts in the unit of node j, that of a
        translation in node i's: the weights are kappa / s_j^2 and tau / s_i^2 in the world's.

        Parameters
        ----------
        scales : (n,) positive, 1 for poses of known scale
        """
        i, j = self.edges.T
        return replace(
            self,
            translations=scales[i, None] * self.translations,
            tau=self.tau / scales[i] ** 2,
            scales=self.scales * scales[i] / scales[j],
        )

    def subgraph(self, nodes: IntArray) -> SimilarityGraph:
        """The graph induced on ``nodes``, renumbered in that order."""
        nodes = chosen_nodes(nodes, self.num_nodes)
        _, chosen = induced(self.num_nodes, self.edges, nodes)
        points = None if self.points is None else self.points[nodes]
        return self._among(self.rotation.subgraph(nodes), chosen, points, self.free[nodes])

    def _check_besides(self) -> None:
        if self.information is not None:
            raise GraphError("similarities have isotropic weights, no information matrices")
        if self.blocks:
            raise GraphError("distances are not for nodes of unknown scale")

    def _with(
        self,
        rotation: RotationGraph,
        chosen: IntArray | BoolArray,
        points: BoolArray | None,
        blocks: tuple[Observations, ...],
    ) -> SimilarityGraph:
        return self._among(rotation, chosen, points, self.free)

    def _among(
        self,
        rotation: RotationGraph,
        chosen: IntArray | BoolArray,
        points: BoolArray | None,
        free: BoolArray,
    ) -> SimilarityGraph:
        assumed, absolute = (
            None if f is None else f[chosen] for f in (self.assumed, self.absolute)
        )
        t, tau, scales = self.translations[chosen], self.tau[chosen], self.scales[chosen]
        flags = assumed, absolute
        return SimilarityGraph(rotation, t, tau, None, points, *flags, scales=scales, free=free)

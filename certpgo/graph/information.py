"""Measured poses with their full information matrices."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import GraphError
from certpgo.graph.graph import PoseGraph, RotationGraph
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    frozen_floats,
    frozen_indices,
)
from certpgo.linalg.balls import Ball, is_positive_definite


@dataclass(frozen=True, eq=False)
class Information:
    """The information matrices of a file, each distinct one stored once.

    Attributes
    ----------
    distinct : (k, p, p) symmetric matrices, translation before rotation
    index : (m,) which of them belongs to each edge
    residual : the cost whose residuals they weigh in the program that the file is of, as named in
        `certpgo.costs`; None if that is not known

    Raises
    ------
    GraphError
        Matrices that are not square, finite and symmetric, or an index beyond them.
    """

    distinct: FloatArray
    index: IntArray
    residual: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "distinct", frozen_floats(self.distinct))
        object.__setattr__(self, "index", frozen_indices(self.index))
        shape = self.distinct.shape
        if len(shape) != 3 or shape[1] != shape[2] or self.index.ndim != 1:
            raise GraphError(f"information must be square matrices and an index, not {shape}")
        _refuse_asymmetric(self.distinct)
        if ((self.index < 0) | (self.index >= len(self.distinct))).any():
            raise GraphError(f"information matrices are numbered 0 to {len(self.distinct) - 1}")

    @property
    def matrices(self) -> FloatArray:
        """(m, p, p) matrices of the edges."""
        return np.asarray(self.distinct[self.index])

    @cached_property
    def is_definite(self) -> BoolArray:
        """(m,) which matrices are proven to be positive definite."""
        return np.asarray(is_positive_definite(Ball.exact(self.distinct))[self.index])

    def subset(self, chosen: IntArray | BoolArray) -> Information:
        """The matrices of some edges, given by index or mask (m,)."""
        return Information(self.distinct, self.index[chosen], self.residual)


@dataclass(frozen=True, eq=False)
class InformationGraph:
    """Relative poses between nodes, each with a full information matrix.

    Attributes
    ----------
    isotropic : the same measurements with the weights kappa and tau of the chordal cost
    information : (m, p, p) symmetric matrices, translation before rotation, p = 3 or 6; 1/m^2,
        1/m and dimensionless. What residual they weigh is the cost's: the rotational part refers to
        the vector part of a quaternion in g2o, to the tangent space in GTSAM

    Raises
    ------
    GraphError
        Matrices of another shape, not symmetric, not finite or beyond the range of weights.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.datasets.synthetic import helix
    >>> graph = helix(3, np.random.default_rng(0)).graph
    >>> information = np.tile(np.diag([4.0, 4, 4, 1, 1, 1]), (graph.num_edges, 1, 1))
    >>> full = InformationGraph(graph, information)
    >>> full.num_edges, bool(full.is_definite.all())
    (14, True)
    """

    isotropic: PoseGraph
    information: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "information", frozen_floats(self.information))
        m, p = self.num_edges, self.d * (self.d + 1) // 2
        if self.information.shape != (m, p, p):
            raise GraphError(
                f"information must be {(m, p, p)} matrices, not {self.information.shape}"
            )
        if not (np.abs(self.information) < FAR).all():
            raise GraphError(f"information must be finite, with entries below {FAR:.2g}")
        _refuse_asymmetric(self.information)

    @property
    def rotation(self) -> RotationGraph:
        """The graph of relative rotations."""
        return self.isotropic.rotation

    @property
    def rotations(self) -> FloatArray:
        """(m, d, d) measured rotations R_ij ~ R_i^T R_j."""
        return self.isotropic.rotation.rotations

    @property
    def translations(self) -> FloatArray:
        """(m, d) measured t_ij ~ R_i^T (t_j - t_i), metres."""
        return self.isotropic.translations

    @property
    def edges(self) -> IntArray:
        """(m, 2) node pairs (i, j)."""
        return self.isotropic.edges

    @property
    def num_nodes(self) -> int:
        """Number n of poses."""
        return self.isotropic.num_nodes

    @property
    def num_edges(self) -> int:
        """Number m of edges, parallel ones counted."""
        return self.isotropic.num_edges

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return self.isotropic.d

    @cached_property
    def is_definite(self) -> BoolArray:
        """(m,) which information matrices are proven to be positive definite."""
        return is_positive_definite(Ball.exact(self.information))

    def scaled(self, factor: float) -> InformationGraph:
        """The same measurements with all weights times ``factor``."""
        isotropic = self.isotropic.reweighted(np.full(self.num_edges, factor))
        other = InformationGraph(isotropic, factor * self.information)
        if math.frexp(factor)[0] == 0.5:  # a power of two rounds nothing
            other.__dict__["is_definite"] = self.is_definite
        return other

    def reweighted(self, factors: FloatArray) -> InformationGraph:
        """Information times factors (m,); an edge with factor 0 is removed."""
        kept = factors != 0.0
        information = factors[kept, None, None] * self.information[kept]
        return InformationGraph(self.isotropic.reweighted(factors), information)

    def with_edges(self, chosen: IntArray | BoolArray) -> InformationGraph:
        """All nodes with only the ``chosen`` edges, given by index or mask (m,)."""
        return InformationGraph(self.isotropic.with_edges(chosen), self.information[chosen])


def _refuse_asymmetric(information: FloatArray) -> None:
    """Refuse matrices (m, p, p) that are not finite and symmetric."""
    if not np.isfinite(information).all():
        raise GraphError("information must be finite")
    if (information != np.swapaxes(information, 1, 2)).any():
        raise GraphError("information matrices must be symmetric")

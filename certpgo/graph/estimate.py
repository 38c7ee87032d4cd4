"""Estimates: one absolute pose or rotation per node."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from certpgo.errors import GraphError, InputError, require
from certpgo.graph.display import Speaking
from certpgo.graph.keys import NO_KEYS, Keys
from certpgo.graph.phrases import counted
from certpgo.graph.picture import drawn
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray, chosen_rows, frozen_floats


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Speaking):
    """Absolute rotations, and translations if the problem has them.

    Attributes
    ----------
    rotations : (n, d, d), R_i world <- body i; a matrix of few digits is replaced by the nearest
        rotation
    translations : (n, d) origins t_i of the bodies in the world frame, metres; or None
    keys : ids, names and timestamps, as far as the source states them; `certpgo.write` writes
        them, and what is given with an instance is matched by them
    scales : (n,) how many units of the world one of the node's own is, positive; None where all
        nodes measure in the unit of the world. See `certpgo.SimilarityGraph`

    Raises
    ------
    GraphError
        A matrix is not a rotation (the worst is named), a translation is not finite, a scale is not
        positive, or the keys are of another number of nodes.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Estimate
    >>> Estimate(np.array([np.eye(3)] * 2), np.zeros((2, 3))).num_nodes
    2
    >>> Estimate(np.array([np.eye(3), 2.0 * np.eye(3)]))
    Traceback (most recent call last):
        ...
    certpgo.errors.GraphError: node 1: not a rotation, off by ...
    """

    rotations: FloatArray
    translations: FloatArray | None = None
    keys: Keys = NO_KEYS
    scales: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotations", frozen_floats(self.rotations))
        n = len(self.rotations)
        if self.rotations.shape not in {(n, 2, 2), (n, 3, 3)}:
            raise GraphError(
                f"rotations must be (n, d, d) with d = 2 or 3, not {self.rotations.shape}"
            )
        worst, defect = so.worst_defect(self.rotations)
        if not defect <= so.DEFECT_TOLERANCE:
            raise GraphError(f"node {worst}: {so.shortfall(self.rotations[worst], defect)}")
        if defect > so.ROUNDING_DEFECT:
            cleaned = frozen_floats(so.nearest_to_rounding(self.rotations))
            object.__setattr__(self, "rotations", cleaned)
        require(self.keys, Keys, "the Keys of an estimate")
        self.keys.require(n)
        if self.scales is not None:
            object.__setattr__(self, "scales", frozen_floats(self.scales))
            check_scales("node", self.scales, n)
        if self.translations is None:
            return
        object.__setattr__(self, "translations", frozen_floats(self.translations))
        if self.translations.shape != (n, self.d):
            raise GraphError(f"translations must be {(n, self.d)}, not {self.translations.shape}")
        if not np.isfinite(self.translations).all():
            bad = ~np.isfinite(self.translations).all(axis=1)
            raise GraphError(f"node {int(np.argmax(bad))}: translation is not finite")

    @classmethod
    def trusted(
        cls,
        rotations: FloatArray,
        translations: FloatArray | None = None,
        keys: Keys = NO_KEYS,
        scales: FloatArray | None = None,
    ) -> Estimate:
        """An estimate without checks, for matrices known to be rotations."""
        new = object.__new__(cls)
        object.__setattr__(new, "rotations", rotations)
        object.__setattr__(new, "translations", translations)
        object.__setattr__(new, "keys", keys)
        object.__setattr__(new, "scales", scales)
        return new

    @property
    def _headline(self) -> str:
        what = "rotation{s}" if self.translations is None else "pose{s}"
        what = what if self.scales is None else "pose{s} with scales"
        return f"{type(self).__name__}: {counted(self.num_nodes, what)}, {self.d}D"

    def _facts(self) -> Iterator[tuple[str, str]]:
        t = self.translations
        if t is not None and len(t):
            unit = "m" if self.scales is None else "units"
            extent = " x ".join(f"{length:.4g}" for length in np.ptp(t, axis=0))
            yield "extent", f"{extent} {unit}"
            steps = np.linalg.norm(np.diff(t, axis=0), axis=1)
            yield "path", f"{steps.sum():.4g} {unit} through all nodes in their order"
        if self.scales is not None and len(self.scales):
            yield "scales", f"{self.scales.min():.4g} to {self.scales.max():.4g}"
        yield from self.keys.facts()
        yield "next", "certpgo.certify(graph, estimate); certpgo.write(path, estimate)"

    def _picture(self) -> str:
        if self.translations is None:
            return ""
        return drawn(self.translations, np.empty((0, 2), np.intp), np.arange(self.num_nodes))

    @property
    def num_nodes(self) -> int:
        """Number n of nodes."""
        return len(self.rotations)

    @property
    def d(self) -> int:
        """Dimension of space, 2 or 3."""
        return int(self.rotations.shape[-1])

    def with_translations(self, translations: FloatArray | None) -> Estimate:
        """The same rotations with other translations."""
        if translations is not None and np.shape(translations) != (self.num_nodes, self.d):
            expected = (self.num_nodes, self.d)
            raise GraphError(f"translations must be {expected}, not {np.shape(translations)}")
        return Estimate.trusted(self.rotations, translations, self.keys, self.scales)

    def keyed(self, keys: Keys) -> Estimate:
        """The same poses with these keys."""
        keys.require(self.num_nodes)
        return Estimate.trusted(self.rotations, self.translations, keys, self.scales)

    def moved(
        self, rotation: FloatArray, translation: FloatArray | None = None, scale: float = 1.0
    ) -> Estimate:
        """The estimate in another world frame: S R_i and a S t_i + s (``rotation`` S is (d, d)).

        Unknown scales s_i become a s_i, for a positive ``scale`` a.
        """
        rotation = frozen_floats(rotation)
        offset = np.zeros(self.d) if translation is None else frozen_floats(translation)
        if rotation.shape != (self.d, self.d) or offset.shape != (self.d,):
            raise InputError(f"a rotation {(self.d, self.d)} and a shift ({self.d},) expected")
        require(scale, Real, "a number as scale")
        scales = None if self.scales is None else scale * self.scales
        if self.translations is None:
            return Estimate(rotation @ self.rotations, keys=self.keys, scales=scales)
        moved = scale * self.translations @ rotation.T + offset
        return Estimate(rotation @ self.rotations, moved, self.keys, scales)

    def anchored(self, node: int, like: Estimate | None = None) -> Estimate:
        """The estimate moved so that ``node`` is the identity at the origin, or as in ``like``."""
        require(node, Integral, "the number of a node")
        if like is not None:
            require(like, Estimate, "an Estimate to be like")
        for one in (self, like):
            if one is not None and not 0 <= node < one.num_nodes:
                raise InputError(f"node {node} is not among 0 to {one.num_nodes - 1}")
        node = int(node)
        R = self.rotations[node].T
        if self.translations is None:
            return self.moved(R if like is None else like.rotations[node] @ R)
        if like is not None and like.translations is not None:
            R = like.rotations[node] @ R
            return self.moved(R, like.translations[node] - R @ self.translations[node])
        return self.moved(R, -R @ self.translations[node])

    def subset(self, nodes: IntArray) -> Estimate:
        """The estimate of ``nodes`` alone, in that order."""
        nodes = chosen_rows(nodes, self.num_nodes, "nodes")
        translations = None if self.translations is None else self.translations[nodes]
        scales = None if self.scales is None else self.scales[nodes]
        return Estimate(self.rotations[nodes], translations, self.keys.subset(nodes), scales)


def check_scales(of: str, scales: FloatArray, count: int) -> None:
    """Refuse scales that are not ``count`` positive numbers, within 2^-100 and 2^100.

    Raises
    ------
    GraphError
        One is not, or there are more or fewer.
    """
    if scales.shape != (count,):
        raise GraphError(f"scales must be ({count},), not {scales.shape}")
    bad = ~((scales >= 2.0**-100) & (scales <= 2.0**100))
    if bad.any():
        k = int(np.argmax(bad))
        raise GraphError(f"{of} {k}: a scale is a positive number, not {scales[k]:g}")

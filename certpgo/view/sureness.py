"""How sure the positions of nodes are, to draw around them: certified regions and covariances."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from certpgo.certify import Certificate, Verdict
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Instance
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.marginals import Marginals
from certpgo.solve.likelihood import LEVEL, excesses, quantiles_of_nodes

#: Nodes drawn at most.
MOST = 40
#: The level in words.
SHOWN = f"{100.0 * LEVEL:g} %"
REGIONS, COVARIANCES = "certified regions", "covariances"


@dataclass(frozen=True, eq=False)
class Outlines:
    """Ellipsoids around positions, of which {x : (x - centre)^T shape^-1 (x - centre) <= 1}.

    Attributes
    ----------
    name : what they are
    nodes : (k,) whose they are, those of the placement
    centres : (k, 3) in its frame
    shapes : (k, 3, 3) planar ones have no extent along z
    sentence : what is drawn, and of how many nodes
    """

    name: str
    nodes: IntArray
    centres: FloatArray
    shapes: FloatArray
    sentence: str

    def wires(self, points: int = 24) -> FloatArray:
        """(s, 2, 3) lines of the ellipses along their principal planes, one in the plane."""
        values, axes = np.linalg.eigh(self.shapes)
        half = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        angles = np.linspace(0.0, 2.0 * np.pi, points + 1)
        circle = np.stack([np.cos(angles), np.sin(angles)])
        planes = [(1, 2)] if not values[:, 0].any() else [(0, 1), (0, 2), (1, 2)]
        rings = [
            self.centres[:, None] + np.einsum("kap,ps->ksa", half[:, :, list(plane)], circle)
            for plane in planes
        ]
        ends = [np.stack([ring[:, :-1], ring[:, 1:]], axis=2).reshape(-1, 2, 3) for ring in rings]
        return np.concatenate(ends)


@dataclass(frozen=True, eq=False)
class Sureness:
    """What is known of where an estimate's nodes are, to be computed when it is drawn.

    Attributes
    ----------
    instance, problem, certificate, estimate : the problem is what the certificate is of
    reference : the pose that all are seen from; by default that of the certificate
    """

    instance: Instance
    problem: Certifiable
    certificate: Certificate
    estimate: Estimate
    reference: int | None = None

    def outlines(
        self, nodes: IntArray, positions: FloatArray, extent: float
    ) -> tuple[Outlines, ...]:
        """Those of few nodes, evenly in their order, where they are no larger than the map.

        Parameters
        ----------
        nodes, positions : (k,), (k, 3) of the placement
        extent : of the map
        """
        graph = self.instance.graph
        if not graph.has_positions or graph.has_scales:
            return ()
        rows = np.arange(len(nodes))
        if len(nodes) > MOST:
            rows = np.linspace(0, len(nodes) - 1, MOST).round().astype(np.intp)
        seen = self.instance.named(self._seen_from)
        return tuple(
            _outlines(name, f"{said}, seen from {seen}", nodes, positions, shapes, rows, extent)
            for name, said, shapes in (*self._regions(), *self._covariances())
        )

    @property
    def _seen_from(self) -> int:
        """The reference, also where nothing is proven."""
        if self.reference is not None:
            return self.reference
        known, world = self.certificate.regions, self.instance.world
        if known is not None:
            return known.anchor
        return self.problem.tangent_layout.still(world)

    def _regions(self) -> Iterator[tuple[str, str, FloatArray]]:
        """The balls that hold each node, (n, 3, 3), if there are any."""
        known = self.certificate.regions
        if known is None or self.certificate.verdict is Verdict.UNDECIDED:
            return
        found = known.distance(self._seen_from, excesses(self.problem, LEVEL))
        if found is not None and found.metres is not None:
            said = "each holds its node in every estimate that the measurements do not exclude"
            yield REGIONS, said, _in_space(found.metres[:, None, None] ** 2 * np.eye(known.form.d))

    def _covariances(self) -> Iterator[tuple[str, str, FloatArray]]:
        """The ellipsoids of covariances (n, 3, 3), if the measurements determine all nodes."""
        part, anchor = self.instance, self._seen_from
        # Covariances of points are in the frame of the estimate, so that is the drawn one.
        world = part.world
        framed = self.estimate if world is None else self.estimate.anchored(world)
        d, R = framed.d, framed.rotations.copy()
        R[part.graph.is_point] = np.eye(d)
        with suppress(NumericalError):
            own = Marginals(self.problem, framed, anchor, part.held).covariances[:, :d, :d]
            scaled = quantiles_of_nodes(self.problem, LEVEL)[:, None, None] * own
            said = "of the measurements linearized at the estimate"
            yield COVARIANCES, said, _in_space(R @ scaled @ np.swapaxes(R, 1, 2))


def _in_space(shapes: FloatArray) -> FloatArray:
    """(n, 3, 3) of (n, d, d)."""
    n, d, _ = shapes.shape
    there = np.zeros((n, 3, 3))
    there[:, :d, :d] = shapes
    return there


def _outlines(
    name: str,
    said: str,
    nodes: IntArray,
    positions: FloatArray,
    shapes: FloatArray,
    rows: IntArray,
    extent: float,
) -> Outlines:
    """Those of the ``rows`` of a placement, but for the reference, and what is larger than it."""
    of_rows = shapes[nodes[rows]]
    across = 2.0 * np.sqrt(np.maximum(np.linalg.eigvalsh(of_rows)[:, -1], 0.0))
    large = ~(across <= extent)
    kept = ~large & (across > 0.0)
    sentence = f"{name.capitalize()} at {SHOWN}, {said}."
    if len(rows) < len(nodes):
        sentence += f" They are drawn of {len(rows):,} of {len(nodes):,} nodes, evenly."
    if large.any():
        count = counted(int(large.sum()), "node{s}")
        sentence += f" Left out, as larger than the map: those of {count}."
    return Outlines(name, nodes[rows][kept], positions[rows][kept], of_rows[kept], sentence)

"""Where nodes are, in metres and degrees: what `certpgo.certify.regions` proves, as data."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.errors import InputError, require
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.phrases import rounded_up
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import U as UNIT
from certpgo.objective.lifting import quarter_turn

#: Degrees of which nothing is known.
NO_LIMIT = 180.0


@dataclass(frozen=True, eq=False, repr=False)
class ProvenDistance(Brief):
    """How far each node can be from where any optimum has it, seen from one pose.

    Poses are compared in the frame of the reference: by how far, and by which angle, a node is
    elsewhere relative to that. All numbers are proven, despite rounding.

    Attributes
    ----------
    reference : the pose whose frame it is
    metres : (n,) for each node; None of rotations alone
    degrees : (n,) for each node: 180 where nothing is known, 0 for points
    scales : (n,) by which scales differ, 0 where they are known; None where all are. Metres are
        then in the unit of the reference

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> answer = certpgo.solve(helix(6, np.random.default_rng(0)).graph)
    >>> distance = answer.certificate.distance
    >>> metres, degrees = distance.largest
    >>> metres < 0.01, degrees < 0.1, distance.metres[distance.reference]
    (True, True, np.float64(0.0))
    """

    reference: int
    metres: FloatArray | None
    degrees: FloatArray
    scales: FloatArray | None = None

    @property
    def node(self) -> int:
        """The node that may be furthest off."""
        return int(np.argmax(self.degrees if self.metres is None else self.metres))

    @property
    def largest(self) -> tuple[float | None, float]:
        """The largest distance of any node, metres, and the largest angle of any, degrees."""
        metres = None if self.metres is None else float(self.metres.max())
        return metres, float(self.degrees.max())

    @property
    def median(self) -> tuple[float | None, float]:
        """The median of the nodes' distances, metres, and of their angles, degrees."""
        metres = None if self.metres is None else float(np.median(self.metres))
        return metres, float(np.median(self.degrees))

    def in_words(self, named: Callable[[int], str]) -> Iterator[tuple[str, str]]:
        """The largest and the median, rounded up, as names and values.

        Nothing of rotations alone where nothing is known of one.

        Parameters
        ----------
        named : what a node is called
        """
        if limits(self) == (None, None):
            return
        unit = "" if self.scales is None else ", in its unit"
        at = f"(most at {named(self.node)}; seen from {named(self.reference)}{unit})"
        yield "proven distance", f"within {apart(*self.largest)} of every optimum  {at}"
        metres, degrees = self.median
        half = f"half of the nodes within {apart(metres, degrees)}"
        if metres is not None:  # turns are of another half, and points have none
            turned = f", half within {apart(None, degrees)}" if 0.0 < degrees < NO_LIMIT else ""
            half = f"half of the nodes within {rounded_up(metres, 3)} m{turned}"
        yield "", half

    def sentence(self, named: Callable[[int], str]) -> str:
        """The same as a sentence; empty where nothing is known."""
        words = " ".join("; ".join(value for _, value in self.in_words(named)).split())
        return words and f"{words[0].upper()}{words[1:]}."


@dataclass(frozen=True, eq=False, repr=False)
class Region(Brief):
    """Where a node is, seen from a pose, in every estimate up to some cost.

    All of them are inside, however far from the estimate in the centre, which need not be an
    optimum; not all that is inside costs as little. The set is an ellipsoid of U = [u V], what the
    relative pose differs by from the centre: u in metres, and V = R - R' of rotations. ``metres``
    and ``degrees`` follow from it. All numbers are proven, despite rounding.

    Attributes
    ----------
    node, reference : the node, and the pose in whose frame it is
    position : (d,) of the node in the centre, metres; None of rotations alone
    rotation : (d, d) of the node in the centre, times its scale if that is unknown; None for points
    metres : radius of the ball of positions; None of rotations alone
    degrees : largest angle from the centre: 180 where nothing is known, 0 for points
    scale : by which the scale differs at most; 0 where it is known
    shape : (b, b) with tr(U shape^-1 U^T) <= 1. Its first row is that of u; where distances are
        measured in the plane, the first two, of u and u turned by 90 degrees

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(6, 0.3, 1)
    >>> answer = certpgo.solve(instance.graph)
    >>> region = answer.region(3, 0, excess=0.001)
    >>> print(f"{region.degrees:.2f}")
    1.58
    >>> region.holds(answer.estimate), region.holds(around)
    (True, False)
    """

    node: int
    reference: int
    position: FloatArray | None
    rotation: FloatArray | None
    metres: float | None
    degrees: float
    scale: float
    shape: FloatArray

    def holds(self, estimate: Estimate) -> bool:
        """Whether an estimate has the node inside: False only if it is outside despite rounding.

        Raises
        ------
        InputError
            An estimate of another graph.
        """
        require(estimate, Estimate, "an estimate")
        known = self.rotation if self.position is None else self.position
        other = known is None or len(known) != estimate.d
        other |= self.position is not None and estimate.translations is None
        if other or max(self.node, self.reference) >= estimate.num_nodes:
            raise InputError(f"an estimate of the graph expected, not {estimate!r}")
        position, rotation = seen_from(estimate, self.node, self.reference)
        U, off = np.zeros((estimate.d, 0)), np.zeros(0)
        if self.rotation is not None:
            U = rotation - self.rotation
            off = np.full(len(U), np.linalg.norm(rotation, 2) + np.linalg.norm(self.rotation, 2))
        if self.position is not None and position is not None:
            u = position - self.position
            columns = [u[:, None]]
            if len(self.shape) > U.shape[1] + 1:
                columns.append(quarter_turn(u)[:, None])
            U = np.concatenate([*columns, U], axis=1)
            far = np.linalg.norm(position) + np.linalg.norm(self.position)
            off = np.concatenate([np.full(len(columns), far), off])
        return _is_inside(self.shape, U, 16.0 * UNIT * off)


def _is_inside(shape: FloatArray, columns: FloatArray, off: FloatArray) -> bool:
    """Whether tr(U shape^-1 U^T) <= 1 for some U whose entries are as far off as these (b,).

    More than the rounding of the factorization and of the solution is put on the diagonal of the
    shape, scaled to one.
    """
    from scipy.linalg import solve_triangular

    size, b = np.sqrt(np.maximum(np.diagonal(shape), np.finfo(float).tiny)), len(shape)
    L = np.linalg.cholesky(shape / np.outer(size, size) + 32.0 * b * b * UNIT * np.eye(b))
    found = np.abs(solve_triangular(L, (columns / size).T, lower=True))
    found -= 1.01 * (np.abs(np.linalg.inv(L)) @ (off / size))[:, None]
    return bool((np.maximum(found, 0.0) ** 2).sum() <= 1.0 + 64.0 * UNIT)


def limits(
    found: ProvenDistance | None, node: int | None = None
) -> tuple[float | None, float | None]:
    """Metres and degrees of a node, or the largest of any; None where nothing is known."""
    if found is None:
        return None, None
    metres, degrees = found.largest
    if node is not None:
        metres = None if found.metres is None else float(found.metres[node])
        degrees = float(found.degrees[node])
    return metres, degrees if degrees < NO_LIMIT else None


def apart(metres: float | None, degrees: float | None) -> str:
    """A distance and an angle in words, rounded up."""
    turned = "any angle"
    if degrees is not None and degrees < NO_LIMIT:
        turned = f"{rounded_up(degrees, 3)} degrees"
    return turned if metres is None else f"{rounded_up(metres, 3)} m and {turned}"


def seen_from(
    estimate: Estimate, node: int, reference: int
) -> tuple[FloatArray | None, FloatArray]:
    """Position (d,) and rotation (d, d) of a node in the frame of a pose, times its scale."""
    R, t, s = estimate.rotations, estimate.translations, estimate.scales
    turned = R[reference].T @ R[node] * (1.0 if s is None else s[node])
    return None if t is None else (t[node] - t[reference]) @ R[reference], turned

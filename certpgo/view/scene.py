"""What there is to draw of a graph and its estimates, for pages and for the viewer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import InputError
from certpgo.graph import Instance
from certpgo.graph.kinds import PRIORS, RELATIVE, Kind
from certpgo.io.surfaces import Surface
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, round_below
from certpgo.view.sureness import Outlines, Sureness

#: The value of what an edge does not measure.
NOT_MEASURED = -1.0
#: Quantile of values that gets the last colour; larger ones share it.
TOP = 0.98
#: Length of a frustum over the median step, and its least and largest share of the extent.
FRUSTUM, LEAST, MOST = 0.4, 0.01, 0.05
#: Poses drawn at most for each estimate.
POSES = 600
#: What positions are that were estimated, in metres and in a map's own unit.
IN_METRES = "Nodes are drawn at their positions, in metres."
IN_UNITS = "Nodes are drawn at their positions, in the map's unit of length."
AT_POSITIONS = {"m": IN_METRES, "units": IN_UNITS}

#: Corners and lines of a camera, which looks along z, and of an arrow along x.
_CAMERA = np.array([[0, 0, 0], [-0.7, -0.5, 1], [0.7, -0.5, 1], [0.7, 0.5, 1], [-0.7, 0.5, 1]])
_RAYS = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]])
_ARROW = np.array([[1.2, 0, 0], [-0.4, 0.5, 0], [-0.4, -0.5, 0]])
_SIDES = np.array([[0, 1], [1, 2], [2, 0]])

#: Viridis, sampled; the pages' script has the same.
STOPS = np.array(
    [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ]
)


#: Colours of small and large shares that are seen on a light and on a dark background.
EITHER = np.array([[110.0, 140.0, 180.0], [225.0, 85.0, 20.0]])
#: Red, green and blue, 0 to 255.
Rgb = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Measure:
    """A number of each edge, to colour it by.

    Attributes
    ----------
    unit : what it is, such as ``"degrees"``
    values : (m,); `NOT_MEASURED` where the edge does not measure it
    """

    unit: str
    values: FloatArray

    @cached_property
    def top(self) -> float:
        """The value with the last colour, not dominated by a few outliers."""
        finite = self.values[np.isfinite(self.values) & (self.values >= 0.0)]
        if not len(finite):
            return 0.0
        return float(np.quantile(finite, TOP)) or float(finite.max())

    @property
    def shares(self) -> FloatArray:
        """(m,) values over the top, from 0 to 1; 0 where nothing is measured."""
        if not self.top > 0.0:
            return np.zeros(len(self.values))
        return np.clip(self.values / self.top, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Placement:
    """Where one estimate puts nodes.

    Attributes
    ----------
    name : of the estimate
    nodes : (k,) nodes of the scene, in the order of their ids
    positions : (k, 3) in the world or the layout; planar ones have z = 0
    rotations : (k, 3, 3) world <- body; planar ones turn about z
    measures : residuals of the scene's edges; none for a trajectory alone, or a truth
    """

    name: str
    nodes: IntArray
    positions: FloatArray
    rotations: FloatArray
    measures: tuple[Measure, ...] = ()

    def spread(self, n: int) -> FloatArray:
        """(n, 3) positions of all nodes; not a number where one is not placed."""
        everywhere = np.full((n, 3), np.nan)
        everywhere[self.nodes] = self.positions
        return everywhere


@dataclass(frozen=True, eq=False)
class Box:
    """A box around points along their principal axes.

    Attributes
    ----------
    centre : (3,) of the box
    axes : (3, 3) rows right, up and towards the viewer, by falling extent; right-handed
    half : (3,) half of the box's sides, along the axes
    """

    centre: FloatArray
    axes: FloatArray
    half: FloatArray

    @property
    def corner(self) -> FloatArray:
        """(3,) the corner on the left, below and at the back."""
        return np.asarray(self.centre - self.half @ self.axes)

    @property
    def extent(self) -> float:
        """The longest side; 1 for a single point."""
        return float(2.0 * self.half.max()) or 1.0


@dataclass(frozen=True, eq=False)
class Scene:
    """What there is to draw of n nodes and m edges: measurements, then distances.

    Everything is in the frame of the last placement; others are aligned with it.

    Attributes
    ----------
    name : of the graph, or the file
    d : dimension of space, 2 or 3
    ids : (n,) node ids
    edges : (m, 2) nodes that are joined; both ends of a prior are its node
    kinds : (m,) a `certpgo.graph.kinds.Kind` each
    rejected : (m,) measurements that the last estimate does without
    landmarks : (n,) which nodes are points
    placements : of each estimate, the answer last
    truth : the truth's, aligned with the answer; None if it is not known
    weights : of edges, where they differ
    surfaces : clouds and meshes by name, in the answer's frame and unit
    sentence : what positions are
    metric : whether positions were estimated, not arranged
    length_unit : ``"m"`` or ``"units"``
    verdict : of the last placement, if a certificate came with it, and what it is about
    sureness : what is known of where its nodes are; None without a certificate
    """

    name: str
    d: int
    ids: IntArray
    edges: IntArray
    kinds: IntArray
    rejected: BoolArray
    landmarks: BoolArray
    placements: tuple[Placement, ...]
    truth: Placement | None = None
    weights: tuple[Measure, ...] = ()
    surfaces: tuple[tuple[str, Surface], ...] = ()
    sentence: str = IN_METRES
    metric: bool = True
    length_unit: str = "m"
    verdict: str = ""
    sureness: Sureness | None = None

    @cached_property
    def outlines(self) -> tuple[Outlines, ...]:
        """How sure the positions of the last placement are."""
        if self.sureness is None or not self.placements:
            return ()
        answer = self.placements[-1]
        return self.sureness.outlines(answer.nodes, answer.positions, self.frame.extent)

    def are(self, *kinds: Kind) -> BoolArray:
        """(m,) which edges are of one of these kinds."""
        return np.isin(self.kinds, kinds)

    @property
    def are_steps(self) -> BoolArray:
        """(m,) which edges are between poses whose ids are consecutive."""
        i, j = self.ids[self.edges].T
        return np.asarray(self.are(*RELATIVE) & (np.abs(i - j) == 1))

    @property
    def are_loops(self) -> BoolArray:
        """(m,) which edges are between other poses."""
        return self.are(*RELATIVE) & ~self.are_steps

    @cached_property
    def frame(self) -> Box:
        """Around the last placement, and all surfaces."""
        around = [placement.positions for placement in self.placements[-1:]]
        around += [surface.points for _, surface in self.surfaces]
        return frame_of(np.concatenate(around), self.d)

    @cached_property
    def frustum(self) -> float:
        """Length at which a pose is drawn."""
        steps = [self.steps(placement) for placement in self.placements[-1:]]
        lengths = np.concatenate(
            [np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) for ends in steps] or [np.zeros(0)]
        )
        moved = lengths[lengths > 0.0]
        size = FRUSTUM * float(np.median(moved)) if len(moved) else 0.0
        return float(np.clip(size, LEAST * self.frame.extent, MOST * self.frame.extent))

    @property
    def is_flat(self) -> bool:
        """Whether all is in a plane, which is then seen from straight above."""
        return bool(self.frame.half[2] <= 1e-3 * self.frame.extent)

    @property
    def bar(self) -> float:
        """A round length, 1, 2 or 5 times a power of ten, that is about a fifth of the extent."""
        return round_below(0.2 * self.frame.extent)

    @property
    def units(self) -> list[str]:
        """What edges can be coloured by."""
        measures = [*(m for p in self.placements[-1:] for m in p.measures), *self.weights]
        return [measure.unit for measure in measures]

    def unit(self, colour: str | None) -> str:
        """The unit that colours edges: the chosen one, by default the first; empty without any.

        Raises
        ------
        InputError
            No edge has the chosen one.
        """
        if colour is not None and colour not in self.units:
            known = ", ".join(self.units) or "none here"
            raise InputError(f"edges can be coloured by {known}; not by {colour}")
        return colour or next(iter(self.units), "")

    def colours(
        self, placement: Placement, unit: str, drawn: BoolArray, *, dark: bool | None
    ) -> NDArray[np.uint8]:
        """(e, 3) colours of the ``drawn`` edges (m,); grey where the unit is not measured."""
        chosen = np.full((int(drawn.sum()), 3), 128, dtype=np.uint8)
        measure = self.measure(placement, unit)
        if measure is not None:
            known = measure.values[drawn] >= 0.0
            chosen[known] = colours(measure.shares[drawn][known], dark=dark)
        return chosen

    def measure(self, placement: Placement, unit: str) -> Measure | None:
        """The measure of edges in a placement by its unit; None if there is none."""
        found = [m for m in (*placement.measures, *self.weights) if m.unit == unit]
        return found[0] if found else None

    def joins(self, placement: Placement) -> BoolArray:
        """(m,) which edges are between nodes that it places."""
        placed = np.zeros(len(self.ids), dtype=bool)
        placed[placement.nodes] = True
        return np.asarray(placed[self.edges].all(axis=1))

    def ends(self, placement: Placement, chosen: BoolArray) -> FloatArray:
        """(e, 2, 3) both ends of the ``chosen`` edges (m,), as `joins` allows."""
        return np.asarray(placement.spread(len(self.ids))[self.edges[chosen]])

    def steps(self, placement: Placement) -> FloatArray:
        """(s, 2, 3) both ends of the trajectory's steps, or without any, of all edges."""
        if not len(self.edges):
            return np.stack([placement.positions[:-1], placement.positions[1:]], axis=1)
        drawn = self.are_steps if self.are_steps.any() else self.are_loops
        return self.ends(placement, drawn & self.joins(placement))

    def poses(self, placement: Placement) -> IntArray:
        """(k,) rows of the placement that are poses, in the order of their ids."""
        return np.flatnonzero(~self.landmarks[placement.nodes])

    @property
    def frustum_lines(self) -> FloatArray:
        """(s, 2, 3) lines of a pose in its frame: a camera's frustum along z, in 2D an arrow.

        Rotations alone look along the axis that they turn most, so that a full turn can be seen.
        """
        corners, lines = (_ARROW, _SIDES) if self.d == 2 else (_CAMERA, _RAYS)
        if self.d == 3 and not self.metric:
            mean = self.placements[-1].rotations.mean(axis=0)
            steadiness = np.linalg.norm(mean, axis=0).round(6)
            corners = np.roll(corners, int(np.argmin(steadiness)) + 1, axis=1)
        return np.asarray(self.frustum * corners[lines])

    def frusta(self, placement: Placement, most: int = POSES) -> FloatArray:
        """(s, 2, 3) lines of its poses, chosen evenly if there are more than ``most``."""
        rows = self.poses(placement)
        if len(rows) > most:
            rows = rows[np.linspace(0, len(rows) - 1, most).round().astype(np.intp)]
        turned = np.einsum("kab,seb->ksea", placement.rotations[rows], self.frustum_lines)
        turned += placement.positions[rows, None, None]
        return np.asarray(turned.reshape(-1, 2, 3))


def frame_of(points: FloatArray, d: int = 3) -> Box:
    """The box of points (p, 3) along their principal axes; planar ones are seen from above."""
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred)
    axes = vectors.T[np.argsort(-values, kind="stable")]
    if d == 2:
        axes[2] = (0.0, 0.0, 1.0)
        axes[0] = axes[0] - axes[0, 2] * axes[2]
        length = float(np.linalg.norm(axes[0]))
        axes[0] = axes[0] / length if length > 0.0 else (1.0, 0.0, 0.0)
    for k in (0, 2):
        axes[k] *= np.sign(axes[k, np.argmax(np.abs(axes[k]))])
    axes[1] = np.cross(axes[2], axes[0])
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return Box(0.5 * (low + high) @ axes, axes, 0.5 * (high - low))


def drawn_edges(instance: Instance) -> IntArray:
    """(m, 2) nodes that measurements join as drawn, without the world."""
    measured = instance.measurements
    return np.where(measured.are(*PRIORS)[:, None], measured.edges[:, 1:], measured.edges)


def colours(shares: FloatArray, *, dark: bool | None = False) -> NDArray[np.uint8]:
    """(k, 3) colours of shares (k,); large ones stand out on a light or ``dark`` background.

    With None they are seen on both.
    """
    at = np.clip(shares, 0.0, 1.0)
    if dark is None:
        return np.asarray((EITHER[0] + at[:, None] * (EITHER[1] - EITHER[0])).round(), np.uint8)
    place = (0.2 + 0.8 * at if dark else 0.88 * (1.0 - at)) * (len(STOPS) - 1)
    channels = [np.interp(place, np.arange(len(STOPS)), STOPS[:, c]) for c in range(3)]
    return np.stack(channels, axis=1).round().astype(np.uint8)

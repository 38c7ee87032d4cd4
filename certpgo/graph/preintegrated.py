"""Preintegrated inertial measurements between poses, whose velocities are points.

A pose with a velocity has one more node, the point p + T v where it would be after a unit of time T
without any force. What is integrated between two poses, dt seconds apart, from the biases that are
given (Forster et al., T-RO 2017), are a rotation, which is an edge of the graph, and two steps in
the frame of the first pose, without gravity:

    e_v = v_j - v_i - R_w g dt - R_i dv,
    e_p = p_j - p_i - v_i dt - R_w g dt^2/2 - R_i dp - lag e_v,

where g is gravity in the frame of a node w. That is the world where something else is measured in
it: gravity is known. Where nothing is, R_w g is any vector of that length: its direction is
estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.edges import broadcast, check_edges, check_weights, edge_name
from certpgo.graph.estimate import Estimate
from certpgo.graph.kinds import Kind
from certpgo.graph.observations import Observations
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_floats, frozen_indices

#: Largest numbers: products of them are far from overflow.
LARGEST = 2.0**100
#: The nodes of a measurement: pose i and its velocity, pose j and its velocity, where gravity is.
A, VA, B, VB, W = range(5)
#: Whose products one step's cost consists of, a row each, for e_v and e_p; and the row with its
#: residual. Rows from w are twice there.
POSITIONS = ((A, VA), (A, B), (A, VB), (B, VA), (B, VB), (VA, VB))
FROM_W = ((W, A), (W, VA), (W, B), (W, VB))
TURN = (A, W)
PAIRS = np.array([*POSITIONS, *FROM_W, *FROM_W, TURN])
MAIN = 1


@dataclass(frozen=True, eq=False, repr=False)
class Preintegrated(Observations):
    """Steps of velocities and positions between poses, with fixed biases.

    Their cost is w_v |e_v|^2 + w_p |e_p|^2, see `certpgo.graph.preintegrated`. Where the noise of
    both is correlated, and that of neither depends on the direction, e_p less a lag times e_v is
    independent of e_v: with white noise of the accelerometer for lag = dt/2.

    Attributes
    ----------
    num_nodes : number n of nodes of the graph that they belong to
    nodes : (k, 5) pose i and the point of its velocity, pose j and that of its, and the node in
        whose frame gravity is given
    seconds : (k,) dt, positive
    units : (k,) T, a power of two of seconds, and 2 (dt - lag) at least
    lags : (k,) between 0 and dt, seconds
    velocity_steps : (k, 3) dv in the frame of pose i, m/s
    position_steps : (k, 3) dp - lag dv in the frame of pose i, metres
    gravity : (k, 3) g in the frame of node w, m/s^2
    weights : (k, 2) w_v and w_p, inverse variances of each coordinate, s^2/m^2 and 1/m^2

    Raises
    ------
    GraphError
        A number out of range, or a node with two velocities.

    Examples
    --------
    Two poses, a second apart, at rest on the ground:

    >>> import numpy as np
    >>> from certpgo.graph.preintegrated import Preintegrated
    >>> nodes, g = np.array([[0, 1, 2, 3, 4]]), np.array([[0.0, 0.0, -9.81]])
    >>> dt, ones = np.ones(1), np.ones((1, 2))
    >>> block = Preintegrated(5, nodes, dt, 2.0 * dt, 0.0 * dt, -g, -0.5 * g, g, ones)
    >>> block.num_measurements, block.edges.shape
    (2, (30, 2))
    """

    kind: ClassVar[Kind] = Kind.INERTIAL
    places: ClassVar[bool] = False

    edges: IntArray = field(init=False)
    nodes: IntArray
    seconds: FloatArray
    units: FloatArray
    lags: FloatArray
    velocity_steps: FloatArray
    position_steps: FloatArray
    gravity: FloatArray
    weights: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", frozen_indices(self.nodes))
        for name in self._columns[1:]:
            object.__setattr__(self, name, frozen_floats(getattr(self, name)))
        k = len(self.nodes)
        widths = dict.fromkeys(("velocity_steps", "position_steps", "gravity"), 3)
        widths |= {"nodes": 5, "weights": 2}
        for name in self._columns:
            shape = (k, widths[name]) if name in widths else (k,)
            if getattr(self, name).shape != shape:
                raise GraphError(f"{name} must be {shape}, not {getattr(self, name).shape}")
        rows = self.nodes[:, PAIRS].reshape(k, -1, 2)
        object.__setattr__(self, "edges", frozen_indices(np.tile(rows, (1, 2, 1)).reshape(-1, 2)))
        check_edges(self.edges, self.num_nodes)
        self._check_values()

    def _check_values(self) -> None:
        pairs = self.nodes[:, [A, B]]
        for name in ("velocity_steps", "position_steps", "gravity"):
            bad = ~(np.abs(getattr(self, name)) < LARGEST).all(axis=1)
            if bad.any():
                raise GraphError(
                    f"{edge_name(pairs, bad)}: {name} must be finite and below {LARGEST:.2g}"
                )
        for name, weights in zip("vp", self.weights.T, strict=True):
            check_weights(f"weight of e_{name}", weights, pairs)
        dt, lag, unit = self.seconds, self.lags, self.units
        if (bad := ~((dt > 0.0) & (dt < LARGEST))).any():
            raise GraphError(f"{edge_name(pairs, bad)}: seconds must be finite and positive")
        if (bad := ~((lag >= 0.0) & (lag <= dt))).any():
            raise GraphError(f"{edge_name(pairs, bad)}: a lag is between 0 and the seconds")
        if (bad := ~((np.frexp(unit)[0] == 0.5) & (unit >= 2.0 * (dt - lag)))).any():
            said = "a unit of time is a power of two, and twice the seconds less the lag at least"
            raise GraphError(f"{edge_name(pairs, bad)}: {said}")
        owners = np.concatenate([self.nodes[:, [A, VA]], self.nodes[:, [B, VB]]])
        known = np.unique(np.column_stack([owners, np.tile(unit, 2)]), axis=0)
        for column, said in ((0, "two velocities, or units"), (1, "the velocities of two poses")):
            which, counts = np.unique(known[:, column], return_counts=True)
            if (counts > 1).any():
                node = int(which[np.argmax(counts > 1)])
                raise GraphError(f"node {node}: {said} in preintegrated measurements")

    @property
    def kinds(self) -> IntArray:
        """(r,) what each row measures: all but two of a measurement's are products of nodes."""
        kinds = np.full((2 * len(self.nodes), len(PAIRS)), Kind.PRODUCT)
        kinds[:, MAIN] = self.kind
        return kinds.ravel()

    @property
    def turned(self) -> IntArray:
        """The nodes whose rotations they hold, if only in part."""
        return self.nodes[:, [A, W]].ravel()

    @property
    def columns(self) -> dict[str, Any]:
        """The attributes with a row for each measurement."""
        return {name: getattr(self, name) for name in self._columns}

    @property
    def _columns(self) -> list[str]:
        return [one.name for one in fields(self) if one.name not in ("num_nodes", "edges")]

    def _chosen(self, chosen: IntArray | BoolArray) -> Self:
        """Some measurements, by index or mask (k,)."""
        return replace(self, **{name: of[chosen] for name, of in self.columns.items()})

    def subset(self, chosen: IntArray | BoolArray) -> Self:
        """The measurements whose first residual is among the ``chosen`` rows."""
        main = np.arange(MAIN, self.num_edges, 2 * len(PAIRS))
        return self._chosen(np.flatnonzero(np.isin(main, np.arange(self.num_edges)[chosen])))

    def between(self, nodes: IntArray) -> Self | None:
        """Those between some nodes (l,), numbered 0 ... l-1 in that order; None without any."""
        place = np.full(self.num_nodes, -1)
        place[nodes] = np.arange(len(nodes))
        found = place[self.nodes]
        inside = np.flatnonzero((found >= 0).all(axis=1))
        if not len(inside):
            return None
        return replace(self._chosen(inside), num_nodes=len(nodes), nodes=found[inside])

    def reweighted(self, factors: FloatArray) -> Self:
        """The measurements with weights times the factors of the rows of their residuals.

        Those with factor 0 are removed.

        Raises
        ------
        GraphError
            One of the two steps of a measurement is removed alone.
        """
        rows = broadcast(factors, self.num_edges).reshape(-1, 2, len(PAIRS))[:, :, MAIN]
        kept = (rows != 0.0).any(axis=1)
        one = self._chosen(kept)
        return replace(one, weights=rows[kept] * one.weights)

    @staticmethod
    def joined(num_nodes: int, parts: Any, nodes: Any) -> Preintegrated:
        """All measurements of several blocks, whose nodes have these numbers among all."""
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in parts[0]._columns
        }
        columns["nodes"] = np.concatenate(
            [to[part.nodes] for part, to in zip(parts, nodes, strict=True)]
        )
        whole: Preintegrated = replace(parts[0], num_nodes=num_nodes, **columns)
        return whole

    def velocities(self, point: Estimate) -> tuple[IntArray, FloatArray]:
        """The poses that have velocities, ascending, and these in the estimate's frame.

        As (q,) nodes and (q, 3) m/s.
        """
        owners = np.concatenate([self.nodes[:, [A, VA]], self.nodes[:, [B, VB]]])
        poses, first = np.unique(owners[:, 0], return_index=True)
        t, unit = np.asarray(point.translations), np.tile(self.units, 2)[first]
        return poses, (t[owners[first, 1]] - t[poses]) / unit[:, None]

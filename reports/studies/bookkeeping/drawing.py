"""Random small graphs as plain arrays: any mix of measurements, with their full information."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import certpgo
from certpgo import Graph, Instance, Ranges
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import Information

Array = Any
#: Standard deviations of measurements: radians, and metres where steps are about one.
NOISES = (0.0, 1e-3, 0.05, 0.3)


@dataclass(frozen=True)
class Measurements:
    """What was measured between poses, points and the world, in this order.

    Attributes
    ----------
    d : 2 or 3
    R, t : (n, d, d) and (n, d) true poses; the world is the identity
    ids : (n,) ascending; the world's is not written
    points : (n,) which nodes are points
    world : whether the last node is the world
    apart : id of the first point, where points are numbered apart from poses in files; else 0
    moved : (m,) whether the step is measured; None for all
    held : nodes that stay where they are
    far : how far positions are from the origin of their file, metres
    edges : (m, 2) from a pose or the world, to a pose or a point
    turns, steps : (m, d, d) and (m, d) measured
    turned : (m,) whether the rotation is measured
    information : (m, p, p) translation first; zero for what is not measured
    pairs, distances, precisions : (k, 2), (k,) and (k,) distances between nodes
    """

    d: int
    R: Array
    t: Array
    ids: Array
    points: Array
    world: bool
    edges: Array
    turns: Array
    steps: Array
    turned: Array
    information: Array
    pairs: Array
    distances: Array
    precisions: Array
    apart: int = 0
    moved: Array | None = None
    held: tuple[int, ...] = ()
    far: float = 0.0

    @property
    def n(self) -> int:
        """Number of nodes."""
        return len(self.R)

    @property
    def m(self) -> int:
        """Number of measurements, without distances."""
        return len(self.edges)

    @property
    def kappa(self) -> Array:
        """(m,) d / (2 tr(O_R^-1)) in space and O_R in the plane; 0 without a measured rotation."""
        d, omega = self.d, self.information[:, self.d :, self.d :]
        return omega[:, 0, 0] if d == 2 else 0.5 * _harmonic(omega)

    @property
    def tau(self) -> Array:
        """(m,) d / tr(O_t^-1)."""
        return _harmonic(self.information[:, : self.d, : self.d])

    def subset(self, chosen: Array) -> Measurements:
        """All nodes with some of the measurements, and all distances."""
        return replace(
            self,
            edges=self.edges[chosen],
            turns=self.turns[chosen],
            steps=self.steps[chosen],
            turned=self.turned[chosen],
            moved=None if self.moved is None else self.moved[chosen],
            information=self.information[chosen],
        )

    def induced(self, nodes: Array) -> Measurements:
        """Some nodes, ascending, with what is measured between them."""
        inside = np.isin(self.edges, nodes).all(axis=1)
        part, near = self.subset(inside), np.isin(self.pairs, nodes).all(axis=1)
        return replace(
            part,
            R=self.R[nodes],
            t=self.t[nodes],
            ids=self.ids[nodes],
            points=self.points[nodes],
            world=self.world and self.n - 1 in nodes,
            edges=np.searchsorted(nodes, part.edges),
            held=tuple(np.flatnonzero(np.isin(nodes, self.held)).tolist()),
            pairs=np.searchsorted(nodes, self.pairs[near]),
            distances=self.distances[near],
            precisions=self.precisions[near],
        )

    @property
    def graph(self) -> Graph:
        """With the isotropic weights."""
        rotation = RotationGraph(self.n, self.edges, self.turns, self.kappa)
        points = self.points if self.points.any() else None
        of_world = self.edges[:, 0] == self.n - 1 if self.world else None
        return PoseGraph(rotation, self.steps, self.tau, points=points, absolute=of_world)

    @property
    def instance(self) -> Instance:
        """With the information as g2o's, and with distances."""
        ranges = None
        if len(self.pairs):
            ranges = Ranges(self.n, self.pairs, self.distances, self.precisions)
        stated = Information.of(self.information, "g2o")
        return Instance(
            "drawn",
            self.graph.with_information(stated).with_ranges(ranges),
            self.ids,
            world=self.n - 1 if self.world else None,
        )

    @property
    def text(self) -> str:
        """As a g2o file: true poses, then measurements in order, without distances."""
        return self.text_of(range(self.m))

    def text_of(self, chosen: Iterable[int]) -> str:
        """The same with some of the measurements, in that order."""
        said = ["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"] if self.d == 3 else []
        # Held nodes need values of all.
        shown = ~self.points[: self.n - self.world] | bool(self.held)
        said += [self.vertex(k) for k in np.flatnonzero(shown).tolist()]
        said += [f"FIX {self.ids[k]}" for k in self.held if k < self.n - self.world]
        return "\n".join([*said, *map(self._line, chosen), ""])

    def vertex(self, k: int) -> str:
        """The line of a node's values."""
        tags = {2: ("VERTEX_SE2", "VERTEX_XY"), 3: ("VERTEX_SE3:QUAT", "VERTEX_TRACKXYZ")}[self.d]
        tag = tags[int(self.points[k])]
        numbers = [*self.t[k].tolist(), *([] if self.points[k] else numbers_of(self.R[k]))]
        return " ".join([tag, str(self.ids[k]), *map(repr, numbers)])

    def _line(self, e: int) -> str:
        d, (i, j) = self.d, self.edges[e].tolist()
        is_prior, is_sighting = self.world and i == self.n - 1, bool(self.points[j])
        tags = {
            2: ("EDGE_SE2", "EDGE_PRIOR_SE2", "EDGE_SE2_XY", "EDGE_PRIOR_SE2_XY"),
            3: ("EDGE_SE3:QUAT", "EDGE_SE3_PRIOR", "EDGE_SE3_TRACKXYZ", "EDGE_SE3_XYZPRIOR"),
        }[d]
        alone = not self.turned[e] and (is_prior or is_sighting)
        is_apart = self.apart > 0 and is_sighting
        words = ["LANDMARK2" if is_apart else tags[2 * alone + is_prior]]
        words += [] if is_prior else [str(self.ids[i])]
        words += [str(self.ids[j] - self.apart * is_apart)]
        words += ["0"] if d == 3 and (is_prior or is_sighting) else []
        numbers = self.steps[e].tolist()
        if not alone:
            numbers += numbers_of(self.turns[e])
        size = d if alone else d * (d + 1) // 2
        numbers += self.information[e, :size, :size][np.triu_indices(size)].tolist()
        return " ".join([*words, *map(repr, numbers)])

    def read(self, **options: Any) -> Instance:
        """What the package reads in its file."""
        return read_bytes(self.text.encode(), **options)


def read_bytes(text: bytes, **options: Any) -> Instance:
    """What the package reads in a g2o file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.g2o"
        path.write_bytes(text)
        return certpgo.read(path, quiet=True, **options)


def draw(
    rng: np.random.Generator,
    *,
    d: int | None = None,
    nodes: tuple[int, int] = (3, 8),
    points: float = 0.3,
    priors: float = 0.3,
    distances: float = 0.0,
    loops: float = 1.0,
    noises: Sequence[float] = NOISES,
    full: float = 0.5,
) -> Measurements:
    """A random connected graph.

    Parameters
    ----------
    d : dimension; by default, 2 or 3
    nodes : least and largest number of poses
    points, priors, distances : probabilities that there are any
    loops : measurements beyond a spanning tree, as a share of the poses
    noises : one of them is drawn
    full : probability of information that is no multiple of the identity
    """
    d, n = d or int(rng.integers(2, 4)), int(rng.integers(nodes[0], nodes[1] + 1))
    k = int(rng.integers(1, 4)) if rng.random() < points else 0
    world = bool(rng.random() < priors)
    R = np.concatenate([turns(rng, n, d), np.tile(np.eye(d), (k + world, 1, 1))])
    t = np.cumsum(rng.standard_normal((n + k + world, d)), axis=0)
    t[n + k :] = 0.0
    pairs, turned = _pairs(rng, n, k, world, loops)
    sigma, isotropic = float(rng.choice(noises)), rng.random() >= full
    m, p, q = len(pairs), d * (d + 1) // 2, d * (d - 1) // 2
    information = random_information(rng, m, p, d, isotropic) / (sigma or 0.05) ** 2
    information[~turned, d:], information[~turned, :, d:] = 0.0, 0.0
    i, j = pairs.T
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ rotations(sigma * rng.standard_normal((m, q)), d)
    measured[~turned] = np.eye(d)
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + sigma * rng.standard_normal((m, d))
    found = Measurements(
        d, R, t, _ids(rng, n + k + world), np.arange(n + k + world) >= n, world, pairs, measured,
        steps, turned, information, **no_distances(),
    )  # fmt: skip
    found.points[n + k :] = False
    return _with_distances(rng, found, sigma) if rng.random() < distances else found


def turns(rng: np.random.Generator, n: int, d: int) -> Array:
    """(n, d, d) random rotations."""
    if d == 2:
        return rotations(rng.uniform(-np.pi, np.pi, (n, 1)), 2)
    return Rotation.random(n, rng=rng).as_matrix().reshape(n, 3, 3)


def rotations(w: Array, d: int) -> Array:
    """(..., d, d) rotations by angles (..., 1), or vectors (..., 3)."""
    if d == 2:
        c, s = np.cos(w[..., 0]), np.sin(w[..., 0])
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return Rotation.from_rotvec(w.reshape(-1, 3)).as_matrix().reshape(*w.shape[:-1], 3, 3)


def _pairs(
    rng: np.random.Generator, n: int, k: int, world: bool, loops: float
) -> tuple[Array, Array]:
    """(m, 2) edges, and whether they measure the rotation: poses, sightings, priors."""
    pairs = [(int(rng.integers(max(0, b - 2), b)), b) for b in range(1, n)]
    more = int(rng.integers(loops * n + 1))
    pairs += [tuple(rng.choice(n, 2, replace=False)) for _ in range(more)]
    turned = [True] * len(pairs)
    pairs = [(b, a) if rng.random() < 0.3 else (a, b) for a, b in pairs]
    for point in range(n, n + k):
        seen = rng.choice(n, int(rng.integers(1, min(n, 3) + 1)), replace=False)
        pairs += [(int(pose), point) for pose in seen]
    turned += [False] * (len(pairs) - len(turned))
    if world:
        known = rng.choice(n, int(rng.integers(1, n + 1)), replace=False)
        whole = rng.random(len(known)) < 0.5
        whole[0] = True
        pairs += [(n + k, int(pose)) for pose in known]
        turned += whole.tolist()
    return np.array(pairs, dtype=np.intp), np.array(turned)


def random_information(rng: np.random.Generator, m: int, p: int, d: int, isotropic: bool) -> Array:
    """(m, p, p) random matrices, or multiples of the identity for steps and turns."""
    if isotropic:
        weights = 10.0 ** rng.uniform(-0.5, 0.5, (m, 2))
        return weights[:, np.r_[np.zeros(d, int), np.ones(p - d, int)], None] * np.eye(p)
    B = np.linalg.qr(rng.standard_normal((m, p, p)))[0]
    A = (B * 10.0 ** rng.uniform(-0.5, 0.5, (m, 1, p))) @ np.swapaxes(B, 1, 2)
    return 0.5 * (A + np.swapaxes(A, 1, 2))


def _ids(rng: np.random.Generator, n: int) -> Array:
    if rng.random() < 0.5:
        return np.arange(n)
    largest = int(rng.choice([3 * n, 10**6, 2**50]))
    return np.unique(rng.integers(0, largest, 20 * n))[:n]


def _with_distances(rng: np.random.Generator, found: Measurements, sigma: float) -> Measurements:
    known = found.n - found.world
    pairs = np.array([rng.choice(known, 2, replace=False) for _ in range(rng.integers(1, known))])
    true = np.linalg.norm(found.t[pairs[:, 1]] - found.t[pairs[:, 0]], axis=1)
    distances = np.abs(true + sigma * rng.standard_normal(len(pairs)))
    precisions = 10.0 ** rng.uniform(-0.5, 0.5, len(pairs)) / (sigma or 0.05) ** 2
    return replace(found, pairs=pairs, distances=distances, precisions=precisions)


def no_distances() -> dict[str, Array]:
    """What measurements without distances have for them."""
    return {
        "pairs": np.zeros((0, 2), dtype=np.intp),
        "distances": np.zeros(0),
        "precisions": np.zeros(0),
    }


def _harmonic(A: Array) -> Array:
    """(m,) p / tr(A^-1) of matrices (m, p, p), over the p axes that are no zeros; 0 without any."""
    stated = np.diagonal(A, axis1=1, axis2=2) > 0.0
    whole = A + ~stated[:, :, None] * np.eye(A.shape[-1])
    variances = np.diagonal(np.linalg.inv(whole), axis1=1, axis2=2)
    count = stated.sum(axis=1)
    return count / np.maximum((variances * stated).sum(axis=1), count == 0)


def numbers_of(R: Array) -> list[float]:
    """An angle, or a quaternion x y z w."""
    if len(R) == 2:
        return [float(np.arctan2(R[1, 0], R[0, 0]))]
    return Rotation.from_matrix(R).as_quat().tolist()

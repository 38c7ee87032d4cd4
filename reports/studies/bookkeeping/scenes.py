"""A small graph with the features that a row names, as files and as arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import certpgo
from certpgo import Instance
from reports.studies.bookkeeping.drawing import (
    Array,
    Measurements,
    no_distances,
    numbers_of,
    random_information,
    rotations,
    turns,
)
from reports.studies.bookkeeping.oracle import Poses

#: Standard deviations: radians, and metres where steps are about one.
SIGMA = {"none": 0.0, "some": 0.03, "much": 0.3}
#: Where positions far from the origin are.
FAR = (448_000.0, 5_411_000.0, 130.0)
#: Weights that options state.
KAPPA, TAU = 40.0, 25.0
#: By how much a wrong measurement is off, and the unit of the law.
WRONG, UNIT = 3.0, 0.37


@dataclass(frozen=True)
class Scene:
    """A graph and what its files say.

    Attributes
    ----------
    row : the level of each factor
    of : the measurements, in the order in which the package numbers them
    first : (m,) which of them are in the first of two files
    wrong : those that are far from right
    origin : (d,) where positions are judged from: differences of large numbers say little
    """

    row: Mapping[str, str]
    of: Measurements
    first: Array
    wrong: tuple[int, ...]
    origin: Array

    @cached_property
    def options(self) -> list[str]:
        """What the command is told of the weights."""
        kappa_tau = ["--kappa", repr(KAPPA), "--tau", repr(TAU)]
        return {
            "chosen": kappa_tau,
            "ones": ["--unit-weights"],
            "covariance": ["--weights-are", "covariance"],
            "quaternion": ["--rotation-information", "quaternion"],
        }.get(self.row["weights"], [])

    @property
    def has_matrices(self) -> bool:
        """Whether the package knows the information, rather than weights alone."""
        row = self.row
        known = row["matrices"] != "none" and row["weights"] not in ("chosen", "ones")
        return known and row["relative poses"] == "whole"

    @property
    def own_cost(self) -> str:
        """The cost that the documentation says is the default."""
        row = self.row
        if row["relative poses"] != "whole":
            return "rotations"
        chordal = row["file"] == "pyfg"
        robust = row["outliers"] != "none" or row["rejected"] != "none"
        chordal |= robust and (row["proof"] in ("file", "integers") or row["command"] == "follow")
        return "chordal" if chordal or not self.has_matrices or self.turns_open_axes else "g2o"

    @property
    def turns_open_axes(self) -> bool:
        """Whether what is open along an axis of a held pose is along none of the first one."""
        of, d = self.of, self.of.d
        _, *others = sorted(self.constrained)[: -1 if of.world else None] or [0]
        whole = of.turned & (True if of.moved is None else of.moved) & self.counts
        is_open = whole & ~of.information[:, d - 1].any(axis=1)
        return bool((is_open & np.isin(of.edges[:, 1], others)).any())

    @property
    def cost(self) -> str:
        """The cost that is asked for."""
        asked = self.row["cost"]
        if self.row["relative poses"] != "whole":
            return "rotations"
        return self.own_cost if asked == "own" else asked

    def judged(self, cost: str) -> Measurements:
        """The measurements as they count in a cost, without those between held nodes."""
        of, d, row = self.of, self.of.d, self.row
        omega = of.information
        p = omega.shape[-1]
        if row["matrices"] == "none" or row["weights"] in ("chosen", "ones"):
            kappa, tau = (KAPPA, TAU) if row["weights"] == "chosen" else (1.0, 1.0)
            weights = np.r_[np.full(d, tau), np.full(p - d, kappa * (1.0 if d == 2 else 2.0))]
            moved = np.ones(of.m, dtype=bool) if of.moved is None else of.moved
            known = np.repeat(np.stack([moved, of.turned], axis=1), [d, p - d], axis=1)
            omega = (weights * known)[:, :, None] * np.eye(p)
        elif row["weights"] == "quaternion" and cost in ("chordal", "rotations"):
            half = np.r_[np.ones(d), np.full(p - d, 0.5)]
            omega = omega * half[:, None] * half
        prior = of.edges[:, :1] == (of.n - 1 if of.world else -1)
        prior = prior & (True if of.moved is None else of.moved[:, None])
        steps, (_, t) = of.steps - prior * self.origin, self.near((of.R, of.t))
        found = replace(of, information=omega, steps=steps, t=t).subset(self.counts)
        distances = of.pairs, of.distances, of.precisions
        if row["weights"] == "ones":
            distances = of.pairs, of.distances, np.ones(len(of.pairs))
        names = ("pairs", "distances", "precisions")
        far = float(np.linalg.norm(self.origin))
        given = dict(zip(names, distances, strict=True))
        return replace(found, held=self.constrained, far=far, **given)

    def near(self, poses: Poses) -> Poses:
        """Poses seen from there."""
        known = np.arange(self.of.n)[:, None] < self.of.n - self.of.world
        return poses[0], poses[1] - known * self.origin

    @property
    def counts(self) -> Array:
        """(m,) which measurements are not between held nodes."""
        return ~np.isin(self.of.edges, self.constrained).all(axis=1)

    def judged_rows(self, nodes: Array) -> list[int]:
        """The measurements that are judged where an estimate has these nodes."""
        inside = self.counts & np.isin(self.of.edges, nodes).all(axis=1)
        return np.flatnonzero(inside).tolist()

    @property
    def constrained(self) -> tuple[int, ...]:
        """Nodes that are held relative to each other."""
        of = self.of
        all_held = (*of.held, of.n - 1) if of.world else of.held
        return all_held if of.held and len(all_held) > 1 else ()

    # Files.

    def written(self, folder: Path) -> list[Path]:
        """The files of the graph."""
        of, kind = self.of, self.row["file"]
        if kind == "npz" or (kind == "pyfg" and self.row["files"] == "one" and not len(of.pairs)):
            path = folder / f"graph.{kind}"
            certpgo.write(path, self.instance)
            return [path]
        if self.row["weights"] == "covariance":
            of = replace(of, information=np.linalg.pinv(of.information, hermitian=True))
        if kind == "pyfg" and (len(of.pairs) or self.has_priors_alone):
            if self.row["partial edges"] != "none" or self.row["attitudes"] != "none":
                certpgo.write(folder / "graph.pyfg", self.instance)
            return self._as_pyfg(folder)
        names = ("one",) if self.row["files"] == "one" else ("one", "two")
        if self.row["files"] == "reversed":
            names = ("two", "one")
        paths = []
        for name in names:
            inside = self.first if name == "one" or len(names) == 1 else ~self.first
            text = of.text_of(np.flatnonzero(inside) if len(names) > 1 else range(of.m))
            if self.row["matrices"] == "none":
                text = _without_matrices(text, of.d)
            paths.append(folder / f"{name}.g2o")
            paths[-1].write_text(text)
        if kind == "pyfg":
            found = [path.with_suffix(".pyfg") for path in paths]
            for path, other in zip(paths, found, strict=True):
                certpgo.write(other, certpgo.read(path, quiet=True, fixed=False))
            return found
        return paths

    @property
    def has_priors_alone(self) -> bool:
        """Whether the second file is of priors or of nothing: no graph that is read by itself."""
        of, second = self.of, ~self.first
        priors = of.world and (of.edges[second, 0] == of.n - 1).all()
        return bool(priors or not second.any())

    def _as_pyfg(self, folder: Path) -> list[Path]:
        """As PyFG, in the package's order of measurements."""
        inside = [np.ones(self.of.m, dtype=bool)]
        if self.row["files"] != "one":
            inside = [self.first, ~self.first]
        if self.row["files"] == "reversed":
            inside.reverse()
        paths = []
        for number, chosen in enumerate(inside):
            paths.append(folder / f"{number}.pyfg")
            paths[-1].write_text(pyfg(self.of, np.flatnonzero(chosen), number == 0))
        return paths

    @property
    def instance(self) -> Instance:
        """As arrays, or as the package reads its text, with the distances."""
        of = self.of
        if self.row["file"] == "arrays" or len(of.pairs):
            return replace(of.instance, initial=None)
        text = of.text
        if self.row["matrices"] == "none":
            text = _without_matrices(text, of.d)
        return _read(text)

    def called(self, node: int) -> int:
        """The id of a node; nodes with names are numbered."""
        return node if self.row["file"] == "pyfg" else int(self.of.ids[node])

    def values(self, poses: Poses, nodes: Iterable[int]) -> tuple[str, str]:
        """Vertices of poses and points in the world's frame, and the suffix of their file."""
        of = replace(self.of, R=poses[0], t=poses[1])
        if self.row["file"] == "pyfg":  # has names
            return "".join(f"{named_vertex(of, k)}\n" for k in nodes), ".pyfg"
        return "".join(f"{of.vertex(k)}\n" for k in nodes), ".g2o"


def _read(text: str) -> Instance:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.g2o"
        path.write_text(text)
        return certpgo.read(path, quiet=True)


def _name(of: Measurements, k: int) -> str:
    return f"{'L' if of.points[k] else 'A'}{of.ids[k]}"


def named_vertex(of: Measurements, k: int) -> str:
    """A vertex as PyFG has it."""
    _, _, *numbers = of.vertex(k).split()
    pose, point = ("SE2", "XY") if of.d == 2 else ("SE3:QUAT", "XYZ")
    tag = f"VERTEX_{point}" if of.points[k] else f"VERTEX_{pose} 0"
    return " ".join([tag, _name(of, k), *numbers])


def pyfg(of: Measurements, chosen: Array, with_distances: bool) -> str:
    """Nodes, some of the measurements and the distances, with covariances."""
    d, pose = of.d, "SE2" if of.d == 2 else "SE3:QUAT"
    point = "XY" if d == 2 else "XYZ"
    names = [_name(of, k) for k in range(of.n)]
    lines = [named_vertex(of, k) for k in range(of.n - of.world)]
    for e in chosen.tolist():
        i, j = of.edges[e].tolist()
        alone, is_prior = not of.turned[e], bool(of.world and i == of.n - 1)
        size = d if alone else d * (d + 1) // 2
        numbers = of.steps[e].tolist() + ([] if alone else numbers_of(of.turns[e]))
        covariance = np.linalg.inv(of.information[e, :size, :size])
        numbers += covariance[np.triu_indices(size)].tolist()
        what = point if alone else pose
        words = ["EDGE_SE2_XY" if d == 2 else "EDGE_SE3_XYZ"] if alone else [f"EDGE_{pose}"]
        words = [f"VERTEX_{what}:PRIOR"] if is_prior else words
        words += ["0", *([] if is_prior else [names[i]]), names[j]]
        lines.append(" ".join([*words, *map(repr, numbers)]))
    measured = zip(of.pairs.tolist(), of.distances, of.precisions, strict=True)
    for (i, j), distance, weight in measured if with_distances else ():
        lines.append(
            f"EDGE_RANGE 0 {names[i]} {names[j]} {float(distance)!r} {float(1.0 / weight)!r}"
        )
    return "\n".join(lines) + "\n"


def _without_matrices(text: str, d: int) -> str:
    """The lines without what follows a measurement."""
    size = 6 if d == 2 else 10
    lines = [line.split() for line in text.splitlines()]
    cut = [line[:size] if line[0].startswith("EDGE") else line for line in lines]
    return "\n".join(map(" ".join, cut)) + "\n"


def drawn(row: Mapping[str, str], rng: np.random.Generator) -> Scene:
    """A random graph with the features of a row."""
    d = 2 if row["dimension"] == "plane" else 3
    n = int(rng.integers(4, 7))
    k = 0 if row["landmarks"] == "none" else int(rng.integers(1, 3))
    priors = [row[name] for name in ("positions", "attitudes", "full priors")]
    world = set(priors) != {"none"}
    pairs = _pairs(row, rng, n, k, world)
    edges = np.array([pair for pair, _, _ in pairs])
    turned, moved = (np.array([one[slot] for one in pairs]) for slot in (1, 2))
    sigma, size = SIGMA[row["noise"]], n + k + world
    R = np.concatenate([turns(rng, n, d), np.tile(np.eye(d), (k + world, 1, 1))])
    t = np.cumsum(rng.standard_normal((size, d)), axis=0)
    if row["positions"] == "far":
        t += FAR[:d]
    t[n + k :] = 0.0
    m, p, q = len(edges), d * (d + 1) // 2, d * (d - 1) // 2
    omega = random_information(rng, m, p, d, row["matrices"] != "full") / (sigma or 0.05) ** 2
    omega[~turned, d:], omega[~turned, :, d:] = 0.0, 0.0
    if row["relative poses"] == "whole":  # a rotation graph's steps are zero, with information
        omega[~moved, :d], omega[~moved, :, :d] = 0.0, 0.0
    if row["partial edges"] == "axes":
        for e in _loops(rng, n, pairs):
            omega[e, d - 1], omega[e, :, d - 1] = 0.0, 0.0
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ rotations(sigma * rng.standard_normal((m, q)), d)
    measured[~turned] = np.eye(d)
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + sigma * rng.standard_normal((m, d))
    steps[~moved] = 0.0
    points = (np.arange(size) >= n) & (np.arange(size) < n + k)
    held = {"none": (), "one": (0,), "several": (0, n - 2)}[row["held"]]
    of = Measurements(
        d, R, t, _numbers(row, rng, n, k, world), points, world, edges, measured, steps, turned,
        omega, **no_distances(), apart=n * (row["landmarks"] == "numbered apart"),
        moved=moved, held=held,
    )  # fmt: skip
    if row["distances"] != "none":
        of = _measured_far(rng, of, sigma)
    if row["parallel edges"] == "copy":
        of = _with_copy(rng, of, n)
    of, wrong = _with_wrong(row, rng, of, n)
    first = _first_file(rng, of)
    late = ~first if row["files"] != "reversed" else first
    if row["files"] == "one":
        late = np.zeros(of.m, dtype=bool)
    # PyFG as the package writes it has positions after poses.
    apart = (row["file"] == "pyfg") & ~of.turned
    order = sorted(range(of.m), key=lambda e: (*_rank(of, e), late[e], apart[e]))
    distances = {"pairs": of.pairs, "distances": of.distances, "precisions": of.precisions}
    of = replace(of.subset(np.array(order)), **distances)
    origin = np.array(FAR[:d]) * (row["positions"] == "far")
    return Scene(row, of, first[order], tuple(order.index(e) for e in wrong), origin)


def _pairs(
    row: Mapping[str, str], rng: np.random.Generator, n: int, k: int, world: bool
) -> list[tuple[tuple[int, int], bool, bool]]:
    """Nodes of measurements, and whether they measure the rotation and the step."""
    moves = row["relative poses"] == "whole"
    tree = [(int(rng.integers(max(0, b - 2), b)), b) for b in range(1, n)]
    loops = [tuple(sorted(rng.choice(n, 2, replace=False).tolist())) for _ in range(n)]
    if row["parallel edges"] == "none":
        loops = sorted(set(loops) - set(tree))
    else:
        loops.append(tree[int(rng.integers(len(tree)))])
    found = [((a, b), True, moves) for a, b in [*tree, *loops]]
    found = [((b, a), u, v) if rng.random() < 0.3 else ((a, b), u, v) for (a, b), u, v in found]
    if row["partial edges"] in ("turns", "steps"):
        for e in _loops(rng, n, found):
            alone = row["partial edges"] == "turns"
            found[e] = (found[e][0], alone, not alone)
    for point in range(n, n + k):
        # A right angle apart: the first two poses always see it, so that parts do too.
        seen = {0, 1, *rng.choice(n, 2, replace=False).tolist()}
        found += [((pose, point), False, True) for pose in sorted(seen)]
    if world:
        levels = (("positions", False, True), ("attitudes", True, False))
        for name, turned, moved in (*levels, ("full priors", True, True)):
            count = {"positions": 3, "attitudes": 2, "full priors": 2}[name]
            if row[name] != "none":
                poses = {0, *rng.choice(n, count, replace=False).tolist()}
                found += [((n + k, pose), turned, moved) for pose in sorted(poses)]
    return found


def _loops(
    rng: np.random.Generator, n: int, pairs: list[tuple[tuple[int, int], bool, bool]]
) -> list[int]:
    """Some of the measurements between poses beyond the tree; at least one if there are any."""
    loops = [e for e in range(n - 1, len(pairs)) if max(pairs[e][0]) < n]
    chosen = [e for e in loops if rng.random() < 0.4]
    return chosen or loops[:1]


def _numbers(
    row: Mapping[str, str], rng: np.random.Generator, n: int, k: int, world: bool
) -> Array:
    if row["landmarks"] == "numbered apart":
        return np.arange(n + k + world)
    size = n + k + world
    if row["ids"] == "plain":
        return np.arange(size)
    most = 3 * size if row["ids"] == "gaps" else 2**50
    found = np.unique(rng.integers(0, most, 40 * size))[:size]
    return np.r_[found[:-1], found[-2] + 1] if world else found  # the world's is the next one


def _measured_far(rng: np.random.Generator, of: Measurements, sigma: float) -> Measurements:
    known = of.n - of.world
    pairs = np.array([rng.choice(known, 2, replace=False) for _ in range(int(rng.integers(1, 4)))])
    true = np.linalg.norm(of.t[pairs[:, 1]] - of.t[pairs[:, 0]], axis=1)
    distances = np.abs(true + sigma * rng.standard_normal(len(pairs)))
    weights = 10.0 ** rng.uniform(-0.5, 0.5, len(pairs)) / (sigma or 0.05) ** 2
    return replace(of, pairs=pairs, distances=distances, precisions=weights)


def _with_copy(rng: np.random.Generator, of: Measurements, n: int) -> Measurements:
    """One measurement twice, in the same numbers."""
    e = int(rng.integers(n - 1))
    distances = {"pairs": of.pairs, "distances": of.distances, "precisions": of.precisions}
    return replace(of.subset(np.r_[np.arange(of.m), e]), **distances)


def _with_wrong(
    row: Mapping[str, str], rng: np.random.Generator, of: Measurements, n: int
) -> tuple[Measurements, list[int]]:
    """One measurement beyond the tree far from right, where some are to be rejected."""
    if row["outliers"] == "none" and row["rejected"] == "none":
        return of, []
    inside = np.flatnonzero(of.edges.max(axis=1) < n)[n - 1 :]
    if not len(inside):
        return of, []
    e = int(rng.choice(inside))
    turned, steps = of.turns.copy(), of.steps.copy()
    if of.turned[e]:
        turned[e] = turned[e] @ rotations(np.full((1, of.d * (of.d - 1) // 2), 1.0), of.d)[0]
    if of.moved is None or of.moved[e]:
        steps[e] += WRONG
    return replace(of, turns=turned, steps=steps), [e]


def _rank(of: Measurements, e: int) -> tuple[bool, bool]:
    """The package numbers priors last, and before these what sees points."""
    return bool(of.world and of.edges[e, 0] == of.n - 1), bool(of.points[of.edges[e, 1]])


def _first_file(rng: np.random.Generator, of: Measurements) -> Array:
    """(m,) measurements of the first file; the same between two nodes stay together."""
    keys: dict[tuple[int, int], bool] = {}
    own = [keys.setdefault(tuple(pair), bool(rng.random() < 0.5)) for pair in of.edges.tolist()]
    found = np.array(own)
    found[0], found[-1] = True, bool(len(keys) < 2)
    same = (of.edges == of.edges[-1]).all(axis=1)
    found[same] = found[-1]
    first = (of.edges == of.edges[0]).all(axis=1)
    found[first] = True
    return found


def determined(of: Measurements, nodes: Array, held: tuple[int, ...]) -> bool:
    """Whether whole measurements, sightings and what is held join all of these nodes."""
    whole = of.turned & (True if of.moved is None else of.moved)
    joins = of.edges[whole | of.points[of.edges[:, 1]]].tolist()
    joins += [(held[0], node) for node in held[1:]]
    joined, wanted = {int(nodes[0])}, set(nodes.tolist())
    while True:
        more = {k for i, j in joins for k in (i, j) if {i, j} & joined} - joined
        if not more:
            return wanted <= joined
        joined |= more


def renamed(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same with other names of poses and points, in another order of lines."""
    of = scene.of
    known = int((~of.points).sum()) - of.world
    order = np.r_[rng.permutation(known), np.arange(known, of.n)]  # node k was order[k]
    place = np.argsort(order)
    moved = replace(
        of,
        R=of.R[order],
        t=of.t[order],
        edges=place[of.edges],
        pairs=place[of.pairs] if len(of.pairs) else of.pairs,
        held=tuple(place[list(of.held)].tolist()),
    )
    return replace(scene, of=moved)


def scaled(scene: Scene) -> Scene:
    """The same in another unit of length."""
    of, p = scene.of, scene.of.information.shape[-1]
    by = np.r_[np.full(of.d, 1.0 / UNIT), np.ones(p - of.d)]
    moved = replace(
        of,
        t=of.t * UNIT,
        steps=of.steps * UNIT,
        information=of.information * by[:, None] * by,
        distances=of.distances * UNIT,
        precisions=of.precisions / UNIT**2,
    )
    return replace(scene, of=moved, origin=UNIT * scene.origin)


def turned(scene: Scene, rng: np.random.Generator) -> Scene:
    """The same in another frame of the world."""
    of = scene.of
    known, (Q,), s = of.n - of.world, turns(rng, 1, of.d), rng.standard_normal(of.d)
    R, t = of.R.copy(), of.t.copy()
    poses = ~of.points[:known]
    R[:known][poses] = Q @ R[:known][poses]
    t[:known] = (t[:known] - scene.origin) @ Q.T + s + scene.origin
    changed_turns, steps = of.turns.copy(), of.steps.copy()
    if of.world:
        prior = of.edges[:, 0] == of.n - 1
        whole = prior & of.turned
        changed_turns[whole] = Q @ changed_turns[whole]
        placed = prior & (of.moved if of.moved is not None else True)
        steps[placed] = (steps[placed] - scene.origin) @ Q.T + s + scene.origin
    omega = of.information.copy()
    if of.world:
        # A pose's residual is in its own measured frame, a position's in the world's.
        alone = prior & ~of.turned
        found = Q @ omega[alone, : of.d, : of.d] @ Q.T
        omega[alone, : of.d, : of.d] = 0.5 * (found + np.swapaxes(found, 1, 2))
    return replace(
        scene, of=replace(of, R=R, t=t, turns=changed_turns, steps=steps, information=omega)
    )

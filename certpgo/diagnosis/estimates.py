"""Conventions that an estimate may have been written in, each judged by the cost of so reading it.

Poses are read as x y z and a quaternion x y z w, of the body in the world, in metres. A reading
undoes one other convention; the cost says which one explains the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown, counted
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray

#: A reading explains an estimate if it leaves at most this share of the cost, and of its excess.
SHARE = 0.1
#: An estimate is asked about if it costs this many times the least cost known.
WRONG = 2.0
#: It is near to the optimum, or else leaves hardly anything.
FAR, SURE = 100.0, 0.01
#: Readings that cost hardly more than the best are preferred if they are simpler.
HARDLY = 1.02
#: Units by their length in metres, and how closely a scale must meet one.
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3, "feet": 0.3048}
NEAR = 0.02
#: Squared correlation of steps with measured ones from which a scale is one.
ALIKE = 0.8

Poses = tuple[FloatArray, FloatArray | None]


@dataclass(frozen=True)
class Convention:
    """A way to write poses, and how these are read.

    Attributes
    ----------
    kind : its name in findings
    said : what was written, in words; ``{it}`` and ``{its}`` are what is read
    next : what to do about it
    read : rotations (n, d, d) and translations (n, d), as they are read in the usual way, to those
        that are meant
    """

    kind: str
    said: str
    next: str
    read: Callable[[FloatArray, FloatArray | None], Poses]


def found(examined: Examined) -> Iterator[Finding]:
    """The convention that explains the estimate best, if one does."""
    if examined.estimate is None or examined.instance.graph.has_scales:
        return
    estimate, d = examined.estimate, examined.instance.graph.d
    given = examined.problem.cost(estimate)
    if not given > WRONG * examined.best:
        return
    names = [*_candidates(d)]
    if not examined.instance.graph.is_point.any():
        names += [(one,) for one in STEPS]
    trials = [_tried(examined, estimate, given, one) for one in names]
    trials += [_reordered(examined, estimate, *o) for o in _orders(examined.instance.ids)]
    best = min(trial.share for trial in trials)
    chosen = next(trial for trial in trials if trial.share <= HARDLY * best)
    cost = chosen.share * given
    near = cost < FAR * examined.best or chosen.share < SURE
    if near and cost < SHARE * _collapsed(examined) and explains(cost, given, examined.best):
        so_read, as_given = cost_shown(cost), cost_shown(given)
        said = in_words(chosen.said, "the estimate")
        said = f"{said}: so read it costs {so_read}, as it stands {as_given}"
        if cost > WRONG * examined.best:
            said = f"{said}, the optimum {cost_shown(examined.best)}"
        yield Finding(chosen.kind, said, chosen.next, cost, given)


def _collapsed(examined: Examined) -> float:
    """The cost of a map in one point, which any scale and any bent map may come near to."""
    best = examined.estimate
    if best is None or best.translations is None:
        return math.inf
    return examined.problem.cost(best.with_translations(0.0 * best.translations))


def explains(cost: float, given: float, best: float) -> bool:
    """Whether a hypothesis leaves little of a cost, and of what that is above the best one."""
    return cost < SHARE * given and cost - best < SHARE * (given - best)


@dataclass(frozen=True)
class _Trial:
    """A reading, and the share of the given cost that it leaves."""

    kind: str
    said: str
    next: str
    share: float


# --- Conventions ----------------------------------------------------------------------------------


def with_w_first(R: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) whose quaternions w x y z were read as x y z w, as they are meant."""
    return quaternion.rotations(np.roll(quaternion.to_write(R), -1, axis=1))


def _inverse(R: FloatArray, t: FloatArray | None) -> Poses:
    back = np.swapaxes(R, 1, 2)
    return back, None if t is None else -np.einsum("nab,nb->na", back, t)


def _turned_back(R: FloatArray, t: FloatArray | None) -> Poses:
    return np.swapaxes(R, 1, 2), t


def _positions_of_inverses(R: FloatArray, t: FloatArray | None) -> Poses:
    return R, None if t is None else -np.einsum("nab,nb->na", R, t)


def _composed(R: FloatArray, t: FloatArray | None) -> Poses:
    """Products of each pose and all before it, by doubling the steps."""
    step, R = 1, R.copy()
    t = None if t is None else t.copy()
    while step < len(R):
        before = R[:-step]
        if t is not None:
            t[step:] = t[:-step] + np.einsum("nab,nb->na", before, t[step:])
        R[step:] = before @ R[step:]
        step *= 2
    return so.project(R), t


def _mirrored(axis: int) -> Callable[[FloatArray, FloatArray | None], Poses]:
    def read(R: FloatArray, t: FloatArray | None) -> Poses:
        signs = np.where(np.arange(R.shape[1]) == axis, -1.0, 1.0)
        return R, None if t is None else signs * t

    return read


def _of_other_hand(axis: int) -> Callable[[FloatArray, FloatArray | None], Poses]:
    def read(R: FloatArray, t: FloatArray | None) -> Poses:
        signs = np.where(np.arange(R.shape[1]) == axis, -1.0, 1.0)
        return signs[:, None] * R * signs, None if t is None else signs * t

    return read


def _permuted(order: tuple[int, ...]) -> Callable[[FloatArray, FloatArray | None], Poses]:
    def read(R: FloatArray, t: FloatArray | None) -> Poses:
        return R, None if t is None else t[:, list(order)]

    return read


def _turned(C: FloatArray) -> Callable[[FloatArray, FloatArray | None], Poses]:
    def read(R: FloatArray, t: FloatArray | None) -> Poses:
        return R @ C, t

    return read


W_FIRST = Convention(
    "quaternion-w-first",
    "{its} quaternions have w first",
    "write them as qx qy qz qw",
    lambda R, t: (with_w_first(R), t),
)
FORMS = (
    Convention(
        "inverse-poses",
        "{its} poses are of the world in the body (world to camera), not of the body in the world",
        "invert each pose",
        _inverse,
    ),
    Convention(
        "inverse-rotations",
        "{its} rotations are inverse, its positions are not",
        "transpose each rotation, or negate x, y and z of its quaternion",
        _turned_back,
    ),
    Convention(
        "inverse-positions",
        "{its} positions are of the world in the body, its rotations of the body in the world",
        "replace each position t by -R t",
        _positions_of_inverses,
    ),
)

#: Those of all poses together, in the order of nodes.
STEPS = (
    Convention(
        "relative-poses",
        "{its} poses are each relative to the one before, not to the first",
        "multiply each from the left by the product of all before it",
        _composed,
    ),
    Convention(
        "relative-poses",
        "{its} poses are each inverse and relative to the one before: of that in its own frame",
        "invert each, and multiply it from the left by the product of all before it",
        lambda R, t: _composed(*_inverse(R, t)),
    ),
)


def of_axes(d: int) -> Iterator[Convention]:
    """Axes of positions or of the world: mirrored or permuted."""
    names = "xyz"[:d]
    for axis, name in enumerate(names):
        yield Convention(
            "mirrored",
            f"{{its}} positions are mirrored: {name} has the other sign",
            f"negate {name}",
            _mirrored(axis),
        )
    # Of whichever axis: they differ by a turn of the world, but for what the bodies are.
    for axis, name in enumerate(names):
        yield Convention(
            "other-handedness",
            f"{{it}} is of the other handedness, mirrored in {name}",
            f"negate {name}, and turn rotations accordingly (S R S)",
            _of_other_hand(axis),
        )
    for order in permutations(range(d)):
        if order != tuple(range(d)):
            columns = " ".join(names[k] for k in np.argsort(order))
            yield Convention(
                "permuted-axes",
                f"{{its}} positions are in the order {columns}",
                f"write them as {' '.join(names)}",
                _permuted(order),
            )


def of_bodies(d: int) -> Iterator[Convention]:
    """Other axes of the bodies: their rotations turned from the right."""
    for C in quarter_turns(d):
        yield Convention(
            "permuted-axes",
            f"{{its}} bodies have other axes: {axes_of(C)}, as of a camera and its vehicle",
            "multiply each rotation from the right by that permutation",
            _turned(C),
        )


def axes_of(C: FloatArray) -> str:
    """Which axes are those of a signed permutation, in words."""
    names = "xyz"[: len(C)]
    rows = [(int(np.argmax(np.abs(c))), c) for c in C.T]
    named = [f"{'-' if c[k] < 0.0 else ''}{names[k]}" for k, c in rows]
    return ", ".join(f"{own} is {of}" for own, of in zip(names, named, strict=True))


def quarter_turns(d: int) -> Iterator[FloatArray]:
    """All rotations that permute axes, but for the identity."""
    for order in permutations(range(d)):
        for signs in product((1.0, -1.0), repeat=d):
            C = np.zeros((d, d))
            C[list(order), np.arange(d)] = signs
            if np.linalg.det(C) > 0.0 and not np.array_equal(C, np.eye(d)):
                yield C


def _candidates(d: int) -> Iterator[tuple[Convention, ...]]:
    """Conventions to try, single ones first, then with quaternions of w first."""
    yield ()
    alone = (*FORMS, *of_axes(d), *of_bodies(d))
    if d == 3:
        yield (W_FIRST,)
    for one in alone:
        yield (one,)
    if d == 3:
        for one in FORMS:
            yield (W_FIRST, one)


# --- Trials ---------------------------------------------------------------------------------------


def _tried(
    examined: Examined, estimate: Estimate, given: float, conventions: tuple[Convention, ...]
) -> _Trial:
    """The estimate, of a given cost, read by some conventions, in the unit that fits best."""
    poses = read_by(estimate, conventions, examined.instance.world)
    examined.trying("+".join(one.kind for one in conventions) or "scaled")
    kind = conventions[0].kind if conventions else "as-given"
    said = ", and ".join(one.said for one in conventions)
    next = ", and ".join(one.next for one in conventions)
    cost = examined.problem.cost(poses)
    scale = best_scale(examined, poses)
    if scale is not None and abs(scale - 1.0) > NEAR and poses.translations is not None:
        t = scale * poses.translations
        scaled = examined.problem.cost(poses.with_translations(t))
        if scaled < SHARE * cost:
            unit, factor = unit_of(scale)
            if not conventions:
                kind = unit
            more = unit_in_words(unit, factor)
            said = f"{said}, and {more}" if said else more
            times = f"multiply its positions by {factor}"
            next, cost = f"{next}, and {times}" if next else times, scaled
    return _Trial(kind, said, next, cost / given)


def read_by(
    estimate: Estimate, conventions: tuple[Convention, ...], world: int | None = None
) -> Estimate:
    """The estimate as some conventions say; the world stays where it is."""
    R, t = estimate.rotations, estimate.translations
    for one in conventions:
        R, t = one.read(R, t)
    if world is not None:
        R = R.copy()
        R[world] = estimate.rotations[world]
        if t is not None and estimate.translations is not None:
            t = t.copy()
            t[world] = estimate.translations[world]
    return Estimate(R, t)


def best_scale(examined: Examined, estimate: Estimate) -> float | None:
    """The factor of all positions that fits measured translations; None if none does."""
    graph, t = examined.instance.graph, estimate.translations
    if t is None or not graph.has_positions:
        return None
    i, j = graph.edges.T
    v = np.einsum("mba,mb->ma", estimate.rotations[i], t[j] - t[i])
    size = float(graph.tau @ (v * v).sum(axis=1))
    along = float(graph.tau @ (v * graph.translations).sum(axis=1))
    stated = float(graph.tau @ (graph.translations**2).sum(axis=1))
    # Noise is best scaled to nothing, which explains nothing.
    return along / size if along > 0.0 and along**2 > ALIKE * size * stated else None


def unit_of(scale: float) -> tuple[str, str]:
    """The unit of lengths that this factor turns into metres, or ``"scaled"``; and the factor."""
    for name, metres in UNITS.items():
        if abs(scale / metres - 1.0) < NEAR:
            return name, f"{metres:g}"
    return "scaled", f"{scale:.4g}"


def in_words(said: str, it: str) -> str:
    """What a convention says of an estimate or a truth."""
    return said.format(it=it, its=f"{it}'s")


def unit_in_words(unit: str, factor: str) -> str:
    """What `unit_of` says, in words."""
    return f"{{it}} is in {unit}" if unit in UNITS else f"{{its}} lengths are off by {factor}"


# --- Orders of nodes ------------------------------------------------------------------------------


def _orders(ids: IntArray) -> Iterator[tuple[str, IntArray]]:
    """Orders that poses may have been written in: what it is called, and the places of nodes.

    Places are beyond an end where a node has no pose.
    """
    n = len(ids)
    yield "from the last node to the first", np.arange(n)[::-1]
    for shift in (1, -1, 2, -2):
        by = counted(abs(shift), "node{s}")
        yield f"by {by} too {'late' if shift > 0 else 'early'}", np.arange(n) + shift
    by_text = np.argsort(np.array([str(k) for k in ids]), kind="stable")
    yield "sorted as texts (1, 10, 11, 2)", np.argsort(by_text)


def _reordered(examined: Examined, estimate: Estimate, called: str, places: IntArray) -> _Trial:
    """The estimate in another order, judged by measurements between nodes that have a pose."""
    problem, n = examined.problem, len(places)
    examined.trying("reordered")
    if (world := examined.instance.world) is not None:
        places = np.where(np.arange(n) == world, world, places)
    has_pose = (places >= 0) & (places < n)
    if (places == np.arange(n)).all():
        return _Trial("reordered", "", "", math.inf)
    chosen, t = np.clip(places, 0, n - 1), estimate.translations
    other = Estimate(estimate.rotations[chosen], None if t is None else t[chosen])
    known = has_pose[problem.graph.edges].all(axis=1)
    costs, given = (float(problem.edge_costs(one)[known].sum()) for one in (other, estimate))
    said = f"{{its}} poses are of nodes in another order: {called}"
    share = costs / given if given > 0.0 else math.inf
    return _Trial("reordered", said, "give each pose the id of its node", share)

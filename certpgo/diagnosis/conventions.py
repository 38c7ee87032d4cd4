"""Conventions that poses may have been written in, and orders of nodes.

Poses are read as x y z and a quaternion x y z w, of the body in the world, in metres. A reading
undoes one other convention.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from certpgo.graph import Estimate, Instance
from certpgo.graph.phrases import counted
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

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
    of_each : whether each pose is read by itself
    """

    kind: str
    said: str
    next: str
    read: Callable[[FloatArray, FloatArray | None], Poses]
    of_each: bool = True


@dataclass(frozen=True, eq=False)
class NodeOrder:
    """An order that poses may have been written in.

    Attributes
    ----------
    called : the order, in words
    places : (n,) of each node among the poses, beyond an end where it has none
    """

    called: str
    places: IntArray

    @property
    def has_pose(self) -> BoolArray:
        """(n,) which nodes have a pose."""
        return (self.places >= 0) & (self.places < len(self.places))

    def read(self, estimate: Estimate, nodes: IntArray | slice = slice(None)) -> Estimate:
        """The poses of some nodes, any where they have none."""
        places = np.clip(self.places[nodes], 0, len(self.places) - 1)
        t = estimate.translations
        return Estimate(estimate.rotations[places], None if t is None else t[places])


Reading = tuple[Convention, ...] | NodeOrder


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
        of_each=False,
    ),
    Convention(
        "relative-poses",
        "{its} poses are each inverse and relative to the one before: of that in its own frame",
        "invert each, and multiply it from the left by the product of all before it",
        lambda R, t: _composed(*_inverse(R, t)),
        of_each=False,
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


def candidates(d: int) -> Iterator[tuple[Convention, ...]]:
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


# --- Orders of nodes ------------------------------------------------------------------------------


def orders_of(instance: Instance) -> Iterator[NodeOrder]:
    """Orders that poses may have been written in, other than that of the nodes."""
    ids, world = instance.ids, instance.world
    own = np.arange(len(ids))
    found = [("from the last node to the first", own[::-1])]
    for shift in (1, -1, 2, -2):
        by = counted(abs(shift), "node{s}")
        found.append((f"by {by} too {'late' if shift > 0 else 'early'}", own + shift))
    by_text = np.argsort(np.array([str(k) for k in ids]), kind="stable")
    found.append(("sorted as texts (1, 10, 11, 2)", np.argsort(by_text)))
    for called, places in found:
        if world is not None:
            places = np.where(own == world, world, places)
        if (places != own).any():
            yield NodeOrder(called, places)

"""GTSAM's Values as an estimate, or any object with its keys() and at...().

GTSAM is not imported. Keys are integers; GTSAM's Symbols have a letter in the highest of eight
bytes and an index in the other seven.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.graph.phrases import INDEX_BITS, counted, shown_id
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: The name of the type of factor graphs.
FACTOR_GRAPH = "NonlinearFactorGraph"


def estimate_from_values(
    values: Any,
    ids: Sequence[int] | IntArray,
    d: int,
    with_translations: bool,
    *,
    points: BoolArray | None = None,
    exact: bool = False,
) -> tuple[Estimate, str]:
    """The poses, or rotations, of the nodes ``ids``, and the positions of those that are points.

    Keys are matched with the ids; failing that, the indices of one letter's Symbols are; failing
    that, keys and ids in ascending order, if there are equally many. Points are matched apart.

    Parameters
    ----------
    values : has ``keys()`` and ``atPose3``, ``atRot3``, ``atPose2`` or ``atRot2``, and for points
        ``atPoint3`` or ``atPoint2``
    ids : (n,) node ids, in the order of the estimate
    d : dimension of space, 2 or 3
    with_translations : whether translations are needed
    points : (n,) which nodes are points; None for none
    exact : whether the ids must be keys

    Returns
    -------
    estimate : n poses or rotations, in the order of ``ids``
    notice : how keys were matched if they are not the ids, and what was ignored; or empty

    Raises
    ------
    InputError
        The keys do not match the ids, or the values are of another kind.
    """
    is_point = np.zeros(len(ids), dtype=bool) if points is None else points
    R, t = np.tile(np.eye(d), (len(ids), 1, 1)), np.zeros((len(ids), d))
    elements, notices = _elements(values, d, of_points=bool(is_point.any())), []
    for chosen, of, what in (
        (~is_point, elements.poses, "pose or rotation"),
        (is_point, elements.points, "point"),
    ):
        if not chosen.any():
            continue
        expected = [int(node) for node in np.asarray(ids)[chosen].tolist()]
        missing = [node for node in expected if node not in of]
        if exact and missing:
            named = shown_id(missing[0])
            raise InputError(f"the values hold no {d}D {what} at key {named}")
        keys, notice = (expected, "") if exact else _keys_of(of, expected, what.split(" ")[0])
        matrices = [of[key] for key in keys]
        if with_translations and any(M.shape == (d, d) for M in matrices):
            raise InputError("the values hold rotations only, but the graph measures translations")
        R[chosen] = [M[:d, :d] for M in matrices]
        if with_translations:
            t[chosen] = [M[:d, d] for M in matrices]
        notices += [notice] if notice else []
    return Estimate(R, t if with_translations else None), "; ".join(notices)


class _Elements(NamedTuple):
    """Matrices by key: (d + 1, d + 1) of poses and points, (d, d) of rotations."""

    poses: dict[int, FloatArray]
    points: dict[int, FloatArray]


def _elements(values: Any, d: int, *, of_points: bool) -> _Elements:
    """All poses or rotations, and all points where there may be some."""
    try:
        keys = [int(key) for key in values.keys()]  # noqa: SIM118 - not a mapping
    except (TypeError, ValueError):
        raise InputError("GTSAM's Values expected, whose keys are integers") from None
    found = {key: M for key in keys if (M := _element(values, key, d)) is not None}
    if not found:
        other = 5 - d
        if any(_element(values, key, other) is not None for key in keys[:1]):
            raise InputError(f"the values are {other}D, but the graph is {d}D")
        said = f"{counted(len(keys), 'value{s}')}, but no {d}D pose or rotation"
        raise InputError(f"{said}; certpgo.from_gtsam takes similarities, with their factors")
    others = [key for key in keys if key not in found] if of_points else []
    points = {key: M for key in others if (M := _point(values, key, d)) is not None}
    return _Elements(found, points)


def _point(values: Any, key: int, d: int) -> FloatArray | None:
    get: Callable[[int], Any] | None = getattr(values, f"atPoint{d}", None)
    if get is None:
        return None
    try:
        position = np.asarray(get(key), dtype=np.float64)
    except Exception:  # the binding's error for a value of another type
        return None
    M = np.eye(d + 1)
    M[:d, d] = position
    return M


def _element(values: Any, key: int, d: int) -> FloatArray | None:
    for name, size in ((f"atPose{d}", d + 1), (f"atRot{d}", d)):
        get: Callable[[int], Any] | None = getattr(values, name, None)
        if get is None:
            continue
        try:
            element = get(key)
        except Exception:  # the binding's error for a value of another type
            continue
        M = np.asarray(element.matrix(), dtype=np.float64)
        if M.shape == (size, size):
            return M
    return None


def _keys_of(elements: dict[int, FloatArray], ids: list[int], what: str) -> tuple[list[int], str]:
    """The key of each id, and a notice if it is not the id itself."""
    extra = len(elements) - len(ids)
    unused = f"{counted(extra, what + '{s}')} of other keys ignored" if extra else ""
    if not elements:
        raise InputError(f"the values hold no {what}s, and the graph has {len(ids)}")
    if all(node in elements for node in ids):
        return ids, unused
    letters: dict[int, dict[int, int]] = {}
    for key in elements:
        letters.setdefault(key >> INDEX_BITS, {})[key & ((1 << INDEX_BITS) - 1)] = key
    fitting = [letter for letter, keys in letters.items() if all(node in keys for node in ids)]
    if len(fitting) == 1:
        keys = letters[fitting[0]]
        match = (
            f"keys matched with node ids by the index of the symbols {shown_id(keys[ids[0]])} ..."
        )
        return [keys[node] for node in ids], f"{match}; {unused}" if unused else match
    found = f"the values hold {_range(sorted(elements))}, the graph has {_range(sorted(ids))}"
    if len(fitting) > 1:
        raise InputError(f"{found}: several letters fit; give ids, the key of each node")
    if extra == 0:
        rank = dict(zip(sorted(ids), sorted(elements), strict=True))
        return [rank[node] for node in ids], f"{found}: matched in ascending order"
    raise InputError(f"{found}: they do not match; give ids, the key of each node")


def _range(keys: list[int]) -> str:
    first, last = shown_id(keys[0]), shown_id(keys[-1])
    return f"{len(keys)} keys {first} ... {last}" if len(keys) > 1 else f"the key {first}"

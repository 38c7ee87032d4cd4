"""Names of nodes or images, and the numbers in them, used as node ids."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from certpgo.errors import InputError
from certpgo.io.format import LabelledPoses
from certpgo.linalg.arrays import IntArray, numbered


def name_numbers(names: Sequence[str]) -> IntArray | None:
    """The last number in each name without extension; None unless all have distinct ones.

    ``frame_12.jpg`` is 12, ``left/0007.png`` is 7.
    """
    found = [re.findall(r"\d+", PurePosixPath(name).stem) for name in names]
    if not all(found) or max(len(digits[-1]) for digits in found) > 18:
        return None
    numbers = np.array([int(digits[-1]) for digits in found], dtype=np.intp)
    return numbers if len(np.unique(numbers)) == len(numbers) else None


def named_ids(
    poses: LabelledPoses, ids: IntArray | None, names: Sequence[str]
) -> tuple[IntArray | None, str]:
    """The node id of each named pose, and a notice if that is a guess.

    Names are matched with the graph's own names; without those, the file's ids are used if they are
    the graph's, otherwise the numbers in the names.

    Parameters
    ----------
    ids, names : (n,) of the graph, if there is one; names may be empty
    """
    numbers = name_numbers(poses.names)
    if ids is None:
        return (numbers if poses.ids is None else poses.ids), ""
    if names:
        return _by_name(poses.names, ids, names), ""
    fitting = numbers if numbers is not None and _covers(ids, numbers) else None
    if poses.ids is None:
        if numbers is None:
            raise InputError("the names contain no distinct numbers to use as node ids")
        return numbers, "the numbers in names are used as node ids"
    if fitting is None or np.array_equal(fitting, poses.ids):
        return poses.ids, ""
    if _covers(ids, poses.ids):
        return poses.ids, "image ids are used as node ids; the numbers in image names fit as well"
    return fitting, "image ids are not node ids: the numbers in image names are used instead"


def _by_name(given: Sequence[str], ids: IntArray, names: Sequence[str]) -> IntArray:
    known = dict(zip(names, ids.tolist(), strict=True))
    foreign = [name for name in given if name not in known]
    if foreign:
        raise InputError(
            f"estimate of another graph: {foreign[0]} is not in the graph "
            f"({len(foreign)} of {len(given)} are not)"
        )
    return np.array([known[name] for name in given], dtype=np.intp)


def _covers(ids: IntArray, given: IntArray) -> bool:
    """Whether ``given`` are exactly the graph's ids, in any order."""
    return len(given) == len(ids) and bool((numbered(ids, given) >= 0).all())

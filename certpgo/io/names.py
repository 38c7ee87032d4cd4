"""Names of nodes or images, and the numbers in them, used as node ids."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from certpgo.errors import InputError
from certpgo.io.format import LabelledPoses
from certpgo.linalg.arrays import IntArray

#: A letter and an id, which may be negative.
_LETTERED = re.compile(r"[A-Za-z]-?\d+")


def name_numbers(names: Sequence[str]) -> IntArray | None:
    """The last number in each name without extension; None unless all have distinct ones.

    ``frame_12.jpg`` is 12, ``left/0007.png`` is 7. Of names that are a letter and an integer, as
    PyFG files have them, ``A-1`` is -1.
    """
    signed = all(map(_LETTERED.fullmatch, names))
    found = [re.findall(r"-?\d+" if signed else r"\d+", PurePosixPath(name).stem) for name in names]
    if not all(found) or max(len(digits[-1]) for digits in found) > 18:
        return None
    numbers = np.array([int(digits[-1]) for digits in found], dtype=np.intp)
    return numbers if len(np.unique(numbers)) == len(numbers) else None


def named_ids(poses: LabelledPoses, ids: IntArray) -> tuple[IntArray, str]:
    """The node id of each named pose, and a notice if that is a guess.

    The file's ids, or the numbers in the names if more of these are the graph's.

    Parameters
    ----------
    ids : (n,) of the graph, which has no names

    Raises
    ------
    InputError
        The file has no ids, and the names no distinct numbers.
    """
    numbers = name_numbers(poses.names)
    if poses.ids is None:
        if numbers is None:
            raise InputError("the names contain no distinct numbers to use as node ids")
        return numbers, "the numbers in names are used as node ids"
    if numbers is None or np.array_equal(numbers, poses.ids):
        return poses.ids, ""
    fitting, by_number = (int(np.isin(ids, given).sum()) for given in (poses.ids, numbers))
    if by_number > fitting:
        said = "image ids are not node ids: the numbers in image names are used instead"
        return numbers, said
    if by_number == fitting > 0:
        said = "image ids are used as node ids; the numbers in image names fit as well"
        return poses.ids, said
    return poses.ids, ""

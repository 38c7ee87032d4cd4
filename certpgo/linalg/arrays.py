"""Array types for annotations, read-only arrays, and positions of ids."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from certpgo.errors import GraphError, InputError, kind_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.integer[Any]]
BoolArray = NDArray[np.bool_]
CSC = sparse.csc_array


def frozen_floats(values: ArrayLike) -> FloatArray:
    """A read-only, C-contiguous float64 array; the input is copied unless it is already one."""
    return _freeze(values, np.float64)


def frozen_indices(values: ArrayLike) -> IntArray:
    """A read-only, C-contiguous index array; the input is copied unless it is already one.

    Raises
    ------
    GraphError
        A number is not whole, or beyond 64 bits.
    """
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise InputError(f"an array of numbers expected, not {kind_of(values)}") from None
    if given.dtype.kind not in "ib":
        wrong = _no_index(given)
        if wrong.any():
            found = given[wrong].tolist()[0]
            shown = repr(found)[:40] if isinstance(found, int | float | str) else kind_of(found)
            raise GraphError(f"whole numbers of 64 bits expected, not {shown}")
    return _freeze(given, np.intp)


def _no_index(given: NDArray[Any]) -> BoolArray:
    """Which entries of an array of another type than integers are no integers of 64 bits."""
    if given.dtype.kind == "u":
        return np.asarray(given >= 2**63)
    if given.dtype.kind != "f":
        flags = [not _is_index(value) for value in given.ravel().tolist()]
        return np.array(flags, dtype=np.bool_).reshape(given.shape)
    return np.asarray((given != np.rint(given)) | ~(np.abs(given) < 2.0**63))


def frozen_flags(values: ArrayLike) -> BoolArray:
    """A read-only, C-contiguous array of booleans; the input is copied unless it is already one."""
    return _freeze(values, np.bool_)


def _freeze(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    try:
        array = np.ascontiguousarray(values, dtype=dtype)
    except (TypeError, ValueError):  # objects, words, or rows of different lengths
        raise InputError(f"an array of numbers expected, not {kind_of(values)}") from None
    if array.flags.writeable:
        array = array.copy() if np.shares_memory(array, np.asarray(values)) else array
        array.flags.writeable = False
    return array


def _is_index(value: object) -> bool:
    return isinstance(value, int) and -(2**63) <= value < 2**63


def chosen_rows(chosen: ArrayLike, n: int, which: str) -> NDArray[Any]:
    """Indices, or flags, of some of n rows; anything else is refused by an InputError.

    Parameters
    ----------
    which : what the rows are, in the plural
    """
    try:
        rows = np.asarray(chosen)
        rows = rows if rows.size or rows.dtype.kind == "b" else rows.astype(np.intp)
    except ValueError:  # rows of different lengths
        raise InputError(f"{which} are chosen by their numbers, or {n} flags") from None
    flags = rows.dtype.kind == "b" and rows.shape == (n,)
    if not flags and (rows.dtype.kind not in "iu" or rows.ndim != 1):
        raise InputError(f"{which} are chosen by their numbers, or {n} flags")
    if not flags and rows.size and not -n <= rows.min() <= rows.max() < n:
        raise InputError(f"{which} are numbered from 0 to {n - 1}")
    return rows


def numbered(ids: IntArray, queries: IntArray) -> IntArray:
    """Position in ``ids`` (ascending) of each of ``queries``; -1 if absent."""
    if not len(ids):
        return np.full(np.shape(queries), -1)
    place = np.minimum(np.searchsorted(ids, queries), len(ids) - 1)
    return np.asarray(np.where(ids[place] == queries, place, -1), dtype=np.intp)


def round_below(number: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is at most a positive number."""
    power = 10.0 ** math.floor(math.log10(number))
    # The logarithm may be rounded up.
    return power * max(k for k in (0.5, 1.0, 2.0, 5.0) if k * power <= number)

"""Array types for annotations, read-only arrays, and positions of ids."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.integer[Any]]
BoolArray = NDArray[np.bool_]
CSC = sparse.csc_array


def frozen_floats(values: ArrayLike) -> FloatArray:
    """A read-only, C-contiguous float64 array; the input is copied unless it is already one."""
    return _freeze(values, np.float64)


def frozen_indices(values: ArrayLike) -> IntArray:
    """A read-only, C-contiguous index array; the input is copied unless it is already one."""
    return _freeze(values, np.intp)


def frozen_flags(values: ArrayLike) -> BoolArray:
    """A read-only, C-contiguous array of booleans; the input is copied unless it is already one."""
    return _freeze(values, np.bool_)


def _freeze(values: ArrayLike, dtype: Any) -> NDArray[Any]:
    array = np.ascontiguousarray(values, dtype=dtype)
    if array.flags.writeable:
        array = array.copy() if np.shares_memory(array, np.asarray(values)) else array
        array.flags.writeable = False
    return array


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

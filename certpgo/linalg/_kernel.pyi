"""The compiled kernel: see `certpgo.linalg.multifrontal`. Arrays are contiguous."""

from typing import Any

from certpgo.linalg.arrays import FloatArray, IntArray

def order(indptr: IntArray, indices: IntArray, /) -> bytes: ...
def analyze(
    indptr: IntArray, indices: IntArray, order: IntArray, sizes: IntArray, /
) -> tuple[bytes, bytes, bytes, bytes, bytes, bytes]: ...
def measure(
    offset: IntArray,
    start: IntArray,
    above: IntArray,
    begin: IntArray,
    rows: IntArray,
    panel: IntArray,
    /,
) -> tuple[int, int, int]: ...
def factor(
    fronts: tuple[Any, ...],
    data: FloatArray,
    panels: FloatArray | None,
    weights: FloatArray | None,
    sums: FloatArray | None,
    squares: FloatArray | None,
    single: bool,
    /,
) -> bool: ...
def solve(fronts: tuple[Any, ...], panels: FloatArray, X: FloatArray, single: bool, /) -> None: ...
def lower(
    fronts: tuple[Any, ...],
    panels: FloatArray,
    heights: IntArray,
    rows: IntArray,
    values: FloatArray,
    /,
) -> int: ...

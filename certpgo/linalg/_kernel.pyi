"""The compiled kernel: see `certpgo.linalg.multifrontal`. Arrays are contiguous."""

from typing import Any

from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.multifrontal import Kept, Triple

def order(indptr: IntArray, indices: IntArray, /) -> bytes: ...
def analyze(
    indptr: IntArray, indices: IntArray, order: IntArray, sizes: IntArray, /
) -> tuple[bytes, bytes, bytes, bytes, bytes, bytes]: ...
def measure(
    indptr: IntArray,
    indices: IntArray,
    order: IntArray,
    sizes: IntArray,
    start: IntArray,
    above: IntArray,
    begin: IntArray,
    rows: IntArray,
    place: IntArray,
    offset: IntArray,
    entry: IntArray,
    panel: IntArray,
    /,
) -> tuple[int, int, int]: ...
def pin(indptr: IntArray, indices: IntArray, data: FloatArray, rows: IntArray, /) -> None: ...
def settle(*arrays: Any) -> tuple[float, bool] | None: ...
def lever_sums(edges: tuple[Any, ...], d: int, sums: FloatArray, /) -> None: ...
def factor(
    fronts: tuple[Any, ...],
    data: FloatArray,
    scale: FloatArray | None,
    panels: Kept | None,
    sums: Triple | None,
    residual: Triple | None,
    single: bool,
    /,
) -> bool: ...
def solve(
    fronts: tuple[Any, ...],
    panels: Kept,
    scale: FloatArray | None,
    B: FloatArray,
    X: FloatArray,
    single: bool,
    /,
) -> None: ...
def inverse_blocks(
    indptr: IntArray,
    indices: IntArray,
    L: FloatArray,
    at: IntArray,
    order: IntArray,
    above: bool,
    blocks: FloatArray,
    /,
) -> bool | None: ...
def lower(
    fronts: tuple[Any, ...],
    panels: Kept,
    heights: IntArray,
    rows: IntArray,
    values: FloatArray,
    /,
) -> int: ...
def gradient(
    edges: tuple[Any, ...],
    d: int,
    r: int,
    R: FloatArray,
    t: FloatArray | None,
    G: FloatArray | None,
    terms: FloatArray,
    /,
) -> None: ...
def first_order(
    edges: tuple[Any, ...],
    d: int,
    R: FloatArray,
    t: FloatArray | None,
    turning: FloatArray,
    moving: FloatArray | None,
    tangent: FloatArray,
    multipliers: FloatArray,
    terms: FloatArray,
    /,
) -> float: ...
def hessian(
    edges: tuple[Any, ...],
    d: int,
    R: FloatArray,
    multipliers: FloatArray,
    spread: FloatArray,
    first: FloatArray | None,
    degree: FloatArray | None,
    diagonal: FloatArray,
    upper: FloatArray,
    /,
) -> None: ...
def slopes(
    edges: tuple[Any, ...],
    d: int,
    weights: FloatArray,
    series: FloatArray | None,
    R: FloatArray,
    t: FloatArray,
    terms: FloatArray,
    gradient: FloatArray,
    /,
) -> None: ...
def curvatures(
    edges: tuple[Any, ...],
    d: int,
    weights: FloatArray,
    series: FloatArray | None,
    R: FloatArray,
    t: FloatArray,
    diagonal: FloatArray,
    upper: FloatArray,
    /,
) -> None: ...
def turn(R: FloatArray, v: FloatArray, d: int, left: bool, out: FloatArray, /) -> None: ...
def assemble(
    places: tuple[IntArray, ...],
    diagonal: FloatArray,
    upper: FloatArray,
    data: FloatArray,
    /,
) -> None: ...
def subtract(
    indptr: IntArray,
    own: IntArray,
    b: int,
    values: FloatArray,
    d: int,
    data: FloatArray,
    /,
) -> None: ...
def scatter_sum(index: IntArray, values: FloatArray, sums: FloatArray, columns: int, /) -> None: ...
def components(pairs: IntArray, labels: IntArray, /) -> None: ...
def tree(pairs: IntArray, root: int, parents: IntArray, order: IntArray, /) -> None: ...
def compose(
    edges: tuple[Any, ...],
    d: int,
    parents: IntArray,
    R: FloatArray,
    t: FloatArray | None,
    /,
) -> None: ...
def angles(edges: tuple[Any, ...], d: int, R: FloatArray, angles: FloatArray, /) -> None: ...
def residuals(
    edges: tuple[Any, ...],
    d: int,
    R: FloatArray,
    t: FloatArray | None,
    turned: FloatArray,
    moved: FloatArray | None,
    /,
) -> None: ...
def lessen(
    shift: float,
    gauge: FloatArray | None,
    blocks: FloatArray,
    nodes: IntArray,
    d: int,
    multipliers: FloatArray,
    /,
) -> None: ...
def blocks(pairs: IntArray, indptr: IntArray, indices: IntArray, slots: IntArray, /) -> int: ...
def worst_defect(R: FloatArray, d: int, /) -> tuple[int, float]: ...
def expand(indptr: IntArray, indices: IntArray, b: int, rows: IntArray, /) -> None: ...
def diagonal_places(indptr: IntArray, indices: IntArray, places: IntArray, /) -> None: ...
def combine(
    operation: str,
    unit: float,
    a: FloatArray,
    a_radius: FloatArray,
    b: FloatArray,
    b_radius: FloatArray,
    mid: FloatArray,
    radius: FloatArray,
    /,
) -> None: ...
def polynomial(
    coefficients: FloatArray,
    unit: float,
    x: FloatArray,
    radii: FloatArray,
    mid: FloatArray,
    radius: FloatArray,
    /,
) -> None: ...
def eliminate(
    A: FloatArray,
    radii: FloatArray,
    p: int,
    count: int,
    unit: float,
    mid: FloatArray,
    radius: FloatArray,
    proven: IntArray,
    /,
) -> None: ...
def multiply(
    fronts: tuple[Any, ...], data: FloatArray, x: FloatArray, y: FloatArray, /
) -> None: ...
def tagged_lines(
    text: bytes, tags: tuple[tuple[bytes, int, int], ...], first: int, /
) -> tuple[
    list[tuple[bytearray, bytearray, bytearray, bytearray, list[bytes]]], list[tuple[int, bytes]]
]: ...
def numbers(texts: list[bytes], values: FloatArray, lengths: IntArray, /) -> bool: ...

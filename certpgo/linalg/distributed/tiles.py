"""What the tasks of a factorization compute: subtrees by the kernel, separators tile by tile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.linalg.multifrontal import Elimination, Fronts, Kept

#: Half the distance between 1 and the next number; the unit of the leading part of L.
U, UNIT = 2.0**-53, 2.0**24


class NotDefinite(Exception):  # noqa: N818
    """The matrix is not positive definite."""


@dataclass(frozen=True, eq=False)
class RowScaling:
    """To measure the residual at the rows of a tile: powers of two, and weights over these."""

    scale: FloatArray
    v: FloatArray


@dataclass(frozen=True, eq=False)
class Tile:
    """A tile of L or of an update, and what rounding did to it.

    Attributes
    ----------
    values : (h, w); those on the diagonal are whole
    rows, columns : (h,) and (w,) bounds on the row sums of |E| v and of its transpose
    squares : (h,) squared norms of the rows, of L only
    """

    values: Kept
    rows: FloatArray
    columns: FloatArray
    squares: FloatArray


def subtree(fronts: Fronts, data: FloatArray, **options: Any) -> Elimination:
    """Eliminate the nodes of subtrees.

    Raises
    ------
    NotDefinite
        The matrix is not positive definite.
    """
    done = fronts.eliminate(data, **options)
    if done is None:
        raise NotDefinite
    return done


def update_of(done: Elimination, begin: int, size: int, rows: slice, columns: slice) -> Kept:
    """Part of the update of a subtree's root."""
    lower = done.update[begin : begin + size**2].reshape(size, size).T
    block = lower[rows, columns]
    return np.tril(block) + np.tril(block, -1).T if rows == columns else block.copy()


def block_of(tile: Tile, rows: slice, columns: slice) -> Kept:
    """Part of a tile."""
    return tile.values[rows, columns]


def eliminate(
    shape: tuple[int, int],
    entries: tuple[IntArray, IntArray, Kept] | None,
    incoming: Sequence[tuple[Kept, IntArray, IntArray]],
    left: Sequence[tuple[Tile, Tile]],
    corner: Tile | None,
    *,
    kind: tuple[bool, bool],
    real: Any,
    measured: tuple[RowScaling, RowScaling] | None,
) -> Tile:
    """A tile of a front: assemble it, subtract the products of the columns before, and divide.

    Parameters
    ----------
    entries : rows, columns and values of the matrix, lower triangle only
    incoming : updates of the parts below, and their rows and columns
    left : the tiles of these rows and of these columns in each column of tiles before
    corner : the diagonal tile of the column, if this is one of L below it
    kind : whether the tile is on the diagonal, and whether it is one of L
    measured : of rows and columns

    Raises
    ------
    NotDefinite
        The matrix is not positive definite.
    """
    on_diagonal, is_own = kind
    F: Any = np.zeros(shape, dtype=real)
    if entries is not None:
        rows, columns, values = entries
        F[rows, columns] = values
        if on_diagonal:
            F = np.tril(F) + np.tril(F, -1).T
    lost = np.zeros(shape if measured else (0, 0))
    for update, rows, columns in incoming:
        place = np.ix_(rows, columns)
        total = F[place] + update
        if measured:
            lost[place] += np.abs(_rounding(F[place], update, total))
        F[place] = total
    rest = F.copy()
    for row, column in left:
        rest -= row.values @ column.values.T
    if on_diagonal:  # what goes up is the lower triangle, and the residual is measured for both
        rest = np.tril(rest) + np.tril(rest, -1).T
    L: Any
    if not is_own:
        L = rest
    elif corner is None:
        L = _cholesky(rest)
    else:
        L = solve_triangular(corner.values, rest.T, lower=True, check_finite=False).T
    squares = np.einsum("rc,rc->r", L, L, dtype=np.float64) if is_own else np.zeros(shape[0])
    none = np.zeros(0)
    tile = Tile(L, none, none, squares)
    if measured is None:
        return tile
    pairs = [*left, (tile, corner or tile)] if is_own else list(left)
    sizes = lost * np.outer(measured[0].scale, measured[1].scale)
    sums = _residual(F, None if is_own else L, pairs, sizes, *measured)
    return Tile(L, sums[0], none if on_diagonal else sums[1], squares)


def _cholesky(A: Kept) -> Kept:
    try:
        L = np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        raise NotDefinite from None
    if not ((np.diag(L) > 0.0) & (np.diag(L) < np.inf)).all():
        raise NotDefinite
    return L


def _rounding(a: Any, b: Any, total: Any) -> Any:
    """A + b - total, exactly (Knuth's TwoSum)."""
    part = total - a
    return (a - (total - part)) + (b - part)


def _residual(
    before: FloatArray,
    after: FloatArray | None,
    left: Sequence[tuple[Tile, Tile]],
    sizes: FloatArray,
    of_rows: RowScaling,
    of_columns: RowScaling,
) -> tuple[FloatArray, FloatArray]:
    """Bounds on |E| v and |E|^T v for E = before - sum of products - after, and ``sizes`` more.

    As `measure_front` in residual.h, in the same units; docs/multifrontal.md has the argument.
    """
    unit = np.outer(of_rows.scale, of_columns.scale)
    exact, cross = np.zeros_like(before), np.zeros_like(before)
    inner = sum(column.values.shape[1] for _, column in left)
    rows, columns = np.zeros(before.shape[0]), np.zeros(before.shape[1])
    for row, column in left:
        (H, low), (G, less) = _parts(row.values, of_rows), _parts(column.values, of_columns)
        exact += H @ G.T
        cross += H @ less.T + low @ (G + less).T
        for out, mine, others, v in (
            (rows, (H, low), (G, less), of_columns.v),
            (columns, (G, less), (H, low), of_rows.v),
        ):
            high, small = (np.abs(part).T @ v for part in others)
            out += np.abs(mine[0]) @ small + np.abs(mine[1]) @ (high + small)
    slack = 2.0 * (inner + 8.0 + len(left)) * U
    scaled, lost = before * unit, np.zeros_like(before)
    if after is not None:
        taken = after * unit
        difference = scaled - taken
        scaled, lost = difference, _rounding(scaled, -taken, difference)
    rest, small = scaled - exact, lost - cross
    sizes = sizes + np.abs(rest + small)
    sizes += 4.0 * U * (np.abs(rest) + np.abs(lost) + np.abs(cross))
    return slack * rows + sizes @ of_columns.v, slack * columns + sizes.T @ of_rows.v


def _parts(L: Kept, scaled: RowScaling) -> tuple[FloatArray, FloatArray]:
    """L = L1 + L2, scaled, with L1 in multiples of 2^-24."""
    whole: FloatArray = L * scaled.scale[:, None]
    high = np.rint(whole * UNIT) / UNIT
    return high, whole - high


def without_values(tile: Tile) -> Tile:
    """Only what rounding did."""
    return replace(tile, values=np.empty(0))


def sums_of(done: Elimination) -> Elimination:
    """Of a subtree, only sums."""
    return replace(done, panels=None, update=np.empty(0))


def panels_of(done: Elimination) -> Kept:
    """Of a subtree, L."""
    return np.asarray(done.panels)


def row_sums(column: Sequence[Tile], weights: FloatArray) -> FloatArray:
    """|L| |L|^T w and squared norms of rows (k + 1, h) of a column of tiles; weights (k, h)."""
    L = np.concatenate([np.asarray(tile.values, dtype=np.float64) for tile in column])
    size = np.abs(L)
    return np.concatenate([(size @ (size.T @ weights.T)).T, [np.einsum("rc,rc->r", L, L)]])


def panel(columns: Sequence[Sequence[Tile]], height: int, real: Any) -> Kept:
    """L of a separator, column by column, from its tiles on and below the diagonal."""
    panels = []
    for column in columns:
        L = np.concatenate([tile.values for tile in column])
        whole = np.zeros((L.shape[1], height), dtype=real)
        whole[:, height - len(L) :] = L.T
        panels.append(whole)
    return np.concatenate(panels).ravel()


def forward(
    fronts: Fronts,
    panels: Kept,
    right: FloatArray,
    incoming: Sequence[tuple[FloatArray, int, IntArray]],
) -> FloatArray:
    """L^-1 X (k, N) of a part; ``right`` has its own rows, the parts below bring updates."""
    X = np.zeros((len(right), fronts.size))
    X[:, : right.shape[1]] = right
    for other, own, places in incoming:
        X[:, places] += other[:, own:]
    return fronts.substitute(panels, X, 1)


def backward(
    fronts: Fronts,
    panels: Kept,
    forwarded: FloatArray,
    above: FloatArray | None,
    own: int,
    places: IntArray,
) -> FloatArray:
    """L^-T X (k, N) of a part, from what `forward` found and the solution of the part above."""
    X = forwarded.copy()
    X[:, own:] = 0.0 if above is None else above[:, places]
    return fronts.substitute(panels, X, -1)


def own_rows(X: FloatArray, own: int) -> FloatArray:
    """The first rows (k, own)."""
    return X[:, :own]

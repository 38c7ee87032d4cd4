"""Several files of tagged lines that are read as one graph.

Ids and names mean the same node in all of them. A vertex that several files have has the values of
the first. A measurement that is in several files, in the same numbers, is one measurement: robots
often store both the measurements between them. Parallel measurements of one file are kept: one that
a file has twice counts twice, whichever files have it too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.io.compressed import uncompressed_name
from certpgo.io.dialect import Kind
from certpgo.io.records import Records, Rows
from certpgo.linalg.arrays import BoolArray, IntArray

#: What becomes of vertices and measurements that several files have.
VALUED = "node{s} with values in several files: the first one's are used"
REPEATED = "measurement{s} in several files, in the same numbers: counted once"
_VALUES: tuple[Kind, ...] = ("pose", "point")
_MEASUREMENTS: tuple[Kind, ...] = ("edge", "sighting", "range", "prior")
#: Names that are written in full.
NAMED = 3


def joined_name(paths: Sequence[Path]) -> str:
    """The name of the graph in all the files."""
    names = [uncompressed_name(path).stem for path in paths]
    more = [f"{len(names) - NAMED} more"] if len(names) > NAMED else []
    return "+".join([*names[:NAMED], *more])


def joined_source(paths: Sequence[Path]) -> str:
    """Where it is from."""
    return ", ".join(map(str, paths))


@contextmanager
def located(paths: Sequence[Path], firsts: Sequence[int]) -> Iterator[None]:
    """Errors about lines, counted through all files, name the file and its own line.

    Parameters
    ----------
    firsts : numbers of the files' first lines
    """
    try:
        yield
    except FormatError as error:
        if len(paths) == 1:
            raise
        if error.line is None:
            raise type(error)(joined_source(paths), None, error.expected) from None
        file = int(np.searchsorted(firsts, error.line, side="right")) - 1
        line = error.line - firsts[file] + 1
        raise type(error)(paths[file], line, error.expected) from None


def counted_once(content: Records, path: Path, firsts: Sequence[int]) -> None:
    """Leave out what an earlier file has, with notices.

    Raises
    ------
    FormatError
        A fixed node has another pose in another file.
    """
    if len(firsts) == 1:
        return
    for kind in _VALUES:
        rows = content.take(kind)
        again = _again(rows.nodes, rows, firsts)
        kept, other = rows.subset(~again), rows.subset(again)
        order = np.argsort(kept.nodes[:, 0], kind="stable")
        first = kept.subset(order[np.searchsorted(kept.nodes[order, 0], other.nodes[:, 0])])
        moved = (first.rotations != other.rotations).any(axis=(1, 2))
        moved |= (first.translations != other.translations).any(axis=1)
        for row in np.flatnonzero(moved & np.isin(other.nodes[:, 0], content.fixed))[:1]:
            said = "is fixed, and has another pose here than in an earlier file"
            raise FormatError(path, int(other.lines[row]), f"node {other.nodes[row, 0]} {said}")
        content.counts[VALUED] += len(other)
        content.rows[kind] = [kept]
    for kind in _MEASUREMENTS:
        if not len(rows := content.take(kind)):
            continue
        again = _again(_numbers(rows), rows, firsts)
        content.counts[REPEATED] += int(again.sum())
        content.rows[kind] = [rows.subset(~again)]


def _again(keys: IntArray, rows: Rows, firsts: Sequence[int]) -> BoolArray:
    """(k,) which rows an earlier file has: the n-th of a file with these keys (k, c) its n-th."""
    if not len(rows):
        return np.zeros(0, dtype=bool)
    file = np.searchsorted(firsts, rows.lines, side="right")
    which = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    _, which = np.unique(np.stack([which, _ranks(file, which)]), axis=1, return_inverse=True)
    first = np.full(which.max() + 1, len(firsts) + 1)
    np.minimum.at(first, which.ravel(), file)
    return np.asarray(file > first[which.ravel()])


def _ranks(*keys: IntArray) -> IntArray:
    """(k,) how many earlier rows have the same keys."""
    order = np.lexsort(keys)
    begins = np.any([np.diff(key[order], prepend=-1) != 0 for key in keys], axis=0)
    ranks = np.empty(len(order), dtype=np.intp)
    at = np.arange(len(order))
    ranks[order] = at - np.maximum.accumulate(np.where(begins, at, 0))
    return ranks


def _numbers(rows: Rows) -> IntArray:
    """(k, c) all numbers of measurements, as integers that are equal where those are."""
    k = len(rows)
    floats = [rows.rotations, rows.translations, rows.kappa, rows.tau]
    if rows.information is not None:
        floats.append(rows.information.matrices)
    numbers = np.concatenate([np.reshape(x, (k, -1)) for x in floats], axis=1) + 0.0
    columns = [rows.nodes, np.ascontiguousarray(numbers).view(np.int64)]
    if len(rows.sensors):
        columns.append(rows.sensors[:, None])
    return np.concatenate(columns, axis=1)

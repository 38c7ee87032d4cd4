"""Databases of SQLite, which are only read."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from certpgo.errors import FormatError
from certpgo.linalg.arrays import FloatArray

#: The first bytes of such a file.
MAGIC = b"SQLite format 3\0"


def found_rows(path: Path, query: str, program: str) -> list[tuple[Any, ...]]:
    """The rows that a query finds; a FormatError names the program whose database is expected."""
    place = f"file:{quote(str(path.resolve()))}?mode=ro"
    try:
        with closing(sqlite3.connect(place, uri=True)) as database:
            return database.execute(query).fetchall()
    except sqlite3.Error as error:
        raise FormatError(path, None, f"a database of {program} expected: {error}") from None


def columns_of(path: Path, table: str, program: str) -> tuple[str, ...]:
    """The names of a table's columns; none if it is not there."""
    rows = found_rows(path, f"PRAGMA table_info({table})", program)
    return tuple(row[1] for row in rows)


def numbers_of(path: Path, place: str, blob: Any, size: int, kind: str) -> FloatArray | None:
    """The numbers (size,) of a blob; None if it is null or empty.

    Parameters
    ----------
    place : of the blob, for messages
    kind : ``"<f8"`` for doubles, ``"<f4"`` for single precision
    """
    if blob is None or blob == b"":
        return None
    called = {"<f8": "doubles", "<f4": "numbers of single precision"}[kind]
    if not isinstance(blob, bytes) or len(blob) != np.dtype(kind).itemsize * size:
        raise FormatError(path, None, f"{place}: {size} {called} expected")
    found = np.frombuffer(blob, dtype=kind).astype(np.float64)
    if not np.isfinite(found).all():
        raise FormatError(path, None, f"{place}: finite numbers expected")
    return found

"""Databases of SQLite, which are only read."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from itertools import count
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

import numpy as np

from certpgo.errors import FormatError
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import FloatArray

#: The first bytes of such a file.
MAGIC = b"SQLite format 3\0"
#: What a column holds.
Kind = Literal["integers", "numbers", "texts", "anything"]
_KINDS: dict[Kind, Any] = {
    "integers": int,
    "numbers": (int, float),
    "texts": str,
    "anything": object,
}
#: Instructions between two looks at how many there were, of which a byte of the file may take some.
_STEP, _PER_BYTE, _SMALL = 10_000, 50, 1 << 20


def kinds_of(path: Path, program: str) -> dict[str, str]:
    """The name of each table and view of a database, with ``table``, ``virtual table`` or ``view``.

    Raises
    ------
    FormatError
        It cannot be read; the message names the program whose database is expected.
    """
    query = "SELECT name, type, sql LIKE 'create virtual%' FROM sqlite_master"
    rows = _rows(path, query, program)
    known = [row for row in rows if isinstance(row[0], str) and row[1] in ("table", "view")]
    return {name: "virtual table" if virtual else kind for name, kind, virtual in known}


def columns_of(path: Path, table: str, program: str) -> tuple[str, ...]:
    """The names of a table's columns; none if it is not there.

    Raises
    ------
    FormatError
        It is a view, whose rows may have no end, or no plain table.
    """
    kind = kinds_of(path, program).get(table)
    if kind is None:
        return ()
    if kind != "table":
        said = f"a database of {program} expected, and {table} is a {kind}"
        raise FormatError(path, None, said)
    return tuple(row[1] for row in _rows(path, f"PRAGMA table_info({table})", program))


def found_rows(
    path: Path, table: str, columns: Mapping[str, Kind], program: str
) -> list[tuple[Any, ...]]:
    """Some columns of all rows of a table, in its order.

    Parameters
    ----------
    columns : what each of them holds; SQLite itself allows anything anywhere

    Raises
    ------
    FormatError
        There is no such table of columns, or a value of another kind.
    """
    missing = columns.keys() - {*columns_of(path, table, program)}
    if missing:
        said = f"a database of {program} expected, with {', '.join(columns)} in table {table}"
        raise FormatError(path, None, said)
    rows = _rows(path, f"SELECT {', '.join(columns)} FROM {table} ORDER BY rowid", program)
    for k, (name, kind) in enumerate(columns.items()):
        for row in rows:
            if not isinstance(row[k], _KINDS[kind]):
                said = f"table {table}: {kind} expected as {name}, not {str(row[k])[:40]!r}"
                raise FormatError(path, None, said)
    return rows


def _rows(path: Path, query: str, program: str) -> list[tuple[Any, ...]]:
    """What a query finds, in steps and memory that the size of the file bounds."""
    import sqlite3

    place = f"file:{quote(str(readable(path).resolve()))}?mode=ro"
    size, steps = readable(path).stat().st_size, count()
    try:
        with closing(sqlite3.connect(place, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(size, _SMALL))
            most = _PER_BYTE * max(size, _SMALL) // _STEP
            database.set_progress_handler(lambda: next(steps) > most, _STEP)
            return database.execute(query).fetchall()
    except sqlite3.Error as error:
        raise FormatError(path, None, f"a database of {program} expected: {error}") from None


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

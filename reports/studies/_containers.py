"""Small files of JSON, SQLite, Cartographer and scans, which the package does not write."""

from __future__ import annotations

import gzip
import json
import sqlite3
import struct
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from typing import Any

import numpy as np
from numpy.random import Generator

MAGIC = struct.pack("<Q", 0x7B1D1F7B5BF501DB)
#: 2022-02-14, in ticks of 100 ns since the year 1.
TICKS = (62135596800 + 1644823128) * 10**7 + 5 * 10**6
#: What a value of JSON or of a database becomes.
VALUES = (None, True, -1, 0, 2**31, 2**63 - 1, -(2**63), 1e308, float("inf"), float("nan"))
VALUES += (0.5, "many", "", "1e999999999999999999", "\udcff", [], {}, [[1]], b"", b"\xff" * 12)
#: Written as no number that Python writes.
_DIGITS = "9" * 5000


# --- JSON -----------------------------------------------------------------------------------------


def of_json(rng: Generator, data: bytes) -> bytes:
    """One value of a file of JSON changed, left out or said twice."""
    try:
        content = json.loads(data)
    except ValueError:  # mutated before
        return data[: len(data) // 2]
    places = list(_places(content))
    holder, key = places[int(rng.integers(0, len(places)))]
    if rng.random() < 0.1:
        del holder[key]
    elif rng.random() < 0.1:
        holder[key] = [holder[key]] * 2
    else:
        value = VALUES[int(rng.integers(0, len(VALUES)))]
        holder[key] = value if not isinstance(value, bytes) else "DIGITS"
    return json.dumps(content).replace('"DIGITS"', _DIGITS).encode("utf-8", "surrogatepass")


def _places(content: Any) -> Iterable[tuple[Any, Any]]:
    """Every list or object with the place of each value in it."""
    for key in list(content) if isinstance(content, dict) else range(len(content)):
        yield content, key
        if isinstance(content[key], dict | list):
            yield from _places(content[key])


# --- SQLite ---------------------------------------------------------------------------------------


def database(tables: dict[str, tuple[str, Sequence[Sequence[Any]]]]) -> bytes:
    """A database of tables by name: their columns as SQL, and rows."""
    with closing(sqlite3.connect(":memory:")) as made:
        for name, (columns, rows) in tables.items():
            made.execute(f"CREATE TABLE {name} ({columns})")
            marks = ", ".join("?" for _ in rows[0])
            made.executemany(f"INSERT INTO {name} VALUES ({marks})", rows)
        made.commit()
        return made.serialize()


def of_database(rng: Generator, data: bytes) -> bytes:
    """One value of a database changed, a table emptied, renamed, or replaced by an endless view."""
    try:
        with closing(sqlite3.connect(":memory:")) as given:
            given.deserialize(data)
            query = "SELECT name FROM sqlite_master WHERE type = 'table'"
            tables = [name for (name,) in given.execute(query)]
            table = tables[int(rng.integers(0, len(tables)))]
            columns = [row[1] for row in given.execute(f"PRAGMA table_info({table})")]
            column, choice = columns[int(rng.integers(0, len(columns)))], rng.random()
            if choice < 0.04:
                given.execute(f"DELETE FROM {table}")
            elif choice < 0.08:
                given.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO other")
            elif choice < 0.12:
                given.execute(f"ALTER TABLE {table} RENAME TO former")
                numbers = ", ".join(f"x AS {name}" for name in columns)
                given.execute(
                    f"CREATE VIEW {table} AS WITH RECURSIVE c(x) AS "
                    f"(SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT {numbers} FROM c"
                )
            else:
                plain = [v for v in VALUES if not isinstance(v, list | dict) and v != "\udcff"]
                value = plain[int(rng.integers(0, len(plain)))]
                row = int(rng.integers(0, 4))
                where = f"rowid IN (SELECT rowid FROM {table} LIMIT 1 OFFSET {row})"
                given.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (value,))
            given.commit()
            return given.serialize()
    except (sqlite3.Error, IndexError, UnicodeError):  # mutated before, or of the wrong type
        return data[: int(rng.integers(0, len(data) + 1))]


def databases() -> dict[str, bytes]:
    """One of rtabmap and one of COLMAP."""
    steps = [np.column_stack([np.eye(3), [k, 0, 0]]).astype("<f4").tobytes() for k in range(3)]
    weights = np.diag([100.0, 100, 100, 400, 400, 400]).tobytes()
    links = [(1, 2, 0, weights, steps[1]), (2, 3, 0, weights, steps[1])]
    links += [(1, 3, 1, weights, steps[2]), (1, 1, 7, weights, steps[0])]
    turn, step = np.array([1.0, 0.1, 0, 0]).tobytes(), np.array([1.0, 0, 0]).tobytes()
    pairs = [((2**31 - 1) * i + j, 50, 2, turn, step) for i, j in ((1, 2), (2, 3), (1, 3))]
    rtabmap = {
        "Node": (
            "id INTEGER PRIMARY KEY, stamp FLOAT, pose BLOB, gps BLOB",
            [(k + 1, 1.5 + k, steps[k], bytes(48)) for k in range(3)],
        ),
        "Link": (
            "from_id INTEGER, to_id INTEGER, type INTEGER, information_matrix BLOB, transform BLOB",
            links,
        ),
    }
    colmap = {
        "images": ("image_id INTEGER, name TEXT", [(k, f"im_{k}.jpg") for k in (1, 2, 3)]),
        "two_view_geometries": (
            "pair_id INTEGER, rows INTEGER, config INTEGER, qvec BLOB, tvec BLOB",
            pairs,
        ),
    }
    return {"rtabmap": database(rtabmap), "colmap database": database(colmap)}


# --- Cartographer ---------------------------------------------------------------------------------


def varint(value: int) -> bytes:
    """A whole number, seven bits a byte."""
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def message(**fields: Any) -> bytes:
    """Fields called f1, f2, ...: ints, floats, or bytes (a list of these is repeated)."""
    out = b""
    for name, given in fields.items():
        for value in given if isinstance(given, list) else [given]:
            number = int(name[1:]) << 3
            if isinstance(value, float):
                out += varint(number | 1) + struct.pack("<d", value)
            elif isinstance(value, int):
                out += varint(number) + varint(value)
            else:
                out += varint(number | 2) + varint(len(value)) + value
    return out


def rigid(x: float, z: float = 0.0, q: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> bytes:
    """A pose."""
    turned = {f"f{k}": c for k, c in enumerate(q, 1)}
    return message(f1=message(f1=x, f3=z), f2=message(**turned))


def constraint(
    submap: tuple[int, int], node: tuple[int, int], x: float, tag: int = 0, **pose: Any
) -> bytes:
    """A measurement of a node in a submap."""
    ends = (message(f1=k[0], f2=k[1]) for k in (submap, node))
    found = rigid(x, **pose)
    return message(**dict(zip(("f1", "f2"), ends, strict=True)), f3=found, f5=tag, f6=10.0, f7=20.0)


def records(contents: Iterable[bytes]) -> bytes:
    """A file of these records."""
    packed = map(gzip.compress, contents)
    return MAGIC + b"".join(struct.pack("<Q", len(record)) + record for record in packed)


def state(constraints: list[bytes], *, indexed: bool = True) -> bytes:
    """A state of Cartographer of two submaps and two nodes."""
    index = [{"f7": k} if indexed and k else {} for k in range(2)]
    nodes = [message(f1=TICKS + k * 10**7, f5=rigid(float(k)), **index[k]) for k in range(2)]
    submaps = [
        message(f1=rigid(float(k)), **({"f2": k} if indexed and k else {})) for k in range(2)
    ]
    graph = message(f2=constraints, f4=message(f1=nodes, f2=submaps))
    return records([message(f1=2), message(f1=graph), message(f3=b"")])


def of_records(change: Callable[[Generator, bytes], bytes]) -> Callable[[Generator, bytes], bytes]:
    """A mutation of what a record contains, which is then compressed again."""

    def mutation(rng: Generator, data: bytes) -> bytes:
        contents, at = [], len(MAGIC)
        try:
            while at < len(data):
                (size,) = struct.unpack_from("<Q", data, at)
                contents.append(gzip.decompress(data[at + 8 : at + 8 + size]))
                at += 8 + size
            chosen = int(rng.integers(0, len(contents)))
        except Exception:  # mutated before
            return change(rng, data)
        contents[chosen] = change(rng, contents[chosen])
        if rng.random() < 0.02:  # a bomb
            contents[chosen] += message(f9=bytes(1 << 25))
        return records(contents)

    return mutation


# --- Scans ----------------------------------------------------------------------------------------


def scans() -> dict[str, bytes]:
    """Files of points: PCD, VTK, PLY and CSV."""
    points = [[1.0, 2.0, 3.0], [4.5, 5.5, 6.5], [7.0, 8.0, 9.0]]
    text = "".join(f"{x} {y} {z}\n" for x, y, z in points).encode()
    packed = np.array(points, "<f4").tobytes()
    pcd = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\n"
    vtk = b"# vtk DataFile Version 3.0\nscan\n%s\nDATASET POLYDATA\nPOINTS 3 float\n"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    return {
        "pcd": f"{pcd}POINTS 3\nDATA ascii\n".encode() + text,
        "pcd binary": f"{pcd}POINTS 3\nDATA binary\n".encode() + packed,
        "vtk": vtk % b"ASCII" + text,
        "vtk binary": vtk % b"BINARY" + np.array(points, ">f4").tobytes(),
        "ply": f"ply\nformat ascii 1.0\nelement vertex 3\n{axes}end_header\n".encode() + text,
        "csv": b"x,y,z\n" + text.replace(b" ", b","),
    }

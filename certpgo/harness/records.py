"""What came out: one solve, one JSON line.

Records are kept raw, so that a report is a pure function of them and a caption costs no re-run.
"""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

from certpgo.errors import FormatError

#: Distributions whose versions a record names.
DISTRIBUTIONS = ("certpgo", "numpy", "scipy", "gtsam", "cvxopt")


@dataclass(frozen=True)
class Record:
    """One method on one instance.

    Attributes
    ----------
    table, row, method : labels, as in the specification
    part : which component of a graph that is not connected, or empty
    solver, settings : what was run
    reading : reading options of the instance, as text
    judging : reading options of the graph that metrics were evaluated on, when another
    seed : of a synthetic instance, or None
    d, n, m : dimension, nodes, edges
    metrics : metric to value
    verdict, tier, reason : of the certificate, or empty
    status, iterations, seconds, note : as the method reported them
    error : why there is no answer, or empty
    provenance : versions, machine, engine, threads, commit, date
    """

    table: str
    row: str
    method: str
    part: str = ""
    solver: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    reading: Mapping[str, str] = field(default_factory=dict)
    judging: Mapping[str, str] | None = None
    seed: int | None = None
    d: int | None = None
    n: int | None = None
    m: int | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    verdict: str = ""
    tier: str = ""
    reason: str = ""
    status: str = ""
    iterations: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    error: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)


def as_data(record: Record) -> dict[str, Any]:
    """The record as plain data; numbers that are not finite become None."""
    return {f.name: _plain(getattr(record, f.name)) for f in fields(record)}


def to_line(record: Record) -> str:
    """The record as one line of JSON."""
    return json.dumps(as_data(record), allow_nan=False)


def from_line(line: str) -> Record:
    """The record of one line; fields it does not know are dropped.

    Raises
    ------
    ValueError
        The line is no record.
    """
    data = json.loads(line)
    known = {f.name for f in fields(Record)}
    if not isinstance(data, dict) or not {"table", "row", "method"} <= set(data):
        raise ValueError("not a record")
    return Record(**{key: value for key, value in data.items() if key in known})


def read_records(path: Path) -> tuple[Record, ...]:
    """Every record of the file; a last line that was cut short is passed over.

    Raises
    ------
    FormatError
        Another line is no record.
    """
    lines = path.read_text(encoding="utf-8").split("\n")
    records = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            records.append(from_line(line))
        except (ValueError, TypeError) as error:
            if number == len(lines):
                break
            raise FormatError(path, number, "a record, one JSON object a line") from error
    return tuple(records)


@contextmanager
def new_file(path: Path) -> Iterator[TextIO]:
    """A file that appears under its name when the block ends, however it ends.

    Records are flushed line by line by the caller; an interrupted run keeps what is done.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("w", encoding="utf-8") as stream:
            yield stream
    finally:
        os.replace(part, path)


def provenance(engine: str, root: Path | None) -> dict[str, str]:
    """What made the numbers, apart from their inputs.

    Parameters
    ----------
    engine : factorization engine
    root : checkout whose commit is named, or None
    """
    return {
        "versions": ", ".join(_versions()),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "engine": engine,
        "threads": os.environ.get("OMP_NUM_THREADS", "default"),
        "commit": _commit(root),
        "date": datetime.now(UTC).strftime("%Y-%m-%dT%H:%MZ"),
    }


def _versions() -> Iterator[str]:
    for name in DISTRIBUTIONS:
        try:
            yield f"{name} {metadata.version(name)}"
        except metadata.PackageNotFoundError:
            continue


@cache
def _commit(root: Path | None) -> str:
    if root is None or not (root / ".git").exists():
        return "unknown"
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude=*"],
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

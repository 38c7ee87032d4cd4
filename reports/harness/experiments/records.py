"""What came out: one solve, one JSON line.

Records are kept raw, so that a report is a pure function of them and a caption costs no re-run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.certify import Certificate
from certpgo.errors import FormatError, InputError
from certpgo.io.plain import plain
from certpgo.optimize.solution import Solution

#: Iterations that a record keeps of a method.
TRACED = 40
#: How far below and above the answer's cost the last one told may be, relative: what is told may
#: end before a last projection, and nothing of F ends below it.
ENDS = 1e-6, 1e-3


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
    certified_by : the bounds that show the answer, or the stationary one beside it, to be optimal
    status, iterations, seconds, counts, note : as the method reported them
    trace : at most `TRACED` rows of seconds and cost as the method went on, of the first seed alone
    error : why there is no answer, or empty
    kind : ``"poses"`` or ``"rotations"``, of the graph
    key : what was asked for, see `reports.harness.experiments.keys`; empty in older records
    profile : ``"quick"`` or ``"full"``
    parts : how many records have the key, one a component
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
    certified_by: str = ""
    tier: str = ""
    reason: str = ""
    status: str = ""
    iterations: int | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    note: str = ""
    trace: tuple[tuple[float, float], ...] = ()
    error: str = ""
    kind: str = ""
    key: str = ""
    profile: str = ""
    parts: int = 1
    provenance: Mapping[str, str] = field(default_factory=dict)


def of_solution(solution: Solution) -> dict[str, Any]:
    """The fields of a record that say how a method ended and what it did."""
    return {
        "status": solution.status.value,
        "iterations": solution.iterations,
        "seconds": dict(solution.seconds),
        "counts": dict(solution.counts),
    }


def trace_of(solution: Solution) -> tuple[tuple[float, float], ...]:
    """Seconds and cost as the method went on; early iterations stand closer than late ones.

    Nothing of methods that tell another cost: robust ones, and those that do not end at F.
    """
    told = [iteration for iteration in solution.trace if math.isfinite(iteration.cost)]
    below, above = ENDS
    F = solution.cost
    ends = told and -below * F <= told[-1].cost - F <= above * F
    if not ends or solution.weights is not None:
        return ()
    if len(told) > TRACED:
        places = np.geomspace(1, len(told), TRACED).round().astype(int) - 1
        told = [told[place] for place in np.unique(places)]
    return tuple((float(f"{it.seconds:.6g}"), float(f"{it.cost:.12g}")) for it in told)


def of_certificate(certificate: Certificate) -> dict[str, Any]:
    """The fields of a record that hold the verdict."""
    return {
        "verdict": certificate.verdict.value,
        "tier": certificate.tier.value,
        "reason": certificate.reason,
    }


def as_data(record: Record) -> dict[str, Any]:
    """The record as plain data; numbers that are not finite become None."""
    return {f.name: plain(getattr(record, f.name)) for f in fields(record)}


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
    record = Record(**{key: value for key, value in data.items() if key in known})
    return replace(record, trace=tuple((seconds, cost) for seconds, cost in record.trace))


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


def latest(records: Iterable[Record]) -> list[Record]:
    """The last record of each key and part, in the order of the first ones.

    Older records, without a key, are told apart by row, method, part and seed, and give way to any
    that has one.
    """
    found: dict[object, Record] = {}
    keyed: set[object] = set()
    for record in records:
        place = (record.row, record.method, record.part, record.seed)
        if record.key:
            keyed.add(place)
        found[(record.key, record.part) if record.key else place] = record
    return [record for name, record in found.items() if record.key or name not in keyed]


class Appended:
    """Records appended to ``NAME.jsonl``, so that a run can be killed and go on.

    A last line that was cut short is cut off.

    Parameters
    ----------
    folder, name : where the file is, and what it is called

    Raises
    ------
    InputError
        The folder cannot be written to.
    FormatError
        The file holds something else.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.path = folder / f"{name}.jsonl"
        self._made = not folder.exists()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self.path.open("a+b") as stream:
                stream.seek(0)
                stream.truncate(stream.read().rfind(b"\n") + 1)
        except OSError as error:
            raise InputError(f"{folder}: cannot write there: {error.strerror}") from None
        self.records = list(read_records(self.path))

    def add(self, record: Record) -> None:
        """Keep a record."""
        self.records.append(record)
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(to_line(record) + "\n")

    def close(self) -> None:
        """Leave nothing behind where nothing was kept."""
        if not self.records:
            self.path.unlink(missing_ok=True)
            if self._made:
                with suppress(OSError):
                    self.path.parent.rmdir()


class Journal(Appended):
    """Records found by their content keys."""

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(folder, name)
        self._found: dict[str, dict[str, Record]] = {}
        for record in self.records:
            self._index(record)

    def find(self, key: str) -> tuple[Record, ...]:
        """The last record of each part that has the key."""
        return tuple(self._found.get(key, {}).values()) if key else ()

    def add(self, record: Record) -> None:
        """Keep a record, unless it says what the last one of its key and part says."""
        known = self._found.get(record.key, {}).get(record.part)
        if known is None or replace(known, provenance=record.provenance) != record:
            super().add(record)
        self._index(record)

    def _index(self, record: Record) -> None:
        self._found.setdefault(record.key, {})[record.part] = record


class Ledger(Appended):
    """Records found by row, seed and engine."""

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(folder, name)
        self._found = {_key(record): record for record in self.records}

    def find(self, row: str, seed: int | None, engine: str) -> Record | None:
        """The record of that row, seed and engine, unless it failed."""
        record = self._found.get((row, seed, engine))
        return None if record is None or record.error else record

    def add(self, record: Record) -> None:
        """Keep a record."""
        super().add(record)
        self._found[_key(record)] = record


def _key(record: Record) -> tuple[str, int | None, str]:
    return record.row, record.seed, record.provenance.get("engine", "")


def is_left_out(error: str) -> bool:
    """Whether there is no answer by choice, or for want of a file or package: no failure."""
    return error.startswith("not run") or "is not installed" in error

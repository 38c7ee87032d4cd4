"""The gate: new records against committed ones, and which metric moved, which way, by how much."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from certpgo.errors import FormatError, InputError
from certpgo.optimize.solution import Status
from reports.harness.experiments import scan
from reports.harness.experiments.journal import from_line, read_entries, to_line
from reports.harness.experiments.metrics import (
    TIMES,
    WORK,
    Better,
    Direction,
    Tolerance,
    count_allowed,
    metric_of,
)
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.zoo_records import FILE as ZOO
from reports.harness.experiments.zoo_records import ZooRecord
from reports.harness.experiments.zoo_regression import zoo_movements

#: Tables whose quick profiles are run when no new records are given: quick ones without times.
FIXED = (
    "every_method",
    "eriksson2018_table1",
    "eriksson2018_table2",
    "moreira2020_table5_6",
    "moreira2020_table5_7",
    "compare",
    "own_cost",
)

#: Folder of the quick profile's records, whose seeds differ from the full profile's.
QUICK = "quick"

#: Name of the file of ratios of times, which the gate leaves out.
TIMED = "speed"

#: Directions that fail the gate.
FAILING = ("worse", "different")

#: A cost is below a bound, or a bound above a cost, beyond rounding.
ROUNDING = 1e-9

_STRENGTH = {"": 0, "UNDECIDED": 1, "BOUNDED": 2, "CERTIFIED": 3}
_ENDED_WELL = (Status.CLOSED_FORM.value, Status.CONVERGED.value)
_SPECIFICATION = ("solver", "settings", "reading", "judging", "d", "n", "m", "objective")


class Key(NamedTuple):
    """What a record is matched by."""

    profile: str
    table: str
    row: str
    part: str
    method: str
    seed: int | None


#: A record of a table, or of the zoo.
Entry = Record | ZooRecord
#: Records by their keys.
Records = dict[Key, Entry]


@dataclass(frozen=True)
class Movement:
    """A value that is not the committed one.

    Attributes
    ----------
    key : of the record
    metric : what moved
    before, after : committed and new, numbers or texts
    direction : ``"worse"`` and ``"different"`` fail, ``"better"`` and ``"noted"`` do not
    """

    key: Key
    metric: str
    before: Any
    after: Any
    direction: Direction

    @property
    def change(self) -> float | None:
        """Relative to the committed number; None where there is none."""
        numbers = [x for x in (self.before, self.after) if isinstance(x, (int, float))]
        if len(numbers) < 2 or not self.before:
            return None
        return float((self.after - self.before) / abs(self.before))


@dataclass(frozen=True)
class GateFindings:
    """What the gate found.

    Attributes
    ----------
    compared : records on both sides
    movements : in the order of the new records
    missing : committed records of the same tables without a new one, and why if known
    added : new records without a committed one
    untouched : committed tables of the same profiles without any new record
    other_engine : records made with another factorization engine than the committed ones
    """

    compared: int
    movements: tuple[Movement, ...]
    missing: Mapping[Key, str]
    added: tuple[Key, ...]
    untouched: tuple[str, ...]
    other_engine: int

    @property
    def failures(self) -> tuple[Movement, ...]:
        """The movements that fail the gate."""
        return tuple(move for move in self.movements if move.direction in FAILING)

    def holds(self, *, complete: bool = False) -> bool:
        """Whether nothing failed and, if it is complete, no record is on one side alone."""
        lacking = self.missing or self.added or self.untouched
        return not self.failures and not (complete and lacking)


def compare_records(new: Records, committed: Records, *, times: float = TIMES) -> GateFindings:
    """Compare records that are of the same table, row, part, method, seed and profile.

    Parameters
    ----------
    times : factor by which ratios of times may move
    """
    movements: list[Movement] = []
    missing: dict[Key, str] = {}
    added: list[Key] = []
    compared = other_engine = 0
    for key, after in new.items():
        before = committed.get(key)
        if _is_left_out(after):
            if before is not None and not _is_left_out(before):
                missing[key] = after.why_missing
        elif before is None or _is_left_out(before):
            added.append(key)
        else:
            compared += 1
            other_engine += _engine(before) != _engine(after)
            movements.extend(_movements(key, before, after, times))
    profiles = {key.profile for key in new}
    tables = {(key.profile, key.table) for key in new}
    rest = [key for key in committed if key not in new and not _is_left_out(committed[key])]
    missing |= {key: "" for key in rest if key[:2] in tables}
    untouched = {key.table for key in rest if key.profile in profiles and key[:2] not in tables}
    return GateFindings(
        compared, tuple(movements), missing, tuple(added), tuple(sorted(untouched)), other_engine
    )


def load_records(source: Path) -> Records:
    """The last record of each key in a file, or in a folder and its folder ``quick``.

    Raises
    ------
    InputError
        There are none.
    FormatError
        A line is no record, or a record's metrics are no numbers.
    """
    if not source.exists():
        raise InputError(f"{source}: no such file or folder")
    folders = (source, source / QUICK)
    paths = [source]
    if source.is_dir():
        paths = [p for f in folders for p in sorted(f.glob("*.jsonl")) if p.stem != TIMED]
    found = {_key(record): record for path in paths for record in _read(path)}
    if not found:
        raise InputError(f"{source}: no records in there")
    return found


def run_quick(
    names: Iterable[str],
    data: Path | None = None,
    announce: Callable[[str], None] = lambda message: None,
) -> tuple[Records, dict[str, str]]:
    """Records of tables' quick profiles, and which tables cannot be run, and why.

    Parameters
    ----------
    data : folder to look for files in first
    announce : called with what is about to run
    """
    found: Records = {}
    refused: dict[str, str] = {}
    for name in names:
        try:
            for record in run_table(scan.get_table(name), data=data, quick=True, announce=announce):
                kept = from_line(to_line(record), Record)  # settings as a file has them
                found[_key(kept)] = kept
        except InputError as error:
            refused[name] = str(error)
    return found, refused


def _read(path: Path) -> Iterator[Entry]:
    records: tuple[Entry, ...]
    try:
        records = read_entries(path, ZooRecord if path.stem == ZOO else Record)
    except UnicodeDecodeError:
        raise FormatError(path, None, "records are text in UTF-8") from None
    for record in records:
        if not all(x is None or isinstance(x, (int, float)) for x in _numbers(record)):
            key = _key(record)
            place = f"{key.row}, {key.method}"
            raise FormatError(path, None, f"metrics and counts must be numbers ({place})")
        yield record


def _numbers(record: Entry) -> Iterator[Any]:
    """What must be numbers, or None."""
    if isinstance(record, ZooRecord):
        tables: Iterable[Any] = (record.points, record.instances, *record.outcomes.values())
    else:
        yield record.iterations
        tables = (record.metrics, record.counts)
    for values in tables:
        yield from values.values() if isinstance(values, Mapping) else [values]


def _key(record: Entry) -> Key:
    if isinstance(record, ZooRecord):
        profile = QUICK if record.quick else "full"
        return Key(profile, ZOO, record.family, "", "every certifier", record.seed)
    return Key(*(getattr(record, name) for name in Key._fields))


def _is_left_out(record: Entry) -> bool:
    if isinstance(record, ZooRecord):
        return bool(record.why_missing)
    return record.absence is not None and not record.absence.is_failure


def _engine(record: Entry) -> str:
    return record.provenance.get("engine", "")


def _movements(key: Key, before: Entry, after: Entry, times: float) -> Iterator[Movement]:
    if isinstance(before, Record) and isinstance(after, Record):
        yield from _of_tables(key, before, after, times)
    elif isinstance(before, ZooRecord) and isinstance(after, ZooRecord):
        same_engine = _engine(before) == _engine(after)
        for metric, direction, was, now in zoo_movements(before, after, same_engine):
            yield Movement(key, metric, was, now, direction)
    else:
        was, now = type(before).__name__, type(after).__name__
        yield Movement(key, "kind of record", was, now, "different")


def _of_tables(key: Key, before: Record, after: Record, times: float) -> Iterator[Movement]:
    def moved(metric: str, direction: Direction, was: Any, now: Any) -> Movement:
        return Movement(key, metric, was, now, direction)

    if before.absence or after.absence:
        was_missing, is_missing = before.why_missing, after.why_missing
        if was_missing != is_missing:
            direction: Direction = "noted"
            if not (was_missing and is_missing):
                direction = "worse" if is_missing else "better"
            yield moved("error", direction, was_missing or "none", is_missing or "none")
        return
    other = [f for f in _SPECIFICATION if getattr(before, f) != getattr(after, f)]
    if other:  # another problem or method: comparing values would say nothing
        for name in other:
            yield moved(name, "different", getattr(before, name), getattr(after, name))
        return
    for metric, way in (
        ("verdict", _of_verdict(before.verdict, after.verdict)),
        ("certified_by", _of_bounds(before.certified_by, after.certified_by)),
        ("status", _of_status(before.status, after.status)),
    ):
        if way is not None:
            yield moved(metric, way, getattr(before, metric), getattr(after, metric))
    yield from _contradictions(moved, before, after)
    same_engine = _engine(before) == _engine(after)
    was, now = dict(before.metrics), dict(after.metrics)
    for known in map(metric_of, dict.fromkeys((*was, *now))):
        of_engine = known.tolerance is Tolerance.TIME_RATIO
        if known.tolerance is Tolerance.MACHINE or (of_engine and not same_engine):
            continue
        x, y = was.get(known.key), now.get(known.key)
        if x is None or y is None:  # not finite, or not asked for
            if (x is None) != (y is None):
                yield moved(known.key, "noted" if x is None else "different", x, y)
        elif abs(y - x) > known.allowed(x, y, was.get("cost") or 0.0, times):
            yield moved(known.key, _direction(known.better, x, y), x, y)
    counted = {"iterations": (before.iterations, after.iterations)}
    for name in dict.fromkeys((*before.counts, *after.counts)):
        if same_engine or name != "nonzeros":
            counted[name] = (before.counts.get(name, 0), after.counts.get(name, 0))
    for name, (k, now_k) in counted.items():
        if k is None or now_k is None:
            continue
        if abs(now_k - k) > count_allowed(k, same_engine):
            yield moved(name, _direction("lower" if name in WORK else "", k, now_k), k, now_k)


def _direction(better: Better, x: float, y: float) -> Direction:
    if not better:
        return "different"
    return "better" if (y < x) == (better == "lower") else "worse"


def _contradictions(
    moved: Callable[[str, Direction, Any, Any], Movement], before: Record, after: Record
) -> Iterator[Movement]:
    """A cost on one side below the bound proven on the other, which is impossible."""
    if "kept_percent" in before.metrics:
        return  # a robust method's bound is of the measurements it kept alone
    for title, bound, cost in (
        ("cost below the committed bound", before, after),
        ("bound above the committed cost", after, before),
    ):
        least, found = bound.metrics.get("lower_bound"), cost.metrics.get("cost")
        if least is not None and found is not None and least - found > ROUNDING * abs(least):
            pair = (least, found) if bound is before else (found, least)
            yield moved(title, "worse", *pair)


def _of_verdict(before: str, after: str) -> Direction | None:
    if before == after:
        return None
    # A refutation may come from a better certifier; a worse estimate has a worse cost.
    if after == "REFUTED":
        return "worse" if before == "CERTIFIED" else "noted"
    if before == "REFUTED":
        return "better" if after == "CERTIFIED" else "noted"
    return "better" if _STRENGTH.get(after, 0) > _STRENGTH.get(before, 0) else "worse"


def _of_bounds(before: str, after: str) -> Direction | None:
    was, now = ({name for name in text.split(", ") if name != "none"} for text in (before, after))
    if was == now or not (before and after):
        return None  # not every record has them
    return "worse" if was - now else "better"


def _of_status(before: str, after: str) -> Direction | None:
    if before == after:
        return None
    was, now = before in _ENDED_WELL, after in _ENDED_WELL
    if was == now:
        return "noted"
    return "better" if now else "worse"

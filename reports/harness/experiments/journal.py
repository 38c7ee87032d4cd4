"""Files of results, one JSON line each, appended as results are made.

Results are kept raw, so that a report is a pure function of them and a caption costs no re-run.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from certpgo.errors import FormatError
from certpgo.io.json_values import plain
from certpgo.io.writing import unwritable_folder

Entry = TypeVar("Entry", bound="JournalEntry")


@dataclass(frozen=True, kw_only=True)
class JournalEntry:
    """What every line holds, whatever was run.

    Attributes
    ----------
    key : of what was asked for; a later entry of the same key and part replaces this one
    part : which component of a graph that is not connected, or empty
    provenance : versions, machine, engine, threads, commit, date
    """

    key: str = ""
    part: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)


def as_data(entry: JournalEntry) -> dict[str, Any]:
    """The entry as plain data; numbers that are not finite become None."""
    return {f.name: plain(getattr(entry, f.name)) for f in fields(entry)}


def to_line(entry: JournalEntry) -> str:
    """The entry as one line of JSON."""
    return json.dumps(as_data(entry), allow_nan=False)


def from_line(line: str, kind: type[Entry]) -> Entry:
    """The entry of one line.

    Raises
    ------
    ValueError, TypeError
        The line is none of this kind.
    """
    return kind(**json.loads(line))


def read_entries(path: Path, kind: type[Entry]) -> tuple[Entry, ...]:
    """Every entry of the file; a last line that was cut short is ignored.

    Raises
    ------
    FormatError
        Another line is none of this kind.
    """
    lines = path.read_text(encoding="utf-8").split("\n")
    entries = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            entries.append(from_line(line, kind))
        except (ValueError, TypeError) as error:
            if number == len(lines):
                break
            raise FormatError(path, number, "a record, one JSON object a line") from error
    return tuple(entries)


def latest(entries: Iterable[Entry]) -> list[Entry]:
    """The last entry of each key and part, in the order of the first ones."""
    return list({(entry.key, entry.part): entry for entry in entries}.values())


class Journal(Generic[Entry]):
    """Entries appended to ``NAME.jsonl``, so that a run can be stopped and resumed.

    A last line that was cut short is removed.

    Parameters
    ----------
    folder, name : where the file is, and what it is called
    kind : the class of its entries

    Raises
    ------
    InputError
        The folder cannot be written to.
    FormatError
        The file holds something else.
    """

    def __init__(self, folder: Path, name: str, kind: type[Entry]) -> None:
        self.path = folder / f"{name}.jsonl"
        self._is_new_folder = not folder.exists()
        self._found: dict[str, dict[str, Entry]] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with self.path.open("a+b") as stream:
                stream.seek(0)
                stream.truncate(stream.read().rfind(b"\n") + 1)
        except OSError as error:
            raise unwritable_folder(folder, error) from None
        for entry in read_entries(self.path, kind):
            self._index(entry)

    def find(self, key: str) -> tuple[Entry, ...]:
        """The last entry of each part that has the key."""
        return tuple(self._found.get(key, {}).values())

    def add(self, entry: Entry) -> None:
        """Keep an entry, unless the last one of its key and part differs in provenance alone."""
        known = self._found.get(entry.key, {}).get(entry.part)
        if known is None or replace(known, provenance=entry.provenance) != entry:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(to_line(entry) + "\n")
        self._index(entry)

    def close(self) -> None:
        """Leave no file, and no new folder, where nothing was kept."""
        if not self._found:
            self.path.unlink(missing_ok=True)
            if self._is_new_folder:
                with suppress(OSError):
                    self.path.parent.rmdir()

    def _index(self, entry: Entry) -> None:
        self._found.setdefault(entry.key, {})[entry.part] = entry

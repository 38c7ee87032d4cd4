"""The whole benchmark of speed: what is measured, and its files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from certpgo import registry
from certpgo.io.writing import write_whole
from certpgo.linalg.factor import default_engine
from certpgo.solve.provenance import provenance
from reports.harness.experiments.journal import Journal, read_entries
from reports.harness.experiments.regression import TIMED
from reports.harness.experiments.timing import one_core
from reports.harness.speed import (
    kernels,
    limits,
    pages,
    programs,
    proving,
    reading,
    sessions,
    small,
    solving,
)
from reports.harness.speed.measuring import Group, SpeedRecord, measured

#: Name of the files.
FILE = TIMED
SECTIONS = {
    module.SECTION: module.groups
    for module in (programs, reading, solving, small, proving, sessions, kernels, limits)
}


def groups(quick: bool, sections: Sequence[str] = ()) -> list[Group]:
    """All that is measured, or some sections of it."""
    return [group for name in sections or SECTIONS for group in SECTIONS[name](quick)]


def run(
    folder: Path, chosen: Sequence[Group], started: Callable[[Group], object] = lambda group: None
) -> Iterator[tuple[Group, list[SpeedRecord]]]:
    """Measure, and keep what is measured in the folder.

    Records of this commit are reused, so that an interrupted run resumes; those of another are
    removed.

    Parameters
    ----------
    started : is called with each group before it is measured

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    made = provenance(default_engine(), registry.repository())
    commit = made["commit"]
    _forget(folder / f"{FILE}.jsonl", commit)
    journal = Journal(folder, FILE, SpeedRecord)
    try:
        with one_core() as protocol:
            made |= {"threads": "1", "protocol": protocol}
            for group in chosen:
                found = list(journal.find(group.key(commit)))
                if not found:
                    started(group)
                    found = measured(group, commit, made)
                    for record in found:
                        journal.add(record)
                yield group, found
    finally:
        journal.close()


def _forget(path: Path, commit: str) -> None:
    if not path.is_file():
        return
    if any(r.provenance.get("commit") != commit for r in read_entries(path, SpeedRecord)):
        path.unlink()


def write(folder: Path, records: Sequence[SpeedRecord]) -> None:
    """The page and the CSV."""
    write_whole(folder / f"{FILE}.md", pages.markdown(records).encode())
    write_whole(folder / f"{FILE}.csv", pages.csv_text(records).encode())

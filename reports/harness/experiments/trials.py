"""The instances of a table: a row and a repetition each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certpgo.errors import InputError, how_to_install
from certpgo.objective.choose_cost import CHORDAL
from reports.harness.experiments.instances import is_here, seed_of
from reports.harness.experiments.keys import Profile, record_key
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Method, Row, Table


@dataclass(frozen=True)
class Trial:
    """A row of a table and which of its instances.

    Attributes
    ----------
    place : the row's place in the table, whichever rows are run
    repetition : of a synthetic row, which instance; of others 0
    """

    table: Table
    row: Row
    place: int
    repetition: int
    profile: Profile

    def key(self, method: Method) -> str:
        """The key of the method's records."""
        return record_key(self.table, self.row, self.place, method, self.repetition, self.profile)

    @property
    def seed(self) -> np.random.SeedSequence | None:
        """What a synthetic instance is drawn with."""
        if not self.row.generator:
            return None
        return seed_of(self.table.seed, self.place, self.repetition)

    def blank(self, method: Method) -> Record:
        """The record of a method before anything is known."""
        return Record(
            self.table.name,
            self.row.label,
            method.label,
            solver=method.solver,
            settings={**method.settings, **self.row.settings.get(method.label, {})},
            seed=self.repetition if self.row.generator else None,
            key=self.key(method),
            profile=self.profile,
            objective="" if self.row.cost == CHORDAL else self.row.cost,
        )


def trials_of(
    table: Table, *, data: Path | None, seeds: int | None = None, quick: bool = False
) -> Iterator[Trial]:
    """Every row and repetition of the profile, see `reports.harness.experiments.runner.run_table`.

    Raises
    ------
    InputError
        There are none, see `chosen_rows`.
    """
    usual = 1 if quick else table.seeds
    profile: Profile = "quick" if quick else "full"
    places = {row.label: place for place, row in enumerate(table.rows + table.stand_ins)}
    for row in chosen_rows(table, data=data, quick=quick):
        place = places[row.label]
        for repetition in range((seeds or usual) if row.generator else 1):
            yield Trial(table, row, place, repetition, profile)


def chosen_rows(table: Table, *, data: Path | None, quick: bool) -> tuple[Row, ...]:
    """The rows to run: those of the profile, and the stand-ins when no file is here.

    Raises
    ------
    InputError
        Rows are optional, and the files of none of them are here.
    """
    rows = table.rows
    if table.optional:
        here = [
            tuple(row for row in group if is_here(row, data))
            for group in (table.rows, table.stand_ins)
        ]
        rows = here[0] or here[1]
    if not rows:
        raise InputError(
            f"none of the files of table {table.name} is here: {how_to_install('baselines')} "
            "brings some, certpgo fetch others; --data names a folder of your own"
        )
    if quick and table.quick:
        rows = tuple(row for row in rows if row.label in table.quick) or rows[:1]
    return rows

"""Runs the zoo: a record a family, then a record a block of random instances."""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from certpgo import registry
from certpgo.assess.provenance import provenance
from certpgo.errors import NumericalError
from certpgo.linalg.factor import default_engine
from reports.harness.certifiers import campaign, oracle
from reports.harness.certifiers.families import FAMILIES
from reports.harness.certifiers.judging import FALSE, Tally, certifiers, judged
from reports.harness.experiments.records import Ledger, Record

TABLE = "zoo"
#: Random instances without a campaign, and of the quick profile.
FEWEST, QUICK = 500, 5
#: Thread pools of the libraries that a process may load.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

Announce = Callable[[str], None]


@dataclass(frozen=True)
class Job:
    """A family, or a block of random instances from ``seed`` on."""

    name: str
    seed: int | None = None
    quick: bool = False

    @property
    def row(self) -> str:
        """What its record is called."""
        if self.seed is None:
            return self.name
        return f"{self.name}: seeds {self.seed} to {self.seed + campaign.BLOCK - 1}"


def jobs(instances: int = 0, quick: bool = False) -> list[Job]:
    """Every family, and random instances: at least ``instances`` of them, and some anyway."""
    total = max(instances, QUICK if quick else FEWEST)
    named = [Job(name, quick=quick) for name in FAMILIES]
    return named + [Job(kind.name, first) for kind, first in campaign.blocks(total)]


def run_jobs(
    ledger: Ledger, wanted: list[Job], *, processes: int = 1, announce: Announce = lambda _: None
) -> Iterator[Record]:
    """The records of the jobs, in their order; those that the ledger has are not run again.

    Parameters
    ----------
    processes : how many work at once, each with one thread
    announce : told how many jobs are done
    """
    oracle.library()  # what is missing is said here, not by a process that dies of it
    names = list(certifiers())
    found = {job: ledger.find(job.row, job.seed, default_engine()) for job in wanted}
    left = [job for job in wanted if not _is_of(found[job], job, names)]
    done = len(wanted) - len(left)
    for job, made in _made(left, processes):
        found[job] = made
        ledger.add(made)
        done += 1
        announce(f"{done} of {len(wanted)}: {job.row}")
    for job in wanted:
        kept = found[job]
        if kept is not None:
            yield kept


def record(job: Job) -> Record:
    """The record of a job, made in this process."""
    judges = certifiers()
    if job.seed is None:
        tally, faults, wrong = _family(job, judges)
    else:
        tally, faults = campaign.block(campaign.kind_called(job.name), job.seed, judges)
        wrong = {}
    return Record(
        TABLE,
        job.row,
        "every certifier",
        part=job.name,
        seed=job.seed,
        settings={"certifiers": list(judges), "quick": job.quick, "falsely certified": wrong},
        counts={": ".join(filter(None, key)): count for key, count in sorted(tally.items())},
        note="; ".join(faults),
        error="" if tally["", "points"] else "no points: its file is not here",
        provenance=provenance(default_engine(), registry.source()),
    )


def _family(job: Job, judges: dict[str, Any]) -> tuple[Tally, list[str], dict[str, list[str]]]:
    tally: Tally = Counter()
    faults: list[str] = []
    wrong: dict[str, list[str]] = {}
    for case in FAMILIES[job.name](job.quick):
        counts, said = judged(case, judges)
        tally += counts
        faults += said
        for name, outcome in counts:
            if outcome == FALSE:
                wrong.setdefault(name, []).append(case.name)
    return tally, faults, wrong


def _is_of(kept: Record | None, job: Job, names: list[str]) -> bool:
    if kept is None or kept.settings.get("certifiers") != names:
        return False
    return job.seed is not None or kept.settings.get("quick") == job.quick


def _made(wanted: list[Job], processes: int) -> Iterator[tuple[Job, Record]]:
    """Jobs with their records, as they are done."""
    context = multiprocessing.get_context("spawn")
    with (
        _one_thread_each(),
        ProcessPoolExecutor(max(1, min(processes, len(wanted))), mp_context=context) as pool,
    ):
        waiting = {pool.submit(record, job): job for job in wanted}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool:
            raise NumericalError("a process was killed: no memory?") from None
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """For processes started inside: libraries read this when they are loaded."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

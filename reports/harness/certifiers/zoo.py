"""Runs the zoo: a record per family, then a record per block of random instances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool

from certpgo import registry
from certpgo.errors import NumericalError
from certpgo.linalg.factor import default_engine
from certpgo.solve.processes import processes
from certpgo.solve.provenance import provenance
from reports.harness.certifiers import campaign, oracle
from reports.harness.certifiers.families import FAMILIES
from reports.harness.certifiers.opinions import certifiers, tally_of
from reports.harness.experiments.journal import Journal
from reports.harness.experiments.zoo_records import Job, Outcome, ZooRecord, total

#: Random instances without a campaign, and of the quick profile.
FEWEST, QUICK = 500, 5

Announce = Callable[[str], None]


def jobs(instances: int = 0, quick: bool = False) -> list[Job]:
    """Every family, and random instances: at least ``instances`` of them, and a few in any case."""
    total = max(instances, QUICK if quick else FEWEST)
    named = [Job(name, quick=quick) for name in FAMILIES]
    return named + [Job(kind.name, first) for kind, first in campaign.blocks(total)]


def run_jobs(
    journal: Journal[ZooRecord],
    chosen: list[Job],
    *,
    workers: int = 1,
    announce: Announce = lambda _: None,
) -> Iterator[ZooRecord]:
    """The records of the jobs, in their order; those in the journal are not run again.

    Parameters
    ----------
    workers : processes that work at once, each with one thread
    announce : called with how many jobs are done
    """
    oracle.library()  # a missing package is an error here, not in a process that dies of it
    keys = {job: job.key(certifiers()) for job in chosen}
    # Without points its file was not here.
    found = {job: kept for job in chosen for kept in journal.find(keys[job]) if kept.points}
    left = [job for job in chosen if job not in found]
    done = len(chosen) - len(left)
    for job, made in _made(left, workers):
        found[job] = made
        journal.add(made)
        done += 1
        announce(f"{done} of {len(chosen)}: {job.label}")
    yield from (found[job] for job in chosen)


def record_of(job: Job) -> ZooRecord:
    """The record of a job, made in this process."""
    asked = certifiers()
    wrong: dict[str, list[str]] = {}
    if job.seed is None:
        tallies = []
        for case in FAMILIES[job.name](job.quick):
            tallies.append(tally_of(case, asked))
            for name in asked:
                if tallies[-1].of(name)[Outcome.FALSE]:
                    wrong.setdefault(name, []).append(case.name)
        tally = total(tallies)
    else:
        tally = campaign.block(campaign.kind_called(job.name), job.seed, asked)
    return ZooRecord(
        key=job.key(asked),
        family=job.name,
        seed=job.seed,
        quick=job.quick,
        certifiers=list(asked),
        falsely_certified=wrong,
        provenance=provenance(default_engine(), registry.source()),
        **vars(tally),
    )


def _made(chosen: list[Job], workers: int) -> Iterator[tuple[Job, ZooRecord]]:
    """Jobs with their records, as they are done."""
    with processes(max(1, min(workers, len(chosen)))) as pool:
        waiting = {pool.submit(record_of, job): job for job in chosen}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BrokenProcessPool:
            raise NumericalError("a process was killed: no memory?") from None

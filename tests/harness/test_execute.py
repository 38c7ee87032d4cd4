"""Tasks in this process, in others, and on a cluster; what kills one is a row."""

import itertools
import os
import signal
import threading
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace

import pytest
from repeated import by_key

from certpgo.solve.processes import processes
from reports.harness.commands.reproduce import Order, reproduce
from reports.harness.experiments import scan
from reports.harness.experiments.absence import DIED
from reports.harness.experiments.execute import Pool, execute
from reports.harness.experiments.limits import Limit, OutOfTime
from reports.harness.experiments.plan import table_tasks
from reports.harness.experiments.spec import Method


@pytest.fixture
def table(small_checkout):
    return scan.get_table("cycles")


def mischievous(table, deed, nodes=6):
    return replace(table, methods=(Method("mischief", settings={"deed": deed, "nodes": nodes}),))


def executed(table, pool, **more):
    started = []
    tasks = table_tasks(table, lambda key: (), **more)
    outcomes = list(execute(tasks, pool, announce=lambda _: None, starting=started.append))
    assert sum(outcome.is_last for outcome in outcomes) == len(tasks)
    return [record for outcome in outcomes for record in outcome.records]


def failures(records):
    return {record.row: record.error for record in records if record.error}


def test_two_processes_make_the_records_of_one(table):
    alone, together = (executed(table, Pool(workers)) for workers in (1, 2))
    assert len(alone) == 12
    assert by_key(together) == by_key(alone)
    assert {record.provenance["threads"] for record in alone + together} == {"1"}


def test_more_workers_than_cores_are_not_alone(table, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    assert {r.provenance["alone"] for r in executed(table, Pool(1), quick=True)} == {"yes"}
    assert {r.provenance["alone"] for r in executed(table, Pool(2), quick=True)} == {"no"}
    timed = replace(table, reference=Method("eigen_ra"), methods=(Method("eigen_ra"),))
    assert {r.provenance["alone"] for r in executed(timed, Pool(2), quick=True)} == {"yes"}


def test_times_are_taken_after_all_else(table):
    started = []
    timed = replace(table, name="timed", reference=Method("eigen_ra"))
    tasks = [
        *table_tasks(timed, lambda _: (), quick=True),
        *table_tasks(table, lambda _: (), quick=True),
    ]
    for outcome in execute(
        tasks, Pool(1), announce=lambda _: None, starting=lambda task: started.append(task.report)
    ):
        assert outcome.task.report in started
    assert started == ["cycles", "timed"]


@pytest.mark.parametrize(
    ("deed", "said", "workers"),
    [
        ("sleep", "not finished within 0.5 s", 1),
        ("sleep", "not finished within 0.5 s", 2),
        ("swell", "not enough memory", 1),
        ("err", "RuntimeError: by design", 1),
    ],
)
def test_a_method_that_fails_is_a_row_with_its_reason(table, deed, said, workers):
    records = executed(mischievous(table, deed), Pool(workers), limit=Limit(0.5))
    assert len(records) == 6
    assert failures(records) == {"n = 6": said}


def test_a_worker_that_dies_fails_its_own_task_alone_which_is_then_done(table):
    table = mischievous(table, "die")
    records = executed(table, Pool(2))
    assert len(records) == 6
    assert failures(records) == {"n = 6": DIED.error}
    known = {record.key: [record] for record in records}
    assert table_tasks(table, lambda key: known.get(key, ())) == ()


def test_the_limit_ends_what_takes_too_long_and_leaves_no_alarm():
    before = signal.getsignal(signal.SIGALRM)
    with pytest.raises(OutOfTime), Limit(0.01).kept():
        threading.Event().wait(60)
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_any_executor_makes_the_same_records(table):
    alone = executed(table, Pool())
    with ThreadPoolExecutor(2) as threads, processes(2) as others:
        for executor in (threads, others):
            records = executed(table, Pool(2, executor))
            assert by_key(records) == by_key(alone)
            assert {record.provenance["alone"] for record in records} == {"unknown"}


def test_a_table_is_reproduced_by_an_executor(table, tmp_path, capsys):
    with ThreadPoolExecutor(2) as threads:
        assert reproduce("cycles", Order(tmp_path), Pool(2, threads)) == 0
        assert "written to" in capsys.readouterr().err
        assert reproduce("cycles", Order(tmp_path), Pool(2, threads)) == 0
    assert "Up to date" in capsys.readouterr().err


def test_an_executor_that_is_broken_ends_the_run_and_leaves_what_is_done(table):
    table, found = mischievous(table, "die", 7), []
    tasks = table_tasks(table, lambda key: ())
    silent = {"announce": lambda _: None, "starting": lambda _: None}
    with processes(1) as pool:
        outcomes = execute(tasks, Pool(1, pool), **silent)
        for outcome in itertools.islice(outcomes, 3):
            found += outcome.records
        with pytest.raises(BrokenExecutor):
            next(outcomes)
    assert [record.row for record in found] == ["n = 4", "n = 5", "n = 6"]


@pytest.fixture
def cluster(small_checkout):
    """Two worker processes of Dask behind a scheduler on the loopback."""
    distributed = pytest.importorskip("distributed", reason="needs Dask")
    import dask

    @contextmanager
    def running(**settings):
        with (
            dask.config.set(settings),
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
            ) as made,
            distributed.Client(made) as client,
        ):
            yield Pool(2, client.get_executor())

    return running


@pytest.mark.filterwarnings("ignore")
def test_a_task_that_kills_every_worker_of_a_cluster_is_a_row(table, cluster):
    table = replace(mischievous(table, "die", 4), rows=table.rows[:2], quick=())
    with cluster(**{"distributed.scheduler.allowed-failures": 0}) as pool:
        records = executed(table, pool)
    [said] = failures(records).values()
    assert "KilledWorker" in said
    assert [record.absence for record in records].count(DIED.absence) == 1
    assert len(records) == 2


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_a_worker_loses_no_record_and_makes_none_twice(
    table, cluster, small_checkout, monkeypatch
):
    monkeypatch.setenv("CERTPGO_TEST_STOP", "3")  # from the third run on, they wait
    with cluster() as pool:
        waiting = small_checkout.with_suffix(".pid")

        def kill_half_way():
            while not (waiting.exists() and waiting.read_text()):
                time.sleep(0.02)
            os.kill(int(waiting.read_text()), signal.SIGKILL)
            small_checkout.with_suffix(".go").touch()

        killer = threading.Thread(target=kill_half_way)
        killer.start()
        records = executed(table, pool)
        killer.join()
    monkeypatch.delenv("CERTPGO_TEST_STOP")
    # What the worker was in the middle of, or had not sent yet, runs again.
    assert 7 <= len(small_checkout.read_text().split()) <= 8
    assert len({record.key for record in records}) == len(records) == 12
    assert by_key(records) == by_key(executed(table, Pool()))
    assert {record.provenance["alone"] for record in records} == {"unknown"}

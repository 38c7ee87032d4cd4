"""Tasks in this process, in others, and on a cluster; what kills one is a row."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from repeated import by_key

from certpgo.errors import InputError, MissingDependency, how_to_install
from reports.harness.experiments import clusters, scan
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
    alone, together = (executed(table, Pool(jobs)) for jobs in (1, 2))
    assert len(alone) == 12
    assert by_key(together) == by_key(alone)
    assert {record.provenance["threads"] for record in alone + together} == {"1"}


def test_more_jobs_than_cores_are_not_alone(table, monkeypatch):
    monkeypatch.setattr("joblib.cpu_count", lambda: 1)
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


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize(
    ("deed", "said"),
    [
        ("sleep", "not finished within 0.5 s"),
        ("swell", "not enough memory"),
        ("err", "RuntimeError: by design"),
    ],
)
def test_a_method_that_fails_is_a_row_with_its_reason(table, deed, said, jobs):
    records = executed(mischievous(table, deed), Pool(jobs), limit=Limit(0.5))
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


def test_an_address_of_another_kind_is_refused():
    with pytest.raises(InputError, match=r"begins with tcp:// \(Dask\) or ray:// \(Ray\)"):
        Pool(scheduler="http://here")


def test_what_is_no_scheduler_is_refused(monkeypatch):
    pytest.importorskip("distributed", reason="needs Dask")
    monkeypatch.setattr(clusters, "PATIENCE", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        mute = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        for address in ("tcp://127.0.0.1:1", mute):
            with pytest.raises(InputError, match=f"{address}: no Dask scheduler responds"):
                clusters.dask_client(address)
    for address in ("nonsense", "", "Threads", "tls://host:1", "tcp://host"):
        with pytest.raises(InputError, match="address is expected, tcp://host:port"):
            clusters.dask_client(address)


@pytest.mark.parametrize(
    ("address", "package", "line"),
    [
        ("tcp://127.0.0.1:1", "distributed", how_to_install("cluster")),
        ("ray://127.0.0.1:1", "ray", "pip install 'ray[client]'"),
    ],
)
def test_a_missing_package_is_named_with_its_install_line(
    table, monkeypatch, address, package, line
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependency, match="pip install") as caught:
        executed(table, Pool(scheduler=address))
    assert str(caught.value).endswith(line)


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
        ):
            yield made

    return running


@pytest.fixture
def ray_address(small_checkout, tmp_path, monkeypatch):
    """A cluster of Ray with two cores, behind a client's port on the loopback."""
    pytest.importorskip("ray", reason="needs ray")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # of a token that another cluster left behind
    with socket.socket() as free, socket.socket() as other:
        free.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        port, own = free.getsockname()[1], other.getsockname()[1]
    ray = Path(sys.executable).with_name("ray")
    start = f"start --head --num-cpus 2 --include-dashboard=false --port {own}"
    memory = "--object-store-memory 100000000"
    options = f"{start} --ray-client-server-port {port} {memory}".split()
    subprocess.run([ray, *options], check=True, capture_output=True)
    yield f"ray://127.0.0.1:{port}"
    subprocess.run([ray, "stop", "--force"], check=True, capture_output=True)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_ray_runs_the_same_and_a_task_that_kills_its_worker_is_a_row(table, ray_address):
    # One test, for stopping one cluster stops every other of the machine.
    records = executed(table, Pool(scheduler=ray_address))
    assert by_key(records) == by_key(executed(table, Pool()))
    assert {record.provenance["alone"] for record in records} == {"unknown"}
    deadly = replace(mischievous(table, "die", 4), rows=table.rows[:2], quick=())
    records = executed(deadly, Pool(scheduler=ray_address))
    assert failures(records) == {"n = 4": DIED.error}
    assert len(records) == 2


@pytest.mark.filterwarnings("ignore")
def test_a_task_that_kills_every_worker_of_a_cluster_is_a_row(table, cluster):
    table = replace(mischievous(table, "die", 4), rows=table.rows[:2], quick=())
    with cluster(**{"distributed.scheduler.allowed-failures": 0}) as made:
        records = executed(table, Pool(scheduler=made.scheduler_address))
    assert failures(records) == {"n = 4": DIED.error}
    assert len(records) == 2


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_a_worker_loses_no_record_and_makes_none_twice(
    table, cluster, small_checkout, monkeypatch
):
    monkeypatch.setenv("CERTPGO_TEST_STOP", "3")  # from the third run on, they wait
    with cluster() as made:
        waiting = small_checkout.with_suffix(".pid")

        def kill_half_way():
            while not (waiting.exists() and waiting.read_text()):
                time.sleep(0.02)
            os.kill(int(waiting.read_text()), signal.SIGKILL)
            small_checkout.with_suffix(".go").touch()

        killer = threading.Thread(target=kill_half_way)
        killer.start()
        records = executed(table, Pool(scheduler=made.scheduler_address))
        killer.join()
    monkeypatch.delenv("CERTPGO_TEST_STOP")
    assert len(small_checkout.read_text().split()) == 7
    assert len({record.key for record in records}) == len(records) == 12
    assert by_key(records) == by_key(executed(table, Pool()))
    assert {record.provenance["alone"] for record in records} == {"unknown"}

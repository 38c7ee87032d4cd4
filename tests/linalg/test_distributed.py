"""Factorizations as tasks: those of one machine, on threads and on a cluster."""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
import types

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrices import exact_residual, uneven_matrix
from strategies import rng_of, seeds

import certpgo
from certpgo import Marginals
from certpgo.errors import CertPGOError, InputError, MissingDependency
from certpgo.io.datasets.synthetic import grid3d
from certpgo.linalg import compiled, factor
from certpgo.linalg.distributed import fronts, schedulers
from certpgo.linalg.distributed.fronts import DistributedFronts
from certpgo.linalg.distributed.tasks import TaskGraph
from certpgo.linalg.multifrontal import Fronts, Tree, minimum_degree
from certpgo.objective.problem import problem_of

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="not compiled")
distributed = pytest.importorskip("distributed", reason="needs certpgo[cluster]")
dask = pytest.importorskip("dask", reason="needs certpgo[cluster]")


class AtOnce:
    """Runs tasks one after another."""

    factorizations = 0

    def compute(self, graph, keys):
        return list(dask.get(graph.calls, keys))

    keep = compute


def both(P, sizes, scheduler=None, **cut):
    tree = Tree.of(P.indptr, P.indices, minimum_degree(P.indptr, P.indices))
    return Fronts(tree, sizes), DistributedFronts(tree, sizes, scheduler or AtOnce(), **cut)


cuts = st.sampled_from([(0.0, 6), (0.1, 3), (0.3, 7), (0.6, 1000), (1.0, 5)])


@settings(max_examples=15)
@given(seeds, st.integers(2, 14), st.integers(1, 4), cuts)
def test_tasks_factorize_like_one_machine(seed, n, b, cut):
    rng = rng_of(seed)
    P, A = uneven_matrix(seed, n, b, 1.0)
    whole, parts = both(P, np.full(n, b), share=cut[0], tile=cut[1])
    assert sum(branch.own for branch in parts.branches) == whole.size
    L, other = (F.factor(A.data) for F in (whole, parts))
    left = whole.lower(L.panels).toarray()
    right = whole.lower(np.concatenate(other.panels)).toarray()
    np.testing.assert_allclose(right, left, rtol=1e-9, atol=1e-12 * abs(left).max())
    X = rng.standard_normal((n * b, 2))
    w = rng.uniform(0.1, 10.0, (n * b, 2))
    for mixed in (False, True):
        ours = parts.factor_kept_single(A.data, A.diagonal(), mixed=mixed).solve(A @ X)
        np.testing.assert_allclose(ours, X, rtol=0, atol=3e-2 * abs(X).max())
    for found, expected in zip(parts.row_sums(A.data, w), whole.row_sums(A.data, w), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    indefinite = A.data.copy()
    indefinite[rng.integers(len(indefinite))] = -1e30
    assert parts.factor(indefinite) is None or (A.diagonal() > 0).all()


@settings(max_examples=12)
@given(seeds, st.sampled_from([(6, 3), (10, 1), (4, 4)]), cuts)
def test_the_measured_residual_bounds_the_exact_one(seed, shape, cut):
    (n, b), rng = shape, rng_of(seed)
    P, A = uneven_matrix(seed, n, b, 1.0)
    whole, parts = both(P, np.full(n, b), share=cut[0], tile=cut[1])
    w = 10.0 ** rng.uniform(-2.0, 2.0, n * b)
    L = whole.lower(np.concatenate(parts.factor(A.data).panels))
    exact = exact_residual(A, L, whole.order, w)
    sums, squares = parts.residual(A.data, A.diagonal(), w)
    expected, _ = whole.residual(A.data, A.diagonal(), w)
    assert np.all(exact <= sums)
    assert sums.sum() <= 3.0 * expected.sum() + 3.0 * exact.sum()
    np.testing.assert_allclose(squares, A.diagonal(), rtol=1e-12)


@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_what_is_not_definite_is_found_by_any_task(place):
    P, A = uneven_matrix(1, 30, 2, 0.0)
    _, parts = both(P, np.full(30, 2), share=0.1, tile=4)
    data, row = A.data.copy(), int(place * 59)
    entry = A.indptr[row] + np.flatnonzero(A.indices[A.indptr[row] : A.indptr[row + 1]] == row)[0]
    for value in (-1.0, np.nan):
        data[entry] = value
        assert parts.factor(data) is None
        assert parts.row_sums(data, np.ones((60, 2))) is None
        assert parts.residual(data, np.ones(60), np.ones(60)) is None


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes behind a scheduler on the loopback."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as made:
        yield made


@pytest.fixture
def large(monkeypatch):
    """A graph whose factorizations count as large, and its answer on one machine."""
    graph = grid3d(5, np.random.default_rng(0)).graph
    answer = certpgo.solve(graph)
    monkeypatch.setattr(factor, "DISTRIBUTED_FROM", 0.0)
    return graph, answer


def is_same(answer, other):
    assert answer.verdict is other.verdict is certpgo.Verdict.CERTIFIED
    assert answer.cost == pytest.approx(other.cost, rel=1e-12)
    bound = answer.certificate.lower_bound
    assert bound == pytest.approx(other.certificate.lower_bound, rel=1e-9)


def test_threads_give_the_same_answer(large):
    graph, expected = large
    with certpgo.scheduler("threads"):
        is_same(certpgo.solve(graph), expected)
    assert schedulers.current() is None


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_answer_wherever_the_factor_is(large, cluster, monkeypatch):
    graph, expected = large
    with certpgo.scheduler(cluster.scheduler_address):
        is_same(certpgo.solve(graph), expected)
        monkeypatch.setattr(fronts, "GATHERED", 0.0)
        is_same(certpgo.solve(graph), expected)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_loses_a_worker_loses_nothing(cluster):
    P, A = uneven_matrix(2, 150, 4, 0.0)
    w = np.ones((600, 2))
    with certpgo.scheduler(cluster.scheduler_address):
        whole, parts = both(P, np.full(150, 4), schedulers.current(), share=0.05, tile=60)
        expected = whole.row_sums(A.data, w)
        pids = [worker.pid for worker in cluster.workers.values()]
        done = threading.Event()

        def kill():
            time.sleep(0.3)
            os.kill(pids[0], signal.SIGKILL)
            done.set()

        killer = threading.Thread(target=kill)
        killer.start()
        rounds = 0
        while rounds < 2 or not done.is_set():
            for found, sums in zip(parts.row_sums(A.data, w), expected, strict=True):
                np.testing.assert_allclose(found, sums, rtol=1e-12)
            rounds += 1
        killer.join()
        # The fronts that it kept are computed again.
        for found, sums in zip(parts.row_sums(A.data, w), expected, strict=True):
            np.testing.assert_allclose(found, sums, rtol=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_a_problem_is_solved_where_the_scheduler_is_now(large, cluster):
    graph, expected = large
    problem = problem_of(graph)
    for address in (cluster.scheduler_address, "threads"):
        with certpgo.scheduler(address):
            is_same(certpgo.solve(graph), expected)
            first = certpgo.certify(problem, expected.estimate)
            distributed_covariances = Marginals(problem, expected.estimate).covariances
        again = certpgo.certify(problem, expected.estimate)
        assert again.lower_bound == pytest.approx(first.lower_bound, rel=1e-9)
        np.testing.assert_allclose(
            Marginals(problem, expected.estimate).covariances,
            distributed_covariances,
            rtol=1e-9,
            atol=1e-15,
        )


def test_what_is_no_scheduler_is_refused(monkeypatch):
    monkeypatch.setattr(schedulers, "PATIENCE", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        mute = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        for address in ("tcp://127.0.0.1:1", mute):
            refused = pytest.raises(InputError, match=f"{address}: no Dask scheduler responds")
            with refused, certpgo.scheduler(address):
                pass
    for address in ("nonsense", "", "Threads", "tls://host:1", "tcp://host"):
        refused = pytest.raises(InputError, match="address is expected, tcp://host:port")
        with refused, certpgo.scheduler(address):
            pass
    monkeypatch.setenv("CERTPGO_ENGINE", "superlu")
    with pytest.raises(InputError, match="cannot be tasks"), certpgo.scheduler("threads"):
        pass
    monkeypatch.delenv("CERTPGO_ENGINE")
    monkeypatch.setitem(sys.modules, "distributed", None)
    missing = pytest.raises(MissingDependency, match=r"certpgo\[cluster\]")
    with missing, certpgo.scheduler("threads"):
        pass


@pytest.mark.filterwarnings("ignore")
def test_clusters_that_cannot_be_used_are_refused(monkeypatch, cluster):
    monkeypatch.setattr(schedulers, "PATIENCE", 0.5)
    options = {"host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(n_workers=0, **options) as empty:
        refused = pytest.raises(InputError, match="has no workers")
        with refused, certpgo.scheduler(empty.scheduler_address):
            pass
    monkeypatch.setattr(schedulers, "PATIENCE", 10.0)
    own = {**schedulers.versions(), "numpy": "0.1"}
    monkeypatch.setattr(schedulers, "versions", lambda: own)
    refused = pytest.raises(InputError, match=r"numpy .*, this process")
    client = types.SimpleNamespace(
        wait_for_workers=lambda *_, **__: None,
        run=lambda _: {"tcp://a:1": {**own, "numpy": "2.4"}},
    )
    with refused:
        schedulers._require_workers(client, "tcp://b:1")


def test_failures_of_a_cluster_are_one_line(monkeypatch):
    monkeypatch.setattr(schedulers, "PATIENCE", 0.02)
    monkeypatch.setattr(schedulers, "POLL", 0.01)
    future = types.SimpleNamespace(status="error", result=lambda: 1 / 0)

    def too_long(*_, **__):
        raise TimeoutError

    client = types.SimpleNamespace(
        get=lambda *_, **__: [future],
        gather=list,
        as_current=contextlib.nullcontext,
        scheduler_info=lambda **_: {"workers": {}},
    )
    monkeypatch.setattr(distributed, "wait", too_long)
    with pytest.raises(CertPGOError, match="has lost all its workers"):
        schedulers.Cluster(client).compute(TaskGraph(), ["a"])
    monkeypatch.setattr(schedulers, "PATIENCE", 1.0)
    monkeypatch.setattr(distributed, "wait", lambda *_, **__: None)
    with pytest.raises(CertPGOError, match=r"the cluster failed \(ZeroDivisionError: .*logs"):
        schedulers.Cluster(client).compute(TaskGraph(), ["a"])

"""Threads of BLAS: limited in a search, as they were after it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import threadpoolctl

import certpgo
from certpgo.io.datasets.synthetic import grid3d
from certpgo.linalg.threads import one_thread


def of_blas():
    """Threads of NumPy's and SciPy's BLAS; other packages bring libraries of their own."""
    found = threadpoolctl.threadpool_info()
    ours = [x for x in found if any(name in x["filepath"] for name in ("numpy", "scipy"))]
    return [x["num_threads"] for x in ours]


@pytest.fixture
def two_threads():
    with threadpoolctl.threadpool_limits(2):
        yield of_blas()


def test_they_are_limited_while_anyone_is_within(two_threads):
    with one_thread:
        with one_thread:
            pass
        assert set(of_blas()) == {1}
        with one_thread.lifted():
            assert of_blas() == two_threads
        assert set(of_blas()) == {1}
    assert of_blas() == two_threads
    with one_thread.lifted():
        assert of_blas() == two_threads


def test_threads_of_python_leave_them_as_they_were(two_threads):
    graph = grid3d(2, np.random.default_rng(0)).graph
    with ThreadPoolExecutor(4) as pool:
        costs = list(pool.map(lambda _: certpgo.solve(graph).cost, range(8)))
    assert len(set(costs)) == 1
    assert of_blas() == two_threads


def test_a_search_and_a_certificate_take_one(two_threads):
    instance, seen = grid3d(2, np.random.default_rng(0)), []

    def monitor(iteration):
        seen.extend(of_blas())
        return False

    answer = certpgo.solve(instance, monitor=monitor)
    certpgo.certify(instance, answer.estimate, monitor=monitor)
    assert set(seen) == {1}
    assert of_blas() == two_threads

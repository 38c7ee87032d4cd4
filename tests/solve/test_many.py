"""Many graphs by threads or an executor: order, errors in their places, lazy, stopped in time."""

import functools
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from certpgo import (
    CertPGOError,
    GraphError,
    InputError,
    InputNotice,
    Quadratic,
    SpecError,
    certify,
    certify_many,
    check,
    prove_many,
    solve,
    solve_many,
    write,
)
from certpgo.io.datasets.synthetic import cycle, grid3d, winding_cycle
from certpgo.solve.many import results_of
from certpgo.solve.processes import processes


def graphs(count):
    """Of different sizes, so that the later ones are often done first."""
    return [cycle(3 + 7 * (k % 3), 0.1, np.random.default_rng(k)).graph for k in range(count)]


@pytest.mark.parametrize("workers", [None, 1, 3])
def test_answers_are_those_of_solve_in_order(workers):
    given = [*graphs(6), grid3d(3, np.random.default_rng(0))]
    for answer, alone in zip(
        solve_many(given, workers=workers, cost="chordal"), map(solve, given), strict=True
    ):
        assert answer.cost == alone.cost
        assert answer.certificate.lower_bound == alone.certificate.lower_bound
        assert (answer.estimate.rotations == alone.estimate.rotations).all()
        assert answer.instance is alone.instance


def test_an_error_stands_in_the_place_of_its_graph(tmp_path):
    whole = winding_cycle(6, 0.3, 0)[0].graph
    apart, absent = whole.with_edges([0, 3]), tmp_path / "absent.g2o"
    first, second, third, last = solve_many([whole, apart, absent, whole])
    assert first.verdict == last.verdict == "CERTIFIED"
    with pytest.raises(GraphError) as alone:
        solve(apart)
    assert isinstance(second, GraphError)
    assert str(second) == str(alone.value)
    assert isinstance(third, InputError)
    assert "absent.g2o" in str(third)


def test_settings_are_refused_before_any_graph_is_taken():
    def none():
        pytest.fail("a graph was taken")
        yield

    with pytest.raises(SpecError, match="no_such_setting"):
        solve_many(none(), no_such_setting=1)
    with pytest.raises(InputError, match="at least one worker, not 0"):
        solve_many(none(), workers=0)
    with pytest.raises(InputError, match="at least one worker, not -1"):
        certify_many(none(), workers=-1)


def test_settings_hold_for_every_graph():
    noisy = grid3d(3, np.random.default_rng(0), rotation_noise=0.7).graph
    for answer in solve_many([noisy] * 2, max_rank=3):
        assert [level.rank for level in answer.levels] == [3]


def test_graphs_are_taken_as_answers_are_asked_for():
    taken = []

    def endless():
        for k in itertools.count():
            taken.append(k)
            yield graphs(1)[0]

    found = list(itertools.islice(solve_many(endless(), workers=2), 5))
    assert [answer.verdict for answer in found] == ["CERTIFIED"] * 5
    assert len(taken) <= 10


def test_other_errors_end_all():
    def work(item, _):
        return 1 // item

    results = results_of(work, [1, 0, 1])
    assert next(results) == 1
    with pytest.raises(ZeroDivisionError):
        next(results)


def test_what_is_no_longer_wanted_is_stopped():
    begun, stopped, done = threading.Event(), threading.Event(), []

    def work(item, ends):
        if item:
            begun.set()
            while not ends(None):
                time.sleep(0.001)
            stopped.set()
        done.append(item)
        return item

    results = results_of(work, [0, 1, 2, 3], workers=1)
    assert next(results) == 0
    assert begun.wait(10.0)
    results.close()
    assert stopped.wait(10.0)
    assert done in ([0], [0, 1])  # what waits is not begun


def test_certificates_are_those_of_certify_in_order():
    cycles = [winding_cycle(9, 0.3, k) for k in (0, 1, 0)]
    pairs = [(instance.graph, around) for instance, around in cycles]
    for found, pair in zip(certify_many(pairs, workers=2, angles=True), pairs, strict=True):
        alone = certify(*pair, angles=True)
        assert (found.verdict, found.lower_bound) == (alone.verdict, alone.lower_bound)
        assert found.bounds == alone.bounds


def test_threads_share_a_problem_and_an_estimate_of_another_graph_is_named():
    instance = grid3d(3, np.random.default_rng(0))
    problem, truth = Quadratic(instance.graph), instance.truth
    wrong = truth.subset(np.arange(5))
    estimates = [truth, wrong, *[truth] * 6]
    found = list(certify_many(((problem, one) for one in estimates), workers=4))
    alone = certify(instance.graph, truth)
    assert isinstance(found.pop(1), CertPGOError)
    assert {one.lower_bound for one in found} == {alone.lower_bound}


@pytest.fixture(scope="module")
def two_processes():
    with processes(2) as pool:
        yield pool


@pytest.fixture(params=["threads", "processes"])
def executor(request):
    if request.param == "processes":
        yield request.getfixturevalue("two_processes")
        return
    with ThreadPoolExecutor(2) as pool:
        yield pool


def test_answers_by_an_executor_are_those_of_solve_in_order(executor, tmp_path):
    write(tmp_path / "grid.g2o", grid := grid3d(3, np.random.default_rng(0)))
    given = [*graphs(4), grid, tmp_path / "grid.g2o"]
    found = solve_many(given, workers=2, executor=executor, cost="chordal")
    for answer, graph in zip(found, given, strict=True):
        alone = solve(graph, cost="chordal")
        assert answer.cost == alone.cost
        assert answer.certificate.lower_bound == alone.certificate.lower_bound
        np.testing.assert_array_equal(answer.estimate.rotations, alone.estimate.rotations)


def test_errors_by_an_executor_stand_in_their_places_and_name_the_graph(executor, tmp_path):
    whole = winding_cycle(6, 0.3, 0)[0]
    absent, bad = tmp_path / "absent.g2o", tmp_path / "bad.g2o"
    bad.write_text("EDGE_SE2 0 1 1 0 x\n")
    given = [whole, whole.graph.with_edges([0, 3]), absent, bad, whole]
    first, *errors, last = solve_many(given, executor=executor)
    assert first.verdict == last.verdict == "CERTIFIED"
    for place, (error, graph) in enumerate(zip(errors, given[1:], strict=False), 1):
        with pytest.raises(CertPGOError) as alone:
            solve(graph)
        assert type(error) is alone.type
        assert str(error) == str(alone.value)
        assert vars(error)["__notes__"][0].startswith(f"of item {place}")
    assert errors[1].__notes__ == [f"of item 2, {absent}"]
    assert errors[0].component_sizes == (2, 2, 1, 1)
    assert (errors[2].path, errors[2].line) == (bad, 1)


def test_certificates_by_an_executor_are_those_of_certify(executor):
    cycles = [winding_cycle(9, 0.3, k) for k in (0, 1)]
    pairs = [(instance, around) for instance, around in cycles]
    found = certify_many([*pairs, "no pair"], executor=executor, angles=True)
    for pair in pairs:
        assert next(found).lower_bound == certify(*pair, angles=True).lower_bound
    assert "a pair of a graph and an estimate expected" in str(next(found))


def test_proofs_by_an_executor_are_those_that_the_checker_accepts(executor, tmp_path):
    paths = [tmp_path / f"{name}.g2o" for name in ("grid", "absent", "cycle")]
    write(paths[0], grid3d(2, np.random.default_rng(0)))
    write(paths[2], winding_cycle(5, 0.1, 0)[0])
    proofs = {path: tmp_path / "proofs" / f"{path.stem}.cert" for path in paths}
    with pytest.warns(InputNotice, match=r"cycle.g2o: all translations are zero"):
        found = list(prove_many(proofs, executor=executor, cost="chordal"))
    assert "absent.g2o" in str(found[1])
    assert found[1].__notes__ == [f"of item 1, {paths[1]}"]
    for path, proven in ((paths[0], found[0]), (paths[2], found[2])):
        assert check(path, proofs[path]).lower == proven.lower
        assert 0.0 <= proven.lower <= proven.upper
    assert next(prove_many({paths[0]: proofs[paths[0]]}, cost="chordal")).lower == found[0].lower


def test_what_is_no_executor_is_refused():
    with pytest.raises(InputError, match=r"an executor, as of concurrent\.futures, expected, not"):
        solve_many(graphs(1), executor=4)
    with pytest.raises(InputError, match="a mapping from paths"):
        prove_many(["a.g2o"])


def test_an_executor_is_left_open_and_what_waits_is_cancelled():
    begun, gate = [], threading.Event()

    def work(item, ends):
        begun.append(item)
        gate.wait(10.0 if item else 0.0)
        return item

    with ThreadPoolExecutor(1) as pool:
        results = results_of(work, range(100), workers=2, executor=pool)
        assert next(results) == 0
        results.close()
        gate.set()
        assert pool.submit(int, "7").result() == 7
    assert begun in ([0], [0, 1])


def die_on(item, ends, *, one):
    if item == one:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def test_a_process_that_dies_ends_all_and_is_told_with_the_item():
    with processes(1) as pool:
        results = results_of(functools.partial(die_on, one=2), range(5), 1, pool)
        assert [next(results), next(results)] == [0, 1]
        with pytest.raises(BrokenExecutor) as caught:
            next(results)
    assert caught.value.__notes__ == ["of item 2"]


#: Ends by Ctrl-C while one of two processes sleeps; prints the first result before.
INTERRUPTED = """
import os, signal, sys, threading, time
from certpgo.solve.many import results_of
from certpgo.solve.processes import processes

def work(item, ends):
    if item:
        os.write(1, f"{os.getpid()}\\n".encode())  # whole, whatever the other process prints
        time.sleep(600)
    return item

if __name__ == "__main__":
    with processes(1) as pool:
        for result in results_of(work, range(3), 1, pool):
            os.write(1, f"result {result}\\n".encode())
            threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
"""


def test_ctrl_c_ends_processes_in_the_middle_of_their_work(tmp_path):
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED)
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode != 0
    assert "KeyboardInterrupt" in done.stderr
    assert "result 0" in done.stdout
    for line in done.stdout.split():
        if line.isdigit() and line != "0":
            assert not Path(f"/proc/{line}").exists()


@pytest.mark.filterwarnings("ignore")
def test_forty_graphs_on_a_cluster_of_two_workers():
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    given = graphs(40)
    given[7] = given[7].with_edges([0])
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        found = list(solve_many(given, workers=2, executor=client.get_executor()))
    assert isinstance(found[7], GraphError)
    assert found[7].__notes__ == ["of item 7"]
    for place in (0, 13, 39):
        assert found[place].cost == solve(given[place]).cost
    assert all(answer.verdict == "CERTIFIED" for k, answer in enumerate(found) if k != 7)

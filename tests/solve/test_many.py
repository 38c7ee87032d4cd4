"""Many graphs and estimates by threads: order, errors in their places, lazy, stopped in time."""

import itertools
import threading
import time

import numpy as np
import pytest

from certpgo import (
    CertPGOError,
    GraphError,
    InputError,
    Quadratic,
    SpecError,
    certify,
    certify_many,
    solve,
    solve_many,
)
from certpgo.io.datasets.synthetic import cycle, grid3d, winding_cycle
from certpgo.solve.many import by_threads


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
    with pytest.raises(InputError, match="at least one thread, not 0"):
        solve_many(none(), workers=0)
    with pytest.raises(InputError, match="at least one thread, not -1"):
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

    results = by_threads(work, [1, 0, 1])
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

    results = by_threads(work, [0, 1, 2, 3], workers=1)
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

"""What `certpgo bench speed` measures, how it compares, and what it says of what is not here."""

import stat
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matrices import uneven_matrix

from certpgo.errors import CertPGOError, InputError
from certpgo.io.datasets import synthetic
from certpgo.linalg import compiled
from certpgo.linalg.multifrontal import Fronts, Tree, minimum_degree
from reports.harness.experiments.absence import Absence, Missing
from reports.harness.experiments.journal import from_line, to_line
from reports.harness.speed import bench, limits, pages, sessions
from reports.harness.speed.measuring import (
    Comparison,
    Group,
    Lap,
    SpeedRecord,
    in_turn,
    measured,
    processor,
)
from reports.harness.speed.programs import SE_SYNC_VARIABLE, run, se_sync

needs_the_kernel = pytest.mark.skipif(not compiled.AVAILABLE, reason="without a C compiler")


def group_of(timers, comparisons, **more):
    @contextmanager
    def within():
        yield timers

    return Group("solving", "somewhere", within, tuple(comparisons), rounds=3, **more)


COSTS = {"ours": 2.0, "near": 2.001, "below": 1.0, "above": 3.5}


def laps(*seconds):
    """A timer of these seconds, one after another; the first is the warm-up's."""
    remaining = list(seconds)
    return lambda: Lap(remaining.pop(0), "said")


def test_steps_are_timed_in_turn_after_a_warm_up():
    order = []
    timers = {name: processor(lambda name=name: order.append(name), calls=2) for name in "ab"}
    found = in_turn(timers, 3)
    assert "".join(order) == "aabb" * 4
    assert [len(found[name]) for name in "ab"] == [3, 3]


def test_a_ratio_is_the_median_of_the_rounds_and_has_a_spread():
    timers = {"ours": laps(9.0, 1.0, 2.0, 6.0), "theirs": laps(9.0, 2.0, 2.0, 2.0)}
    goals = Comparison("ours", "theirs", 0.9), Comparison("theirs", "ours", 2.0)
    first, second = measured(group_of(timers, goals), "commit", {"commit": "commit"})
    assert first.ratios == (0.5, 1.0, 3.0)
    assert (first.seconds, first.against_seconds, first.ratio) == (2.0, 2.0, 1.0)
    assert first.misses
    assert not second.misses
    assert (first.note, first.key, first.part) == ("said", second.key, "ours / theirs")
    assert from_line(to_line(first), SpeedRecord) == first


def test_there_is_no_ratio_to_what_ends_at_another_minimum():
    timers = {name: processor(lambda: 0, cost=lambda _, c=c: c) for name, c in COSTS.items()}
    timers["unknown"] = processor(lambda: 0)
    pairs = [Comparison("ours", other) for other in ("near", "below", "above", "unknown")]
    *compared, elsewhere, unknown = measured(group_of(timers, pairs), "commit", {})
    assert all(record.absence is None for record in (*compared, unknown))
    assert elsewhere.absence is Absence.ELSEWHERE
    assert not elsewhere.absence.is_failure
    assert elsewhere.error == "it ends at another minimum: 3.5 against 2"
    assert elsewhere.against_seconds is not None
    assert compared[0].against_note == "2.001"


def test_what_cannot_run_says_why_and_leaves_the_others():
    def failing():
        raise InputError("information is not definite")

    not_here = Missing(Absence.MISSING_PACKAGE, "SE-Sync is not here")
    timers = {"a": laps(*[1.0] * 4), "b": laps(*[2.0] * 4), "c": not_here, "d": failing}
    pairs = [Comparison(*pair) for pair in ("ab", "ac", "da")]
    good, absent, failed = measured(group_of(timers, pairs), "commit", {})
    assert good.ratio == 0.5
    assert (absent.absence, absent.why_missing) == (not_here.absence, not_here.error)
    assert (absent.seconds, absent.ratio, absent.misses) == (1.0, None, False)
    assert failed.absence is Absence.FAILED
    assert "not definite" in failed.error


def test_a_group_that_cannot_be_prepared_is_missing_as_a_whole():
    @contextmanager
    def nowhere():
        raise InputError("its file is not here")
        yield

    group = replace(group_of({}, [Comparison("a", "b")]), timers=nowhere)
    [record] = measured(group, "commit", {})
    assert "not here" in record.error


def test_a_record_has_ratios_or_a_reason():
    with pytest.raises(ValueError, match="a reason"):
        SpeedRecord(section="s", subject="x", what="a", against="b")


def test_keys_are_of_what_is_measured_and_of_the_commit():
    one = group_of({}, [Comparison("a", "b", 1.0)])
    others = [replace(one, subject="elsewhere"), replace(one, rounds=2)]
    keys = [one.key("c"), one.key("d"), *(other.key("c") for other in others)]
    assert len(set(keys)) == 4
    assert replace(one, comparisons=(Comparison("a", "b", 2.0),)).key("c") == one.key("c")


def test_se_sync_is_asked_for_its_own_seconds_where_it_is_built(tmp_path, monkeypatch):
    monkeypatch.delenv(SE_SYNC_VARIABLE, raising=False)
    absent = se_sync(tmp_path)
    assert absent.absence is Absence.MISSING_PACKAGE
    assert SE_SYNC_VARIABLE in absent.error
    script = tmp_path / "SE-Sync"
    monkeypatch.setenv(SE_SYNC_VARIABLE, str(script))
    assert se_sync(tmp_path).error == f"{SE_SYNC_VARIABLE}: {script} is no program"
    for said in ("Total elapsed computation time: 0.125 seconds", "nothing"):
        script.write_text(f"#!/bin/sh\necho '{said}' >&2\n")
        script.chmod(script.stat().st_mode | stat.S_IXUSR)
        timer = se_sync(tmp_path / "graph.g2o")
        if said == "nothing":
            with pytest.raises(CertPGOError, match=r"printed no seconds for graph.g2o"):
                timer()
        else:
            assert timer().seconds == 0.125


def test_a_share_that_is_spared_is_not_counted():
    def step():
        return sum(range(10**6))

    assert processor(step, spared=lambda result: 1.0)().seconds == 0.0
    assert processor(step, spared=lambda result: 0.25)().seconds > 0.0


def test_a_program_that_fails_is_quoted():
    with pytest.raises(CertPGOError, match="ended with code 3: the last line"):
        run(["/bin/sh", "-c", "echo first; echo the last line; exit 3"])


@needs_the_kernel
@given(st.integers(0, 100), st.integers(2, 12), st.integers(1, 4))
def test_flops_are_the_squares_of_the_columns_of_the_factor(seed, n, b):
    P, A = uneven_matrix(seed, n, b, 1.0)
    tree = Tree.of(P.indptr, P.indices, minimum_degree(P.indptr, P.indices))
    fronts = Fronts(tree, np.full(n, b))
    L = fronts.factor(np.ascontiguousarray(A.data)).lower()[0]
    lengths = np.diff(L.indptr)
    assert limits.flops_of(fronts) == pytest.approx(float((lengths**2).sum()))


@needs_the_kernel
def test_work_is_counted_while_it_is_done():
    P, A = uneven_matrix(0, 8, 3, 1.0)
    tree = Tree.of(P.indptr, P.indices, minimum_degree(P.indptr, P.indices))
    fronts, data = Fronts(tree, np.full(8, 3)), np.ascontiguousarray(A.data)
    own = Fronts.eliminate
    with limits.counting() as total:
        fronts.factor(data).solve(np.ones(24))
        fronts.factor_kept_single(data, A.diagonal())
        fronts.multiply(data, np.ones(24))
    once = limits.flops_of(fronts)
    assert (total.double, total.single) == (once, once)
    moved = limits.substituted(fronts, "double") + limits.multiplied(fronts, data)
    assert total.moved == moved
    assert Fronts.eliminate is own


def test_a_limit_is_work_over_the_rates_of_the_moment(monkeypatch):
    rates = {"single": 4.0, "double": 2.0}
    monkeypatch.setattr(limits, "peak", rates.__getitem__)
    monkeypatch.setattr(limits, "copied_per_second", lambda: 5.0)
    lap = limits.Work(single=8.0, double=6.0, moved=10.0).timer()()
    assert lap.seconds == 2.0 + 3.0 + 2.0
    assert "GFlop/s in single" in lap.note


def test_rates_are_those_of_a_computer():
    assert 1e8 < limits.peak("double") < 1e13
    assert 1e8 < limits.copied_per_second() < 1e13


@pytest.mark.gtsam
def test_ours_is_certified_in_each_cost_and_others_run(dataset_path):
    pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")
    dataset_path("MIT")
    [group] = bench.groups(True, ["solving"])
    with group.timers() as timers:
        laps = {name: timer() for name, timer in timers.items() if callable(timer)}
    notes = {name: lap.note for name, lap in laps.items()}
    ours = [note for name, note in notes.items() if name.startswith(("solve", "certify"))]
    assert len(ours) == 6
    assert all(note.startswith("CERTIFIED") for note in ours)
    assert all(lap.note or lap.cost for lap in laps.values())


def test_a_session_is_fed_all_measurements():
    graph, seen = synthetic.grid3d(5, np.random.default_rng(0)).graph, []
    session, latencies = sessions.fed(graph, lambda count, session: seen.append(count))
    assert seen == [100, 200, graph.num_edges]
    assert len(latencies) == graph.num_edges == session.graph.num_edges
    parts = list(sessions.prefixes(graph))
    assert [part.num_edges for part in parts] == seen


RECORDS = [
    SpeedRecord(
        section=limits.SECTION,
        subject=f"helix of {n} poses",
        what="solve",
        against=limits.limit_of("solve"),
        seconds=1e-4 * n**1.25,
        against_seconds=1e-5 * n**1.5,
        ratios=(4.0, 5.0, 6.0),
        goal=3.0,
        size=n,
    )
    for n in (100, 1000)
]


def test_pages_have_ratios_goals_and_exponents():
    absent = SpeedRecord(
        section="solving",
        subject="intel",
        what="solve",
        against="SE-Sync",
        seconds=0.5,
        absence=Absence.MISSING_PACKAGE,
        error="SE-Sync is not here",
    )
    page = pages.markdown([absent, *RECORDS])
    assert "intel" not in page  # no row without numbers
    assert "Not measured: SE-Sync is not here." in page
    assert "| its limit | 0.01 | 5 | 4 | 6 | > 3 |" in page
    assert "| solve | 1.25 | 1.50 |" in page
    assert "2 ratios with a goal, 2 above it." in page
    lines = pages.csv_text([absent, *RECORDS]).splitlines()
    assert len(lines) == 4
    assert lines[1].endswith(",SE-Sync is not here")
    assert lines[2].count(",") == lines[0].count(",")


def test_every_section_has_words():
    assert set(pages.OF_SECTION) == set(bench.SECTIONS)


def test_results_of_the_commit_are_kept_and_others_forgotten(tmp_path, monkeypatch):
    calls = []

    def group():
        timers = {"a": lambda: calls.append("a") or Lap(1.0), "b": laps(*[1.0] * 4)}
        return group_of(timers, [Comparison("a", "b")])

    assert len(list(bench.run(tmp_path, [group()]))) == 1
    assert len(calls) == 4
    [(_, again)] = bench.run(tmp_path, [group()])
    assert len(calls) == 4
    assert again[0].provenance["protocol"]
    monkeypatch.setattr(bench, "provenance", lambda *_: {"commit": "another"})
    list(bench.run(tmp_path, [group()]))
    assert len(calls) == 8
    assert len((tmp_path / "speed.jsonl").read_text().splitlines()) == 1

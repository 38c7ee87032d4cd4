import os
from dataclasses import replace

import numpy as np
import pytest

from certpgo.errors import FormatError, InputError
from certpgo.graph import Estimate
from certpgo.io.datasets.edges import viewing_edges
from certpgo.optimize.monitor import Iteration
from certpgo.optimize.solution import Solution, Status
from certpgo.solve.provenance import provenance
from reports.harness.experiments.absence import Absence, missing
from reports.harness.experiments.journal import Journal, from_line, latest, read_entries, to_line
from reports.harness.experiments.records import TRACED, Record, trace_of

RECORD = Record(
    "t",
    "row",
    "method",
    settings={"tol": 1e-9},
    reading={"weights": "unit"},
    seed=3,
    metrics={"cost": 0.1 + 0.2},
    seconds={"eigen": 0.25},
    trace=((0.0, 3.0), (0.25, 2.5)),
)


def test_a_record_survives_its_line():
    assert from_line(to_line(RECORD), Record) == RECORD
    absent = Record("t", "row", "method", absence=Absence.TOO_LARGE, error="above 5 nodes")
    assert from_line(to_line(absent), Record) == absent
    assert absent.why_missing == "not run: above 5 nodes"


@pytest.mark.parametrize("more", [{"error": "it broke"}, {"absence": "failed"}])
def test_a_missing_result_has_a_reason_and_words_for_it(more):
    with pytest.raises(ValueError, match="reason"):
        Record("t", "row", "method", **more)


def test_a_file_that_is_not_here_is_not_a_failure(monkeypatch):
    monkeypatch.setattr("certpgo.io.datasets.lookup.find", lambda entry, data: None)
    with pytest.raises(InputError) as caught:
        viewing_edges("Ellis_Island.mat")
    found = missing(caught.value)
    assert (found.absence, found.absence.is_failure) == (Absence.NOT_HERE, False)
    assert str(found) == "not run: Ellis_Island.mat: file not here; certpgo fetch Ellis_Island.mat"


def test_a_trace_is_thinned_and_keeps_its_ends():
    told = tuple(Iteration(k, 1000.0 / (k + 1), 0.0, 0.0, 0.5 * k) for k in range(1000))
    estimate = Estimate(np.eye(2)[None])
    trace = trace_of(Solution(estimate, 1.0, Status.CONVERGED, trace=told))
    assert TRACED // 2 < len(trace) <= TRACED
    assert (trace[0], trace[-1]) == ((0.0, 1000.0), (499.5, 1.0))
    assert set(trace) <= {(it.seconds, float(f"{it.cost:.12g}")) for it in told}
    assert trace_of(Solution(estimate, 1.0, Status.CONVERGED)) == ()
    short = Solution(estimate, told[6].cost, Status.CONVERGED, trace=told[:7])
    assert len(trace_of(short)) == 7
    assert trace_of(replace(short, cost=1.0)) == ()
    assert len(trace_of(replace(short, cost=told[6].cost * 0.9995))) == 7
    assert trace_of(replace(short, cost=told[6].cost * 1.00001)) == ()
    robust = replace(short, weights=np.ones(1))
    assert trace_of(robust) == ()


@pytest.mark.parametrize(
    "line",
    [
        to_line(RECORD).replace("{", '{"colour": "red", ', 1),
        to_line(RECORD).replace('"absence": null, "error": ""', '"absence": "bored", "error": "x"'),
        '{"table": "t"}',
        "[]",
    ],
)
def test_what_is_no_record_is_refused(line):
    with pytest.raises((ValueError, TypeError)):
        from_line(line, Record)


def test_a_last_line_cut_short_is_passed_over(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text(to_line(RECORD) + "\n" + to_line(RECORD)[:40])
    assert read_entries(path, Record) == (RECORD,)


def test_another_broken_line_is_named(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text(f"{to_line(RECORD)[:40]}\n{to_line(RECORD)}\n")
    with pytest.raises(FormatError, match=r"r\.jsonl:1: a record"):
        read_entries(path, Record)


def test_numbers_that_are_not_finite_are_null():
    assert '"cost": null' in to_line(Record("t", "r", "m", metrics={"cost": float("inf")}))


def keyed(key="k", part="", **more):
    return replace(RECORD, key=key, part=part, **more)


def test_records_are_appended_and_found_by_their_key(tmp_path):
    journal = Journal(tmp_path / "new", "r", Record)
    made = [keyed(), keyed(part="b", parts=2), keyed("other"), keyed(iterations=7)]
    for record in made:
        journal.add(record)
    assert read_entries(journal.path, Record) == tuple(made)
    for found in (journal, Journal(tmp_path / "new", "r", Record)):
        assert found.find("k") == (made[3], made[1])
        assert found.find("none") == ()


def test_what_says_the_same_again_is_not_appended(tmp_path):
    journal = Journal(tmp_path, "r", Record)
    journal.add(keyed(provenance={"date": "today"}))
    journal.add(keyed(provenance={"date": "tomorrow"}))
    assert [r.provenance["date"] for r in read_entries(journal.path, Record)] == ["today"]


def test_a_last_line_cut_short_is_cut_off(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text(to_line(keyed()) + "\n" + to_line(RECORD)[:40])
    Journal(tmp_path, "r", Record).add(keyed("next"))
    assert [record.key for record in read_entries(path, Record)] == ["k", "next"]


def test_the_last_of_a_key_and_part_counts():
    records = [keyed(), keyed(part="b"), keyed(iterations=7)]
    assert latest(records) == [keyed(iterations=7), keyed(part="b")]


def test_a_file_without_records_is_not_left_behind(tmp_path):
    Journal(tmp_path / "new", "r", Record).close()
    assert not (tmp_path / "new").exists()
    journal = Journal(tmp_path / "new", "r", Record)
    journal.add(RECORD)
    journal.close()
    assert read_entries(journal.path, Record) == (RECORD,)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file: cannot write there: a file is there"):
        Journal(tmp_path / "file", "r", Record)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_named(tmp_path):
    (tmp_path / "ro").mkdir(mode=0o500)
    with pytest.raises(InputError, match=r"ro: cannot write there: Permission denied"):
        Journal(tmp_path / "ro", "r", Record)


def test_provenance_names_versions_engine_and_date():
    origin = provenance("superlu", None)
    assert origin["engine"] == "superlu"
    assert "numpy" in origin["versions"]
    assert origin["commit"] == "unknown"

import os

import pytest

from certpgo.errors import FormatError, InputError
from certpgo.harness.records import Journal, Record, from_line, provenance, read_records, to_line

RECORD = Record(
    "t",
    "row",
    "method",
    settings={"tol": 1e-9},
    reading={"weights": "unit"},
    seed=3,
    metrics={"cost": 0.1 + 0.2},
    seconds={"eigen": 0.25},
)


def test_a_record_survives_its_line():
    assert from_line(to_line(RECORD)) == RECORD


def test_a_field_of_a_later_version_is_dropped():
    line = to_line(RECORD).replace("{", '{"colour": "red", ', 1)
    assert from_line(line) == RECORD


def test_a_last_line_cut_short_is_passed_over(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text(to_line(RECORD) + "\n" + to_line(RECORD)[:40])
    assert read_records(path) == (RECORD,)


def test_another_broken_line_is_named(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text(f"{to_line(RECORD)[:40]}\n{to_line(RECORD)}\n")
    with pytest.raises(FormatError, match=r"r\.jsonl:1: a record"):
        read_records(path)


def test_numbers_that_are_not_finite_are_null():
    assert '"cost": null' in to_line(Record("t", "r", "m", metrics={"cost": float("inf")}))


def test_results_appear_when_the_run_is_over(tmp_path):
    journal = Journal(tmp_path / "new", "r")
    journal.add(RECORD)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["r.jsonl.part"]
    path = journal.publish("text")
    assert read_records(path) == (RECORD,)
    assert {p.name for p in (tmp_path / "new").iterdir()} == {"r.jsonl", "r.md"}


def test_an_interrupted_run_leaves_the_results_before_it(tmp_path):
    for text, partial in (("whole", False), ("less", True)):
        journal = Journal(tmp_path, "r")
        journal.add(RECORD)
        journal.publish(text, partial=partial)
    assert (tmp_path / "r.md").read_text() == "whole"
    assert (tmp_path / "r.partial.md").read_text() == "less"
    assert read_records(tmp_path / "r.partial.jsonl") == (RECORD,)


def test_a_discarded_run_leaves_nothing(tmp_path):
    Journal(tmp_path / "new", "r").discard()
    assert not (tmp_path / "new").exists()


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file: cannot write there: File exists"):
        Journal(tmp_path / "file", "r")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_named(tmp_path):
    (tmp_path / "ro").mkdir(mode=0o500)
    with pytest.raises(InputError, match=r"ro: cannot write there: Permission denied"):
        Journal(tmp_path / "ro", "r")


def test_provenance_names_versions_engine_and_date():
    origin = provenance("superlu", None)
    assert origin["engine"] == "superlu"
    assert "numpy" in origin["versions"]
    assert origin["commit"] == "unknown"

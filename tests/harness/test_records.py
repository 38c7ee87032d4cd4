import pytest

from certpgo.errors import FormatError
from certpgo.harness.records import Record, from_line, new_file, provenance, read_records, to_line

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


def test_an_interrupted_file_keeps_what_is_done(tmp_path):
    def interrupted():
        with new_file(tmp_path / "new" / "r.jsonl") as stream:
            stream.write(to_line(RECORD) + "\n")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert read_records(tmp_path / "new" / "r.jsonl") == (RECORD,)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["r.jsonl"]


def test_provenance_names_versions_engine_and_date():
    origin = provenance("superlu", None)
    assert origin["engine"] == "superlu"
    assert "numpy" in origin["versions"]
    assert origin["commit"] == "unknown"

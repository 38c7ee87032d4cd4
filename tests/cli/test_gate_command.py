import json
import os

import pytest

from certpgo import registry
from reports.harness.experiments import regression
from reports.harness.experiments.journal import to_line
from reports.harness.experiments.records import Record

RECORD = Record(
    "t", "row", "newton", metrics={"cost": 10.0}, verdict="CERTIFIED", iterations=3, n=5
)


def write(folder, *records):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "t.jsonl").write_text("".join(to_line(record) + "\n" for record in records))
    return folder


def record(**changed):
    return Record(**{**vars(RECORD), **changed})


@pytest.fixture
def committed(tmp_path):
    return write(tmp_path / "committed", RECORD, record(row="other"))


def test_the_gate_holds_and_names_what_is_missing(certpgo, committed, tmp_path):
    new = write(tmp_path / "new", RECORD)
    done = certpgo("gate", new, "--against", committed)
    assert (done.code, done.err) == (0, "")
    assert "without a new record: t, other, newton" in done.out
    assert "the gate holds: 1 record compared" in done.out
    complete = certpgo("gate", new, "--against", committed, "--complete")
    assert complete.code == 7
    assert "records are lacking" in complete.out


def test_the_gate_says_what_moved_which_way_and_by_how_much(certpgo, committed, tmp_path):
    new = write(tmp_path / "new", record(metrics={"cost": 11.0}, iterations=2))
    done = certpgo("gate", new, "--against", committed)
    assert done.code == 7
    [cost] = [line for line in done.out.splitlines() if "cost" in line]
    assert [word for word in cost.split() if word != "│"] == [
        *("t", "row", "newton", "cost", "10", "11", "+10.0", "%", "worse")
    ]
    assert "iterations" in done.out
    assert "better" in done.out
    assert "the gate failed: 1 record compared" in done.out
    assert "1 value worse or different" in done.out


def test_the_gate_is_one_json_document(certpgo, committed, tmp_path):
    new = write(tmp_path / "new", record(verdict="BOUNDED"), record(row="third", seed=2))
    done = certpgo("gate", new, "--against", committed / "t.jsonl", "--json")
    assert done.code == 7
    said = done.json
    assert (said["holds"], said["compared"]) == (False, 1)
    [move] = said["movements"]
    assert (move["what"], move["committed"], move["new"]) == ("verdict", "CERTIFIED", "BOUNDED")
    assert (move["direction"], move["fails"], move["change"]) == ("worse", True, None)
    assert [key["row"] for key in said["missing"]] == ["other"]
    assert [(key["row"], key["seed"]) for key in said["added"]] == [("third", 2)]


def test_the_zoo_is_a_file_of_its_own(certpgo, tmp_path):
    results = registry.repository() / "reports" / "results" / "zoo.jsonl"
    first, *others = results.read_text().splitlines()
    data = json.loads(first)
    data["outcomes"]["certpgo proof"]["missed"] = 1
    path = tmp_path / "zoo.jsonl"
    path.write_text("\n".join([json.dumps(data), *others]) + "\n")
    done = certpgo("gate", path, "--json")
    assert (done.code, done.json["compared"]) == (7, len(others) + 1)
    [move] = done.json["movements"]
    assert (move["table"], move["what"]) == ("zoo", "certpgo proof: missed")
    assert (move["committed"], move["new"], move["direction"]) == (0, 1, "worse")


def test_times_are_compared_as_told(certpgo, tmp_path):
    committed = write(tmp_path / "committed", record(metrics={"ratio": 1.0}))
    new = write(tmp_path / "new", record(metrics={"ratio": 1.4}))
    assert certpgo("gate", new, "--against", committed).code == 0
    assert certpgo("gate", new, "--against", committed, "--times", "1.3").code == 7
    assert certpgo("gate", new, "--against", committed, "--times", "0.5").code == 2


def test_nothing_to_compare_is_an_error_of_one_line(certpgo, committed, tmp_path):
    new = write(tmp_path / "new", record(row="third"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.jsonl").write_text("{}\n{}\n")
    for arguments, said in (
        ((new, "--against", committed), "has none of these records"),
        ((committed, "--against", committed), "would be compared with itself"),
        ((tmp_path / "nowhere", "--against", committed), "no such file or folder"),
        ((new, "--against", tmp_path / "empty"), "no records"),
        ((tmp_path / "bad.jsonl", "--against", committed), "bad.jsonl:1"),
    ):
        done = certpgo("gate", *arguments)
        assert (done.code, done.out, done.err.count("\n")) == (1, "", 1)
        assert said in done.err


def test_without_new_records_the_fixed_set_is_run(certpgo, tmp_path, monkeypatch):
    monkeypatch.setattr(regression, "FIXED", ("eriksson2018_table1",))
    done = certpgo("gate", "--json")
    assert done.code == 0, done.out
    assert done.json["compared"]
    assert {key["table"] for key in done.json["missing"]} <= {"eriksson2018_table1"}


def test_without_a_checkout_the_gate_says_so(certpgo, tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, registry.REPOSITORY_VARIABLE, str(tmp_path))
    done = certpgo("gate")
    assert (done.code, done.err.count("\n")) == (1, 1)
    assert registry.REPOSITORY_VARIABLE in done.err

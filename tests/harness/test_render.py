from dataclasses import replace

import pytest

from certpgo.errors import InputError
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.keys import QUICK_NOTES
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.rendering.published import Printed
from reports.harness.rendering.render import CROWDED, notes, sections, table_markdown

TABLE = Table(
    "t",
    "A title",
    (Row("a"),),
    (Method("m"), Method("other")),
    (Column("cost", "F", ".3f"), Column("verdict", "verdict"), Column("seconds", "s")),
    notes=("A note.",),
)


NOT_READ = {
    "d": None,
    "n": None,
    "m": None,
    "reading": {},
    "metrics": {},
    "absence": Absence.NOT_HERE,
    "error": "file not here",
}


def record(method="m", **more):
    parts = {
        "key": method,
        "d": 3,
        "n": 4,
        "m": 5,
        "reading": {"weights": "file"},
        "metrics": {"cost": 1.5},
    }
    return Record("t", "a", method, **{**parts, **more})


def test_costs_of_two_readings_never_share_a_section():
    records = [record(), record("other", reading={"weights": "unit"})]
    first, second = sections(TABLE, records)
    assert "information matrices" in first.caption
    assert "all weights 1" in second.caption


def test_markdown_to_the_byte():
    good = record(verdict="CERTIFIED", seconds={"x": 0.25, "y": 0.5}, note="a | b")
    bad = record("other", metrics={}, absence=Absence.FAILED, error="it failed")
    good = Record(**{**vars(good), "provenance": {"engine": "superlu"}})
    assert table_markdown(TABLE, [good, bad]).split("\n") == [
        "# A title",
        "",
        "## a (4 nodes, 5 edges, 3D)",
        "",
        "Read with weights from the file's information matrices; parallel edges added. m: a | b.",
        "",
        "| method | F | verdict | s | not run or failed |",
        "| --- | --- | --- | --- | --- |",
        "| m | 1.500 | CERTIFIED | 0.750 (x 0.250, y 0.500) |  |",
        "| other |  |  |  | it failed |",
        "",
        "A note.",
        "",
        "engine: superlu",
        "",
    ]


def test_the_cost_beside_a_robust_verdict_is_that_of_the_kept_measurements():
    proven = {"cost": 99.0, "lower_bound": 1.5, "gap": 0.25, "kept_percent": 90.0}
    robust = record(verdict="CERTIFIED", metrics=proven)
    plain = record("other", verdict="CERTIFIED", metrics={**proven, "kept_percent": 100.0})
    rows = sections(TABLE, [robust, plain])[0].rows
    assert [row[1:3] for row in rows] == [("1.750", "CERTIFIED"), ("99.000", "CERTIFIED")]


def test_a_graph_that_is_not_here_is_said_once():
    gone = [record(m, **NOT_READ) for m in ("m", "other")]
    [section] = sections(TABLE, gone)
    assert section.rows == (("every method", "", "", "", "not run: file not here"),)
    assert section.caption == "Not read."


@pytest.mark.parametrize(
    ("printed", "ours", "agrees"),
    [
        ("18824.3", 18824.34, True),
        ("18824.3", 18824.36, False),
        ("4.2e-07", 4.15e-07, True),
        ("4.2e-07", 4.26e-07, False),
        ("1.0", 0.96, True),
        ("1.0", 0.94, False),
        ("27", 27.5, True),
    ],
)
def test_agreement_is_to_the_printed_digits(printed, ours, agrees):
    assert Printed.of(printed).agrees(ours) == agrees


def test_what_is_no_number_cannot_be_compared():
    with pytest.raises(InputError, match="no printed number"):
        Printed.of("n/a")


def test_the_order_in_which_records_were_made_does_not_show():
    first, second = record(key="1", seed=0), record("other", key="2", seed=0)
    later = [record(key="3", seed=1), record("other", key="4", seed=1)]
    text = table_markdown(TABLE, [first, second, *later])
    assert table_markdown(TABLE, [*reversed(later), second, first]) == text
    assert (
        table_markdown(
            TABLE,
            [record(key="1", seed=0, absence=Absence.FAILED, error="old"), *later, second, first],
        )
        == text
    )


def test_quick_results_are_not_under_notes_of_full_ones():
    quick = record(profile="quick")
    assert notes(TABLE, [record(), quick]) == (QUICK_NOTES, *TABLE.notes)
    assert QUICK_NOTES in table_markdown(TABLE, [quick])
    assert notes(replace(TABLE, notes=()), [quick]) == ()


def test_times_that_were_not_taken_alone_are_warned_of():
    def origin(alone):
        return record(seconds={"x": 1.0}, provenance={"alone": alone})

    assert notes(TABLE, [origin("yes"), record(seconds={"x": 1.0})]) == TABLE.notes
    for alone in ("no", "unknown"):
        assert notes(TABLE, [origin("yes"), origin(alone)]) == (*TABLE.notes, CROWDED)
    timeless = replace(TABLE, columns=TABLE.columns[:2])
    assert notes(timeless, [origin("no")]) == TABLE.notes

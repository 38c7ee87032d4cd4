"""Printed values beside ours, on a small paper made by hand."""

from dataclasses import replace

import pytest

from certpgo import registry
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Cause, Column, Method, Row, Table
from reports.harness.rendering import cells
from reports.harness.rendering.cells import CellStatus
from reports.harness.rendering.findings import findings
from reports.harness.rendering.published import published

#: x_f: of F, the lower the better; x_g: of the mean symmetry, neither; x_time_s: a time.
PRINTED = "set,edges,x_f,x_g,x_time_s\none,5,1.50,2.0,9.1\ntwo,6,3.0,4.0,9.2\nthree,7,5.0,,9.3\n"


@pytest.fixture(autouse=True)
def checkout(tmp_path, monkeypatch):
    for name in ("baselines", "reports/published"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "reports/published/paper_table1.csv").write_text(PRINTED)
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path))
    published.cache_clear()
    yield
    published.cache_clear()


def table(**more):
    return Table(
        "t",
        "A title",
        more.pop("rows", (Row("a", published="one"), Row("b", published="two"))),
        (
            Method(
                "m", published={"cost": "x_f", "mean_symmetry": "x_g", "total_seconds": "x_time_s"}
            ),
        ),
        (Column("cost", "f"), Column("mean_symmetry", "g")),
        **{"published": "paper_table1", "key": "set", **more},
    )


def record(row="a", seed=None, **metrics):
    return Record("t", row, "m", seed=seed, metrics=metrics)


def found(records, **more):
    return {(c.key, c.column): c for c in cells.cells(table(**more), records)}


def test_every_printed_value_is_counted_and_nothing_else():
    assert cells.value_columns(table()) == ("x_f", "x_g")
    # five: what is empty, the number of edges and times are no values
    keys = [("one", "x_f"), ("one", "x_g"), ("two", "x_f"), ("two", "x_g"), ("three", "x_f")]
    assert list(found([])) == keys


def test_values_are_reproduced_better_different_or_not_run():
    records = [record(cost=1.504, mean_symmetry=2.06), record("b", cost=2.9)]
    values = found(
        records, remarks={"a": "read otherwise", "three": "lost", "b": "a program of today"}
    )
    assert {key: (c.found, c.reason) for key, c in values.items()} == {
        ("one", "x_f"): (CellStatus.REPRODUCED, ""),
        ("one", "x_g"): (CellStatus.UNEXPLAINED, "read otherwise"),
        ("two", "x_f"): (CellStatus.BETTER, "a program of today"),
        ("two", "x_g"): (CellStatus.NOT_RUN, "a program of today"),
        ("three", "x_f"): (CellStatus.NOT_RUN, "lost"),
    }
    assert values["one", "x_g"].ours == 2.06
    assert cells.tally(values.values()) == dict(zip(CellStatus, (1, 0, 1, 0, 1, 2), strict=True))


def test_what_is_worse_is_not_better():
    assert found([record("b", cost=3.1)])["two", "x_f"].found is CellStatus.UNEXPLAINED


def test_a_failure_says_why_before_any_explanation():
    absent = replace(record(), absence=Absence.NOT_HERE, error="file not here")
    values = found([absent], remarks={"m": "another program"})
    assert values["one", "x_f"].reason == "file not here"
    assert values["two", "x_f"].reason == "no record"
    assert values["three", "x_f"].reason == "not among our rows"


def test_explanations_are_of_both_then_the_row_then_the_method():
    said = {"a/m": "both", "a": "the row", "m": "the method"}
    spec = table(remarks=said)
    assert cells.explanation(spec, "a", "m") == ("both", None)
    assert cells.explanation(spec, "a", "other") == ("the row", None)
    assert cells.explanation(spec, "b", "m") == ("the method", None)
    assert cells.explanation(spec, "b", "other") == ("", None)


def test_only_a_cause_that_an_experiment_shows_explains():
    cause = Cause("it is cut off", "t")
    values = found([record(mean_symmetry=9.0)], explained={"a": cause}, remarks={"a/m": "tried"})
    # what is said of both comes first, and a remark is no cause
    assert values["one", "x_g"].found is CellStatus.UNEXPLAINED
    values = found([record(mean_symmetry=9.0)], explained={"a": cause}, remarks={"m": "tried"})
    value = values["one", "x_g"]
    assert (value.found, value.reason) == (CellStatus.EXPLAINED, "it is cut off (shown in t)")


@pytest.mark.parametrize(
    ("offset", "expected"), [(0.199, CellStatus.REPRODUCED), (0.201, CellStatus.UNEXPLAINED)]
)
def test_two_standard_errors_of_the_mean_over_the_seeds(offset, expected):
    # Mean 4 + offset; deviation 0.2 of four, hence a standard error of 0.1.
    spread = 0.2 * 0.75**0.5
    values = [4.0 + offset + side * spread for side in (-1.0, -1.0, 1.0, 1.0)]
    records = [record("b", seed=k, mean_symmetry=value) for k, value in enumerate(values)]
    value = found(records, summary="mean")["two", "x_g"]
    assert value.standard_error == pytest.approx(0.1)
    assert value.ours == pytest.approx(4.0 + offset)
    assert value.found is expected
    # of one instance nobody knows the spread
    assert found(records[:1], summary="mean")["two", "x_g"].standard_error is None


@pytest.mark.parametrize(
    ("draws", "expected", "reason"),
    [
        ((3.96, 4.04, 90.0), CellStatus.REPRODUCED, ""),
        # the mean and its error, which would reach 4.0, do not count
        ((5.0, 6.0, 90.0), CellStatus.UNEXPLAINED, "none of 3 draws reaches it; of the row"),
        ((3.0, 3.2, 3.94), CellStatus.UNEXPLAINED, "none of 3 draws reaches it; of the row"),
        ((3.0, 3.2, 3.95), CellStatus.AMONG, "3 of 3 draws are lower"),
        ((3.0, 5.2, 9.0), CellStatus.AMONG, "1 of 3 draws are lower"),
    ],
)
def test_a_printed_number_of_unknown_statistic_is_compared_with_the_draws(draws, expected, reason):
    records = [record("b", seed=k, mean_symmetry=value) for k, value in enumerate(draws)]
    value = found(records, summary="median", remarks={"b": "of the row"})["two", "x_g"]
    assert (value.ours, value.found, value.reason) == (draws[1], expected, reason)
    assert (value.draws, value.standard_error) == ((draws[0], draws[2]), None)


def test_where_no_reading_reaches_it_all_draws_are_counted():
    spec = table(summary="median", rows=(Row("a", published="two"), Row("b", published="two")))
    records = [
        record(row, seed=k, mean_symmetry=value)
        for row, values in (("a", (1.0, 2.0)), ("b", (5.0, 5.5, 6.0)))
        for k, value in enumerate(values)
    ]
    [cell] = [c for c in cells.cells(spec, records) if (c.key, c.column) == ("two", "x_g")]
    assert (cell.row, cell.found) == ("b", CellStatus.UNEXPLAINED)
    assert cell.reason == "none of 5 draws of 2 readings reaches it"


def test_one_draw_is_a_number():
    value = found([record("b", seed=0, mean_symmetry=4.2)], summary="median")["two", "x_g"]
    assert (value.found, value.draws) == (CellStatus.UNEXPLAINED, None)


def test_values_of_other_programs_are_marked_by_column_or_key():
    assert {key for key, c in found([], others=("x_g", "three")).items() if c.of_other} == {
        ("one", "x_g"),
        ("two", "x_g"),
        ("three", "x_f"),
    }


def test_other_instances_are_never_compared():
    value = found([record(cost=1.5)], comparable=False)["one", "x_f"]
    assert (value.found, value.reason) == (CellStatus.NOT_RUN, "of another instance")


def test_the_nearest_of_several_readings_counts():
    rows = (Row("a", published="one"), Row("b", published="one"))
    method = Method("m", published={"mean_symmetry": "x_g"})
    spec = Table(
        "t",
        "",
        rows,
        (method,),
        (Column("mean_symmetry", "g"),),
        published="paper_table1",
        key="set",
    )
    first, *others = cells.cells(spec, [record(mean_symmetry=9.0), record("b", mean_symmetry=2.0)])
    assert (first.row, first.found) == ("b", CellStatus.REPRODUCED)
    assert [cell.key for cell in others] == ["two"]


def test_of_lines_of_methods_the_key_names_both(tmp_path):
    lines = "set,by,f\none,us,1.0\none,them,2.0\n"
    (tmp_path / "reports/published/paper_table2.csv").write_text(lines)
    method = Method("m", published={"cost": "f"}, printed="us")
    spec = Table(
        *("t", "", (Row("a", published="one"),), (method,), (Column("cost", "f"),)),
        published="paper_table2",
        key="set,by",
        remarks={"them": "weights are not public"},
    )
    ours, theirs = cells.cells(spec, [record(cost=1.0)])
    assert ours.found is CellStatus.REPRODUCED
    assert (theirs.key, theirs.reason) == ("one/them", "weights are not public")


def test_the_findings_to_the_byte():
    records = [record(cost=1.504, mean_symmetry=2.06), record("b", cost=2.9)]
    assert findings(table(remarks={"a": "read | otherwise"}), records) == [
        "## Printed values",
        "",
        "Of 5 printed values 1 reproduced, 1 better, 1 different (0 explained, 1 unexplained), 2 "
        "not run.",
        "",
        "| row | method | metric | printed | ours | found | why, or what was tried |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| a | m | mean_symmetry | 2.0 | 2.06 | differs, unexplained | read \\| otherwise |",
        "| b | m | cost | 3.0 | 2.9 | better |  |",
        "",
        "| not run, because | values |",
        "| --- | --- |",
        "| no record | 1 |",
        "| not among our rows | 1 |",
        "",
    ]

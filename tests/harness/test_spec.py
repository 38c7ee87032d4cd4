import pytest

from certpgo.errors import SpecError
from reports.harness.experiments.spec import Column, Method, Row, Table

ROW, METHOD, COLUMN = Row("MIT"), Method("newton"), Column("cost", "F")


def table(**changes):
    parts = {"rows": (ROW,), "methods": (METHOD,), "columns": (COLUMN,), **changes}
    return Table("t", "title", **parts)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rows": ()}, "must not be empty"),
        ({"methods": (METHOD, METHOD)}, "two methods are called 'newton'"),
        ({"rows": (ROW,), "stand_ins": (ROW,)}, "two rows are called 'MIT'"),
        ({"quick": ("MTI",)}, "did you mean MIT"),
        ({"seeds": 0}, "seeds must be at least 1"),
        ({"columns": (Column("ratio", "x"),)}, "relative to a reference"),
    ],
)
def test_a_wrong_table_is_refused_at_construction(changes, said):
    with pytest.raises(SpecError, match=said):
        table(**changes)


def test_a_right_table_is_not():
    assert table(quick=("MIT",)).metrics == ("cost",)


def test_a_row_is_a_dataset_or_synthetic_and_not_both():
    for wrong in ({}, {"dataset": "MIT", "generator": "cycle"}):
        with pytest.raises(SpecError, match="either a dataset or a generator"):
            Row(**wrong)


def test_an_unknown_column_suggests_the_nearest():
    with pytest.raises(SpecError, match="did you mean cost"):
        Column("costs", "F")


def test_settings_cannot_be_changed_afterwards():
    with pytest.raises(TypeError):
        Method("newton", settings={"tolerance": 1.0}).settings["tolerance"] = 2.0

"""Figures: the contract that every one keeps, and what single ones show."""

import json

import pytest

from certpgo import registry
from certpgo.errors import InputError, SpecError
from certpgo.harness.figure import Figure, computed, publish, rendered


@pytest.fixture(scope="module")
def quick():
    """The record of a figure's quick profile, computed once; skips where files are not here."""
    records = {}

    def record_of(name):
        if name not in records:
            try:
                records[name] = computed(registry.get_figure(name), quick=True)
            except InputError as error:
                pytest.skip(str(error))
        return records[name]

    return record_of


@pytest.mark.parametrize("name", registry.figure_names())
def test_every_figure_keeps_the_contract(name, quick, tmp_path):
    figure = registry.get_figure(name)
    assert figure.name == name
    record = quick(name)
    assert "{" not in figure.captioned(record)
    path = publish(figure, record, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"{name}.json", f"{name}.svg"]
    kept = json.loads(path.with_suffix(".json").read_text())
    assert kept["data"] == record
    assert kept["provenance"]["versions"]
    drawing = path.read_bytes()
    assert drawing.startswith(b"<?xml")
    assert len(drawing) < 400_000
    assert rendered(figure, kept["data"]) == drawing


@pytest.fixture
def bar():
    """A figure of one bar."""

    def draw(canvas, record):
        canvas.add_subplot().bar([0], [record["height"]])

    return Figure("bar", "A bar", "nobody", lambda quick, data: {"height": 2}, draw, "{height} m")


def test_a_figure_is_drawn_from_its_record_alone(bar):
    record = computed(bar)
    assert bar.captioned(record) == "2 m"
    assert rendered(bar, record) == rendered(bar, record)
    assert rendered(bar, record) != rendered(bar, {"height": 3})


def test_a_figure_ignores_the_reader_s_own_matplotlib_settings(bar):
    import matplotlib as mpl

    before = rendered(bar, {"height": 2})
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        assert rendered(bar, {"height": 2}) == before
        assert mpl.rcParams["font.size"] == 20


def test_numbers_that_are_not_finite_are_null_in_a_record():
    spec = Figure("f", "", "", lambda quick, data: {"x": [float("nan"), 1.5]}, print, "")
    assert computed(spec) == {"x": [None, 1.5]}


def test_a_folder_that_cannot_be_written_to_is_one_line(bar, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write there"):
        publish(bar, {"height": 2}, tmp_path / "file")


def test_names_are_completed_over_tables_and_figures():
    assert registry.get_report("eriksson2018-figure1").name == "eriksson2018_figure1"
    assert registry.get_report("eriksson2018-table1").name == "eriksson2018_table1"
    with pytest.raises(SpecError, match="did you mean eriksson2018_figure1"):
        registry.get_report("eriksson2018-figure")
    with pytest.raises(SpecError, match="unknown figure"):
        registry.get_figure("eriksson2018-table1")


def test_figure_1_of_eriksson_shows_three_minima_of_which_the_lowest_is_certified(quick):
    minima = quick("eriksson2018_figure1")["minima"]
    assert [m["verdict"] for m in minima] == ["CERTIFIED", "REFUTED", "REFUTED"]
    costs = [m["cost"] for m in minima]
    assert costs == sorted(costs)
    assert costs[1] > 2 * costs[0]

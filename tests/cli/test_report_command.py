"""The report from made-up results in a checkout of its own: files, index, bytes, command."""

import json

import pytest

from certpgo import registry
from certpgo.errors import FormatError, InputError
from reports.harness.experiments.journal import to_line
from reports.harness.experiments.records import Record
from reports.harness.rendering import citations, publication
from reports.harness.rendering.citations import citation
from reports.harness.rendering.published import published
from reports.harness.rendering.results import gather

TABLE = """\
from reports.harness.experiments.claims import Claim, within
from reports.harness.experiments.spec import Cause, Column, Method, Row, Table

TABLE = Table(
    "paper_table1",
    "A small table",
    (Row("a", published="one"), Row("b", published="two")),
    (Method("m", published={"cost": "f"}),),
    (Column("cost", "F"),),
    source="A paper",
    published="paper_table1",
    key="set",
    claims=(
        Claim("F is at most 1", within("cost", "m", 0.0, 1.0), "p. 1", each=True),
        Claim("F is at least 9", within("cost", "m", 9.0, 10.0), "p. 2", remark="It is not"),
    ),
    remarks={"b": "another b"},
)
"""
FIGURE = """\
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Figure

FIGURE = Figure(
    *("paper_figure1", "A bar", "nobody", None, None, ""),
    claims=(Claim("It is high", lambda record: record["height"] > 1),),
)
"""
BIB = "@book{paper,\n  title = {A paper}\n}\n\n@book{other,\n  title = {x @ y}\n}\n"
ORIGIN = {"engine": "superlu", "date": "2026-01-02T03:04Z"}


@pytest.fixture
def results(tmp_path, monkeypatch):
    root = tmp_path / "checkout"
    for name in ("baselines", *(f"reports/{k}" for k in ("tables", "figures", "published"))):
        (root / name).mkdir(parents=True)
    (root / "reports/tables/paper_table1.py").write_text(TABLE)
    (root / "reports/figures/paper_figure1.py").write_text(FIGURE)
    (root / "reports/published/paper_table1.csv").write_text("set,f\none,1.0\ntwo,2.0\n")
    (root / "reports/published/sources.bib").write_text(BIB)
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(root))
    for cached in (published, citations.entries):
        cached.cache_clear()
    folder = tmp_path / "results"
    folder.mkdir()
    lines = [to_line(record("a", 7.0)), to_line(record("b", 2.5)), to_line(record("a", 1.0))]
    (folder / "paper_table1.jsonl").write_text("\n".join(lines) + "\n")
    made = {"data": {"height": 2}, "provenance": {**ORIGIN, "date": "2026-01-01T00:00Z"}}
    (folder / "paper_figure1.json").write_text(json.dumps(made))
    (folder / "paper_figure1.svg").write_text("<svg/>")
    yield folder
    for cached in (published, citations.entries):
        cached.cache_clear()


def record(row, cost):
    made = {"key": row, "metrics": {"cost": cost}, "provenance": ORIGIN}
    return Record("paper_table1", row, "m", **made)


def test_the_index_says_first_what_was_reproduced(results):
    text = dict(publication.report_files(gather(results)))["index.md"].decode()
    assert text.split("\n")[2] == (
        "**Of 2 values that the papers print of their own methods and that were run, 1 are "
        "reproduced (50 %), 0 better, 1 different (0 explained, 1 unexplained). Of 3 claims "
        "tried, 1 hold and 2 differ. Not run: 0 printed values and 0 claims.**"
    )
    for line in (
        "| [paper_table1](paper_table1.md) | 2 | 1 | 0 | 0 | 0 | 1 | 0 |",
        "| all of the two papers, of their own methods | 2 | 1 | 0 | 0 | 0 | 1 | 0 |",
        "| all of the two papers, of other programs | 0 | 0 | 0 | 0 | 0 | 0 | 0 |",
        "| all of other sources | 0 | 0 | 0 | 0 | 0 | 0 | 0 |",
        "| paper_table1 | 1 | another b |",
        "| paper_table1 | F is at most 1 | p. 1 | differs: holds in 1 of 2 rows |",
        "| paper_table1 | F is at least 9 | p. 2 | differs. It is not |",
        "| paper_figure1 | It is high |  | holds |",
        "| paper_figure1 | A bar | [SVG](paper_figure1.svg) | "
        "`paper` in [sources.bib](sources.bib) |",
        "- engine: superlu",
        "- date: 2026-01-01T00:00Z to 2026-01-02T03:04Z",
    ):
        assert line in text.split("\n"), line


def test_every_link_of_the_index_leads_somewhere(results):
    files = dict(publication.report_files(gather(results)))
    targets = {part.partition(")")[0] for part in files["index.md"].decode().split("](")[1:]}
    unlinked = {name for name in files if name.endswith((".csv", ".tex"))}  # not committed
    assert unlinked
    assert targets == set(files) - {"index.md"} - unlinked


def test_the_same_results_give_the_same_bytes(results, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second, second):
        publication.write_report(gather(results), folder)
    names = sorted(path.name for path in first.iterdir())
    assert names == sorted(path.name for path in second.iterdir())
    assert all((first / name).read_bytes() == (second / name).read_bytes() for name in names)


def test_a_table_offers_its_citation(results):
    files = dict(publication.report_files(gather(results)))
    assert b"```bibtex\n@book{paper,\n  title = {A paper}\n}\n```" in files["paper_table1.md"]
    assert rb"A small table~\cite{paper}" in files["paper_table1.tex"]
    assert files["sources.bib"].decode() == BIB
    assert citation("other_figure2") == "@book{other,\n  title = {x @ y}\n}"
    assert citation("speed") == ""


def test_the_last_record_of_a_kind_counts(results):
    [table] = gather(results).tables
    assert [(r.row, r.metrics["cost"]) for r in table.records] == [("a", 1.0), ("b", 2.5)]


def test_what_was_not_run_is_counted_and_said(results):
    (results / "paper_table1.jsonl").unlink()
    files = dict(publication.report_files(gather(results)))
    text = files["index.md"].decode()
    assert "Of 1 claim tried, 1 hold and 0 differ. Not run: 2 printed values and 2" in text
    assert "| paper_table1 | 2 | no record |" in text
    assert "| paper_table1 | A small table | not run |" in text
    assert "paper_table1.md" not in files


def test_what_differs_and_was_never_looked_into_is_said(results):
    path = registry.repository() / "reports/tables/paper_table1.py"
    path.write_text(TABLE.replace("another b", ""))
    text = dict(publication.report_files(gather(results)))["index.md"].decode()
    assert "1 different (0 explained, 1 unexplained). Of" in text
    assert "| paper_table1 | 1 | nothing was tried |" in text


def test_what_is_explained_names_the_page_that_shows_it(results):
    path = registry.repository() / "reports/tables/paper_table1.py"
    explained = TABLE.replace('remarks={"b": "another b"}', 'explained={"b": Cause("b", "p")}')
    path.write_text(explained)
    text = dict(publication.report_files(gather(results)))["index.md"].decode()
    assert "1 different (1 explained, 0 unexplained). Of" in text
    assert "| paper_table1 | 1 | b (shown in p) |" in text


def test_the_command_writes_the_report(results, tmp_path, certpgo):
    done = certpgo("report", "--results", results, "--out", tmp_path / "out")
    assert done.code == 0
    assert done.out.startswith(
        "Of 2 values that the papers print of their own methods and that were run, 1 are reproduced"
    )
    names = {path.name for path in (tmp_path / "out").iterdir()}
    tables = {f"paper_table1.{suffix}" for suffix in ("md", "csv", "tex")}
    assert names == tables | {"index.md", "paper_figure1.svg", "sources.bib"}


def test_no_results_are_one_clear_line(results, tmp_path, certpgo):
    done = certpgo("report", "--results", tmp_path / "nothing")
    assert (done.code, done.err.count("\n")) == (1, 1)
    assert "no such folder" in done.err
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no results"):
        gather(tmp_path / "empty")


@pytest.mark.parametrize("text", ["{", "[]", '{"data": 1}'])
def test_a_spoilt_figure_is_named(results, text):
    (results / "paper_figure1.json").write_text(text)
    with pytest.raises(FormatError, match=r"paper_figure1\.json"):
        gather(results)


def test_the_report_as_one_page(certpgo, tmp_path):
    page = tmp_path / "page.html"
    assert certpgo("report", "--out", tmp_path / "out", "--html", page).code == 0
    text = page.read_text(encoding="utf-8")
    assert "Moreira 2020, Table 5.7" in text
    assert "<svg" in text
    assert "data:text/csv" in text

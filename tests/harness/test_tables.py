"""Every table of the checkout validates, builds its methods and runs its quick profile."""

import re
from functools import partial

import pytest

from certpgo import registry
from certpgo.errors import InputError
from certpgo.linalg.factor import engines
from certpgo.registry import build
from reports.harness.experiments import claim_outcomes, reference, scan
from reports.harness.experiments.figure import Figure
from reports.harness.experiments.journal import from_line, latest, read_entries, to_line
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import run_table, run_trial
from reports.harness.experiments.spec import FACTORIZATION
from reports.harness.experiments.timing import paired
from reports.harness.experiments.trials import chosen_rows, trials_of
from reports.harness.rendering import cells
from reports.harness.rendering.citations import citation
from reports.harness.rendering.formats import forms
from reports.harness.rendering.published import printed_number, published
from reports.harness.rendering.render import sections, table_markdown

NAMES = scan.table_names()
#: Methods that take too long for a test, by table.
SLOW = {
    "eriksson2018_table1": {"interior points on (D), Clarabel"},
    "moreira2020_table5_4": {"low rank and sparse", "l1 augmented Lagrangian"},
    "moreira2020_table5_7_ratios": {"EIG-SE(3)", "chordal (ours)"},
    "robust_pose_graphs": {
        "graduated non-convexity, from the certified optimum",
        "certified optimum, not robust",
    },
}
RESULTS = registry.repository() / "reports" / "results"
#: Printed columns that say what a line is of, besides its key.
DESCRIPTIVE = {"abbreviation", "n", "vertices", "edges", "poses", "sigma_t"}


@pytest.fixture(params=NAMES, scope="module")
def table(request):
    return scan.get_table(request.param)


@pytest.fixture(scope="module")
def records(table):
    """What the table's quick profile gives, but for slow methods."""
    methods = {method.label for method in table.methods} - SLOW.get(table.name, set())
    try:
        trials = list(trials_of(table, data=None, quick=True))
    except InputError as error:
        pytest.skip(str(error))
    with pytest.MonkeyPatch.context() as patched:  # times are in the committed records
        patched.setattr(reference, "paired", partial(paired, rounds=1))
        return [record for trial in trials for record in run_trial(trial, methods=methods)]


def test_a_table_is_called_as_its_file(table):
    assert table.name in NAMES


def test_columns_are_told_apart_by_their_titles(table):
    titles = ["method", *(column.title for column in table.columns)]
    assert len(set(titles)) == len(titles)


def test_methods_and_their_settings_exist(table):
    for method in (*table.methods, *filter(None, [table.reference])):
        while method is not None:
            if method.solver not in ("", FACTORIZATION):
                build(method.solver, method.settings)
            method = method.start
    for row in table.rows + table.stand_ins:
        for label, settings in row.settings.items():
            [method] = [m for m in table.methods if m.label == label]
            build(method.solver, {**method.settings, **settings})


def test_published_keys_and_columns_exist(table):
    if not table.published:
        assert not any(row.published for row in table.rows)
        return
    lines = published(table.published, table.key)
    printed = [row for row in table.rows if row.published]
    assert printed
    for row in printed:
        assert any(key == row.published or key.startswith(f"{row.published}/") for key in lines)
        for method in filter(row.runs, table.methods):
            for metric in method.published:
                assert printed_number(table, row, method, metric)


def test_every_printed_column_is_a_value_a_time_or_says_what_a_line_is(table):
    if not table.published:
        return
    lines = published(table.published, table.key)
    columns = set().union(*lines.values())
    known = {*cells.value_columns(table), *table.key.split(","), *DESCRIPTIVE}
    assert all(name.endswith(("_time_s", "_ratio")) for name in columns - known)
    # but for lines that hold none, each line has its values counted
    printed = cells.cells(table, ())
    assert len(printed) == sum(
        bool(line[name]) for line in lines.values() for name in cells.value_columns(table)
    )


def test_explanations_are_of_something(table):
    rows = [row.label for row in table.rows + table.stand_ins]
    methods = [method.label for method in table.methods]
    both = {f"{row}/{method}" for row in rows for method in methods}
    lines = published(table.published, table.key) if table.published else {}
    of_lines = {*lines, *(part for key in lines for part in key.split("/"))}
    assert set(table.explained) <= both | {*rows, *methods}
    assert set(table.remarks) <= both | {*rows, *methods} | of_lines
    assert all((RESULTS / f"{cause.shown}.md").is_file() for cause in table.explained.values())


def committed(table):
    path = RESULTS / f"{table.name}.jsonl"
    if not path.is_file():
        pytest.skip(f"no results of {table.name} here")
    return latest(read_entries(path, Record))


def test_of_every_committed_value_that_differs_the_cause_is_known_or_what_was_tried(table):
    found = cells.cells(table, committed(table))
    assert [cell for cell in found if cell.found.differs and not cell.reason] == []


def test_committed_results_name_engines_that_exist(table):
    named = {record.provenance.get("engine") for record in committed(table)} - {None}
    assert named <= set(engines())


def test_every_committed_claim_that_differs_is_remarked_upon(table):
    outcomes = claim_outcomes.of_table(table, committed(table))
    differing = [o for o in outcomes if o.found is claim_outcomes.ClaimStatus.DIFFERS]
    assert [o.claim.text for o in differing if not o.claim.remark] == []


def test_rows_of_committed_latex_have_one_cell_a_column(table):
    text = forms()["tex"].render(table, committed(table))
    kinds = re.search(r"@\{\}(\w+)@\{\}", text)[1]
    rows = [line for line in text.split("\n") if line.endswith(" \\\\")]
    assert rows
    assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(kinds) - 1}
    bare = re.sub(r"\\[{}]", "", text)
    assert bare.count("{") == bare.count("}")
    assert bare.count("$") % 2 == 0


def test_claims_can_be_asked_of_any_records(table, records):
    for found in (claim_outcomes.of_table(table, records), claim_outcomes.of_table(table, ())):
        assert len(found) == len(table.claims)
    assert {outcome.found for outcome in found} <= {claim_outcomes.ClaimStatus.NOT_RUN}
    assert all(claim.source for claim in table.claims)


def test_a_paper_s_table_or_figure_can_be_cited():
    for name in (*NAMES, *scan.figure_names()):
        spec = scan.get_experiment(name)
        printed = "" if isinstance(spec, Figure) else spec.published
        assert bool(citation(printed or name)) == ("20" in (printed or name)), name


def test_quick_profile_runs_and_renders(table, records):
    rows = chosen_rows(table, data=None, quick=True)
    assert len({(record.row, record.method) for record in records}) == len(records)
    methods = {method.label for method in table.methods}
    assert {record.method for record in records} <= methods
    assert {record.row for record in records} == {row.label for row in rows}
    for record in records:
        assert bool(record.absence) != bool(record.metrics), record
    text = table_markdown(table, records)
    for section in sections(table, records):
        assert section.title in text
        assert all(len(row) == len(section.header) for row in section.rows)


def test_rendering_is_a_function_of_the_records_alone(table, records):
    again = [from_line(to_line(record), Record) for record in records]
    for form in forms().values():
        assert form.render(table, again) == form.render(table, records)


def test_moreira_table_5_6_agrees_with_its_printed_eigenvalues(dataset_path):
    dataset_path("parking-garage")
    table = scan.get_table("moreira2020_table5_6")
    text = table_markdown(table, list(run_table(table, quick=True)))
    assert text.count(" agrees") == 4
    assert " differs" not in text


def test_moreira_table_5_7_agrees_with_its_printed_likelihoods(dataset_path):
    dataset_path("parking-garage")
    table = scan.get_table("moreira2020_table5_7")
    [eigen_ma, *_] = run_table(table, quick=True)
    assert f"{eigen_ma.metrics['f_ml']:.1f}" == "18824.3"
    assert "f_ML 18824.3 agrees; s 1.0 agrees" in table_markdown(table, [eigen_ma])

"""Every table of the checkout validates, builds its methods and runs its quick profile."""

import pytest

from certpgo import registry
from certpgo.errors import InputError
from certpgo.harness.methods import build
from certpgo.harness.published import printed_number, published
from certpgo.harness.records import from_line, to_line
from certpgo.harness.render import markdown, sections
from certpgo.harness.runner import chosen_rows, run
from certpgo.harness.spec import FACTORIZATION

NAMES = registry.table_names()


@pytest.fixture(params=NAMES, scope="module")
def table(request):
    return registry.get_table(request.param)


@pytest.fixture(scope="module")
def records(table):
    """What the table's quick profile gives."""
    try:
        return list(run(table, quick=True))
    except InputError as error:
        pytest.skip(str(error))


def test_a_table_is_called_as_its_file(table):
    assert table.name in NAMES


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


def test_quick_profile_runs_and_renders(table, records):
    rows = chosen_rows(table, data=None, quick=True)
    assert len({(record.row, record.method) for record in records}) == len(records)
    methods = {method.label for method in table.methods}
    assert {record.method for record in records} <= methods
    assert {record.row for record in records} == {row.label for row in rows}
    for record in records:
        assert bool(record.error) != bool(record.metrics), record
    text = markdown(table, records)
    for section in sections(table, records):
        assert section.title in text
        assert all(len(row) == len(section.header) for row in section.rows)


def test_rendering_is_a_function_of_the_records_alone(table, records):
    again = [from_line(to_line(record)) for record in records]
    assert markdown(table, again) == markdown(table, records)


def test_moreira_table_5_6_agrees_with_its_printed_eigenvalues(dataset_path):
    dataset_path("parking-garage")
    table = registry.get_table("moreira2020_table5_6")
    text = markdown(table, list(run(table, quick=True)))
    assert text.count(" agrees") == 4
    assert " differs" not in text


def test_moreira_table_5_7_agrees_with_its_printed_likelihoods(dataset_path):
    dataset_path("parking-garage")
    table = registry.get_table("moreira2020_table5_7")
    [eigen_ma, *_] = run(table, quick=True)
    assert f"{eigen_ma.metrics['f_ml']:.1f}" == "18824.3"
    assert "f_ML 18824.3 agrees; s 1.0 agrees" in markdown(table, [eigen_ma])

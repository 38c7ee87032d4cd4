"""What there is to do, and under which key."""

import pickle
from dataclasses import replace

import pytest
from repeated import numbers

from reports.harness.experiments import scan
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.plan import in_order, keys, run_task, table_tasks
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.experiments.trials import trials_of

CYCLE = Row(generator="cycle", arguments={"n": 5, "sigma": 0.1})
RA, TREE = Method("eigen_ra"), Method("spanning_tree")
TABLE = Table("t", "title", (CYCLE,), (RA, TREE), (Column("cost", "F"),), seeds=2)


def found(records):
    by_key = {}
    for record in records:
        by_key.setdefault(record.key, []).append(record)
    return lambda key: by_key.get(key, ())


def key(table=TABLE, *, method=0, repetition=0, quick=False):
    trial = list(trials_of(table, data=None, quick=quick, seeds=2))[repetition]
    return trial.key(table.methods[method])


def test_a_key_is_sixteen_hexadecimal_digits_and_the_same_tomorrow():
    assert key() == "3388934b9c77efc1"


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "u"},
        {"seed": 1},
        {"rows": (replace(CYCLE, label="other"),)},
        {"rows": (replace(CYCLE, arguments={"n": 5, "sigma": 0.2}),)},
        {"rows": (replace(CYCLE, settings={"eigen_ra": {"x": 1}}),)},
        {"methods": (Method("eigen_ra", settings={"x": 1}), TREE)},
        {"methods": (Method("eigen_ra", start=TREE), TREE)},
        {"methods": (Method("eigen_ra", engine="superlu"), TREE)},
        {"columns": (Column("cost", "F"), Column("gap", "gap"))},
        {"certify": False},
        {"reference": TREE},
    ],
)
def test_a_key_tells_what_was_asked_for(changed):
    assert key(replace(TABLE, **changed)) != key()


@pytest.mark.parametrize(
    "changed",
    [
        {"title": "another"},
        {"notes": ("A note.",)},
        {"columns": (Column("cost", "cost", ".3f"),)},
        {"columns": (Column("cost", "F"), Column("seconds", "s"))},
        {"methods": (RA, Method("newton"))},
        {"rows": (replace(CYCLE, published="p"),)},
        {"rows": (replace(CYCLE, settings={"spanning_tree": {"x": 1}}),)},
        {"seeds": 7},
    ],
)
def test_a_key_does_not_tell_how_it_is_shown_or_what_others_do(changed):
    assert key(replace(TABLE, **changed)) == key()


def test_keys_of_methods_repetitions_and_profiles_differ():
    made = {
        key(method=m, repetition=r, quick=q) for m in (0, 1) for r in (0, 1) for q in (False, True)
    }
    assert len(made) == 8


def test_of_the_graph_itself_the_metrics_it_is_asked_for_make_the_key():
    columns = (Column("lambda1", "l"), Column("cost", "F"))
    table = replace(TABLE, methods=(Method(published={"lambda1": "x"}), RA), columns=columns)
    assert key(table) == key(replace(table, columns=columns[:1]))
    assert key(table, method=1) != key(replace(table, columns=columns[:1]), method=1)


def test_the_answer_that_others_are_compared_with_makes_their_keys():
    table = replace(TABLE, columns=(Column("apart_deg", "apart"),))
    other = replace(table, methods=(Method("newton"), TREE))
    assert key(table, method=1) != key(other, method=1)


def test_a_task_a_row_and_repetition_with_the_methods_that_lack_a_record():
    first, second = table_tasks(TABLE, found([]))
    assert [first.methods, second.methods] == [("eigen_ra", "spanning_tree")] * 2
    records = run_task(first)
    [left] = table_tasks(TABLE, found(records))
    assert (left.trial.repetition, left.methods) == (1, ("eigen_ra", "spanning_tree"))
    assert [t.methods for t in table_tasks(TABLE, found(records[:1]))] == [
        ("spanning_tree",),
        ("eigen_ra", "spanning_tree"),
    ]


def test_tasks_give_the_records_of_a_run_in_any_order_and_after_a_journey():
    whole = numbers(run_table(TABLE))
    tasks = [pickle.loads(pickle.dumps(task)) for task in table_tasks(TABLE, found([]))]
    made = [record for task in reversed(tasks) for record in run_task(task)]
    assert numbers(in_order(keys(TABLE), found(made))) == whole
    assert {record.provenance["threads"] for record in made} == {"1"}


@pytest.mark.parametrize("name", scan.table_names())
def test_tasks_of_every_table_travel_and_keep_their_keys(name):
    table = scan.get_table(name)
    if table.optional:
        table = replace(table, optional=False)
    tasks = table_tasks(table, found([]), seeds=1)
    known = set(keys(table, seeds=1))
    for task in tasks:
        there = pickle.loads(pickle.dumps(task))
        assert there == task
        for method in there.trial.table.methods:
            assert there.trial.key(method) in known


@pytest.mark.parametrize("name", scan.table_names())
def test_a_quick_instance_is_the_full_run_s(name):
    table = replace(scan.get_table(name), optional=False)
    full, quick = (
        {
            (trial.row.label, trial.repetition): trial.seed and trial.seed.spawn_key
            for trial in trials_of(table, data=None, seeds=1, quick=is_quick)
        }
        for is_quick in (False, True)
    )
    assert quick.items() <= full.items()


def test_each_table_has_a_key_of_its_own_for_each_record():
    made = [
        key
        for name in scan.table_names()
        for key in keys(replace(scan.get_table(name), optional=False))
    ]
    assert len(set(made)) == len(made)


def test_a_graph_that_was_not_here_is_tried_again_when_it_is(tmp_path):
    path = tmp_path / "late.g2o"
    table = replace(TABLE, rows=(Row(dataset=str(path)),), methods=(Method("eigen_ma"),))
    records = list(run_table(table))
    assert "late.g2o" in records[0].error
    assert table_tasks(table, found(records)) == ()
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    assert len(table_tasks(table, found(records))) == 1


def test_a_package_that_was_missing_is_tried_again():
    [record, _] = [
        replace(r, absence=Absence.MISSING_PACKAGE, error="pip install x") for r in run_table(TABLE)
    ][:2]
    assert table_tasks(TABLE, found([record]), seeds=1)[0].methods == ("eigen_ra", "spanning_tree")


def test_methods_for_other_graphs_are_not_planned_once_the_graph_is_known():
    table = replace(TABLE, methods=(RA, Method("eigen_ma", takes="poses")), seeds=1)
    [task] = table_tasks(table, found([]))
    assert task.methods == ("eigen_ra", "eigen_ma")
    records = run_task(task)
    assert [record.method for record in records] == ["eigen_ra"]
    assert table_tasks(table, found(records)) == ()


def test_each_component_needs_its_record(tmp_path):
    path = tmp_path / "two.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in (0, 1, 5)]
    path.write_text("\n".join(lines) + "\n")
    row = Row(dataset=str(path), components="each")
    table = replace(TABLE, rows=(row,), methods=(Method("eigen_ma"),))
    records = list(run_table(table))
    assert [record.parts for record in records] == [2, 2]
    assert table_tasks(table, found(records)) == ()
    assert len(table_tasks(table, found(records[:1]))) == 1


def test_what_others_are_compared_with_is_solved_again():
    table = replace(TABLE, columns=(Column("apart_deg", "apart"),), certify=False, seeds=1)
    first, second = run_table(table)
    assert second.metrics["apart_deg"] > 0.0
    [task] = table_tasks(table, found([first]))
    assert task.methods == ("spanning_tree",)
    assert numbers(run_task(task)) == numbers([second])

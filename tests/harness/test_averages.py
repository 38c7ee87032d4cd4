"""Means over the instances of a row, and metrics that compare with the optimum."""

import numpy as np
import pytest

from certpgo import certify
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from reports.harness.experiments import evaluate
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.averages import summarized
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.rendering.published import _lines
from reports.harness.rendering.render import sections

ROW = Row(generator="orbital", label="a", arguments={"n": 9, "sigma": 0.2})


def table(*methods, **more):
    columns = (Column("error", "error"), Column("global_percent", "%"), Column("verdict", "v"))
    return Table("t", "A title", (ROW,), methods, columns, **more)


def record(method="m", **more):
    return Record("t", "a", method, d=3, n=4, m=5, **more)


def test_numbers_are_means_and_texts_are_counted():
    first = record(metrics={"cost": 1.0}, verdict="CERTIFIED", seconds={"x": 1.0}, iterations=3)
    second = record(metrics={"cost": 3.0}, verdict="REFUTED", seconds={"x": 2.0}, iterations=6)
    third = record(absence=Absence.TOO_LARGE, error="above 8 nodes")
    [mean] = summarized([first, second, third], "mean")
    assert mean.metrics == {"cost": 2.0}
    assert mean.seconds == {"x": 1.5}
    assert mean.verdict == "CERTIFIED (1); REFUTED (1)"
    assert mean.iterations == 4
    assert mean.why_missing == "1 of 3: not run: above 8 nodes"


def test_medians_come_with_quartiles():
    records = [record(metrics={"cost": value}) for value in (5.0, 1.0, 2.0, 9.0, 3.0)]
    [median] = summarized(records, "median")
    assert median.metrics == {"cost": 3.0, "cost.lower": 2.0, "cost.upper": 5.0}


def test_bounds_are_counted_one_by_one():
    both, one = record(certified_by="rows, factorization"), record(certified_by="factorization")
    [mean] = summarized([both, one], "mean")
    assert mean.certified_by == "rows (1), factorization"


def test_methods_stay_apart_and_one_record_stays_as_it_is():
    first, second = record(note="x"), record("other")
    assert summarized([first, second], "mean") == [first, second]


def test_an_averaged_table_has_one_section_a_row():
    spec = table(Method("cycle_closed_form"), summary="mean")
    records = list(run_table(spec, seeds=3))
    [section] = sections(spec, records)
    assert section.title == "a (9 nodes, 9 edges, 3D), mean of 3 instances"
    assert len(section.rows) == 1
    assert len(sections(table(Method("cycle_closed_form")), records)) == 3


def test_errors_are_against_the_certified_optimum():
    spec = table(Method("cycle_closed_form"), Method("spanning_tree"))
    exact, tree = run_table(spec)
    assert abs(exact.metrics["error"]) < 1e-13
    assert exact.metrics["global_percent"] == 100.0
    assert tree.metrics["error"] > 1e-3
    assert tree.metrics["global_percent"] == 0.0
    assert exact.certified_by.endswith("cycle sum, factorization")


def test_a_method_may_be_for_small_graphs_alone_and_a_row_for_nobody():
    [small] = run_table(table(Method("newton", max_nodes=8)))
    assert small.why_missing == "not run: above 8 nodes"
    absent = Table(
        "t",
        "A title",
        (Row("Gustavus", absent="the edge set is not public"),),
        (Method("newton"),),
        (Column("error", "error"),),
    )
    [record] = run_table(absent)
    assert record.why_missing == "not run: the edge set is not public"


def test_which_bounds_hold_at_a_wound_up_cycle():
    instance, wound = synthetic.winding_cycle(12, 0.7, -1)
    problem = Quadratic(instance.graph)
    assert evaluate.certified_by(problem, certify(problem, wound)) == "none"
    assert evaluate.optimum(problem) == pytest.approx(96 * np.sin(0.7 / 24) ** 2, rel=1e-12)


def test_published_lines_may_have_keys_of_several_columns(tmp_path):
    path = tmp_path / "printed.csv"
    path.write_text("n,sigma,error\n20,0.2,1.5\n20,0.5,0.6\n")
    assert _lines(path, "n,sigma")["20/0.5"]["error"] == "0.6"

"""Growth: families solved in processes of their own, slopes, and runs that go on."""

import math
from dataclasses import replace

import numpy as np
import pytest

from certpgo.errors import FormatError, SpecError
from reports.harness.experiments.records import Ledger, Record
from reports.harness.scaling import scale


@pytest.mark.parametrize("name", scale.FAMILIES)
def test_every_family_is_certified(name):
    record = scale.measured(name, scale.family(name).quick[0], seed=0)
    assert record.error == ""
    assert record.verdict == "CERTIFIED"
    assert record.metrics["cost"] > 0.0
    assert record.metrics["memory_gb"] > 0.01
    assert record.counts["factorizations"] >= 1


def test_a_process_of_its_own_counts_the_same_work():
    here, there = scale.measured("grid", 4, 0), scale.measure("grid", 4, 0)
    assert there.counts == here.counts
    assert there.metrics["cost"] == pytest.approx(here.metrics["cost"], rel=1e-9)


def test_slope_of_a_power_law():
    records = [
        Record("t", f"r{n}", "m", n=n, metrics={"median_seconds": 3.0 * n**1.3})
        for n in (10, 100, 500)
    ]
    assert scale.slope(records) == pytest.approx(1.3)
    assert math.isnan(scale.slope(records[:1]))
    assert math.isnan(scale.slope([]))


def test_an_unknown_family_names_the_nearest():
    with pytest.raises(SpecError, match="did you mean helix"):
        scale.measure("helx", 3)


def test_a_ledger_goes_on_where_it_was_cut_off(tmp_path):
    ledger = Ledger(tmp_path / "new", "scale_x")
    first = Record("scale_x", "x 3", "certified", seed=0, n=9)
    ledger.add(first)
    ledger.add(replace(first, row="x 4", error="no memory"))
    with ledger.path.open("a") as stream:
        stream.write('{"table": "scale_x", "row"')  # killed while writing
    again = Ledger(tmp_path / "new", "scale_x")
    assert again.find("x 3", 0, "") == first
    assert again.find("x 3", 1, "") is None
    assert again.find("x 4", 0, "") is None  # what failed is done again
    assert again.find("x 3", 0, "superlu") is None
    again.add(replace(first, row="x 4"))
    assert Ledger(tmp_path / "new", "scale_x").find("x 4", 0, "").n == 9


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "scale_x.jsonl").write_text("not a record\nat all\n")
    with pytest.raises(FormatError):
        Ledger(tmp_path, "scale_x")


def test_the_uneven_helix_has_long_steps():
    rng = np.random.default_rng(0)
    graph = scale.family("uneven_helix").build(10, rng).graph
    steps = np.linalg.norm(graph.translations, axis=1)
    assert steps[: graph.num_nodes - 1].max() > 2.0

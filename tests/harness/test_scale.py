"""Growth: families solved in processes of their own, slopes, and runs that go on."""

import math
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest

from certpgo.errors import FormatError, SpecError
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.journal import Journal
from reports.harness.experiments.records import Record
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


def test_slopes_of_phases_that_all_graphs_have():
    records = [
        Record("t", f"r{n}", "m", n=n, seconds={"start": 2.0 * n, "newton": n**1.5} | extra)
        for n, extra in ((10, {"certify": 1.0}), (100, {}), (500, {}))
    ]
    assert scale.phase_slopes(records) == pytest.approx({"start": 1.0, "newton": 1.5})
    assert scale.phase_slopes([]) == {}


def test_an_unknown_family_names_the_nearest():
    with pytest.raises(SpecError, match="did you mean helix"):
        scale.measure("helx", 3)


def test_a_key_is_of_family_size_seed_and_engine(monkeypatch):
    keys = [scale.graph_key("grid", 4, 0), scale.graph_key("grid", 5, 0)]
    keys += [scale.graph_key("grid", 4, 1), scale.graph_key("helix", 4, 0)]
    monkeypatch.setattr(scale, "default_engine", lambda: "another")
    assert len({*keys, scale.graph_key("grid", 4, 0)}) == 5


def test_a_file_of_something_else_is_refused(tmp_path):
    (tmp_path / "scale_x.jsonl").write_text("not a record\nat all\n")
    with pytest.raises(FormatError):
        Journal(tmp_path, "scale_x", Record)


def test_a_process_that_was_killed_is_a_record(monkeypatch):
    def submit(*_):
        raise BrokenProcessPool

    monkeypatch.setattr(scale.ProcessPoolExecutor, "submit", submit)
    record = scale.measure("grid", 4)
    assert (record.absence, record.n) == (Absence.PROCESS_DIED, None)


def test_the_uneven_helix_has_long_steps():
    rng = np.random.default_rng(0)
    graph = scale.family("uneven_helix").build(10, rng).graph
    steps = np.linalg.norm(graph.translations, axis=1)
    assert steps[: graph.num_nodes - 1].max() > 2.0

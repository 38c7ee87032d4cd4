import sys

import numpy as np
import pytest

from certpgo import registry
from certpgo.errors import InputError, SpecError, how_to_install
from certpgo.graph.trees import compose, spanning_tree
from certpgo.io.datasets.synthetic import cycle
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Iteration
from certpgo.optimize.solution import Solution, Status
from certpgo.registry import parse_settings
from certpgo.solve.comparison import solution_of
from reports.harness.experiments.absence import Absence
from reports.harness.experiments.instances import load_row, seed_of
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.spec import Column, Method, Row, Table

CYCLE = Row(generator="cycle", arguments={"n": 5, "sigma": 0.1})
POSES = Row(generator="grid3d", arguments={"side": 2})
RA = Method("eigen_ra")


def table(rows, methods, **more):
    return Table("t", "title", rows, methods, (Column("cost", "F"),), **more)


def test_an_instance_is_solved_judged_and_recorded():
    [record] = run_table(table((CYCLE,), (Method("newton", "ours", start=RA),)))
    assert (record.n, record.m, record.d, record.seed) == (5, 5, 3, 0)
    assert record.verdict == "CERTIFIED"
    assert record.metrics["lower_bound"] <= record.metrics["cost"] + 1e-12
    assert set(record.seconds) == {"eigen_ra", "newton"}
    assert record.error == ""


def test_a_method_that_times_nothing_is_timed_as_a_whole(monkeypatch):
    def untimed(self, problem, *, initial=None, monitor=None):
        answer = problem.complete(initial.rotations)
        told = (Iteration(0, 1.0, 0.0, 0.0, 0.5),)
        return Solution(answer, 1.0, Status.CONVERGED, trace=told)

    def start(self, problem, *, initial=None, monitor=None):
        tree = compose(problem.graph, spanning_tree(problem.graph))
        return Solution(tree, 2.0, Status.CLOSED_FORM, seconds={"tree": 0.25})

    monkeypatch.setattr(registry.get_solver("newton"), "solve", untimed)
    monkeypatch.setattr(registry.get_solver("spanning_tree"), "solve", start)
    problem = Quadratic(cycle(5, 0.1, np.random.default_rng(0)).graph)
    alone = solution_of(Method("spanning_tree"), problem)
    assert alone.seconds == {"tree": 0.25}
    both = solution_of(Method("newton", start=Method("spanning_tree")), problem)
    assert both.seconds["spanning_tree"] == 0.25
    assert both.seconds["solve"] > 0.0
    assert both.trace[0].seconds == 0.75


def test_a_method_runs_with_its_engine_and_leaves_the_environment_alone(monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", "nowhere")
    [record] = run_table(table((CYCLE,), (Method("eigen_ra", engine="superlu"),)))
    assert (record.error, record.provenance["engine"]) == ("", "superlu")
    [other] = run_table(table((CYCLE,), (RA,)))
    assert "nowhere" in other.error


def test_seeds_are_distinct_and_repeatable():
    twice = [list(run_table(table((CYCLE,), (RA,)), seeds=3)) for _ in range(2)]
    costs = [[record.metrics["cost"] for record in records] for records in twice]
    assert costs[0] == costs[1]
    assert len(set(costs[0])) == 3
    assert [record.seed for record in twice[0]] == [0, 1, 2]


def test_seeds_come_from_the_table_the_row_and_the_repetition():
    words = {
        tuple(seed_of(*key).generate_state(2))
        for key in [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    }
    assert len(words) == 4


@pytest.mark.parametrize(
    ("row", "method", "reason"),
    [
        (Row("no-such-file.g2o"), RA, "no-such-file.g2o"),
        (Row("rim"), RA, "not run: file not here"),
        (Row(generator="cyle"), RA, "did you mean cycle"),
        (CYCLE, Method("eigen_ma"), "eigen_ma takes pose graphs only"),
        (POSES, RA, "eigen_ra takes rotation graphs only"),
        (CYCLE, Method("eigen_ra", settings={"tolerance": 1}), "unknown setting of eigen_ra"),
        (CYCLE, Method("eigenra"), "did you mean eigen_ra"),
        (Row(generator="cycle", arguments={"n": 1, "sigma": 0.1}), RA, "3"),
    ],
)
def test_a_failure_is_a_record_with_its_reason_and_the_next_one_runs(
    row, method, reason, monkeypatch, tmp_path
):
    monkeypatch.setenv("CERTPGO_DATA", str(tmp_path))
    rows = (row, Row(label="good", generator="cycle", arguments={"n": 5, "sigma": 0.1}))
    bad, *_, good = run_table(table(rows, (method, Method("eigen_ra", "good"))))
    assert reason in bad.why_missing
    assert bad.metrics == {}
    assert good.error == ""


def test_a_family_that_reads_a_file_finds_it_in_the_data_folder(
    monkeypatch, tmp_path, dataset_path
):
    here = dataset_path("Ellis_Island.mat").parent
    row = Row(generator="viewing_graph", arguments={"name": "Ellis_Island.mat", "sigma": 0.0})
    monkeypatch.setenv("CERTPGO_DATA", str(tmp_path))
    monkeypatch.setattr("certpgo.io.datasets.lookup.cache_folder", lambda: tmp_path)
    assert load_row(row, here, None).graph.num_edges == 20297
    with pytest.raises(InputError, match="file not here"):
        load_row(row, None, None)


def test_gtsam_missing_is_a_record_with_the_install_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    [record] = run_table(table((POSES,), (Method("gtsam_chordal"),)))
    assert record.absence is Absence.MISSING_PACKAGE
    assert record.error == f"GTSAM is not installed: {how_to_install('baselines', 'gtsam')}"


def test_the_stand_ins_run_when_no_file_is_here(monkeypatch, tmp_path):
    monkeypatch.setenv("CERTPGO_DATA", str(tmp_path))
    spec = table((Row("rim"),), (RA,), stand_ins=(CYCLE,), optional=True)
    assert [record.row for record in run_table(spec)] == ["cycle"]


def test_an_optional_table_without_any_file_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setenv("CERTPGO_DATA", str(tmp_path))
    with pytest.raises(InputError, match=r"none of the files of table t is here: pip install"):
        list(run_table(table((Row("rim"),), (RA,), stand_ins=(Row("grid3D"),), optional=True)))


def test_settings_are_read_by_their_type():
    given = ["tolerance=1e-3", "max_iterations=7"]
    assert parse_settings("newton", given) == {"tolerance": 1e-3, "max_iterations": 7}
    assert parse_settings("eigen_ma", ["translations=thesis"]) == {"translations": "thesis"}
    for wrong, said in [
        ("tolerance", "key=value"),
        ("max_iterations=x", "an integer"),
        ("tol=1", "did you mean tolerance"),
    ]:
        with pytest.raises(SpecError, match=said):
            parse_settings("newton", [wrong])
    python = ["chordal=False", "force=TRUE", "tolerance=None"]
    assert parse_settings("sdp_dual", python) == {
        "chordal": False,
        "force": True,
        "tolerance": None,
    }
    with pytest.raises(
        SpecError, match="unknown setting of cycle_closed_form 'tol'; there are none"
    ):
        parse_settings("cycle_closed_form", ["tol=1"])

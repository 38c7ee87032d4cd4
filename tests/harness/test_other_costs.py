"""Tables and the zoo under the costs of other programs."""

import numpy as np
import pytest

from certpgo import registry
from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate
from certpgo.io import read
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.comparison import solution_of
from reports.harness.experiments import plan, scan
from reports.harness.experiments.journal import read_entries
from reports.harness.experiments.records import Record
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.spec import Column, Method, Row, Table
from reports.harness.rendering.render import table_markdown

COLUMNS = (Column("cost", "cost"), Column("over_bound", "cost / bound"))
OF_F, OF_GTSAM = Method("certified", "F's"), Method("certified", "GTSAM's", cost="gtsam")


def square(information):
    """A walk around a square in the plane that misses its start, every edge with this matrix."""
    lines = [f"EDGE_SE2 {k} {(k + 1) % 4} 1 0 {1.4 + 0.1 * k} {information}" for k in range(4)]
    return "\n".join(lines)


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "square.g2o"
    file.write_text(square("9 2 1 4 -1 30"), encoding="utf-8")
    return str(file)


def table(rows, methods, **more):
    return Table("t", "title", rows, methods, more.pop("columns", COLUMNS), **more)


def test_optima_of_two_costs_are_judged_by_both(path):
    rows = (Row(path, "by GTSAM", cost="gtsam"), Row(path, "by F"))
    records = list(run_table(table(rows, (OF_F, OF_GTSAM))))
    f_by_gtsam, own, f_by_f, gtsam_by_f = records
    assert [r.objective for r in records] == ["gtsam", "gtsam", "", ""]
    assert [r.verdict for r in records] == ["BOUNDED", "CERTIFIED", "CERTIFIED", "BOUNDED"]
    assert own.metrics["cost"] < f_by_gtsam.metrics["cost"]
    assert f_by_f.metrics["cost"] < gtsam_by_f.metrics["cost"]
    assert f_by_gtsam.metrics["over_bound"] == pytest.approx(
        f_by_gtsam.metrics["cost"] / own.metrics["cost"], rel=1e-5
    )
    text = table_markdown(table(rows, (OF_F, OF_GTSAM)), records)
    assert text.count("those of `--cost gtsam`") == 1


def test_a_cost_that_has_no_bound_is_refused_in_a_sentence(tmp_path):
    file = tmp_path / "flat.g2o"
    file.write_text(square("9 2 30 4 -1 30"), encoding="utf-8")
    [record] = run_table(table((Row(str(file), cost="g2o"),), (OF_F,)))
    assert record.absence == "failed"
    assert record.error.startswith("flat: 4 of 4 information matrices are not positive definite")


def test_only_methods_that_can_minimise_another_cost(path):
    instance = read(path)
    problem = Quadratic(instance.graph)
    with pytest.raises(SpecError, match="newton does not minimise the cost gtsam"):
        solution_of(Method("newton", cost="gtsam"), problem, instance)
    with pytest.raises(SpecError, match="unknown cost 'ceres'"):
        solution_of(Method("certified", cost="ceres"), problem, instance)
    with pytest.raises(SpecError, match="does not minimise"):
        solution_of(OF_GTSAM, problem)
    start = Method("newton", start=OF_GTSAM)
    assert solution_of(start, problem, instance).seconds["GTSAM's"] > 0.0


@pytest.mark.parametrize(
    "more", [{"reference": OF_F}, {"columns": (Column("error", "F - F*"),)}], ids=str
)
def test_times_and_optima_are_of_the_chordal_cost(more):
    with pytest.raises(SpecError, match="of the chordal cost"):
        table((Row("MIT", cost="g2o"),), (OF_F,), **more)


def test_records_of_the_chordal_cost_have_the_keys_that_they_had():
    kept = registry.repository() / "reports" / "results" / "quick" / "eriksson2018_table1.jsonl"
    if not kept.is_file():
        pytest.skip("no results here")
    keys = {record.key for record in read_entries(kept, Record)}
    assert {*plan.keys(scan.get_table("eriksson2018_table1"), quick=True)} == keys


class TestZoo:
    """The zoo under these costs."""

    @pytest.fixture(autouse=True)
    def _with_balls(self):
        pytest.importorskip("flint", reason="python-flint is not installed")

    @pytest.mark.parametrize("d", [2, 3])
    @pytest.mark.parametrize("cost", ["g2o", "gtsam"])
    def test_the_oracle_encloses_the_cost(self, cost, d):
        from reports.harness.certifiers import oracle, own_costs

        for noise in (0.0, 1e-3, 1.0):
            problem, true = own_costs._measured(cost, d, noise, np.random.default_rng(5))
            low, high = oracle.cost(problem, true)
            lower, upper = problem.enclosure(true)
            assert max(low, lower) <= min(high, upper)
            assert high - low <= 1e-12 * high + 1e-28

    def test_a_residual_of_zero(self):
        from reports.harness.certifiers import made, oracle, own_costs

        for cost in ("g2o", "gtsam"):
            ring = made.wound(3, 0.0, 1)
            problem = own_costs._problem(
                cost, ring.graph, np.zeros((3, 3)), np.tile(np.eye(6), (3, 1, 1))
            )
            still = Estimate(np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)))
            low, high = oracle.cost(problem, still)
            assert -1e-30 <= low <= high <= 1e-30

    def test_what_is_wrong_is_noticed_and_rules_about_f_refuse(self):
        from reports.harness.certifiers import own_costs
        from reports.harness.certifiers.opinions import Opinion, certifiers, tally_of

        rigged = {"certpgo rigged": lambda problem, point: Opinion(point)}
        asked = certifiers()
        best, wound = (next(c for c in own_costs.wound(True) if name in c.name) for name in NAMES)
        assert tally_of(wound, rigged).of("certpgo rigged")["false"] == 1
        assert tally_of(best, rigged).of("certpgo rigged")["false"] == 0
        found = tally_of(best, asked)
        ours = {"certpgo standard", "certpgo standard, unrefined", "certpgo proof"}
        assert "g2o" in best.name
        for name in ("certpgo standard", "certpgo proof"):
            assert found.of(name)["certified"] == 1
        for name in set(asked) - ours:
            assert found.of(name)["refused"] == 1


NAMES = ("at the optimum", "wound up")


def test_the_file_s_weights_are_read_as_they_are(path):
    problem = objective_of(read(path), "gtsam")
    assert problem.graph.information_matrices[0, 2, 2] == 30.0
    with pytest.raises(InputError):
        objective_of(read(path, unit_weights=True), "gtsam")

"""Metrics against ground truth, and of what robust methods kept."""

import numpy as np
import pytest

from certpgo.io.datasets import thesis
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Solution, Status
from reports.harness.experiments import evaluate
from reports.harness.experiments.runner import run_table
from reports.harness.experiments.spec import Column, Method, Row, Table

KEYS = ("rmse_deg", "median_l1_deg", "f_gt", "kept_percent", "precision", "recall", "apart_deg")


@pytest.fixture(scope="module")
def instance():
    return thesis.langevin_graph(40, 8.0, 1.0, np.random.default_rng(0), outliers=0.1)


def values(instance, weights=None, truth=None, outliers=None, other=None):
    problem = Quadratic(instance.graph)
    solution = Solution(instance.truth, 0.0, Status.CLOSED_FORM, weights=weights)
    return evaluate.of_estimate(
        KEYS, problem, problem, solution, None, truth=truth, outliers=outliers, other=other
    )


def test_without_truth_and_weights_nothing_is_said(instance):
    assert set(values(instance)) == {"cost"}


def test_the_truth_of_some_nodes_is_enough(instance):
    nodes = np.array([3, 5, 8])
    found = values(instance, truth=(nodes, instance.truth.subset(nodes)))
    assert found["rmse_deg"] == pytest.approx(0.0, abs=1e-5)
    assert found["f_gt"] == pytest.approx(0.0, abs=1e-12)


def test_precision_and_recall_by_hand(instance):
    m = instance.graph.num_edges
    wrong, weights = np.zeros(m, dtype=bool), np.ones(m)
    wrong[:10] = True
    weights[6:14] = 0.0
    found = values(instance, weights, outliers=wrong)
    assert (found["precision"], found["recall"]) == (0.5, 0.4)
    assert found["kept_percent"] == pytest.approx(100.0 * (1 - 8 / m))
    clean = values(instance, weights, outliers=np.zeros(m, dtype=bool))
    assert clean["precision"] == 0.0
    assert "recall" not in clean
    assert values(instance, np.ones(m), outliers=wrong)["precision"] == 1.0


def test_answers_are_compared_with_the_first_methods():
    columns = tuple(Column(key, key) for key in KEYS)
    row = Row(
        generator="langevin_graph",
        label="a",
        arguments={"n": 30, "fiedler": 8.0, "sigma_deg": 1.0, "outliers": 0.1},
    )
    methods = (Method("adaptive_trimming"), Method("eigen_ra"), Method("cycle_closed_form"))
    first, second, failed = run_table(Table("t", "T", (row,), methods, columns, certify=False))
    assert "apart_deg" not in first.metrics
    assert second.metrics["apart_deg"] > 0.0
    assert first.metrics["rmse_deg"] < second.metrics["rmse_deg"]
    assert first.metrics["recall"] == 1.0
    assert failed.error
    # A first method that fails leaves nothing to compare with.
    _, alone = run_table(Table("t", "T", (row,), methods[:0:-1], columns, certify=False))
    assert "apart_deg" not in alone.metrics

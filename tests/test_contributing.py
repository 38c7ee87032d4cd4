"""The solver printed in CONTRIBUTING.md is a file of its own, and everything finds it."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from certpgo import registry
from certpgo.cli import main
from certpgo.io import write
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.objective.quadratic import Quadratic
from reports.harness.experiments import scan
from reports.harness.experiments.runner import run_table

ROOT = registry.repository()
NAME = "neighbour_means"


@pytest.fixture(scope="module")
def printed():
    """The example's text."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    assert f"`baselines/{NAME}.py`" in text
    [block] = re.findall(r"^```python\n(.*?)^```$", text, flags=re.M | re.S)
    return block


@pytest.fixture
def checkout(tmp_path, monkeypatch, printed):
    """A copy of the checkout with that file in it, and nothing else new."""
    for folder in ("baselines", "reports/tables", "reports/published"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    (tmp_path / "baselines" / f"{NAME}.py").write_text(printed)
    monkeypatch.setenv(registry.REPOSITORY_VARIABLE, str(tmp_path))
    return tmp_path


@pytest.fixture
def graph(tmp_path):
    """A cycle with one turn to share out."""
    path = tmp_path / "cycle.npz"
    write(path, winding_cycle(6, 0.3, 0)[0])
    return path


def test_it_is_thirty_lines(printed):
    assert len([line for line in printed.splitlines() if line]) <= 30
    assert max(map(len, printed.splitlines())) <= 100


def test_it_is_listed(checkout, capsys):
    assert main(["list", "methods"]) == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if NAME in line]
    assert "both" in line
    assert "Damped Jacobi sweeps" in line


def test_it_solves_a_graph_and_is_judged(checkout, graph, capsys):
    arguments = ["solve", str(graph), "--method", NAME]
    assert main(arguments) == 0
    assert "CERTIFIED" in capsys.readouterr().out
    assert main([*arguments, "--set", "max_iterations=1"]) in (3, 4)
    capsys.readouterr()
    assert main([*arguments, "--set", "max_iterations=0"]) == 1
    assert "max_iterations at least 1" in capsys.readouterr().err


def test_it_finds_the_turn_that_the_closed_form_shares_out(checkout):
    # Every residual of the optimum is 0.3 / 6, and the cost is 8 n sin^2 of a half of it.
    instance, optimum = winding_cycle(6, 0.3, 0)
    problem = Quadratic(instance.graph)
    solution = registry.get_solver(NAME)().solve(problem)
    assert solution.cost == pytest.approx(problem.cost(optimum), rel=1e-9)


def test_it_is_compared_by_name(checkout, graph, tmp_path):
    out = tmp_path / "r"
    methods = f"certified,{NAME}"
    assert main(["compare", str(graph), "--methods", methods, "--out", str(out)]) == 0
    lines = (out / "compare.jsonl").read_text().splitlines()
    found = {result["method"]: result["verdict"] for result in map(json.loads, lines)}
    assert found == {"certified": "CERTIFIED", NAME: "CERTIFIED"}
    assert f"| {NAME} |" in (out / "compare.md").read_text()


def test_it_is_in_a_table_without_being_named_there(checkout):
    table = scan.get_table("every-method")
    own = tuple(method for method in table.methods if method.label == NAME)
    records = list(run_table(replace(table, methods=own), quick=True))
    assert [record.row for record in records] == list(table.quick)
    assert all(record.verdict and record.status == "converged" for record in records)


@pytest.mark.slow
def test_every_contract_is_held_against_it(checkout):
    options = ("-o", "addopts=", "-p", "no:cacheprovider", "-k", NAME)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "tests/optimize/test_contracts.py"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    [passed] = re.findall(r"(\d+) passed", done.stdout)
    assert int(passed) >= 10

"""certpgo diagnose, and the likely cause that solve and certify print."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import certpgo as package
from certpgo import Estimate
from certpgo.diagnosis.conventions import FORMS
from reports.studies.diagnosis.mistakes import clean

REPORTS = Path(__file__).parents[1] / "data" / "reports"


@pytest.fixture
def inverse(tmp_path):
    """A graph's file, and that of the inverse poses of its best estimate."""
    path, other = tmp_path / "g.g2o", tmp_path / "inverse.tum"
    package.write(path, replace(clean(3, 1), truth=None))
    best = package.solve(package.read(path)).estimate
    R, t = FORMS[0].read(best.rotations, best.translations)
    package.write(other, Estimate(R, t))
    return path, other


def test_findings_as_text_as_data_and_as_a_page(certpgo, inverse, tmp_path):
    path, other = inverse
    out, html = tmp_path / "findings.txt", tmp_path / "page.html"
    done = certpgo("diagnose", path, other, "-o", out, "--html", html)
    assert done.code == 0
    assert done.out.startswith("The estimate's poses are of the world in the body")
    assert "Invert each pose." in done.out
    assert out.read_text().startswith("The estimate's poses")
    assert "inverse-poses" in html.read_text()
    [found] = certpgo("diagnose", path, other, "--json").json["findings"]
    assert found["kind"] == "inverse-poses"
    assert found["cost"] < 1e-3 * found["cost_as_given"]


def test_certify_and_truth_name_the_cause(certpgo, inverse, tmp_path):
    path, other = inverse
    page = tmp_path / "page.html"
    done = certpgo("certify", path, other, "--html", page)
    assert "likely cause      The estimate's poses are of the world" in done.out
    assert "Likely cause: The estimate" in page.read_text()
    judged = certpgo("certify", path, other, "--json").json
    assert [found["kind"] for found in judged["findings"]] == ["inverse-poses"]
    done = certpgo("solve", path, "--truth", other)
    assert "The truth's poses are of the world" in done.out
    assert certpgo("solve", path, "--json").json["findings"] == []


def test_nothing_is_wrong_with_a_good_map(certpgo, inverse, tmp_path):
    path, _ = inverse
    good = tmp_path / "good.g2o"
    certpgo("solve", path, "-o", good)
    done = certpgo("diagnose", path, good)
    assert done.code == 0
    assert done.out.startswith("None of")


def test_solve_names_the_offset_of_the_truths_clock(certpgo, tmp_path):
    """Where times match by accident, as the likely cause, and where none do, before the search."""
    graph, times = REPORTS / "own_zero.g2o", REPORTS / "own_zero_times.tum"
    truth = REPORTS / "own_zero_truth.txt"
    done = certpgo("solve", graph, "--timestamps", times, "--truth", truth)
    assert "Add --truth-offset -3.045" in done.out
    late, offset = tmp_path / "late.txt", -1003.0
    rows = [line.split() for line in truth.read_text().splitlines()[1:]]
    late.write_text("".join(f"{float(t) + 1000.0} {' '.join(pose)}\n" for t, *pose in rows))
    done = certpgo("solve", graph, "--timestamps", times, "--truth", late)
    assert done.code == 1
    assert f"with --truth-offset {offset:.4g} positions are off by 0.0" in done.err


def test_info_outliers_and_solve_name_causes(certpgo, tmp_path):
    """What stands in the graph, and what explains all measurements that contradict one another."""
    loops, stiff = REPORTS / "loops_from_target.g2o", tmp_path / "stiff.g2o"
    assert "likely cause" not in certpgo("info", loops).out
    assert "All loop closures are inverses" in certpgo("outliers", loops).out
    text = (REPORTS / "square_roots.g2o").read_text()
    stiff.write_text(text.replace("44.72135955 0 0 44.72135955 0", "1e12 0 0 1e12 0", 1))
    assert "likely cause    1 measurement (0-1) weighs up to 1e+12" in certpgo("info", stiff).out
    [found] = certpgo("info", stiff, "--json").json["findings"]
    assert found["kind"] == "stiff-edge"
    made = clean(3, 1)
    edges = made.graph.edges.copy()
    loop = abs(edges[:, 0] - edges[:, 1]) > 1
    edges[loop] = edges[loop, ::-1]
    path = tmp_path / "inverted.g2o"
    graph = replace(made.graph, edges=edges)
    package.write(path, replace(made, graph=graph, truth=None, initial=None))
    done = certpgo("solve", path)
    assert "likely cause      All loop closures are inverses" in done.out
    [found] = certpgo("outliers", path, "--json").json["findings"]
    assert found["kind"] == "inverted-closures"
    t = np.where(loop[:, None], made.graph.translations / 0.3048, made.graph.translations)
    package.write(path, replace(made, graph=replace(made.graph, translations=t), truth=None))
    assert "likely cause      Loop closures are in feet" in certpgo("solve", path).out


def test_a_bad_estimate_says_nothing_of_the_measurements(certpgo, tmp_path):
    """chi^2 that is about measurements and their noise is that of the optimum."""
    path, bad = tmp_path / "g.g2o", tmp_path / "bad.tum"
    made = clean(3, 1)
    package.write(path, replace(made, truth=None))
    best = package.solve(package.read(path)).estimate
    rng = np.random.default_rng(0)
    off = best.translations + 0.5 * rng.standard_normal(best.translations.shape)
    package.write(bad, Estimate(best.rotations, off))
    done = certpgo("certify", path, bad)
    assert "that of the optimum is" in done.out
    assert "measurements may be wrong" not in done.err
    fit = certpgo("certify", path, bad, "--json").json["fit"]
    assert fit["chi2"] > 10.0 * fit["degrees_of_freedom"]
    assert fit["warning"] is None
    edges = made.graph.translations.copy()
    edges[-1] += 30.0
    graph = replace(made.graph, translations=edges)
    package.write(path, replace(made, graph=graph, truth=None))
    done = certpgo("certify", path, bad)
    assert "chi^2 of the " in done.err
    assert "measurements may be wrong" in done.err


def test_commands_can_be_pasted_from_the_beginning_of_a_sentence():
    found = package.Finding("kind", "it is wrong", "certpgo solve GRAPH --robust leaves it out")
    assert str(found) == "It is wrong. certpgo solve GRAPH --robust leaves it out"


def test_truth_is_compared_where_nothing_is_wrong_with_it(certpgo, tmp_path):
    """As `solve` says it: of how many poses, and how far off these are."""
    path, truth, made = tmp_path / "g.g2o", tmp_path / "truth.tum", clean(3, 1)
    package.write(path, replace(made, truth=None))
    n = made.graph.num_nodes - 2
    package.write(truth, made.truth.subset(np.arange(n)))
    done = certpgo("diagnose", path, "--truth", truth)
    [line] = [line for line in done.out.splitlines() if line.startswith("truth")]
    assert line.split(maxsplit=1)[1].startswith(f"of {n} of {n + 2} poses: ATE ")
    solved = certpgo("solve", path, "--truth", truth).out
    [ate] = [line for line in solved.splitlines() if line.startswith("ATE")]
    metres = float(re.search("ATE +([^ ]+) m", ate)[1])
    assert float(re.search("ATE ([^ ]+) m", line)[1]) == pytest.approx(metres, rel=1e-4)
    assert certpgo("diagnose", path, "--json").json["truth"] is None


def test_overstated_noise_alone_spoils_no_map(certpgo, tmp_path):
    path, made = tmp_path / "g.g2o", clean(3, 1)
    graph = made.graph
    graph = replace(graph, kappa=0.01 * graph.kappa, tau=0.01 * graph.tau, information=None)
    package.write(path, replace(made, graph=graph, truth=None))
    done = certpgo("diagnose", path)
    assert done.out.startswith("Nothing is wrong with the map but its stated noise: residuals of")

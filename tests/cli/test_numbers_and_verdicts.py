"""A verdict stands with the cost that it is about, and a number has one spelling."""

import json
import math
import re

import numpy as np
import pytest

import certpgo as package
from certpgo import plot
from certpgo.graph.phrases import bound_shown, cost_shown, gap_shown
from certpgo.io.datasets.synthetic import helix

NUMBER = re.compile(r"\d+\.?\d*(?:e[-+]?\d+)?")


def spelled(text, value, within):
    """All spellings of numbers in a text that are within a share of a value."""
    return {w for w in NUMBER.findall(text) if abs(float(w) - value) <= within * value}


@pytest.fixture
def outliers(tmp_path):
    """A helix with wrong loop closures, in a file."""
    made = helix(6, np.random.default_rng(0))
    graph = made.graph
    i, j = graph.edges.T
    R, t = graph.rotations.copy(), graph.translations.copy()
    wrong = np.flatnonzero(j - i > 1)[::7]
    R[wrong] = np.swapaxes(R[wrong], 1, 2)
    t[wrong] += 5.0
    rotation = package.RotationGraph(made.graph.num_nodes, graph.edges, R, graph.kappa)
    path = tmp_path / "outliers.g2o"
    package.write(path, package.PoseGraph(rotation, t, graph.tau))
    return path


@pytest.fixture
def answer(outliers):
    """Its robust answer, which rejects some."""
    found = package.solve_robustly(package.read(outliers))
    assert len(found.solution.rejected)
    assert found.cost > 1.1 * found.certificate.cost_upper
    return found


def test_the_number_beside_a_verdict_is_the_certified_one(certpgo, outliers, answer, tmp_path):
    kept, of_all = answer.certificate.cost_upper, answer.cost
    page, scene = tmp_path / "page.html", tmp_path / "scene.html"
    printed = certpgo("solve", outliers, "--robust", "--html", page)
    viewed = certpgo("view", outliers, "--robust", "-o", scene)
    compared = certpgo(
        "compare",
        outliers,
        "--methods=graduated_non_convexity,spanning_tree",
        f"--out={tmp_path / 'results'}",
    )
    markdown = (tmp_path / "results" / "compare.md").read_text()
    said = {
        "text": printed.out,
        "notes": printed.err,
        "view": viewed.err,
        "page": page.read_text(encoding="utf-8").split("<script")[0],
        "repr": repr(answer),
        "str": str(answer),
        "notebook": answer._repr_html_(),
        "certificate": repr(answer.certificate),
        "plot": plot.bounds(answer, ax=_axes()).get_title(),
        "compare": compared.out,
        "progress": compared.err,
        "markdown": markdown,
    }
    for where, text in said.items():
        for line in text.splitlines():
            if "CERTIFIED" in line:
                assert not spelled(line, of_all, 1e-4), (where, line)
    for where in ("view", "repr", "certificate"):
        assert spelled(said[where], kept, 1e-6) == {cost_shown(kept)}, where
    row = json.loads((tmp_path / "results" / "compare.jsonl").read_text().splitlines()[0])
    assert row["kept"] < 1.0
    assert row["cost"] > 1.1 * row["certified_cost"] >= row["lower_bound"]
    for where in ("compare", "progress", "markdown"):
        assert len(spelled(said[where], row["certified_cost"], 1e-6)) == 1, where
        assert not spelled(said[where], row["cost"], 1e-4), where
    assert min(map(printed.out.index, spelled(printed.out, kept, 1e-6))) < min(
        map(printed.out.index, spelled(printed.out, of_all, 1e-6))
    )
    for where in ("str", "notebook", "page", "plot", "notes"):
        assert not spelled(said[where], of_all, 1e-4), where


def test_json_has_both_costs_under_names_of_their_own(certpgo, outliers, answer):
    found = certpgo("solve", outliers, "--robust", "--json").json
    kept, of_all = answer.certificate.cost_upper, answer.cost
    assert found["verdict"] == "CERTIFIED"
    assert found["cost"] == found["solution"]["cost_of_kept"] == pytest.approx(kept, rel=1e-9)
    assert found["solution"]["cost_of_all"] == pytest.approx(of_all, rel=1e-6)
    assert found["solution"]["cost"] == found["solution"]["cost_of_all"]
    assert found["lower_bound"] <= found["cost"]


def test_a_number_is_spelled_alike_wherever_it_is_printed(certpgo, square, tmp_path):
    instance = package.read(square)
    best = package.solve(instance, cost="chordal").estimate
    moved = best.with_translations(best.translations + 1e-6 * np.arange(8).reshape(4, 2))
    estimate, page = tmp_path / "moved.npz", tmp_path / "page.html"
    package.write(estimate, moved, instance=instance)
    printed = certpgo("certify", square, estimate, "--cost=chordal", "--html", page)
    assert printed.code == 0
    read = package.read_estimate(estimate, instance)
    c = package.certify(instance, read, cost="chordal")
    assert c.gap > 1e-8 * c.cost_upper
    said = {
        "text": printed.out,
        "page": page.read_text(encoding="utf-8").split("<script")[0],
        "reason": c.reason,
        "str": str(c),
        "repr": repr(c),
        "plot": _written_on(plot.bounds(package.Quadratic(instance.graph), c, ax=_axes())),
    }
    share = c.relative_gap
    costs = {cost_shown(c.cost_upper), bound_shown(c.lower_bound)}
    for where, text in said.items():
        text = re.sub(r"tolerance +\S+", "", text)
        assert spelled(text, c.gap, 0.05) == {gap_shown(c.gap)}, where
        assert spelled(text, c.cost_upper, 10.0 * share) <= costs, where
        assert cost_shown(c.cost_upper) in text, where
        if where not in ("repr", "plot"):
            assert len(spelled(text, share, 0.05)) == 1, where
    shares = [spelled(said[where], share, 0.05) for where in ("text", "page", "reason", "str")]
    assert all(one == shares[0] for one in shares)
    assert float(gap_shown(c.gap)) >= c.gap


def _axes():
    figure = pytest.importorskip("matplotlib.figure")
    return figure.Figure().add_subplot()


def _written_on(ax):
    return "\n".join([ax.get_title(), *(text.get_text() for text in ax.texts)])


SCALED = """\
EDGE_SE2 0 1 1.01 0 1.57 {0} 0 0 {0} 0 {0}
EDGE_SE2 1 2 0.99 0 1.58 {0} 0 0 {0} 0 {0}
EDGE_SE2 2 3 1 0.01 1.56 {0} 0 0 {0} 0 {0}
EDGE_SE2 3 0 1 0 1.57 {0} 0 0 {0} 0 {0}
"""


@pytest.mark.parametrize(("weight", "said"), [(1e6, "too small"), (1e4, ""), (1e-3, "too large")])
def test_an_unusual_chi2_is_warned_of_wherever_a_verdict_is_printed(
    certpgo, tmp_path, weight, said
):
    graph, solved = tmp_path / "scaled.g2o", tmp_path / "solved.g2o"
    graph.write_text(SCALED.format(weight))
    page, judged = tmp_path / "page.html", tmp_path / "judged.html"
    runs = [
        certpgo("solve", graph, "-o", solved, "--html", page),
        certpgo("solve", graph, "--json"),
        certpgo("certify", graph, solved, "--html", judged),
        certpgo("certify", graph, solved, "--json"),
        certpgo("follow", graph),
    ]
    for done in runs:
        assert done.code == 0, done.err
        assert bool(said) == ("chi^2 is" in done.err), done.err
        assert said in done.err
        assert "at 3 degrees of freedom" in done.out or done.json["fit"]["degrees_of_freedom"] == 3
    for done in (runs[1], runs[3]):
        fit = done.json["fit"]
        assert fit["chi2"] == pytest.approx(done.json["cost"])  # g2o's cost is chi^2
        assert said in (fit["warning"] or "")
    for written in (page, judged):
        text = written.read_text(encoding="utf-8")
        assert "at 3 degrees of freedom" in text
        assert said in text
    answer = package.solve(package.read(graph))
    assert said in str(answer)
    assert "at 3 degrees of freedom" in " ".join(str(answer).split())


def test_rejecting_more_than_a_third_is_warned_of(certpgo, tmp_path):
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 0 1e4 0 0 1e4 0 1e4" for k in range(9)]
    good = [f"EDGE_SE2 {k} {k + 2} 2 0 0 1e4 0 0 1e4 0 1e4" for k in range(8)]
    bad = [f"EDGE_SE2 {k} {9 - k} {k - 7} {k + 3} {k + 1} 1e4 0 0 1e4 0 1e4" for k in range(4)]
    for count, wrong in ((4, False), (12, True)):
        graph = tmp_path / f"wrong{count}.g2o"
        graph.write_text("\n".join([*lines, *good, *(bad * 3)[:count]]) + "\n")
        done = certpgo("solve", graph, "--robust")
        assert done.code == 0, done.err
        assert (f"{count} of {17 + count} measurements are rejected" in done.err) == wrong
        assert math.isfinite(certpgo("solve", graph, "--robust", "--json").json["cost"])


def test_a_tree_is_said_to_have_no_redundancy_and_notes_are_said_once(certpgo, tmp_path):
    path = tmp_path / "tree.g2o"
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0.1 1 0 0 1 0 1" for i in range(3)]
    path.write_text("\n".join([*lines, "EDGE_BEARING_SE2_XY 0 9 0.1 5"]) + "\n")
    done = certpgo("solve", path)
    assert done.out.startswith("EXACT FIT. Every measurement is met to ten digits")
    assert done.out.partition("\n")[2].startswith("\n")  # alone
    assert "redundancy        none: a tree fits any measurements" in done.out
    assert (done.out + done.err).count("skipped") == 1
    path.write_text("\n".join([*lines, "EDGE_SE2 3 0 1 0 0.1 1 0 0 1 0 1"]) + "\n")
    closed = certpgo("solve", path).out
    assert "redundancy" not in closed
    assert "costliest edges   " in closed
    assert " degrees, " in next(line for line in closed.splitlines() if "largest res" in line)

"""solve --html and certify --html."""

import html
import json
import re

import pytest

from certpgo.graph.phrases import rounded_up


def scene_of(page):
    """The data of the page's view."""
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def test_solve_writes_a_page_the_same_each_time(certpgo, square, tmp_path):
    out = tmp_path / "page.html"
    done = certpgo("solve", square, "--html", out, "--json")
    assert done.code == 0
    assert f"page written to {out}" in done.err
    page = out.read_text()
    assert "<strong>CERTIFIED</strong>" in page
    assert f"{done.json['cost']:.10g}"[:9] in page
    assert "Gap to the proven lower bound" in page
    assert scene_of(page)["ids"] == [0, 1, 2, 3]
    assert f"certpgo solve {square.name} -o best.g2o" in page
    certpgo("solve", square, "--html", out)
    assert out.read_text() == page
    assert str(tmp_path) not in page


def test_the_page_says_how_to_check_a_proof(certpgo, square, tmp_path):
    out, proof = tmp_path / "page.html", tmp_path / "square.cert"
    done = certpgo("solve", square, "--proof", proof, "--html", out)
    assert done.code == 0
    assert f"certpgo check {square.name} {proof.name}" in out.read_text()


def test_certify_writes_a_page_of_the_answer_as_given(certpgo, square, tmp_path):
    out = tmp_path / "page.html"
    done = certpgo("certify", square, square, "--unit-weights", "--html", out)
    assert done.code == 3
    page = out.read_text()
    assert "<strong>BOUNDED</strong>" in page
    assert "The estimate came from a file" in page
    assert (
        f"certpgo certify {square.name} {square.name} --unit-weights --proof estimate.cert" in page
    )
    assert "all weights 1, ignoring those of the file" in page


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_pages_of_another_cost(certpgo, square, tmp_path, cost):
    out, solution = tmp_path / "page.html", tmp_path / "solution.g2o"
    done = certpgo("solve", square, "--cost", cost, "--html", out, "-o", solution, "--json")
    assert done.code == 0
    page = out.read_text()
    assert html.escape(done.json["objective"], quote=False) in html.unescape(page)
    assert f"{done.json['cost']:.10g}"[:9] in page
    assert "Gap to the proven lower bound" in page
    chosen = " --cost gtsam\n" if cost == "gtsam" else " --proof"
    assert f"certpgo certify {square.name} {solution.name}{chosen}" in page
    judged = certpgo("certify", square, square, "--cost", cost, "--html", out, "--json")
    given = out.read_text()
    assert "<strong>BOUNDED</strong>" in given
    assert rounded_up(judged.json["certificate"]["cost_upper"], 12) in given
    assert "Bounds by eigenvalues" not in page + given


def test_a_method_that_keeps_no_trace(certpgo, square, tmp_path):
    out = tmp_path / "page.html"
    done = certpgo("solve", square, "--method", "eigen_ma", "--html", out)
    assert done.code == 3
    page = out.read_text()
    assert "The method kept fewer than two iterations." in page
    assert f"certpgo solve {square.name} --method eigen_ma --cost chordal -o best.g2o" in page


def test_the_page_of_a_robust_method_is_of_what_it_kept(certpgo, square, tmp_path):
    out = tmp_path / "page.html"
    done = certpgo("solve", square, "--method", "graduated_non_convexity", "--html", out, "--json")
    kept = done.json["solution"]["kept"]
    assert (
        f"The method kept {kept} of 4 measurements: the verdict is about these" in out.read_text()
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("solve", "{graph}", "--html", "{out}", "--method", "eigen_ma", "--no-certify"), "--html"),
        (("certify", "{graph}", "{graph}", "--html", "{out}", "--csv", "{csv}"), "--csv"),
        (("certify", "{graph}", "{graph}", "--html", "{graph}"), "lost"),
        (("solve", "{graph}", "--html", "{graph}"), "lost"),
        (("solve", "{graph}", "--html", "{out}", "--proof", "{out}"), "two outputs"),
        (("solve", "{graph}", "--html", "{nowhere}"), "no folder"),
        (("certify", "{graph}", "{graph}", "--html", "{nowhere}"), "no folder"),
    ],
)
def test_refusals(certpgo, square, tmp_path, arguments, said):
    names = {
        "graph": square,
        "out": tmp_path / "page.html",
        "csv": tmp_path / "rows.csv",
        "nowhere": tmp_path / "nowhere" / "page.html",
    }
    before = square.read_text()
    done = certpgo(*(argument.format(**names) for argument in arguments))
    assert done.code == 1
    assert said in done.err
    assert done.err.count("\n") == 1
    assert not names["out"].exists()
    assert square.read_text() == before


def test_several_components_have_no_page(certpgo, square, tmp_path):
    graph = tmp_path / "two.g2o"
    edges = [line for line in square.read_text().splitlines() if line.startswith("EDGE")]
    moved = [re.sub(r"^(EDGE_SE2) (\d) (\d)", r"\1 1\2 1\3", line) for line in edges]
    graph.write_text("\n".join(edges + moved) + "\n")
    out, estimate = tmp_path / "page.html", tmp_path / "estimate.g2o"
    ids = [*range(4), *range(10, 14)]
    estimate.write_text("".join(f"VERTEX_SE2 {k} 0 0 0\n" for k in ids))
    for command in (("solve", graph), ("certify", graph, estimate)):
        done = certpgo(*command, "--components", "each", "--html", out)
        assert done.code == 1
        assert "--html" in done.err
        assert not out.exists()
    done = certpgo("solve", graph, "--components", "largest", "--html", out)
    assert done.code == 0
    assert "--components largest" in out.read_text()


#: Three corners of a rectangle, and a beacon that seems nearer to each than they allow.
BEACON = """\
VERTEX_SE2 0.0 A0 0 0 0
VERTEX_SE2 1.0 A1 6 0 0
VERTEX_SE2 2.0 A2 6 8 0
VERTEX_XY L0 3 4
EDGE_SE2 0.5 A0 A1 6 0 0.01 0.01 0 0 0.01 0 0.0001
EDGE_SE2 1.5 A1 A2 0 8 0 0.01 0 0 0.01 0 0.0001
EDGE_RANGE 0.0 A0 L0 4.9 0.01
EDGE_RANGE 1.0 A1 L0 4.8 0.01
EDGE_RANGE 2.0 A2 L0 4.7 0.01
"""


def test_pages_of_distances(certpgo, tmp_path):
    graph, estimate, page = tmp_path / "beacon.pyfg", tmp_path / "best.pyfg", tmp_path / "page.html"
    graph.write_text(BEACON)
    assert certpgo("solve", graph, "-o", estimate, "--html", page).code == 0
    text = page.read_text()
    assert "The cost F on this page includes the squared errors of distances." in text
    assert re.search(r"largest residual</dt><dd>[^<]* degrees, [^<]* m<", text)
    assert "4 nodes, 2 edges, 3 distances, 2D" in text
    assert "--robust" not in text
    assert scene_of(text)["kinds"][-3:] == [3, 3, 3]
    again = tmp_path / "again.html"
    assert certpgo("certify", graph, estimate, "--html", again).code == 0
    assert scene_of(again.read_text())["edges"] == scene_of(text)["edges"]


def test_a_page_of_distances_without_other_initial_values(certpgo, tmp_path):
    """Initial values may be at one point, or the estimate itself; the verdict stays."""
    graph, page = tmp_path / "beacon.pyfg", tmp_path / "page.html"
    graph.write_text(BEACON.replace("6 0 0\nV", "0 0 0\nV").replace("6 8 0", "0 0 0"))
    graph.write_text(graph.read_text().replace("L0 3 4", "L0 0 0"))
    assert certpgo("solve", graph, "--html", page).code == 0
    assert "before" not in scene_of(page.read_text())
    graph.write_text(BEACON)
    page.unlink()
    done = certpgo("certify", graph, graph, "--html", page)
    assert done.code == certpgo("certify", graph, graph).code == 3, done.err
    assert "before" not in scene_of(page.read_text())


def test_commands_of_a_page_match_poses_as_the_user_did(certpgo, square, tmp_path):
    out, times, estimate = (tmp_path / name for name in ("page.html", "times.txt", "e.tum"))
    times.write_text("10.0\n11.0\n12.0\n13.0\n")
    certpgo("solve", square, "-o", estimate, "--timestamps", times, "--html", out)
    again = f"--timestamps {times} --proof estimate.cert"
    assert f"{square.name} {estimate.name} {again}" in out.read_text()
    how = ("--timestamps", times, "--max-difference", 0.5)
    done = certpgo("certify", square, estimate, "--unit-weights", *how, "--html", out)
    assert done.code == 3
    again = f"--unit-weights --timestamps {times} --max-difference 0.5"
    page = out.read_text()
    assert f"{square.name} {estimate.name} {again} --best polished.g2o" in page
    assert f"{square.name} {estimate.name} {again} --proof estimate.cert" in page

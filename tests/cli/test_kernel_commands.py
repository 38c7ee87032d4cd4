"""The option --kernel of solve, certify and compare."""

import numpy as np
import pytest

from certpgo import Estimate, InputNotice, solve
from certpgo.graph import Instance, RotationGraph
from certpgo.io import read, write
from certpgo.linalg import rotations as so


def flat(text):
    return " ".join(text.split())


@pytest.fixture
def views(tmp_path):
    """Twelve rotations, each measured with each other, six of them wrongly."""
    rng, n = np.random.default_rng(0), 12
    truth, edges = so.random(rng, n, 3), np.array([(i, j) for i in range(n) for j in range(i)])
    i, j = edges.T
    R = np.swapaxes(truth[i], 1, 2) @ truth[j] @ so.exp(0.02 * rng.normal(size=(len(i), 3)))
    wrong = rng.choice(len(i), 6, replace=False)
    R[wrong] = so.random(rng, 6, 3)
    path = tmp_path / "views.g2o"
    graph = RotationGraph(n, edges, R, np.ones(len(i)))
    write(path, Instance("views", graph, np.arange(n), initial=Estimate(truth)))
    return path


def test_solve_and_certify_judge_by_the_kernel(certpgo, views, tmp_path):
    best, plain = tmp_path / "best.g2o", tmp_path / "plain.g2o"
    done = certpgo("solve", views, "--kernel", "huber:5deg", "-o", best)
    assert done.code == 0
    assert done.out.startswith("CERTIFIED")
    assert "(F, under Huber's kernel of 5 degrees)" in flat(done.out)
    assert "disagree" not in done.out + done.err
    report = certpgo("solve", views, "--kernel", "huber:5deg", "--json").json
    assert report["objective"] == "F, under Huber's kernel of 5 degrees"
    with pytest.warns(InputNotice, match="read as a rotation graph"):
        graph = read(views).graph
    assert report["cost"] == pytest.approx(solve(graph, kernel="huber:5deg").cost)
    assert certpgo("solve", views, "-o", plain).code == 0
    done = certpgo("certify", views, plain, "--kernel", "huber:5deg")
    assert done.code != 0
    again = [line for line in done.out.splitlines() if line.startswith("next")]
    assert all("--kernel huber:5deg" in line for line in again)
    assert certpgo("certify", views, best, "--kernel", "huber:5deg").code == 0
    rows = tmp_path / "rows.csv"
    assert certpgo("certify", views, best, plain, "--kernel", "huber:5deg", "--csv", rows).code != 0
    assert "Huber's kernel of 5 degrees" in rows.read_text()


def test_compare_judges_all_methods_by_the_kernel(certpgo, views, tmp_path):
    methods = "certified,certified (F),eigen_ra"
    how = ("--kernel", "geman-mcclure:20deg", "--methods", methods, "--json")
    rows = certpgo("compare", views, *how, "-o", tmp_path / "found").json
    own, of_f, eigen = rows
    assert [row["method"] for row in rows] == methods.split(",")
    assert own["verdict"] == "CERTIFIED"
    assert own["minimised"] == "chordal, geman-mcclure:20deg"
    assert own["cost"] < of_f["cost"]
    assert own["cost"] < eigen["cost"]
    assert {row["objective"] for row in rows} == {
        "F, under Geman and McClure's kernel of 20 degrees"
    }


def test_what_knows_no_kernel_is_refused(certpgo, views, tmp_path):
    for option in ("--robust", "--proof", "--html", "--covariances", "--regions", "--method"):
        value = () if option == "--robust" else (tmp_path / "out.x",)
        done = certpgo("solve", views, "--kernel", "huber:5deg", option, *value)
        assert (done.code, done.out) == (1, "")
        assert done.err.endswith(f"certpgo: {option} is not for a cost with --kernel\n")
    for text, said in (("huber", "needs a scale"), ("tukey:1", "unknown kernel 'tukey'")):
        done = certpgo("solve", views, "--kernel", text)
        assert done.code == 2
        assert said in flat(done.err)

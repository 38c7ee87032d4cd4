"""Options of commands refuse what the table of capabilities says, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from features import N, having, plain

from certpgo import Ranges, write
from certpgo.graph.capabilities import OPERATIONS
from certpgo.graph.information import Information
from certpgo.graph.trees import tree_initialization


@pytest.mark.parametrize(
    "option", ["method", "proof", "covariances", "regions", "robust", "bounds"]
)
@pytest.mark.parametrize("feature", ["distances", "scales"])
def test_options_refuse_what_the_table_says(certpgo, tmp_path, option, feature):
    path = tmp_path / "graph.npz"
    write(path, having(feature))
    given = {
        "method": ("--method", "eigen_ma"),
        "proof": ("--proof", str(tmp_path / "x.cert")),
        "covariances": ("--covariances", str(tmp_path / "x.csv")),
        "regions": ("--regions", str(tmp_path / "r.csv")),
        "robust": ("--robust",),
    }.get(option)
    done = certpgo(option, path) if given is None else certpgo("solve", path, *given)
    refused = feature in OPERATIONS[option].lacks
    assert ("not take" in done.err) is refused
    assert (done.code == 1) is refused


def test_pages_and_commands_of_graphs_with_distances(certpgo, tmp_path):
    """A distance wrong by far is red on the page, and commands keep a cost that is chosen."""
    graph, page = tmp_path / "graph.npz", tmp_path / "page.html"
    write(graph, having("distances"))
    robust = certpgo("solve", graph, "--robust", "--html", page)
    assert robust.code == 0
    assert "rejected edge" in page.read_text()
    done = certpgo("solve", graph, "--time-limit", "0")
    assert "--cost" not in done.out  # the graph's own
    other = having("distances").with_information(
        Information.isotropic(np.full(17, 4.0), np.full(17, 4.0), 3, "g2o", "quaternion")
    )
    write(graph, other)
    for cost, said in (("g2o", False), ("chordal", True)):
        stopped = certpgo("solve", graph, "--cost", cost, "--time-limit", "0")
        assert f"--cost {cost}" in stopped.out or not said


def test_wrong_loops_beside_distances_are_listed_and_methods_compared(certpgo, tmp_path):
    """Distances that fit, and one loop that is wrong by far."""
    graph, path = plain(), tmp_path / "graph.npz"
    t, far = tree_initialization(graph).translations, graph.translations.copy()
    far[-1] += 50.0
    pairs = np.array([[0, 2], [1, 4]])
    lengths = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
    ranges = Ranges(N, pairs, lengths, np.ones(2))
    write(path, replace(graph, translations=far).with_ranges(ranges))
    listed = certpgo("outliers", path, "--json").json
    assert [one["edge"] for one in listed["rejected"]] == [graph.num_edges - 1]
    assert listed["verdict"] == "CERTIFIED"
    out = tmp_path / "out"
    compared = certpgo("compare", path, "--methods", "certified,newton", "-o", out, "--json").json
    best, other = compared
    assert best["verdict"] == "CERTIFIED"
    assert best["minimised"] == "chordal with distances"
    assert other["note"].startswith("minimises F without distances")
    assert other["cost"] > best["cost"] > 0.0
    bounds = certpgo("bounds", path)
    assert "about F without distances, whose terms are never negative" in bounds.err
    assert bounds.code == 0

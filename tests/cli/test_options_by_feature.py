"""Options of commands refuse what the table of capabilities says, and nothing else."""

import numpy as np
import pytest
from features import having

from certpgo import write
from certpgo.graph.capabilities import OPERATIONS
from certpgo.graph.information import Information


@pytest.mark.parametrize("option", ["method", "proof", "covariances", "regions", "robust"])
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
    }[option]
    done = certpgo("solve", path, *given)
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

"""Options of commands refuse what the table of capabilities says, and nothing else."""

import pytest
from features import having

from certpgo import write
from certpgo.graph.capabilities import OPERATIONS


@pytest.mark.parametrize("option", ["method", "proof", "covariances", "robust"])
@pytest.mark.parametrize("feature", ["distances", "scales"])
def test_options_refuse_what_the_table_says(certpgo, tmp_path, option, feature):
    path = tmp_path / "graph.npz"
    write(path, having(feature))
    given = {
        "method": ("--method", "eigen_ma"),
        "proof": ("--proof", str(tmp_path / "x.cert")),
        "covariances": ("--covariances", str(tmp_path / "x.csv")),
        "robust": ("--robust",),
    }[option]
    done = certpgo("solve", path, *given)
    refused = feature in OPERATIONS[option].lacks
    assert ("not take" in done.err) is refused
    assert (done.code == 1) is refused

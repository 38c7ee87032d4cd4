"""What a user calls a graph, resolved once."""

import pytest

from certpgo import datasets
from certpgo.datasets.source import resolve
from certpgo.errors import InputError


def test_a_file_goes_before_a_dataset_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "intel").write_text("EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    source = resolve("intel")
    assert source.is_file
    assert source.is_here
    assert str(source.path()) == "intel"


def test_a_dataset_is_looked_for_once(dataset_path, monkeypatch):
    dataset_path("smallGrid3D")
    looked = []
    find = datasets.find
    monkeypatch.setattr(datasets, "find", lambda *given: looked.append(given) or find(*given))
    source = resolve("smallGrid3D")
    assert source.is_here
    assert source.path() == source.found
    assert source.graph(quiet=True).name == "smallGrid3D"
    assert sum(given[0] == "smallGrid3D" for given in looked) == 1


def test_what_is_neither_is_refused_with_the_nearest_names():
    with pytest.raises(InputError, match="smallGrid2: no such file or dataset; did you mean small"):
        resolve("smallGrid2")
    with pytest.raises(InputError, match="certpgo list datasets"):
        resolve("qqqq")


def test_a_dataset_that_is_no_graph_is_refused(dataset_path):
    names = [name for name in datasets.names() if datasets.entry(name).kind == "truth"]
    source = resolve(next(name for name in names if datasets.find(name)))
    with pytest.raises(InputError, match="holds no graph"):
        source.graph()

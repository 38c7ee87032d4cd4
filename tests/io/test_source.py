"""What a user calls a graph, resolved once."""

import pytest

from certpgo.errors import InputError
from certpgo.io import datasets
from certpgo.io.datasets import lookup
from certpgo.io.datasets.source import resolve


def test_a_file_goes_before_a_dataset_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "intel").write_text("EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    source = resolve("intel")
    assert source.hides_dataset
    assert str(source.path()) == "intel"


def test_a_dataset_is_looked_for_once(dataset_path, monkeypatch):
    dataset_path("smallGrid3D")
    looked = []
    find = lookup.find
    monkeypatch.setattr(
        lookup, "find", lambda entry, data: looked.append(entry.name) or find(entry, data)
    )
    source = resolve("smallGrid3D")
    assert source.path() == source.found
    assert source.graph(quiet=True).name == "smallGrid3D"
    assert looked == ["smallGrid3D"]


def test_a_download_happens_once(monkeypatch, tmp_path):
    fetched = []
    monkeypatch.setattr(lookup, "places", lambda data: {"here": tmp_path})
    monkeypatch.setattr(
        lookup, "download", lambda entry: fetched.append(entry.name) or tmp_path / "MIT.g2o"
    )
    source = resolve("MIT")
    assert source.found is None
    with pytest.raises(InputError, match=r"MIT\.g2o is not in here"):
        source.path(download=False)
    assert source.path() == source.path() == tmp_path / "MIT.g2o"
    assert fetched == ["MIT"]


def test_what_is_neither_is_refused_with_the_nearest_names():
    with pytest.raises(InputError, match="smallGrid2: no such file or dataset; did you mean small"):
        resolve("smallGrid2")
    with pytest.raises(InputError, match="certpgo list datasets"):
        resolve("qqqq")
    with pytest.raises(InputError, match="-: no such file or dataset; a pipe is /dev/stdin"):
        resolve("-")


def test_a_dataset_that_is_no_graph_is_refused(dataset_path):
    names = [name for name in datasets.names() if datasets.entry(name).kind == "truth"]
    source = resolve(next(name for name in names if datasets.find(name)))
    with pytest.raises(InputError, match="holds no graph"):
        source.graph()

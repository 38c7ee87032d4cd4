import hashlib
import re
import warnings
from contextlib import suppress
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import numpy as np
import pytest

from certpgo import io
from certpgo.errors import InputError, InputNotice, SpecError
from certpgo.io import datasets
from certpgo.io.datasets import catalogue, lookup
from certpgo.objective.quadratic import Quadratic

TRIANGLE = b"EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n"


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No data folder in the environment, an empty cache, no wheel."""
    monkeypatch.delenv(lookup.DATA_VARIABLE, raising=False)
    monkeypatch.setattr(lookup, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.setattr(lookup.importlib.util, "find_spec", lambda name: None)


@pytest.fixture
def little(monkeypatch):
    """A catalogue of one little file that exists nowhere else."""
    entry = replace(
        catalogue.entry("intel"),
        name="little",
        file="folder/little.g2o",
        checksum="sha256:" + hashlib.sha256(TRIANGLE).hexdigest(),
        bytes=len(TRIANGLE),
        nodes=3,
        edges=2,
    )
    known = {"little": entry}
    monkeypatch.setattr(catalogue, "entries", lambda: known)
    return entry


def put(folder, content=TRIANGLE, name="little.g2o"):
    path = folder / "deep" / name
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    return path


def test_every_entry_of_the_catalogue_is_well_formed():
    for entry in catalogue.entries().values():
        assert entry.kind in catalogue.KINDS
        assert re.fullmatch(r"sha256:[0-9a-f]{64}|git:[0-9a-f]{40}", entry.checksum)
        assert entry.truth == "" or catalogue.entry(entry.truth).kind == "truth"
        assert (entry.edges is not None) or entry.kind != "graph"
        assert (entry.url is None) == (entry.origin in {"derived", "gtsam wheel"})


def test_one_checksum_has_one_name():
    checksums = [entry.checksum for entry in catalogue.entries().values()]
    assert len(set(checksums)) == len(checksums)


def test_names_by_kind():
    assert {"sphere2500", "rim", "w10000"} <= set(datasets.names("graph"))
    assert "sphere2500_groundtruth" in datasets.names("truth")
    assert sorted(datasets.names()) == sorted(n for k in catalogue.KINDS for n in datasets.names(k))
    with pytest.raises(SpecError, match="did you mean graph"):
        datasets.names("graphs")


def test_a_dataset_is_also_known_by_its_file_name():
    assert datasets.entry("sphere2500.txt") is datasets.entry("sphere2500_isam")
    assert datasets.entry("sphere2500.g2o") is datasets.entry("sphere2500")


@pytest.mark.parametrize("name", ["sphere25000", "EGs.txt"])
def test_unknown_and_ambiguous_names_are_refused(name):
    with pytest.raises(SpecError, match=f"unknown dataset '{name}'"):
        datasets.find(name)


def test_a_misspelt_name_gets_the_nearest():
    with pytest.raises(SpecError, match=r"did you mean .*torus3D"):
        datasets.fetch("torus3d")


def test_the_places_in_their_order(nowhere, little, tmp_path, monkeypatch):
    assert datasets.find("little") is None
    in_cache = put(tmp_path / "cache")
    assert datasets.find("little") == in_cache
    in_variable = put(tmp_path / "variable")
    monkeypatch.setenv(lookup.DATA_VARIABLE, str(tmp_path / "variable"))
    assert datasets.find("little") == in_variable
    in_argument = put(tmp_path / "argument")
    assert datasets.find("little", tmp_path / "argument") == in_argument
    assert datasets.fetch("little", tmp_path / "argument") == in_argument


def test_among_files_of_one_name_the_checksum_decides(nowhere, little, tmp_path):
    put(tmp_path / "a", b"another file")
    put(tmp_path / "b", TRIANGLE.replace(b"2 1 0 0", b"2 1 0 1"))
    right = put(tmp_path / "c")
    assert datasets.find("little", tmp_path) == right


def test_a_file_with_another_checksum_is_reported(nowhere, little, tmp_path):
    wrong = put(tmp_path / "data", TRIANGLE.replace(b"2 1 0 0", b"2 1 0 1"))
    with pytest.raises(InputError, match="checksum differs") as caught:
        datasets.fetch("little", tmp_path / "data", download=False)
    message = str(caught.value)
    assert str(wrong) in message
    assert str(tmp_path / "cache") in message
    assert "\n" not in message


def test_a_data_folder_that_is_none_is_refused(little, tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        datasets.find("little", tmp_path / "absent")


def test_gits_own_hash_serves_where_no_other_is_known(tmp_path):
    path = tmp_path / "hello"
    path.write_bytes(b"hello\n")
    entry = replace(datasets.entry("rim"), checksum="git:ce013625030ba8dba906f756967f9e9ca394464a")
    assert entry.agrees(path)
    path.write_bytes(b"hallo\n")
    assert not entry.agrees(path)


@pytest.mark.parametrize(
    ("name", "remedy"),
    [
        ("sphinx_SO3", "no download address"),
        ("w10000", r"pip install 'gtsam"),
    ],
)
def test_a_file_without_address_says_so(nowhere, name, remedy):
    with pytest.raises(InputError, match=remedy):
        datasets.fetch(name)


class Server:
    """Stands in for pooch.retrieve: delivers `content`, or fails."""

    def __init__(self, content):
        self.content, self.url = content, None

    def __call__(self, url, known_hash, fname, path, downloader):
        self.url = url
        if self.content is None:
            raise ConnectionError("no route to host\nand a long story")
        path.mkdir(parents=True)
        (path / fname).write_bytes(self.content)
        return str(path / fname)


def test_a_download_lands_in_the_cache(nowhere, little, tmp_path, monkeypatch):
    server = Server(TRIANGLE)
    monkeypatch.setattr("pooch.retrieve", server)
    path = datasets.fetch("little")
    assert path == tmp_path / "cache" / "folder" / "little.g2o"
    assert datasets.find("little") == path
    assert server.url == (
        f"https://raw.githubusercontent.com/{little.origin}/{little.commit}/{little.path}"
    )


def test_find_never_downloads(nowhere, little, monkeypatch):
    monkeypatch.setattr("pooch.retrieve", Server(TRIANGLE))
    assert datasets.find("little") is None
    with pytest.raises(InputError, match="can be downloaded from"):
        datasets.load("little", download=False)


def test_a_failed_download_is_one_line(nowhere, little, monkeypatch):
    monkeypatch.setattr("pooch.retrieve", Server(None))
    with pytest.raises(InputError, match=r"download of https://\S+ failed \(no route") as caught:
        datasets.fetch("little")
    assert "\n" not in str(caught.value)


def test_a_download_with_another_checksum_is_thrown_away(nowhere, little, tmp_path, monkeypatch):
    monkeypatch.setattr("pooch.retrieve", Server(b"moved"))
    with pytest.raises(InputError, match="checksum differs"):
        datasets.fetch("little")
    assert not list((tmp_path / "cache").rglob("*.g2o"))


class Endless(BaseHTTPRequestHandler):
    """Delivers ones without an end, and counts them."""

    sent = 0

    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        with suppress(OSError):
            while Endless.sent < 1 << 30:
                Endless.sent += self.wfile.write(b"1" * (1 << 16))

    def log_message(self, *_):
        pass


@pytest.mark.parametrize("known", [True, False])
def test_no_more_is_downloaded_than_stated(nowhere, little, tmp_path, monkeypatch, known):
    pytest.importorskip("pooch")
    if not known:
        monkeypatch.setitem(catalogue.entries(), "little", replace(little, bytes=None))
    monkeypatch.setattr(lookup, "MOST", 1 << 20)
    monkeypatch.setattr(Endless, "sent", 0)
    with ThreadingHTTPServer(("127.0.0.1", 0), Endless) as server:
        address = f"http://127.0.0.1:{server.server_port}/little.g2o"
        monkeypatch.setattr(catalogue.Entry, "url", property(lambda entry: address))
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            with pytest.raises(InputError, match=r"has more than the \d+ bytes expected"):
                datasets.fetch("little")
        finally:
            server.shutdown()
            thread.join()
    assert Endless.sent < 1 << 26
    assert not list((tmp_path / "cache").rglob("*.g2o"))


def test_what_is_no_graph_is_not_loaded():
    with pytest.raises(InputError, match="holds no graph but truth"):
        datasets.load("ring_groundtruth")


GRAPHS = [n for kind in ("graph", "adjacency") for n in datasets.names(kind)]


@pytest.mark.parametrize("name", [n for n in GRAPHS if (datasets.entry(n).edges or 0) < 30000])
def test_each_graph_has_the_counts_of_the_catalogue(name, dataset):
    entry, graph = datasets.entry(name), dataset(name).graph
    assert (graph.num_nodes, graph.num_edges, graph.d) == (entry.nodes, entry.edges, entry.d)


def test_loading_reads_with_the_options_given(nowhere, little, tmp_path):
    put(tmp_path / "data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputNotice)
        instance = datasets.load("little", tmp_path / "data", unit_weights=True)
        again = io.read(datasets.find("little", tmp_path / "data"), unit_weights=True)
    assert instance.options == again.options
    assert instance.graph.num_edges == 2


@pytest.mark.parametrize("name", ["ring", "sphere2500", "city10000", "sphinx_SO3"])
def test_truth_that_covers_the_graph_comes_with_it(name, dataset, dataset_path):
    dataset_path(datasets.entry(name).truth)
    instance = dataset(name)
    assert instance.name == name
    angles = Quadratic(instance.graph).residual_angles(instance.truth)
    # Truth of another graph, or in another frame, would leave right angles.
    assert np.median(angles) < np.deg2rad(10)


def test_truth_in_part_is_asked_for(dataset, dataset_path):
    dataset_path("Ellis_Island_truth")
    instance = dataset("Ellis_Island")
    nodes, estimate = datasets.truth("Ellis_Island", instance)
    assert instance.truth is None
    assert (len(nodes), estimate.num_nodes) == (227, 227)


def test_most_datasets_have_no_truth(dataset):
    assert datasets.truth("tinyGrid3D", dataset("tinyGrid3D")) is None

"""States of Cartographer, whose messages are encoded by hand."""

import gzip
import struct

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, io
from reports.studies._containers import MAGIC, constraint, message, state

CYCLE = [
    constraint((0, 0), (0, 0), 0.0),
    constraint((0, 0), (0, 1), 1.0),
    constraint((0, 1), (0, 1), 0.0),
    constraint((0, 1), (0, 0), -1.1, tag=1),
]


@pytest.mark.parametrize("indexed", [True, False])
def test_constraints_are_a_planar_graph(tmp_path, indexed):
    """Four steps that miss by 0.1 m, each weighed 10: 10^2 0.1^2 / 4."""
    path = tmp_path / "map.pbstream"
    path.write_bytes(state(CYCLE, indexed=indexed))
    instance = io.read(path, quiet=True)
    assert instance.names == ("node0/0", "node0/1", "submap0/0", "submap0/1")
    assert instance.graph.d == 2
    assert instance.times_ns[:2].tolist() == [1644823128500000000, 1644823129500000000]
    assert instance.graph.information_matrices[0].tolist() == np.diag([100.0, 100, 400]).tolist()
    assert instance.initial.translations[:, 0].tolist() == [0, 1, 0, 1]
    assert "1 loop closure, without Huber's loss" in instance.notices[-1]
    assert "weights from the file's square roots of information" in str(instance)
    answer = certpgo.solve(instance)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(0.25, rel=1e-9)


def test_in_space(tmp_path):
    path = tmp_path / "map.pbstream"
    turned = {"z": 0.5, "q": (0.6, 0.0, 0.0, 0.8)}
    path.write_bytes(state([*CYCLE[1:], constraint((0, 0), (0, 0), 0.25, **turned)]))
    instance = io.read(path, quiet=True)
    assert instance.graph.d == 3
    np.testing.assert_allclose(instance.graph.rotations[-1][1, 2], -0.96, atol=1e-15)
    assert instance.graph.translations[-1].tolist() == [0.25, 0.0, 0.5]
    assert instance.graph.tau.tolist() == [100.0] * 4


def test_the_trajectory_is_an_estimate(tmp_path):
    path = tmp_path / "map.pbstream"
    path.write_bytes(state([]))
    estimate = io.read_estimate(path)
    assert estimate.keys.times_ns.tolist() == [1644823128500000000, 1644823129500000000]
    assert estimate.translations[:, 0].tolist() == [0.0, 1.0]
    with pytest.raises(FormatError, match="no constraints: this state has poses alone"):
        io.read(path)


def test_damage_is_one_line(tmp_path):
    path, whole = tmp_path / "map.pbstream", state(CYCLE)
    after = 8 + len(gzip.compress(message(f3=b"")))  # what follows the graph is not read
    for end in range(8, len(whole) - after, 7):
        path.write_bytes(whole[:end])
        with pytest.raises(FormatError, match=r"damaged|no pose graph"):
            io.read(path)
    rng = np.random.default_rng(0)
    graph = message(f1=message(f2=CYCLE, f4=b""))
    for _ in range(200):
        spoiled = bytearray(graph)
        spoiled[rng.integers(len(graph))] = rng.integers(256)
        record = gzip.compress(bytes(spoiled))
        path.write_bytes(MAGIC + struct.pack("<Q", len(record)) + record)
        try:
            io.read(path, quiet=True)
        except certpgo.errors.CertPGOError:
            continue

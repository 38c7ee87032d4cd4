"""Databases of rtabmap."""

import sqlite3
from contextlib import closing, suppress

import numpy as np
import pytest

import certpgo
from certpgo import FormatError, io
from certpgo.linalg import rotations as so

NODE = "CREATE TABLE Node (id INTEGER PRIMARY KEY, map_id INTEGER, stamp FLOAT, pose BLOB)"
LINK = (
    "CREATE TABLE Link (from_id INTEGER, to_id INTEGER, type INTEGER, "
    "information_matrix BLOB, transform BLOB)"
)
FULL = np.diag([100.0, 100, 100, 400, 400, 400])
SLAC = np.diag([4.0, 4, 4, 1e-5, 1e-5, 1e-5])
QUARTER = so.exp(np.array([[0.0, 0, np.pi / 2]]))[0]


def pose(x, y, R=None):
    return np.column_stack([np.eye(3) if R is None else R, [x, y, 0]]).astype("<f4").tobytes()


def link(i, j, transform, information=FULL, kind=0):
    return i, j, kind, np.asarray(information).tobytes(), transform


@pytest.fixture
def database(tmp_path):
    """Writes a database of poses (id, stamp, pose) and links, and returns its path."""

    def write(nodes, links, table=LINK):
        path = tmp_path / "rtabmap.db"
        path.unlink(missing_ok=True)
        with closing(sqlite3.connect(path)) as made, made:
            made.execute(NODE)
            made.execute(table)
            made.executemany("INSERT INTO Node VALUES (?, 0, ?, ?)", nodes)
            made.executemany("INSERT INTO Link VALUES (?, ?, ?, ?, ?)", links)
        return path

    return write


NODES = [(1, 1644823128.5, pose(0, 0)), (2, 1644823129.25, pose(1, 0)), (5, 2e9, pose(2, 0))]
LINKS = [link(1, 2, pose(1, 0)), link(2, 5, pose(1, 0)), link(1, 5, pose(2.1, 0), kind=1)]


def test_a_graph_with_times(database):
    """Three steps of 1, 1 and 2.1 m leave 3 (100 / 30^2)."""
    instance = io.read(database(NODES, LINKS), quiet=True)
    assert instance.ids.tolist() == [1, 2, 5]
    assert instance.times_ns.tolist() == [1644823128500000000, 1644823129250000000, 2 * 10**18]
    assert instance.graph.kappa.tolist() == [200.0] * 3
    np.testing.assert_array_equal(instance.initial.translations[:, 0], [0, 1, 2])
    off = float(np.float32(2.1)) - 2.0
    assert certpgo.solve(instance).cost == pytest.approx(100 * off**2 / 3, rel=1e-9)
    poses = io.read_estimate(instance.source)
    assert poses.keys.ids.tolist() == [1, 2, 5]
    assert poses.keys.times_ns.tolist() == instance.times_ns.tolist()


def test_links_stored_at_both_nodes_count_once(database):
    turned = pose(1, 2, QUARTER)
    back = pose(-2, 1, QUARTER.T)
    links = [link(1, 2, turned), link(2, 1, back), link(2, 1, back), link(1, 2, turned, kind=1)]
    instance = io.read(database(NODES[:2], links), quiet=True)
    assert instance.graph.edges.tolist() == [[0, 1], [0, 1]]
    np.testing.assert_allclose(instance.graph.rotations[0], QUARTER, atol=1e-7)
    assert "2 links stored again in reverse left out" in instance.notices


def test_priors_and_what_is_skipped(database):
    priors = [link(1, 1, pose(10, 0)), link(5, 5, pose(12, 1, QUARTER), SLAC)]
    others = [link(1, -3, pose(1, 1), kind=8), link(2, 2, pose(0, 0), kind=9)]
    links = LINKS + [(i, j, 7, *rest) for i, j, _, *rest in priors] + others
    instance = io.read(database(NODES, links), quiet=True)
    assert instance.world == 3
    graph = instance.graph
    assert graph.edges[3:].tolist() == [[3, 0], [3, 2]]
    assert graph.kappa[3:].tolist() == [200.0, 0.0]
    assert graph.tau[3:].tolist() == [100.0, 4.0]
    assert "1 sighting of landmarks skipped" in instance.notices
    assert "1 measurement of gravity skipped" in instance.notices
    without = io.read(instance.source, priors=False, quiet=True)
    assert without.world is None
    assert "2 priors of poses skipped" in without.notices


@pytest.mark.parametrize(
    ("links", "said"),
    [
        ([], "no links between poses"),
        ([link(1, 2, b"short")], "link 1 to 2: transform: 12 numbers of single precision"),
        ([link(1, 2, None)], "link 1 to 2: no transform"),
        ([link(1, 1, pose(1, 0))], "link 1 to 1 is measured from itself"),
        ([link(1, 2, pose(1, 0, 2 * np.eye(3)))], "link 1 to 2: nine numbers of a rotation"),
        ([link(1, 2, pose(np.nan, 0))], "link 1 to 2: transform: finite"),
        ([link(1, 2, pose(1, 0), -FULL)], "link 1 to 2: .*not positive definite"),
        ([*LINKS, link(9, 9, pose(1, 0), kind=7)], "prior of node 9, which no link joins"),
    ],
)
def test_what_cannot_be_read_is_named(database, links, said):
    with pytest.raises(FormatError, match=said):
        io.read(database(NODES, links))


def test_older_databases_are_named(database):
    old = LINK.replace("information_matrix", "variance")
    with pytest.raises(FormatError, match="information_matrix, transform in table Link"):
        io.read(database(NODES, LINKS, old))


def test_damaged_databases_are_refused_or_read(database):
    rng = np.random.default_rng(5)
    path = database(NODES, LINKS)
    whole = path.read_bytes()
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[rng.integers(0, len(damaged))] = rng.integers(256)
        path.write_bytes(bytes(damaged[: rng.integers(100, len(damaged) + 1)]))
        with suppress(FormatError):
            io.read(path, quiet=True)


def test_gps_records_are_named(database):
    """rtabmap has them in the nodes, and priors in links."""
    path = database(NODES, LINKS)
    with closing(sqlite3.connect(path)) as made, made:
        made.execute("ALTER TABLE Node ADD COLUMN gps BLOB")
    assert not any("GPS" in notice for notice in io.read(path, quiet=True).notices)
    with closing(sqlite3.connect(path)) as made, made:
        made.execute("UPDATE Node SET gps = ? WHERE id < 5", (np.ones(6).tobytes(),))
    said = "2 GPS records of nodes not read: positions are taken from links, as priors"
    assert said in io.read(path, quiet=True).notices

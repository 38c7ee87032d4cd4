"""Whatever the bytes of a file, its reader gives an answer or one line that names the file."""

import gzip
import json
import sqlite3
import struct
import time
import zipfile
import zlib
from contextlib import closing
from io import BytesIO

import numpy as np
import pytest
from numpy.lib import format as npy
from scipy import io as matlab
from scipy import sparse

from certpgo import io
from certpgo.errors import FormatError
from certpgo.io import compressed
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.io.matlab import sparse_pattern
from certpgo.io.stream import piped
from certpgo.io.timestamps import node_times
from certpgo.registration.scans import read_scan
from reports.studies import _containers

#: Of the benchmark, which reads 100,000.
SAMPLE = 350


def test_a_sample_of_the_benchmark(tmp_path):
    from reports.studies import fuzz_readers as fuzz

    tally, fuzzer = fuzz.Tally(), fuzz.Fuzzer(15, fuzz.samples(), tmp_path)
    for number in range(SAMPLE):
        fuzzer.judge(number, tally)
    assert tally.failures == []
    outcomes = {outcome for _, outcome in tally.files}
    assert outcomes == {"read", "refused"}


def refused(path, said, read=io.read):
    with pytest.raises(FormatError) as caught:
        read(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


# --- .mat -----------------------------------------------------------------------------------------

A = np.triu(np.ones((4, 4)), 1)


def element(kind, content, order="<"):
    return struct.pack(f"{order}II", kind, len(content)) + content + bytes(-len(content) % 8)


def mat(rows, starts, *, values=None, dims=(4, 4), flags=5, order="<", compress=False):
    """A MATLAB 5 file of one sparse matrix."""
    values = np.ones(len(rows)) if values is None else values
    parts = [
        element(6, struct.pack(f"{order}II", flags, len(rows)), order),
        element(5, struct.pack(f"{order}{len(dims)}i", *dims), order),
        element(1, b"A", order),
        element(5, np.array(rows, f"{order}i4").tobytes(), order),
        element(5, np.array(starts, f"{order}i4").tobytes(), order),
        element(9, np.array(values, f"{order}f8").tobytes(), order),
    ]
    matrix = element(14, b"".join(parts), order)
    if compress:
        packed = zlib.compress(matrix)
        matrix = struct.pack(f"{order}II", 15, len(packed)) + packed
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(f"{order}H", 0x100)
    return header + (b"IM" if order == "<" else b"MI") + matrix


ROWS, STARTS = [0, 0, 1, 0, 1, 2], [0, 0, 1, 3, 6]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compress", [False, True])
def test_a_sparse_matrix_in_either_byte_order(tmp_path, order, compress):
    path = tmp_path / "g.mat"
    path.write_bytes(mat(ROWS, STARTS, order=order, compress=compress))
    pattern = sparse_pattern(path)
    assert pattern.shape == (4, 4)
    assert np.array_equal(np.stack([pattern.rows, pattern.columns]), np.nonzero(A.T)[::-1])


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("dtype", [np.float64, np.bool_])
def test_what_scipy_writes_is_read(tmp_path, compress, dtype):
    rng = np.random.default_rng(0)
    wanted = sparse.random_array((40, 40), density=0.1, rng=rng, format="csc").astype(dtype)
    path = tmp_path / "g.mat"
    matlab.savemat(path, {"a long name of a matrix": wanted}, do_compression=compress)
    pattern = sparse_pattern(path)
    found = sparse.coo_array(
        (np.ones(len(pattern.rows)), (pattern.rows, pattern.columns)), (40, 40)
    )
    assert ((found.toarray() != 0) == (wanted.toarray() != 0)).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rows": [0, 0, 1, 0, 1, 4]}, "damaged MATLAB 5 file (row indices)"),
        ({"rows": [0, 0, 1, 0, 1, -1]}, "(row indices)"),
        ({"starts": [0, 0, 1 << 30, 3, 6]}, "(compressed columns)"),
        ({"starts": [0, 3, 1, 3, 6]}, "(compressed columns)"),
        ({"starts": [1, 1, 1, 3, 6]}, "(compressed columns)"),
        ({"starts": [0, 0, 1, 3, 7]}, "(compressed columns)"),
        ({"starts": [0, 0, 1, 3, -1]}, "(compressed columns)"),
        ({"starts": [0, 0, 1, 3]}, "(compressed columns)"),
        ({"starts": []}, "(compressed columns)"),
        ({"values": [1.0]}, "(compressed columns)"),
        ({"dims": (4, 2**31 - 1)}, "(compressed columns)"),
        ({"dims": (-1, 4)}, "(a sparse matrix)"),
        ({"dims": (4, 4, 4)}, "(a sparse matrix)"),
        ({"dims": (5, 4)}, "a square adjacency matrix expected, not (5, 4)"),
        ({"flags": 6}, "one sparse adjacency matrix expected"),
        ({"flags": 5 | 0x800}, "one sparse adjacency matrix expected"),
    ],
)
@pytest.mark.parametrize("compress", [False, True])
def test_a_damaged_sparse_matrix(tmp_path, changes, said, compress):
    # SciPy 1.17 writes out of bounds for some of these, and Python dies.
    path = tmp_path / "g.mat"
    path.write_bytes(mat(**{"rows": ROWS, "starts": STARTS, "compress": compress} | changes))
    refused(path, said)


def test_mat_files_of_other_things(tmp_path):
    path = tmp_path / "g.mat"
    two = {"A": sparse.csc_array(A), "B": sparse.csc_array(A)}
    for variables in ({"A": A}, two, {"A": {"B": A}}, {}):
        matlab.savemat(path, variables)
        refused(path, "one sparse adjacency matrix expected")
    whole = mat(ROWS, STARTS)
    path.write_bytes(whole[:-8])
    refused(path, "(an element's size)")
    path.write_bytes(whole[:150])
    refused(path, "MATLAB 5 file")
    path.write_bytes(whole[:126] + b"XX" + whole[128:])
    refused(path, "not a readable MATLAB 5 file")


# --- .npz -----------------------------------------------------------------------------------------


@pytest.fixture
def graph(tmp_path):
    """A graph's archive, and its arrays."""
    path = tmp_path / "g.npz"
    io.write(path, winding_cycle(5, 0.1, 0)[0])
    with np.load(path) as archive:
        return path, dict(archive)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("version", np.array([1, 1]), "one graph (version 1) expected, not something else"),
        ("version", np.array("1"), "one graph (version 1) expected, not something else"),
        ("num_nodes", np.arange(2), "'num_nodes' must be integers of shape ()"),
        ("num_nodes", np.array(10**18), "ids must be"),
        ("edges", np.zeros((5, 2)), "'edges' must be integers of shape (5, 2), not float64"),
        ("edges", np.arange(10), "'edges' must be integers"),
        ("rotations", np.zeros((5, 3, 3), dtype=complex), "'rotations' must be floating-point"),
        (
            "rotations",
            np.zeros((4, 3, 3)),
            "'rotations' must be floating-point numbers of shape (5, ",
        ),
        ("kappa", np.zeros((5, 1)), "'kappa' must be floating-point numbers of shape (5,)"),
        ("kappa", np.zeros(5, dtype=[("a", "f8")]), "'kappa' must be"),
        ("ids", np.zeros(5, dtype="M8[s]"), "'ids' must be integers"),
        ("fixed", np.array(3), "'fixed' must be integers"),
        ("fixed", np.array([7]), "fixed nodes are numbered 0 to 4"),
        ("options", np.array("[1]"), "'options' must hold strings"),
        ("options", np.array('{"keep": 1}'), "'options' must hold strings"),
        ("options", np.array("[" * 100_000), "'options' must hold strings"),
        ("notices", np.array("7"), "'notices' must hold strings"),
        ("tau", np.ones(5), "'translations' is missing"),
        ("name", np.array("\udcff"), "an archive of plain NumPy arrays expected"),
    ],
)
def test_npz_arrays_of_another_kind(graph, name, value, said):
    path, arrays = graph
    np.savez(path, **arrays | {name: value})
    refused(path, said)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"information": np.ones((1, 3, 2))}, "'information' must be floating-point"),
        ({"information": np.ones((1, 3, 3), dtype=int)}, "'information' must be floating-point"),
        ({"information": np.ones((1, 6, 6))}, "information must be (3, 3, 3), a matrix per edge"),
        ({"information": np.full((1, 3, 3), np.nan)}, "information must be finite"),
        ({"information": np.triu(np.ones((1, 3, 3)))}, "information matrices must be symmetric"),
        ({"information_index": np.zeros(2, dtype=int)}, "'information_index' must be integers"),
        ({"information_index": np.array([0, 1, 0])}, "information matrices are numbered 0 to 0"),
        ({"information_index": None}, "the array 'information_index' is missing"),
        ({"translations": None, "tau": None}, "this graph measures rotations"),
    ],
)
def test_npz_information_of_another_kind(tmp_path, changed, said):
    source, path = tmp_path / "g.g2o", tmp_path / "g.npz"
    edges = ((0, 1), (1, 2), (2, 0))
    source.write_text("".join(f"EDGE_SE2 {i} {j} 1 0 2 3 1 0 3 0 3\n" for i, j in edges))
    io.write(path, io.read(source))
    with np.load(path) as archive:
        arrays = dict(archive) | changed
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    refused(path, said)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("version", np.array([1, 1])),
        ("ids", np.array(3)),
        ("ids", np.zeros(5)),
        ("rotations", np.array(1.0)),
        ("translations", np.array("far")),
    ],
)
def test_npz_estimates_of_another_kind(tmp_path, name, value):
    path = tmp_path / "e.npz"
    io.write(path, winding_cycle(5, 0.1, 0)[0].truth)
    with np.load(path) as archive:
        np.savez(path, **dict(archive) | {name: value})
    refused(path, "", io.read_estimate)


def repacked(path, **changed):
    """The archive with other bytes for some of its arrays."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members |= {f"{name}.npy": content for name, content in changed.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def headed(shape, dtype="<f8"):
    stream = BytesIO()
    npy.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": dtype})
    return stream.getvalue()


@pytest.mark.parametrize("shape", [(10**12, 9), (-1,), (2**62, 2**62), (6,)])
def test_an_array_is_as_large_as_its_shape_says(graph, shape):
    path, _ = graph
    repacked(path, kappa=headed(shape) + bytes(40))
    refused(path, "an archive of plain NumPy arrays expected")


def test_arrays_by_columns_are_read(graph):
    path, arrays = graph
    np.savez(path, **arrays | {"edges": np.asfortranarray(arrays["edges"])})
    assert np.array_equal(io.read(path).graph.edges, arrays["edges"])


# --- What expands ---------------------------------------------------------------------------------


@pytest.fixture
def small(monkeypatch):
    """A limit that small files reach."""
    monkeypatch.setattr(compressed, "SMALL", 1 << 16)


def test_an_archive_out_of_proportion(graph, small):
    path, _ = graph
    repacked(path, kappa=headed((1 << 20,)) + bytes(8 << 20))
    refused(path, "expands to 8 MB, out of proportion to its size")


def test_an_archive_that_hides_its_size(graph, small):
    path, _ = graph
    repacked(path, kappa=headed((5,)) + bytes(8 << 20))
    with zipfile.ZipFile(path) as archive:
        wrong = archive.getinfo("kappa.npy").file_size
    small_size = struct.pack("<I", len(headed((5,))) + 40)
    path.write_bytes(path.read_bytes().replace(struct.pack("<I", wrong), small_size))
    refused(path, "an archive of plain NumPy arrays expected")


@pytest.mark.parametrize(("size", "said"), [(8 << 20, "out of proportion"), (64, "damaged")])
def test_a_matrix_out_of_proportion(tmp_path, small, size, said):
    path = tmp_path / "g.mat"
    packed = zlib.compress(struct.pack("<II", 14, size) + bytes(8 << 20))
    path.write_bytes(mat(ROWS, STARTS)[:128] + struct.pack("<II", 15, len(packed)) + packed)
    refused(path, said)


# --- Text -----------------------------------------------------------------------------------------

EDGE = b"EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1"


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (EDGE + b"\n" + EDGE + b"\r", 2, "a carriage return within a line"),
        (EDGE + b"\r" + EDGE + b"\n", 1, "a carriage return within a line"),
        (b"# of old\r\n" + EDGE + b" # a\rb\n", 2, "a carriage return within a line"),
        (EDGE + b"\n\n" + EDGE + b"\x0b\n", 3, "the character 0x0b within a line"),
        (EDGE + b"\r\r\n", 1, "a carriage return within a line"),
    ],
)
def test_control_characters_are_refused_with_their_line(tmp_path, text, line, said):
    path = tmp_path / "g.g2o"
    path.write_bytes(text)
    refused(path, f":{line}: {said}")


def test_control_characters_are_found_across_chunks(tmp_path, monkeypatch):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 50)
    path = tmp_path / "g.g2o"
    path.write_bytes((EDGE + b"\r\n") * 9 + EDGE + b"\r" + EDGE + b"\n")
    refused(path, ":10: a carriage return")
    path.write_bytes((EDGE + b"\r\n") * 9)
    assert io.read(path, quiet=True).graph.num_edges == 9


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("9" * 5000 + " 4\n", ""),
        ("0 0\n", ""),
        ("3 0\n\n\n\n", "expected 3 rows"),
        (f"1 {10**15}\n1 2 3\n", "expected 1000000000000000 numbers, not 3"),
        ("1 four\n", "expected numbers"),
        ("1\n", "expected 2 numbers"),
    ],
)
def test_the_first_line_of_an_iterate(file, text, said):
    path = file(text, "Y.txt")
    refused(path, said, lambda p: io.read_estimate(p, format="iterate"))


def test_a_folder_is_no_file_of_poses(tmp_path):
    refused(tmp_path, "a tum file expected", lambda p: io.read_estimate(p, format="tum"))


def test_underscores_are_no_digits(file):
    path = file("0 1 " + "1 0 0 0 1 0 0 0 1 " + "0 0 1_0\n", "EGs.txt")
    refused(path, ":1: i j, 9 numbers")


def test_a_tag_of_any_bytes_is_skipped_with_a_notice(tmp_path):
    path = tmp_path / "g.g2o"
    path.write_bytes(b"VERTEX_\xff 0 1 2\n" + EDGE + b"\n")
    instance = io.read(path, quiet=True)
    assert instance.graph.num_edges == 1
    assert any(r"VERTEX_\xff line skipped" in said for said in instance.notices)


def test_a_time_beyond_memory_is_refused(file):
    path = file("#timestamp,x,y,z,qw,qx,qy,qz\n1e999999999999999999,0,0,0,1,0,0,0\n", "a.csv")
    refused(path, ":2: timestamps in seconds expected", io.read_estimate)
    path = file("#timestamp,x,y,z,qw,qx,qy,qz\n1e999999999,0,0,0,1,0,0,0\n", "a.csv")
    refused(path, ":2: timestamps in seconds expected", io.read_estimate)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"extrinsics": "KEY", "views": []}, "extrinsics with key"),
        ({"extrinsics": "DIGITS", "views": []}, "numbers of fewer digits"),
    ],
)
def test_keys_of_json_that_are_no_ids(file, content, said):
    value = {"rotation": np.eye(3).tolist(), "center": [0, 0, 0]}
    text = json.dumps({"sfm_data_version": "0.3", **content})
    for key in ("Infinity", str(10**30)) if said.startswith("extr") else ("9" * 5000,):
        entry = f'[{{"key": {key}, "value": {json.dumps(value)}}}]'
        path = file(text.replace('"KEY"', entry).replace('"DIGITS"', entry), "sfm_data.json")
        refused(path, said, io.read_estimate)


# --- SQLite ---------------------------------------------------------------------------------------

ENDLESS = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT"


def changed(tmp_path, name, *statements):
    path = tmp_path / "g.db"
    path.write_bytes(_containers.databases()[name])
    with closing(sqlite3.connect(path)) as made, made:
        for statement in statements:
            made.execute(statement)
    return path


@pytest.mark.parametrize(
    ("name", "statements", "said"),
    [
        (
            "colmap database",
            [
                "DROP TABLE two_view_geometries",
                f"CREATE VIEW two_view_geometries AS {ENDLESS} x AS pair_id, x AS rows, "
                "2 AS config, x AS qvec, x AS tvec FROM c",
            ],
            "two_view_geometries is a view",
        ),
        (
            "rtabmap",
            ["DROP TABLE Node", f"CREATE VIEW Node AS {ENDLESS} x AS id, x AS stamp FROM c"],
            "Node is a view",
        ),
        ("colmap database", ["UPDATE two_view_geometries SET rows = -5"], "not -5"),
        ("colmap database", ["UPDATE two_view_geometries SET rows = 'many'"], "not 'many'"),
        ("colmap database", ["UPDATE images SET name = NULL"], "texts expected as name"),
        ("rtabmap", ["UPDATE Link SET type = 'a'"], "integers expected as type, not 'a'"),
        ("rtabmap", ["UPDATE Node SET id = -1 WHERE id = 3", "DROP TABLE Link"], "no known format"),
        (
            "rtabmap",
            ["ALTER TABLE Link ADD COLUMN big AS (zeroblob(1 << 29))"],
            "",
        ),
    ],
)
def test_databases_of_other_things(tmp_path, name, statements, said):
    path = changed(tmp_path, name, *statements)
    if said:
        refused(path, said)
    else:
        assert io.read(path, quiet=True).graph.num_edges == 4


def test_a_database_whose_nodes_have_no_poses(tmp_path):
    path = changed(tmp_path, "rtabmap", "DELETE FROM Node")
    assert io.read(path, quiet=True).initial is None
    refused(path, "table Node: at least one pose expected", io.read_estimate)


def test_the_steps_of_a_query_are_bounded(tmp_path, monkeypatch):
    # A column that is computed may take any time.
    path = changed(
        tmp_path,
        "rtabmap",
        "ALTER TABLE Link RENAME COLUMN transform TO stored",
        "ALTER TABLE Link ADD COLUMN transform AS (hex(zeroblob(length(stored) << 20)))",
    )
    refused(path, "a database of rtabmap expected")
    for name in ("_PER_BYTE", "_STEP"):
        monkeypatch.setattr(f"certpgo.io.sqlite.{name}", int(name == "_STEP"))
    refused(changed(tmp_path, "rtabmap"), "interrupted")


# --- What expands, as text ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "begin", "more"),
    [
        ("g.g2o.gz", EDGE + b"\n", b"# " + b"a" * 998 + b"\n"),
        ("g.jrl.gz", b'{"robots": [], "measurements": "', b"a" * 1000),
        ("times.txt.gz", b"1\n", b"# " + b"a" * 998 + b"\n"),
    ],
)
def test_compressed_text_out_of_proportion(tmp_path, small, name, begin, more):
    path = tmp_path / name
    path.write_bytes(gzip.compress(begin + more * 4000))
    if name.startswith("times"):
        refused(path, "out of proportion", node_times)
    else:
        refused(path, "out of proportion")


def test_a_line_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr("certpgo.io.chunks._CHUNK_BYTES", 50)
    monkeypatch.setattr("certpgo.io.chunks.LONGEST_LINE", 100)
    path = tmp_path / "g.g2o"
    path.write_bytes(EDGE + b"\n" + EDGE + b" " * 200)
    refused(path, ":2: lines of at most")


def test_json_that_takes_too_much_memory(file, monkeypatch):
    path = file('{"class_name": "PoseGraph", "nodes": [' + "[]," * 20_000 + "[]]}", "g.json")
    refused(path, "nodes[0]: an object expected")
    monkeypatch.setattr("certpgo.io.json_files._SMALL", 1 << 20)
    monkeypatch.setattr("certpgo.io.json_files.RATIO", 10)
    refused(path, "in memory, out of proportion")


def test_states_out_of_proportion(tmp_path, small, monkeypatch):
    path = tmp_path / "m.pbstream"
    message = _containers.message
    path.write_bytes(_containers.records([message(f1=message(f9=bytes(8 << 20)))]))
    refused(path, "out of proportion")
    monkeypatch.setattr("certpgo.io.formats.pbstream._FEW", 100)
    many = message(f1=message(f2=[b""] * 20_000))  # they compress to nearly nothing
    path.write_bytes(_containers.records([many]))
    refused(path, "this is damaged")


@pytest.mark.parametrize("changes", [{"f1": 2**64 - 1}, {"f1": 1}, {"f1": b"x"}, {"f5": 3}])
def test_states_of_other_values(tmp_path, changes):
    path, message = tmp_path / "m.pbstream", _containers.message
    ends = {"f1": message(f1=0, f2=0), "f2": message(f1=0, f2=0)}
    constraint = message(**ends, f3=_containers.rigid(1.0), f6=10.0, f7=20.0)
    node = message(**{"f1": _containers.TICKS, "f5": _containers.rigid(0.0), **changes})
    graph = message(f2=constraint, f4=message(f1=node, f2=message(f1=_containers.rigid(0.0))))
    path.write_bytes(_containers.records([message(f1=graph)]))
    refused(path, "timestamps expected of the years" if changes == {"f1": 1} else "damaged")


def test_many_sensors_take_time_in_proportion(file):
    """One sensor for each of 20,000 sightings: as the body's own, in a few array operations."""
    n = 20_000
    sensors = "".join(f"PARAMS_SE3OFFSET {k} {k} 0 0 0 0 0 1\n" for k in range(n))
    seen = "".join(f"EDGE_SE3_TRACKXYZ 0 {k + 9} {k} 1 0 0\n" for k in range(n))
    start = time.process_time()
    graph = io.read(file(sensors + seen), quiet=True).graph
    assert time.process_time() - start < 3.0  # a loop over sensors and sightings takes a minute
    assert (graph.translations == np.arange(n)[:, None] * [1, 0, 0] + [1, 0, 0]).all()


# --- Scans ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        ("pcd binary", "POINTS 3", "POINTS -1", "counts of at least 1"),
        ("pcd binary", "COUNT 1 1 1", "COUNT 0 0 0", "counts of at least 1"),
        ("pcd binary", "POINTS 3", f"POINTS {10**12}", f"{10**12} points announced, 3 found"),
        ("vtk", "POINTS 3", "POINTS 99999999999999999999", "points announced, 3 found"),
        ("vtk", "POINTS 3", "POINTS " + "9" * 5000, "POINTS n float or double expected"),
        ("pcd", "SIZE 4 4 4", "SIZE 1 4 4", "data type"),
        ("vtk binary", "POINTS 3", "POINTS 99999999999999999999", "points announced, 3 found"),
    ],
)
def test_counts_of_points_that_are_not_there(tmp_path, name, old, new, said):
    path = tmp_path / f"scan.{name.split()[0]}"
    path.write_bytes(_containers.scans()[name].replace(old.encode(), new.encode()))
    refused(path, said, read_scan)


def test_a_stream_without_line_ends(monkeypatch):
    monkeypatch.setattr("certpgo.io.stream.LONGEST_LINE", 100)
    with pytest.raises(FormatError, match="standard input:2: lines of at most"):
        list(piped(BytesIO(EDGE + b"\n" + b"EDGE_SE2 0 1 " + b"0" * 20_000), 5))

"""certpgo sparsify and suggest: loop closures chosen, and those that are missing."""

import json
from dataclasses import replace

import numpy as np
import pytest

import certpgo as package
from certpgo.io.datasets.synthetic import helix


@pytest.fixture
def path(tmp_path):
    """The g2o file of a helix."""
    path = tmp_path / "helix.g2o"
    package.write(path, helix(6, np.random.default_rng(0)))
    return path


def test_the_sparse_graph_is_written_with_its_estimate(certpgo, path, tmp_path):
    out = tmp_path / "sparse.g2o"
    done = certpgo("sparsify", path, "--keep", "25%", "-o", out)
    assert done.code == 0
    assert "loop closures kept; the sparse graph is CERTIFIED. " in done.out
    again = package.read(out)
    best = package.solve(again)
    assert package.certify(again, again.initial).cost_upper == pytest.approx(best.cost)
    data = json.loads(certpgo("sparsify", path, "--keep", "0.25", "--json").out)
    assert len(data["kept"]) == round(0.25 * data["loop_closures"])
    assert data["sparse"]["cost"] == pytest.approx(best.cost)
    assert data["connectivity"] <= data["connectivity_bound"]
    assert data["cost_of_all"] >= data["whole"]["lower_bound"]
    assert len(json.loads(certpgo("sparsify", path, "--keep", "7", "--json").out)["kept"]) == 7
    data = json.loads(certpgo("sparsify", path, "--keep", "7", "--by", "spectrum", "--json").out)
    assert (data["by"], len(data["kept"])) == ("spectrum", 7)
    assert certpgo("sparsify", path, "--keep", "7", "--by", "colour").code == 2


@pytest.mark.parametrize(
    ("keep", "message"),
    [
        ("x", "'x' is not a number, a fraction or a percentage"),
        ("150%", "the fraction of loop closures must be in"),
        ("100000", "loop closures can be kept, not 100000"),
    ],
)
def test_wrong_amounts_are_one_line(certpgo, path, keep, message):
    done = certpgo("sparsify", path, "--keep", keep)
    assert done.code in (1, 2)
    assert message in " ".join(done.err.replace("│", " ").split())
    assert "Traceback" not in done.err


def test_suggestions_name_the_nodes(certpgo, path):
    data = json.loads(certpgo("suggest", path, "-n", 3, "--json").out)
    values = [data["connectivity"], *(one["connectivity"] for one in data["suggested"])]
    assert len(values) == 4
    assert values == sorted(values)
    done = certpgo("suggest", path, "-n", 3)
    i, j = data["suggested"][0]["ids"]
    assert f"{i}-{j}" in done.out
    assert "3 loop closures would raise the connectivity" in done.out
    assert certpgo("suggest", path, "--within", "1e-9").code == 1


def test_distances_are_said_not_to_count(certpgo, tmp_path):
    graph = tmp_path / "beacon.pyfg"
    poses = [f"VERTEX_SE2 {i} A{i} {6 * i} 0 0" for i in range(4)]
    steps = [f"EDGE_SE2 {i} A{i} A{i + 1} 6 0 0 1 0 0 1 0 1" for i in range(3)]
    graph.write_text("\n".join([*poses, *steps, "EDGE_RANGE 1 A0 A3 16 1"]) + "\n")
    done = certpgo("suggest", graph, "-n", 1)
    assert done.code == 0
    assert "connectivity is that of relative poses, without 1 distance\n" in done.err


def poses_of(path, nodes):
    """The words of the vertices of some nodes."""
    lines = (line.split() for line in path.read_text().splitlines())
    return {int(w[1]): w[2:] for w in lines if w[0].startswith("VERTEX") and int(w[1]) in nodes}


@pytest.mark.parametrize(("fixed", "kept"), [((), (0,)), ((7,), (7,)), ((3, 20), (3, 20))])
def test_the_sparse_graph_is_in_the_frame_of_its_file(certpgo, tmp_path, fixed, kept):
    """The first node is where the file has it, or what it fixes."""
    made = helix(6, np.random.default_rng(0))
    moved = made.truth.moved(np.eye(3)[[1, 2, 0]], [5.0, -2.0, 1.0])
    path, out = tmp_path / "framed.g2o", tmp_path / "sparse.g2o"
    package.write(path, replace(made, initial=moved, fixed=fixed))
    done = certpgo("sparsify", path, "--keep", "50%", "-o", out, "--json")
    fixes = [line for line in out.read_text().splitlines() if line.startswith("FIX")]
    assert fixes == [f"FIX {k}" for k in fixed]
    there, here = (poses_of(file, kept) for file in (path, out))
    for node in kept:
        found, stated = (np.array(one[node], dtype=float) for one in (here, there))
        np.testing.assert_allclose(found, stated, atol=1e-12 if len(fixed) < 2 else 1e-15)
    again = package.read(out, quiet=True)
    cost = done.json["sparse"]["cost"]
    assert package.solve(again).cost == pytest.approx(cost, rel=1e-9)
    initial = package.certify(again, again.initial)
    assert initial.cost_upper == pytest.approx(cost, rel=1e-6)


#: Two maps of a square each in their own frames, measurements between them, one of them wrong.
STEP = "EDGE_SE2 {} {} {} {} {} 1e4 0 0 1e4 0 1e4\n".format
SQUARE = "".join(STEP(k, (k + 1) % 4, 1 + 0.01 * k, 0, 1.5707963) for k in range(4))
JOINTS = STEP(0, 100, 0, 3, 0) + STEP(1, 102, 5, 5, 2) + STEP(1, 101, 3, 0, 0)
JOINTS += STEP(2, 102, 0, -3, 0) + STEP(3, 103, -3, 0, 0)


@pytest.fixture
def maps(tmp_path):
    """The files of two maps and of the measurements between them."""
    texts = {
        "a": SQUARE + "".join(f"VERTEX_SE2 {k} {k} 7 0.5\n" for k in range(4)) + "FIX 2\n",
        "b": SQUARE + "".join(f"VERTEX_SE2 {k} {k} -9 3\n" for k in range(4)) + "FIX 0\n",
        "joints": JOINTS,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.g2o").write_text(text)
    return [tmp_path / f"{name}.g2o" for name in texts]


def test_merged_maps_are_written_without_what_was_left_out(certpgo, maps, tmp_path):
    first, second, joints = maps
    out = tmp_path / "both.g2o"
    chosen = (first, second, "--between", joints, "--offset", 100, "-o", out, "--json")
    done = certpgo("merge", *chosen, "--robust")
    left_out = [row["edge"] for row in done.json["between"] if row["left_out"]]
    assert left_out == [1]  # its number in the file of the measurements between the maps
    assert "both.g2o is without the 1 measurement left out" in " ".join(done.err.split())
    again = package.read(out, quiet=True)
    assert again.graph.num_edges == 12
    assert [1, 102] not in again.pairs.tolist()
    cost = done.json["cost"]
    assert package.solve(again).cost == pytest.approx(cost, rel=1e-9)
    rest = [line for k, line in enumerate(JOINTS.splitlines()) if k != 1]
    joints.write_text("\n".join(rest))
    assert certpgo("merge", *chosen).json["cost"] == pytest.approx(cost, rel=1e-9)


def test_merged_maps_are_in_the_frame_of_the_first(certpgo, maps, tmp_path):
    first, second, joints = maps
    out = tmp_path / "both.g2o"
    chosen = ("--between", joints, "--offset", 100, "-o", out)
    certpgo("merge", first, second, *chosen)
    assert [line for line in out.read_text().splitlines() if line.startswith("FIX")] == ["FIX 2"]
    np.testing.assert_allclose(np.array(poses_of(out, [2])[2], float), [2, 7, 0.5], atol=1e-12)
    first.write_text(SQUARE)
    certpgo("merge", first, second, *chosen)
    assert "FIX 100" in out.read_text()
    found = np.array(poses_of(out, [100])[100], float)
    np.testing.assert_allclose(found, [0, -9, 3], atol=1e-12)
    second.write_text(SQUARE)
    certpgo("merge", first, second, *chosen)
    assert "FIX" not in out.read_text()
    np.testing.assert_allclose(np.array(poses_of(out, [0])[0], float), np.zeros(3), atol=1e-12)

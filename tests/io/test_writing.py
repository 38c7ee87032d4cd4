"""What is written is read back: to the last bit from npz, to the format's digits from the rest."""

import errno
import os
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import certpgo
from certpgo import io
from certpgo.errors import FormatError, InputError, InputNotice, SpecError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of, own_cost

seeds = st.integers(0, 2**32 - 1)


def make_instance(seed, d, poses=True):
    rng = np.random.default_rng(seed)
    n, m = 5, 9
    edges = np.array([(k, k + 1) for k in range(4)] + [(0, 2), (4, 1), (2, 4), (3, 0), (1, 0)])
    rotation = RotationGraph(n, edges, so.random(rng, m, d), rng.uniform(1e-3, 1e6, m))
    graph = rotation
    if poses:
        graph = PoseGraph(rotation, rng.standard_normal((m, d)), rng.uniform(1e-3, 1e6, m))
    ids = np.sort(rng.choice(1000, n, replace=False)) - 500
    return Instance(
        "instance",
        graph,
        ids,
        truth=make_estimate(rng, n, d, poses),
        initial=make_estimate(rng, n, d, poses),
        fixed=(2,),
        options={"keep": "all", "rotation_information": "tangent", "weights": "file"},
        notices=("made up",),
    )


def make_estimate(rng, n, d, poses=True):
    t = rng.standard_normal((n, d)) if poses else None
    return Estimate(so.random(rng, n, d), t)


def assert_estimates_agree(a, b, atol):
    np.testing.assert_allclose(a.rotations, b.rotations, rtol=0, atol=atol)
    assert (a.translations is None) == (b.translations is None)
    if a.translations is not None:
        np.testing.assert_allclose(a.translations, b.translations, rtol=0, atol=atol)


def assert_graphs_agree(a, b, atol):
    np.testing.assert_array_equal(a.nodes, b.nodes)
    np.testing.assert_array_equal(a.edges, b.edges)
    np.testing.assert_array_equal(a.kappa, b.kappa)
    np.testing.assert_allclose(a.rotations, b.rotations, rtol=0, atol=atol)
    if a.has_positions:
        np.testing.assert_array_equal(a.tau, b.tau)
        np.testing.assert_array_equal(a.translations, b.translations)


@pytest.mark.parametrize("suffix", [".npz", ".g2o"])
@given(seed=seeds, d=st.sampled_from([2, 3]), poses=st.booleans())
def test_graphs_survive(tmp_path_factory, suffix, seed, d, poses):
    instance = make_instance(seed, d, poses)
    path = tmp_path_factory.mktemp("graph") / f"graph{suffix}"
    said = pytest.warns(InputNotice, match="no ground truth")
    with said if suffix == ".g2o" else nullcontext():
        io.write(path, instance)
    found = io.read(path, quiet=True)
    atol = 0.0 if suffix == ".npz" else 2e-15
    assert_graphs_agree(found.graph, instance.graph, atol)
    np.testing.assert_array_equal(found.ids, instance.ids)
    assert_estimates_agree(found.initial, instance.initial, atol)
    assert found.fixed == instance.fixed
    assert found.options == instance.options
    if suffix == ".npz":
        assert_estimates_agree(found.truth, instance.truth, 0.0)
        assert (found.name, found.notices) == (instance.name, instance.notices)


@pytest.mark.parametrize("suffix", [".npz", ".g2o", ".tum", ".kitti", ".rots"])
@given(seed=seeds, d=st.sampled_from([2, 3]))
def test_estimates_survive(tmp_path_factory, suffix, seed, d):
    instance = make_instance(seed, d, poses=suffix != ".rots")
    path = tmp_path_factory.mktemp("estimate") / f"estimate{suffix}"
    said = suffix == ".kitti"
    with pytest.warns(InputNotice, match="hold no node ids") if said else nullcontext():
        io.write(path, instance.truth, instance=instance, anchor="none")
    found = io.read_estimate(path, instance)
    assert_estimates_agree(found, instance.truth, 0.0 if suffix == ".npz" else 3e-15)


@pytest.mark.parametrize("suffix", [".npz", ".g2o", ".tum", ".rots"])
def test_ids_decide_the_order(tmp_path, suffix):
    instance = make_instance(0, 3)
    shuffled = [3, 0, 4, 1, 2]
    path = tmp_path / f"estimate{suffix}"
    truth = instance.truth if suffix != ".rots" else Estimate(instance.truth.rotations)
    io.write(path, truth.subset(shuffled), ids=instance.ids[shuffled])
    wanted = (
        replace(instance, graph=instance.graph.rotations_alone) if suffix == ".rots" else instance
    )
    assert_estimates_agree(
        io.read_estimate(path, replace(wanted, truth=None, initial=None)), truth, 3e-15
    )
    assert_estimates_agree(io.read_estimate(path), truth, 3e-15)


def test_what_a_format_has_no_room_for_is_said(tmp_path):
    with pytest.warns(InputNotice, match="translations are not written"):
        io.write(tmp_path / "estimate.rots", make_instance(0, 3).truth)


def test_read_options_apply_to_npz_too(tmp_path):
    path = tmp_path / "graph.npz"
    io.write(path, make_instance(0, 2))
    once = io.read(path, keep="first", kappa=3.0, quiet=True)
    assert once.graph.num_edges == 8
    io.write(path, once)
    again = io.read(path, quiet=True)
    assert again.options == once.options
    assert again.options["keep"] == "first"
    assert again.options["weights"] == "kappa=3.0,tau=file"


def test_npz_kinds_are_not_confused(tmp_path):
    instance = make_instance(0, 3)
    graph, estimate = tmp_path / "graph.npz", tmp_path / "estimate.npz"
    io.write(graph, instance)
    io.write(estimate, instance.truth)
    with pytest.raises(FormatError, match=r"one graph \(version 1\) expected, not estimate"):
        io.read(estimate)
    with pytest.raises(FormatError, match=r"one estimate .* expected, not graph"):
        io.read_estimate(graph)
    foreign = tmp_path / "foreign.npz"
    np.savez(foreign, a=1)
    with pytest.raises(FormatError, match="not something else"):
        io.read(foreign)
    pickled = tmp_path / "pickled.npz"
    np.savez(pickled, kind=np.array([{}], dtype=object))
    with pytest.raises(FormatError, match="plain NumPy arrays"):
        io.read(pickled)


def test_npz_arrays_are_checked(tmp_path):
    instance = make_instance(0, 3)
    path = tmp_path / "graph.npz"
    io.write(path, instance)
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, "kappa": -arrays["kappa"]})
    with pytest.raises(FormatError, match="kappa is"):
        io.read(path)
    del arrays["ids"]
    np.savez(path, **arrays)
    with pytest.raises(FormatError, match="'ids' is missing"):
        io.read(path)


def test_a_bare_graph_takes_its_numbers_for_ids(tmp_path):
    graph = make_instance(0, 3).graph
    path = tmp_path / "graph.g2o"
    io.write(path, graph)
    assert io.read(path).ids.tolist() == [0, 1, 2, 3, 4]
    io.write(path, graph, ids=[9, 7, 5, 3, 1])
    found = io.read(path)
    assert found.ids.tolist() == [1, 3, 5, 7, 9]
    np.testing.assert_array_equal(found.graph.edges, 4 - graph.edges)


@pytest.mark.parametrize("ids", [[1, 2, 3], [1, 1, 2, 3, 4], [0.5, 1, 2, 3, 4]])
def test_bad_ids(tmp_path, ids):
    with pytest.raises(InputError, match="5 distinct integers"):
        io.write(tmp_path / "graph.g2o", make_instance(0, 3).graph, ids=ids)


@pytest.mark.parametrize("d", [2, 3])
def test_anchors(tmp_path, d):
    instance = make_instance(0, d)
    path = tmp_path / "estimate.npz"

    def written(**options):
        io.write(path, instance.truth, instance=instance, **options)
        return io.read_estimate(path, instance)

    def assert_at(found, node, like):
        np.testing.assert_allclose(found.rotations[node], like.rotations[node], rtol=0, atol=1e-14)
        where = like.translations[node]
        np.testing.assert_allclose(found.translations[node], where, rtol=0, atol=1e-14)

    origin = Estimate(np.tile(np.eye(d), (5, 1, 1)), np.zeros((5, d)))
    assert_at(written(), 0, instance.initial)
    assert_at(written(anchor="file"), 0, instance.initial)
    assert_at(written(anchor="prior"), 2, instance.initial)
    assert_at(written(anchor="identity"), 0, origin)
    assert_estimates_agree(written(anchor="none"), instance.truth, 0.0)
    # Anchoring is one motion of the world: relative poses stay.
    moved, truth = written(), instance.truth
    relative = [np.swapaxes(e.rotations[:1], 1, 2) @ e.rotations for e in (moved, truth)]
    np.testing.assert_allclose(*relative, rtol=0, atol=1e-14)
    io.write(path, truth, instance=replace(instance, initial=None))
    assert_at(io.read_estimate(path, instance), 0, origin)


def test_an_estimate_in_place_is_not_moved(tmp_path):
    instance = make_instance(0, 3)
    path = tmp_path / "estimate.npz"
    io.write(path, instance.initial, instance=instance)
    assert_estimates_agree(io.read_estimate(path, instance), instance.initial, 0.0)
    io.write(path, instance.truth, ids=instance.ids)
    assert_estimates_agree(io.read_estimate(path, instance), instance.truth, 0.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"anchor": "prior"}, "needs a graph with a fixed node"),
        ({"anchor": "origin"}, "anchor must be"),
        ({"ids": [1, 2]}, "5 distinct integers"),
        ({"instance": make_instance(0, 2)}, "3D, not 2D"),
    ],
)
def test_bad_options(tmp_path, options, message):
    estimate = make_estimate(np.random.default_rng(0), 5, 3)
    with pytest.raises(InputError, match=message):
        io.write(tmp_path / "estimate.g2o", estimate, **options)
    assert not list(tmp_path.iterdir())


def test_what_a_format_cannot_hold_is_refused_and_leaves_nothing(tmp_path):
    instance = make_instance(0, 3)
    rotations = Estimate(instance.truth.rotations)
    for suffix in (".tum", ".kitti"):
        with pytest.raises(InputError, match="needs translations"):
            io.write(tmp_path / f"a{suffix}", rotations)
        with pytest.raises(InputError, match="cannot be written for a graph"):
            io.write(tmp_path / f"a{suffix}", instance)
    with pytest.raises(InputError, match="or name the format"):
        io.write(tmp_path / "a.txt", rotations)
    with pytest.raises(InputError, match="cannot be written for an estimate"):
        io.write(tmp_path / "a.txt", rotations, format="isam")
    with pytest.raises(SpecError, match="kitti"):
        io.write(tmp_path / "a.txt", rotations, format="kiti")
    with pytest.raises(InputError, match="cannot be written: No such file"):
        io.write(tmp_path / "absent" / "a.g2o", rotations)
    assert not list(tmp_path.iterdir())


def test_a_failure_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "graph.g2o"
    path.write_text("precious")

    def interrupted(graph_numbers):
        raise KeyboardInterrupt

    monkeypatch.setattr("certpgo.io.exact.quaternion.to_write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        io.write(path, make_instance(0, 3))
    assert path.read_text() == "precious"
    assert [p.name for p in tmp_path.iterdir()] == ["graph.g2o"]


@pytest.mark.parametrize("suffix", [".npz", ".g2o", ".tum", ".ply"])
def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch, suffix):
    estimate = make_estimate(np.random.default_rng(0), 50, 3)
    path = tmp_path / f"old{suffix}"
    path.write_text("old")
    whole = open

    def filled(file, mode="r", *more, **options):
        if "w" in mode and os.path.dirname(file) == str(tmp_path):
            with whole(file, "wb") as torn:
                torn.write(b"torn")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole(file, mode, *more, **options)

    monkeypatch.setattr("builtins.open", filled)
    monkeypatch.setattr("io.open", filled)
    with pytest.raises(InputError, match=f"{path}: cannot be written: No space left on device"):
        io.write(path, estimate)
    monkeypatch.undo()
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [(path.name, "old")]


def test_of_two_writers_of_a_file_one_is_whole(tmp_path):
    path = tmp_path / "shared.g2o"
    estimates = [make_estimate(np.random.default_rng(k), 200, 3) for k in range(2)]
    alone = []
    for estimate in estimates:
        io.write(path, estimate)
        alone.append(path.read_bytes())
    begin = threading.Barrier(2)

    def often(estimate):
        begin.wait()
        for _ in range(10):
            io.write(path, estimate)
            assert path.read_bytes() in alone

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(often, estimates))
    assert path.read_bytes() in alone
    assert list(tmp_path.iterdir()) == [path]


def test_a_symbolic_link_stays_and_its_target_is_written(tmp_path):
    target, link = tmp_path / "folder" / "target.tum", tmp_path / "link.tum"
    target.parent.mkdir()
    link.symlink_to(target)  # first dangling, then to an existing file
    estimate = make_estimate(np.random.default_rng(0), 3, 3)
    for _ in range(2):
        io.write(link, estimate)
        assert link.is_symlink()
        assert len(target.read_text().splitlines()) == 3
    assert [p.name for p in target.parent.iterdir()] == ["target.tum"]


def test_a_link_to_itself_is_refused(tmp_path):
    link = tmp_path / "loop.tum"
    link.symlink_to(link)
    with pytest.raises(InputError, match=r"loop\.tum: cannot be written"):
        io.write(link, make_estimate(np.random.default_rng(0), 3, 3))
    assert link.is_symlink()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("suffix", [".tum", ".npz", ".g2o"])
def test_a_pipe_is_written_to_and_stays(tmp_path, suffix):
    pipe, link = tmp_path / f"pipe{suffix}", tmp_path / f"link{suffix}"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    estimate = make_estimate(np.random.default_rng(0), 3, 3)
    io.write(tmp_path / f"file{suffix}", estimate)
    for path in (pipe, link):
        received = []
        reader = threading.Thread(target=lambda into=received: into.append(pipe.read_bytes()))
        reader.start()
        io.write(path, estimate)
        reader.join()
        assert received == [(tmp_path / f"file{suffix}").read_bytes()]
        assert pipe.is_fifo()
        assert link.is_symlink()


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs sockets that are files")
def test_a_socket_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the path of a socket must be short
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("s.tum")
        with pytest.raises(InputError, match="a block device or a socket"):
            io.write("s.tum", make_estimate(np.random.default_rng(0), 3, 3))
    assert (tmp_path / "s.tum").is_socket()


def test_planar_estimates_are_embedded_at_height_zero(tmp_path):
    half_turn = Estimate(so.exp(np.array([[np.pi / 2]])), np.array([[3.0, 4.0]]))
    io.write(tmp_path / "a.tum", half_turn, ids=[7])
    stamp, x, y, z, qx, qy, qz, qw = (tmp_path / "a.tum").read_text().split()
    assert (stamp, x, y, z, qx, qy) == ("7", "3.0", "4.0", "0.0", "0.0", "0.0")
    np.testing.assert_allclose([float(qz), float(qw)], np.sqrt(0.5), rtol=1e-15)
    io.write(tmp_path / "a.kitti", half_turn)
    row = np.array((tmp_path / "a.kitti").read_text().split(), dtype=float)
    expected = [0, -1, 0, 3, 1, 0, 0, 4, 0, 0, 1, 0]
    np.testing.assert_allclose(row, expected, rtol=0, atol=1e-15)


def test_timestamps(tmp_path):
    instance = make_instance(0, 3)
    path, stamps = tmp_path / "a.tum", tmp_path / "times.txt"
    seconds = [1.5e9 + 0.1 * k for k in range(5)]
    stamps.write_text("# seconds\n" + "".join(f"{s!r} rgb/{s}.png\n" for s in seconds))

    def first_column(**options):
        io.write(path, instance.truth, instance=instance, anchor="none", **options)
        return [float(line.split()[0]) for line in path.read_text().splitlines()]

    assert first_column() == instance.ids.tolist()
    assert first_column(timestamps="index") == [0, 1, 2, 3, 4]
    assert_estimates_agree(
        io.read_estimate(path, instance, timestamps="index"), instance.truth, 3e-15
    )
    assert first_column(timestamps=stamps) == seconds
    path.write_text("".join(reversed(path.read_text().splitlines(keepends=True))))
    assert_estimates_agree(
        io.read_estimate(path, instance, timestamps=stamps), instance.truth, 3e-15
    )
    with pytest.raises(FormatError, match="not node ids"):
        io.read_estimate(path, instance)
    stamps.write_text("1.0\n2.0\n")
    with pytest.raises(InputError, match="2 timestamps for 5 nodes"):
        io.write(path, instance.truth, timestamps=stamps)
    with pytest.raises(FormatError, match="2 timestamps for 5 nodes"):
        io.read_estimate(path, instance, timestamps=stamps)
    stamps.write_text("1.0\nsoon\n")
    with pytest.raises(FormatError, match=r"times.txt:2: a timestamp"):
        io.write(path, instance.truth, timestamps=stamps)


def test_written_g2o_is_isotropic_text(tmp_path):
    graph = make_instance(0, 3).graph.with_weights(0.1, 0.3)
    io.write(tmp_path / "a.g2o", graph)
    line = (tmp_path / "a.g2o").read_text().splitlines()[0].split()
    information = "0.3 0 0 0 0 0 0.3 0 0 0 0 0.3 0 0 0 0.2 0 0 0.2 0 0.2"
    assert " ".join(line[10:]) == information


def test_real_graphs_survive_g2o(data, tmp_path):
    for name in ("slam3d/parking-garage.g2o", "slam2d/intel.g2o", "slam3d/sphere400.txt"):
        instance = io.read(data(name))
        io.write(tmp_path / "a.g2o", instance)
        assert_graphs_agree(io.read(tmp_path / "a.g2o").graph, instance.graph, 2e-15)


def test_full_information_is_written_as_it_was_read(tmp_path):
    line = "EDGE_SE2 {} {} 1 0.01 1.57 101.25 3e-2 -0.7 200.1 1 50.123456789\n"
    source = tmp_path / "square.g2o"
    source.write_text("".join(line.format(k, (k + 1) % 4) for k in range(4)))
    instance = io.read(source)
    io.write(tmp_path / "again.g2o", instance)
    again = io.read(tmp_path / "again.g2o")
    np.testing.assert_array_equal(
        again.graph.information_matrices, instance.graph.information_matrices
    )
    np.testing.assert_array_equal(again.graph.tau, instance.graph.tau)
    np.testing.assert_array_equal(again.graph.kappa, instance.graph.kappa)


def test_matrix_weights_are_in_files_of_the_package_alone(tmp_path):
    graph = synthetic.helix(3, np.random.default_rng(0)).graph
    general = graph.with_matrix_weights(
        np.tile(np.diag([1.0, 2.0, 3.0, 4.0]), (graph.num_edges, 1, 1))
    )
    with pytest.raises(InputError, match=r"only \.npz files hold matrix weights"):
        io.write(tmp_path / "general.g2o", general)
    assert not list(tmp_path.iterdir())
    io.write(tmp_path / "general.npz", general)
    again = io.read(tmp_path / "general.npz", quiet=True).graph
    np.testing.assert_array_equal(again.couplings, general.couplings)
    np.testing.assert_array_equal(again.arms, general.arms)
    turned = general.rotations_alone
    io.write(tmp_path / "turned.npz", turned)
    read = io.read(tmp_path / "turned.npz", quiet=True).graph
    np.testing.assert_array_equal(read.couplings, turned.couplings)


def test_what_is_neither_graph_nor_estimate_is_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"is written, not a str$"):
        io.write(tmp_path / "x.g2o", "graph")


def test_full_information_of_another_text_is_written_to_g2o(tmp_path):
    """In the plane the rotational part is one angle's, whatever a format calls it."""
    given, path = tmp_path / "given.txt", tmp_path / "written.g2o"
    given.write_text(
        "ODOMETRY 0 1 1 0 0.1 50 1 2 60 3 70\nODOMETRY 1 2 1 0 0.1 50 1 2 60 3 70\n"
        "LANDMARK 0 5 2 1 8 0.5 9\nLANDMARK 2 5 0 1 8 0.5 9\n"
    )
    whole = io.read(given, quiet=True)
    io.write(path, whole)
    again = io.read(path, quiet=True)
    np.testing.assert_array_equal(
        again.graph.information_matrices, whole.graph.information_matrices
    )
    np.testing.assert_array_equal(again.graph.tau, whole.graph.tau)


def about_quaternions(tmp_path):
    """A triangle with full matrices, read as g2o reads them."""
    rng, lines = np.random.default_rng(5), []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        A = rng.normal(size=(6, 6))
        upper = (A @ A.T + np.eye(6))[np.triu_indices(6)].tolist()
        x, q = rng.normal(size=3).tolist(), [0.1, -0.2, 0.3, 0.9]
        lines.append(" ".join(map(str, ["EDGE_SE3:QUAT", i, j, *x, *q, *upper])))
    path = tmp_path / "triangle.g2o"
    path.write_text("\n".join(lines) + "\n")
    return io.read(path, rotation_information="quaternion", quiet=True)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("suffix", ["g2o", "npz", "pyfg", "json"])
def test_information_about_quaternions_is_written_with_its_graph(tmp_path, suffix, whole):
    given, path = about_quaternions(tmp_path), tmp_path / f"copy.{suffix}"
    io.write(path, given if whole else given.graph)
    found, before = io.read(path, quiet=True).graph, given.graph
    estimate = make_estimate(np.random.default_rng(0), 3, 3, True)
    if suffix in ("g2o", "npz"):  # the default cost stays
        assert own_cost(found) == own_cost(before) == "g2o"
        expected = objective_of(before).cost(estimate)
        assert objective_of(found).cost(estimate) == pytest.approx(expected, rel=1e-12)
    if suffix == "g2o":
        found = io.read(path, rotation_information="quaternion", quiet=True).graph
    assert found.kappa == pytest.approx(before.kappa, rel=1e-12)
    if suffix in ("g2o", "npz"):
        assert found.information.about == "quaternion"
        assert np.array_equal(found.information_matrices, before.information_matrices)
    else:  # about tangents, with a quarter of the rotational information
        unit = np.repeat([1.0, 0.5], 3)
        expected = before.information_matrices * np.outer(unit, unit)
        assert np.allclose(found.information_matrices, expected, rtol=1e-9, atol=1e-12)


def test_indefinite_information_about_quaternions_keeps_the_weights_in_g2o(tmp_path):
    given = about_quaternions(tmp_path)
    matrices = given.graph.information_matrices.copy()
    matrices[0, 0, 3] = matrices[0, 3, 0] = 1e3
    graph = given.graph.with_information(Information.of(matrices, "g2o", "quaternion"))
    assert own_cost(graph) == "chordal"
    io.write(tmp_path / "indefinite.g2o", graph)
    found = io.read(tmp_path / "indefinite.g2o", quiet=True).graph
    assert found.kappa == pytest.approx(graph.kappa, rel=1e-12)


def test_mahalanobis_weights_of_an_npz_file_know_what_information_is_about(tmp_path):
    given, path = about_quaternions(tmp_path), tmp_path / "copy.npz"
    io.write(path, given.graph)
    expected = io.read(
        tmp_path / "triangle.g2o", rotation_information="quaternion", mahalanobis=True, quiet=True
    )
    found = io.read(path, mahalanobis=True, quiet=True)
    assert np.allclose(found.graph.couplings, expected.graph.couplings)


def test_an_npz_file_says_what_its_information_is_about(tmp_path):
    path = tmp_path / "copy.npz"
    io.write(path, about_quaternions(tmp_path))
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **arrays | {"information_about": "angles"})
    with pytest.raises(FormatError, match="'information_about' must be 'tangent' or 'quaternion'"):
        io.read(path)
    del arrays["information_about"]  # older files have the option of reading alone
    np.savez(path, **arrays)
    assert io.read(path, quiet=True).graph.information.about == "quaternion"


def test_graphs_with_priors_know_their_world(tmp_path):
    graph = synthetic.helix(3, np.random.default_rng(0)).graph
    fixed = certpgo.with_priors(graph, [0, 2], None, np.eye(3)[:2], tau=4.0)
    path = tmp_path / "fixed.g2o"
    io.write(path, fixed)
    assert path.read_text().count("PRIOR") == 2
    again = certpgo.solve(io.read(path, quiet=True), cost="chordal")
    assert again.cost == pytest.approx(certpgo.solve(fixed, cost="chordal").cost, rel=1e-9)

"""g2o's lines of similarities, against matrix exponentials and g2o's own definitions."""

import warnings

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import rng_of, seeds

import certpgo
from certpgo import Estimate, FormatError, InputError, Instance
from certpgo.cli import main
from certpgo.errors import InputNotice
from certpgo.io.datasets.monocular import random_maps
from certpgo.linalg import rotations as so
from certpgo.linalg import similarities


def generator(v):
    A = np.zeros((4, 4))
    A[:3, :3] = so.hat(v[None, :3])[0] + v[6] * np.eye(3)
    A[:3, 3] = v[3:6]
    return A


def matrix(R, t, s):
    M = np.eye(4)
    M[:3, :3], M[:3, 3] = s * R, t
    return M


def exponential(v):
    """g2o's Sim3(v) as a matrix, by SciPy."""
    return scipy.linalg.expm(generator(np.asarray(v, dtype=float)))


@given(seeds, st.sampled_from([1.0, 1e-3, 1e-6, 1e-12]), st.sampled_from([1.0, 1e-4, 0.0]))
@settings(max_examples=60)
def test_exponentials_are_those_of_matrices(seed, turn, growth):
    v = rng_of(seed).standard_normal((5, 7))
    v[:, :3] *= turn
    v[:, 6] *= growth
    R, t, s = similarities.exp(v)
    for k in range(5):
        assert matrix(R[k], t[k], s[k]) == pytest.approx(exponential(v[k]), rel=1e-9, abs=1e-12)
    assert similarities.log(R, t, s) == pytest.approx(v, rel=1e-7, abs=1e-9)


def test_logarithms_of_half_turns_have_an_exponential():
    R = so.exp(np.array([[np.pi, 0.0, 0.0], [0.0, np.pi - 1e-9, 0.0]]))
    t, s = np.array([[1.0, 2.0, 3.0]] * 2), np.array([2.0, 0.3])
    v = similarities.log(R, t, s)
    for k in range(2):
        assert exponential(v[k]) == pytest.approx(matrix(R[k], t[k], s[k]), abs=1e-7)


VERTICES = ["0 0.1 0.2 -0.3 1 2 3 0.2 1 1 0 0", "7 -0.4 0.1 0.2 0 1 -1 -0.5"]
EDGE = "EDGE_SIM3:EXPMAP 0 7 {} {}"


def written(tmp_path, lines):
    path = tmp_path / "essential.g2o"
    path.write_text("\n".join(lines) + "\n")
    return path


def consistent(tmp_path, information=""):
    """A file whose measurement is what g2o computes from its vertices, world to camera."""
    rows = [np.array(line.split()[1:8], dtype=float) for line in VERTICES]
    S = [np.linalg.inv(exponential(row)) for row in rows]  # g2o's estimates
    C = S[1] @ np.linalg.inv(S[0])  # the measurement without error: C S_0 S_1^-1 = 1
    v = scipy.linalg.logm(np.linalg.inv(C)).real  # what EdgeSim3::write writes
    numbers = [v[2, 1], v[0, 2], v[1, 0], *v[:3, 3], v[0, 0]]
    lines = [f"VERTEX_SIM3:EXPMAP {line}" for line in VERTICES]
    return written(
        tmp_path, [*lines, EDGE.format(" ".join(repr(float(x)) for x in numbers), information)]
    )


@pytest.fixture(autouse=True)
def quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputNotice)
        yield


def test_files_of_g2o_are_world_to_camera_inverted(tmp_path):
    """What g2o's own error says is zero costs nothing here."""
    instance = certpgo.read(consistent(tmp_path))
    assert instance.ids.tolist() == [0, 7]
    assert instance.graph.free.tolist() == [False, True]
    assert instance.initial.scales[1] == pytest.approx(np.exp(-0.5 - 0.2))
    problem = certpgo.solve(instance).problem
    assert problem.cost(instance.initial) < 1e-25
    other = certpgo.read(consistent(tmp_path), keep="last")
    assert other.graph.scales == pytest.approx([np.exp(-0.7)])


def test_the_unit_is_that_of_the_fixed_node(tmp_path):
    path = consistent(tmp_path)
    path.write_text(path.read_text() + "FIX 7\n")
    instance = certpgo.read(path)
    assert instance.graph.free.tolist() == [True, False]
    assert instance.initial.scales == pytest.approx([np.exp(0.7), 1.0])
    assert any("node 7 is 1, the unit of the map" in notice for notice in instance.notices)
    assert certpgo.solve(instance).problem.cost(instance.initial) < 1e-25


def test_information_is_rotation_then_translation(tmp_path):
    diagonal = [6.0, 6.0, 6.0, 5.0, 5.0, 5.0, 99.0]
    text = " ".join(repr(diagonal[i]) if i == j else "0" for i in range(7) for j in range(i, 7))
    graph = certpgo.read(consistent(tmp_path, text)).graph
    assert graph.kappa.tolist() == [3.0]
    assert graph.tau.tolist() == [5.0]


@pytest.mark.parametrize("suffix", [".g2o", ".npz"])
@given(seed=seeds)
@settings(max_examples=5)
def test_what_is_written_is_read(tmp_path_factory, suffix, seed):
    graph, truth = random_maps(rng_of(seed), 3)
    path = tmp_path_factory.mktemp("maps") / f"map{suffix}"
    certpgo.write(path, Instance("map", graph, np.arange(8) * 2, initial=truth, fixed=(0,)))
    back = certpgo.read(path)
    assert back.graph.rotations == pytest.approx(graph.rotations, abs=1e-13)
    assert back.graph.translations == pytest.approx(graph.translations, rel=1e-10, abs=1e-12)
    assert back.graph.scales == pytest.approx(graph.scales, rel=1e-14)
    assert (back.graph.kappa == graph.kappa).all()
    assert (back.graph.tau == graph.tau).all()
    assert (back.graph.free == graph.free).all()
    assert back.initial.scales == pytest.approx(truth.scales, rel=1e-14)
    assert back.initial.translations == pytest.approx(truth.translations, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("suffix", [".g2o", ".npz"])
def test_answers_are_read_and_judged(tmp_path, suffix):
    graph, _ = random_maps(np.random.default_rng(4), 3)
    instance = Instance("map", graph, np.arange(8) + 5)
    answer = certpgo.solve(instance)
    path = tmp_path / f"answer{suffix}"
    certpgo.write(path, answer)
    assert certpgo.certify(instance, path).verdict == "CERTIFIED"
    assert certpgo.read_estimate(path).scales == pytest.approx(answer.estimate.scales)


def test_mixed_and_planar_graphs_are_kept_in_npz_alone(tmp_path):
    for d, known, points in ((2, (), 0), (3, (2,), 0), (3, (), 2)):
        graph, truth = random_maps(np.random.default_rng(1), d, known=known, points=points)
        instance = Instance("map", graph, np.arange(8), truth=truth)
        with pytest.raises(InputError, match="npz files hold"):
            certpgo.write(tmp_path / "map.g2o", instance)
        assert not list(tmp_path.glob("*.g2o"))
        certpgo.write(tmp_path / "map.npz", instance)
        back = certpgo.read(tmp_path / "map.npz")
        assert (back.graph.free == graph.free).all()
        assert (back.truth.scales == truth.scales).all()
        with pytest.raises(InputError, match=r"only \.g2o and \.npz files hold similarities"):
            certpgo.write(tmp_path / "map.pyfg", instance)


def test_trajectories_leave_scales_out_and_say_so(tmp_path):
    _, truth = random_maps(np.random.default_rng(1), 3)
    with pytest.warns(InputNotice, match="scales are not written"):
        certpgo.write(tmp_path / "map.tum", truth)
    graph, _ = random_maps(np.random.default_rng(1), 3)
    with pytest.raises(InputError, match="the estimate has no scales"):
        certpgo.certify(graph, certpgo.read_estimate(tmp_path / "map.tum"))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("VERTEX_SIM3:EXPMAP 0 1 2 3 4 5 6", "takes 1 id and 7 numbers"),
        ("VERTEX_SIM3:EXPMAP 0 0 0 0 1 4 5 6 1", "takes 1 id and 7 numbers"),
        ("VERTEX_SIM3:EXPMAP 0 0 0 0 4 5 6 70", "logarithms of scales within 69"),
        ("EDGE_SIM3:EXPMAP 0 7 0 0 0 4 5 6", "takes 2 ids and 7 numbers"),
        ("EDGE_SIM3:EXPMAP 0 7 0 0 0 4 5 6 -80", "logarithms of scales within 69"),
        (
            "EDGE_SIM3:EXPMAP 0 7 0 0 0 4 5 6 0 1 2 3",
            "then 28 or no information numbers; 12 values found",
        ),
        ("EDGE_SIM3:EXPMAP 7 7 0 0 0 4 5 6 0", "node 7 is measured from itself"),
        ("EDGE_SE3:QUAT 0 7 0 0 0 0 0 0 1", "no tag 'EDGE_SE3:QUAT'"),
    ],
)
def test_lines_that_mean_nothing_are_located(tmp_path, line, said):
    path = consistent(tmp_path)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(FormatError, match=said) as error:
        certpgo.read(path)
    assert error.value.line == 4


def test_scales_and_free_belong_together(tmp_path):
    graph, _ = random_maps(np.random.default_rng(1), 3)
    certpgo.write(tmp_path / "map.npz", graph)
    with np.load(tmp_path / "map.npz") as archive:
        arrays = dict(archive)
    del arrays["free"]
    np.savez(tmp_path / "half.npz", **arrays)
    with pytest.raises(FormatError, match="'scales' and 'free' belong together"):
        certpgo.read(tmp_path / "half.npz")


def test_frames_of_the_world_leave_scales():
    _, truth = random_maps(np.random.default_rng(1), 3)
    for moved in (truth.anchored(3), truth.moved(so.random(np.random.default_rng(0), 1, 3)[0])):
        assert (moved.scales == truth.scales).all()
    assert (truth.subset([4, 2]).scales == truth.scales[[4, 2]]).all()
    assert isinstance(truth.with_translations(None), Estimate)


#: Of a stereo camera of KITTI: focal lengths and centre, pixels.
CAMERA = "718.8 718.8 607.2 185.2"


def camera_graph(file, cameras=(CAMERA, CAMERA)):
    poses = "0 0 0 0 0 0 0 0", "1 0 0 .1 1 0 0 0.05"
    lines = [f"VERTEX_SIM3:EXPMAP {pose} {c}" for pose, c in zip(poses, cameras, strict=True)]
    return file("\n".join([*lines, EDGE.format("0 0 .1 1 0 0 0.05", "").replace(" 7 ", " 1 ")]))


def vertices(path):
    lines = [line.split() for line in path.read_text().splitlines()]
    return [line[9:] for line in lines if line[0] == "VERTEX_SIM3:EXPMAP"]


def test_the_camera_is_kept(file, tmp_path):
    graph = camera_graph(file)
    instance = certpgo.read(graph, quiet=True)
    out, archive = tmp_path / "out.g2o", tmp_path / "g.npz"
    certpgo.write(out, certpgo.solve(instance))
    assert vertices(out) == [CAMERA.split()] * 2
    certpgo.write(archive, instance)
    certpgo.write(out, certpgo.read(archive, quiet=True))
    assert vertices(out) == [CAMERA.split()] * 2
    certpgo.write(out, certpgo.read_estimate(graph))
    assert vertices(out) == [CAMERA.split()] * 2


def test_different_cameras_are_not_kept(file, tmp_path):
    with pytest.warns(InputNotice, match="2 different cameras: they are not kept"):
        instance = certpgo.read(camera_graph(file, (CAMERA, "1 1 0 0")))
    certpgo.write(tmp_path / "out.g2o", instance)
    assert vertices(tmp_path / "out.g2o") == [["1", "1", "0", "0"]] * 2
    with pytest.raises(FormatError, match=r":2: numbers expected"):
        certpgo.read(camera_graph(file, (CAMERA, "718.8 718.8 a b")))


def test_a_graph_of_similarities_is_converted_with_its_unit(file, tmp_path):
    graph, out = camera_graph(file), tmp_path / "out.g2o"
    assert main(["convert", str(graph), str(out)]) == 0
    again = certpgo.read(out, quiet=True).graph
    assert again.free.tolist() == [False, True]
    assert again.scales == pytest.approx(certpgo.read(graph, quiet=True).graph.scales, rel=1e-12)
    assert main(["convert", str(graph), str(out), "--no-fixed"]) != 0  # which releases it

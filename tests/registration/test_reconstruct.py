"""Frames to a certified trajectory: the synthetic room, real frames, and what goes wrong."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import certpgo
from certpgo.cli import main
from certpgo.errors import InputError, InputNotice
from certpgo.io.surfaces import read_surface
from certpgo.linalg import rotations as so
from certpgo.registration.averaging import averaged_graph
from certpgo.registration.calibration import calibrated
from certpgo.registration.camera import Camera
from certpgo.registration.dense import DenseRegistration
from certpgo.registration.features import ColourCamera
from certpgo.registration.fuse import ColouredCloud, VoxelGrid, denoised, voxel_means
from certpgo.registration.loops import DeadReckoning, adjacent, consistent
from certpgo.registration.pairs import FramePair, together
from certpgo.registration.ransac import Motion
from certpgo.registration.reconstruct import ReconstructSettings
from certpgo.registration.sequences import FolderSequence
from certpgo.registration.synthetic import SyntheticSequence, synthetic_sequence
from certpgo.solve.metrics import angular_errors, position_errors

cv2 = pytest.importorskip("cv2")
pytest.importorskip("small_gicp")


@pytest.fixture(scope="module")
def frames():
    return synthetic_sequence(30)


@pytest.fixture(scope="module")
def found(frames):
    return certpgo.reconstruct(frames)


def test_the_room_is_certified_and_accurate(frames, found):
    assert found.answer.verdict.value == "CERTIFIED"
    assert found.nodes.tolist() == list(range(30))
    assert position_errors(found.estimate, frames.truth).rmse < 0.002
    assert angular_errors(found.estimate, frames.truth).rmse_deg < 0.12
    for k in found.averaged.chosen[found.averaged.kept]:
        pair, R, t = found.pairs[k], frames.truth.rotations, frames.truth.translations
        assert np.degrees(so.angle(pair.R.T @ R[pair.i].T @ R[pair.j])) < 0.5
        assert np.linalg.norm(R[pair.i].T @ (t[pair.j] - t[pair.i]) - pair.t) < 0.02


def test_the_scene_lies_on_the_room(frames, found):
    """Points are near a face of the room or of a box, but for noise."""
    first = frames.truth
    points = found.scene.points @ first.rotations[0].T + first.translations[0]
    off = []
    for low, high in frames.room.boxes:
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        inside = np.minimum(points - low, high - points).min(axis=1)
        off.append(np.maximum(np.linalg.norm(outside, axis=1), np.maximum(inside, 0.0)))
    assert np.median(np.min(off, axis=0)) < 0.01
    assert len(found.scene) > 50_000


def test_the_graph_keeps_its_information(found, tmp_path):
    """The g2o file's own cost is the one that was certified."""
    path = tmp_path / "graph.g2o"
    certpgo.write(path, found.instance)
    again = certpgo.read(path)
    assert again.graph.information is not None
    a, b = again.graph.information_matrices, found.instance.graph.information_matrices
    assert np.abs(a - b).max() < 1e-9 * np.abs(b).max()
    if len(found.rejected) == 0:
        answer = certpgo.solve(again)
        assert answer.cost == pytest.approx(found.answer.cost, rel=1e-6)


def test_the_output_says_what_is_not_proven(found):
    said = dict(found.consistency())
    assert said["frames"] == "30 of 30"
    assert "right places" in said["not proven"]
    assert "frame " in found.named(found.pairs[0])


def test_results_are_resumed(frames, tmp_path, monkeypatch):
    few, folder = frames.chosen(range(6)), tmp_path / "kept"
    first = certpgo.reconstruct(few, cache=folder)
    monkeypatch.setattr("certpgo.registration.features.detect", None)
    monkeypatch.setattr("certpgo.registration.front_end.measure", None)
    again = certpgo.reconstruct(few, cache=folder)
    assert np.array_equal(again.estimate.translations, first.estimate.translations)
    for path in folder.iterdir():
        path.write_bytes(b"damaged")
    with pytest.raises(TypeError), pytest.warns(InputNotice, match="it is made again"):
        certpgo.reconstruct(few, cache=folder)


@pytest.fixture
def folder(frames, tmp_path):
    """Six frames of the room as Open3D has them."""
    path = tmp_path / "frames"
    for name in ("color", "depth"):
        (path / name).mkdir(parents=True)
    for k in range(6):
        frame = frames.frame(k)
        cv2.imwrite(str(path / f"color/{k}.png"), frame.colour[:, :, ::-1])
        millimetres = np.rint(1000 * frame.depth).astype(np.uint16)
        cv2.imwrite(str(path / f"depth/{k}.png"), millimetres)
    c = frames.camera
    (path / "camera.param").write_text(f"{c.fx} {c.fy} {c.cx} {c.cy}\n")
    return path


def test_the_command_writes_scene_trajectory_and_graph(folder, tmp_path, capsys):
    out = [tmp_path / name for name in ("scene.ply", "t.tum", "g.g2o")]
    line = ["reconstruct", folder, "-o", out[0], "--trajectory", out[1], "--graph", out[2]]
    assert main([*map(str, line), "--no-cache"]) == 0
    assert capsys.readouterr().out.startswith("CERTIFIED")
    assert out[0].read_bytes().startswith(b"ply\n")
    assert certpgo.read_estimate(out[1]).num_nodes == 6
    assert certpgo.read(out[2]).graph.num_nodes == 6


def test_a_page_shows_points_and_a_given_graph_is_fused_again(folder, tmp_path, capsys):
    """The graph that was written gives the same scene; its page has points, in the same place."""
    out = [tmp_path / name for name in ("a.ply", "a.html", "g.g2o", "b.ply", "b.html")]
    a, page, graph, b, again = map(str, out)
    line = ["reconstruct", str(folder), "-o", a, "--html", page, "--graph", graph, "--no-cache"]
    assert main(line) == 0
    line = ["reconstruct", graph, "--frames", str(folder), "-o", b, "--html", again]
    assert main(line) == 0
    said = capsys.readouterr().out
    assert said.count("CERTIFIED") == 2
    assert said.count("not proven") == 2
    first, second = (read_surface(Path(path)) for path in (a, b))
    assert abs(len(first.points) - len(second.points)) < 0.01 * len(first.points)
    assert np.abs(first.points.mean(axis=0) - second.points.mean(axis=0)).max() < 1e-3
    for text in (path.read_text(encoding="utf-8") for path in (out[1], out[4])):
        assert "CERTIFIED" in text
        assert "not proven: that images" in text
        assert '"cloud": {' in text.replace('"cloud":{', '"cloud": {')


def test_a_graph_of_other_frames_is_refused(folder, tmp_path, capsys):
    graph = tmp_path / "g.g2o"
    graph.write_text("EDGE_SE3:QUAT 0 9 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n")
    assert main(["reconstruct", str(graph), "--frames", str(folder)]) == 1
    assert "node 9 is no frame: frames has frames 0 to 5" in capsys.readouterr().err
    graph.write_text("EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    with pytest.raises(InputError, match="no poses in space"):
        averaged_graph(certpgo.read(graph))


def test_a_mesh_is_written(folder, tmp_path, capsys):
    pytest.importorskip("skimage")
    out = tmp_path / "mesh.ply"
    line = ["reconstruct", str(folder), "--every", "2", "-o", str(out), "--mesh", "--calibrate"]
    assert main([*line, "--no-cache"]) == 0
    assert capsys.readouterr().out.startswith("CERTIFIED")
    surface = read_surface(out)
    assert len(surface.faces) > 1000


class TwoLenses(SyntheticSequence):
    """Frames whose colour camera has a longer lens than the depth camera."""

    @property
    def lens(self):
        return self.camera.scaled(1.08)

    def frame(self, k):
        longer = SyntheticSequence(**{**vars(self), "camera": self.lens})
        return replace(super().frame(k), colour=longer.frame(k).colour)


def test_the_colour_camera_is_estimated_where_it_is_another_one(frames):
    mixed = TwoLenses(**{**vars(frames.chosen(range(6))), "registered": False})
    found = certpgo.reconstruct(mixed)
    assert found.colour.camera.fx == pytest.approx(mixed.lens.fx, rel=0.02)
    assert f"fx,fy,cx,cy {found.colour.camera.fx:.1f}" in dict(found.consistency())["colour camera"]


def test_a_calibration_that_no_other_pair_confirms_is_not_used(frames, monkeypatch):
    mixed = TwoLenses(**{**vars(frames.chosen(range(6))), "registered": False})
    monkeypatch.setattr("certpgo.registration.calibration.PAIRS", 2)
    assert calibrated(mixed) is not None
    monkeypatch.setattr("certpgo.registration.calibration.PAIRS", 1)
    assert calibrated(mixed) is None


@pytest.mark.parametrize("first", [0, 4])
def test_a_few_registered_frames_have_no_other_colour_camera(frames, first):
    assert calibrated(frames.chosen(range(first, first + 6))) is None


def test_colours_are_looked_up_in_the_colour_camera(frames):
    frame, camera = frames.frame(0), frames.camera
    known = frame.depth > 0
    same = ColourCamera(camera).seen(frame, camera)
    assert np.array_equal(same[known], frame.colour[known])
    assert not same[~known].any()
    right = ColourCamera(replace(camera, cx=camera.cx + 5.0)).seen(frame, camera)
    assert np.array_equal(right[:, :-5][known[:, :-5]], frame.colour[:, 5:][known[:, :-5]])


def test_depths_are_looked_up_in_the_colour_camera(frames):
    """A shifted centre shifts the image; of two depths at one pixel the nearest is seen."""
    frame, camera = frames.frame(0), frames.camera
    assert np.array_equal(ColourCamera(camera).registered(frame.depth, camera), frame.depth)
    left = ColourCamera(replace(camera, cx=camera.cx - 5.0)).registered(frame.depth, camera)
    assert np.array_equal(left[:, :-5], frame.depth[:, 5:])
    half = ColourCamera(Camera(camera.fx / 2, camera.fy / 2, 0.0, 0.0)).registered(
        np.float32([[2.0, 1.0], [3.0, 4.0]]), Camera(camera.fx, camera.fy, 0.0, 0.0)
    )
    assert half.tolist() == [[1.0, 0.0], [0.0, 0.0]]


def test_a_grid_of_parts_is_that_of_all_points():
    rng = np.random.default_rng(0)
    points, colours = rng.uniform(-1, 1, (3000, 3)), rng.integers(0, 256, (3000, 3), np.uint8)
    whole, parts = VoxelGrid(0.2), VoxelGrid(0.2)
    whole.add(points, colours)
    for part in np.array_split(np.arange(3000), [7, 8, 900, 1000, 2500]):
        parts.add(points[part], colours[part])
    for least in (1, 3):
        a, b = whole.cloud(least), parts.cloud(least)
        assert a.points == pytest.approx(b.points, abs=1e-6)
        assert np.array_equal(a.colours, b.colours)


def test_noise_is_judged_by_parts_as_by_the_whole(monkeypatch):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (500, 3)).astype(np.float32)
    cloud = ColouredCloud(points, np.zeros((500, 3), np.uint8))
    whole = denoised(cloud)
    monkeypatch.setattr("certpgo.registration.fuse.BLOCK", 7)
    assert 0 < len(whole) < 500
    assert np.array_equal(denoised(cloud).points, whole.points)


def test_keypoints_and_clouds_that_disagree_say_how_noisy_both_are():
    """The weighted mean, with the larger of the stated covariance and the one they show."""
    stated = Motion(np.eye(3), np.zeros(3), 1e6 * np.eye(6), np.ones(30, bool), 1.0)
    for shift, excess in ((0.0, 1.0), (0.001, 1.0), (0.1, 0.1**2 / 2e-6 / 6.0)):
        t = np.array([shift, 0.0, 0.0])
        found = DenseRegistration(np.eye(3), t, 3e6 * np.eye(6), 99, 0.01, 0.9, 0.9)
        both = np.sqrt(2.0 / 3.0) * 1e-3  # so that 1/1e6 + 1/3e6 + 2 floors are 2e-6
        floors = 0.5 * both**2 * np.eye(6)
        R, mean, covariance, factor = together(stated, found, floors)
        assert np.array_equal(R, np.eye(3))
        assert mean == pytest.approx(0.75 * t)
        assert covariance == pytest.approx(np.eye(6) / 4e6)
        assert factor == pytest.approx(excess)


def test_damaged_frames_leave_gaps_that_are_named(folder):
    blank = folder / "color/2.png"
    cv2.imwrite(str(blank), np.zeros((240, 320, 3), np.uint8))
    (folder / "depth/4.png").write_bytes((folder / "depth/4.png").read_bytes()[:-30])
    with pytest.warns(InputNotice) as caught:
        found = certpgo.reconstruct(certpgo.read_sequence(folder))
    said = " ".join(str(one.message) for one in caught)
    assert "2.png" in said
    assert "0 keypoints with a depth" in said
    assert "truncated" in said
    assert found.nodes.tolist() == [0, 1, 3, 5]


def test_depths_past_the_cutoff_are_refused(folder):
    with pytest.raises(InputError, match="depths are past the cutoff"):
        certpgo.reconstruct(certpgo.read_sequence(folder, depth_scale=100.0))


def test_a_wrong_focal_length_is_noticed(folder):
    frames = certpgo.read_sequence(folder)
    wrong = FolderSequence(**{**vars(frames), "camera": frames.camera.scaled(1.5)})
    with pytest.warns(InputNotice, match="are camera and depth scale right"):
        certpgo.reconstruct(wrong, ReconstructSettings(dense=False))
    wrong = FolderSequence(**{**vars(frames), "camera": frames.camera.scaled(1.2)})
    with pytest.warns(InputNotice, match="colour and depth disagree on the motion"):
        certpgo.reconstruct(wrong)


def test_frames_that_do_not_overlap_are_refused(frames):
    with pytest.raises(InputError, match="overlap"):
        certpgo.reconstruct(frames.chosen([0, 12, 24]))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("", "give a folder of frames, or --synthetic"),
        ("nowhere --synthetic", "give a folder of frames, or --synthetic"),
        ("nowhere", "nowhere: no such folder"),
        ("--synthetic -o scene.obj", "scene.obj: the scene is written as .ply"),
        ("--synthetic --mesh", "--mesh needs --out"),
        ("--synthetic -o nowhere/scene.ply", "nowhere/scene.ply: cannot be written"),
        ("--synthetic --method global_icp", "certpgo register SCANS --method global_icp"),
        ("--synthetic --method horn", "no method 'horn': pose_graph is known here"),
        ("g.g2o --frames f --every 2", "without --graph and --every"),
        ("--synthetic --camera 1,1,1,1", "--camera and --depth-scale are for frames in a folder"),
    ],
)
def test_the_command_refuses(line, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["reconstruct", *line.split()]) == 1
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def step(i, j, R, t, sigma=0.001):
    return FramePair(i, j, R, t, sigma**2 * np.eye(6), 100, 90, 1.0, False)


def test_dead_reckoning_contradicts_a_wrong_loop_and_pairs_of_loops_agree():
    n = 40
    angle = np.linspace(0, 2 * np.pi, n)
    truth = certpgo.Estimate(
        so.exp(np.stack([0 * angle, 0 * angle, angle], 1)),
        np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1),
    )
    R, t = truth.rotations, truth.translations
    between = {(i, j): (R[i].T @ R[j], R[i].T @ (t[j] - t[i])) for i in range(n) for j in range(n)}
    steps = [step(k, k + 1, *between[k, k + 1]) for k in range(n - 1)]
    reckoning = DeadReckoning(np.arange(n), truth, steps)
    right = [step(i, j, *between[i, j]) for i, j in ((0, 20), (1, 30), (5, 39))]
    wrong = step(2, 25, between[2, 25][0], between[2, 25][1] + [0.6, 0, 0])
    assert all(map(reckoning.allows, right))
    assert not reckoning.allows(wrong)
    assert consistent([*right, wrong], reckoning) == right
    assert adjacent(3) == [(0, 1), (0, 2), (1, 2)]


def test_voxels_average_what_falls_into_them():
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (1000, 3))
    grid = VoxelGrid(0.5)
    for part in np.array_split(points, 7):
        grid.add(part, np.full((len(part), 3), 7, np.uint8))
    cloud = grid.cloud()
    assert np.abs(cloud.points - voxel_means(points, 0.5)).max() < 1e-6
    assert len(cloud) == 64
    assert (cloud.colours == 7).all()


def test_lonely_points_are_noise():
    rng = np.random.default_rng(0)
    points = np.vstack([rng.uniform(0, 1, (500, 3)), [[9.0, 9, 9]]]).astype(np.float32)
    cleaned = denoised(ColouredCloud(points, np.zeros((501, 3), np.uint8)))
    assert cleaned.points.max() < 1.0
    assert len(cleaned) > 450

"""Folders of frames: layouts, cameras and truths as printed; broken ones named."""

import json

import numpy as np
import pytest

import certpgo
from certpgo.errors import FormatError, InputError
from certpgo.registration.camera import Camera, camera_of, depth_noise, read_camera

cv2 = pytest.importorskip("cv2")

K = "585 0 320\n0 585 240\n0 0 1\n"


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def pictures(n=2):
    rng = np.random.default_rng(0)
    for k in range(n):
        yield rng.integers(0, 255, (6, 8, 3), np.uint8), np.full((6, 8), 1000 * (k + 1), np.uint16)


@pytest.fixture
def seven_scenes(tmp_path):
    (tmp_path / "camera-intrinsics.txt").write_text(K)
    for k, (colour, depth) in enumerate(pictures()):
        save(tmp_path / f"frame-00000{k}.color.png", colour)
        save(tmp_path / f"frame-00000{k}.depth.png", depth)
        # As printed: a rotation to a few digits.
        pose = f"0.8001 -0.6 0 {k}\n0.6 0.8 0 0\n0 0 1 0\n0 0 0 1\n"
        (tmp_path / f"frame-00000{k}.pose.txt").write_text(pose)
    return tmp_path


def test_seven_scenes(seven_scenes):
    frames = certpgo.read_sequence(seven_scenes)
    assert len(frames) == 2
    assert frames.camera == Camera(585, 585, 320, 240)
    colour, _ = next(pictures())
    assert (frames.frame(0).colour[:, :, ::-1] == colour).all()
    assert frames.frame(1).depth.max() == 2.0
    R = frames.truth.rotations
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() < 1e-12
    assert frames.truth.translations[:, 0].tolist() == [0.0, 1.0]


def test_tum_associates_by_time_and_takes_its_scale(tmp_path):
    for k, (colour, depth) in enumerate(pictures()):
        save(tmp_path / f"rgb/{k}.png", colour)
        save(tmp_path / f"depth/{k}.png", 5 * depth)
    (tmp_path / "rgb.txt").write_text("# colour\n1.00 rgb/0.png\n2.00 rgb/1.png\n9 rgb/1.png\n")
    (tmp_path / "depth.txt").write_text("1.01 depth/0.png\n1.99 depth/1.png\n")
    (tmp_path / "groundtruth.txt").write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="no intrinsics: give --camera"):
        certpgo.read_sequence(tmp_path)
    frames = certpgo.read_sequence(tmp_path, camera="525,525,3.5,2.5")
    assert frames.times.tolist() == [1.0, 2.0]
    assert frames.frame(1).depth.max() == 2.0
    assert frames.truth.translations[1].tolist() == [1.0, 0.0, 0.0]


def test_icl_nuim_lists_depth_first(tmp_path):
    for k, (colour, depth) in enumerate(pictures()):
        save(tmp_path / f"rgb/{k}.png", colour)
        save(tmp_path / f"depth/{k}.png", 5 * depth)
    lines = "0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n"
    (tmp_path / "associations.txt").write_text(lines)
    frames = certpgo.read_sequence(tmp_path, camera="481.2,-480,3.5,2.5")
    assert frames.frame(0).depth.max() == 1.0


def test_open3d(tmp_path):
    for k, (colour, depth) in enumerate(pictures()):
        save(tmp_path / f"color/{k}.png", colour)
        save(tmp_path / f"depth/{k}.png", depth)
    columns = {"intrinsic_matrix": [525, 0, 0, 0, 526, 0, 3.5, 2.5, 1]}
    (tmp_path / "camera_intrinsic.json").write_text(json.dumps(columns))
    log = "{0} {0} 1\n1 0 0 {0}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    (tmp_path / "trajectory.log").write_text(log.format(0) + log.format(1))
    frames = certpgo.read_sequence(tmp_path)
    assert frames.camera == Camera(525, 526, 3.5, 2.5)
    assert frames.truth.translations[1].tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("name", "spoil", "said"),
    [
        ("frame-000001.depth.png", lambda p: p.unlink(), "no such image"),
        ("frame-000001.depth.png", lambda p: p.write_bytes(p.read_bytes()[:-20]), "truncated"),
        ("frame-000001.color.png", lambda p: p.write_bytes(b"GIF89a"), "PNG or JPEG"),
        ("frame-000001.depth.png", lambda p: save(p, np.ones((6, 8), np.uint8)), "16 bits"),
        ("frame-000001.depth.png", lambda p: save(p, np.ones((3, 4), np.uint16)), "differ in size"),
    ],
)
def test_a_damaged_image_is_named(seven_scenes, name, spoil, said):
    spoil(seven_scenes / name)
    frames = certpgo.read_sequence(seven_scenes)
    with pytest.raises(FormatError, match=said) as raised:
        frames.frame(1)
    assert raised.value.path.name == name


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("frame-000001.pose.txt", "1 0 0\n"),
        ("frame-000001.pose.txt", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        ("frame-000001.pose.txt", "nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
        ("frame-000001.pose.txt", "a b\n"),
        ("camera-intrinsics.txt", "585 585\n"),
        ("camera-intrinsics.txt", "585 0 320\n0 585 240\n0 0 2\n"),
        ("camera-intrinsics.txt", "-5, 585, 3, 2\n"),
    ],
)
def test_a_malformed_text_is_named(seven_scenes, name, text):
    (seven_scenes / name).write_text(text)
    with pytest.raises(FormatError) as raised:
        certpgo.read_sequence(seven_scenes)
    assert raised.value.path.name == name


def test_what_is_no_sequence_is_refused(tmp_path):
    with pytest.raises(InputError, match="no frames"):
        certpgo.read_sequence(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        certpgo.read_sequence(tmp_path / "nowhere")
    save(tmp_path / "color/0.png", np.zeros((4, 4, 3), np.uint8))
    save(tmp_path / "depth/0.png", np.zeros((4, 4), np.uint16))
    save(tmp_path / "depth/1.png", np.zeros((4, 4), np.uint16))
    with pytest.raises(InputError, match="1 colour and 2 depth"):
        certpgo.read_sequence(tmp_path, camera="5,5,2,2")
    with pytest.raises(InputError, match="positive"):
        certpgo.read_sequence(tmp_path, camera="5,5,2,2", depth_scale=-1.0)


def test_a_camera_sees_where_its_rays_go():
    camera = camera_of("500,510,320,240")
    pixels = np.array([[0.0, 0.0], [320.0, 240.0], [639.0, 479.0]])
    assert np.abs(camera.pixels(2.5 * camera.rays(pixels)) - pixels).max() < 1e-12
    assert camera.cloud(np.ones((2, 3), np.float32)).shape == (6, 3)
    # Across the ray pixels, along it the sensor's noise.
    C = camera.covariances(np.array([[0.0, 0.0, 2.0]]))[0]
    assert C[2, 2] == pytest.approx(depth_noise(np.array(2.0)) ** 2)
    with pytest.raises(InputError, match="a camera is fx,fy,cx,cy"):
        camera_of("500,510,320")


def test_lines_of_a_camera_file_may_be_comments(tmp_path):
    path = tmp_path / "camera.param"
    path.write_text("# fx, fy, cx, cy\n525.0\n525.0\n319.5\n239.5\n")
    assert read_camera(path) == Camera(525, 525, 319.5, 239.5)

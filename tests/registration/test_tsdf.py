"""Fused depth: surfaces rendered in closed form come back."""

import numpy as np
import pytest

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.registration import tsdf
from certpgo.registration.camera import Camera

pytest.importorskip("skimage")

CAMERA = Camera(fx=120.0, fy=120.0, cx=63.5, cy=47.5)
RADIUS, AWAY = 0.5, 2.0


def rays():
    v, u = np.mgrid[0:96, 0:128]
    return CAMERA.rays(np.stack([u, v], axis=-1).astype(float))


def looking_at_the_origin(direction):
    """Camera to world, the camera AWAY from the origin and its axis through it."""
    z = -np.asarray(direction, dtype=float)
    x = np.cross([0.1, 1.0, 0.3], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1), -AWAY * z


def sphere(R, t):
    """Depth of the sphere of RADIUS about the origin, coloured by the world's axes."""
    ray = rays() @ R.T
    a, b, c = (ray**2).sum(-1), ray @ t, t @ t - RADIUS**2
    root = b**2 - a * c
    depth = np.where(root > 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, 0.0)
    place = t + depth[..., None] * ray
    return np.rint(255 * (place / RADIUS + 1) / 2).clip(0, 255).astype(np.uint8), depth


@pytest.fixture(scope="module")
def ball():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    poses = [looking_at_the_origin(axis) for axis in axes]
    estimate = Estimate(np.array([R for R, _ in poses]), np.array([t for _, t in poses]))
    frames = (sphere(R, t) for R, t in poses)
    return tsdf.mesh(tsdf.integrate(frames, estimate, CAMERA, voxel=0.02, truncation=0.08))


def test_a_sphere_comes_back_within_a_fraction_of_a_voxel(ball):
    vertices, _, colours = ball
    error = np.linalg.norm(vertices, axis=1) - RADIUS
    assert np.sqrt(np.mean(error**2)) < 0.25 * 0.02
    shown = 2.0 * colours / 255.0 - 1.0
    assert np.sqrt(np.mean((shown - vertices / RADIUS) ** 2)) < 0.05


def test_a_mesh_is_closed_and_faces_outward(ball):
    vertices, faces, _ = ball
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.sum(a * np.cross(b, c)) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.02)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert np.mean(count == 2) > 0.99


def test_a_plane_is_exact():
    """Distances along the axis are linear in the voxels: the zero is where the plane is."""
    depth = np.full((96, 128), 1.2345)
    colour = np.full((96, 128, 3), 77, np.uint8)
    pose = Estimate(np.eye(3)[None], np.array([[0.3, -0.2, 0.1]]))
    vertices, faces, colours = tsdf.mesh(
        tsdf.integrate([(colour, depth)], pose, CAMERA, voxel=0.02)
    )
    np.testing.assert_allclose(vertices[:, 2], 1.3345, atol=1e-6)
    assert (colours == 77).all()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] < 0.0).all()  # it faces the camera
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(1.2345**2 * 128 * 96 / 120**2, rel=0.07)  # but for the border


def test_frames_of_one_scene_average():
    frames = [(np.zeros((96, 128, 3), np.uint8), np.full((96, 128), z)) for z in (1.0, 1.02)]
    pose = Estimate(np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)))
    vertices, _, _ = tsdf.mesh(tsdf.integrate(frames, pose, CAMERA, voxel=0.02))
    np.testing.assert_allclose(vertices[:, 2], 1.01, atol=1e-6)


@pytest.mark.parametrize(
    ("frames", "voxel", "message"),
    [
        ([(np.zeros((4, 4, 3)), np.ones((4, 4)))] * 2, 0.1, "frame 1 has no pose"),
        ([(np.zeros((4, 5, 3)), np.ones((4, 4)))], 0.1, "of one size"),
        ([], 0.0, "voxel"),
    ],
)
def test_unusable_frames_are_refused(frames, voxel, message):
    pose = Estimate(np.eye(3)[None], np.zeros((1, 3)))
    with pytest.raises(InputError, match=message):
        tsdf.integrate(frames, pose, CAMERA, voxel=voxel)


def test_what_needs_too_much_memory_is_refused(monkeypatch):
    monkeypatch.setattr(tsdf, "MOST", 1e-3)
    pose = Estimate(np.eye(3)[None], np.zeros((1, 3)))
    frame = np.zeros((96, 128, 3), np.uint8), np.full((96, 128), 1.0)
    with pytest.raises(InputError, match="GB"):
        tsdf.integrate([frame], pose, CAMERA, voxel=0.01)


def test_an_empty_volume_has_no_mesh():
    with pytest.raises(InputError, match="no surface"):
        tsdf.mesh(tsdf.Volume(0.1, 0.4, {}))

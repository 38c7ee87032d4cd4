"""The viewer: what is given to viser, offline files, and what a browser makes of them."""

import io
import re
import sys
from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo.errors import InputError, MissingDependency
from certpgo.io.datasets import synthetic
from certpgo.io.surfaces import Surface
from certpgo.view import viewer
from certpgo.view.caption import OUTLINES
from certpgo.view.load_scene import scene_of

pytest.importorskip("viser", reason="viser is not installed")
import trimesh


class Handle:
    """What viser returns, with the attributes that were given or set."""

    def __init__(self, kind, name, given):
        self.kind, self.name = kind, name
        self.visible = given.pop("visible", True)
        self.__dict__.update(given)


class Api:
    """Records every ``add_...`` by name, as viser's scene."""

    def __init__(self):
        self.added = {}

    def __getattr__(self, kind):
        def add(name, *values, **given):
            names = {"add_line_segments": ("points", "colors"), "add_point_cloud": ("points",)}
            names["add_glb"] = ("glb",)
            given |= dict(zip(names.get(kind, ()), values, strict=False))
            assert name not in self.added
            self.added[name] = Handle(kind, name, given)
            return self.added[name]

        return add


class Server:
    def __init__(self):
        self.scene, self.initial_camera = Api(), Handle("camera", "", {})


@pytest.fixture(scope="module")
def answered():
    """A noisy grid in space with its answer, its dead reckoning, and a rejected edge."""
    instance = synthetic.grid3d(3, np.random.default_rng(0))
    things = instance, ("before", instance.truth), certpgo.solve(instance.graph, cost="chordal")
    return instance, scene_of(*things, rejected=[5])


def drawn(scene, **options):
    server = Server()
    drawing = viewer.Drawing(server, scene, **{"dark": False, "colour": None} | options)
    return drawing, server.scene.added, server.initial_camera


def test_viser_gets_every_edge_and_every_pose_once(answered):
    instance, scene = answered
    drawing, added, _ = drawn(scene)
    lines = {name: len(h.points) for name, h in added.items() if h.kind == "add_line_segments"}
    m, n = instance.graph.num_edges, instance.graph.num_nodes
    for name in ("before", "answer"):
        parts = ("steps", "loop closures", "rejected")
        assert sum(lines[f"/{name}/{part}"] for part in parts) == m
        assert lines[f"/{name}/rejected"] == 1
        assert lines[f"/{name}/poses"] == 8 * n
    assert list(drawing.layers) == ["answer", "before", "truth", *OUTLINES, "scale"]
    for outlines in scene.outlines:
        assert lines[f"/{outlines.name}/rings"] == len(outlines.wires()) > 0
    shown = [name for name, handle in drawing.layers.items() if handle.visible]
    assert shown == ["answer", "truth", "scale"]
    assert {"/answer/start", "/answer/end", "/scale/bar", "/scale/axes"} <= added.keys()


def test_edges_are_coloured_by_what_is_chosen(answered):
    _, scene = answered
    for unit in ("degrees", "metres"):
        drawing, added, _ = drawn(scene, colour=unit)
        steps = added["/answer/loop closures"]
        measure = scene.measure(scene.placements[-1], unit)
        shown = scene.are_loops & ~scene.rejected
        lightness = steps.colors[:, 0].astype(int) @ [2126, 7152, 722]
        worst = np.argmax(np.where(shown, measure.values, -1)[shown])
        assert lightness[worst] == lightness.min()
        assert steps.colors.shape == (shown.sum(), 2, 3)
    before = steps.colors.copy()
    drawing.recolour("degrees")
    assert not np.array_equal(before, steps.colors)
    with pytest.raises(InputError, match="coloured by degrees, metres; not by heat"):
        drawn(scene, colour="heat")


def test_the_camera_sees_all_of_the_answer(answered):
    _, scene = answered
    planar = scene_of(synthetic.winding_cycle(8, 0.1, 0)[0])
    for shown in (scene, planar):
        _, added, camera = drawn(shown)
        points = np.concatenate(
            [h.points.reshape(-1, 3) for name, h in added.items() if "poses" in name]
        )
        away = camera.position / np.linalg.norm(camera.position)
        depth = np.linalg.norm(camera.position) - points @ away
        up = np.cross(away, [1.0, 0.0, 0.0])
        assert depth.min() > 0.0
        assert (np.abs(points @ up) < depth * np.tan(0.5 * camera.fov)).all()
        assert (np.abs(points[:, 0]) < viewer.ASPECT * depth * np.tan(0.5 * camera.fov)).all()


def test_a_walk_visits_the_poses(answered):
    instance, scene = answered
    drawing, added, _ = drawn(scene)
    assert drawing.walk_length == instance.graph.num_nodes
    drawing.walk_to(3)
    first = np.array(added["/walker"].position)
    drawing.walk_to(4)
    step = np.linalg.norm(added["/walker"].position - first)
    t = scene.placements[-1].positions
    scale = viewer.EXTENT / scene.frame.extent
    assert step == pytest.approx(scale * np.linalg.norm(t[4] - t[3]))


def test_clouds_and_meshes_are_given_with_their_colours():
    rng = np.random.default_rng(0)
    faces = np.array([[0, 1, 2]])
    red = np.tile(np.array([[255, 0, 0]], dtype=np.uint8), (5, 1))
    points = rng.standard_normal((5, 3)) + 1e6
    scene = scene_of(Surface(points, red, faces), Surface(points, None, faces[:0]))
    drawing, added, _ = drawn(scene)
    assert list(drawing.layers) == ["mesh", "cloud", "scale"]
    assert added["/mesh"].kind == "add_glb"
    # Near the origin, where half precision has digits.
    assert np.abs(added["/cloud"].points).max() < viewer.EXTENT
    written = trimesh.load_scene(io.BytesIO(added["/mesh"].glb), file_type="glb")
    (mesh,) = written.geometry.values()
    assert np.array_equal(mesh.visual.vertex_attributes["color"][:, :3], red)
    assert np.allclose(mesh.vertices, added["/cloud"].points, rtol=0, atol=1e-6)
    assert (mesh.visual.material.doubleSided, mesh.visual.material.metallicFactor) == (True, 0.0)


@pytest.fixture(scope="module")
def page(answered, tmp_path_factory):
    path = tmp_path_factory.mktemp("offline") / "scene.html"
    _, scene = answered
    path.write_text(viewer.offline(replace(scene, name="<grid>")))
    return path


def test_an_offline_file_loads_nothing(page):
    text = page.read_text()
    assert "<title>&lt;grid&gt;</title>" in text
    head = text.partition("__VISER_EMBED_DATA__")[0]
    assert not re.search(r"<(script|link|img|iframe)[^>]*(src|href)=[\"']?https?:", head)
    assert "@import" not in head
    assert "url(http" not in head


def test_a_recorded_walk_is_longer_than_a_picture(answered):
    _, scene = answered
    assert len(viewer.offline(scene, play=True)) > len(viewer.offline(scene, dark=True))


def test_a_view_shows_itself_in_a_notebook_and_is_served(answered):
    instance, _ = answered
    view = certpgo.show(instance, instance.truth, dark=True)
    assert view._repr_html_().startswith('<iframe srcdoc="')
    with view.serve(port=8130) as address:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)


def test_without_viser_the_extra_is_named(answered, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingDependency, match=r"pip install 'trimesh.*' 'viser"):
        viewer.offline(answered[1])


def test_a_browser_draws_an_offline_file_without_errors(page, chromium):
    opened = chromium(page)
    assert any("Embedded data loaded" in line for line in opened.said), opened.log[-2000:]
    assert not opened.errors
    assert opened.picture.stat().st_size > 2000

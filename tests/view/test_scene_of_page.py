"""What is drawn on pages: the view of a trajectory, curves and bars, and the view's script."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from strategies import point_graph

from certpgo import Ranges, read, solve
from certpgo.graph import Estimate, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.view.charts import Curve, bars, histogram, lines
from certpgo.view.load_scene import scene_of
from certpgo.view.page import TEMPLATES
from certpgo.view.page_scene import page_scene
from certpgo.view.scene import colours


def scene(graph, problem, estimate, **limit):
    """The data of a page about an estimate."""
    return page_scene(scene_of(graph, estimate), problem.edge_costs(estimate), **limit)


@pytest.fixture(scope="module")
def grid():
    """A small grid of poses, at its truth."""
    instance = synthetic.grid3d(3, np.random.default_rng(0))
    return instance, Quadratic(instance.graph), instance.truth


def test_scene_of_poses(grid):
    instance, problem, truth = grid
    drawn = scene(instance, problem, truth)
    n, m = instance.graph.num_nodes, instance.graph.num_edges
    assert np.shape(drawn["points"]) == (n, 3)
    assert np.array_equal(drawn["edges"], instance.graph.edges)
    degrees, metres = drawn["measures"]
    angles = np.degrees(problem.residual_angles(truth))
    assert degrees["values"] == pytest.approx(angles, rel=1e-3)
    assert metres["unit"] == "metres"
    assert len(metres["values"]) == m
    consecutive = np.abs(np.diff(instance.ids[instance.graph.edges], axis=1))[:, 0] == 1
    assert drawn["loop"] == (~consecutive).astype(int).tolist()
    assert np.allclose(drawn["points"], truth.translations, rtol=0, atol=1e-4)


def test_many_edges_are_thinned_and_it_is_said(grid):
    instance, problem, truth = grid
    limit = 20
    drawn = scene(instance, problem, truth, limit=limit)
    assert len(drawn["edges"]) == len(set(drawn["numbers"])) == limit
    costs = problem.edge_costs(truth)
    assert set(np.argsort(-costs, kind="stable")[:2].tolist()) <= set(drawn["numbers"])
    for numbered, (i, j) in zip(drawn["numbers"], drawn["edges"], strict=True):
        ends = [drawn["ids"][i], drawn["ids"][j]]
        assert ends == instance.ids[instance.graph.edges[numbered]].tolist()
    m = instance.graph.num_edges
    assert drawn["sentences"][1].startswith(f"{limit} of {m} edges are drawn: the 2 costliest")
    assert "nodes" in drawn["sentences"][2]


def test_rotations_without_positions_stand_around_their_cycle():
    edges = np.stack([np.arange(8), (np.arange(8) + 1) % 8], axis=1)
    angle = 2.0 * np.pi * np.arange(8) / 8
    turned = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1)
    planar = RotationGraph(8, edges, np.tile(np.eye(2), (8, 1, 1)), np.ones(8))
    flat = scene(planar, Quadratic(planar), Estimate(turned.reshape(8, 2, 2)))
    assert np.linalg.norm(flat["points"], axis=1) == pytest.approx(1.0, abs=1e-4)
    assert [measure["unit"] for measure in flat["measures"]] == ["degrees"]
    assert flat["measures"][0]["values"] == [45.0] * 8
    assert np.shape(flat["frusta"]) == (24, 2, 2)
    assert not flat["metric"]
    graph = RotationGraph(8, edges, np.tile(np.eye(3), (8, 1, 1)), np.ones(8))
    solid = scene(graph, Quadratic(graph), Estimate(np.tile(np.eye(3), (8, 1, 1))))
    assert np.shape(solid["points"]) == (8, 3)
    assert solid["flat"]
    assert solid["measures"][0]["top"] == 0.0


def test_before_and_truth_are_drawn_beside_the_answer(grid):
    instance, problem, truth = grid
    shown = scene_of(instance, ("early", truth.moved(np.eye(3), np.ones(3))), truth)
    drawn = page_scene(shown, problem.edge_costs(truth))
    assert drawn["before"]["name"] == "early"
    assert np.allclose(drawn["before"]["points"], drawn["points"], rtol=0, atol=1e-4)
    assert drawn["before"]["values"] == [measure["values"] for measure in drawn["measures"]]
    steps = (np.abs(np.diff(instance.graph.edges, axis=1)) == 1).sum()
    assert np.shape(drawn["truth"]) == (steps, 2, 3)
    assert drawn["ends"] == [0, instance.graph.num_nodes - 1]
    # The page's points, in the frame, are around the origin.
    axes, centre = np.array(drawn["frame"]["axes"]), drawn["frame"]["centre"]
    along = (np.array(drawn["points"]) - centre) @ axes.T
    assert along.max(axis=0) == pytest.approx(-along.min(axis=0), abs=1e-3)


def test_a_histogram_counts_all():
    shown = histogram([0.0, 4.9, 5.0, 39.0, 40.0, float("nan")], "degrees")
    assert [bar.label for bar in shown.bars][:2] == ["0 to 5 degrees", "5 to 10 degrees"]
    assert [int(bar.text) for bar in shown.bars] == [2, 1, 0, 0, 0, 0, 0, 1, 1]
    assert histogram([1.0] * 2000, "degrees").bars[-1].text == "2,000"
    assert histogram([float("inf")], "degrees") is None
    assert histogram([0.0], "degrees").bars[0].text == "1"


def test_lines_and_bars():
    drawn = lines("F", "iteration", [Curve("a", [0, 1, 2], [3.0, math.nan, 1.0])])
    (label, points) = drawn.curves[0]
    assert label == "a"
    places = [tuple(map(float, place.split(","))) for place in points.split()]
    assert places == [(drawn.left, drawn.top), (drawn.right, drawn.bottom)]
    assert [mark.text for mark in drawn.x_marks] == ["0.0", "0.5", "1.0", "1.5", "2.0"]
    gap = lines("gap", "s", [Curve("a", [0, 1, 2], [1e2, 1e-4, -1.0])], logarithmic=True)
    assert [mark.text for mark in gap.y_marks] == ["1e-4", "1e-2", "1e0", "1e2"]
    assert len(gap.curves[0][1].split()) == 2
    assert lines("F", "iteration", [Curve("a", [0], [1.0])]) is None
    assert lines("F", "i", [Curve("a", [0, 1], [5.0, 5.0])]).y_marks
    shown = bars([-1.0, 0.0, 3.0], ["a", "b", "c"])
    assert shown.zero == 25.0
    assert [(bar.x, bar.width) for bar in shown.bars] == [(0, 25), (25, 0), (25, 75)]
    assert bars([0.0], ["a"]).bars[0].width == 0.0


@pytest.fixture
def node():
    """Runs a script after the view's, and returns what it prints as JSON."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")

    def run(script):
        code = (TEMPLATES / "scene.js").read_text() + f"\nconsole.log(JSON.stringify({script}));"
        done = subprocess.run([program, "-e", code], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_the_camera_turns_without_stretching(node):
    for turn, tilt in ((0.0, 0.0), (0.6, 0.6), (-2.0, 1.5)):
        C = np.array(node(f"Scene.camera({turn}, {tilt})"))
        assert np.allclose(C @ C.T, np.eye(3), rtol=0, atol=1e-12)
        assert np.linalg.det(C) == pytest.approx(1.0)


@pytest.mark.parametrize("d", [2, 3])
def test_ellipsoids_look_as_their_projection(node, d):
    rng = np.random.default_rng(d)
    B = rng.standard_normal((d, d))
    A, frame = B @ B.T, np.linalg.qr(rng.standard_normal((d, d)))[0]
    given = f"{json.dumps(A.tolist())}, {{axes: {json.dumps(frame.tolist())}}}"
    long, short, angle = node(f"Scene.outline({given}, {{turn: 0.7, tilt: 0.4}})")
    seen = np.array(node("Scene.camera(0.7, 0.4)"))[:2] @ frame if d == 3 else frame
    # The canvas has y downwards.
    seen = np.array([[1.0, 0.0], [0.0, -1.0]]) @ seen
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    assert turn @ np.diag([long**2, short**2]) @ turn.T == pytest.approx(seen @ A @ seen.T)
    ball = json.dumps((4.0 * np.eye(d)).tolist())
    assert node(f"Scene.outline({ball}, null, {{turn: 1, tilt: 0.2}})")[:2] == pytest.approx([2, 2])


def test_all_points_are_seen_from_everywhere(node):
    points = np.random.default_rng(0).standard_normal((50, 3)).tolist()
    flat = node(
        "(() => { const p = "
        + json.dumps(points)
        + "; const box = Scene.frame(p), out = [];"
        + "for (const turn of [0, 1, 2]) for (const tilt of [-1.5, 0, 0.7])"
        + " out.push(...Scene.project(p, box, {turn, tilt, zoom: 1, x: 0, y: 0}, 400, 300));"
        + " return out; })()"
    )
    places = np.reshape(flat, (-1, 2))
    assert places.min() >= 0.0
    assert np.all(places.max(axis=0) <= [400, 300])
    alone = "[[2, 3]], Scene.frame([[2, 3]]), Scene.start({dimensions: 2})"
    one = node(f"[...Scene.project({alone}, 400, 300)]")
    assert one == [200, 150]


def test_planar_points_fill_the_view_upright(node):
    flat = node(
        "(() => { const p = [[0, 0], [4, 0], [4, 1]]; return [...Scene.project(p, Scene.frame(p),"
        " Scene.start({dimensions: 2}), 400, 300)]; })()"
    )
    x, y = np.reshape(flat, (-1, 2)).T
    assert x.tolist() == pytest.approx([12, 388, 388])
    assert y[2] < y[1] == pytest.approx(197)


def test_points_in_a_frame_fill_the_view_from_above(node):
    points = (np.random.default_rng(0).standard_normal((50, 3)) * [9, 3, 1]).tolist()
    flat = node(
        f"(() => {{ const p = {json.dumps(points)}, box = Scene.frame(p);"
        " const from = Scene.start({dimensions: 3, frame: {}});"
        " box.seen = Scene.seenFrom(p, box, from);"
        " return [...Scene.project(p, box, from, 400, 300)]; })()"
    )
    places = np.reshape(flat, (-1, 2)) - [200, 150]
    assert np.abs(places[:, 0]).max() == pytest.approx(188)
    assert np.abs(places[:, 1]).max() <= 150
    turned = node("Scene.framed([[3, 1]], {axes: [[0, 1], [-1, 0]], centre: [1, 1]})")
    assert turned == [[0, -2]]
    assert node("[0.07, 1, 3, 49].map(Scene.round)") == pytest.approx([0.05, 1, 2, 20])


def test_python_and_the_script_have_the_same_colours(node):
    shares = np.linspace(0.0, 1.0, 7)
    for dark in (True, False):
        drawn = node(f"{shares.tolist()}.map((s) => Scene.colour(s, {str(dark).lower()}))")
        rgb = np.array([re.findall(r"\d+", shade) for shade in drawn], dtype=int)
        assert np.abs(rgb - colours(shares, dark=dark)).max() <= 1


def test_the_nearest_edge_is_named(node):
    data = json.dumps(
        {
            "edges": [[0, 1], [1, 2]],
            "ids": [7, 8, 12],
            "numbers": [3, 5],
            "loop": [0, 1],
            "measures": [
                {"unit": "degrees", "values": [1.5, 2]},
                {"unit": "metres", "values": [0.1, 0.2]},
            ],
        }
    )
    places = "[0, 0, 10, 0, 10, 10]"
    edges = "[[0, 1], [1, 2]]"
    assert node(f"Scene.nearest({edges}, {places}, 11, 6, 6)") == 1
    assert node(f"Scene.nearest({edges}, {places}, 4, -2, 6)") == 0
    assert node(f"Scene.nearest({edges}, {places}, 40, 40, 6)") == -1
    assert (
        node(f"Scene.sentence({data}, 1)")
        == "Edge 5, 8 to 12 (loop closure): residual 2 degrees, 0.2 metres."
    )
    assert node("Scene.ranking([1, 3, 2, 3])") == [1, 3, 2, 0]


def test_colours_keep_their_order_in_lightness(node):
    """Told apart by lightness alone, whatever the kind of colour blindness."""
    for dark in ("true", "false"):
        shades = node(
            f"[0, .1, .2, .3, .4, .5, .6, .7, .8, .9, 1].map(s => Scene.colour(s, {dark}))"
        )
        rgb = np.array([re.findall(r"\d+", shade) for shade in shades], dtype=float)
        lightness = rgb @ [0.2126, 0.7152, 0.0722]
        steps = np.diff(lightness)
        assert np.all(steps > 0) if dark == "true" else np.all(steps < 0)
    assert node("Scene.bucket(0, 0)") == 0
    assert node("Scene.bucket(9, 2)") == 31


FIELD = """\
EDGE_SE2 3 4 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 4 6 1 0 0.1 100 0 0 100 0 400
EDGE_SE2_XY 3 0 1 1 25 0 25
EDGE_SE2_XY 6 0 -1 1 25 0 25
EDGE_PRIOR_SE2 3 5 6 0.5 25 0 0 25 0 16
EDGE_PRIOR_SE2_XY 6 7 7 25 0 25
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    """Three poses, of which two see a landmark and two are measured from the world; solved."""
    path = tmp_path_factory.mktemp("field") / "field.g2o"
    path.write_text(FIELD)
    instance = read(path, quiet=True)
    return instance, solve(instance)


def test_landmarks_and_priors_are_drawn_as_such(field):
    instance, answer = field
    drawn = scene(instance, answer.problem, answer.estimate)
    assert drawn["ids"] == [0, 3, 4, 6]
    assert drawn["landmarks"] == [1, 0, 0, 0]
    assert drawn["kinds"] == [0, 0, 1, 1, 2, 2]
    assert drawn["edges"][2:] == [[1, 0], [3, 0], [1, 1], [3, 3]]
    there = instance.in_world(answer.estimate).translations
    assert np.allclose(drawn["points"], there, rtol=0, atol=1e-3)
    degrees, metres = drawn["measures"]
    assert [value == -1.0 for value in degrees["values"]] == [False, False, True, True, False, True]
    assert min(metres["values"]) >= 0.0
    assert drawn["sentences"][1:] == [
        "Drawn as dots: 1 landmark.",
        "Drawn as rings, at the nodes that they measure: 2 priors.",
        "Drawn as faint lines: 2 sightings.",
    ]
    thinned = scene(instance, answer.problem, answer.estimate, limit=3)
    assert instance.ids[instance.world] not in thinned["ids"]
    assert len(thinned["kinds"]) == 3
    assert thinned["sentences"][-1].startswith("3 of 6 edges are drawn")


def test_distances_are_drawn_with_their_errors(grid):
    plain, _, truth = grid
    lengths = np.linalg.norm(truth.translations[[26, 20]] - truth.translations[[0, 1]], axis=1)
    ranges = Ranges(
        27, np.array([[0, 26], [1, 20]]), lengths + np.array([0.25, 0.5]), np.array([1.0, 2.0])
    )
    instance = replace(plain, graph=plain.graph.with_ranges(ranges))
    drawn = scene(instance, objective_of(instance), truth)
    assert drawn["edges"][-2:] == [[0, 26], [1, 20]]
    assert drawn["kinds"][-3:] == [0, 3, 3]
    degrees, metres = drawn["measures"]
    assert degrees["values"][-2:] == [-1.0, -1.0]
    assert metres["values"][-2:] == pytest.approx([0.25, 0.5])
    assert len(metres["values"]) == plain.graph.num_edges + 2
    assert "Drawn as faint lines: 2 distances." in drawn["sentences"]
    assert scene_of(instance, truth).units[-1] == "distance weight"


def test_a_view_without_measured_rotations(field):
    """Sightings alone have no residual angles to colour by."""
    graph, truth = point_graph(np.random.default_rng(0), 3, 5, 2, odometry=False)
    drawn = scene(graph, Quadratic(graph), truth)
    assert [measure["unit"] for measure in drawn["measures"]] == ["metres"]
    assert drawn["kinds"] == [1] * graph.num_edges


def test_sightings_and_priors_are_named(node):
    data = {
        "edges": [[0, 1], [1, 1], [1, 1]],
        "ids": [7, 8],
        "numbers": [3, 5, 6],
        "loop": [1, 1, 1],
        "kinds": [1, 2, 2],
        "measures": [
            {"unit": "degrees", "values": [-1, 2, 3]},
            {"unit": "metres", "values": [0.1, 0.2, -1]},
        ],
    }
    said = node(f"[0, 1, 2].map((e) => Scene.sentence({json.dumps(data)}, e))")
    assert said == [
        "Edge 3, 7 to 8 (landmark seen): residual 0.1 metres.",
        "Edge 5, at 8 (prior): residual 2 degrees, 0.2 metres.",
        "Edge 6, at 8 (prior): residual 3 degrees.",
    ]
    places, edges = "[0, 0, 10, 0]", "[[0, 1], [1, 1]]"
    assert node(f"Scene.nearest({edges}, {places}, 4, 1, 6)") == 0
    assert node(f"Scene.nearest({edges}, {places}, 4, 1, 6, (e) => e !== 0)") == -1
    assert node(f"Scene.nearest({edges}, {places}, 11, 1, 6, (e) => e !== 0)") == 1

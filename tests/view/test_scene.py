"""Laws of scenes: what is drawn does not depend on the frame, the order of nodes or the source."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from features import having

import certpgo
from certpgo.errors import FormatError, InputError, InputNotice
from certpgo.graph import Estimate, Instance, RotationGraph, SimilarityGraph
from certpgo.graph.keys import Keys
from certpgo.graph.kinds import Kind
from certpgo.io.datasets import synthetic
from certpgo.io.datasets.monocular import random_maps
from certpgo.io.surfaces import Surface, read_surface
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.view.layout import layout
from certpgo.view.load_scene import scene_of
from certpgo.view.placements import aligned
from certpgo.view.scene import IN_UNITS, NOT_MEASURED, Measure, colours, frame_of

RNG = np.random.default_rng(0)
FIELD = """\
EDGE_SE2 3 4 1 0 0.1 100 0 0 100 0 400
EDGE_SE2 4 6 1 0 0.1 100 0 0 100 0 400
EDGE_SE2_XY 3 0 1 1 25 0 25
EDGE_SE2_XY 6 0 -1 1 25 0 25
EDGE_PRIOR_SE2 3 5 6 0.5 25 0 0 25 0 16
"""


@pytest.fixture(scope="module")
def helix():
    return synthetic.helix(4, np.random.default_rng(0))


@pytest.fixture(scope="module")
def grid():
    return synthetic.grid3d(3, np.random.default_rng(0))


def moved(estimate):
    return estimate.moved(so.random(RNG, 1, estimate.d)[0], RNG.standard_normal(estimate.d))


def test_residuals_are_those_of_the_problem(grid):
    scene = scene_of(grid, grid.truth)
    problem = Quadratic(grid.graph)
    degrees, metres = scene.placements[-1].measures
    assert degrees.values == pytest.approx(np.degrees(problem.residual_angles(grid.truth)))
    lengths = np.linalg.norm(problem.translation_residuals(grid.truth), axis=1)
    assert metres.values == pytest.approx(lengths)
    assert scene.units == ["degrees", "metres"]


def test_a_map_without_a_unit_is_drawn_in_its_own_and_the_truth_with_it():
    graph, truth = random_maps(np.random.default_rng(1), turn=0.0, scale=0.0, move=0.0)
    graph = graph.with_unknown_scales(np.ones(graph.num_nodes, dtype=bool))
    instance = Instance("maps", graph, np.arange(graph.num_nodes))
    scene = scene_of(instance, moved(truth), truth=truth.moved(np.eye(3), scale=10.0))
    assert scene.truth.positions == pytest.approx(scene.placements[-1].positions, abs=1e-9)
    assert scene.units[:2] == ["degrees", "units"]
    assert (scene.length_unit, scene.sentence) == ("units", IN_UNITS)


def test_a_map_on_a_line_is_scaled_too_with_its_graph_or_without():
    line = Estimate(np.tile(np.eye(3), (4, 1, 1)), np.eye(3)[0] * np.arange(4.0)[:, None])
    rotation = RotationGraph(4, [[0, 1], [1, 2], [2, 3]], line.rotations[1:], np.ones(3))
    steps = line.translations[1:] - line.translations[:3]
    free = np.ones(4, dtype=bool)
    graph = SimilarityGraph(rotation, steps, np.ones(3), scales=np.ones(3), free=free)
    known = replace(line, scales=np.ones(4))
    truth = line.moved(np.eye(3), np.ones(3), 10.0)
    for things in ([Instance("line", graph, np.arange(4)), known], [known]):
        scene = scene_of(*things, truth=truth)
        assert scene.truth.positions == pytest.approx(scene.placements[-1].positions)
        assert (scene.length_unit, scene.sentence) == ("units", IN_UNITS)


def test_a_moved_estimate_is_the_same_scene_moved(helix):
    first, second = scene_of(helix, helix.truth), scene_of(helix, moved(helix.truth))
    assert first.frame.half == pytest.approx(second.frame.half)
    assert first.frustum == pytest.approx(second.frustum)
    pairs = zip(first.placements[-1].measures, second.placements[-1].measures, strict=True)
    for one, other in pairs:
        assert one.values == pytest.approx(other.values, abs=1e-6)


def test_others_and_the_truth_are_aligned_with_the_answer(grid):
    answer = moved(grid.truth)
    scene = scene_of(grid, ("before", moved(grid.truth)), ("after", answer), truth=grid.truth)
    for placement in (*scene.placements, scene.truth):
        assert np.allclose(placement.positions, answer.translations, rtol=0, atol=1e-9)
        assert np.allclose(placement.rotations, answer.rotations, rtol=0, atol=1e-9)
    assert [placement.name for placement in scene.placements] == ["before", "after"]


def test_positions_on_a_line_are_aligned_by_rotations():
    R = so.random(RNG, 5, 3)
    line = Estimate(R, np.outer(np.arange(5.0), [1.0, 2.0, 3.0]))
    nodes = np.arange(5)
    there = aligned(moved(line), line, nodes, nodes)
    assert np.allclose(there.translations, line.translations, rtol=0, atol=1e-9)
    assert np.allclose(there.rotations, R, rtol=0, atol=1e-9)


def test_relabelled_nodes_are_drawn_at_the_same_places(helix):
    n = helix.graph.num_nodes
    order = np.random.default_rng(1).permutation(n)
    place = np.argsort(order)
    graph = replace(helix.graph, edges=place[helix.graph.edges])
    other = Instance("other", graph, helix.ids[order])
    first = scene_of(helix, helix.truth).placements[-1]
    second = scene_of(other, helix.truth.subset(order)).placements[-1]
    assert np.allclose(first.positions, second.positions, rtol=0, atol=1e-12)
    for one, two in zip(first.measures, second.measures, strict=True):
        assert one.values == pytest.approx(two.values)


def test_planar_graphs_lie_at_zero_and_are_seen_upright(tmp_path):
    path = tmp_path / "field.g2o"
    path.write_text(FIELD)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputNotice)
        instance = certpgo.read(path)
        scene = scene_of(instance, certpgo.solve(instance))
    (answer,) = scene.placements
    assert not answer.positions[:, 2].any()
    assert scene.is_flat
    assert scene.frame.axes[2].tolist() == [0, 0, 1]
    assert scene.ids[answer.nodes].tolist() == [0, 3, 4, 6]
    assert scene.landmarks[answer.nodes].tolist() == [True, False, False, False]
    kinds = (Kind.BETWEEN, Kind.BETWEEN, Kind.SIGHTING, Kind.SIGHTING, Kind.PRIOR)
    assert scene.kinds.tolist() == list(kinds)
    assert scene.are_steps.tolist() == [True, False, False, False, False]
    assert scene.are_loops.tolist() == [False, True, False, False, False]
    assert scene.edges[-1, 0] == scene.edges[-1, 1]
    degrees = scene.measure(answer, "degrees").values
    assert (degrees == NOT_MEASURED).tolist() == [False, False, True, True, False]
    # An arrow of three lines at each pose, none at the landmark.
    assert scene.frusta(answer).shape == (9, 2, 3)
    assert scene.frusta(answer, most=2).shape == (6, 2, 3)


def test_frames_are_right_handed_boxes_around_all_points():
    points = RNG.standard_normal((50, 3)) * [1.0, 9.0, 3.0] + [100.0, 0.0, -5.0]
    frame = frame_of(points)
    assert frame.axes @ frame.axes.T == pytest.approx(np.eye(3))
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)
    along = np.abs((points - frame.centre) @ frame.axes.T)
    assert along.max(axis=0) == pytest.approx(frame.half)
    assert np.argmax(np.abs(frame.axes[0])) == 1
    assert (np.diff(frame.half) < 0).all()
    assert frame_of(np.zeros((1, 3))).extent == 1.0


def test_cycles_are_circles_and_other_rotations_stand_by_their_neighbours():
    instance, _ = synthetic.winding_cycle(12, 0.1, 0)
    places = layout(instance.graph).places
    steps = places[instance.graph.edges]
    lengths = np.linalg.norm(steps[:, 1] - steps[:, 0], axis=1)
    assert lengths == pytest.approx(2 * np.sin(np.pi / 12))
    path = np.stack([np.arange(19), np.arange(1, 20)], axis=1)
    graph = RotationGraph(20, path, np.tile(np.eye(3), (19, 1, 1)), np.ones(19))
    first = layout(graph).places[:, 0]
    assert (np.diff(first) > 0).all() or (np.diff(first) < 0).all()
    # A clique with a tail of three nodes is not drawn as a point.
    clique = np.stack(np.triu_indices(24, 1), axis=1)[::3]
    edges = np.concatenate(
        [clique, [[0, 24], [24, 25], [25, 26]], np.stack([np.arange(23), np.arange(1, 24)], 1)]
    )
    tailed = RotationGraph(27, edges, np.tile(np.eye(3), (len(edges), 1, 1)), np.ones(len(edges)))
    assert np.median(np.abs(layout(tailed).places).max(axis=1)) > 0.3
    apart = RotationGraph(4, np.array([[0, 1], [2, 3]]), np.tile(np.eye(2), (2, 1, 1)), np.ones(2))
    assert np.linalg.norm(layout(apart).places, axis=1) == pytest.approx(1.0)


def test_a_wound_cycle_looks_wound():
    """Frusta of winding 1 turn once around; those of the optimum do not turn."""
    instance, wound = synthetic.winding_cycle(12, 0.0, 1)
    scene = scene_of(instance, wound)
    looks = scene.placements[-1].rotations[:, :, 0]
    assert np.linalg.norm(looks.sum(axis=0)) == pytest.approx(0.0, abs=1e-9)
    assert scene.placements[-1].measures[0].values == pytest.approx(30.0)
    assert not scene.metric


def test_rejected_edges_are_those_of_the_answer_or_as_given(grid):
    m = grid.graph.num_edges
    given = scene_of(grid, rejected=[2, 5]).rejected
    assert np.flatnonzero(given).tolist() == [2, 5]
    assert scene_of(grid, rejected=given).rejected.tolist() == given.tolist()
    assert not scene_of(grid, rejected=[]).rejected.any()
    known = replace(grid, outliers=given)
    assert scene_of(known).rejected.tolist() == given.tolist()
    answer = certpgo.solve_robustly(grid.graph)
    assert scene_of(grid, answer).rejected.sum() == len(answer.solution.rejected)
    with pytest.raises(InputError, match=f"rejected must be {m} flags"):
        scene_of(grid, rejected=[m])


def test_without_an_estimate_there_is_dead_reckoning_or_the_files_values(grid, tmp_path):
    assert [p.name for p in scene_of(grid.graph).placements] == ["dead reckoning"]
    path = tmp_path / "grid.g2o"
    certpgo.write(path, replace(grid, initial=grid.truth))
    scene = scene_of(path, grid.truth)
    assert [p.name for p in scene.placements] == ["initial values", "estimate"]
    # Values that say nothing.
    nowhere = grid.truth.with_translations(np.zeros((27, 3)))
    scene = scene_of(replace(grid, initial=nowhere))
    assert [p.name for p in scene.placements] == ["dead reckoning"]


def test_trajectories_are_matched_by_their_times(grid, tmp_path):
    first, second = tmp_path / "first.tum", tmp_path / "second.tum"
    certpgo.write(first, grid.truth)
    certpgo.write(second, moved(grid.truth).subset(np.arange(3, 20)), ids=np.arange(3, 20))
    scene = scene_of(first, second)
    whole, part = scene.placements
    assert part.nodes.tolist() == list(range(3, 20))
    assert np.allclose(whole.positions[3:20], part.positions, rtol=0, atol=1e-9)
    assert len(scene.steps(part)) == 16
    assert scene.units == []
    # Clocks that are read at other times, and a truth that begins later.
    seconds = np.arange(27) * 10**9 + 250_000_000
    ahead = grid.truth.keyed(Keys(times_ns=seconds + 4_000_000))
    late = moved(grid.truth).keyed(Keys(times_ns=seconds + 10**12)).subset(np.arange(5, 9))
    answer = grid.truth.keyed(Keys(times_ns=seconds))
    scene = scene_of(("ahead", moved(ahead)), ("answer", answer), truth=late, truth_offset=-1000.0)
    for track, nodes in ((scene.placements[0], slice(27)), (scene.truth, slice(5, 9))):
        expected = answer.translations[nodes]
        assert np.allclose(track.positions, expected, rtol=0, atol=1e-9)


def test_a_truth_with_labels_finds_its_nodes(grid):
    part = moved(grid.truth).keyed(Keys(ids=np.arange(27))).subset(np.array([7, 5, 9, 6]))
    truth = scene_of(grid, grid.truth, truth=part).truth
    assert truth.nodes.tolist() == [5, 6, 7, 9]
    expected = grid.truth.translations[truth.nodes]
    assert np.allclose(truth.positions, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_clouds_and_meshes_are_read(tmp_path, form):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 2]], dtype=float)
    header = (
        f"ply\nformat {form} 1.0\ncomment of a test\nelement vertex 4\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        "property uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    if order:
        row = np.dtype([("p", order + "f4", 3), ("c", "u1", 3)])
        table = np.zeros(4, row)
        table["p"], table["c"] = points, [255, 128, 0]
        body = table.tobytes() + b"\4" + np.arange(4, dtype=order + "i4").tobytes()
    else:
        rows = (f"{x:g} {y:g} {z:g} 255 128 0" for x, y, z in points)
        body = "\n".join([*rows, "4 0 1 2 3"]).encode()
    path = tmp_path / "square.ply"
    path.write_bytes(header.encode() + body)
    read = read_surface(path)
    assert read.points.tolist() == points.tolist()
    assert read.colours.tolist() == [[255, 128, 0]] * 4
    assert read.faces.tolist() == [[0, 1, 2], [2, 3, 0]]
    assert scene_of(path).surfaces[0][0] == "square"
    path.write_bytes((header.encode() + body)[:-6])
    with pytest.raises(
        FormatError, match=r"square.ply: (a complete PLY file expected|1 faces announced, 0 found)"
    ):
        read_surface(path)


def test_what_cannot_be_drawn_is_named(grid, tmp_path):
    text, flat = tmp_path / "notes.txt", tmp_path / "flat.ply"
    text.write_text("nothing\n")
    flat.write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
    empty = tmp_path / "empty.ply"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    empty.write_text(f"ply\nformat ascii 1.0\nelement vertex 0\n{axes}end_header\n")
    poses = Instance("apart", grid.graph.with_edges([0]), grid.ids)
    for things, said in (
        ((), "nothing to show"),
        ((text,), "notes.txt"),
        ((flat,), "flat.ply: vertices with x, y and z expected"),
        ((tmp_path / "none.g2o",), "no such file or dataset"),
        ((empty,), "empty.ply: at least one vertex with x, y and z expected"),
        ((Estimate(grid.truth.rotations),), "rotations without positions"),
        ((grid, grid), "a second graph"),
        ((grid, Estimate(np.tile(np.eye(3), (2, 1, 1)))), "an estimate of 27 nodes in 3D"),
        ((grid, Estimate(grid.truth.rotations)), "with positions"),
        ((grid, 3), "not an int"),
        ((poses,), "not connected"),
    ):
        with pytest.raises(InputError, match=said):
            scene_of(*things)
    # With an estimate, a graph in pieces is drawn.
    assert len(scene_of(poses, grid.truth).edges) == 1


def test_colours_differ_in_lightness_and_the_top_ignores_outliers():
    shares = np.linspace(0.0, 1.0, 9)
    for dark in (True, False):
        steps = np.diff(colours(shares, dark=dark) @ [0.2126, 0.7152, 0.0722])
        assert np.all(steps > 0) if dark else np.all(steps < 0)
    # Where the background is not known, all of them are seen on both: contrast of 3 and more.
    for rgb in colours(shares, dark=None) / 255.0:
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        luminance = linear @ [0.2126, 0.7152, 0.0722]
        assert 1.05 / (luminance + 0.05) > 3.0
        assert (luminance + 0.05) / 0.055 > 3.0
    values = np.concatenate([np.ones(99), [1e6, np.inf, NOT_MEASURED]])
    measure = Measure("degrees", values)
    assert measure.top == 1.0
    assert measure.shares[-3:].tolist() == [1.0, 1.0, 0.0]
    assert Measure("degrees", np.zeros(3)).shares.tolist() == [0.0] * 3


def test_surfaces_are_framed():
    cloud = Surface(RNG.standard_normal((40, 3)), None, np.zeros((0, 3), dtype=int))
    scene = scene_of(cloud)
    assert scene.surfaces[0][0] == "cloud"
    assert scene.frame.extent >= np.ptp(cloud.points[:, 0]) / np.sqrt(3)


@pytest.mark.parametrize("feature", ["distances", "own kinds"])
def test_measurements_that_are_no_edges_are_drawn_as_such(feature):
    answer = certpgo.solve(having(feature))
    assert certpgo.plot.trajectory(answer) is not None

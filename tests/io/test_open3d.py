"""Open3D's pose graphs: frames, weights against Open3D's own cost, round trips, malformed files."""

import json

import numpy as np
import pytest

import certpgo
from certpgo.errors import FormatError, InputError, InputNotice, NoMeasurements
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so

#: A quarter turn about z, and (1, 2, 3): source points to target points.
QUARTER = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1]
IDENTITY = np.eye(4).ravel().tolist()


def edge(target=0, source=1, transformation=QUARTER, information=None, **more):
    information = np.eye(6) if information is None else information
    return {
        "class_name": "PoseGraphEdge",
        "source_node_id": source,
        "target_node_id": target,
        "transformation": list(transformation),
        "information": np.asarray(information).ravel().tolist(),
        "confidence": 1.0,
        "uncertain": False,
        **more,
    }


def pose_graph(poses, edges):
    nodes = [{"class_name": "PoseGraphNode", "pose": list(pose)} for pose in poses]
    return {"class_name": "PoseGraph", "edges": edges, "nodes": nodes, "version_major": 1}


@pytest.fixture
def stored(file):
    """Writes the content of a JSON file as Open3D does, and returns its path."""

    def write(content, name="graph.json"):
        return file(json.dumps(content, indent="\t"), name)

    return write


def test_a_transformation_is_a_measurement_of_the_source_from_the_target(stored):
    instance = certpgo.read(stored(pose_graph([IDENTITY, QUARTER], [edge()])))
    graph = instance.graph
    assert instance.ids.tolist() == [0, 1]
    assert graph.edges.tolist() == [[0, 1]]
    assert np.abs(graph.rotations[0] - [[0, -1, 0], [1, 0, 0], [0, 0, 1]]).max() == 0.0
    assert graph.translations.tolist() == [[1.0, 2.0, 3.0]]
    # The poses of these nodes fit the measurement.
    assert certpgo.Quadratic(graph).cost(instance.initial) == 0.0


def test_information_has_rotation_before_translation(stored):
    omega = np.diag([2.0, 2, 2, 5, 5, 5])
    omega[0, 4] = omega[4, 0] = 0.25
    instance = certpgo.read(stored(pose_graph([IDENTITY, QUARTER], [edge(information=omega)])))
    assert (instance.graph.kappa[0], instance.graph.tau[0]) == (1.0, 5.0)
    found = instance.graph.information_matrices[0]
    assert np.diag(found).tolist() == [5, 5, 5, 2, 2, 2]
    assert found[3, 1] == found[1, 3] == 0.25
    about = certpgo.read(instance.source, rotation_information="quaternion")
    assert about.graph.kappa[0] == 0.25
    unit = certpgo.read(instance.source, unit_weights=True)
    assert unit.graph.tau[0] == 1.0
    assert unit.graph.information is None


def open3d_cost(content, estimate):
    """The sum of e^T Omega e that Open3D minimises, from the file alone."""
    total = 0.0
    T = np.tile(np.eye(4), (estimate.num_nodes, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = estimate.rotations, estimate.translations
    for one in content["edges"]:
        X = np.array(one["transformation"]).reshape(4, 4).T
        target, source = T[one["target_node_id"]], T[one["source_node_id"]]
        D = np.linalg.inv(X) @ np.linalg.inv(target) @ source
        turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
        e = np.concatenate([turn, D[:3, 3]])
        total += e @ np.array(one["information"]).reshape(6, 6) @ e
    return total


@pytest.mark.parametrize("mahalanobis", [False, True])
def test_f_is_open3ds_cost_to_second_order(stored, mahalanobis):
    rng = np.random.default_rng(3)
    made = helix(3, rng).graph
    truth = certpgo.solve(made).estimate
    edges = []
    for i, j in made.edges.tolist():
        R = truth.rotations[i].T @ truth.rotations[j]
        M = np.eye(4)
        M[:3, :3] = R
        M[:3, 3] = truth.rotations[i].T @ (truth.translations[j] - truth.translations[i])
        turned = (
            np.diag(rng.uniform(1.0, 1.9, 3)) if mahalanobis else 3.0 * rng.random() * np.eye(3)
        )
        omega = np.zeros((6, 6))
        omega[:3, :3], omega[3:, 3:] = 10.0 * turned, (1.0 + rng.random()) * np.eye(3)
        edges.append(edge(i, j, M.T.ravel(), omega))
    content = pose_graph([IDENTITY] * made.num_nodes, edges)
    graph = certpgo.read(stored(content), mahalanobis=mahalanobis).graph
    turn, step = rng.standard_normal((2, made.num_nodes, 3))
    for size in (1e-2, 1e-3):
        near = Estimate(truth.rotations @ so.exp(size * turn), truth.translations + size * step)
        ratio = certpgo.Quadratic(graph).cost(near) / open3d_cost(content, near)
        assert abs(ratio - 1.0) < 10.0 * size**2


def test_a_graph_survives_being_written_and_read(tmp_path):
    made = helix(4, np.random.default_rng(0))
    path = tmp_path / "helix.json"
    certpgo.write(path, made)
    found, graph = certpgo.read(path), made.graph
    assert found.graph.edges.tolist() == graph.edges.tolist()
    assert np.abs(found.graph.rotations - graph.rotations).max() < 1e-15
    assert (found.graph.translations == graph.translations).all()
    assert found.graph.kappa == pytest.approx(graph.kappa, rel=1e-15)
    assert (found.graph.tau == graph.tau).all()
    # Without initial values the nodes are along a spanning tree.
    assert np.isfinite(certpgo.Quadratic(graph).cost(found.initial))
    assert json.loads(path.read_text())["nodes"][0]["class_name"] == "PoseGraphNode"
    solved = certpgo.solve(found)
    certpgo.write(tmp_path / "solved.json", solved)
    again = certpgo.read_estimate(tmp_path / "solved.json", found)
    assert certpgo.certify(found, again).verdict == "CERTIFIED"


@pytest.mark.parametrize("about", ["tangent", "quaternion"])
def test_full_matrices_are_written_about_the_tangent_space(file, tmp_path, about):
    omega = np.diag([1.0, 2, 3, 40, 50, 60]) + 0.1
    upper = " ".join(map(repr, omega[np.triu_indices(6)].tolist()))
    lines = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {upper}\n"
    instance = certpgo.read(file(lines), rotation_information=about)
    certpgo.write(tmp_path / "full.json", instance)
    found = certpgo.read(tmp_path / "full.json")
    unit = np.repeat([1.0, {"tangent": 1.0, "quaternion": 0.5}[about]], 3)
    assert np.allclose(
        found.graph.information_matrices[0], omega * np.outer(unit, unit), rtol=1e-15
    )
    assert found.graph.kappa == pytest.approx(instance.graph.kappa, rel=1e-14)


def test_uncertain_edges_and_lost_ids_are_named(stored, tmp_path):
    content = pose_graph([IDENTITY, QUARTER], [edge(), edge(uncertain=True, confidence=0.25)])
    with pytest.warns(InputNotice, match="1 edge uncertain: read with all of the information"):
        graph = certpgo.read(stored(content)).graph
    assert graph.tau.tolist() == [1.0, 1.0]
    with pytest.warns(InputNotice, match="hold no node ids"):
        certpgo.write(tmp_path / "ids.json", Instance("ids", graph, np.array([4, 7])))


def test_a_file_without_edges_is_an_estimate(stored):
    path = stored(pose_graph([IDENTITY, QUARTER], None))
    assert certpgo.read_estimate(path).num_nodes == 2
    with pytest.raises(NoMeasurements, match="an estimate, not a graph"):
        certpgo.read(path)


def test_what_open3d_cannot_hold_is_refused(tmp_path):
    path = tmp_path / "out.json"
    planar = PoseGraph(RotationGraph(2, [[0, 1]], np.eye(2)[None], [1.0]), np.ones((1, 2)), [1.0])
    with pytest.raises(InputError, match="this graph is planar"):
        certpgo.write(path, planar)
    rotations = RotationGraph(2, [[0, 1]], np.eye(3)[None], [1.0])
    with pytest.raises(InputError, match="measures rotations alone"):
        certpgo.write(path, rotations)
    with pytest.raises(InputError, match="rotations only"):
        certpgo.write(path, Estimate(np.tile(np.eye(3), (2, 1, 1))))
    poses = PoseGraph(RotationGraph(3, [[0, 1]], np.eye(3)[None], [1.0]), np.ones((1, 3)), [1.0])
    certpgo.write(path, poses)
    assert certpgo.read(path).graph.num_nodes == 3
    points = PoseGraph(
        RotationGraph(2, [[0, 1]], np.eye(3)[None], [0.0]),
        np.ones((1, 3)),
        [1.0],
        points=[False, True],
    )
    with pytest.raises(InputError, match="neither priors nor points"):
        certpgo.write(path, points)


SKEW = np.eye(6) + np.triu(np.ones((6, 6)), 1)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"class_name": "PointCloud"}, 'class_name: "PoseGraph" expected'),
        ({"nodes": {}}, "nodes: a list expected"),
        ({"nodes": [7]}, r"nodes\[0\]: an object expected"),
        ({"nodes": [{"pose": QUARTER[:15]}] * 2}, r"nodes\[0\].pose: 16 finite numbers expected"),
        ({"nodes": [{"pose": [*QUARTER[:15], 2]}] * 2}, r"nodes\[0\].pose: .* last row 0 0 0 1"),
        ({"nodes": [{"pose": [2, *QUARTER[1:]]}] * 2}, r"nodes\[0\].pose: nine numbers of a rot"),
        ({"edges": [edge(), edge(source=2)]}, r"edges\[1\].source_node_id: one of the 2 nodes"),
        ({"edges": [edge(target="0")]}, r"edges\[0\].target_node_id: one of the 2 nodes"),
        ({"edges": [edge(source=0)]}, r"edges\[0\]: node 0 is measured from itself"),
        ({"edges": [edge(information=np.eye(5))]}, r"edges\[0\].information: 36 finite numbers"),
        ({"edges": [edge(information=SKEW)]}, r"edges\[0\].information: a symmetric matrix"),
        (
            {"edges": [edge(), edge(information=-np.eye(6))]},
            r"edges\[1\].information: the rotation block of the information is not positive def",
        ),
        ({"edges": [edge(transformation=[float("nan")] * 16)]}, r"edges\[0\].transformation: 16"),
    ],
)
def test_a_malformed_file_is_refused_with_its_key(stored, change, expected):
    content = pose_graph([IDENTITY, QUARTER], [edge()]) | change
    with pytest.raises(FormatError, match=expected):
        certpgo.read(stored(content), format="open3d")


def test_text_that_is_no_json_is_refused_with_its_line(file):
    path = file('{"class_name": "PoseGraph",\n"nodes": [}', "graph.json")
    with pytest.raises(FormatError, match=r"graph\.json:2: JSON expected"):
        certpgo.read(path)


def test_information_near_the_end_of_doubles_does_not_overflow(stored):
    huge = np.diag([1.5e308, 1, 1, 1, 1, 1])  # rotation before translation
    graph = certpgo.read(stored(pose_graph([IDENTITY, QUARTER], [edge(information=huge)]))).graph
    assert (graph.kappa[0], graph.tau[0]) == (0.75, 1.0)

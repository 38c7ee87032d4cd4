"""Maps merged by measurements between them: F* of the whole, and who disagrees."""

from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo import WORLD, Instance, Ranges, Verdict
from certpgo.errors import GraphError, InputError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.kinds import Kind, Node
from certpgo.graph.labels import Landmark
from certpgo.io.datasets.synthetic import helix


@pytest.fixture(scope="module")
def graph():
    return helix(6, np.random.default_rng(0)).graph


def cut(graph, parts, offset=100):
    """Maps of consecutive nodes with ids of their own, and what lies between them."""
    groups = np.array_split(np.arange(graph.num_nodes), parts)
    owner = np.repeat(np.arange(parts), [len(group) for group in groups])
    ids = np.concatenate([offset * k + np.arange(len(group)) for k, group in enumerate(groups)])
    across = owner[graph.edges[:, 0]] != owner[graph.edges[:, 1]]
    nodes = np.unique(graph.edges[across])
    joints = Instance("joints", graph.with_edges(across).subgraph(nodes), ids[nodes])
    return [graph.subgraph(group) for group in groups], joints


@pytest.mark.parametrize("parts", [2, 3])
def test_the_parts_have_the_optimum_of_the_whole(graph, parts):
    maps, joints = cut(graph, parts)
    merged, whole = certpgo.merge(maps, joints, offset=100), certpgo.solve(graph)
    assert merged.answer.verdict is Verdict.CERTIFIED
    assert merged.answer.cost == pytest.approx(whole.cost, rel=1e-9)
    assert merged.raised >= merged.terms.sum() * (1 - 1e-9)  # the maps' own terms cannot fall
    assert len(merged.between) == joints.graph.num_edges
    assert ((merged.tails >= 0.0) & (merged.tails <= 1.0)).all()


def test_distances_within_and_between_maps_have_the_optimum_of_the_whole():
    made = helix(4, np.random.default_rng(3))
    graph, at = made.graph, made.truth.translations
    half, n = graph.num_nodes // 2, graph.num_nodes
    pairs = np.array([[0, half - 1], [1, n - 1], [3, half + 2], [half, n - 1]])
    apart = np.linalg.norm(at[pairs[:, 1]] - at[pairs[:, 0]], axis=1)
    apart += np.array([0.1, -0.1, 0.0, 0.05])
    ranges = Ranges(n, pairs, apart, np.array([9.0, 4.0, 25.0, 16.0]))
    whole = Instance("whole", graph.with_ranges(ranges), np.arange(n))
    (first, second), joints = cut(graph, 2)
    own = Instance("first", first.with_ranges(ranges.between(np.arange(half))), np.arange(half))
    other = ranges.between(np.arange(half, n))
    theirs = Instance("second", second.with_ranges(other), np.arange(n - half))
    place = {label: k for k, label in enumerate(joints.ids.tolist())}
    across = [(k % half + 100 * (k >= half)) for k in pairs[1:3].ravel().tolist()]
    new = [k for k in across if k not in place]
    place |= {label: len(place) + k for k, label in enumerate(new)}
    edges = np.array([place[k] for k in across]).reshape(2, 2)
    nodes = np.full(len(place), Node.POSE)
    between = Instance(
        "between",
        replace(joints.graph, nodes=nodes).with_ranges(
            Ranges(len(place), edges, apart[1:3], ranges.weights[1:3])
        ),
        np.array(list(place)),
    )
    merged, direct = certpgo.merge([own, theirs], between, offset=100), certpgo.solve(whole)
    assert merged.answer.cost == pytest.approx(direct.cost, rel=1e-8)
    assert merged.answer.certificate.lower_bound <= direct.cost
    assert direct.certificate.lower_bound <= merged.answer.cost
    m, joined = graph.num_edges, merged.instance.measurements
    assert joined.counts == {Kind.BETWEEN: m, Kind.RANGE: 4}
    assert merged.between.tolist() == [*range(m - joints.graph.num_edges, m), m + 2, m + 3]
    named = {tuple(merged.instance.ids[pair]) for pair in joined.edges[m + 2 :].tolist()}
    assert named == {tuple(across[:2]), tuple(across[2:])}
    assert merged.raised >= merged.terms.sum() - 1e-6
    assert len(merged.disagreeing) == 0
    far = replace(
        between,
        graph=between.graph.with_ranges(
            replace(between.graph.ranges, distances=apart[1:3] + np.array([5.0, 0.0]))
        ),
    )
    wrong = certpgo.merge([own, theirs], far, offset=100)
    assert m + 2 in wrong.disagreeing
    assert "1-" in wrong.named(m + 2)


def test_eight_maps_have_the_optimum_of_the_sphere(dataset):
    graph = dataset("sphere2500").graph
    maps, joints = cut(graph, 8, offset=1000)
    merged = certpgo.merge(maps, joints, offset=1000, cost="chordal")
    assert merged.answer.verdict is Verdict.CERTIFIED
    assert merged.answer.cost == pytest.approx(1687.0058, rel=1e-7)
    assert {part.verdict for part in merged.parts} == {Verdict.CERTIFIED}
    assert len(merged.disagreeing) == 0


def test_a_wrong_joint_is_named_and_left_out(graph):
    maps, joints = cut(graph, 2)
    turned = RotationGraph(2, [[0, 1]], [np.diag([1.0, -1.0, -1.0])], [1e4])
    wrong = PoseGraph(turned, [[9.0, 9.0, 9.0]], [1e4])
    nodes = joints.graph.num_nodes
    both = certpgo.graph.concatenate.joined(
        [joints.graph, wrong], nodes + 1, None, [np.arange(nodes), np.array([0, nodes])]
    )
    ids = np.array([*joints.ids, 117])
    if 117 in joints.ids:
        pytest.skip("the node has a joint already")
    merged = certpgo.merge(maps, Instance("joints", both, ids), offset=100, robust=True)
    assert graph.num_edges in merged.disagreeing
    assert merged.left_out
    said = " ".join(str(merged).split())
    assert f"left out {merged.named(graph.num_edges)}" in said
    kept = merged.terms[~np.isin(merged.between, merged.disagreeing)]
    assert f"{len(kept)} of {len(merged.terms)} measurements kept, " in said
    assert f"add up to {kept.sum():.4g}" in said
    assert merged.answer.verdict is Verdict.CERTIFIED
    assert merged.answer.cost <= certpgo.solve(graph).cost * (1 + 1e-9)


def test_the_merged_graph_keeps_the_information_of_its_files(graph, tmp_path):
    maps, joints = cut(graph, 2)
    paths = [tmp_path / f"{name}.g2o" for name in ("first", "second", "joints")]
    ids = [np.arange(one.num_nodes) for one in maps]
    for path, one, own in zip(paths, [*maps, joints.graph], [*ids, joints.ids], strict=True):
        certpgo.write(path, Instance("part", one, own))
    *read, between = (certpgo.read(path) for path in paths)
    merged = certpgo.merge(read, between, offset=100).instance
    stated = np.concatenate([part.graph.information_matrices for part in (*read, between)])
    assert np.array_equal(merged.graph.information_matrices, stated)
    assert certpgo.solve(merged).certificate.objective.startswith("g2o's chi2")
    assert certpgo.merge([maps[0], read[1]], between, offset=100).instance.graph.information is None


def test_maps_that_cannot_be_merged_are_refused(graph):
    maps, joints = cut(graph, 2)
    with pytest.raises(InputError, match="node 0 is in several maps"):
        certpgo.merge(maps, joints)
    with pytest.raises(InputError, match="at least two maps, not 1"):
        certpgo.merge(maps[:1], joints)
    with pytest.raises(InputError, match="a larger offset is due"):
        certpgo.merge(maps, joints, offset=3)
    with pytest.raises(InputError, match="is in none of the maps"):
        certpgo.merge(maps, joints, offset=1000)
    names = tuple(f"x{k}" for k in range(maps[0].num_nodes))
    named = Instance("named", maps[0], np.arange(maps[0].num_nodes), names=names)
    with pytest.raises(InputError, match="node x0 of map 0 has a name: an offset is for ids"):
        certpgo.merge([named, maps[1]], joints, offset=100)
    inside = Instance("inside", maps[0].with_edges(np.array([0])), np.arange(maps[0].num_nodes))
    with pytest.raises(InputError, match="is within one map"):
        certpgo.merge(maps, inside, offset=100)


def read(folder, *lines):
    path = folder / "map.g2o"
    path.write_text("\n".join(lines) + "\n")
    return certpgo.read(path, quiet=True)


def step(i, j, x=1.0):
    return f"EDGE_SE2 {i} {j} {x} 0 0 100 0 0 100 0 100"


def prior(i, x):
    return f"EDGE_PRIOR_SE2 {i} {x} 5000000 0 100 0 0 100 0 100"


def test_maps_with_priors_share_one_world(tmp_path):
    first = [step(0, 1), step(1, 2), prior(0, 500000.25), prior(2, 500002.375)]
    second = [step(4, 5), prior(4, 500903.5), prior(5, 500905.25)]  # 3 is the first map's world
    joints = [step(2, 4, 900.0), step(0, 4, 903.0)]
    maps, between = [read(tmp_path, *lines) for lines in (first, second)], read(tmp_path, *joints)
    whole = read(tmp_path, *first, *second, *joints)
    assert len({tuple(one.origin) for one in (*maps, whole)}) == 3
    merged = certpgo.merge(maps, between)
    best = certpgo.solve(whole.graph)
    assert merged.answer.verdict is best.verdict is Verdict.CERTIFIED
    assert merged.answer.cost == pytest.approx(best.cost, rel=1e-9)
    assert merged.instance.labels == (0, 1, 2, 4, 5, WORLD)
    assert merged.between.tolist() == [7, 8]
    in_world = [
        one.in_world(answer.estimate).translations
        for one, answer in ((merged.instance, merged.answer), (whole, best))
    ]
    assert in_world[0] == pytest.approx(in_world[1], abs=1e-6)
    certpgo.write(tmp_path / "merged.g2o", merged.instance)
    again = certpgo.solve(certpgo.read(tmp_path / "merged.g2o", quiet=True))
    assert again.cost == pytest.approx(certpgo.solve(whole).cost, rel=1e-9)
    with pytest.raises(InputError, match="priors are of one map, not between two"):
        certpgo.merge(maps, read(tmp_path, *joints, prior(0, 500000.25)))


def test_landmarks_that_are_numbered_apart_are_no_poses(tmp_path):
    seen = "LANDMARK2 {} {} {} {} 50 0 50".format
    first = [step(0, 1), seen(0, 0, 0.5, 1), seen(1, 0, -0.4, 1)]
    second = [step(0, 1), seen(0, 1, 0.5, 1), seen(1, 1, -0.5, 1.1)]
    joints = [step(1, 10), seen(10, 0, -1.6, 1.0), seen(0, 11, 2.3, 1.0)]
    maps, between = [read(tmp_path, *lines) for lines in (first, second)], read(tmp_path, *joints)
    shifted = [step(10, 11), seen(10, 11, 0.5, 1), seen(11, 11, -0.5, 1.1)]
    whole = read(tmp_path, *first, *shifted, *joints)
    for cost in (None, "chordal", "gtsam"):
        merged = certpgo.merge(maps, between, offset=10, cost=cost)
        assert merged.instance.labels == (0, 1, 10, 11, Landmark(0), Landmark(11))
        best = certpgo.solve(whole, cost=cost)
        assert merged.answer.cost == pytest.approx(best.cost, rel=1e-9)
        assert merged.answer.verdict is best.verdict
        assert merged.answer.certificate.objective == best.certificate.objective
    with pytest.raises(GraphError, match="node 11 is a pose and a point"):
        certpgo.merge(maps, read(tmp_path, "EDGE_SE2_XY 0 11 1 1 50 0 50"), offset=10)


def test_maps_whose_nodes_have_names_are_merged_by_these(tmp_path):
    def file(name, vertices, edges):
        lines = [f"VERTEX_SE2 0 {vertex} 0 0 0" for vertex in vertices]
        for i, j, x in edges:
            lines.append(f"EDGE_SE2 0 {i} {j} {x} 0 0 .01 0 0 .01 0 .01")
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return certpgo.read(path, quiet=True)

    maps = [
        file("a.pyfg", ["A0", "A1"], [("A0", "A1", 1)]),
        file("b.pyfg", ["B0", "B1"], [("B0", "B1", 1)]),
    ]
    joints = [("B0", "A1", -1), ("A0", "B1", 3.3)]
    merged = certpgo.merge(maps, file("joints.pyfg", ["B1", "B0", "A1", "A0"], joints))
    assert merged.instance.names == ("A0", "A1", "B0", "B1")
    assert merged.answer.cost == pytest.approx(100 * 0.3**2 / 4, rel=1e-9)
    assert merged.named(3).startswith("A0-B1 ")


def test_the_fit_of_maps_is_of_the_joints_that_are_kept(tmp_path):
    def written(name, steps):
        lines = (f"EDGE_SE2 {i} {j} {x} 0 0 100 0 0 200 0 300" for i, j, x in steps)
        (tmp_path / name).write_text("\n".join([*lines, ""]))
        return certpgo.read(tmp_path / name)

    first = written("first.g2o", [(0, 1, 1.0), (1, 2, 1.0), (0, 2, 2.1)])
    second = written("second.g2o", [(10, 11, 1.0), (11, 12, 1.0), (10, 12, 2.1)])
    joints = written("joints.g2o", [(2, 10, 1.0), (1, 10, 2.0), (0, 10, 3.0), (0, 12, 50.0)])
    merged = certpgo.merge([first, second], joints, robust=True)
    assert merged.left_out
    [wrong] = merged.disagreeing
    assert wrong == merged.between[-1]
    assert merged.fit.freedom == 3 * (merged.instance.graph.num_edges - 1 - 5)

"""Maps merged by measurements between them: F* of the whole, and who disagrees."""

import numpy as np
import pytest

import certpgo
from certpgo import Instance, PoseGraph, RotationGraph, Verdict
from certpgo.datasets.synthetic import helix
from certpgo.errors import InputError


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


def test_eight_maps_have_the_optimum_of_the_sphere(dataset):
    graph = dataset("sphere2500").graph
    maps, joints = cut(graph, 8, offset=1000)
    merged = certpgo.merge(maps, joints, offset=1000)
    assert merged.answer.verdict is Verdict.CERTIFIED
    assert merged.answer.cost == pytest.approx(1687.0058, rel=1e-7)
    assert {part.verdict for part in merged.parts} == {Verdict.CERTIFIED}
    assert len(merged.disagreeing) == 0


def test_a_wrong_joint_is_named_and_left_out(graph):
    maps, joints = cut(graph, 2)
    turned = RotationGraph(2, [[0, 1]], [np.diag([1.0, -1.0, -1.0])], [1e4])
    wrong = PoseGraph(turned, [[9.0, 9.0, 9.0]], [1e4])
    nodes = joints.graph.num_nodes
    both = certpgo.graph.joining.joined(
        [joints.graph, wrong], nodes + 1, None, [joints.graph.edges, np.array([[0, nodes]])]
    )
    ids = np.array([*joints.ids, 117])
    if 117 in joints.ids:
        pytest.skip("the node has a joint already")
    merged = certpgo.merge(maps, Instance("joints", both, ids), offset=100, robust=True)
    assert graph.num_edges in merged.disagreeing
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
    stated = np.concatenate([part.information.matrices for part in (*read, between)])
    assert np.array_equal(merged.information.matrices, stated)
    assert certpgo.solve(merged).certificate.objective.startswith("g2o's chi2")
    assert certpgo.merge([maps[0], read[1]], between, offset=100).instance.information is None


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
    inside = Instance("inside", maps[0].with_edges(np.array([0])), np.arange(maps[0].num_nodes))
    with pytest.raises(InputError, match="is within one map"):
        certpgo.merge(maps, inside, offset=100)

"""GTSAM's Values: keys that are ids, Symbols, other numbers; poses and rotations, 2D and 3D."""

import numpy as np
import pytest
from strategies import pose_graph

import certpgo
from certpgo import InputNotice
from certpgo.certify import Verdict
from certpgo.errors import GraphError, InputError
from certpgo.graph import Estimate, Instance
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton

N = 6


class Element:
    def __init__(self, M):
        self.M = M

    def matrix(self):
        return self.M


class Values:
    """What certify_values asks for, as GTSAM's bindings behave: another type is a RuntimeError."""

    def __init__(self, elements):
        self.elements = elements

    def keys(self):
        return list(self.elements)

    def _at(self, key, name):
        kind, M = self.elements[key]
        if kind != name:
            raise RuntimeError("wrong type")
        return Element(M)

    def __getattr__(self, name):
        if not name.startswith("at"):
            raise AttributeError(name)
        return lambda key: self._at(key, name[2:])


def symbol(letter, index):
    return (ord(letter) << 56) | index


def values_of(estimate, keys, kind="Pose"):
    d = estimate.d
    elements = {}
    for k, key in enumerate(keys):
        M = np.eye(d + 1)
        M[:d, :d] = estimate.rotations[k]
        if kind == "Pose":
            M[:d, d] = estimate.translations[k]
        elements[int(key)] = (f"{kind}{d}", M if kind == "Pose" else M[:d, :d])
    return Values(elements)


def solved(d, rotations=False):
    graph, R, t = pose_graph(np.random.default_rng(d), N, d)
    problem = Quadratic(graph.rotations_alone if rotations else graph)
    return graph, newton(problem, Estimate(R, None if rotations else t)).estimate


@pytest.mark.parametrize("d", [2, 3])
def test_poses_for_poses_and_for_rotations(d):
    graph, estimate = solved(d)
    values = values_of(estimate, range(N))
    certificate = certpgo.certify_values(graph, values)
    assert certificate.verdict is Verdict.CERTIFIED
    assert certificate.cost_upper == pytest.approx(Quadratic(graph).cost(estimate), rel=1e-12)
    rotations = certpgo.certify_values(graph.rotations_alone, values)
    expected = Quadratic(graph.rotations_alone).cost(estimate)
    assert rotations.cost_upper == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_rotations_alone(d):
    graph, estimate = solved(d, rotations=True)
    values = values_of(estimate, range(N), "Rot")
    assert certpgo.certify_values(graph.rotations_alone, values).verdict is Verdict.CERTIFIED
    with pytest.raises(InputError, match="rotations only"):
        certpgo.certify_values(graph, values)
    assert (
        certpgo.certify_values(graph.rotations_alone, values, tier="screen").tier.value == "screen"
    )


def test_symbols_match_by_their_index_in_any_order_and_this_is_said():
    graph, estimate = solved(3)
    ids = np.array([4, 7, 8, 11, 20, 30])
    instance = Instance("walk", graph, ids)
    order = np.array([5, 0, 3, 1, 2, 4])
    keys = [symbol("x", int(k)) for k in ids[order]]
    values = values_of(estimate.subset(order), keys)
    values.elements[symbol("l", 4)] = ("Point3", np.zeros(3))
    values.elements[symbol("x", 99)] = ("Pose3", np.eye(4))
    with pytest.warns(InputNotice, match=r"index of the symbols x4 .*; 1 pose of other keys"):
        certificate = certpgo.certify_values(instance, values)
    assert certificate.verdict is Verdict.CERTIFIED


def test_as_many_keys_match_in_ascending_order_and_this_is_said():
    graph, estimate = solved(3)
    keys = np.array([12, 15, 11, 20, 19, 13])
    values = values_of(estimate.subset(np.argsort(np.argsort(keys))), keys)
    with pytest.warns(InputNotice, match=r"6 keys 11 \.\.\. 20, .*: matched in ascending order"):
        assert certpgo.certify_values(graph, values).verdict is Verdict.CERTIFIED


def test_keys_that_are_given_are_not_guessed():
    graph, estimate = solved(3)
    keys = [symbol("b", k) for k in range(N)]
    values = values_of(estimate, keys)
    values.elements |= values_of(estimate.subset(np.arange(N)[::-1]), range(N)).elements
    assert certpgo.certify_values(graph, values, ids=keys).verdict is Verdict.CERTIFIED
    with pytest.raises(InputError, match="no 3D pose or rotation at key c0"):
        certpgo.certify_values(graph, values, ids=[symbol("c", k) for k in range(N)])
    with pytest.raises(InputError, match="6 distinct integers"):
        certpgo.certify_values(graph, values, ids=[0] * N)


def pose(d):
    return (f"Pose{d}", np.eye(d + 1))


REFUSED = {
    "too few": ({k: pose(3) for k in range(4)}, "the values hold 4 keys 0 ... 3"),
    "two letters": (
        {symbol(letter, k): pose(3) for letter in "ab" for k in range(N)},
        "several letters fit",
    ),
    "others": ({symbol("x", k + 1): pose(3) for k in range(7)}, "7 keys x1 ... x7, the graph has"),
    "2D": ({k: pose(2) for k in range(N)}, "the values are 2D, but the graph is 3D"),
    "points": ({k: ("Point3", np.zeros(3)) for k in range(N)}, "6 values, but no 3D pose"),
    "none": ({}, "0 values, but no 3D pose"),
}


def test_the_path_of_a_file_stands_for_its_instance(tmp_path):
    graph, estimate = solved(3)
    instance = Instance("walk", graph, np.array([4, 7, 8, 11, 20, 30]))
    path = tmp_path / "walk.g2o"
    certpgo.write(path, instance)
    values = values_of(estimate, instance.ids)
    of_file, of_instance = (certpgo.certify_values(x, values) for x in (path, instance))
    assert of_file.verdict is of_instance.verdict is Verdict.CERTIFIED
    assert of_file.cost_upper == pytest.approx(of_instance.cost_upper, rel=1e-9)
    assert certpgo.certify_values(str(path), values).verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("what", REFUSED)
def test_values_that_do_not_fit(what):
    graph, _ = solved(3)
    elements, said = REFUSED[what]
    with pytest.raises(InputError) as caught:
        certpgo.certify_values(graph, Values(elements))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_reflection_is_no_rotation():
    graph, estimate = solved(3)
    values = values_of(estimate, range(N))
    values.elements[2] = ("Pose3", np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(GraphError, match="node 2: not a rotation"):
        certpgo.certify_values(graph, values)


@pytest.mark.gtsam
@pytest.mark.parametrize("kind", ["Pose3", "Pose2", "Rot3", "Rot2"])
def test_gtsams_own_values(kind):
    gtsam = pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")
    d = int(kind[-1])
    graph, estimate = solved(d, rotations=kind.startswith("Rot"))
    if kind.startswith("Rot"):
        graph = graph.rotations_alone
    assert graph.has_positions != kind.startswith("Rot")
    values = gtsam.Values()
    for k in range(N):
        R = estimate.rotations[k]
        turn = gtsam.Rot3(R) if d == 3 else gtsam.Rot2.fromCosSin(R[0, 0], R[1, 0])
        if kind.startswith("Pose"):
            turn = getattr(gtsam, kind)(turn, estimate.translations[k])
        values.insert(gtsam.symbol("x", k), turn)
    with pytest.warns(InputNotice, match="symbols x0"):
        certificate = certpgo.certify_values(graph, values)
    assert certificate.verdict is Verdict.CERTIFIED

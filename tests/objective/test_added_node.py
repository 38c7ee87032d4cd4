"""A kind of node by a row in two tables: everything that takes a graph knows it."""

from dataclasses import replace

import numpy as np
import pytest
from mixtures import COSTS, mixture
from strategies import rng_of

import certpgo
from certpgo import Quadratic
from certpgo.errors import GraphError, InputError
from certpgo.graph.kinds import NODES, Node
from certpgo.io.datasets.synthetic import grid3d, helix
from certpgo.linalg import rotations as so
from certpgo.objective.manifolds import MANIFOLDS, POSE, traceless
from certpgo.optima.fingerprint import fingerprint

MIRRORED = max(Node) + 1


@pytest.fixture(autouse=True)
def known(monkeypatch):
    """Frames of either handedness, as cameras have that look into mirrors."""
    kind = replace(POSE, name="poses of either handedness", rounded=so.orthonormal)
    monkeypatch.setitem(NODES, MIRRORED, "pose{s} of either handedness")
    monkeypatch.setitem(MANIFOLDS, MIRRORED, kind)


def with_mirrors(graph, every=3):
    """Every third pose of the graph is of the kind."""
    nodes = graph.nodes.copy()
    nodes[graph.pose_nodes[::every]] = MIRRORED
    return replace(graph, nodes=nodes)


def test_its_blocks_are_what_the_kind_admits():
    graph = with_mirrors(grid3d(2, rng_of(2)).graph)
    flipped = np.tile(np.diag([1.0, 1.0, -1.0]), (8, 1, 1))
    signs = np.linalg.det(Quadratic(graph).kinds.apply("rounded", flipped))
    assert np.rint(signs).tolist() == [-1, 1, 1, -1, 1, 1, -1, 1]
    assert (graph.rotations_alone.nodes == Node.ROTATION).all()
    with pytest.raises(GraphError, match="rotations alone, or none"):
        with_mirrors(graph.rotations_alone)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", COSTS)
def test_it_is_solved_and_certified_with_all_measurements_under_any_cost(d, cost):
    graph, truth = mixture(rng_of(d), d)
    mirrored = with_mirrors(graph)
    answer, usual = certpgo.solve(mirrored, cost=cost), certpgo.solve(graph, cost=cost)
    assert answer.verdict.value == usual.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(usual.cost, rel=1e-9)
    judged = certpgo.certify(mirrored, truth, cost=cost)
    assert judged.lower_bound <= usual.cost <= judged.cost_upper


def test_poses_of_unknown_scale_beside_it():
    graph = grid3d(3, rng_of(0)).graph
    free = np.arange(graph.num_nodes) % 2 == 1
    scaled = with_mirrors(graph.with_unknown_scales(free), 2)
    assert (scaled.nodes[free] == Node.SCALED).all()
    assert scaled.with_unknown_scales(~free & (scaled.nodes == Node.POSE)).is_other.any()
    answer, usual = certpgo.solve(scaled), certpgo.solve(graph.with_unknown_scales(free))
    assert answer.verdict is usual.verdict
    assert answer.cost == pytest.approx(usual.cost, rel=1e-9)


@pytest.mark.parametrize("cost", COSTS)
def test_a_session_takes_it_and_gives_measurements_up(cost):
    graph = with_mirrors(mixture(rng_of(3), 3)[0])
    n, m = graph.num_nodes, graph.num_edges
    first = graph.is_point[graph.edges].any(axis=1) | (np.arange(m) < n)
    session = certpgo.Session(cost=cost, every=None)
    session.add(graph.with_blocks().with_edges(first))
    session.add(graph.with_edges(~first), list(range(n)))
    standing = session.refresh()
    assert standing.verdict.value == "CERTIFIED"
    assert standing.cost == pytest.approx(certpgo.solve(graph, cost=cost).cost, rel=1e-9)


def test_maps_that_have_it_are_merged():
    graph = with_mirrors(mixture(rng_of(4), 3)[0])
    n = graph.num_nodes
    maps = [certpgo.Instance(f"map {k}", graph, np.arange(n) + k * n) for k in (0, 1)]
    pair = graph.with_blocks().with_edges([0]).subgraph([0, 1])
    joints = certpgo.Instance("joints", pair, np.array([0, n + 1]))
    merged = certpgo.merge(maps, joints)
    assert merged.answer.verdict.value == "CERTIFIED"
    assert merged.answer.cost == pytest.approx(2.0 * certpgo.solve(graph).cost)
    assert merged.instance.graph.is_other.sum() == 2 * graph.is_other.sum()


@pytest.mark.parametrize("cost", COSTS)
def test_wrong_loops_are_rejected_beside_it(cost):
    graph, wrong = mixture(rng_of(0), 3)[0], [15, 18]
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[wrong] = R[wrong] @ so.exp(np.full((2, 3), 1.2))
    t[wrong] += 6.0
    spoiled = with_mirrors(replace(graph, rotations=R, translations=t))
    answer = certpgo.solve_robustly(spoiled, cost=cost)
    assert answer.solution.rejected.tolist() == wrong
    assert answer.verdict.value == answer.rejection.verdict.value == "CERTIFIED"


def test_what_does_not_take_it_says_so(tmp_path):
    graph = with_mirrors(helix(6, rng_of(2)).graph)
    with pytest.raises(InputError, match="no format holds poses of either handedness"):
        certpgo.write(tmp_path / "g.npz", graph)
    graph = with_mirrors(mixture(rng_of(2), 3)[0].with_blocks())
    assert fingerprint(graph) is None
    for cost in ("chordal", "g2o"):
        with pytest.raises(InputError, match="the proof tier knows no nodes of other kinds"):
            certpgo.solve(graph, tier="proof", cost=cost)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", COSTS)
def test_multipliers_that_prove_nothing_bound_nothing(d, cost, monkeypatch):
    """A kind whose lengths nothing fixes counts nothing, also in what is below other costs."""
    loose = replace(POSE, constrained=traceless, admissible=traceless, proven=None, turns=False)
    monkeypatch.setitem(MANIFOLDS, MIRRORED, loose)
    graph = mixture(rng_of(2), d)[0].with_blocks()
    answer = certpgo.solve(with_mirrors(graph), cost=cost)
    assert answer.verdict.value in ("BOUNDED", "UNDECIDED")
    assert answer.certificate.lower_bound < 0.9 * certpgo.solve(graph, cost=cost).cost


def test_frames_that_turn_have_all_multipliers():
    with pytest.raises(InputError, match="poses: where frames turn, symmetric blocks are"):
        replace(POSE, constrained=traceless)

"""What measurements leave open: closed forms, then dense null spaces."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import Estimate, GraphError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.unobservable import undetermined


def graph_of(d, n, edges, kappa, tau, points=None):
    """Random measurements of these weights."""
    rng, m = rng_of(1), len(edges)
    t = rng.standard_normal((m, d))
    rotation = RotationGraph(n, edges, np.tile(np.eye(d), (m, 1, 1)), kappa)
    return PoseGraph(rotation, t, tau, points=points)


def chain(d):
    return graph_of(d, 4, [[0, 1], [1, 2], [2, 3]], [1.0] * 3, [1.0] * 3)


def at_random(rng, n, d):
    turns = rng.standard_normal((n, 1 if d == 2 else 3))
    return Estimate(so.exp(turns), rng.standard_normal((n, d)))


def found(graph, anchor, problem=None):
    d = graph.d
    return undetermined(
        problem or Quadratic(graph), at_random(rng_of(0), graph.num_nodes, d), anchor
    )


@pytest.mark.parametrize(("d", "fixes", "motions"), [(2, 1, 1), (2, 2, 0), (3, 1, 3), (3, 2, 1)])
def test_positions_of_a_world(d, fixes, motions):
    places = rng_of(2).standard_normal((fixes, d))
    graph = certpgo.with_priors(chain(d), np.arange(fixes), translations=places, tau=1.0)
    left = found(graph, 4)
    if not motions:
        assert left is None
        return
    assert (left.motions, left.nodes, left.cures) == (motions, (0, 1, 2, 3), (("rotation", 0),))
    said = left.in_words(lambda node: "the world" if node == 4 else f"node {node}")
    ways = "1 way" if motions == 1 else f"{motions} ways"
    assert said == (
        f"node 0, node 1, node 2 and node 3 move freely relative to the world, in {ways}: "
        "measurements of the rotation of node 0 would determine all"
    )
    # What is said to determine all does.
    attitude = certpgo.with_priors(graph, [0], np.eye(d)[None], kappa=1.0, world=4)
    assert found(attitude, 4) is None


@pytest.mark.parametrize(("d", "motions"), [(2, 1), (3, 3)])
def test_an_edge_without_rotation(d, motions):
    edges = [[0, 1], [1, 2], [2, 3]]
    left = found(graph_of(d, 4, edges, [1.0, 0.0, 1.0], [1.0] * 3), 0)
    assert (left.motions, left.nodes, left.cures) == (motions, (2, 3), (("rotation", 2),))


def test_points_and_distances():
    sighted = graph_of(3, 4, [[0, 2], [1, 2], [0, 3], [1, 3]], [0.0] * 4, [1.0] * 4, [0, 0, 1, 1])
    left = found(sighted, 0)
    assert (left.motions, left.nodes, left.cures) == (1, (1,), (("rotation", 1),))
    # A point at one distance from a plane's pose may go around it, and at two nowhere.
    measured = graph_of(2, 3, [[0, 1]], [1.0], [1.0], [False, False, True])
    for pairs, motions in (([[0, 2]], 1), ([[0, 2], [1, 2]], 0)):
        ranges = certpgo.Ranges(3, pairs, np.ones(len(pairs)), np.ones(len(pairs)))
        left = found(measured, 0, objective_of(measured.with_ranges(ranges)))
        assert (0 if left is None else left.motions) == motions
        assert left is None or left.cures == (("position", 2),)


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_motions_are_the_dense_null_space(seed, d):
    rng = rng_of(seed)
    n, points = 5, np.array([False] * 4 + [True] * 2)
    edges = [[0, 1], [1, 2], [2, 3], *([int(rng.integers(4)), 4 + k % 2] for k in range(4))]
    kappa = [*rng.choice([0.0, 10.0], 3), 0.0, 0.0, 0.0, 0.0]
    graph = graph_of(d, n + 1, edges, kappa, 10.0 ** rng.uniform(-2, 2, 7), points)
    try:
        problem = Quadratic(graph)
    except GraphError:
        return
    estimate = at_random(rng, n + 1, d)
    H, layout = problem.gauss_newton(estimate).toarray(), problem.tangent_layout
    kept = np.setdiff1d(np.arange(len(H)), np.arange(layout.sizes[0]))
    values = np.linalg.eigvalsh(H[np.ix_(kept, kept)])
    dense = int((values < 1e-11 * values[-1]).sum())
    left = undetermined(problem, estimate, 0)
    assert (0 if left is None else left.motions) == dense
    if left is None or not left.cures:
        return
    # Without the rows that the cures determine, none is left.
    rows = np.arange(len(H))
    for kind, node in left.cures:
        own = layout.first_row(node) + np.arange(layout.sizes[node])
        kept = np.setdiff1d(kept, own[d:] if kind == "rotation" else own[:d])
    assert rows[kept].size
    values = np.linalg.eigvalsh(H[np.ix_(kept, kept)])
    assert values[0] > 1e-11 * values[-1]


def test_answers_and_instances_say_so(tmp_path):
    path = tmp_path / "one.g2o"
    lines = [f"EDGE_SE2 {10 * k} {10 * k + 10} 1 0 0.1 1 0 0 1 0 1" for k in (1, 2)]
    path.write_text("\n".join([*lines, "EDGE_PRIOR_SE2_XY 20 5 0 4 0 4"]) + "\n")
    answer = certpgo.solve(certpgo.read(path, quiet=True))
    assert answer.undetermined.cures == (("rotation", 0),)
    assert "relative to the world, in 1 way: measurements of the" in " ".join(str(answer).split())
    path.write_text(path.read_text().replace("20 5 0", "20 0 0"))
    with pytest.raises(GraphError, match="the rotation of the world: a rotation measured"):
        certpgo.solve(certpgo.read(path, quiet=True))

"""A kind of node in a few lines: descents, bounds and roundings know it."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import rng_of

import certpgo
from certpgo import Quadratic, Verdict
from certpgo.errors import InputError
from certpgo.io.datasets.synthetic import grid3d, random_graph
from certpgo.linalg import rotations as so
from certpgo.objective.manifolds import IN_MEAN_UNIT, POSE, SCALED

#: Frames of either handedness, which rounding leaves as they are.
EITHER = replace(POSE, name="poses of either handedness", rounded=so.orthonormal)


@pytest.mark.parametrize(
    "graph", [grid3d(3, rng_of(0)).graph, random_graph(12, 4.0, 0.3, rng_of(1)).graph]
)
def test_it_is_solved_and_certified_beside_poses(graph):
    problem = Quadratic(graph, nodes=[(EITHER, np.arange(0, graph.num_nodes, 3))])
    answer, usual = certpgo.solve(problem), certpgo.solve(graph)
    assert answer.verdict is usual.verdict is Verdict.CERTIFIED
    assert problem.cost(answer.estimate) == pytest.approx(problem.cost(usual.estimate), rel=1e-9)


def test_its_blocks_are_what_the_kind_admits():
    graph = random_graph(6, 3.0, 2.0, rng_of(2)).graph
    problem = Quadratic(graph, nodes=[(EITHER, np.array([1, 4]))])
    flipped = np.tile(np.diag([1.0, 1.0, -1.0]), (6, 1, 1))
    signs = np.linalg.det(problem.kinds.apply("rounded", flipped))
    assert np.rint(signs).tolist() == [1, -1, 1, 1, -1, 1]


@pytest.mark.parametrize("kind", [SCALED, IN_MEAN_UNIT])
def test_scales_are_the_graphs(kind):
    graph = random_graph(6, 3.0, 0.1, rng_of(0)).graph
    with pytest.raises(InputError, match="SimilarityGraph"):
        Quadratic(graph, nodes=[(kind, np.array([1]))])

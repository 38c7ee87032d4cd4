"""The table of capabilities is true: each cell is tried."""

import numpy as np
import pytest
from features import N, having, plain

import certpgo
from certpgo import InputError, SpecError
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.capabilities import FEATURES, OPERATIONS, lacking, require_capable
from certpgo.graph.concatenate import joined
from certpgo.graph.constructors import of_couplings
from certpgo.graph.streaming import streamed
from certpgo.objective.choose_cost import objective_of, require_poses_alone
from certpgo.objective.truncated_cost import rejecting
from certpgo.registry import get_solver
from certpgo.solve.comparison import Competitor, compare
from certpgo.solve.loop_closures import with_rotations


def merged(graph, robust):
    """Two maps of the same measurements, joined twice by ones of their make."""
    maps = [Instance(name, graph, first + np.arange(N)) for name, first in (("a", 0), ("b", 10))]
    edges, same = np.array([[0, 2], [1, 3]]), np.tile(np.eye(3), (2, 1, 1))
    rotation = RotationGraph(4, edges, same, np.ones(2))
    if graph.has_couplings:
        rotation = of_couplings(4, edges, same, same)
    between = PoseGraph(rotation, np.zeros((2, 3)), np.ones(2))
    if graph.has_scales:
        between = between.with_unknown_scales(np.tile(graph.free[:2], 2))
    return certpgo.merge(maps, Instance("c", between, np.array([0, 1, 10, 11])), robust=robust)


#: How each operation is asked for.
ASKED = {
    "priors": lambda g: certpgo.with_priors(g, np.arange(1), np.eye(3)[None], kappa=1.0),
    "directions": lambda g: certpgo.with_directions(g, np.arange(2), np.eye(3)[:2], kappa=1.0),
    "joint graph": lambda g: joined([g, g], N),
    "loop closures": with_rotations,
    "merge": lambda g: merged(g, robust=False),
    "robust merge": lambda g: merged(g, robust=True),
    "session": lambda g: certpgo.Session().add(g),
    "robust session": lambda g: certpgo.RobustSession().add(g),
    "follow": lambda g: list(streamed(g)),
    "robust fit": certpgo.solve_robustly,
    "rejections": lambda g: rejecting(objective_of(g), np.array([g.num_edges - 1])),
    "kernel": lambda g: objective_of(g, kernel="huber:1").terms,
    "tables": require_poses_alone,
    "compare": lambda g: list(compare(g, [Competitor("certified")])),
    "isotropic method": lambda g: (
        require_poses_alone(g),
        get_solver("eigen_ma")(translations="thesis").solve(objective_of(g)),
    ),
}
#: What options of commands are called, and their values.
OPTIONS = ("method", "proof", "covariances", "regions", "robust", "bounds", "outliers")


@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("operation", ASKED)
def test_what_the_table_says_is_so(operation, feature):
    graph = having(feature)
    assert [name for name, one in FEATURES.items() if one.is_in(graph)] == [feature]
    said = lacking(graph, operation)
    assert bool(said) is (feature in OPERATIONS[operation].lacks)
    if said:
        with pytest.raises(InputError):
            ASKED[operation](graph)
        with pytest.raises(InputError, match=FEATURES[feature].called.split(" (")[0]):
            require_capable(graph, operation)
    else:
        ASKED[operation](graph)


def test_every_row_is_tried_or_an_option():
    assert set(OPERATIONS) == {*ASKED, *OPTIONS}
    for operation in OPERATIONS:
        assert lacking(plain(), operation) == ""


def test_why_scales_are_not_taken_is_said():
    for name, operation in OPERATIONS.items():
        assert bool(operation.of_scales) is ("scales" in operation.lacks)
        assert operation.of_scales in lacking(having("scales"), name)


def test_operations_that_are_not_in_the_table_have_no_answer():
    with pytest.raises(SpecError, match="operation"):
        lacking(plain(), "flying")

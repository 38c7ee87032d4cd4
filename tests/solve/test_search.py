"""One search for any cost: the plans that it follows, and what holds under each."""

from dataclasses import fields

import numpy as np
import pytest
from strategies import pose_graph

from certpgo import Ranges, SimilarityGraph, SolveSettings, solve
from certpgo.certify.normalized import NormalizedProblem
from certpgo.errors import InputError
from certpgo.objective.choose_cost import objective_of
from certpgo.solve import search as plans
from certpgo.solve.search_loop import Search


def poses():
    return pose_graph(np.random.default_rng(0), 6, 3, noise=0.05)[0]


def informed():
    graph = poses()
    return graph.with_information(np.tile(np.eye(6), (graph.num_edges, 1, 1)))


def scaled():
    graph = poses()
    return SimilarityGraph(graph.rotations_alone, graph.translations, graph.tau)


def ranged():
    return poses().with_blocks(Ranges(6, np.array([[0, 3], [1, 4]]), np.ones(2), np.ones(2)))


def scaled_and_ranged():
    return ranged().with_unknown_scales(np.arange(6) > 0)


KINDS = [
    ("CHORDAL", poses, "chordal"),
    ("CHORDAL", lambda: poses().rotations_alone, "chordal"),
    ("SURROGATES", informed, "g2o"),
    ("SIMILARITIES", scaled, "chordal"),
    ("DISTANCES", ranged, "chordal"),
    ("SIMILARITY_SUMS", scaled_and_ranged, "chordal"),
]
of_each_kind = pytest.mark.parametrize(("plan", "graph", "cost"), KINDS)


@of_each_kind
def test_each_kind_of_cost_has_a_plan(plan, graph, cost):
    assert plans.plan_of(objective_of(graph(), cost)) is getattr(plans, plan)


def test_plans_are_data_and_the_search_has_no_subclass():
    assert Search.__subclasses__() == []
    rows = [plan for plan in vars(plans).values() if isinstance(plan, plans.Plan)]
    assert len(rows) == 7
    for field in fields(plans.Plan):  # what does not differ is no part of a plan
        assert len({getattr(row, field.name) for row in rows}) > 1


@of_each_kind
def test_a_highest_rank_below_that_of_estimates_is_refused(plan, graph, cost):
    with pytest.raises(InputError, match="maximal rank must be at least 3, not 2"):
        solve(graph(), cost=cost, max_rank=2)


@of_each_kind
@pytest.mark.parametrize("rank", [3, 12])
def test_the_highest_rank_is_the_one_of_the_settings(plan, graph, cost, rank):
    problem = objective_of(graph(), cost)
    normalized = NormalizedProblem.of(problem, "standard", 1e-5, 1e-12)
    search = Search(plans.plan_of(problem), problem, normalized, SolveSettings(max_rank=rank))
    assert (search.highest, search.normalized.ranks) == (rank, rank - 3)

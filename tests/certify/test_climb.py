"""Points of higher rank, and the bounds that surrogates there give."""

import numpy as np
import pytest
from strategies import pose_graph, rng_of

from certpgo import Quadratic, certify, solve
from certpgo.certify.normalized import NormalizedProblem
from certpgo.graph import PoseGraph
from certpgo.io.datasets.synthetic import grid3d, winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.g2o import G2oCost
from certpgo.optimize.curvature import negative_curvature, resolution
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.progress import Stop
from certpgo.optimize.riemannian_newton import newton
from certpgo.optimize.solution import Status
from certpgo.optimize.staircase import climb
from certpgo.solve.bounding import raised, reached
from certpgo.solve.minima import local_minimum


def uneven(condition, noise):
    """A grid in space whose translational information has a condition, at random axes."""
    rng = np.random.default_rng(0)
    graph = grid3d(3, rng, rotation_noise=noise, translation_noise=1e-9).graph
    m = graph.num_edges
    sigmas = noise * condition ** np.array([-0.25, 0.0, 0.25])
    axes = so.random(rng, m, 3)
    moved = (axes @ (sigmas * rng.standard_normal((m, 3)))[:, :, None])[:, :, 0]
    Omega = np.zeros((m, 6, 6))
    T = (axes * sigmas**-2.0) @ np.swapaxes(axes, 1, 2)
    Omega[:, :3, :3] = 0.5 * (T + np.swapaxes(T, 1, 2))
    Omega[:, 3:, 3:] = np.eye(3) / noise**2
    weights = np.full(m, 3.0 / np.sum(sigmas**2))
    graph = PoseGraph(graph.rotations_alone, graph.translations + moved, weights)
    return Sum(graph.with_information(Omega), G2oCost)


def test_a_wound_cycle_unwinds_at_a_higher_rank():
    instance, wound = winding_cycle(12, 0.0, 1)
    problem = Quadratic(instance.graph)
    stairs = list(climb(problem, wound, 5, Stop()))
    assert [stair.point.rank for stair in stairs][:1] == [4]
    costs = [problem.cost(wound), *(stair.cost for stair in stairs)]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < 1e-9 < 1.0 < costs[0]
    assert not list(climb(problem, wound, 3, Stop()))
    stop = Stop(lambda step: True)
    stopped = list(climb(problem, wound, 5, stop))
    assert [stair.status for stair in stopped] == [Status.INTERRUPTED]
    assert not list(climb(problem, wound, 5, stop))


def test_a_climb_may_go_on_elsewhere_and_end_early():
    """It then descends at the next rank all the same."""
    instance, wound = winding_cycle(12, 0.0, 1)
    problem, asked = Quadratic(instance.graph), []

    def twice(point, eigenvalue):
        asked.append((point.rotations.shape[1], eigenvalue))
        return len(asked) <= 2

    stairs = list(climb(problem, wound, 9, Stop(), goes_on=twice, next_point=lambda _: wound))
    assert [stair.point.rank for stair in stairs] == [4, 5]
    assert [rank for rank, _ in asked] == [3] * 3
    assert all(eigenvalue < -0.1 for _, eigenvalue in asked)
    assert all(stair.counts["factorizations"] > 0 for stair in stairs)


def test_a_missed_negative_eigenvalue_is_computed_again():
    """Where the spectrum is crowded, 5 % are not enough (a surrogate that is far from tight)."""
    problem = uneven(100.0, 0.1)
    x = descend(problem, newton(problem.chordal, solve(problem.chordal).estimate).estimate)
    below = problem.surrogate(x.estimate).problem
    value, direction = negative_curvature(below, below.with_optimal_translations(x.estimate))
    assert value < -1e3 * resolution(below)
    assert direction.shape == (problem.n, 3)


def test_later_surrogates_have_better_bounds_that_hold():
    problem = uneven(100.0, 0.1)
    normalized = NormalizedProblem.of(problem, "standard", 1e-5, 1e-12)
    x = descend(normalized.problem, solve(problem.chordal).estimate).estimate
    f = normalized.problem.cost(x)
    found = list(reached(normalized, x, f))
    assert [r.number for r in found] == sorted(r.number for r in found)
    bounds = {
        k: max((r.bound.value for r in found if r.number == k and r.bound), default=-np.inf)
        for k in {r.number for r in found}
    }
    assert max(bounds.values()) > max(bounds[0], 0.5 * f)
    assert max(bounds.values()) <= f * (1.0 + 1e-12)
    alone = local_minimum(normalized, x, False)
    assert alone.value < 0.9 * raised(normalized, alone).value
    certificate = certify(problem, x)
    assert certificate.verdict.value == "BOUNDED"
    assert certificate.lower_bound == pytest.approx(
        normalized.unit * max(bounds.values()), rel=1e-6
    )


def test_information_is_isotropic_where_surrogates_do_not_bend():
    rng = rng_of(3)
    graph, _, _ = pose_graph(rng, 6, 2, noise=0.3)
    Omega = np.tile(np.diag([4.0, 4.0, 2.0]), (graph.num_edges, 1, 1))
    problem = Sum(graph.with_information(Omega), G2oCost)
    v = rng.standard_normal((graph.num_edges, 2))
    assert problem.bend(v, np.full(graph.num_edges, 4.0)) == pytest.approx(0.0, abs=1e-12)
    assert problem.bend(v, np.full(graph.num_edges, 3.0)) == pytest.approx((v * v).sum())

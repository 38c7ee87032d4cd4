"""Every method that solves the relaxation of rotation averaging finds the same optimum."""

import os

import numpy as np
import pytest
from strategies import rng_of, rotation_graph

import certpgo
from certpgo.io.datasets.synthetic import cycle
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.block_coordinate_descent import BlockCoordinateDescent
from certpgo.optimize.methods.cycle_closed_form import CycleClosedForm
from certpgo.optimize.methods.rotation_coordinate_descent import RotationCoordinateDescent
from certpgo.optimize.methods.sdp_dual import DualSDP
from certpgo.optimize.methods.sdp_primal import PrimalSDP

#: Random instances; more on demand.
INSTANCES = int(os.environ.get("CERTPGO_INSTANCES", "12"))


@pytest.mark.parametrize("seed", range(INSTANCES))
def test_methods_agree_where_the_relaxation_is_tight(seed):
    rng = rng_of(seed)
    d, n = int(rng.integers(2, 4)), int(rng.integers(4, 10))
    graph, _ = rotation_graph(rng, n, d, noise=float(rng.uniform(0.05, 0.4)))
    best = certpgo.solve(graph)
    assert best.certificate.relative_gap < 1e-8
    problem = Quadratic(graph)
    descent = BlockCoordinateDescent(tolerance=1e-8).solve(problem)
    assert descent.relaxation.value == pytest.approx(best.cost, rel=1e-6)
    assert descent.cost == pytest.approx(best.cost, rel=1e-6)
    sparse = RotationCoordinateDescent().solve(problem, initial=descent.estimate)
    assert sparse.cost == pytest.approx(best.cost, rel=1e-9)
    for program in (DualSDP(), PrimalSDP()):
        found = program.solve(problem)
        assert found.relaxation.value == pytest.approx(best.cost, rel=1e-5)
        assert found.cost == pytest.approx(best.cost, rel=1e-6)
        assert found.lower_bound <= best.cost * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", range(INSTANCES))
def test_the_closed_form_is_the_staircases_optimum(seed):
    rng = rng_of(seed)
    d, n = int(rng.integers(2, 4)), int(rng.integers(3, 40))
    graph = cycle(n, float(rng.uniform(0.05, 0.3)), rng, d).graph
    graph = graph.with_weights(np.exp(rng.uniform(-2.0, 2.0, n)))
    problem = Quadratic(graph)
    found, best = CycleClosedForm().solve(problem), certpgo.solve(graph)
    assert best.certificate.gap <= best.certificate.tolerance
    assert found.cost == pytest.approx(best.cost, rel=1e-9, abs=1e-13 * problem.scale)

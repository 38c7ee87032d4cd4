"""One cost on graphs with full information, GPS, landmarks and distances."""

import numpy as np
import pytest
from mixtures import COSTS, coordinates, independent, mixture
from scipy.optimize import least_squares

import certpgo


@pytest.mark.parametrize(("d", "seed"), [(2, 0), (2, 1), (3, 0)])
@pytest.mark.parametrize("cost", COSTS)
def test_a_mixture_is_solved_and_certified_under_one_cost(d, cost, seed):
    graph, truth = mixture(np.random.default_rng([seed, d]), d)
    answer = certpgo.solve(graph, cost=cost)
    assert answer.verdict.value == "CERTIFIED"

    def value(x):
        return independent(graph, cost, x)

    own = coordinates(answer.estimate)
    assert answer.cost == pytest.approx((value(own) ** 2).sum(), rel=1e-9)
    # Descents from the truth and from the answer find nothing better.
    for start in (coordinates(truth), own):
        found = least_squares(value, start, max_nfev=60)
        assert 2.0 * found.cost >= (1.0 - 1e-9) * answer.certificate.lower_bound
        assert 2.0 * found.cost >= (1.0 - 1e-7) * answer.cost

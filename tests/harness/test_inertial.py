"""A sample of `reports.studies.inertial`: the form, its derivatives, and a tight graph."""

import numpy as np
import pytest
import scipy.sparse as sp

from reports.studies import inertial


def test_measurements_without_noise_cost_nothing():
    graph = inertial.inertial_graph(np.random.default_rng(0), 6, noise=0.0)
    assert inertial.cost(graph, graph.truth) == pytest.approx(0.0, abs=1e-15)


def test_the_tangents_are_the_derivatives():
    rng = np.random.default_rng(1)
    graph = inertial.inertial_graph(rng, 5)
    T, X = inertial.tangents(graph, graph.truth), graph.truth
    step = rng.standard_normal(T.shape[1])
    ahead, behind = (inertial.moved(graph, X, s * step) for s in (1e-6, -1e-6))
    assert pytest.approx((ahead - behind) / 2e-6, abs=1e-6) == (T @ step).reshape(-1, 3).T


def test_a_usual_graph_is_tight_and_a_turned_one_is_the_same():
    graph = inertial.inertial_graph(np.random.default_rng(2), 7)
    X = inertial.descend(graph, graph.truth)
    S = graph.form - inertial.multipliers(graph, X)
    assert abs(sp.csr_array(S) @ X.T).max() < 1e-6 * graph.form.diagonal().max()
    least, rest = inertial.smallest(graph, X)
    assert least > -inertial.NEGATIVE
    assert rest > 1e-5
    Q = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    assert inertial.cost(graph, Q @ X) == pytest.approx(inertial.cost(graph, X), rel=1e-9)

"""chi^2 and degrees of freedom: against drawn noise, and counted for each kind of measurement."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import certpgo
from certpgo import Instance, Quadratic, Ranges
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.solve.fit import Fit, fit_of, goodness_of_fit, squares

NODES, EDGES, RUNS = 12, 30, 25
SQUARE = """\
EDGE_SE2 0 1 1.01 0 1.57 100 0 0 100 0 100
EDGE_SE2 1 2 0.99 0 1.58 100 0 0 100 0 100
EDGE_SE2 2 3 1 0.01 1.56 100 0 0 100 0 100
EDGE_SE2 3 0 1 0 1.57 100 0 0 100 0 100
"""


def drawn(d, anisotropy, rng):
    """Poses measured with noise of random information matrices, and these in g2o's units."""
    q = so.tangent_dim(d)
    R, t = so.exp(rng.standard_normal((NODES, q))), 3.0 * rng.standard_normal((NODES, d))
    loops = [rng.choice(NODES, 2, replace=False) for _ in range(EDGES - NODES + 1)]
    edges = np.array([(k, k + 1) for k in range(NODES - 1)] + [tuple(pair) for pair in loops])
    full = np.zeros((EDGES, d + q, d + q))
    for block, size in ((slice(0, d), 400.0), (slice(d, None), 2500.0)):
        k = full[0, block, block].shape[0]
        axes = np.linalg.qr(rng.standard_normal((EDGES, k, k)))[0]
        values = size * anisotropy ** rng.uniform(0.0, 1.0, (EDGES, 1, k))
        full[:, block, block] = (axes * values) @ np.swapaxes(axes, 1, 2)
    full = 0.5 * (full + np.swapaxes(full, 1, 2))
    inverse = np.linalg.inv(full)
    noise = (np.linalg.cholesky(inverse) @ rng.standard_normal((EDGES, d + q, 1)))[:, :, 0]
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ so.exp(noise[:, d:])
    # g2o's and GTSAM's translations are in the measured pose's frame.
    moved = (back @ (t[j] - t[i])[:, :, None] + measured @ noise[:, :d, None])[:, :, 0]
    of_t, of_R = (np.trace(inverse[:, b, b], axis1=1, axis2=2) for b in (slice(d), slice(d, None)))
    kappa = full[:, 2, 2] if d == 2 else 1.5 / of_R
    graph = PoseGraph(RotationGraph(NODES, edges, measured, kappa), moved, d / of_t)
    half = np.r_[np.ones(d), np.full(q, 1.0 if d == 2 else 2.0)]
    return graph, full, half[:, None] * full * half


@pytest.mark.parametrize("anisotropy", [1.0, 30.0])
@pytest.mark.parametrize("d", [2, 3])
def test_chi2_is_of_its_degrees_of_freedom_under_every_cost(d, anisotropy):
    rng = np.random.default_rng(1)
    found = {"chordal": [], "g2o": [], "gtsam": []}
    for _ in range(RUNS):
        graph, full, halved = drawn(d, anisotropy, rng)
        answer = certpgo.solve(graph)
        kept = Information(full, np.arange(EDGES))
        found["chordal"].append(goodness_of_fit(answer.problem, answer.estimate, kept))
        for cost, matrices in (("g2o", halved), ("gtsam", full)):
            named = graph.with_information(Information.of(matrices, cost))
            instance = Instance("drawn", named, np.arange(NODES))
            found[cost].append(certpgo.solve(instance, initial=answer.estimate).fit)
    freedom = (EDGES - NODES + 1) * d * (d + 1) // 2
    for cost, fits in found.items():
        assert {fit.freedom for fit in fits} == {freedom}, cost
        over = np.array([fit.chi2 for fit in fits]) / freedom
        # The mean of all runs, within four of its standard deviations.
        assert abs(over.mean() - 1.0) < 4.0 * np.sqrt(2.0 * fits[0].spread / freedom / RUNS), cost
        assert not any(fit.warning for fit in fits), cost
    assert (found["chordal"][0].spread > 1.05) == (anisotropy > 1.0)


def test_each_kind_of_measurement_is_counted():
    made = helix(3, np.random.default_rng(0))
    graph, truth = made.graph, made.truth
    n, m = graph.num_nodes, graph.num_edges

    def freedom(measured, estimate):
        return goodness_of_fit(Quadratic(measured), estimate).freedom

    loose = 6 * (m - n + 1)
    assert freedom(graph, truth) == loose
    world = Estimate(
        np.concatenate([truth.rotations, np.eye(3)[None]]),
        np.concatenate([truth.translations, np.zeros((1, 3))]),
    )
    fixes = certpgo.with_priors(graph, [0, 3, 8], translations=truth.translations[[0, 3, 8]], tau=4)
    assert freedom(fixes, world) == loose + 9 - 6
    one = certpgo.with_priors(graph, [0, 3], translations=truth.translations[[0, 3]], tau=4)
    assert freedom(one, world) == loose + 6 - 5  # turns about the line through them are left open
    up = certpgo.with_directions(fixes, [1, 2], truth.rotations[[1, 2], 2], kappa=9.0, world=n)
    assert freedom(up, world) == loose + 9 - 6 + 2 * 2
    turned = goodness_of_fit(Quadratic(graph.rotations_alone), Estimate(truth.rotations))
    assert turned.freedom == 3 * (m - n + 1)


def test_points_and_distances_are_counted():
    made = helix(3, np.random.default_rng(0))
    graph, truth = made.graph, made.truth
    n, m, t = graph.num_nodes, graph.num_edges, truth.translations
    seen = np.array([0, 4, 8])
    where = np.swapaxes(truth.rotations[seen], 1, 2) @ (np.ones(3) - t[seen])[:, :, None]
    rotation = RotationGraph(
        n + 1,
        np.concatenate([graph.edges, np.stack([seen, np.full(3, n)], axis=1)]),
        np.concatenate([graph.rotations, np.tile(np.eye(3), (3, 1, 1))]),
        np.r_[graph.kappa, np.zeros(3)],
    )
    with_point = PoseGraph(
        rotation,
        np.concatenate([graph.translations, where[:, :, 0]]),
        np.r_[graph.tau, np.ones(3)],
        points=np.arange(n + 1) == n,
    )
    estimate = Estimate(
        np.concatenate([truth.rotations, np.eye(3)[None]]), np.concatenate([t, np.ones((1, 3))])
    )
    expected = 6 * (m - n + 1) + 3 * 3 - 3
    assert goodness_of_fit(Quadratic(with_point), estimate).freedom == expected
    ranges = Ranges(n, np.array([[0, 8], [1, 7]]), np.array([3.0, 4.0]), np.full(2, 100.0))
    instance = Instance("ranged", graph.with_ranges(ranges), np.arange(n))
    problem = objective_of(instance)
    found = goodness_of_fit(problem, truth)
    assert found.freedom == 6 * (m - n + 1) + 2
    assert found.chi2 == pytest.approx(problem.cost(truth))


def test_information_counts_by_its_rank():
    graph, full, _ = drawn(3, 1.0, np.random.default_rng(0))
    problem = objective_of(graph.with_information(full), "gtsam")
    singular = full.copy()
    singular[-1, [1, 5]] = singular[-1, :, [1, 5]] = 0.0
    left = replace(problem, measured=graph.with_information(singular))
    estimate = certpgo.solve(graph).estimate
    assert goodness_of_fit(problem, estimate).freedom == 6 * (EDGES - NODES + 1)
    assert goodness_of_fit(left, estimate).freedom == 6 * (EDGES - NODES + 1) - 2


@pytest.mark.parametrize(
    ("chi2", "said"),
    [
        (6252.0, "16.1 times the stated noise; meas"),
        (24.0, ""),
        (1.0, "0.204 times the stated noise, which"),
    ],
)
def test_what_is_beyond_the_quantiles_is_said(chi2, said):
    warning = Fit(chi2, 24).warning
    assert said in warning
    assert bool(warning) == bool(said)
    assert Fit(1.2 * 24, 24, 3.0).warning == ""


def test_the_quantiles_are_those_of_chi2():
    for freedom in (1, 24, 5000):
        low, high = stats.chi2.ppf(1e-6, freedom), stats.chi2.isf(1e-6, freedom)
        assert [bool(Fit(x, freedom).warning) for x in (0.99 * low, 1.01 * low)] == [True, False]
        assert [bool(Fit(x, freedom).warning) for x in (0.99 * high, 1.01 * high)] == [False, True]


def test_only_stated_noise_has_a_chi2(tmp_path):
    square = tmp_path / "square.g2o"
    square.write_text(SQUARE)
    read = certpgo.read(square)
    assert certpgo.solve(read).fit.freedom == 3
    assert certpgo.solve(certpgo.read(square, unit_weights=True)).fit is None
    assert certpgo.solve(read.graph).fit.freedom == 3
    identity = tmp_path / "identity.g2o"
    identity.write_text(SQUARE.replace("100 0 0 100 0 100", "1 0 0 1 0 1"))
    assert certpgo.solve(certpgo.read(identity)).fit is None
    tree = tmp_path / "tree.g2o"
    tree.write_text(SQUARE.rpartition("EDGE")[0])
    assert certpgo.solve(certpgo.read(tree)).fit is None
    fractional = np.array([1.0, 1.0, 1.0, 0.5])
    problem = Quadratic(read.graph.reweighted(fractional))
    estimate = certpgo.solve(read.graph).estimate
    assert fit_of(read, problem, estimate, fractional) is None


def test_the_parts_of_a_term_add_up_to_chi2():
    graph = drawn(2, 1.0, np.random.default_rng(3))[0]
    problem, estimate = Quadratic(graph), certpgo.solve(graph).estimate
    terms, numbers = squares(problem, estimate)
    assert (numbers == [2, 1]).all()
    costs = terms[:, 0] + 2.0 * terms[:, 1]
    np.testing.assert_allclose(costs, problem.edge_costs(estimate), rtol=1e-9)


def test_square_roots_of_information_are_recognised(tmp_path):
    """Noise of 0.05 in a file that states 20: the information is 400 if 20 is its square root."""
    rng, lines = np.random.default_rng(4), []
    for i in range(30):
        for j in (i + 1, i + 2):
            step = np.array([j - i, 0.0, 0.0]) + 0.05 * rng.standard_normal(3)
            lines.append(f"EDGE_SE2 {i} {j} {' '.join(map(str, step.tolist()))} 20 0 0 20 0 20\n")
    path = tmp_path / "roots.g2o"
    path.write_text("".join(lines))
    fit = certpgo.solve(certpgo.read(path, quiet=True)).fit
    assert fit.chi2 < 0.1 * fit.freedom
    assert fit.as_roots == pytest.approx(20 * fit.chi2, rel=0.02)
    assert "square roots of information" in fit.warning
    assert "--weights-are sqrt-information" in fit.warning
    stated = certpgo.solve(certpgo.read(path, weights_are="sqrt-information", quiet=True)).fit
    assert stated.chi2 == pytest.approx(stated.freedom, rel=0.5)
    assert stated.as_roots is None
    assert stated.warning == ""
    assert "square roots" not in Fit(3.0, 60, as_roots=3.0).warning

"""Poses of unknown scale with distances, GPS and a kind of measurement of one's own."""

from dataclasses import replace

import numpy as np
import pytest
from features import added
from mixtures import scaled_mixture
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import certpgo
from certpgo import Estimate, Ranges
from certpgo.errors import InputError
from certpgo.graph.relaxed_point import lifted
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of

CERTIFIED = "CERTIFIED"


def independent(graph, x):
    """Residuals by the documented formulas: nothing of the package."""
    d, n = graph.d, graph.num_nodes
    q = 1 if d == 2 else 3
    t, w = x[: n * d].reshape(n, d), x[n * d : n * (d + q)].reshape(n, q)
    s = np.where(graph.free, np.exp(np.clip(x[n * (d + q) :], -30.0, 30.0)), 1.0)
    if d == 2:
        c, z = np.cos(w[:, 0]), np.sin(w[:, 0])
        R = np.stack([np.stack([c, -z], 1), np.stack([z, c], 1)], 1)
    else:
        R = Rotation.from_rotvec(w).as_matrix()
    out = []
    for e, (i, j) in enumerate(graph.edges):
        turn = s[j] * R[j] - graph.scales[e] * s[i] * R[i] @ graph.rotations[e]
        move = t[j] - t[i] - s[i] * R[i] @ graph.translations[e]
        out += [np.sqrt(graph.kappa[e]) * turn.ravel(), np.sqrt(graph.tau[e]) * move]
    for block in graph.blocks:
        i, j = block.edges.T
        if isinstance(block, Ranges):
            off = np.linalg.norm(t[j] - t[i], axis=1) - block.distances
        else:
            v = np.einsum("kba,kb->ka", R[i], t[j] - t[i])
            off = (block.normals * v).sum(axis=1) - block.heights
        out.append(np.sqrt(block.weights) * off)
    return np.concatenate(out)


def coordinates(estimate):
    turns = so.log(estimate.rotations).ravel()
    return np.concatenate([estimate.translations.ravel(), turns, np.log(estimate.scales)])


def cost_of(graph, estimate):
    return float((independent(graph, coordinates(estimate)) ** 2).sum())


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_the_answer_is_that_of_an_independent_descent(d, seed):
    graph, truth = scaled_mixture(np.random.default_rng([d, seed]), d)
    answer = certpgo.solve(graph)
    assert answer.verdict == CERTIFIED
    assert answer.cost == pytest.approx(cost_of(graph, answer.estimate), rel=1e-9)
    found = least_squares(lambda x: independent(graph, x), coordinates(truth), xtol=1e-14)
    assert answer.cost == pytest.approx(2.0 * found.cost, rel=1e-6)
    assert answer.certificate.lower_bound <= 2.0 * found.cost
    judged = certpgo.certify(graph, answer.estimate)
    assert judged.verdict == CERTIFIED
    judged = certpgo.certify(graph, truth)
    assert judged.lower_bound <= 2.0 * found.cost
    assert judged.cost_upper == pytest.approx(cost_of(graph, truth), rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_no_map_costs_less_than_the_bound(seed):
    """Under noise that leaves gaps: random maps, near the truth and far, and where they lead."""
    rng = np.random.default_rng([9, seed])
    d, known = 2 + seed % 2, (0,) * (seed % 3 > 0)
    graph, truth = scaled_mixture(
        rng, d, n=5, noise=0.6, known=known, distances=4, heights=seed % 4
    )
    answer = certpgo.solve(graph)
    bound = answer.certificate.lower_bound
    assert bound <= answer.certificate.cost_upper
    judged = certpgo.certify(graph, truth).lower_bound
    x = coordinates(truth)
    for size in (0.0, 0.1, 1.0, 3.0):
        there = x + size * rng.normal(size=len(x))
        assert (independent(graph, there) ** 2).sum() >= max(bound, judged)
        found = least_squares(lambda x: independent(graph, x), there, max_nfev=40)
        assert 2.0 * found.cost >= max(bound, judged) * (1.0 - 1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_costs_and_derivatives_are_those_of_the_formulas(d):
    rng = np.random.default_rng(d)
    graph, truth = scaled_mixture(rng, d, noise=0.2)
    n, problem = graph.num_nodes, objective_of(graph)
    moved = Estimate(
        truth.rotations @ so.exp(0.2 * rng.normal(size=(n, so.tangent_dim(d)))),
        truth.translations + 0.2 * rng.normal(size=(n, d)),
        scales=np.where(graph.free, np.exp(0.2 * rng.normal(size=n)), 1.0) * truth.scales,
    )
    low, high = problem.enclosure(moved)
    assert low <= problem.cost(moved) <= high < low * (1.0 + 1e-10)
    assert problem.cost(moved) == pytest.approx(cost_of(graph, moved), rel=1e-12)
    here = problem.linearized(moved)
    rows = here.layout.unpack(rng.normal(size=here.layout.size))
    rows[~graph.free, -1] = 0.0  # of known scales
    x, h = here.layout.pack(rows), 1e-5
    slope = (here.moved(h * x).cost - here.moved(-h * x).cost) / (4.0 * h)
    assert here.gradient @ x == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_distances_have_costs_and_derivatives_at_any_rank(d):
    """The surrogate of what lifts not, at a point of rank d + 1, against differences."""
    rng = np.random.default_rng(d)
    graph, truth = scaled_mixture(rng, d, noise=0.2)
    problem = objective_of(graph).surrogate(truth).problem
    start = problem.linearized(lifted(problem.blocks(truth), d + 1))
    here = start.moved(0.3 * rng.normal(size=start.layout.size))
    rows = here.layout.unpack(rng.normal(size=here.layout.size))
    rows[~graph.free, -1] = 0.0
    x, h = here.layout.pack(rows), 1e-5
    slope = (here.moved(h * x).cost - here.moved(-h * x).cost) / (4.0 * h)
    assert here.gradient @ x == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("d", [2, 3])
def test_a_surrogate_touches_the_cost_and_is_nowhere_above(d):
    rng = np.random.default_rng([4, d])
    graph, truth = scaled_mixture(rng, d, noise=0.3)
    problem = objective_of(graph)
    (below, constant), *_ = problem.surrogate(truth).at(problem.blocks(truth))
    cost = problem.cost(truth)
    assert below.cost(truth) + constant == pytest.approx(cost, rel=1e-6)
    q, n = so.tangent_dim(d), graph.num_nodes
    for size in (0.1, 1.0, 10.0):
        other = Estimate(
            truth.rotations @ so.exp(size * rng.normal(size=(n, q))),
            truth.translations + size * rng.normal(size=(n, d)),
            scales=np.where(graph.free, np.exp(size * rng.normal(size=n)), 1.0),
        )
        assert below.cost(other) + constant <= problem.cost(other) * (1.0 + 1e-12)


def test_scales_without_a_unit_take_no_distances():
    graph, _ = scaled_mixture(np.random.default_rng(0), 3)
    with pytest.raises(InputError, match="no pose has a known scale, which the unit of other"):
        certpgo.solve(graph.with_unknown_scales(~graph.is_point))


@pytest.mark.parametrize("first", [0, 8])
def test_frames_of_unknown_scale_are_refused(first):
    """Heights above planes through such a node, or through a point."""
    graph, _ = scaled_mixture(np.random.default_rng(0), 3)
    ranges, heights = graph.blocks
    pairs = np.stack([np.full(4, first), np.arange(1, 5)], axis=1)
    moved = graph.with_blocks(ranges, replace(heights, edges=pairs))
    with pytest.raises(InputError, match=f"in the frame of node {first}, which is no pose of"):
        certpgo.solve(moved)


@pytest.mark.parametrize("attribute", ["arms", "N", "a"])
def test_what_is_not_of_positions_alone_is_refused(attribute, monkeypatch):
    graph, _ = scaled_mixture(np.random.default_rng(0), 3, distances=0)
    if attribute == "arms":
        monkeypatch.setattr(added.Height, "arms", np.ones((4, 3)))
    else:
        own = added.Height.minorants

        def turning(self, v, Q):
            found = own(self, v, Q)
            return replace(found, **{attribute: getattr(found, attribute) + 1.0})

        monkeypatch.setattr(added.Height, "minorants", turning)
    with pytest.raises(InputError, match="heights are not of positions alone"):
        certpgo.solve(graph)


def test_what_is_not_for_similarities_says_so():
    graph, truth = scaled_mixture(np.random.default_rng(0), 3)
    problem, answer = objective_of(graph), certpgo.solve(graph)
    for ask in (
        lambda: certpgo.solve(graph, tier="proof"),
        lambda: certpgo.solve(graph, cost="g2o"),
        lambda: certpgo.reweigh(graph),
        lambda: certpgo.fit_logarithms(problem),
        lambda: certpgo.solve_robustly(graph),
        lambda: certpgo.certify(graph, truth, rejected=[0]),
        lambda: problem.edge_enclosures(truth),
        lambda: certpgo.to_gtsam(problem, truth),
        lambda: problem.gauss_newton(truth),
        lambda: answer.covariance(0),
    ):
        with pytest.raises(InputError, match=r"scale|similarities|proof|takes relative poses"):
            ask()


def test_a_node_may_have_distances_alone():
    """Four distances place a point that no edge sees."""
    rng = np.random.default_rng(3)
    graph, truth = scaled_mixture(rng, 3, distances=0, heights=0)
    point, others = 8, np.array([0, 2, 4, 6, 9])
    apart = np.linalg.norm(truth.translations[others] - truth.translations[point], axis=1)
    pairs = np.stack([others, np.full(5, point)], axis=1)
    kept = graph.with_edges((graph.edges != point).all(axis=1))
    mixed = kept.with_ranges(Ranges(graph.num_nodes, pairs, apart, np.full(5, 40.0)))
    answer = certpgo.solve(mixed)
    found = least_squares(lambda x: independent(mixed, x), coordinates(truth), xtol=1e-14)
    assert answer.certificate.lower_bound <= 2.0 * found.cost
    assert answer.cost == pytest.approx(2.0 * found.cost, rel=1e-5)


def test_files_keep_them(tmp_path):
    graph, _ = scaled_mixture(np.random.default_rng(1), 3, heights=0)
    path = tmp_path / "map.npz"
    certpgo.write(path, certpgo.Instance("map", graph, np.arange(graph.num_nodes)))
    assert certpgo.solve(path).cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)

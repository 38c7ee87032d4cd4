"""A kind of measurement in a file of its own: everything that takes a graph knows it."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from mixtures import COSTS, coordinates, independent, mixture
from scipy.optimize import least_squares

import certpgo
from certpgo.errors import GraphError, InputError
from certpgo.graph.observations import Observations
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.term import term_of

FILE = Path(__file__).parents[1] / "data" / "observations" / "heights.py"
SPEC = importlib.util.spec_from_file_location("heights", FILE)
added = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(added)


def heights(rng, graph, truth, k=8):
    """Of some nodes in the world, which is the last node, off by 0.1 m."""
    n, d = graph.num_nodes, graph.d
    nodes = rng.choice(n - 1, k, replace=False)
    normals = rng.normal(size=(k, d))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    off = 0.1 * rng.normal(size=k)
    above = (normals * truth.anchored(n - 1).translations[nodes]).sum(axis=1) + off
    pairs = np.stack([np.full(k, n - 1), nodes], axis=1)
    return added.Heights(n, pairs, normals, above, rng.uniform(20.0, 80.0, k))


def residuals_of(block, estimate):
    i, j = block.edges.T
    t, R = estimate.translations, estimate.rotations
    v = np.einsum("kba,kb->ka", R[i], t[j] - t[i])
    return np.sqrt(block.weights) * ((block.normals * v).sum(axis=1) - block.heights)


def test_it_is_short():
    assert len(FILE.read_text().splitlines()) < 80


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", COSTS)
def test_it_is_solved_and_certified_with_all_others_under_any_cost(d, cost):
    rng = np.random.default_rng([7, d])
    graph, truth = mixture(rng, d)
    block = heights(rng, graph, truth)
    mixed = graph.with_blocks(graph.ranges, block)
    answer = certpgo.solve(mixed, cost=cost)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.certificate.objective.endswith("distances and heights")

    def value(x):
        R, t = certpgo_poses(x, d)
        off = residuals_of(block, certpgo.Estimate(R, t))
        return np.concatenate([independent(graph, cost, x), off])

    own = coordinates(answer.estimate)
    assert answer.cost == pytest.approx((value(own) ** 2).sum(), rel=1e-9)
    found = least_squares(value, coordinates(truth), max_nfev=60)
    assert 2.0 * found.cost >= (1.0 - 1e-7) * answer.cost
    judged = certpgo.certify(mixed, truth, cost=cost)
    assert judged.verdict.value in ("BOUNDED", "REFUTED")
    assert judged.lower_bound <= judged.refined_cost


def certpgo_poses(x, d):
    from certpgo.linalg import rotations as so

    n = len(x) // (d + so.tangent_dim(d))
    return so.exp(x[n * d :].reshape(n, -1)), x[: n * d].reshape(n, d)


def test_its_minorants_are_below_and_touch():
    rng = np.random.default_rng(0)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)
    term = term_of(block)
    v = 3.0 * rng.normal(size=(8, 3))
    Q = np.tile(np.eye(3), (8, 1, 1))
    found = term.minorants(v, Q)

    def minorant(v):
        return found.tau * ((v - found.b) ** 2).sum(axis=1) + found.constant

    costs = term.costs(v, Q)
    assert minorant(v) == pytest.approx(costs, rel=1e-6, abs=1e-6)
    for size in (1e-3, 1.0, 1e3):
        other = v + size * rng.normal(size=(8, 3))
        assert (minorant(other) <= term.costs(other, Q) * (1.0 + 1e-9) + 1e-6).all()
    ball = term.enclosures(Ball.exact(v), Ball.exact(Q))
    assert (ball.lower <= costs).all()
    assert (costs <= ball.upper).all()


def test_rows_are_chosen_weighed_and_renumbered():
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)
    assert block.reweighted(np.r_[0.0, np.full(7, 2.0)]).weights == pytest.approx(
        2.0 * block.weights[1:]
    )
    chosen = np.r_[np.unique(block.edges[:3])]
    part = graph.with_blocks(block).subgraph(chosen)
    assert (chosen[part.blocks[0].edges] == block.edges[:3]).all()
    assert (part.blocks[0].heights == block.heights[:3]).all()


def test_what_is_refused():
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)

    class Unknown(Observations):
        pass

    with pytest.raises(InputError, match="no term takes Unknown"):
        certpgo.solve(graph.with_blocks(Unknown(graph.num_nodes, block.edges)))
    with pytest.raises(GraphError, match="given together"):
        graph.with_blocks(block, block)
    with pytest.raises(GraphError, match="heights must have 8 rows"):
        added.Heights(graph.num_nodes, block.edges, block.normals, [1.0], block.weights)
    with pytest.raises(GraphError, match="other measurements are of"):
        graph.with_blocks(added.Heights(3, [[0, 1]], block.normals[:1], [1.0], [1.0]))


@pytest.mark.parametrize("cost", COSTS)
def test_a_session_takes_it_and_gives_it_up(cost):
    """What comes in three parts, and what is left of it, has the optimum of the whole."""
    rng = np.random.default_rng(3)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)
    n, m, k = graph.num_nodes, graph.num_edges, block.num_edges
    odometry = np.arange(m) < n
    names = list(range(n))
    session = certpgo.Session(cost=cost, every=None)
    session.add(graph.with_blocks().with_edges(graph.is_point[graph.edges].any(axis=1) | odometry))
    rest = graph.with_edges(~(graph.is_point[graph.edges].any(axis=1) | odometry))
    session.add(rest.with_blocks(graph.ranges), names)
    last = graph.with_blocks().with_edges([0])
    session.add(last.with_blocks(block), names)
    assert session.refresh().verdict.value == "CERTIFIED"
    doubled = np.r_[np.arange(m), 0]
    whole = graph.with_edges(doubled).with_blocks(graph.ranges, block)
    assert session.standing.cost == pytest.approx(certpgo.solve(whole, cost=cost).cost, rel=1e-9)
    assert session.standing.edges == m + 1 + graph.ranges.num_edges + k
    numbers = session.edges
    assert sorted(numbers) == list(range(len(numbers)))
    session.remove(numbers[-3:])
    kept = block.subset(np.arange(k - 3))
    whole = graph.with_edges(doubled).with_blocks(graph.ranges, kept)
    assert session.refresh().cost == pytest.approx(certpgo.solve(whole, cost=cost).cost, rel=1e-9)


def test_maps_that_have_it_are_merged():
    rng = np.random.default_rng(4)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)
    n = graph.num_nodes
    one = certpgo.Instance("one", graph.with_blocks(graph.ranges, block), np.arange(n))
    other = certpgo.Instance("other", graph.with_blocks(block), np.arange(n) + n)
    joints = certpgo.Instance(
        "joints", graph.with_blocks().with_edges([0]).subgraph([0, 1]), np.array([0, n + 1])
    )
    merged = certpgo.merge([one, other], joints)
    assert merged.answer.verdict.value == "CERTIFIED"
    apart = [certpgo.solve(part.graph, cost="chordal").cost for part in (one, other)]
    assert merged.answer.cost == pytest.approx(sum(apart), rel=1e-8)  # a bridge costs nothing
    assert [block.num_edges for block in merged.instance.graph.blocks] == [12, 16]


def test_what_does_not_take_it_says_so():
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    mixed = graph.with_blocks(heights(rng, graph, truth))
    for ask in (
        lambda: certpgo.solve_robustly(mixed),
        lambda: certpgo.certify(mixed, truth, rejected=np.array([0])),
        lambda: certpgo.RobustSession().add(mixed),
        lambda: certpgo.solve(mixed, tier="proof"),
    ):
        with pytest.raises(InputError, match=r"other measurements|heights"):
            ask()

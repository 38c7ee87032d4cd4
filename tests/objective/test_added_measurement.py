"""A kind of measurement in a file of its own: everything that takes a graph knows it."""

import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from mixtures import COSTS, coordinates, independent, mixture
from scipy.optimize import least_squares

import certpgo
from certpgo.errors import GraphError, InputError
from certpgo.graph.observations import Observations
from certpgo.graph.scale import Scale
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.linalg.ball_arithmetic import Ball, sums
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import Term, term_of
from certpgo.optima.fingerprint import fingerprint

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
    merged = certpgo.merge([one, other], joints, cost="chordal")
    assert merged.answer.verdict.value == "CERTIFIED"
    apart = [certpgo.solve(part.graph, cost="chordal").cost for part in (one, other)]
    assert merged.answer.cost == pytest.approx(sum(apart), rel=1e-8)  # a bridge costs nothing
    assert [block.num_edges for block in merged.instance.graph.blocks] == [12, 16]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", COSTS)
def test_wrong_loops_are_rejected_beside_it(d, cost):
    """Two of them, among distances and heights; no choice is better, proven."""
    rng = np.random.default_rng([0, d])
    graph, truth = mixture(rng, d)
    block, wrong = heights(rng, graph, truth), [15, 18]
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[wrong] = R[wrong] @ so.exp(np.full((2, so.tangent_dim(d)), 1.2))
    t[wrong] += 6.0
    spoiled = replace(graph, rotations=R, translations=t)
    mixed = spoiled.with_blocks(graph.ranges, block)
    answer = certpgo.solve_robustly(mixed, cost=cost)
    assert answer.solution.rejected.tolist() == wrong
    assert answer.verdict.value == answer.rejection.verdict.value == "CERTIFIED"
    right = np.delete(np.arange(graph.num_edges), wrong)
    kept = graph.with_edges(right).with_blocks(graph.ranges, block)
    alone = certpgo.solve(kept, cost=cost)
    assert answer.certificate.cost_upper == pytest.approx(alone.cost, rel=1e-9)
    judged = certpgo.certify(mixed, answer.estimate, cost=cost, rejected=wrong)
    assert judged.verdict.value == "CERTIFIED"
    whole = (independent(spoiled, cost, coordinates(answer.estimate)) ** 2).sum()
    off = (residuals_of(block, answer.estimate) ** 2).sum()
    assert answer.cost == pytest.approx(whole + off, rel=1e-9)


def test_what_does_not_take_it_says_so():
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    mixed = graph.with_blocks(heights(rng, graph, truth))
    with pytest.raises(InputError, match=r"other measurements|heights"):
        certpgo.certify(mixed, truth, rejected=np.array([mixed.num_edges]))
    proven = certpgo.solve(mixed, tier="proof").certificate
    assert (proven.tier.value, proven.verdict.value) == ("proof", "CERTIFIED")


@dataclass(frozen=True, eq=False, repr=False)
class Levers(Observations):
    """Points a on nodes j, seen at m in the frames of nodes i."""

    points: np.ndarray
    seen: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class Lever(Term):
    """w |t_j + R_j a - t_i - R_i m|^2 in the frame of i, its own minorant."""

    of: Levers
    takes = Levers
    plural = "levers"
    edges = property(lambda self: self.of.edges)
    arms = property(lambda self: self.of.points)
    weights = property(lambda self: self.of.weights[:, None, None] * np.eye(self.of.seen.shape[1]))

    @property
    def scale(self):
        none = 0.0 * self.of.weights
        return Scale(none, self.of.weights, (self.of.seen**2).sum(axis=1), none > 0.0)

    def residuals(self, v, Q):
        return v - self.of.seen

    def linearized(self, v, Q):
        k, d = v.shape
        none = np.zeros((k, d, so.tangent_dim(d)))
        return self.residuals(v, Q), np.tile(np.eye(d), (k, 1, 1)), none

    def enclosures(self, v, Q):
        y = v - self.of.seen
        return y.dot(y) * self.of.weights

    def minorants(self, v, Q):
        none = np.zeros_like(v)
        turned = np.zeros((*v.shape, v.shape[1]))
        return Minorants(self.of.weights, none, self.of.seen, turned, none[:, 0])


@pytest.mark.parametrize("cost", COSTS)
def test_its_arms_count(cost):
    """Points of the bodies, off their origins: the cost is what the formula says."""
    rng = np.random.default_rng(5)
    graph, truth = mixture(rng, 3)
    pairs = np.array([rng.choice(14, 2, replace=False) for _ in range(6)])
    points, weights = rng.normal(size=(6, 3)), np.full(6, 40.0)
    (i, j), t, R = pairs.T, truth.translations, truth.rotations
    there = t[j] + np.einsum("kab,kb->ka", R[j], points) - t[i]
    seen = np.einsum("kba,kb->ka", R[i], there) + 0.05 * rng.normal(size=(6, 3))
    mixed = graph.with_blocks(graph.ranges, Levers(graph.num_nodes, pairs, points, seen, weights))

    def whole(estimate):
        t, R = estimate.translations, estimate.rotations
        there = t[j] + np.einsum("kab,kb->ka", R[j], points) - t[i]
        off = np.einsum("kba,kb->ka", R[i], there) - seen
        return (independent(graph, cost, coordinates(estimate)) ** 2).sum() + 40.0 * (off**2).sum()

    answer = certpgo.solve(mixed, cost=cost)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(whole(answer.estimate), rel=1e-9)
    judged = certpgo.certify(mixed, truth, cost=cost)
    assert judged.cost_upper == pytest.approx(whole(truth), rel=1e-9)
    assert judged.lower_bound <= answer.certificate.cost_upper


def test_it_may_be_all_that_joins_a_node():
    rng = np.random.default_rng(6)
    graph, truth = mixture(rng, 3)
    n = graph.num_nodes
    lonely = n - 2  # a landmark
    kept = graph.with_edges((graph.edges != lonely).all(axis=1)).with_blocks()
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    above = normals @ truth.anchored(n - 1).translations[lonely]
    block = added.Heights(n, [[n - 1, lonely]] * 6, normals, above, np.full(6, 50.0))
    answer = certpgo.solve(kept.with_blocks(block), cost="g2o")
    # Minorants of heights have no curvature: they alone bound no position.
    assert answer.certificate.lower_bound <= answer.certificate.cost_upper
    there = answer.estimate.anchored(n - 1).translations[lonely]
    assert there == pytest.approx(truth.anchored(n - 1).translations[lonely], abs=1e-5)


def test_the_world_is_not_assumed_where_it_measures():
    """Attitudes alone, then distances from the world: none fights where the world was put."""
    rng = np.random.default_rng(0)
    instance = helix(3, rng)
    graph, n = instance.graph, instance.graph.num_nodes
    turns = certpgo.with_priors(graph, np.arange(n), instance.truth.rotations, kappa=100.0)
    alone = certpgo.solve(turns)
    from_world = alone.estimate.anchored(n).translations[:n] - [3.0, 4.0, -10.0]
    pairs = np.stack([np.full(n, n), np.arange(n)], axis=1)
    ranges = certpgo.Ranges(n + 1, pairs, np.linalg.norm(from_world, axis=1), np.full(n, 10.0))
    placed = turns.with_ranges(ranges)
    assert placed.num_edges == turns.num_edges - 1
    answer = certpgo.solve(placed)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(alone.cost, rel=1e-8)


def test_what_has_no_terms_is_refused(tmp_path):
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    block, n = heights(rng, graph, truth), graph.num_nodes
    mixed = certpgo.Instance("mixed", graph.with_blocks(block), np.arange(n))
    with pytest.raises(InputError, match=r"only \.npz files hold Heights"):
        certpgo.write(tmp_path / "mixed.pyfg", mixed)
    assert not (tmp_path / "mixed.pyfg").exists()
    assert fingerprint(mixed, "chordal") is None


def test_files_of_the_package_hold_kinds_of_ones_own(tmp_path):
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    block, path = heights(rng, graph, truth), tmp_path / "mixed.npz"
    whole = graph.with_blocks(graph.ranges, block)
    certpgo.write(path, certpgo.Instance("mixed", whole, np.arange(graph.num_nodes)))
    read = certpgo.read(path, quiet=True).graph
    assert list(map(type, read.blocks)) == [certpgo.Ranges, type(block)]
    for name, values in block.columns.items():
        np.testing.assert_array_equal(getattr(read.blocks[1], name), values)
    best, again = certpgo.solve(whole), certpgo.solve(read)
    assert again.cost == best.cost
    arrays = dict(np.load(path))
    for changed, said in (
        ({"block.Depths.edges": arrays["edges"]}, "measurements of the kind Depths: import what"),
        ({"block.Heights.odd": arrays["kappa"]}, "Heights have the arrays edges, heights"),
        ({"block.Heights.weights": np.ones(1)}, "the array 'weights' of Heights must be"),
        ({"block.Heights.edges": np.array(3)}, "the array 'edges' of Heights must be"),
    ):
        np.savez(tmp_path / "changed.npz", **{**arrays, **changed})
        with pytest.raises(InputError, match=said):
            certpgo.read(tmp_path / "changed.npz", quiet=True)


@pytest.mark.parametrize("seed", range(3))
def test_costs_below_zero_of_minorants_stop_no_descent(seed):
    """Of distances with heights, whose minorants have negative weights."""
    rng = np.random.default_rng(seed)
    graph, truth = mixture(rng, 3, n=7, landmarks=3, fixes=3, distances=8)
    block = heights(rng, graph, truth, 5)
    answer = certpgo.solve(graph.with_blocks(graph.ranges, block), cost="chordal")
    assert answer.certificate.lower_bound <= answer.certificate.cost_upper


@pytest.mark.parametrize("size", [1, 7])
def test_it_is_streamed_with_the_later_of_its_nodes(size):
    """Every row comes once, in a part that has its nodes; the end is the optimum of all."""
    rng = np.random.default_rng(8)
    graph, truth = mixture(rng, 2)
    mixed = graph.with_blocks(graph.ranges, heights(rng, graph, truth))
    n = graph.num_nodes
    whole = replace(certpgo.Instance("mixed", mixed, np.arange(n)), world=n - 1)
    session = certpgo.Session(every=None, cost="g2o")
    come = []
    for part, names in streamed(whole, size):
        session.add(part, names)
        come += part.numbers.tolist()
    assert sorted(come) == list(range(mixed.num_edges + 12 + 8))
    standing = session.refresh()
    assert standing.verdict.value == "CERTIFIED"
    assert standing.cost == pytest.approx(certpgo.solve(mixed, cost="g2o").cost, rel=1e-9)
    assert standing.edges == len(come)
    lonely = mixed.with_edges((mixed.edges != n - 2).all(axis=1))
    if (lonely.ranges.edges == n - 2).any():
        with pytest.raises(InputError, match=f"node {n - 2} has distances alone"):
            next(streamed(lonely))


@pytest.mark.parametrize("cost", COSTS)
def test_a_wrong_distance_is_rejected(cost):
    """It is off by 20 m; right edges stay. What is kept is certified, the choice is not."""
    rng = np.random.default_rng([1, 3])
    graph, truth = mixture(rng, 3)
    ranges = graph.ranges
    distances = ranges.distances + 20.0 * (np.arange(ranges.num_edges) == 4)
    spoiled = graph.with_ranges(replace(ranges, distances=distances))
    answer = certpgo.solve_robustly(spoiled, cost=cost)
    assert answer.solution.rejected.tolist() == [graph.num_edges + 4]
    assert answer.rejection is None
    assert "rejections of distances are not certified" in answer.solution.note
    kept = graph.with_ranges(ranges.subset(np.arange(ranges.num_edges) != 4))
    assert answer.certificate.cost_upper == pytest.approx(certpgo.solve(kept, cost=cost).cost)
    lengths = answer.problem.residual_lengths(answer.estimate)[graph.num_edges :]
    i, j = kept.ranges.edges.T
    t = answer.estimate.translations
    off = np.abs(np.linalg.norm(t[j] - t[i], axis=1) - kept.ranges.distances)
    assert lengths == pytest.approx(off, abs=1e-9)
    with pytest.raises(InputError, match="rejections of distances are not certified"):
        certpgo.certify(spoiled, truth, cost=cost, rejected=[graph.num_edges + 4])


@dataclass(frozen=True, eq=False, repr=False)
class Headings(Observations):
    """Relative rotations, of a kind of their own."""

    turns: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class Heading(Term):
    """w |Q - M|_F^2 = w (2 d - 2 <M, Q>), its own minorant, without any position."""

    of: Headings
    takes = Headings
    plural = "headings"
    edges = property(lambda self: self.of.edges)
    weights = property(lambda self: self.of.weights[:, None, None] * np.eye(9))

    @property
    def scale(self):
        none = 0.0 * self.of.weights
        return Scale(self.of.weights, none, none, none > 0.0)

    def residuals(self, v, Q):
        return (Q - self.of.turns).reshape(-1, 9)

    def linearized(self, v, Q):
        turned = (Q[:, None] @ so.hat(np.eye(3))).reshape(-1, 3, 9)
        return self.residuals(v, Q), np.zeros((len(v), 9, 3)), np.swapaxes(turned, 1, 2)

    def enclosures(self, v, Q):
        return sums((Q - self.of.turns).reshaped(len(self.edges), 9).squared()) * self.of.weights

    def minorants(self, v, Q):
        w, none = self.of.weights, np.zeros_like(v)
        constant = 6.0 * w * (1.0 - 2.0**-48)  # 2 d = 6; M is a rotation to rounding
        return Minorants(none[:, 0], none, none, w[:, None, None] * self.of.turns, constant)


@pytest.mark.parametrize("cost", COSTS)
def test_one_without_positions_is_certified_beside_distances(cost):
    rng = np.random.default_rng(2)
    graph, truth = mixture(rng, 3)
    pairs = np.array([rng.choice(14, 2, replace=False) for _ in range(6)])
    (i, j), R = pairs.T, truth.rotations
    turns = np.swapaxes(R[i], 1, 2) @ R[j] @ so.exp(0.05 * rng.normal(size=(6, 3)))
    block = Headings(graph.num_nodes, pairs, turns, np.full(6, 30.0))
    answer = certpgo.solve(graph.with_blocks(graph.ranges, block), cost=cost)
    assert answer.verdict.value == "CERTIFIED"
    own = (independent(graph, cost, coordinates(answer.estimate)) ** 2).sum()
    R = answer.estimate.rotations
    off = ((np.swapaxes(R[i], 1, 2) @ R[j] - turns) ** 2).sum()
    assert answer.cost == pytest.approx(own + 30.0 * off, rel=1e-9)


def test_numbers_of_any_kind_are_checked():
    rng = np.random.default_rng(1)
    graph, truth = mixture(rng, 3)
    block = heights(rng, graph, truth)
    for name, value, said in (
        ("heights", np.nan, "heights must be finite"),
        ("weights", -1.0, "weights must be finite and positive"),
    ):
        values = np.array(getattr(block, name))
        values[2] = value
        with pytest.raises(GraphError, match=f"edge .*: {said}"):
            replace(block, **{name: values})
    none = np.zeros(0)
    empty = certpgo.Ranges(graph.num_nodes, np.zeros((0, 2), dtype=int), none, none)
    assert graph.with_ranges(empty).ranges is None
    assert graph.with_blocks(None, block).blocks == (block,)
    with pytest.raises(InputError, match="distances, or None"):
        graph.with_ranges(block)

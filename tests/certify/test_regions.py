"""How far estimates can be from every optimum: no other estimate is ever outside."""

import re
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixtures import mixture, scaled_mixture
from strategies import definite, dimensions, point_graph, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import InputError
from certpgo.certify import certificate as printed
from certpgo.certify.dual import Attempts
from certpgo.certify.region import ProvenDistance, limits
from certpgo.certify.region import apart as in_words
from certpgo.graph import Estimate
from certpgo.graph.kinds import Node
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.blocks import pinned
from certpgo.objective.choose_cost import COSTS, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.solve.judging import Judge

KINDS = ("rotations", "poses", "points", "fixes", "g2o", "gtsam", "priors g2o")
#: Distances with F alone, and what all else is measured with.
MORE = (
    "distances chordal",
    "mixture chordal",
    "mixture g2o",
    "mixture gtsam",
    "rejected poses",
    "rejected g2o",
    "rejected rotations",
    "scales",
    "scales distances",
)


def problem_of(kind, rng, d, noise=0.1):
    """A small problem and an estimate near its optimum."""
    n = int(rng.integers(4, 8))
    of, _, name = kind.partition(" ")
    if of == "rejected":
        return rejected(*problem_of(name, rng, d, noise), rng)
    if of == "distances":
        graph, R, t = pose_graph(rng, n, d, noise=noise)
        pairs = np.array([rng.choice(n, 2, replace=False) for _ in range(n)])
        length = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
        length = np.abs(length + noise * rng.standard_normal(n))
        ranges = certpgo.Ranges(n, pairs, length, np.full(n, 5.0))
        return objective_of(graph.with_ranges(ranges), name), Estimate(R, t)
    if of == "mixture":
        graph, truth = mixture(rng, d, 6, 2, 2, 5)
        return objective_of(graph, name), truth
    if of == "scales":
        few = {} if name else {"distances": 0, "heights": 0}
        graph, truth = scaled_mixture(rng, d, 5, noise=0.3 * noise, known=(0,), **few)
        return objective_of(graph), truth
    if kind == "rotations":
        graph, R = rotation_graph(rng, n, d, noise=noise)
        return Quadratic(graph), Estimate(R)
    if kind == "points":
        graph, truth = point_graph(rng, n, 4, d, noise=noise)
        return Quadratic(graph), truth
    graph, R, t = pose_graph(rng, n, d, noise=noise)
    if kind == "poses":
        return Quadratic(graph), Estimate(R, t)
    if kind != "fixes" and not kind.startswith("priors"):
        # In space the minorants of GTSAM's cost are those of isotropic translations.
        information = definite(rng, graph.num_edges, d + so.tangent_dim(d), 3.0)
        if kind == "gtsam" and d == 3:
            information[:, :d, d:] = information[:, d:, :d] = 0.0
            information[:, :d, :d] = np.eye(d)
        return Sum(graph.with_information(information), COSTS[kind]), Estimate(R, t)
    fixes = t + noise * rng.standard_normal((n, d))
    fixed = certpgo.with_priors(graph, np.arange(n), translations=fixes, tau=2.0)
    truth = Estimate(np.concatenate([R, np.eye(d)[None]]), np.concatenate([t, np.zeros((1, d))]))
    if kind == "fixes":
        return Quadratic(fixed), truth
    m, q = fixed.num_edges, so.tangent_dim(d)
    information = np.zeros((m, d + q, d + q))
    information[:, :d, :d] = fixed.tau[:, None, None] * np.eye(d)
    information[:, d:, d:] = 2.0 * fixed.kappa[:, None, None] * np.eye(q)
    return Sum(fixed.with_information(information), COSTS["g2o"]), truth


def rejected(problem, truth, rng):
    """The truncated cost of some measurements, of which one is far off."""
    m = problem.graph.num_edges
    prices = np.full(m, np.inf)
    costs = problem.edge_costs(truth)
    for e in rng.permutation(m)[:3]:
        trial = prices.copy()
        trial[e] = costs[e] * 10.0 ** rng.uniform(-1.0, 1.0)
        try:
            _ = TruncatedCost(problem, trial)
        except certpgo.GraphError:
            continue
        prices = trial
    return TruncatedCost(problem, prices), truth


def moved(rng, x, size):
    """The estimate with every pose moved by as much, and all of them elsewhere in the world."""
    n, d, _ = x.rotations.shape
    R = x.rotations @ so.exp(size * rng.standard_normal((n, so.tangent_dim(d))))
    Q = so.random(rng, 1, d)[0]
    if x.translations is None:
        return Estimate(Q @ R)
    t = x.translations + size * rng.standard_normal((n, d))
    s = x.scales
    if s is not None:
        s = np.where(s == 1.0, 1.0, s * np.exp(min(size, 2.0) * rng.standard_normal(n)))
    return Estimate(Q @ R, t @ Q.T + rng.standard_normal(d), scales=s)


def apart(x, other, i):
    """(n,) metres and degrees between the poses of two estimates in the frame of node i."""
    V = x.rotations[i].T @ x.rotations - other.rotations[i].T @ other.rotations
    squares = np.minimum(np.einsum("nab,nab->n", V, V) / 8.0, 1.0)
    degrees = np.degrees(2.0 * np.arcsin(np.sqrt(squares)))
    if x.translations is None:
        return None, degrees
    u = (x.translations - x.translations[i]) @ x.rotations[i]
    u -= (other.translations - other.translations[i]) @ other.rotations[i]
    return np.linalg.norm(u, axis=1), degrees


def among(problem, certificate, x, other):
    """The regions of two estimates, whatever their costs."""
    known = certificate.regions
    costs = [problem.enclosure(point)[1] / known.unit for point in (x, other)]
    return replace(known, estimate=x, cost=max(costs), best=x, known=min(costs))


def shares(problem, certificate, x, other, reference):
    """The largest shares of the limits, of distances, angles and scales; none is above one."""
    nodes, tiny = problem.graph.nodes, 1e-300
    known = among(problem, certificate, x, other)
    found = known.distance(reference)
    metres, degrees = apart(x, other, reference)
    degrees[nodes == Node.POINT] = 0.0
    angles = np.where(found.degrees < 180.0, degrees / np.maximum(found.degrees, tiny), 0.0)
    lengths = np.zeros(1) if metres is None else metres / np.maximum(found.metres, tiny)
    others = np.arange(len(angles)) != reference
    assert (found.metres is None) == (metres is None)
    sizes = np.zeros(1)
    if x.scales is not None:
        scaled = others & (nodes == Node.SCALED)
        sizes = np.abs(x.scales - other.scales)[scaled] / found.scales[scaled]
    of_centre, of_other = (problem.enclosure(one)[1] for one in (x, other))
    excess = (1.0 + 1e-12) * of_other - of_centre
    for node in np.flatnonzero(others)[::3]:
        region = replace(known, cost=of_centre / known.unit).region(int(node), reference, excess)
        assert region.holds(other)
    # By way of the best estimate known, too, whatever this one costs.
    by_best = replace(certificate.regions, estimate=x, cost=of_centre / known.unit)
    limits = by_best.distance(reference, np.full(len(angles), excess))
    assert (degrees <= limits.degrees + 1e-12).all()
    assert metres is None or (metres <= limits.metres + 1e-12).all()
    return (lengths if metres is None else lengths[others]).max(), angles[others].max(), sizes.max()


@pytest.mark.parametrize("kind", [*KINDS, *MORE])
@given(seeds, dimensions)
@settings(max_examples=3)
def test_no_other_estimate_is_outside(kind, seed, d):
    """Near ones, far ones, and any; from every pose."""
    rng = rng_of(seed)
    problem, truth = problem_of(kind, rng, d)
    x = moved(rng, truth, 10.0 ** rng.uniform(-6.0, 0.0))
    certificate = certpgo.certify(problem, x)
    rigid = np.isin(problem.graph.nodes, (Node.POSE, Node.ROTATION))
    for reference in np.flatnonzero(rigid)[::2].tolist():
        if certificate.distance_from(reference) is None:
            continue
        for size in (1e-6, 1e-3, 0.1, 1.0, 30.0):
            other = moved(rng, certificate.best, size)
            assert max(shares(problem, certificate, x, other, reference)) <= 1.0
            assert max(shares(problem, certificate, certificate.best, other, reference)) <= 1.0
        # The optimum itself, without knowing it.
        found, poses = certificate.distance_from(reference), problem.chordal.poses
        metres, degrees = apart(x, certificate.best, reference)
        assert (degrees[poses] <= found.degrees[poses] + 1e-12).all()
        assert metres is None or (metres <= found.metres + 1e-12).all()


@pytest.mark.parametrize("kind", ["poses", "points", "g2o"])
@pytest.mark.parametrize("d", [2, 3])
def test_an_adversary_stays_within_the_limit(kind, d):
    """From the worst direction, by steps at random that come nearer to it."""
    rng, nearest = rng_of(7), 0.0
    problem, truth = problem_of(kind, rng, d, noise=0.03)
    certificate = certpgo.certify(problem, truth)
    best, regions = certificate.refined, certificate.regions
    reference = problem.chordal.anchor
    attempts = Attempts(regions.form, regions.point, True, -np.inf, False)
    S = attempts.matrix(regions.bound.multipliers, np.zeros(0), attempts.rows_of(reference))
    inverse, layout = np.linalg.inv(S.toarray()), regions.form.pattern.layout_of(S)
    for node in range(problem.n):
        if node == reference:
            continue
        row = layout.first_row(node)
        worst = layout.unpack(inverse[:, row] / np.sqrt(inverse[row, row]))
        v = rng.standard_normal(d)
        for size in 10.0 ** np.arange(-2.0, 2.0, 0.5):
            step = size * worst
            t = best.translations + step[:, :1] * v
            R = so.project(best.rotations + v[:, None] * step[:, None, 1:])
            # Exactly as it was, the frame is the same.
            t[reference], R[reference] = best.translations[reference], best.rotations[reference]
            other = Estimate(R, t)
            share = max(shares(problem, certificate, best, other, reference))
            for _ in range(4):
                trial = Estimate(*near(rng, other, 0.1 * size))
                nearer = max(shares(problem, certificate, best, trial, reference))
                other, share = (trial, nearer) if nearer > share else (other, share)
            assert share <= 1.0
            nearest = max(nearest, share)
    assert nearest > 0.6


def near(rng, x, size):
    q = so.tangent_dim(x.d)
    R = x.rotations @ so.exp(0.1 * size * rng.standard_normal((len(x.rotations), q)))
    return R, x.translations + size * 0.1 * rng.standard_normal(x.translations.shape)


def exact_inverse(A):
    """The inverse of a matrix of doubles, in fractions."""
    n = len(A)
    rows = [[Fraction(float(x)) for x in row] for row in A]
    rows = [row + [Fraction(int(r == c)) for c in range(n)] for r, row in enumerate(rows)]
    for k in range(n):
        pivot = rows[k][k]
        rows[k] = [x / pivot for x in rows[k]]
        for r in range(n):
            if r != k and rows[r][k]:
                factor = rows[r][k]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[k], strict=True)]
    return [row[n:] for row in rows]


def is_definite(A):
    """Whether all pivots of a matrix of fractions are >= 0."""
    A = [list(row) for row in A]
    for k in range(len(A)):
        if A[k][k] < 0 or (A[k][k] == 0 and any(A[k][k + 1 :])):
            return False
        for r in range(k + 1, len(A)):
            factor = A[r][k] / A[k][k] if A[k][k] else 0
            A[r] = [a - factor * b for a, b in zip(A[r], A[k], strict=True)]
    return True


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("kind", ["rotations", "poses", "points"])
@pytest.mark.parametrize("d", [2, 3])
def test_blocks_are_above_those_in_fractions(engine, kind, d, monkeypatch):
    """Of the stored matrix: by rounding only, and never below."""
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    problem, truth = problem_of(kind, rng_of(d), d)
    certificate = certpgo.certify(problem, truth)
    known, reference = certificate.regions, problem.anchor
    form, multipliers = known.form, known.bound.multipliers
    found = known._inverse(reference, multipliers)
    layout = form.pattern.layout_of(form.matrix)
    rows = layout.first_row(reference) + np.arange(layout.sizes[reference])
    A = pinned(form.certificate_matrix(multipliers), rows).toarray()
    inverse = exact_inverse(A)
    for node in range(problem.n):
        own = layout.first_row(node) + np.arange(layout.sizes[node])
        exact = [[inverse[r][c] for c in own] for r in own]
        mine = found[node, : len(own), : len(own)]
        excess = [
            [Fraction(float(a)) - b for a, b in zip(*both, strict=True)]
            for both in zip(mine, exact, strict=True)
        ]
        assert is_definite(excess)
        dense = np.array(exact, dtype=float)
        assert np.abs(mine - dense).max() <= 1e-6 * np.abs(dense).max()


def test_a_certified_estimate_far_from_the_optimum(dataset):
    """MIT: poses move by a metre for a thousandth of a per cent of the cost."""
    answer = certpgo.solve(dataset("MIT"), cost="chordal")
    best, regions, v = answer.estimate, answer.certificate.regions, np.array([0.6, 0.8])
    attempts = Attempts(regions.form, regions.point, True, -np.inf, False)
    A = attempts.matrix(regions.bound.multipliers, np.zeros(0), attempts.rows_of(0))
    layout, node = regions.form.pattern.layout_of(A), answer.certificate.distance_from(0).node
    row = layout.first_row(node)
    bend = attempts.symbolic.factor(A).solve(np.eye(1, A.shape[0], row).ravel())
    share = np.sqrt(0.97e-5 * regions.known / bend[row])
    step = share * layout.unpack(bend)
    R = so.project(best.rotations + v[:, None] * step[:, None, 1:])
    bent = regions.form.complete(R)
    certificate = certpgo.certify(answer.problem, bent)
    found, (metres, degrees) = certificate.distance_from(0), apart(bent, best, 0)
    assert certificate.is_optimal
    assert 0.5 < metres[node] <= found.metres[node] < 5.0
    assert (metres <= found.metres + 1e-9).all()
    assert (degrees <= found.degrees + 1e-9).all()
    assert answer.certificate.distance.largest[0] < 0.3
    assert found.metres[0] == found.degrees[0] == 0.0
    assert found.largest == (found.metres[found.node], found.degrees.max())


def test_it_is_of_the_best_answer_known():
    """A worse estimate may be further off, by the cost that it has more."""
    problem, _ = problem_of("poses", rng_of(1), 3)
    best = certpgo.solve(problem).estimate
    sizes = [0.0, 1e-3, 1e-2, 0.1]
    found = [certpgo.certify(problem, moved(rng_of(2), best, size)).distance for size in sizes]
    largest = [one.largest for one in found]
    assert largest == sorted(largest)


def test_weights_have_no_unit():
    problem, truth = problem_of("poses", rng_of(1), 3)
    one, other = (certpgo.certify(problem.scaled(by), truth).distance for by in (1.0, 4.0))
    np.testing.assert_allclose(one.metres, other.metres, rtol=1e-9)
    np.testing.assert_allclose(one.degrees, other.degrees, rtol=1e-9)


def test_nothing_is_said_where_nothing_is_proven(dataset):
    problem, truth = problem_of("poses", rng_of(1), 2)
    screened = certpgo.certify(problem, truth, tier="screen")
    assert screened.distance is None
    assert screened.region(1, 0) is None
    steps = problem.graph
    ones = np.ones(steps.num_edges)
    free = certpgo.SimilarityGraph(
        steps.rotations_alone,
        steps.translations,
        steps.tau,
        scales=ones,
        free=np.ones(problem.n) > 0,
    )
    assert certpgo.solve(free).certificate.distance is None
    instance, _ = winding_cycle(6, 0.3, 0)
    proven = certpgo.certify(Quadratic(instance.graph), instance.truth, tier="proof")
    assert proven.distance.metres is None
    assert proven.distance.degrees.max() < 0.01


def test_points_are_no_references():
    problem, truth = problem_of("points", rng_of(1), 2)
    certificate = certpgo.certify(problem, truth)
    [point, *_] = np.flatnonzero(problem.graph.is_point)
    for wrong in (int(point), -1, problem.n):
        with pytest.raises(InputError, match="poses"):
            certificate.distance_from(wrong)
    assert certificate.distance.degrees[point] == 0.0
    assert certificate.distance.metres[point] > 0.0


@given(seeds, st.sampled_from(["poses", "points"]))
@settings(max_examples=10)
def test_it_costs_nothing_before_it_is_asked_for(seed, kind):
    problem, truth = problem_of(kind, rng_of(seed), 2)
    regions = certpgo.certify(problem, truth).regions
    known = regions.bound.inverses
    assert not known
    regions.distance()
    [first] = known.values()
    regions.distance()
    regions.region(0 if regions.anchor else 1)
    assert known == {(regions.anchor, False): first}
    assert not replace(regions.bound).inverses  # a copy may have other multipliers


@given(seeds, st.sampled_from(["poses", "points", "rotations", "g2o"]), dimensions)
@settings(max_examples=10)
def test_estimates_that_share_a_bound_share_the_inverse(seed, kind, d):
    rng = rng_of(seed)
    problem, truth = problem_of(kind, rng, d, noise=0.01)
    best = certpgo.solve(problem).estimate
    judge = Judge(problem)
    first, *others = [judge.certify(x) for x in (best, truth, moved(rng, best, 0.01))]
    assert first.distance is not None
    for other in others:
        assert other.regions.bound is first.regions.bound
        alone = certpgo.certify(problem, other.regions.estimate).distance
        apart = other.distance
        assert apart.reference == alone.reference
        np.testing.assert_allclose(apart.degrees, alone.degrees, rtol=1e-3, atol=1e-6)
    assert len(first.regions.bound.inverses) == 1


def test_costs_at_the_proof_tier_are_those_of_the_stored_numbers_too():
    graph = pose_graph(rng_of(1), 8, 3, noise=0.2)[0]
    problem = Quadratic(graph)
    given = certpgo.solve(problem).estimate
    judged = certpgo.certify(problem, given, tier="proof")
    upper = min(problem.enclosure(one)[1] for one in (given, judged.refined))
    assert judged.regions.unit * judged.regions.known >= upper
    assert judged.distance.metres.max() < 0.1
    with pytest.raises(ValueError, match="read-only"):
        judged.distance.metres[0] = 0.0
    with pytest.raises(InputError, match="the number of a node"):
        judged.distance_from(1.7)


def test_rounding_alone_puts_nothing_outside():
    """Shapes whose axes differ by twelve orders, and an estimate at the very edge."""
    rng = rng_of(0)
    for _ in range(200):
        B = np.linalg.qr(rng.standard_normal((4, 4)))[0]
        shape = (B * 10.0 ** rng.uniform(-12.0, 0.0, 4)) @ B.T
        shape = 0.5 * (shape + shape.T)
        R, u = so.exp(1e-3 * rng.standard_normal(3)), 0.01 * rng.standard_normal(3)
        edge = [[Fraction(x) for x in row] for row in np.c_[u, R - np.eye(3)].tolist()]
        inverse = exact_inverse(shape)
        share = sum(a * x * b for r in edge for a, of in zip(r, inverse, strict=True)
                    for x, b in zip(of, r, strict=True))  # fmt: skip
        shape *= float(share) * (1.0 + 1e-11)
        there = Estimate(np.stack([np.eye(3), R]), np.stack([np.zeros(3), u]))
        region = certpgo.Region(1, 0, np.zeros(3), np.eye(3), 1.0, 1.0, 0.0, shape)
        assert region.holds(there)
        wide = certpgo.Region(1, 0, np.zeros(3), np.eye(3), 1.0, 1.0, 0.0, 0.9 * shape)
        assert not wide.holds(there) or np.linalg.cond(shape) > 1e10


def test_small_graphs_print_the_distance_and_larger_ones_once_it_is_known(monkeypatch):
    instance = helix(4, rng_of(0))
    answer = certpgo.solve(replace(instance, ids=100 + instance.ids))
    line = "proven distance   within "
    assert line in str(answer)
    assert f"seen from node {100 + answer.certificate.distance.reference})" in flat(answer)
    # A certificate alone knows numbers of nodes.
    assert f"seen from node {answer.certificate.distance.reference})" in flat(answer.certificate)
    monkeypatch.setattr(printed, "SMALL", 10)
    again = certpgo.certify(instance, answer.estimate)
    assert line not in str(again)
    known = again.distance
    assert line in str(again)
    metres, degrees = known.largest
    within = re.search(r"within (\S+) m and (\S+) degrees of every optimum", flat(again))
    assert float(within[1]) == pytest.approx(metres, rel=0.01)
    assert float(within[1]) >= metres
    assert float(within[2]) >= degrees
    assert known.sentence(str).startswith(f"Within {within[1]} m and {within[2]} degrees")


def test_printed_rejections_are_of_all_choices():
    instance = helix(4, rng_of(0))
    R = instance.graph.rotations.copy()
    R[-1] = -R[-1] @ np.diag([1.0, 1.0, -1.0])
    wrong = certpgo.RotationGraph(
        instance.graph.num_nodes, instance.graph.edges, R, instance.graph.kappa
    )
    graph = certpgo.PoseGraph(wrong, instance.graph.translations, instance.graph.tau)
    answer = certpgo.solve_robustly(graph)
    assert answer.rejection.covers(answer.certificate)
    of_all, of_kept = answer.rejection.certificate.distance, answer.certificate.distance
    assert f"within {in_words(*of_all.largest)} of every optimum" in flat(answer)
    assert f"within {in_words(*of_kept.largest)} of every optimum" in flat(answer.certificate)


def test_nothing_is_said_where_nothing_is_known():
    unknown = ProvenDistance(0, None, np.array([0.0, 180.0]))
    assert limits(unknown) == limits(None) == (None, None)
    assert limits(unknown, 0) == (None, 0.0)
    assert not list(unknown.in_words(str))
    assert unknown.sentence(str) == ""
    far = ProvenDistance(0, np.array([0.0, 2.5]), np.array([0.0, 180.0]))
    assert limits(far) == (2.5, None)
    assert far.sentence(str).startswith("Within 2.5 m and any angle of every optimum (most at 1;")
    undecided = replace(
        certpgo.certify(helix(4, rng_of(0)), certpgo.solve(helix(4, rng_of(0))).estimate),
        verdict=certpgo.Verdict.UNDECIDED,
    )
    assert undecided.distance is not None
    assert undecided.stated_distance() is None
    assert "proven distance" not in str(undecided)


def flat(text):
    return " ".join(str(text).split())


def test_halves_of_metres_and_of_degrees_are_not_the_same():
    """Half of the nodes are near, the others hardly turn: none is both."""
    metres, degrees = np.array([0.0, 0.125, 0.125, 9.0, 9.0]), np.array([0.0, 50.0, 50.0, 1.0, 1.0])
    found = ProvenDistance(0, metres, degrees)
    assert (
        dict(found.in_words(str))[""] == "half of the nodes within 0.125 m, half within 1 degrees"
    )
    points = ProvenDistance(0, metres, np.array([0.0, 0.0, 0.0, 1.0, 1.0]))
    assert dict(points.in_words(str))[""] == "half of the nodes within 0.125 m"
    rotations = ProvenDistance(0, None, degrees)
    assert dict(rotations.in_words(str))[""] == "half of the nodes within 1 degrees"


def test_the_proof_tier_assumes_nothing_of_the_factorization(monkeypatch):
    """What is known without measuring the residual does not count, nor stand in for it."""
    from certpgo.certify import regions

    problem, truth = problem_of("points", rng_of(2), 3)
    certificate = certpgo.certify(problem, truth, tier="proof")
    known, (metres, _) = certificate.regions, certificate.distance.largest
    bounded = regions.rounding_of_factor
    monkeypatch.setattr(
        regions, "rounding_of_factor", lambda *given: (0.0 * given[2], bounded(*given)[1])
    )
    fresh = replace(known, bound=replace(known.bound))
    assert fresh.distance().largest[0] == pytest.approx(metres, rel=1e-9)
    monkeypatch.setattr(regions, "measured_residual", lambda *given: None)
    assert replace(known, bound=replace(known.bound)).distance() is None

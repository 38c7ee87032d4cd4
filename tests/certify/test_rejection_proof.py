"""Proof files about truncated costs: what both checkers accept, and that it is true."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from proofs import arrays_of, exact_rotation, repacked, with_claim
from strategies import point_graph, rng_of
from test_truncated import doubtful_graph

import certpgo
from certpgo import InputError, certify, checker, integer_checker, integer_reader, solve
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.solve.proving import write_proof

BOTH = [checker, integer_checker]


def proven(folder, graph, doubtful, price=25.0):
    """Paths of a graph file and of a proof about its truncated cost, and the problem."""
    path, proof = folder / "graph.g2o", folder / "graph.cert"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    problem = TruncatedCost(Quadratic(instance.graph), np.where(doubtful, price, np.inf))
    start = solve(problem.kept).estimate
    found = certify(problem, start)
    write_proof(proof, path, instance, found.refined, found, prices=problem.prices)
    return path, proof, problem


@pytest.fixture(scope="module")
def spatial(tmp_path_factory):
    graph, doubtful = doubtful_graph(np.random.default_rng(3), 3, poses=True)
    return proven(tmp_path_factory.mktemp("spatial"), graph, doubtful)


def least_cost(problem):
    """The lowest truncated cost over all choices, as found by solving each."""
    best = math.inf
    for choice in itertools.product((False, True), repeat=len(problem.rejected)):
        taken = ~problem.is_rejected
        taken[problem.rejected] = choice
        left_out = float(problem.prices[~taken].sum())
        kept = solve(problem.graph.reweighted(1.0 * taken), cost="chordal")
        best = min(best, kept.cost + left_out)
    return best


@pytest.mark.parametrize("seed", range(4))
def test_both_checkers_prove_the_least_cost_of_all_choices(tmp_path, seed):
    d, poses = 2 + seed % 2, seed < 2
    graph, doubtful = doubtful_graph(np.random.default_rng(seed), d, poses=poses)
    path, proof, problem = proven(tmp_path, graph, doubtful)
    best = least_cost(problem)
    first, second = (of.check(path, proof) for of in BOTH)
    assert first.lower <= best * (1.0 + 1e-12)
    assert first.upper >= best * (1.0 - 1e-12)
    assert float(second.upper) == pytest.approx(first.upper, rel=1e-14)
    assert float(second.lower) == pytest.approx(first.lower, rel=1e-12)
    assert first.about == second.about
    assert first.about.endswith(f"truncated: {doubtful.sum()} rejected ones cost 25 to 25 at most")


@pytest.mark.parametrize("price", [25.00004, 25.00006])
def test_checkers_enclose_prices_in_the_digits_that_they_print(tmp_path, price):
    graph, doubtful = doubtful_graph(np.random.default_rng(0), 2, poses=False, doubtful=1)
    path, proof, _ = proven(tmp_path, graph, doubtful, price)
    for of in BOTH:
        assert of.check(path, proof).about.endswith("cost 25.0000 to 25.0001 at most")


def test_a_certified_rejection_is_proven_to_the_last_digits(tmp_path):
    graph, doubtful = doubtful_graph(np.random.default_rng(0), 3, poses=True, doubtful=1)
    path, proof, problem = proven(tmp_path, graph, doubtful)
    assert solve(problem.kept).cost + 25.0 == pytest.approx(least_cost(problem), rel=1e-12)
    for of in BOTH:
        assert of.check(path, proof).relative_gap < 1e-10


def test_points_and_priors_have_proofs(tmp_path):
    # A sighting that is wrong by many metres, and one that is right.
    graph, _ = point_graph(np.random.default_rng(5), 6, 3, 3)
    t, sighted = graph.translations.copy(), np.flatnonzero(graph.is_point[graph.edges[:, 1]])
    t[sighted[0]] += 50.0
    doubtful = np.zeros(graph.num_edges, dtype=bool)
    doubtful[sighted[0]] = True
    posed = certpgo.PoseGraph(graph.rotations_alone, t, graph.tau, points=graph.is_point)
    path, proof, _ = proven(tmp_path, posed, doubtful)
    for of in BOTH:
        said = of.check(path, proof)
        assert said.relative_gap < 1e-9
        assert "landmarks" in said.about
    # No rotation of a point may be used, whatever else is claimed.
    arrays = arrays_of(proof)
    arrays["rejections"][0, 1] = 1.0
    proof.write_bytes(repacked(arrays))
    for of in BOTH:
        with pytest.raises(of.Refused):
            of.check(path, proof)


@pytest.mark.parametrize("keep", ["all", "first", "last"])
def test_both_checkers_number_the_measurements_alike(tmp_path, keep):
    # Priors and sightings come first in the file, every measurement twice, and the wrong one is a
    # sighting: places in the file are others than numbers in the proof.
    graph, _ = point_graph(np.random.default_rng(5), 6, 3, 3)
    sighted = np.flatnonzero(graph.is_point[graph.edges[:, 1]])
    t = graph.translations.copy()
    t[sighted[1]] += 50.0
    posed = certpgo.PoseGraph(graph.rotations_alone, t, graph.tau, points=graph.is_point)
    posed = certpgo.with_priors(posed, np.arange(4), translations=np.eye(4, 3), tau=0.01)
    names = {"ids": np.arange(posed.num_nodes), "world": posed.num_nodes - 1}
    path, proof = tmp_path / "graph.g2o", tmp_path / "graph.cert"
    certpgo.write(path, certpgo.Instance("graph", posed, **names))
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[::-1], *lines[::-1]]) + "\n")
    instance = certpgo.read(path, keep=keep, quiet=True)
    whole = Quadratic(instance.graph)
    wrong = whole.edge_costs(solve(posed).estimate) > 1e3
    assert wrong.any()
    problem = TruncatedCost(whole, np.where(wrong, 25.0, np.inf))
    found = certify(problem, solve(problem.kept).estimate)
    write_proof(proof, path, instance, found.refined, found, prices=problem.prices)
    first, second = (of.check(path, proof) for of in BOTH)
    assert float(second.upper) == pytest.approx(first.upper, rel=1e-12)
    assert float(second.lower) == pytest.approx(first.lower, rel=1e-9)


def damage_price(rows):
    rows[:, 0] *= 1.0 + 1e-6


def damage_weights(rows):
    rows[:, [1, 11]] *= 1.0 - 1e-6


def damage_turning(rows):
    rows[:, 1] = -rows[:, 1]


def damage_moving(rows):
    rows[:, 11] = -rows[:, 11]


def no_price(rows):
    rows[:, [0, 1, 11]] = 0.0


def price_without_weights(rows):
    rows[:, 0] = -1.0
    rows[:, [1, 11]] = 0.0


def infinite(rows):
    rows[0, 0] = np.inf


@pytest.mark.parametrize(
    "damage",
    [
        damage_price,
        damage_weights,
        damage_turning,
        damage_moving,
        no_price,
        price_without_weights,
        infinite,
    ],
)
def test_what_does_not_reach_its_price_is_refused(tmp_path, spatial, damage):
    path, proof, _ = spatial
    arrays = arrays_of(proof)
    used = (arrays["rejections"][:, [1, 11]] > 0.0).any(axis=1)
    assert used.any()
    rows = arrays["rejections"][used]
    damage(rows)
    arrays["rejections"][np.flatnonzero(used)[0]] = rows[0]  # one among others
    changed = tmp_path / "changed.cert"
    changed.write_bytes(repacked(arrays))
    for of in BOTH:
        with pytest.raises(of.Refused):
            of.check(path, changed)


@pytest.mark.parametrize(
    "change",
    [
        lambda e, m: e[::-1],
        lambda e, m: np.r_[e[:-1], m],
        lambda e, m: np.r_[-1, e[1:]],
        lambda e, m: np.r_[e[1], e[1:]],
        lambda e, m: e[:0],
        lambda e, m: np.arange(m),
    ],
)
def test_rejected_measurements_are_each_given_once(tmp_path, spatial, change):
    path, proof, problem = spatial
    arrays = arrays_of(proof)
    m = problem.graph.num_edges
    arrays["rejected"] = change(arrays["rejected"], m).astype("<i4")
    arrays["rejections"] = np.resize(arrays["rejections"], (len(arrays["rejected"]), 15))
    changed = tmp_path / "changed.cert"
    changed.write_bytes(repacked(arrays))
    for of in BOTH:
        with pytest.raises((of.Refused, of.Unreadable)):
            of.check(path, changed)


@pytest.mark.parametrize("change", [{"version": 2}, {"version": 4}, {"cost": "g2o"}])
def test_other_headers_are_unreadable(tmp_path, spatial, change):
    path, proof, _ = spatial
    changed = tmp_path / "changed.cert"
    changed.write_bytes(repacked(with_claim(arrays_of(proof), **change)))
    for of in BOTH:
        with pytest.raises(of.Unreadable):
            of.check(path, changed)


def test_rotations_alone_have_no_translations_to_reach_a_price(tmp_path):
    # The file has translations, which a proof about rotations does not count.
    graph, doubtful = doubtful_graph(np.random.default_rng(4), 3, poses=True)
    path, proof, _ = proven(tmp_path, graph.rotations_alone, doubtful)
    arrays = arrays_of(proof)
    assert arrays["rejections"].shape[1] == 11
    arrays["rejections"] = np.c_[arrays["rejections"], np.full((len(doubtful[doubtful]), 4), 1e3)]
    proof.write_bytes(repacked(arrays))
    for of in BOTH:
        with pytest.raises(of.Refused, match="shape"):
            of.check(path, proof)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([2, 3]), st.floats(-1e-15, 1e-15))
def test_prices_are_compared_exactly(seed, d, less):
    """Both checkers agree with rationals on prices that are barely reached, or barely not."""
    rng = rng_of(seed)
    q = rng.normal(size=(1, 4)) if d == 3 else rng.normal(size=(1, 2))
    kappa, tau, beta, gamma = np.exp(rng.uniform(-3.0, 3.0, 4)).tolist()
    if rng.integers(4) == 0:
        gamma = 0.0
    t, b, C = rng.normal(size=d), rng.normal(size=d), rng.normal(size=(d, d))
    (N,), (D,) = checker.exact_rotations(q)
    R = [[Fraction(int(x), int(D)) for x in row] for row in N]
    turned = sum((Fraction(float(C[r, s])) - R[r][s]) ** 2 for r in range(d) for s in range(d))
    moved = sum((Fraction(float(x)) - Fraction(float(y))) ** 2 for x, y in zip(b, t, strict=True))

    def parallel(x, y):
        return Fraction(x) * Fraction(y) / (Fraction(x) + Fraction(y))

    reached = parallel(kappa, beta) * turned + parallel(tau, gamma) * moved
    price = float(reached) * (1.0 + less)
    holds, claimed = verdicts(q, t, kappa, tau, price, beta, C, gamma, b)
    assert not (holds and reached < Fraction(price))
    assert holds or reached < Fraction(price) * (1 + Fraction(1, 2**150))
    if reached < Fraction(price):
        assert claimed is None
        return
    size = sum(Fraction(float(x)) ** 2 for x in C.ravel())
    constant = Fraction(price) + Fraction(beta) * (d - size)
    assert claimed == constant


def verdicts(q, t, kappa, tau, price, beta, C, gamma, b):
    """Whether doubles accept a claim about one measurement, and the constant in integers."""
    one = np.array([0])
    graph = checker.Graph(
        2, one, one + 1, checker.rotations(q), t[None], np.array([kappa]), np.array([tau])
    )
    given = checker.Rejections(
        one, np.array([price]), np.array([beta]), C[None], np.array([gamma]), b[None]
    )
    holds = bool(checker.rejections_hold(graph, given)[0])

    def exact(x):
        return int(Fraction(float(x)) * integer_checker.ONE)

    def all_exact(x):
        return [exact(number) for number in x]

    turn = integer_reader.quaternion(all_exact(q[0]))
    edge = integer_checker.Edge(0, 1, turn, all_exact(t), exact(kappa), exact(tau))
    weights = exact(price), exact(beta), exact(gamma)
    cut = integer_checker.Rejected(0, *weights, [all_exact(row) for row in C], all_exact(b))
    unused = beta == gamma == 0.0
    try:
        below, constants = checker.truncated(graph, given)
    except checker.Refused:
        assert not holds
        with pytest.raises(integer_checker.Refused):
            integer_checker.constant(edge, cut, len(t))
        return holds, None
    found = integer_checker.constant(edge, cut, len(t)) / integer_checker.ONE
    assert holds or unused
    assert (below.kappa[0], below.tau[0]) == (-beta, -gamma)
    rounding = (price + beta * (len(t) + float((C**2).sum()))) * 2.0**-50
    assert 0 <= found - Fraction(float(constants[0])) <= rounding
    return holds, found


STILL = np.array([[1.0, 0.0]])  # half-angle pair of the identity
ORIGIN = np.zeros(2)


def test_a_price_that_is_just_reached_is_accepted_and_no_more():
    # 2 || 2 = 1, and the centre is 2 away.
    C = np.array([[1.0, 2.0], [0.0, 1.0]])
    assert verdicts(STILL, ORIGIN, 2.0, 1.0, 1.0, 2.0, C, 0.0, ORIGIN)[0]
    moved = np.array([2.0, 0.0])
    for price, holds in ((4.0, True), (np.nextafter(4.0, 5.0), False)):
        found = verdicts(STILL, ORIGIN, 2.0, 2.0, price, 0.0, np.eye(2), 2.0, moved)
        assert (found[0], found[1] is not None) == (holds, holds)


def test_large_distances_are_exact():
    moved = np.array([2.0**60, 0.0])
    for price, holds in ((2.0**120, True), (np.nextafter(2.0**120, np.inf), False)):
        found = verdicts(STILL, ORIGIN, 2.0, 2.0, price, 0.0, np.eye(2), 2.0, moved)
        assert found[0] is holds


def test_what_is_measured_at_the_centre_reaches_nothing():
    assert verdicts(STILL, ORIGIN, 2.0, 2.0, 2.0**-321, 2.0, np.eye(2), 0.0, ORIGIN)[0] is False


def test_weights_and_prices_have_signs():
    far, C = np.array([100.0, 0.0]), 100.0 * np.eye(2)
    for price, beta, gamma in (
        (1.0, -1e-3, 1.0),
        (1.0, 1.0, -1e-3),
        (1.0, -1e-3, 0.0),
        (1.0, 0.0, -1e-3),
        (1.0, -1e-3, -1e-3),
        (0.0, 1.0, 1.0),
        (-1.0, 1.0, 1.0),
        (0.0, 0.0, 0.0),
        (-1.0, 0.0, 0.0),
    ):
        assert verdicts(STILL, ORIGIN, 2.0, 2.0, price, beta, C, gamma, far) == (False, None)


def test_without_weights_a_price_does_not_count():
    assert verdicts(STILL, ORIGIN, 2.0, 2.0, 9.0, 0.0, np.eye(2), 0.0, ORIGIN) == (False, 0)


@pytest.mark.parametrize(("away", "holds"), [(2.0, False), (3.0, True)])
def test_positions_reach_prices_by_their_distance_alone(away, holds):
    moved, C = np.array([away, 0.0]), 100.0 * np.eye(2)
    assert verdicts(STILL, ORIGIN, 0.0, 2.0, 5.0, 0.0, C, 2.0, moved)[0] is holds


def test_distances_are_not_taken_to_be_larger_than_they_are():
    """Measured rotations are known to less than a unit of 2^-160, on either side."""
    q = np.array([[1.0, 1.3 * 2.0**-160]])  # sines of 2.6 units, between 2 and 3
    C = np.array([[1.0, 0.0], [5.0 * 2.0**-160, 1.0]])
    # 2.4^2 + 2.6^2 = 12.52, where rounded distances give 18.
    one = np.array([0])
    graph = checker.Graph(
        2, one, one + 1, checker.rotations(q), ORIGIN[None], np.array([2.0]), np.array([1.0])
    )
    for price, holds in ((7.0, True), (15.0, False)):
        parts = np.array([price * 2.0**-320]), np.array([2.0]), C[None], np.zeros(1), ORIGIN[None]
        assert checker.rejections_hold(graph, checker.Rejections(one, *parts))[0] == holds


@pytest.mark.parametrize("price", [1.0, 4.0, 16.0, 64.0])
def test_costs_are_cut_off_at_their_prices(tmp_path, price):
    graph, doubtful = doubtful_graph(np.random.default_rng(6), 2, poses=True)
    path, proof, problem = proven(tmp_path, graph, doubtful, price)
    arrays = arrays_of(proof)
    q, t = arrays["rotations"], arrays["translations"]
    R = np.array([[float(x) for row in exact_rotation(p) for x in row] for p in q])
    expected = problem.cost(certpgo.Estimate(R.reshape(-1, 2, 2), t))
    for of in BOTH:
        assert float(of.check(path, proof).upper) == pytest.approx(expected, rel=1e-12)


def test_other_costs_have_no_proof_of_rejections(tmp_path):
    graph, _ = doubtful_graph(np.random.default_rng(3), 3, poses=True)
    path = tmp_path / "graph.g2o"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve_robustly(instance, cost="g2o")
    if answer.rejection is None:
        pytest.skip("nothing is rejected")
    with pytest.raises(InputError, match="chordal"):
        write_proof(
            tmp_path / "x.cert",
            path,
            instance,
            answer.estimate,
            answer.rejection.certificate,
            prices=answer.rejection.problem.prices,
        )

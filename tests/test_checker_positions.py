"""Proofs of g2o's cost where positions are measured: what is accepted, and what must be refused."""

from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds
from test_checker_map import map_text, proven, tried

import certpgo
from certpgo import checker
from certpgo.errors import FormatError
from certpgo.solve.proving import write_proof

#: How many proofs of each small graph are damaged.
MUTATIONS = 150


def exact(A):
    """Doubles in rationals."""
    return [exact(row) for row in A] if np.ndim(A) else Fraction(float(A))


def solved(A, y):
    """A^-1 y in rationals, by Cramer's rule."""

    def determinant(M):
        if not M:
            return Fraction(1)
        rest = [[row[:k] + row[k + 1 :] for row in M[1:]] for k in range(len(M))]
        return sum((-1) ** k * M[0][k] * determinant(rest[k]) for k in range(len(M)))

    whole = determinant(A)
    columns = [[[*row[:k], y[r], *row[k + 1 :]] for r, row in enumerate(A)] for k in range(len(A))]
    return [determinant(M) / whole for M in columns]


def one_position(rng, d, condition):
    """A position's measurement as the checker reads it, and a minorant without its constant."""
    p = 3 * d - 3
    A = rng.standard_normal((d, d)) * condition ** rng.uniform(-1, 0, d)
    T = A @ A.T + 1e-3 * np.eye(d) / condition
    T = np.ldexp(T + T.T, int(rng.integers(-60, 60)))
    information = np.zeros((1, p, p))
    information[0, :d, :d] = T
    zero, none = np.zeros(1), np.zeros((1, d))
    q = np.array([[0.0, 0.0, 0.0, 1.0] if d == 3 else [1.0, 0.0]])
    t = 10.0 * rng.standard_normal((1, d))
    graph = checker.Graph(
        2, zero.astype(int), zero.astype(int) + 1, None, t, zero, zero + 1.0, q=q
    )._replace(information=information)
    tau = np.array([np.linalg.eigvalsh(T)[0] * rng.choice([0.99, 0.5, 1e-6, -1.0])])
    arms = t + rng.standard_normal((1, d)) * 10.0 ** rng.uniform(-6, 2)
    touching = np.zeros((1, 1 if d == 2 else 5))
    return graph, checker.EdgeBounds(tau, arms, zero, none[:, :, None] * t, touching, zero)


def smallest(graph, given):
    """The minimum over y of y^T T y - tau |y - y'|^2, in rationals."""
    d = graph.t.shape[1]
    T, tau = exact(graph.information[0, :d, :d]), Fraction(float(given.tau[0]))
    y = [b - t for b, t in zip(exact(given.arms[0]), exact(graph.t[0]), strict=True)]
    A = [[T[a][b] - tau * (a == b) for b in range(d)] for a in range(d)]
    inner = sum(a * b for a, b in zip(y, solved(A, y), strict=True))
    return -tau * sum(x * x for x in y) - tau * tau * inner


@given(seeds, dimensions, st.sampled_from([1.0, 1e3, 1e8]))
@settings(max_examples=60, deadline=None)
def test_constants_are_accepted_up_to_the_exact_minimum(seed, d, condition):
    graph, given = one_position(rng_of(seed), d, condition)
    gamma = smallest(graph, given)
    size = Fraction(float(np.abs(graph.information).max())) + abs(gamma)
    for share in (-1, -1e-3, -1e-12, -1e-15, 1e-15, 1e-12, 1e-3, 1):
        constant = np.array([float(gamma + Fraction(share) * size)])
        held = checker.minorants_hold(graph, given._replace(constants=constant))[0]
        if held:
            assert Fraction(float(constant[0])) <= gamma
        elif share <= -1e-12:
            raise AssertionError("a constant below the minimum is refused")


@given(seeds, dimensions)
@settings(max_examples=20, deadline=None)
def test_minorants_of_positions_hold_no_rotation(seed, d):
    rng = rng_of(seed)
    graph, given = one_position(rng, d, 1e2)
    gamma = smallest(graph, given)
    low = given._replace(constants=np.array([float(gamma - abs(gamma)) - 1.0]))
    assert checker.minorants_hold(graph, low)[0]
    for size in (5e-324, -1e-9, 1.0, -1e6):
        couplings = low.couplings.copy()
        couplings[0, rng.integers(d), rng.integers(d)] = size
        assert not checker.minorants_hold(graph, low._replace(couplings=couplings))[0]
        assert not checker.minorants_hold(graph, low._replace(kappa=np.array([size])))[0]
    # Weights that leave nothing of the information, and information that is not definite.
    for tau in np.linalg.eigvalsh(graph.information[0, :d, :d])[-1] * np.array([1.0, 3.0]):
        assert not checker.minorants_hold(graph, low._replace(tau=np.array([tau])))[0]
    information = graph.information.copy()
    information[0, 0, 0] *= -1.0
    assert not checker.minorants_hold(graph._replace(information=information), low)[0]


@pytest.mark.parametrize("d", [2, 3])
def test_an_isotropic_position_is_its_own_minorant(d):
    graph, given = one_position(rng_of(3), d, 1.0)
    graph.information[0, :d, :d] = 3.0 * np.eye(d)
    own = given._replace(tau=np.array([3.0]), arms=graph.t)
    for constant, held in ((0.0, True), (-1.0, True), (5e-324, False), (1.0, False)):
        found = checker.minorants_hold(graph, own._replace(constants=np.array([constant])))
        assert found.tolist() == [held]
    assert not checker.minorants_hold(graph, own._replace(arms=np.nextafter(graph.t, np.inf)))[0]
    # A pose's measurement, whose rotation counts, is no position.
    whole = graph._replace(kappa=np.ones(1))
    assert not checker.minorants_hold(whole, own._replace(constants=np.array([-1.0])))[0]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("far", [0.0, 4.0e5])
def test_proves_landmarks_and_priors(tmp_path, d, whole, far):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(d, d, whole=whole, far=far))
    proof, instance = proven(path, "g2o")
    said, arrays = checker.check(path, proof), proofs.arrays_of(proof)
    assert said.relative_gap < 1e-9
    assert "with full information, and of positions" in said.about
    assert "with 3 landmarks, with 2 priors" in said.about
    # The exact cost of the stored estimate, of the lines in the file.
    problem = certpgo.objective.choose_cost.objective_of(instance, "g2o")
    estimate = certpgo.solve(instance, cost="g2o").estimate
    assert problem.cost(estimate) == pytest.approx(said.upper, rel=1e-7)
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    assert np.array_equal(np.stack([graph.i, graph.j], axis=1), instance.graph.edges)
    assert np.array_equal(graph.information, instance.graph.information_matrices)


@pytest.mark.parametrize("d", [2, 3])
def test_mutations_prove_nothing_false(tmp_path, d):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(1, d))
    proof, instance = proven(path, "g2o")
    arrays, rng = proofs.arrays_of(proof), np.random.default_rng(0)
    said, names = tried(path, arrays), sorted(arrays.keys() - {"claim", "order"})
    point = np.flatnonzero(instance.graph.is_point)[0]
    multipliers = arrays["multipliers"].copy()
    multipliers[point, 0] = 1e-3
    assert tried(path, {**arrays, "multipliers": multipliers}) is None
    for _ in range(MUTATIONS):
        name = names[rng.integers(len(names))]
        array = arrays[name].copy()
        place = rng.integers(array.size)
        kind, value = rng.integers(4), float(array.flat[place])
        array.flat[place] = [value * 1.001, -value, 0.0, value + rng.normal()][kind]
        found = tried(path, {**arrays, name: array})
        assert found is None or found.lower <= said.upper
        assert found is None or found.upper >= said.lower
    for changes in ({"landmarks": False}, {"priors": False}, {"cost": None}, {"version": 1}):
        found = tried(path, proofs.with_claim(arrays, **changes))
        assert found is None


@pytest.mark.parametrize("words", ["", "4 0.5", "4 9 3"])
def test_positions_must_have_definite_information(tmp_path, words):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(1, 2))
    proof, _ = proven(path, "g2o")
    text = path.read_text().replace("4 0.5 3\n", f"{words}\n", 1)
    claim = proofs.claim_of(proofs.arrays_of(proof))
    if words == "4 9 3":
        graph = checker.read_graph(text.encode(), claim, None)
        with np.load(proof) as archive:
            given = checker.read_proof(archive, claim, graph.n, len(graph.i)).minorants
        held = checker.minorants_hold(graph, given)
        assert held.sum() == len(held) - 1
    else:
        with pytest.raises(checker.Unreadable, match="expected"):
            checker.read_graph(text.encode(), claim, None)


def test_a_sensor_away_from_its_body_is_refused(tmp_path):
    path = tmp_path / "sensor.g2o"
    path.write_text("PARAMS_SE3OFFSET 0 0.5 0 0 0 0 0 1\n" + map_text(3, 3, priors=0))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    with pytest.raises(FormatError, match="sensor 0 is not known to be at its body's origin"):
        write_proof(tmp_path / "p.cert", path, instance, answer.estimate, answer.certificate)

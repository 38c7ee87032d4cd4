"""Both checkers on g2o's cost: against ball arithmetic of 90 digits, and forged minorants."""

import math
from fractions import Fraction

import numpy as np
import proofs
import pytest
import strategies
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

from certpgo import checker, integer_checker, integer_reader
from certpgo.certify.proof import quaternions
from certpgo.linalg import rotations as so

pytest.importorskip("flint", reason="python-flint is not installed")

from exact_costs import (
    BITS,
    applied,
    arb,
    balls,
    ctx,
    inner,
    planar,
    product,
    quadratic,
    random_edges,
    residual,
    rounded,
    spatial,
    transposed,
    turns,
)

few = settings(max_examples=15, deadline=None)
UNIT = arb(2) ** checker.POINT


def rational(x):
    """A fraction as a ball."""
    return arb(x.numerator) / arb(x.denominator)


def rotation(q):
    """R(q)/|q|^2 of doubles."""
    return [[rational(x) for x in row] for row in proofs.exact_rotation(q)]


# --- In integers


def stored(x):
    """Doubles as the integer checker stores them."""
    if np.ndim(x):
        return [stored(row) for row in x]
    return int(Fraction(float(x)) * integer_checker.ONE)


def edges_of(graph):
    """The measurements as the integer checker has them."""
    d, found = graph.t.shape[1], []
    for e, (i, j) in enumerate(zip(graph.i.tolist(), graph.j.tolist(), strict=True)):
        turned = graph.kappa[e] != 0.0
        A = graph.information[e] if turned else graph.information[e, :d, :d]
        q = integer_reader.quaternion(stored(graph.q[e])) if turned else (0, 0, 0, 1)
        t, upper = tuple(stored(graph.t[e])), tuple(stored(A[np.triu_indices(len(A))]))
        one = integer_checker.ONE
        found.append(integer_checker.Edge(i, j, q, t, one * bool(turned), one, one, upper))
    return found


def held_in_integers(graph, given):
    """(m,) which minorants the integer checker accepts."""
    d = graph.t.shape[1]
    tau, b, kappa, N, touching, c = (stored(x) for x in given)
    return np.array(
        [
            integer_checker.minorant_holds(
                edge,
                integer_checker.Minorant(
                    tau[e],
                    kappa[e],
                    c[e],
                    tuple(b[e]),
                    tuple(x for row in N[e] for x in row),
                    tuple(touching[e]) if edge.kappa else (),
                ),
                d,
            )
            for e, edge in enumerate(edges_of(graph))
        ]
    )


def cost_in_integers(graph, q, t):
    """At least f(x), as a fraction."""
    turns = [integer_reader.quaternion(row) for row in stored(q)]
    proof = integer_checker.Proof(turns, stored(t), [], [], 0, 0, [], [])
    given = integer_checker.Graph(graph.n, edges_of(graph), set())
    return integer_checker.g2o_cost(given, proof, graph.t.shape[1])


@given(st.tuples(*[st.integers(0, 2**60) | st.integers(0, 2**400)] * 2).filter(any))
@example((0, 1))
@example((1, 0))
@example((1, 2**300))
@example((2**300, 1))
def test_angles_in_integers(direction):
    s, c = direction
    exact = arb.atan2(arb(s), arb(c))
    unit = arb(2) ** integer_checker.BITS
    ctx.prec = 900
    try:
        off = abs(arb(integer_checker.angle(s, c)) - arb.atan2(arb(s), arb(c)) * unit)
        assert off < 2
    finally:
        ctx.prec = BITS
    assert abs(arb(integer_checker.angle(s, c)) / unit - exact) < 1e-80


def test_definite_matrices_in_integers():
    for diagonal in ([1, 1], [1, 0], [0, 1], [-1, -1], [2, 3, 1], [1 << 900, 1 << 900, 1]):
        A = [[x * (r == s) for s, x in enumerate(diagonal)] for r in range(len(diagonal))]
        small = max(diagonal) < 1 << 400  # what is lost by rounding is refused
        assert integer_checker.is_definite(A) == (min(diagonal) > 0 and small)
    large = [[(4 << 900) + 1, 3 << 900], [3 << 900, 4 << 900]]
    assert integer_checker.is_definite(large)
    assert not integer_checker.is_definite(
        [
            [x - (large[0][0] >> 2) * (r == s) for s, x in enumerate(row)]
            for r, row in enumerate(large)
        ]
    )


# --- Sines, angles and vector parts


@given(st.floats(-7.9, 7.9), st.sampled_from([(256, 12), (320, 12), (300, 20)]))
def test_cosines_and_sines_are_within_what_is_said(angle, sizes):
    bits, halvings = sizes
    exact = int(Fraction(angle) * 2**bits)
    off = arb(2) ** (7 + 2 * halvings - bits)
    cosine, sine = checker.circle(exact >> halvings, bits, halvings)
    x = rational(Fraction(exact, 2**bits))
    assert abs(arb(cosine) / arb(2) ** bits - x.cos()) < off
    assert abs(arb(sine) / arb(2) ** bits - x.sin()) < off


@given(seeds, st.sampled_from([0, 3, -200]))
@few
def test_angles_of_pairs(seed, exponent):
    rng = rng_of(seed)
    pairs = rng.standard_normal((6, 2)) * 10.0 ** rng.uniform(-12, 0, (6, 2))
    pairs = np.ldexp(np.concatenate([pairs, [[1, 0], [0, 1], [0, -1], [-1, 0], [1, 1]]]), exponent)
    angles, either = checker._angles(checker.integers(pairs)[0])
    assert either.tolist() == [False] * 6 + [False, True, True, False, False]
    for (c, s), (found,) in zip(pairs, angles, strict=True):
        E = rotation([c, s])
        exact = arb.atan2(E[1][0], E[0][0])
        if c == 0.0:
            found, exact = abs(found), arb.pi()
        assert abs(arb(int(found)) - exact * UNIT) < 2


def test_a_wrong_guess_of_an_angle_is_refused(monkeypatch):
    def angle():
        return checker._angles(checker.integers(np.array([[0.8, 0.3]]))[0])

    right = angle()[0][0, 0]
    guess = math.atan2(2 * 0.8 * 0.3, 0.8**2 - 0.3**2)
    monkeypatch.setattr(np, "arctan2", lambda s, c: np.array([guess + 1e-13]))
    assert abs(angle()[0][0, 0] - right) <= 2
    for wrong in (guess + 1e-9, guess - 1e-9, guess + math.pi, guess - math.pi, -0.1):
        monkeypatch.setattr(np, "arctan2", lambda s, c, wrong=wrong: np.array([wrong]))
        with pytest.raises(checker.Refused, match="angle"):
            angle()


@given(seeds)
@few
def test_vector_parts(seed):
    q = rng_of(seed).standard_normal((8, 4)) * 10.0 ** rng_of(seed + 1).uniform(-9, 3, (8, 4))
    q[0, 3], q[1] = 0.0, [0.0, 0.0, 0.0, -3.0]
    x, either = checker._vector_parts(checker.integers(q)[0])
    assert either.tolist() == [True] + [False] * 7
    for row, found in zip(q, x, strict=True):
        exact = balls(row)
        norm = inner(exact, exact).sqrt() * (-1 if row[3] < 0.0 else 1)
        for a, b in zip(exact[:3], found, strict=True):
            assert abs(a / norm * UNIT - arb(int(b))) < 2


@given(seeds, dimensions)
@few
def test_relative_quaternions(seed, d):
    a, b = rng_of(seed).standard_normal((2, 3, 2 if d == 2 else 4))
    p, q = (checker.integers(x)[0] for x in (a, b))
    between = checker._between(p, q)
    R, D = checker.exact_rotations(between.astype(float))
    found = np.array(R / D[:, None, None], dtype=float)
    pairs = [
        np.array(R / D[:, None, None], dtype=float) for R, D in map(checker.exact_rotations, (a, b))
    ]
    np.testing.assert_allclose(found, np.swapaxes(pairs[0], 1, 2) @ pairs[1], atol=1e-13)


@given(seeds, st.integers(1, 4))
def test_definite_matrices_are_told_from_others(seed, size):
    rng = rng_of(seed)
    A = rng.integers(-3, 4, (20, size, size))
    A = A @ np.swapaxes(A, 1, 2) + rng.integers(-2, 3) * np.eye(size, dtype=int)
    found = checker._definite(A.astype(object))
    for matrix, definite in zip(A, found, strict=True):
        less = [[Fraction(int(x)) for x in row] for row in matrix]
        for k in range(size):
            less[k][k] -= Fraction(1, 10**9)  # below any eigenvalue of integers like these
        assert proofs.is_positive_semidefinite(less) == definite


# --- The cost


def graph_of(cost):
    """The measurements of a cost, as the checker reads them."""
    graph = cost.graph
    i, j = graph.edges.T
    ones, q = np.ones(graph.num_edges), quaternions(graph.rotations)
    return checker.Graph(
        graph.num_nodes,
        i,
        j,
        None,
        graph.translations,
        ones,
        ones,
        q=q,
        information=graph.information_matrices,
    )


def exact_terms(graph, q, t):
    """Terms of f, by the definitions."""
    R, terms = [rotation(row) for row in q], []
    for e, (i, j) in enumerate(zip(graph.i, graph.j, strict=True)):
        back = transposed(R[i])
        v = applied(back, [a - b for a, b in zip(balls(t[j]), balls(t[i]), strict=True)])
        e_ = residual(rotation(graph.q[e]), balls(graph.t[e]), v, product(back, R[j]))
        terms.append(quadratic(balls(graph.information[e]), e_))
    return terms


@given(seeds, dimensions)
@few
def test_costs_are_rounded_up_by_little(seed, d):
    rng = rng_of(seed)
    graph = graph_of(random_edges(rng, 5, d).cost)
    q = rng.standard_normal((6, 2 if d == 2 else 4)) * 10.0 ** rng.uniform(-3, 3, (6, 1))
    t = rng.standard_normal((6, d)) * 10.0 ** rng.uniform(-3, 3)
    exact = sum(exact_terms(graph, q, t))
    found = arb(checker.g2o_cost(graph, q, t))
    assert exact <= found
    assert found <= exact * (1 + arb(2) ** -51)
    sharp = rational(cost_in_integers(graph, q, t))
    assert exact <= sharp * (1 + arb(2) ** -250)
    assert sharp <= exact * (1 + arb(2) ** -250)
    assert sharp <= found


@pytest.mark.parametrize("k", [-350, -40, 0, 7, 350])
@pytest.mark.parametrize("d", [2, 3])
def test_the_scale_of_information_changes_nothing(d, k):
    rng = rng_of(d)
    edges = random_edges(rng, 6, d)
    graph, q, t = graph_of(edges.cost), rng.standard_normal((7, 2 * d - 2)), np.ones((7, d))
    scaled = graph._replace(information=np.ldexp(graph.information, k))
    assert checker.g2o_cost(scaled, q, t) == math.ldexp(checker.g2o_cost(graph, q, t), k)


def one_edge(measured, step, Omega):
    d = len(step)
    ones = np.ones(1)
    return checker.Graph(
        2,
        np.array([0]),
        np.array([1]),
        None,
        np.array([step]),
        ones,
        ones,
        q=np.array([measured]),
        information=np.asarray(Omega, dtype=float)[None],
    ), np.zeros((2, d))


def test_a_planar_cost_by_hand():
    """A quarter turn measured, a turn of 3 rad / 2 found; one metre too far to the left."""
    Omega = [[2, 0, 1], [0, 3, -1], [1, -1, 4]]
    graph, t = one_edge([math.cos(math.pi / 4), math.sin(math.pi / 4)], [1.0, 0.0], Omega)
    q = np.array([[1.0, 0.0], [math.cos(0.75), math.sin(0.75)]])
    t[1] = [1.0, 1.0]  # y is (1, 0) in the measured frame
    a = 1.5 - math.pi / 2
    expected = 2 + 4 * a * a + 2 * a
    assert checker.g2o_cost(graph, q, t) == pytest.approx(expected, rel=1e-14)
    assert float(cost_in_integers(graph, q, t)) == pytest.approx(expected, rel=1e-14)


def test_a_spatial_cost_by_hand():
    """The quaternion (1, 1, 1, 1) / 2 where none was measured, of either sign and any norm."""
    Omega = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    Omega[0, 3] = Omega[3, 0] = 0.5
    graph, t = one_edge([0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0], Omega)
    t[1] = [1.0, 0.0, 0.0]
    for sign in (7.0, -0.25):
        q = np.array([[0.0, 0.0, 0.0, 1.0], [sign, sign, sign, sign]])
        expected = 1 + 3 + 15 / 4 + 0.5
        assert checker.g2o_cost(graph, q, t) == pytest.approx(expected, rel=1e-15)
        assert 0 <= cost_in_integers(graph, q, t) - Fraction(expected) < Fraction(1, 2**300)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_two_values_at_half_a_turn_the_larger_counts(sign):
    Omega = [[2, 0, 1], [0, 3, 0], [1, 0, 4]]
    graph, t = one_edge([1.0, 0.0], [0.0, 0.0], Omega)
    t[1] = [sign, 0.0]
    expected = 2 + 4 * math.pi**2 + 2 * math.pi
    q = np.array([[1.0, 0.0], [0.0, 1.0]])
    assert checker.g2o_cost(graph, q, t) == pytest.approx(expected)
    assert float(cost_in_integers(graph, q, t)) == pytest.approx(expected)
    Omega = np.eye(6)
    Omega[0, 3] = Omega[3, 0] = 0.5
    graph, t = one_edge([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0], Omega)
    t[1] = [sign, 0.0, 0.0]
    q = np.array([[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    assert checker.g2o_cost(graph, q, t) == math.nextafter(3.0, 4.0)
    assert 0 <= cost_in_integers(graph, q, t) - 3 < Fraction(1, 2**300)


# --- Minorants


def minorants_of(edges):
    """The package's minorants at the edges' residuals; zeros where there are none."""
    v, Q = rounded(edges)
    found = edges.cost.minorants(v, Q)
    d, exist = edges.cost.graph.d, found.exist
    kappa = np.linalg.norm(found.N, axis=(1, 2)) / math.sqrt(d)
    given = checker.EdgeBounds(
        found.tau, found.b, kappa, found.N, found.touching, found.constant - 2 * d * kappa
    )
    shaped = [exist.reshape(-1, *[1] * (x.ndim - 1)) for x in given]
    return exist, checker.EdgeBounds(
        *(np.where(s, x, 0.0) for s, x in zip(shaped, given, strict=True))
    )


def weights_of(graph, given):
    d = graph.t.shape[1]
    return np.abs(given.constants) + 2 * d * np.abs(given.kappa) + np.abs(graph.information).max()


def raised(graph, given, share=1.0, holds=checker.minorants_hold):
    """The minorants with the largest constants that a checker accepts; which there are."""
    low = given.constants - share * weights_of(graph, given)
    high = given.constants + share * weights_of(graph, given)
    held = holds(graph, given._replace(constants=low))
    for _ in range(70):
        middle = 0.5 * (low + high)
        accepted = holds(graph, given._replace(constants=middle))
        low, high = np.where(accepted, middle, low), np.where(accepted, high, middle)
    return held, given._replace(constants=low)


def lowest(graph, given, e):
    """(y, turn) where f - m of an edge is about smallest, by samples of the turn."""
    d, Omega, rng = graph.t.shape[1], graph.information[e], rng_of(e)
    R = np.array(checker.rotations(graph.q[[e]])[0] / 2**checker.POINT, dtype=float)
    target = R.T @ (given.arms[e] - graph.t[e])
    T, P, W = Omega[:d, :d], Omega[:d, d:], Omega[d:, d:]
    A = T - given.tau[e] * np.eye(d)
    N = R.T @ given.couplings[e]

    def at(turn):
        if d == 2:
            x, E = turn, so.exp(turn[None])[0]
        else:
            x, E = turn[1:], quaternion_matrix(turn)
        y = -np.linalg.solve(A, P @ x + given.tau[e] * target)
        rest = y - target
        value = y @ T @ y + 2 * y @ P @ x + x @ W @ x - given.tau[e] * rest @ rest
        return value + 2 * np.sum(N * E), y

    best, spread = turns(rng, 1, d, True)[0], 1.0
    for _ in range(12):
        near = best + spread * rng.standard_normal((60, len(best)))
        if spread == 1.0:
            near = turns(rng, 200, d, True)
        if d == 3:
            near /= np.linalg.norm(near, axis=1)[:, None]
            near = near[near[:, 0] >= 0.0]
        else:
            near = near[np.abs(near[:, 0]) <= np.pi]
        best = min([best, *near], key=lambda turn: at(turn)[0])
        spread *= 0.2
    return at(best)[1], best


def quaternion_matrix(q):
    w, x = q[0], q[1:]
    cross = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
    return (w * w - x @ x) * np.eye(3) + 2 * np.outer(x, x) + 2 * w * cross


def excess(graph, given, edges, e, y, turn):
    """f - m of an edge at a point, without rounding."""
    d = graph.t.shape[1]
    v, Q, rest = edges.point(e, R=rotation(graph.q[e]), y=y, turn=turn)
    arm = [a - b for a, b in zip(v, balls(given.arms[e]), strict=True)]
    N = balls(given.couplings[e])
    m = arb(float(given.tau[e])) * inner(arm, arm) + arb(float(given.constants[e]))
    m += 2 * d * arb(float(given.kappa[e])) - 2 * sum(map(inner, N, Q))
    return quadratic(balls(graph.information[e]), rest) - m


def assert_below(graph, given, edges, e, rng):
    points = [lowest(graph, given, e), (edges.y[e], edges.turn[e])]
    points += [(3 * rng.standard_normal(len(edges.y[e])), turns(rng, 1, graph.t.shape[1], True)[0])]
    for y, turn in points:
        assert excess(graph, given, edges, e, y, turn) > 0
    return excess(graph, given, edges, e, *points[1])


@given(seeds, dimensions, st.booleans(), st.sampled_from([10.0, 1e6]))
@few
def test_accepted_constants_are_below_the_cost_by_little(seed, d, far, condition):
    rng = rng_of(seed)
    edges = random_edges(rng, 6, d, far=far, condition=condition)
    graph = graph_of(edges.cost)
    exist, given = minorants_of(edges)
    accepted = checker.minorants_hold(graph, given)
    assert accepted[exist].all()
    held, best = raised(graph, given, 1e-3)
    exact, sharp = raised(graph, given, 1e-3, held_in_integers)
    assert held[exist].all()
    assert exact[exist].all()
    assert (best.constants <= sharp.constants)[exist].all()
    for e in np.flatnonzero(exist):
        left = assert_below(graph, sharp, edges, e, rng)
        left += arb(sharp.constants[e]) - arb(best.constants[e])
        assert left < 1e-9 * weights_of(graph, best)[e]  # they touch where the package says


def forged(rng, given):
    """One array changed: a number scaled, shifted, negated, or replaced by another's."""
    name = rng.choice(["tau", "arms", "couplings", "touching", "kappa"])
    array = getattr(given, name).copy()
    k = rng.integers(array.size)
    change = rng.integers(4)
    if change == 0:
        array.flat[k] *= rng.choice([-1.0, 0.0, 0.5, 1.0 + 1e-9, 2.0, 1e6])
    elif change == 1:
        array.flat[k] += rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-12, 1)
    elif change == 2:
        array = array[rng.permutation(len(array))]
    else:
        array = array + 10.0 ** rng.uniform(-9, 0) * rng.standard_normal(array.shape)
    return given._replace(**{name: array})


@given(seeds, dimensions)
@settings(max_examples=25, deadline=None)
def test_forged_minorants_are_refused_or_true(seed, d):
    rng = rng_of(seed)
    edges = random_edges(rng, 4, d, far=False)
    graph = graph_of(edges.cost)
    given = minorants_of(edges)[1]
    other = forged(rng, given)
    held, best = raised(graph, other)
    exact, sharp = raised(graph, other, holds=held_in_integers)
    assert not (held & ~exact).any()
    assert (best.constants <= sharp.constants)[held].all()
    for e in np.flatnonzero(exact):
        assert_below(graph, sharp, edges, e, rng)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("k", [-300, 0, 300])
def test_the_scale_of_the_weights_changes_no_verdict(d, k):
    edges = random_edges(rng_of(7), 8, d, far=False)
    graph = graph_of(edges.cost)
    exist, given = minorants_of(edges)
    scaled = {n: np.ldexp(getattr(given, n), k) for n in ("tau", "kappa", "couplings", "constants")}
    scaled["touching"] = given.touching.copy()
    if d == 3:
        scaled["touching"][:, 4] = np.ldexp(given.touching[:, 4], k)
    other = graph._replace(information=np.ldexp(graph.information, k))
    assert exist.any()
    for share in (-1e-14, 1e-15, 1e-14, 1e-13):
        moved = given._replace(constants=given.constants + share * weights_of(graph, given))
        constants = np.ldexp(moved.constants, k)
        held = checker.minorants_hold(other, given._replace(**scaled | {"constants": constants}))
        assert np.array_equal(held, checker.minorants_hold(graph, moved))
    lowest = np.ldexp(given.constants - weights_of(graph, given), k)
    low = given._replace(**scaled | {"constants": lowest})
    assert held_in_integers(other, low)[exist].all()


@pytest.mark.parametrize("d", [2, 3])
def test_indefinite_information_is_refused(d):
    edges = random_edges(rng_of(2), 5, d, far=False, cross=0.0)
    graph = graph_of(edges.cost)
    exist, given = minorants_of(edges)
    assert exist.all()
    lower = given._replace(constants=given.constants - weights_of(graph, given))
    for entry in ((-1, -1), (0, 0)):
        information = graph.information.copy()
        information[2][entry] *= -1.0
        for holds in (checker.minorants_hold, held_in_integers):
            held = holds(graph._replace(information=information), lower)
            assert held.tolist() == [True, True, False, True, True]
    # All of the weight of a translation, or more, leaves nothing for the rest.
    for more in (1.0 + 1e-12, 3.0):
        tau = given.tau.copy()
        tau[1] = more * np.linalg.eigvalsh(graph.information[1, :d, :d])[0]
        assert not checker.minorants_hold(graph, lower._replace(tau=tau))[1]
        assert not held_in_integers(graph, lower._replace(tau=tau))[1]


def planar_holds(*numbers):
    """The checker's verdict on one edge."""
    return bool(checker._planar_hold(*(np.array([x], dtype=object) for x in numbers))[0])


@pytest.mark.parametrize(
    "touching",
    [[-1e-3], [3.15], [4.5], [7.0], [1e300], [1e-300], [math.pi], [3.5]],
)
def test_planar_angles_that_touch_nowhere_are_no_reason_to_believe(touching):
    edges = random_edges(rng_of(3), 3, 2, far=False)
    graph = graph_of(edges.cost)
    exist, given = minorants_of(edges)
    for holds in (checker.minorants_hold, held_in_integers):
        held, best = raised(graph, given._replace(touching=np.array([touching] * 3)), holds=holds)
        if not 0.0 <= touching[0] < math.pi or touching == [1e-300]:
            assert held.tolist() == [touching == [1e-300]] * 3 or touching == [math.pi]
        for e in np.flatnonzero(held & exist):
            assert_below(graph, best, edges, e, rng_of(e))


@pytest.mark.parametrize(
    ("k", "q0", "accepted"),
    [
        (1.0, [1.0, 0.0, 0.0, 0.0], True),
        (0.999, [1.0, 0.0, 0.0, 0.0], False),  # |l| = 1
        (1e9, [1.0, 0.0, 0.0, 0.0], False),  # the larger, the less is left
        (1.0, [-1.0, 0.0, 0.0, 0.0], False),
        (1.0, [1.0, 1e-9, 0.0, 0.0], False),
        (1.0, [0.0, 0.0, 0.0, 0.0], True),
        (-1.0, [1.0, 0.0, 0.0, 0.0], False),
        (10.0, [0.6, 0.75, 0.0, 0.0], True),  # 4 is enough
        (3.99, [0.6, 0.75, 0.0, 0.0], False),
        (4.01, [0.6, 0.75, 0.0, 0.0], True),
        (10.0, [0.6, 0.81, 0.0, 0.0], False),  # longer than 1
        (1.0, [0.6, -0.75, 0.0, 0.0], True),
    ],
)
def test_slopes_are_steep_enough(k, q0, accepted):
    # With T = 2, tau = 1, y' = (-1, 0, 0) and P = e1 e1^T / 2: l = -2 P^T y' = e1.
    Omega = np.diag([2.0, 2.0, 2.0, 50.0, 50.0, 50.0])
    Omega[0, 3] = Omega[3, 0] = 0.5
    graph, _ = one_edge([0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0], Omega)
    given = checker.EdgeBounds(
        np.ones(1),
        np.array([[-1.0, 0.0, 0.0]]),
        np.zeros(1),
        np.zeros((1, 3, 3)),
        np.array([[*q0, k]]),
        np.array([-100.0]),
    )
    assert checker.minorants_hold(graph, given).tolist() == [accepted]
    assert held_in_integers(graph, given).tolist() == [accepted]


# --- Rounding to units, where a unit is not small


def largest(accepts, low, high):
    """The largest integer that is accepted, None if the lowest is not."""
    if not accepts(low):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if accepts(middle) else (low, middle)
    return low


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_planar_minima_in_whole_units(seed):
    rng = rng_of(seed)
    s, u, v = (int(x) for x in rng.integers((1, -60, -60), (60, 60, 60)))
    h, alpha = rng.uniform(-7.0, 7.0), rng.choice([0.0, rng.uniform(0.0, 3.0)])
    angles = [int(x * 2**60) << (checker.FINE - 60) for x in (h, alpha)]
    found = largest(
        lambda wanted: planar_holds(s, angles[0], u, v, angles[1], wanted), -(10**5), 10**5
    )
    assert found is not None
    x = np.linspace(-16.0, 16.0, 20001)
    lowest = min(
        (a * (x + h) ** 2 + 2 * b * np.cos(x) + 2 * c * np.sin(x)).min()
        for a in (s, s + 0.999)
        for b in (u, u + 1.999)
        for c in (v - 0.999, v + 0.999)
    )
    assert found <= lowest + 1e-3


@given(seeds)
@settings(max_examples=40, deadline=None)
def test_spatial_minima_in_whole_units(seed):
    rng = rng_of(seed)
    S, N = rng.integers(0, 30, (3, 3)), rng.integers(-30, 30, (3, 3))
    S, linear = S + S.T, rng.integers(-15, 15, 3)
    q0 = turns(rng, 1, 3, True)[0] * rng.uniform(0.0, 0.99)
    k = float(rng.integers(0, 200))
    whole = [np.array(A, dtype=object)[None] for A in (S, linear, N)]
    touching = np.array([[*q0, k]])
    found = largest(
        lambda wanted: checker._spatial_hold(
            *whole, touching, np.array([wanted], dtype=object), 0
        ).item(),
        -(10**4),
        10**4,
    )
    if found is None:
        assert k < np.linalg.norm(k * q0[1:] + linear) + 1e-9
        return
    assert k >= np.linalg.norm(k * q0[1:] + linear) - 1e-9
    lowest = math.inf
    for _ in range(20):
        more = np.triu(rng.random((3, 3)) < 0.5) * 0.999
        S_, N_ = S + more + np.triu(more, 1).T, N + 0.999 * (rng.random((3, 3)) < 0.5)
        l_ = linear + 0.999 * (rng.random(3) < 0.5)
        for q in turns(rng, 200, 3, True):
            x = q[1:]
            value = x @ S_ @ x + l_ @ x + 2 * np.sum(N_ * quaternion_matrix(q))
            lowest = min(lowest, value)
    assert found <= lowest


@pytest.mark.parametrize(
    "numbers",
    [
        {"h": 8 << checker.FINE},
        {"h": -(8 << checker.FINE)},
        {"alpha": 4 << checker.FINE},
        {"alpha": -1},
        {"s": 1 << 200},
        {"u": 1 << 200},
        {"v": -(1 << 200)},
        {"alpha": int(math.pi * 2**52) << (checker.FINE - 52)},
        {"alpha": (int(math.pi * 2**52) + 1) << (checker.FINE - 52)},
        {"alpha": checker.OFF},
    ],
    ids=str,
)
def test_numbers_out_of_range_are_refused(numbers):
    usual = {"s": 1 << 160, "h": 0, "u": 0, "v": 0, "alpha": 0}
    lowest = -(1 << 300)
    assert planar_holds(*usual.values(), lowest)
    near_pi = numbers.get("alpha") == int(math.pi * 2**52) << (checker.FINE - 52)
    assert planar_holds(*(usual | numbers).values(), lowest) == near_pi


# --- Definiteness


@pytest.mark.parametrize("rig", [None, "identity", "huge", "nan"])
@given(seeds, st.integers(1, 7), st.sampled_from([-900, -60, 0, 60, 900]))
@few
def test_what_doubles_find_definite_is_definite(rig, seed, k, exponent):
    """With eigenvalues down to zero and below, and whatever a factorization returns."""
    rng = rng_of(seed)
    Q = np.linalg.qr(rng.standard_normal((20, k, k)))[0]
    smallest = rng.choice([1.0, 1e-6, 1e-9, 1e-12, 1e-16, 0.0, -1e-16, -1e-9], 20)
    eigenvalues = np.concatenate([smallest[:, None], np.ones((20, k - 1))], axis=1)
    A = np.einsum("mab,mb,mcb->mac", Q, eigenvalues, Q)
    A = (A + np.swapaxes(A, 1, 2)) * 10.0 ** rng.uniform(-8, 8, (20, 1, k))
    A = np.tril(A) + np.swapaxes(np.tril(A, -1), 1, 2)
    exact, _ = checker.integers(A)
    exact = exact << exponent if exponent > 0 else exact * (1 << -exponent)
    made_up = {
        "identity": lambda M: np.eye(k) + 0.0 * M,
        "huge": lambda M: 1e200 * np.eye(k) + 0.0 * M,
        "nan": lambda M: np.full(M.shape, np.nan),
    }
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        if rig:
            patch.setattr(np.linalg, "cholesky", made_up[rig])
        found = checker._well_definite(exact)
    wanted = np.array([is_definite(M.tolist()) for M in exact])
    assert not (found & ~wanted).any()
    assert (checker._definite(exact) == wanted).all()


def is_definite(A):
    """By Gaussian elimination in fractions."""
    A = [[Fraction(x) for x in row] for row in A]
    while A:
        (pivot, *row), *below = A
        if pivot <= 0:
            return False
        A = [[x - r[0] * y / pivot for x, y in zip(r[1:], row, strict=True)] for r in below]
    return True


# --- The certificate matrix of couplings


@given(seeds, dimensions)
@few
def test_couplings_enter_the_matrix_exactly(seed, d):
    rng, n = rng_of(seed), 4
    i, j = strategies.random_edges(rng, n, 4).T
    m = len(i)
    N = rng.standard_normal((m, d, d)) * 10.0 ** rng.uniform(-6, 1, (m, 1, 1))
    b, tau = rng.standard_normal((m, d)), rng.uniform(0.5, 2.0, m)
    graph = checker.Graph(n, i, j, None, b, np.full(m, 100.0), tau, N=N)
    multipliers = rng.standard_normal((n, d * (d + 1) // 2))
    q, t = np.ones((n, 2 * d - 2)), np.zeros((n, d))
    proof = checker.Proof(q, t, multipliers, np.arange(n), np.zeros(n * (d + 1)), 0, 0)
    blocks = checker.certificate_matrix(graph, proof)
    size = d + 1
    exact = {}

    def add(p, a, r, c, value):
        exact[p * size + a, r * size + c] = exact.get((p * size + a, r * size + c), 0) + value

    for e in range(m):
        ends = [(j[e], 0, Fraction(1)), (i[e], 0, Fraction(-1))]
        ends += [(i[e], 1 + a, -Fraction(b[e, a])) for a in range(d)]
        for p, a, x in ends:
            for r, c, y in ends:
                add(p, a, r, c, Fraction(tau[e]) * x * y)
        for a in range(d):
            add(i[e], 1 + a, i[e], 1 + a, Fraction(100))
            add(j[e], 1 + a, j[e], 1 + a, Fraction(100))
            for c in range(d):
                add(i[e], 1 + a, j[e], 1 + c, -Fraction(N[e, a, c]))
                add(j[e], 1 + c, i[e], 1 + a, -Fraction(N[e, a, c]))
    for p in range(n):
        for k, (a, c) in enumerate(zip(*np.triu_indices(d), strict=True)):
            add(p, 1 + a, p, 1 + c, -Fraction(multipliers[p, k]))
            if a != c:
                add(p, 1 + c, p, 1 + a, -Fraction(multipliers[p, k]))
    normal = math.frexp(100.0)[1]

    def assert_block(p, r, high, low):
        for a in range(size):
            for c in range(size):
                scale = int(blocks.scales[p, a] + blocks.scales[r, c]) - normal
                pinned = {(p, a) == (0, 0), (r, c) == (0, 0)} == {True, False}
                wanted = 0 if pinned else exact.get((p * size + a, r * size + c), 0)
                wanted *= Fraction(2) ** scale
                found = Fraction(float(high[a, c])) + Fraction(float(low[a, c]))
                assert abs(found - wanted) < Fraction(1, 2**100)

    for p in range(n):
        assert_block(p, p, blocks.high[0][p], blocks.low[0][p])
    for k, (p, r) in enumerate(blocks.pairs):
        assert_block(p, r, blocks.high[1][k], blocks.low[1][k])


def test_planar_and_spatial_rotations_are_those_of_the_residuals():
    """The test's own conventions: a turn about z in space is the turn in the plane."""
    angle = arb(0.3)
    flat, turned = planar(angle), spatial([(angle / 2).cos(), arb(0), arb(0), (angle / 2).sin()])
    for a in range(2):
        for b in range(2):
            assert abs(flat[a][b] - turned[a][b]) < 1e-80

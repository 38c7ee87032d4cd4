"""The checker's numbers against rational arithmetic: rotations, weights, costs, blocks."""

import math
from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, random_edges, rng_of, seeds

from certpgo import checker

ONE = 1 << checker.POINT


def fractions(x):
    return [Fraction(float(value)) for value in np.ravel(x)]


# --- Doubles as integers, and rotations


finite = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(finite | st.just(0.0), min_size=1, max_size=5))
def test_integers_are_the_doubles_exactly(values):
    N, e = checker.integers(np.array(values))
    assert [Fraction(n) / Fraction(2) ** e for n in N] == fractions(values)


def test_only_finite_doubles_are_integers():
    for bad in (math.inf, -math.inf, math.nan):
        with pytest.raises(checker.Refused, match="finite"):
            checker.integers(np.array([1.0, bad]))


@given(seeds, dimensions, st.sampled_from([-500, -3, 0, 500]))
@settings(max_examples=50)
def test_rotations_are_rounded_down_by_less_than_a_unit(seed, d, exponent):
    q = np.ldexp(rng_of(seed).standard_normal((4, 2 if d == 2 else 4)), exponent)
    q[0] = np.roll([0.5, *[0.0] * (q.shape[1] - 1)], seed % q.shape[1])
    for row, R in zip(q, checker.rotations(q), strict=True):
        exact = np.ravel(proofs.exact_rotation(row))
        assert all(0 <= x * ONE - N < 1 for x, N in zip(exact, R.ravel(), strict=True))


# --- Weights


def harmonic(upper, halves):
    """size / tr(A^-1) / halves in rationals, None where A is not positive definite."""
    size = {1: 1, 3: 2, 6: 3}[len(upper)]
    A = [[Fraction(0)] * size for _ in range(size)]
    for (a, b), x in zip(zip(*np.triu_indices(size), strict=True), upper, strict=True):
        A[a][b] = A[b][a] = Fraction(x)
    if not proofs.is_positive_semidefinite(A):
        return None
    inverse = [[Fraction(int(a == b)) for b in range(size)] for a in range(size)]
    for k in range(size):
        if A[k][k] == 0:
            return None
        inverse[k] = [x / A[k][k] for x in inverse[k]]
        A[k] = [x / A[k][k] for x in A[k]]
        for r in set(range(size)) - {k}:
            inverse[r] = [x - A[r][k] * y for x, y in zip(inverse[r], inverse[k], strict=True)]
            A[r] = [x - A[r][k] * y for x, y in zip(A[r], A[k], strict=True)]
    return Fraction(size) / sum(inverse[k][k] for k in range(size)) / halves


word = st.sampled_from(["1", "-2.5", "0", "7E1", "30", "+4.25e1", "11.125", "100e-1", ".5", "9."])
definite = st.sampled_from(["100", "2.5e2", "40.125", "3", "7.5E+1", "99.e0"])


@given(st.lists(word, min_size=6, max_size=6), st.lists(definite, min_size=3, max_size=3))
def test_harmonic_means_are_rounded_once(words, large):
    words[0], words[3], words[5] = large
    for upper, halves in ((words[:1], 1), (words[3:4], 2), ([*words[:2], words[3]], 1), (words, 2)):
        exact = harmonic(upper, halves)
        encoded = [w.encode() for w in upper]
        if exact is None:
            with pytest.raises(ValueError, match="positive definite"):
                checker.harmonic_mean(encoded, halves)
        else:
            assert checker.harmonic_mean(encoded, halves) == float(exact)


@pytest.mark.parametrize("power", [-300, -30, 0, 30, 300])
def test_harmonic_means_of_any_power(power):
    words = [f"{x}e{power}" for x in ("3.5", "1", ".25", "7", "-1", "2")]
    exact = harmonic(words, 2)
    assert checker.harmonic_mean([w.encode() for w in words], 2) == float(exact)
    mixed = [b"3", b"0", b"5e%d" % power]
    assert checker.harmonic_mean(mixed, 1) == float(harmonic([w.decode() for w in mixed], 1))


@pytest.mark.parametrize(
    "words",
    ["0", "1 1 1", "0 0 1", "1 0 0", "1 0 0 1 1 1", "1 0 0 1 0 0", "0 0 0 1 0 1", "1 1 0 1 0 1"],
)
def test_singular_information_is_refused(words):
    with pytest.raises(ValueError, match="positive definite"):
        checker.harmonic_mean([w.encode() for w in words.split()], 1)


def test_powers_of_information_have_a_range():
    for inside in ("1e-400", "0.01e-398", "1e400", "1e+400"):
        words = [inside, "0", "1"]
        exact = harmonic(words, 1)
        assert checker.harmonic_mean([w.encode() for w in words], 1) == float(exact)
    for outside in (b"1e401", b"1e-401", b"0.1e-400", b"1" + b"0" * 3 + b"e401"):
        with pytest.raises(ValueError, match="range"):
            checker.harmonic_mean([outside], 1)


def test_2d_weights_take_the_blocks_of_translation_and_angle():
    # x, y and theta: xx xy xt yy yt tt.
    kappa, tau = checker.weights((b"2", b"0.5", b"9", b"3", b"9", b"7"), checker.harmonic_mean)
    assert kappa == 7.0
    assert tau == float(harmonic(["2", "0.5", "3"], 1))


def test_3d_weights_take_the_blocks_of_translation_and_rotation():
    upper = np.array([[2, 1, 0, 9, 9, 9], [0, 3, 1, 9, 9, 9], [0, 0, 4, 9, 9, 9]])
    lower = np.array([[0, 0, 0, 5, 1, 2], [0, 0, 0, 0, 6, 1], [0, 0, 0, 0, 0, 7]])
    words = [str(x) for x in np.vstack([upper, lower])[np.triu_indices(6)]]
    kappa, tau = checker.weights(tuple(w.encode() for w in words), checker.harmonic_mean)
    assert tau == float(harmonic(["2", "1", "0", "3", "1", "4"], 1))
    assert kappa == float(harmonic(["5", "1", "2", "6", "1", "7"], 2))


# --- Costs


def quaternions(rng, k, d):
    return rng.standard_normal((k, 2 if d == 2 else 4))


def graph_of(edges, n, measured, t, kappa, tau):
    i, j = np.asarray(edges).T
    return checker.Graph(n, i, j, checker.rotations(measured), t, kappa, tau, q=measured)


def exact_measured(measured):
    return [proofs.exact_rotation(row) for row in measured]


@given(seeds, dimensions, st.booleans(), st.sampled_from([-150, -20, 0, 20, 150]))
@settings(max_examples=40)
def test_upper_bounds_are_costs_rounded_up(seed, d, poses, exponent):
    rng, n = rng_of(seed), 4
    edges = random_edges(rng, n, 3)
    m = len(edges)
    measured, q = quaternions(rng, m, d), quaternions(rng, n, d)
    t, step = (np.ldexp(rng.standard_normal((k, d)), exponent) for k in (n, m))
    kappa, tau = np.ldexp(rng.uniform(1, 2, (2, m)), rng.integers(-60, 60, (2, m)))
    graph = graph_of(edges, n, measured, step, kappa, tau)
    at = t if poses else None
    cost = proofs.exact_cost(graph, exact_measured(measured), q, at)
    upper = Fraction(checker.upper_bound(graph, q, at))
    floor = sum(fractions(kappa) + fractions(tau)) * Fraction(1, 2**200)  # terms are rounded up
    assert cost < upper <= cost * (1 + Fraction(1, 2**50)) + floor


@given(seeds, dimensions)
@settings(max_examples=20)
def test_where_nothing_is_left_the_upper_bound_is_next_to_nothing(seed, d):
    """A measurement that the estimate explains."""
    q = quaternions(rng_of(seed), 2, d)
    still = np.zeros((1, 2 if d == 2 else 4))
    still[0, 0 if d == 2 else 3] = 1.0
    graph = graph_of([[0, 1]], 2, still, np.zeros((1, d)), np.ones(1), np.ones(1))
    upper = checker.upper_bound(graph, q[[0, 0]], np.zeros((2, d)))
    assert upper == 5e-324


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("power", [40, 150])
def test_long_arms_do_not_lose_what_the_truncated_rotation_turns_them_by(power, sign):
    """R = [3 -4; 4 3] / 5 turns (5 2^power, 5 2^-10) into (3, 4) 2^power and what counts."""
    q = np.array([[2.0, 1.0], [2.0, 1.0]])
    step = np.array([[5.0 * 2.0**power, sign * 5.0 * 2.0**-10]])
    graph = graph_of([[0, 1]], 2, np.array([[1.0, 0.0]]), step, np.ones(1), np.ones(1))
    for t in ([[0.0, 0.0], [3.0, 4.0]], [[-3.0, -4.0], [0.0, 0.0]]):
        at = np.array(t) * 2.0**power
        cost = proofs.exact_cost(graph, exact_measured([[1.0, 0.0]]), q, at)
        assert 0 < cost < 2.0**-15
        upper = Fraction(checker.upper_bound(graph, q, at))
        assert cost < upper <= (1 + Fraction(1, 2**50)) * cost


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("power", [-60, -80, -99])
def test_what_is_below_100_bits_counts(power, sign):
    """A translation of 2^power and 2^-103 either way that nothing explains."""
    still, x = np.array([[1.0, 0.0], [1.0, 0.0]]), 2.0**power + 2.0**-103
    graph = graph_of([[0, 1]], 2, still[:1], np.zeros((1, 2)), np.array([2.0**-300]), np.ones(1))
    upper = Fraction(checker.upper_bound(graph, still, np.array([[0.0, 0.0], [sign * x, 0.0]])))
    assert Fraction(x) ** 2 < upper <= Fraction(x) ** 2 * (1 + Fraction(1, 2**50))


@given(st.integers(0, 2**300), st.integers(-300, 300))
def test_integers_are_rounded_up_to_doubles(n, e):
    up, exact = checker._rounded_up(n, e), Fraction(n) / Fraction(2) ** e
    assert exact < Fraction(up) <= exact * (1 + Fraction(1, 2**51)) + Fraction(1, 2**1074)


@given(st.floats(1e-280, 1e300), st.floats(0.0, 1.0), st.integers(0, 4))
def test_relative_gaps_are_rounded_up(upper, part, ulps):
    for lower in (upper * part, upper * (1.0 - ulps * 2.0**-53)):
        exact = 1 - Fraction(lower) / Fraction(upper)
        gap = Fraction(checker.Answer(upper, lower).relative_gap)
        assert exact <= gap <= exact * (1 + Fraction(1, 2**50))


# --- The certificate matrix


def block_of(parts, k):
    """The sum of the high and low parts of block k, exactly."""
    return [a + b for a, b in zip(fractions(parts[0][k]), fractions(parts[1][k]), strict=True)]


@given(seeds, dimensions, st.booleans(), st.sampled_from([0, 20]), st.integers(-2, 2))
@settings(max_examples=40)
def test_blocks_are_the_certificate_matrix_to_100_bits(seed, d, poses, spread, exponent):
    rng, n = rng_of(seed), 4
    b = d + poses
    edges = random_edges(rng, n, 5)
    m = len(edges)
    measured = quaternions(rng, m, d)
    kappa, tau = np.ldexp(rng.uniform(1, 2, (2, m)), rng.integers(-spread, spread + 1, (2, m)))
    t = np.ldexp(rng.standard_normal((m, d)), [0, -50, -150][seed % 3])
    graph = graph_of(edges, n, measured, t, kappa, tau)
    pin = int(rng.integers(n)) if poses else 0
    proof = checker.Proof(
        q=quaternions(rng, n, d),
        t=np.zeros((n, d)) if poses else None,
        multipliers=-rng.uniform(0, 2.0**-spread, (n, d * (d + 1) // 2)) / 8,
        order=np.arange(n),
        delta=np.zeros(n * b),
        pin=pin,
        exponent=exponent,
    )
    blocks = checker.certificate_matrix(graph, proof)
    exact = proofs.exact_matrix(graph, exact_measured(measured), proof.multipliers, poses)
    N, unit = n * b, Fraction(2) ** math.frexp(float(kappa.max()))[1]
    A = [[Fraction(0)] * N for _ in range(N)]
    for row, values in enumerate(exact):
        A[row + poses][poses:] = values
    scales = [Fraction(2) ** int(s) for s in blocks.scales.ravel()]
    found = [[Fraction(0)] * N for _ in range(N)]
    for part, nodes in ((0, [(k, k) for k in range(n)]), (1, blocks.pairs.tolist())):
        for k, (p, q) in enumerate(nodes):
            sums = block_of((blocks.high[part], blocks.low[part]), k)
            for place, x in enumerate(sums):
                r, c = p * b + place // b, q * b + place % b
                found[r][c] = x
                found[c][r] = x if p < q else found[c][r]
    known = set(range(poses, N)) - ({pin * b} if poses else set())
    for r in range(N):
        assert Fraction(1, 4) <= found[r][r] < 1
        for c in range(N):
            if poses and pin * b in (r, c):
                assert r == c or found[r][c] == 0
            elif r in known and c in known:
                error = found[r][c] - A[r][c] * scales[r] * scales[c] / unit
                assert abs(error) < Fraction(1, 2**101)
    for high, low in zip(blocks.high, blocks.low, strict=True):
        assert np.array_equal(high * 4.0**checker.BITS, np.rint(high * 4.0**checker.BITS))
        assert np.abs(low).max(initial=0.0) <= 0.5 * 4.0**-checker.BITS
    weights = np.ldexp(1.0, -blocks.scales)
    weights[:, 0] *= 2.0**exponent
    assert np.array_equal(blocks.weights, weights)


@pytest.mark.parametrize(
    ("power", "passes"), [(-50, True), (-58, True), (-60, False), (-80, False)]
)
def test_what_was_truncated_must_not_be_magnified(power, passes):
    """Lam takes all of a weight of 1 and leaves 2^power: the rotation's 160 bits are to last.

    Scaled until what is left is about 1/2, they are off by 2^(-161 - power), to be below 2^-102.
    """
    edges, kappa = [[0, 1], [1, 2], [2, 0]], np.array([1.0, 2.0**power, 2.0**power])
    still = np.tile([1.0, 0.0], (3, 1))
    graph = graph_of(edges, 3, still, np.zeros((3, 2)), kappa, np.ones(3))
    Lam = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    proof = checker.Proof(still, None, Lam, np.arange(3), np.zeros(6), 0, 0)
    if passes:
        checker.certificate_matrix(graph, proof)
    else:
        with pytest.raises(checker.Refused, match="uneven"):
            checker.certificate_matrix(graph, proof)


@given(st.integers(-(2**60), 2**60), st.integers(-120, -58))
def test_parts_are_the_nearest_multiple_and_the_rest(entry, shift):
    high, low = checker._parts(np.array([entry], dtype=object), np.array([shift]))
    exact = Fraction(entry) * Fraction(2) ** shift
    step = Fraction(1, 4**checker.BITS)
    assert (Fraction(float(high[0])) / step).denominator == 1
    assert abs(exact - Fraction(float(high[0]))) <= step / 2
    assert abs(exact - Fraction(float(high[0])) - Fraction(float(low[0]))) < step / 2**52


# --- The order of elimination


@given(
    seeds,
    st.integers(2, 30),
    st.integers(0, 40),
    st.sampled_from([0, 3, 64]),
    st.sampled_from([1, 4, 128]),
)
def test_fronts_eliminate_every_node_and_hold_its_fill(seed, n, extra, allowance, widest):
    edges = np.sort(random_edges(rng_of(seed), n, extra), axis=1)
    pairs = np.unique(edges, axis=0)
    reach = [set() for _ in range(n)]
    for p, q in pairs.tolist():
        reach[p].add(q)
    for p in range(n):  # elimination, by the definition
        if reach[p]:
            reach[min(reach[p])] |= reach[p] - {min(reach[p])}
    found = checker.fronts(n, pairs, allowance, widest)
    assert all(len(front.pivots) <= widest for front in found)
    assert sorted(p for front in found for p in front.pivots) == list(range(n))
    parents = {}
    for k, front in enumerate(found):
        nodes = front.pivots + front.boundary
        assert nodes == sorted(set(nodes))
        # Nothing but the fill of the last pivot is passed on, and nothing of any pivot is missing.
        assert set(front.boundary) == reach[front.pivots[-1]]
        assert all(reach[p] <= set(nodes) for p in front.pivots)
        zeros = sum(len(nodes) - place - 1 - len(reach[p]) for place, p in enumerate(front.pivots))
        assert zeros <= sum(
            max(allowance, k * (len(nodes) - k) / 8) for k in range(1, len(front.pivots))
        )
        for child in front.children:
            assert child < k
            assert child not in parents
            parents[child] = k
            assert set(found[child].boundary) <= set(nodes)
    assert all((k in parents) == bool(front.boundary) for k, front in enumerate(found))

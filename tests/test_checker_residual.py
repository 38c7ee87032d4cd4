"""The checker's bounds on what a factor leaves, in exact arithmetic, whatever the factor is."""

import math
from fractions import Fraction
from functools import partial
from itertools import combinations

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import checker
from certpgo.certify.proof import exact_graph
from certpgo.objective.quadratic import Quadratic

U = 2.0**-53


def factored(blocks, order, delta, columns=None):
    """What `residual` finds, and its L in two parts (2, N, columns), in the order of elimination.

    ``columns`` are a function of the number of a front and the shape of its columns: another L.
    """
    stacks, parts = [], []
    own_stacks, own_factor, own_refined = checker.stacks, checker._factor, checker._refined

    def listed(*arguments):
        found, entries = own_stacks(*arguments)
        stacks.extend(found)
        return found, entries

    def factor(F, delta):
        if columns is None:
            return own_factor(F, delta)
        k, numbers = delta.shape[1], range(len(F))
        L = np.array([columns(len(parts) + number, F.shape[1:]) for number in numbers])
        return L, np.tile(np.eye(k), (len(F), 1, 1))

    def refined(H, G, delta, L, L1, inverse):
        L2 = L - L1 if columns else own_refined(H, G, delta, L, L1, inverse)
        parts.append((L1.copy(), L2.copy()))
        return L2

    n, b = blocks.weights.shape
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        patch.setattr(checker, "stacks", listed)
        patch.setattr(checker, "_factor", factor)
        patch.setattr(checker, "_refined", refined)
        found = checker.residual(blocks, order, delta)
    wide = []
    for stack, part in zip(stacks, parts, strict=False):
        rows = checker._rows(stack.nodes, b)
        for slot, own in enumerate(rows):
            wide.append(np.zeros((2, n * b + b, part[0].shape[2])))
            wide[-1][:, own] = np.stack(part)[:, slot]
    return found, np.concatenate(wide, axis=2)[:, : n * b]


def dense(blocks, order):
    """The high and the low part (2, N, N), in the order of elimination."""
    p, q, A = checker._in_order(blocks, order)
    places = (checker._rows(x[:, None], A.shape[2]) for x in (p, q))
    parts = checker._assembled([(np.zeros_like(p), *places, A)], 1, len(order) * A.shape[2])
    return np.concatenate(parts)


def margins(blocks, order, found, L):
    """By how much each row is more dominant than what `residual` found says; exact.

    (E_rr v_r - sum |E_rs| v_s) / v_r less (diagonal - needed), E being A - L L^T.
    """
    (A, a), (L, e) = (checker.integers(x) for x in (dense(blocks, order), L))
    unit = max(a, 2 * e)
    product = (L[0] + L[1]) @ (L[0] + L[1]).T
    E = ((A[0] + A[1]) << (unit - a)) - (product << (unit - 2 * e))
    v, _ = checker.integers(blocks.weights[order].ravel())
    own = np.diagonal(E).copy()
    np.fill_diagonal(E, 0)
    sums = own * v - abs(E) @ v
    rows = checker._rows(order, blocks.weights.shape[1])
    said = zip(found.diagonal[rows].tolist(), found.needed[rows].tolist(), strict=True)
    return [
        Fraction(int(s), int(w) << unit) - (Fraction(x) - Fraction(y))
        for s, w, (x, y) in zip(sums, v, said, strict=True)
    ]


def made(seed, d, poses, *, n=6, decades=0.0):
    """A random graph, its weights over decades, and a proof with multipliers -c I; its blocks."""
    rng = rng_of(seed)
    graph = pose_graph(rng, n, d)[0] if poses else rotation_graph(rng, n, d)[0]
    graph = exact_graph(Quadratic(graph))
    uneven = 10.0 ** rng.uniform(-decades / 2, decades / 2, (2, len(graph.i)))
    graph = graph._replace(kappa=graph.kappa * uneven[0], tau=graph.tau * uneven[1])
    on_diagonal = np.equal(*np.triu_indices(d))
    lower = -(10.0 ** rng.uniform(-12, 0)) * graph.kappa.min()
    proof = checker.Proof(
        q=np.eye(2 if d == 2 else 4)[np.zeros(graph.n, dtype=int)],
        t=np.zeros((graph.n, d)) if poses else None,
        multipliers=np.tile(lower * on_diagonal, (graph.n, 1)),
        order=rng.permutation(graph.n),
        delta=rng.uniform(0, 1e-14, graph.n * (d + poses)),
        pin=0,
        exponent=int(rng.integers(-5, 5)),
    )
    return graph, proof, checker.certificate_matrix(graph, proof)


@given(seeds, dimensions, st.booleans(), st.sampled_from([0.0, 6.0, 14.0]))
@settings(max_examples=40)
def test_rows_are_as_dominant_as_said(seed, d, poses, decades):
    _, proof, blocks = made(seed, d, poses, decades=decades)
    found, L = factored(blocks, proof.order, proof.delta)
    if found is None:
        assert decades > 6.0
        return
    assert min(margins(blocks, proof.order, found, L)) >= 0
    if decades == 0.0:  # and the factor is refined: less than a thousandth of a unit of rounding
        assert found.needed.max() < 1e-3 * U
        assert np.abs(found.diagonal - proof.delta).max() < 1e-3 * U


def test_parts_that_no_edge_connects():
    """A root is in one stack with fronts that pass something on."""
    high, between = np.full((4, 1, 1), 0.5), np.full((2, 1, 1), 0.25)
    blocks = by_hand(4, 1, [[0, 2], [1, 2]], high, None, between)
    found, L = factored(blocks, np.arange(4), np.full(4, 1e-12))
    assert (found.diagonal >= found.needed).all()
    assert min(margins(blocks, np.arange(4), found, L)) >= 0


@given(seeds, dimensions, st.booleans(), st.floats(-4, 4), st.sampled_from([0.0, 14.0]))
@settings(max_examples=60)
def test_rows_are_as_dominant_as_said_whatever_the_factor(seed, d, poses, scale, decades):
    _, proof, blocks = made(seed, d, poses, decades=decades)
    rng = rng_of(seed + 1)

    def columns(_, shape):
        return rng.standard_normal(shape) * 2.0 ** (scale + rng.uniform(-3, 3, shape))

    found, L = factored(blocks, proof.order, proof.delta, columns)
    norm = (L[0] ** 2).sum(axis=1).max()
    assert (found is None) == (norm + max(np.abs(x).max() for x in blocks.high) >= 4.0)
    if found is not None:
        assert min(margins(blocks, proof.order, found, L)) >= 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_stacks_of_unequal_fronts_are_as_dominant_as_said(seed):
    """Whatever the factor is, in rows that do not exist as well."""
    _, proof, blocks = made(seed, 2, seed % 2 == 0, n=24)
    n, rng = len(proof.order), rng_of(seed)
    p, q, _ = checker._in_order(blocks, proof.order)
    pairs = np.stack([p, q], axis=1)[p < q]
    found, _ = checker.stacks(checker.fronts(n, pairs), n, p, q)
    assert any((stack.nodes == n).any() for stack in found)
    members = np.concatenate([stack.members for stack in found])
    assert sorted(members.tolist()) == list(range(len(members)))

    def columns(_, shape):
        return rng.standard_normal(shape) * 0.05

    for own in (None, columns):
        residual, L = factored(blocks, proof.order, proof.delta, own)
        assert min(margins(blocks, proof.order, residual, L)) >= 0


def by_hand(n, b, pairs, high=None, low=None, between=None):
    """Blocks with zeros where nothing is given."""
    zeros, none = np.zeros((n, b, b)), np.zeros((len(pairs), b, b))
    high, low = (zeros if x is None else x for x in (high, low))
    between = none if between is None else between
    weights = np.ones((n, b))
    scales = np.zeros((n, b), dtype=np.intp)
    return checker.Blocks(
        np.array(pairs, dtype=np.intp).reshape(-1, 2), (high, between), (low, none), weights, scales
    )


def star(m):
    return [[k, m] for k in range(m)]


def lost(m, tree, entry, monkeypatch):
    """What the bound allows for, over rounding errors each of which is as large as can be.

    Nodes 0 ... m-1 are eliminated before node m, of which an entry of L L^T is large in the first
    column; each later one adds so little that it is lost when it is added to G. What is left of
    that entry is zero, as it is computed.
    """
    pairs = star(m)
    if tree == "chain":
        pairs = sorted(pairs + [[k, k + 1] for k in range(m - 1)])
        # Or else nodes would share fronts, and what they add in one product.
        monkeypatch.setattr(checker, "fronts", partial(checker.fronts, allowance=0))
    high, low = np.zeros((2, m + 1, 2, 2))
    high[:m] = np.eye(2) / 2.0
    first, later = {
        "diagonal": ((1.0 + 2.0**-26, 0.0), (0.99 * 2.0**-39, 0.0)),
        "across": ((1.0, 2.0**-26), (2.0**-25, 0.99 * 2.0**-54)),
    }[entry]
    high[m], low[m] = np.diag([1.5, 0.0]), np.diag([0.0, 2.0**-52])
    if entry == "diagonal":
        high[m, 0, 0], low[m] = 1.0 + 2.0**-25, np.diag([2.0**-52, 0.0])
    else:
        high[m, 0, 1] = high[m, 1, 0] = 2.0**-26
    counted = []

    def columns(number, shape):
        L = np.zeros(shape)
        if shape[0] > shape[1]:
            L[-2:, 0] = later if number else first
            counted.append(number)
        return L

    blocks, order = by_hand(m + 1, 2, pairs, high, low), np.arange(m + 1)
    found, L = factored(blocks, order, np.zeros(2 * m + 2), columns)
    assert m - 2 <= len(counted) <= m
    assert min(margins(blocks, order, found, L)) >= 0
    row, size = (2 * m, 2.0**-78) if entry == "diagonal" else (2 * m + 1, 2.0**-79)
    return found.needed[row] / (len(counted) * size)


@pytest.mark.parametrize("entry", ["diagonal", "across"])
@pytest.mark.parametrize("tree", ["siblings", "chain"])
def test_what_fronts_add_up_rounds_each_time(tree, entry, monkeypatch):
    # A bound less than half as large would be false.
    assert 2.0 < lost(100, tree, entry, monkeypatch) < 2.5


def test_needed_by_zeros():
    # A star: its centre shares the last front with one leaf.
    m, b = 50, 2
    blocks = by_hand(m + 1, b, star(m))
    found, _ = factored(
        blocks, np.arange(m + 1), np.zeros(b * m + b), lambda _, shape: np.zeros(shape)
    )
    reached = b * np.array([2] * m + [m + 1])
    count = np.array([1] * m + [m])  # fronts with a row
    expected = np.repeat((2.0**-100 + (2 * count + 4) * 2.0**-104) * reached, b)
    np.testing.assert_allclose(found.needed, expected, rtol=2e-6)
    assert (found.needed >= expected).all()
    assert not found.diagonal.any()


@pytest.mark.parametrize("smallest", [1e-15, 1e-13, 1e-10])
def test_factors_of_nearly_singular_matrices_are_refined(smallest):
    rng, k = rng_of(8), 12
    Q = np.linalg.qr(rng.standard_normal((k, k)))[0]
    eigenvalues = np.geomspace(0.5, 1.0, k)
    eigenvalues[0] = smallest
    A = Q * eigenvalues @ Q.T
    high = np.rint((A + A.T) * 2.0**49) * 2.0**-50
    delta, order = np.zeros(k), np.arange(1)
    low = 0.5 * (A + A.T) - high
    # Positive by more than the rounding of A.
    low += np.eye(k) * 2.0**-53
    found, L = factored(by_hand(1, k, [], high[None], low[None]), order, delta)
    assert found.needed.max() < 1e-3 * U
    assert np.abs(found.diagonal).max() < 1e-3 * U
    assert min(margins(by_hand(1, k, [], high[None], low[None]), order, found, L)) >= 0


@pytest.mark.parametrize("slack", [2.0**-54, 2.0**-58, 2.0**-62])
@pytest.mark.parametrize("seed", range(8))
def test_slacks_below_the_rounding_of_a_factor_are_enough(slack, seed):
    """However a machine rounds the pivots: singular matrices, exactly, and a little more."""
    rng, n, b = rng_of(seed), 6, 3
    B = rng.integers(-8, 9, (n * b, n * b - 3)) / 64.0
    A = (B @ B.T).reshape(n, b, n, b).transpose(0, 2, 1, 3)
    own, pairs = [(p, p) for p in range(n)], list(combinations(range(n), 2))
    more = np.tile(slack * np.eye(b), (n, 1, 1))
    diagonal, between = (np.array([A[p, q] for p, q in which]) for which in (own, pairs))
    blocks, order = by_hand(n, b, pairs, diagonal, more, between), np.arange(n)
    assert checker.is_positive_semidefinite(blocks, order, np.full(n * b, 0.5 * slack))
    blocks = by_hand(n, b, pairs, diagonal, -more, between)
    assert not checker.is_positive_semidefinite(blocks, order, np.zeros(n * b))


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.2, 0.3, 3.0, 1e3])
def test_a_step_of_any_size_ends_at_the_factor(size):
    rng, k = rng_of(9), 5
    target = rng.standard_normal((2 * k, k))
    target[:k] = np.tril(target[:k], -1) + 2.0 * np.eye(k)
    L = target.copy()
    L[:, -1] /= math.sqrt(1.0 + size)  # the last pivot is far off
    left = target @ target[:k].T - L @ L[:k].T
    stacked = left[None], 0.0 * left[None], np.zeros((1, k)), L[None], L[None]
    L2 = checker._refined(*stacked, np.linalg.inv(L[:k])[None])[0]
    missed = target @ target[:k].T - (L + L2) @ (L + L2)[:k].T
    assert np.abs(missed).max() < 1e-13 * (1.0 + size)


def test_no_step_where_there_is_no_factor():
    L, zeros = np.eye(3)[None], np.zeros((1, 3, 3))
    for left in (-np.ones((1, 3, 3)), -1e200 * L, np.full((1, 3, 3), np.nan)):
        with np.errstate(all="ignore"):
            L2 = checker._refined(left, zeros, zeros[0, :1], L, L, L.copy())
        assert not np.nan_to_num(L2).any()


@pytest.mark.parametrize("entry", ["diagonal", "between"])
def test_the_large_part_is_added_up_exactly_or_not_at_all(entry):
    # Entries and squares of rows may add up to less than 2^52 units of 2^-50.
    unit, order = 2.0**-50, np.arange(2)
    half = np.tile(np.eye(2) / 2.0, (2, 1, 1))
    for size, norm, expected in (
        (1.0, 3.0 - 2.0**-24, True),
        (1.0, 3.0, False),
        (3.0 - unit, 1.0, True),
        (3.0, 1.0, False),
        (0.5, 20.0, False),
        (20.0, 0.5, False),
    ):
        high, between = half.copy(), np.zeros((1, 2, 2))
        (high if entry == "diagonal" else between)[0, 0, 1] = size
        blocks = by_hand(2, 2, [[0, 1]], high, between=between)
        root = np.floor(np.sqrt(norm - 1.0) * 2.0**24) * 2.0**-24 if norm > 1.0 else 0.0
        L = np.zeros((4, 4))
        L[2, :2] = root, np.sqrt(norm) if norm <= 1.0 else 1.0
        if norm == 3.0:  # a sum of three squares
            L[2, :3] = 1.0
        found, _ = factored(blocks, order, np.zeros(4), lambda *_, L=L: L)
        assert (found is not None) == expected, (size, norm)


def test_second_parts_are_small_or_refused():
    blocks = by_hand(1, 2, [], np.eye(2)[None] / 2.0)
    for size, expected in ((0.999, True), (1.0, False), (np.inf, False), (np.nan, False)):
        with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
            patch.setattr(checker, "_refined", lambda *_, x=size: np.full((1, 2, 2), x))
            found = checker.residual(blocks, np.arange(1), np.zeros(2))
        assert (found is not None) == expected


@pytest.mark.parametrize("swap", [0, 1], ids=["diagonal", "across"])
def test_what_is_read_is_rounded_on_the_safe_side(swap):
    # L is zero: what rounds is high + low alone, in one entry a row.
    rng, k = rng_of(3), np.arange(40)
    high, low = np.zeros((2, 1, 40, 40))
    high[0, k, k ^ swap] = rng.integers(2**47, 2**50, 40)[k | swap] * 2.0**-50
    low[0, k, k ^ swap] = rng.uniform(-1, 1, 40)[k | swap] * 2.0**-51
    blocks, order = by_hand(1, 40, [], high, low), np.arange(1)
    found, L = factored(blocks, order, np.zeros(40), lambda _, shape: np.zeros(shape))
    assert min(margins(blocks, order, found, L)) >= 0


@pytest.mark.parametrize("shift", [0, -5, 30, -900])
def test_parts_are_the_nearest_multiples_and_what_is_left(shift):
    rng, half = rng_of(5), 1 << 61
    ties = [half - 1, half, half + 1, -half, -half - 1, 3 * half, -3 * half, 0, 1, -1]
    numbers = np.array(ties + [int(x) << 40 for x in rng.integers(-(2**62), 2**62, 20)], object)
    exact = [Fraction(int(x)) / (1 << 112) for x in numbers]
    stored = numbers << max(-shift, 0) if shift < 0 else numbers
    shifts = np.full(len(numbers), -112 - max(-shift, 0))
    if shift > 0:
        stored, shifts = numbers << 60, shifts - 60
        shifts[0], stored[0] = 1, 1  # one that is shifted to the left
        exact[0] = Fraction(2)
    high, low = checker._parts(stored, shifts)
    for x, a, b in zip(exact, high.tolist(), low.tolist(), strict=True):
        assert (a * 2.0**50).is_integer()
        assert abs(b) <= 2.0**-51
        assert abs(x - Fraction(a) - Fraction(b)) <= Fraction(1, 2**104)


@given(seeds, dimensions, st.booleans(), st.sampled_from([0.0, 10.0]))
@settings(max_examples=15)
def test_blocks_are_the_exact_matrix_scaled(seed, d, poses, decades):
    graph, proof, blocks = made(seed, d, poses, n=4, decades=decades)
    b = d + poses
    order = np.arange(graph.n)
    # Rotations of the measurements as they were read: to 2^-160, as are the checker's.
    measured = [[[Fraction(int(x), 2**checker.POINT) for x in r] for r in R] for R in graph.R]
    A = proofs.exact_matrix(graph, measured, proof.multipliers, poses)
    normal = int(np.frexp(graph.kappa.max())[1])
    scales = blocks.scales.ravel().tolist()[poses:]
    parts = dense(blocks, order)[:, poses:, poses:]
    for r, row in enumerate(A):
        for s, entry in enumerate(row):
            exact = entry * Fraction(2) ** (scales[r] + scales[s] - normal)
            if (r + poses) // b == (s + poses) // b:  # M has deg I where R_ij^T R_ij would be
                assert abs(exact - sum(map(Fraction, parts[:, r, s].tolist()))) <= 2.0**-99
            else:
                assert abs(exact - sum(map(Fraction, parts[:, r, s].tolist()))) <= 2.0**-101
            assert abs(parts[1, r, s]) <= 2.0**-51
            assert (parts[0, r, s] * 2.0**50).is_integer()

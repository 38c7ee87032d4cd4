"""The integer checker: its numbers, its proofs, and that it agrees with the first checker."""

import os
import re
import shutil
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction
from itertools import combinations
from pathlib import Path

import numpy as np
import proofs
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import checker
from certpgo import integer_checker as exact
from certpgo import integer_reader as reader
from certpgo.graph.components import rotations_alone
from certpgo.solve.proving import write_proof
from reports.studies.damaged_proofs import (
    compared,
    compared_reading,
    leading_minors_are_positive,
    outcomes,
)

ONE = exact.ONE
#: How many damaged proofs are compared; more on demand, as in `reports.studies.damaged_proofs`.
PROOFS = int(os.environ.get("CERTPGO_MUTATIONS", "160")) // 16
CLAIM = {"d": 2, "keep": "all", "rotation_information": "tangent", "kappa": None, "tau": None}
CLAIM |= {"cost": None, "landmarks": False, "priors": False, "origin": None, "maps": False}


def stored(x):
    """A double as the checker stores it."""
    return int(Fraction(float(x)) * ONE)


def made(seed, d, poses, n=5):
    rng = rng_of(seed)
    return pose_graph(rng, n, d)[0] if poses else rotation_graph(rng, n, d)[0]


@pytest.fixture
def small(tmp_path):
    """A small pose graph's file, and the arrays of its proof."""
    path, proof = proofs.proven(tmp_path, made(3, 3, True, n=6))
    return path, proofs.arrays_of(proof)


def tried(path, arrays):
    """What is proven by these arrays, repacked."""
    proof = path.with_name("tried.cert")
    proof.write_bytes(proofs.repacked(arrays))
    return exact.check(path, proof)


def read(text, **options):
    return reader.read_graph(text.encode(), {**CLAIM, **options}, None)


# --- Numbers


@given(st.integers(-(2**200), 2**200), st.integers(1, 2**200))
@example(2**53 + 1, 1)  # ties go to even
@example(2**53 + 3, 1)
@example(1, 2**1075)
@example(3, 2**1075)
@example(2**1024 - 2**970 - 1, 1)
def test_nearest_is_the_nearest_double(n, d):
    assert reader.nearest(n, d) == stored(n / d)


def test_what_is_not_finite_is_refused():
    for word in ("1e309", "-1e309", "1e99999999", str(2**1024 - 2**970)):
        with pytest.raises(ValueError, match="finite"):
            reader.double(word)


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(5e-324)
@example(1.7976931348623157e308)
def test_words_and_bits_are_doubles(x):
    assert reader.double(repr(x)) == stored(x)
    assert reader.from_bits(int.from_bytes(np.float64(x).tobytes(), "little")) == stored(x)


@pytest.mark.parametrize(
    ("word", "x"), [("+.5", 0.5), ("5.", 5.0), ("0e99999999", 0.0), ("1e-9999999", 0.0), ("-0", 0)]
)
def test_decimals_may_be_spelled_in_these_ways(word, x):
    assert reader.double(word) == stored(x)


@pytest.mark.parametrize("word", ["", ".", "e5", "1e", "1e+", "--1", "1.2.3", "nan", "1_0", "0x1"])
def test_what_is_no_decimal_is_refused(word):
    with pytest.raises(ValueError, match="decimal"):
        reader.double(word)


@given(st.floats(-1e6, 1e6) | st.floats(-4.0, 4.0) | st.floats(-1e-300, 1e-300))
@example(np.pi)
@example(1.0)
@example(1.5)
@example(1e6)
@settings(max_examples=200)
def test_half_angles_are_those_of_the_first_checker(theta):
    if 0.0 < abs(theta) < 1e-300:  # within a unit of the last bit of the smallest doubles
        return
    assert reader.half_angle(stored(theta)) == tuple(
        map(stored, checker.half_angles(np.array([theta]))[0].tolist())
    )


def test_angles_are_not_too_large():
    assert reader.half_angle(stored(1e6))
    with pytest.raises(ValueError, match="radians"):
        reader.half_angle(stored(np.nextafter(1e6, 2e6)))


def test_circle_is_as_close_as_it_says():
    # Against the same with 200 bits more, all around.
    for x in range(0, 40, 3):
        for bits in (320, 500):
            fine = exact.circle((x << bits + 200) // 7, bits + 200)
            for rough, better in zip(exact.circle((x << bits) // 7, bits), fine, strict=True):
                assert abs((rough << 200) - better) < 1 << (200 + 12)
    half_pi = exact.quarter_turn(320)
    assert abs(half_pi - (exact.quarter_turn(520) >> 200)) < 1 << 13
    assert abs(Fraction(half_pi, 1 << 320) - Fraction(np.pi / 2)) < Fraction(1, 10**15)


@given(seeds, st.sampled_from([3, 6, 10, 21]))
def test_weights_are_those_of_the_first_checker(seed, count):
    rng, p = rng_of(seed), {3: 2, 6: 3, 21: 6, 10: 4}[count]
    B = rng.standard_normal((p, p))
    A = (B @ B.T + 0.1 * np.eye(p)) * 10.0 ** rng.integers(-5, 6)
    words = tuple(repr(float(x)) for x in A[np.triu_indices(p)])
    if count in (6, 21):
        given = reader.weights(words, True)
        wanted = checker.weights(tuple(word.encode() for word in words), checker.harmonic_mean)
        assert given == tuple(map(stored, wanted))
    if count in (3, 6):
        tau = checker.harmonic_mean([word.encode() for word in words], 1)
        assert reader.weights(words, False) == (0, stored(tau))


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("0", "definite"),
        ("-1", "definite"),
        ("1 1 1", "definite"),
        ("1 0 0", "definite"),
        ("1 0 0 1 0 -1", "definite"),
        ("1 0 0 1 1 1", "definite"),
        ("-1 0 0 -1 0 1", "definite"),
        ("1e401", "range"),
        ("1.0e-400", "range"),
    ],
)
def test_weights_are_of_definite_matrices(words, reason):
    with pytest.raises(ValueError, match=reason):
        reader.harmonic_mean(words.split())


def test_weights_of_powers_of_ten():
    assert reader.harmonic_mean(["2e3"]) == stored(2000.0)
    assert reader.harmonic_mean(["2e2", "0e2", "200"]) == stored(200.0)


@given(seeds)
def test_matrices_become_the_quaternions_of_the_first_checker(seed):
    R = certpgo.linalg.rotations.random(rng_of(seed), 1, 3)[0].ravel().tolist()
    R = R if seed % 3 else [round(x, 4) for x in R]
    assert reader.shepperd([stored(x) for x in R]) == [
        stored(x) for x in checker.shepperd(tuple(R))
    ]


def test_matrices_are_near_rotations():
    for row in ("1 0 0 0 1 0 0 0 -1", "1 0 0 0 1 0 0 0 1.001", "2 0 0 0 1 0 0 0 1"):
        with pytest.raises(reader.Unreadable, match="line 1: a rotation matrix expected"):
            read(f"0 1 {row} 0 0 0\n", d=3)
    assert read("0 1 1 0 0 0 1 0 0 0 1.0004 0 0 0\n", d=3).n == 2


@given(st.tuples(*[st.integers(-99, 99)] * 4), st.tuples(*[st.integers(-99, 99)] * 4))
def test_quaternions_multiply_as_rotations_do(a, b):
    A, B = (np.array(exact.matrix(q, 3), dtype=object) for q in (a, b))
    assert (np.array(exact.matrix(exact.product(a, b), 3)) == A @ B).all()
    assert (exact.norm(a) ** 2 * np.eye(3, dtype=int) == A.T @ A).all()
    # |A/|a|^2 - B/|b|^2|^2 = 8 - 8 (a.b)^2 / |a|^2 |b|^2, of which the upper bound is made.
    if any(a) and any(b):
        n, m = exact.norm(a), exact.norm(b)
        apart = sum(x * x for x in (m * A - n * B).flat)
        cosine = sum(x * y for x, y in zip(a, b, strict=True))
        assert apart == 8 * n * m * (n * m - cosine**2)


# --- Reading


@pytest.mark.parametrize(
    ("text", "options", "reason"),
    [
        ("EDGE_SE2 0 1 0 0\n", {}, "line 1: 5 or 11 numbers"),
        ("EDGE_SE2 0 1 0 0 x\n", {}, "line 1: a decimal"),
        ("\nEDGE_SE2 0.5 1 0 0 0\n", {}, "line 2: ids"),
        ("EDGE_SE2 0 1 0 0 0 --1 0 0 1 0 1\n", {}, "decimal"),
        ("EDGE_SE2 0 1 0 0 0 1 0 --0 1 0 1\n", {}, "decimal"),
        ("EDGE_SE2 0 0 0 0 0\n", {}, "from itself"),
        ("EDGE_SE2 0 1 0 0 0 1e-300 0 0 1 0 1e-300\n", {}, "tiny"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0 1e-399\n", {}, "tiny"),
        ("EDGE_SE2 0 1 0 0 0 1e300 0 0 1e300 0 1\n", {}, "huge"),
        ("EDGE_SE2 0 1 0 0 0\n", {"kappa": 0}, "positive"),
        ("EDGE_SE2 0 1 0 0 0\n", {"tau": Decimal("0.0")}, "positive"),
        ("EDGE_SE2 0 1 0 0 0\n", {"tau": -1}, "positive"),
        ("EDGE_SE2 0 1 0 0 0\r", {}, "plain text"),
        ("EDGE_SE2 0 1 0 0 \u0661\n", {}, "plain text"),
        ("EDGE_OTHER 0 1 0 0 0\n", {}, "12 numbers|14 numbers"),
        ("EDGE_SE2 0 1 0 0 0\n0 1 1 0 0 0 1 0 0 0 1 0 0 0\n", {}, "no graph of 2D"),
        ("EDGE_SE2 0 1 0 0 0\n", {"d": 3}, "no graph of 3D"),
        ("VERTEX_SE2 0 0 0 0\n", {}, "no graph of 2D"),
    ],
)
def test_unreadable_lines_are_named(text, options, reason):
    with pytest.raises(reader.Unreadable, match=reason) as error:
        read(text, **options)
    assert "\n" not in str(error.value)


MAP = {"landmarks": True, "priors": True, "maps": True}


@pytest.mark.parametrize("tag", reader.TAGS)
@pytest.mark.parametrize("weighted", [False, True])
def test_both_checkers_read_the_same_lines(tag, weighted):
    role, d, turned = reader.TAGS[tag]
    size, p = (4 * d - 5) if turned else d, (3 * d - 3) if turned else d
    words = [tag, *["3", "7"][role == "prior" :], *["0"] * (d == 3 and role != "pose")]
    words += ["1.25", "-0.5", "0.75", "0.1", "0.2", "-0.3", "0.9"][:size]
    upper = [f"{4 + a}.5" if a == b else "0.25" for a in range(p) for b in range(a, p)]
    start = "EDGE_SE2 0 3 1 0 0.5" if d == 2 else "EDGE_SE3:QUAT 0 3 1 0 0 0.5 0 0 1"
    text = "\n".join([start, " ".join(words + upper * weighted)]).encode()
    for options in (MAP, {"priors": True}, {"rotation_information": "quaternion"}, {"tau": 2.5}):
        claim = {**CLAIM, "d": d, **options}
        assert compared_reading(text, claim) == "both read the same"


def test_both_checkers_read_matrices():
    text = "1 2 0 -1 0 1 0 0 0 0 1 7 8 9\n2 3 1 0 0 0 -1 0 0 0 -1.00001 7 8 9\n"
    assert compared_reading(text.encode(), {**CLAIM, "d": 3}) == "both read the same"
    assert reader.quaternion([stored(0.5), 0]) == (0, 0, 0, 1)
    with pytest.raises(reader.Unreadable, match="no measurements"):
        reader.read_graph(text.encode(), {**CLAIM, "d": 3}, {1})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("EDGE_SE2_XY 0 1 1 1\n", "node 1 is a pose and a point"),
        ("EDGE_SE2_XY 0 5 1 1\nEDGE_PRIOR_SE2 5 0 0 0\n", "node 5 is a pose and a point"),
        ("EDGE_SE2_XY 0 5 1 1\nEDGE_SE2_XY 5 6 1 1\n", "node 5 is a pose and a point"),
        ("LANDMARK2 0 1 1 1\nLANDMARK2 0 -3 1 1\n", "from 0 expected, not -3"),
    ],
)
def test_a_point_has_no_rotation(text, reason):
    with pytest.raises(reader.Unreadable, match=reason):
        read("EDGE_SE2 0 1 1 0 0\n" + text, **MAP)


def test_points_and_the_world_have_ids_of_their_own():
    text = "EDGE_SE2 0 4 1 0 0\nLANDMARK2 0 4 1 1\nLANDMARK2 4 9 2 2\nEDGE_SE2_GPS 4 3 3\n"
    graph = read(text, **MAP)
    assert (graph.n, graph.points) == (5, {2, 3})
    assert [edge[:2] for edge in graph.edges] == [(0, 1), (0, 2), (1, 3), (4, 1)]
    assert [edge.kappa for edge in graph.edges] == [ONE, 0, 0, 0]
    assert read(text).n == 2


def test_sensors_are_at_the_origin_of_their_body():
    text = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1\nEDGE_SE3_TRACKXYZ 0 7 1 1 1 1\n"
    here, there = "PARAMS_SE3OFFSET 1 0 0 0 0 0 0 2\n", "PARAMS_SE3OFFSET 1 0 0 1 0 0 0 1\n"
    assert read(text + here, d=3, **MAP).n == 3
    for more in ("", there, here + there, there + here, here.replace("2", "0")):
        with pytest.raises(reader.Unreadable, match="sensor 1"):
            read(text + more, d=3, **MAP)


def test_an_origin_is_subtracted_without_rounding():
    text = "EDGE_SE2 0 1 1 0 0\nEDGE_SE2_GPS 0 1048576.5 8\n"
    graph = read(text, origin=[Decimal("1048576.0"), Decimal("0.5")], **MAP)
    assert graph.edges[1].t == (stored(0.5), stored(7.5))
    with pytest.raises(reader.Refused, match="not a double"):
        read(text, origin=[Decimal("0.1"), Decimal("0.0")], **MAP)


@pytest.mark.parametrize(
    ("keep", "kept"), [("all", [1, 2, 3]), ("first", [1, 3]), ("last", [2, 3])]
)
def test_parallel_edges(keep, kept):
    text = "EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 0 2 0 0\nEDGE_SE2 1 2 3 0 0\n"
    steps = sorted(edge.t[0] for edge in read(text, keep=keep).edges)
    assert steps == [stored(x) for x in kept]


# --- Positive semidefiniteness


@given(st.lists(st.integers(-(2**40) + 1, 2**40 - 1), min_size=1, max_size=9), st.data())
def test_packed_numbers_are_found_again(numbers, data):
    packing = exact.Packing(48)
    packed = sum(x << 48 * k for k, x in enumerate(numbers))
    assert packing.unpacked(packed, len(numbers)) == numbers
    places = sorted(
        data.draw(st.sets(st.integers(0, 20), min_size=len(numbers), max_size=len(numbers)))
    )
    spread = packing.unpacked(packing.spread(packed, places), places[-1] - places[0] + 1)
    wanted = dict(zip([k - places[0] for k in places], numbers, strict=True))
    assert spread == [wanted.get(k, 0) for k in range(len(spread))]


def sparse(rng, n, precision, slack):
    """A sparse symmetric matrix in units of 2^-(2 precision), singular but for the slack."""
    one = 1 << 2 * precision
    A = np.zeros((n, n), dtype=object)
    pairs = [*((k, k + 1) for k in range(n - 1)), *rng.integers(n, size=(3, 2)).tolist()]
    for i, j in pairs:
        weight = int(rng.integers(1, 2**40)) * one >> 44
        for r, s, x in ((i, i, weight), (j, j, weight), (i, j, -weight), (j, i, -weight)):
            A[r, s] += x if i != j else 0
    A[np.diag_indices(n)] += slack
    return A


def eliminated(A, order, error=0, v=None, precision=12):
    """What the checker says about a matrix, eliminated in some order."""
    n = len(A)
    found = exact.fronts({(i, j) for i, j in combinations(range(n), 2) if A[i, j]}, order, 2)
    row = {node: k for k, node in enumerate(node for front in found for node in front[0])}
    rows, weights = [{} for _ in range(n)], [1] * n
    for node, k in row.items():
        weights[k] = v[node] if v else 1
    for i, j in zip(*np.nonzero(A), strict=True):
        if row[int(i)] <= row[int(j)]:
            rows[row[int(i)]][row[int(j)]] = A[i, j]
    tree = [
        ([row[k] for k in pivots], sorted(row[k] for k in boundary), parent)
        for pivots, boundary, parent in found
    ]
    passed = exact.is_positive_semidefinite(rows, error, tree, weights, precision)
    return passed, rows, tree


@given(seeds, st.integers(2, 9), st.integers(-40, 4000))
@settings(max_examples=150)
def test_what_passes_is_positive_semidefinite(seed, n, slack):
    rng = rng_of(seed)
    A = sparse(rng, n, 12, slack)
    v = [1 << int(k) for k in rng.integers(0, 5, n)]
    passed = eliminated(A, rng.permutation(n).tolist(), v=v)[0]
    definite = leading_minors_are_positive(A.tolist())
    assert not passed or definite
    assert slack > 0 or not passed
    # Twelve bits leave 2^11 for each of at most n entries in a row, weighted.
    assert passed or slack < 2**11 * n * 16 * 3


@given(seeds, st.integers(3, 9))
def test_enough_slack_passes_in_any_order(seed, n):
    rng = rng_of(seed)
    A = sparse(rng, n, 60, 1 << 70)
    assert eliminated(A, rng.permutation(n).tolist(), precision=60)[0]
    A[0, 0] -= A[0, 0] * (1 + (1 << 20)) >> 20
    assert not eliminated(A, rng.permutation(n).tolist(), precision=60)[0]


@given(seeds)
@settings(max_examples=200)
def test_factors_are_hints_and_what_they_leave_decides(seed):
    # A = L L^T + E for any L, in three fronts: what is left is E to the unit, and dominance is
    # judged with its errors. E is at the edge: one more or less in a row makes the difference.
    rng, error = rng_of(seed), int(rng_of(seed).integers(0, 3))
    tree = [([0, 1], [4, 5], 2), ([2, 3], [4, 5], 2), ([4, 5], [], -1)]
    v = [1 << int(k) for k in rng.integers(0, 3, 6)]
    L, E = np.zeros((6, 6), dtype=object), np.zeros((6, 6), dtype=object)
    for pivots, boundary, _ in tree:
        for k, r in enumerate(pivots):
            for s in [*pivots[k:], *boundary]:
                L[s, r] = int(rng.integers(-900, 900))
                E[r, s] = E[s, r] = int(rng.integers(-6, 7)) or 1
    pattern = E != 0
    for r in range(6):
        needed = sum(abs(E[r, s]) * v[s] for s in range(6) if s != r)
        needed += error * sum(v[s] for s in range(6) if pattern[r, s])
        E[r, r] = -(-needed // v[r])
    short = int(rng.integers(-1, 6))
    if short >= 0:
        E[short, short] -= 1
    A = L @ L.T + E
    rows = [{s: A[r, s] for s in range(r, 6) if pattern[r, s]} for r in range(6)]
    columns = iter(
        [L[s, r] for s in [*pivots[k:], *boundary]]
        for pivots, boundary, _ in tree
        for k, r in enumerate(pivots)
    )
    passed = exact.is_positive_semidefinite(rows, error, tree, v, 12, lambda S, _: next(columns))
    assert passed == (short < 0)


def test_errors_of_entries_are_counted():
    # Row 0 has two entries, each with an error, and n 2^11 for the factor's rounding.
    one = 1 << 24
    A = np.array([[one >> 1, one >> 2], [one >> 2, one >> 1]], dtype=object)
    assert eliminated(A, [0, 1], error=1 << 6)[0]
    assert not eliminated(A, [0, 1], error=1 << 22)[0]


@pytest.mark.parametrize("seed", range(5))
def test_a_wrong_tree_is_refused(seed):
    rng = rng_of(seed)
    A = sparse(rng, 7, 60, 1 << 70)
    passed, rows, tree = eliminated(A, list(range(7)), precision=60)
    assert passed
    assert len(tree) > 2

    def again(other):
        try:
            return exact.is_positive_semidefinite(rows, 0, other, [1] * 7, 60)
        except KeyError:
            return False

    for k, (pivots, boundary, parent) in enumerate(tree):
        assert not again(tree[:k] + tree[k + 1 :])
        assert not again([*tree[: k + 1], *tree[k:]])
        if boundary:
            for other in {-1, *range(len(tree))} - {parent}:
                # A row passed on to a front that comes too late is no longer there.
                assert not again([*tree[:k], (pivots, boundary, other), *tree[k + 1 :]])
            assert not again([*tree[:k], (pivots, boundary[1:], parent), *tree[k + 1 :]])


def test_numbers_that_do_not_fit_are_refused():
    # Unpacked, 2^31 in 32 bits would be negative, and its neighbour one more.
    one = 1 << 24
    assert not eliminated(np.array([[one + 1]], dtype=object), [0])[0]
    assert eliminated(np.array([[one]], dtype=object), [0])[0]
    # The same of what is subtracted: a pivot just above its share of the slack.
    A = np.array([[2 * 2**12 + 17, one], [one, one]], dtype=object)
    assert not eliminated(A, [0, 1])[0]


@given(seeds, st.integers(1, 9))
@settings(max_examples=50)
def test_entries_are_below_the_truth_by_less_than_said(seed, parallel):
    rng, bits = rng_of(seed), 6
    A = {(r, s): int(rng.integers(-(2**20), 2**20)) for r in range(6) for s in range(r, 6)}
    scale, unit = [int(x) for x in rng.integers(-3, 4, 6)], 14
    blocks = []
    for k in range(parallel + 1):
        ends = [(2, 0), (0, 2), (4, 2)][1 if 0 < k < parallel else 2 * (k == parallel)]
        N = rng.integers(-(2**20), 2**20, (2, 2)).tolist()
        blocks.append((*ends, N, int(rng.integers(1, 99))))
    rows, error = exact.scaled(A, blocks, unit, scale, bits)
    truth = {place: Fraction(x) for place, x in A.items()}
    for r, s, N, D in blocks:
        for a, b in np.ndindex(2, 2):
            truth[min(r + a, s + b), max(r + a, s + b)] += Fraction(N[a][b], D)
    for (r, s), x in truth.items():
        below = x * Fraction(2) ** (scale[r] + scale[s] + bits - unit) - rows[r][s]
        assert 0 <= below < error
    assert error == parallel + 1


# --- Both checkers


def test_both_agree_on_damaged_files():
    said, false = outcomes(0, PROOFS, 16)
    assert false == []
    answers = {found for _, found in said}
    assert {
        "both prove the same",
        "both refuse",
        "both read the same",
        "neither reads it",
    } <= answers


@given(seeds, dimensions, st.booleans())
@settings(max_examples=12)
def test_what_is_proven_is_true(tmp_path_factory, seed, d, poses):
    path, proof = proofs.proven(tmp_path_factory.mktemp("proof"), made(seed, d, poses))
    assert compared(path, proof) == "both prove the same"
    said, arrays = exact.check(path, proof), proofs.arrays_of(proof)
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    measured = proofs.measured_by(path)
    cost = proofs.exact_cost(graph, measured, arrays["rotations"], arrays.get("translations"))
    assert cost <= said.upper <= cost + Fraction(1, 1 << 1380)
    trace = arrays["multipliers"][:, np.equal(*np.triu_indices(d))]
    assert said.lower == max(0, sum(Fraction(float(x)) for x in trace.ravel()))
    assert proofs.is_positive_semidefinite(
        proofs.exact_matrix(graph, measured, arrays["multipliers"], poses)
    )


@given(seeds, dimensions, st.booleans(), st.floats(-17, -13))
@settings(max_examples=15)
def test_at_the_edge_only_what_is_positive_semidefinite_passes(
    tmp_path_factory, seed, d, poses, digits
):
    path, proof = proofs.proven(tmp_path_factory.mktemp("edge"), made(seed, d, poses, n=4))
    arrays, rng = proofs.arrays_of(proof), rng_of(seed)
    k = tuple(rng.integers(arrays["multipliers"].shape))
    arrays["multipliers"][k] += np.abs(arrays["multipliers"]).max() * 10.0**digits
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    A = proofs.exact_matrix(graph, proofs.measured_by(path), arrays["multipliers"], poses)
    if not proofs.is_positive_semidefinite(A):
        with pytest.raises(exact.Refused, match="semidefinite"):
            tried(path, arrays)


@pytest.mark.parametrize("name", ["version1", "version2_plane", "version2_space"])
def test_committed_proofs(name):
    graph = Path(__file__).parent / "data" / "proofs" / f"{name}.g2o"
    assert compared(graph, graph.with_suffix(".cert")) == "both prove the same"


@pytest.mark.parametrize(
    ("name", "alone"),
    [
        ("smallGrid3D", False),
        ("smallGrid3D", True),
        ("MIT", False),
        ("cycle50_0.5_SO3", False),
        ("cityTrees_reduced_1k", False),
    ],
)
def test_both_prove_public_optima(name, alone, tmp_path, dataset, dataset_path):
    instance, path, proof = dataset(name), dataset_path(name), tmp_path / "proof.cert"
    instance = rotations_alone(instance) if alone else instance
    answer = certpgo.solve(instance.graph, cost="chordal")
    write_proof(proof, path, instance, answer.estimate, answer.certificate)
    assert compared(path, proof) == "both prove the same"


# --- Refusing


def test_more_than_the_optimum_is_refused(small):
    path, arrays = small
    said = tried(path, arrays)
    arrays["multipliers"][1, 0] += float(said.upper - said.lower) + 1e-9 * float(said.lower)
    with pytest.raises(exact.Refused, match="semidefinite"):
        tried(path, arrays)
    arrays["multipliers"][1, 0] += 1e6
    with pytest.raises(exact.Refused, match="diagonal"):
        tried(path, arrays)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("order", lambda a: a[:-1]),
        ("order", lambda a: np.zeros_like(a)),
        ("delta", lambda a: np.full_like(a, np.nan)),
        ("delta", lambda a: a.astype("<f8")),
        ("rotations", lambda a: 0.0 * a),
        ("rotations", lambda a: a + np.inf),
        ("multipliers", lambda a: a.astype(">f8")),
        ("translations", lambda a: a.T),
        ("claim", lambda a: a[:-1]),
    ],
)
def test_other_arrays_are_refused(small, name, change):
    path, arrays = small
    with pytest.raises((exact.Refused, exact.Unreadable)) as error:
        tried(path, {**arrays, name: change(arrays[name])})
    assert "\n" not in str(error.value)


def test_arrays_by_columns_are_read_too(small):
    path, arrays = small
    assert tried(path, {k: np.asfortranarray(a) for k, a in arrays.items()}) == tried(path, arrays)


def test_a_multiplier_of_a_point_is_refused(tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(
        "".join(f"EDGE_SE2 {i} {j} 1 0 1.5\n" for i, j in ((0, 1), (1, 2), (2, 0)))
        + "".join(f"EDGE_SE2_XY {i} 9 1 {i}\n" for i in range(3))
    )
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance.graph, cost="chordal")
    write_proof(tmp_path / "map.cert", path, instance, answer.estimate, answer.certificate)
    arrays = proofs.arrays_of(tmp_path / "map.cert")
    assert "with 1 landmarks" in tried(path, arrays).about
    arrays["multipliers"][3, 0] = 1e-9
    with pytest.raises(exact.Refused, match="multiplier of a point"):
        tried(path, arrays)


def test_what_is_printed_is_rounded_outwards():
    said = exact.Answer(1 + Fraction(1, 2**80), 1 - Fraction(1, 2**80), "")
    assert str(said) == (
        "PROVED: F(x) <= 1.00000000000001, F* >= 0.999999999999999, relative gap <= 1.7e-24"
    )
    assert "F(x) <= 0, F* >= 0, relative gap <= 0" in str(
        exact.Answer(Fraction(0), Fraction(0), "")
    )


# --- By itself


def test_works_as_files_by_themselves(small, tmp_path):
    """The checker needs nothing but a plain proof, and its reader nothing but Python."""
    path, arrays = small
    said, alone = tried(path, arrays), tmp_path / "alone"
    alone.mkdir()
    proof, plain = path.with_name("tried.cert"), alone / "plain.txt"
    reading, checking = (shutil.copy(module.__file__, alone) for module in (reader, exact))

    def run(*command):
        command = [sys.executable, "-E", "-s", "-S", *map(str, command)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=alone, timeout=60)
        return done.returncode, done.stdout, done.stderr

    printed = f"{said}\nabout {said.about}\n"
    assert run(checking, path, proof) == (0, printed, "")
    code, text, err = run(reading, path, proof)
    assert (code, text, err) == (0, reader.plain(path, proof), "")
    plain.write_text(text)
    for program in (reading, checking):
        assert run(program)[0] == 2
        code, out, err = run(program, path, path)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert "not a readable proof" in err
        assert run(program, path, tmp_path / "nowhere.cert")[0] == 1
    other = tmp_path / "other.g2o"
    other.write_text(path.read_text() + "\n")
    code, out, _ = run(checking, other, proof)
    assert code == 6
    assert "SHA-256" in out
    Path(reading).unlink()
    assert run(checking, plain) == (0, printed, "")
    assert run(checking, path)[0] == 1
    plain.write_text(text[:-9])
    assert run(checking, plain)[0] == 1


def test_the_example_of_the_page():
    page = (Path(__file__).parents[1] / "docs" / "plain_proofs.md").read_text()
    block = re.search(r"\n\n((    .*\n)+)\nThe estimate", page)[1]
    said = exact.checked(exact.read(block.replace("    ", "")))
    assert f"    {said}\n    about {said.about}\n" in page
    assert said.lower == 3
    assert 0 < said.upper - Fraction(16, 5) < Fraction(1, 1 << 1390)


@pytest.mark.parametrize(
    ("before", "after", "reason"),
    [
        (r"proof 1", "proof 2", "not a plain proof"),
        (r"\ncost chordal", "\ncost other", "line 4: the chordal"),
        (r"\ncost chordal", "\ncost g2o", "27 numbers|28 numbers|another"),
        (r"\ncost .*", "", "another line expected than 'pose"),
        (r"(\ncost .*)", r"\1\1", "another line expected than 'cost"),
        (r"\npin .*", "", "pin"),
        (r"\npose 0 ", "\npose zero ", "invalid literal"),
        (r"\npose (\d+) \S+", r"\npose \1", "13 numbers expected, not 12"),
        (r"\nedge \d+", r"\nedge 6", "between two nodes"),
        (r"\nedge \d+", r"\nedge -1", "between two nodes"),
        (r"\nedge (\d+) \d+", r"\nedge \1 \1", "between two nodes"),
        (r"\nedge (\d+ \d+) ", r"\nedge \1 -", "not positive"),
        (r"\nedge (\d+ \d+ \S+) ", r"\nedge \1 -", "not positive"),
        (r"\npose (\d+) (\S+ ){4}", r"\npoint \1 ", "3 numbers expected"),
        (r"p-", "p-99999", "shift"),
        (r"p-", "p9999", "beyond doubles"),
        (r"\norder (\d) \d", r"\norder \1 \1", "permutation"),
        (r"\norder .*", "\norder", "permutation"),
        (r"\npin \d", "\npin 6", "out of range"),
        (r"\npin (\d) .*", r"\npin \1 301", "out of range"),
    ],
)
def test_plain_proofs_that_are_damaged_are_refused_with_the_line(small, before, after, reason):
    path, arrays = small
    path.with_name("tried.cert").write_bytes(proofs.repacked(arrays))
    text = reader.plain(path, path.with_name("tried.cert"))
    other = re.sub(before, after, text, count=1)
    assert other != text
    with pytest.raises((exact.Unreadable, exact.Refused), match=reason) as error:
        exact.read(other)
    assert "\n" not in str(error.value)

"""Proofs about similarities: what both checkers read, prove and refuse."""

import hashlib
import io
import math
import zipfile
from dataclasses import replace
from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from strategies import rng_of, seeds

import certpgo
from certpgo import (
    Estimate,
    InputError,
    Instance,
    checker,
    integer_checker,
    integer_reader,
)
from certpgo.graph import RotationGraph, SimilarityGraph
from certpgo.io.datasets.monocular import in_one_unit, random_maps
from certpgo.solve.proving import write_proof

BOTH, READERS = (checker, integer_checker), (checker, integer_reader)


def proven(folder, graph, name="map.npz"):
    """Paths of a graph of similarities and of the proof of its optimum, and the bounds."""
    path, proof = folder / name, folder / f"{name}.cert"
    certpgo.write(path, Instance("map", graph, np.arange(graph.num_nodes)))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    return path, proof, said


def drawn(seed, d=None, mean=None):
    """A random graph; its dimension and unit, too, if they are not given."""
    rng = rng_of(seed)
    d = int(rng.integers(2, 4)) if d is None else d
    points = int(rng.integers(0, 3))
    known = rng.choice(6 - points, int(rng.integers(0, 3)), replace=False).tolist()
    graph, _ = random_maps(rng, d, 6, 9, known=known, points=points, turn=0.2, scale=0.2)
    mean = bool(rng.integers(0, 2)) if mean is None else mean
    return graph.with_unknown_scales(~graph.is_point) if mean else graph


@pytest.fixture(params=["known", "mean"])
def small(request, tmp_path):
    """A graph's file with a point, the arrays of its proof, and its bounds."""
    graph, _ = random_maps(rng_of(4), 3, 6, 9, known=(2,), points=1, turn=0.2, scale=0.2)
    if request.param == "mean":
        graph = graph.with_unknown_scales(~graph.is_point)
    path, proof, said = proven(tmp_path, graph)
    return path, proofs.arrays_of(proof), said


def verdicts(path, arrays):
    """What both checkers prove by these arrays; None where they refuse, in one line."""
    proof, found = path.with_name("tried.cert"), []
    proof.write_bytes(proofs.repacked(arrays))
    for program in BOTH:
        try:
            found.append(program.check(path, proof))
        except (program.Refused, program.Unreadable) as reason:
            found.append(None if "\n" not in str(reason) else reason)
    return found


def refused(path, arrays):
    return verdicts(path, arrays) == [None, None]


def rewritten(path, arrays, **changes):
    """The arrays with the digest of the graph's file, some of whose arrays are changed."""
    with np.load(path) as archive:
        stored = {name: archive[name] for name in archive.files}
    np.savez(path, **{**stored, **changes})
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return proofs.with_claim(arrays, graph_sha256=digest)


# --- Golden values


def of_two(mean):
    """Two maps of the plane at one place, which two measurements say are of scale 1 and 3."""
    rotation = RotationGraph(2, [[0, 1]] * 2, [np.eye(2)] * 2, kappa=np.ones(2))
    scales, free = np.array([1.0, 3.0]), np.array([mean, True])
    return SimilarityGraph(rotation, np.zeros((2, 2)), np.ones(2), scales=scales, free=free)


@pytest.mark.parametrize(
    ("mean", "least"),
    # 2 ((s - 1)^2 + (s - 3)^2), least at 2; that over (1 + s^2) / 2, least at 1 + sqrt 2
    [(False, 4.0), (True, 8.0 / (3.0 + 2.0 * math.sqrt(2.0)))],
)
def test_two_maps_by_hand(tmp_path, mean, least):
    path, proof, said = proven(tmp_path, of_two(mean))
    assert said.lower <= least * (1.0 + 1e-15)
    assert least * (1.0 - 1e-15) <= said.upper
    assert said.relative_gap < 1e-9
    unit = "the root mean square scale" if mean else "the poses of known scale"
    assert f"{1 + mean} scales unknown, in the unit of {unit}" in said.about
    exact = integer_checker.check(path, proof)
    assert exact.about == said.about
    assert said.lower <= exact.lower <= exact.upper <= said.upper


def mapped(q, t, s, graph, mean=False):
    """What both checkers say that poses (q, t, s) cost at most; the first has a known scale."""
    bits = np.vectorize(lambda x: integer_reader.nearest(*x.as_integer_ratio()), otypes=[object])
    i, j, measured, steps, scales = graph
    q, t, s, steps, scales = (np.array(x, dtype=float) for x in (q, t, s, steps, scales))
    free, ones = np.arange(len(s)) >= (not mean), np.ones(len(scales))
    turned = np.array(measured, dtype=float)
    own = checker.Graph(
        len(s),
        np.array(i),
        np.array(j),
        None,
        steps,
        ones,
        ones,
        None,
        turned,
        scales=scales,
        free=free,
    )
    rows = zip(i, j, measured, bits(steps).tolist(), bits(scales), strict=True)
    one = integer_checker.ONE
    edges = [
        integer_checker.Edge(
            i, j, integer_reader.quaternion(bits(m).tolist()), tuple(u), one, one, x
        )
        for i, j, m, u, x in rows
    ]
    other = integer_checker.Graph(len(s), edges, set(), set(np.flatnonzero(free).tolist()))
    turns = [integer_reader.quaternion(row) for row in bits(q).tolist()]
    proof = integer_checker.Proof(turns, bits(t).tolist(), [], [], 0, 0, [], bits(s).tolist())
    exact = integer_checker.upper_bound(other, proof, t.shape[1])
    return checker.upper_bound(own, q, t, None, s), exact


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("size", [2.0**60, 2.0**81, 2.0**200])
@pytest.mark.parametrize("apart", [0, 1])
def test_costs_of_large_scales_are_rounded_once(d, size, apart):
    # A measurement of the scale 3/2 that fits, or is off by a few units of 2^-160, both ways.
    one, tiny = [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, apart * 2.0**-158, 1.0]
    if d == 2:
        one, tiny = one[:1:-1], tiny[:1:-1]
    step, off = np.array([1.0, -2.0, 4.0][:d]), apart * size * 2.0**-158
    s, t = [1.0, size, 1.5 * size], [0.0 * step, [off, -off, off][:d], size * step]
    found, exact = mapped([one, one, tiny], t, s, ([1], [2], [one], [step], [1.5]))
    assert exact <= Fraction(found) <= exact * (1 + Fraction(1, 2**51)) + Fraction(1, 2**250)
    assert (exact > 0) if apart else exact == 0


@given(seeds, st.sampled_from([2, 3]), st.booleans())
@settings(max_examples=20, deadline=None)
def test_upper_bounds_hold_for_scales_of_any_size(seed, d, mean):
    rng = rng_of(seed)

    def turned(count):  # by angles down to units of the checker's rotations
        q = np.eye(4)[[3] * count] if d == 3 else np.eye(2)[[0] * count]
        apart = np.ldexp(rng.standard_normal(q.shape), rng.integers(-170, 2, q.shape))
        return q + np.where(q == 0.0, apart, 0.0)

    i, j = np.array([[0, 1], [1, 2], [2, 1], [1, 2]]).T
    s = np.ldexp(rng.uniform(1.0, 2.0, 3), rng.choice([-60, 0, 60, 90]))
    s[0], scales = 1.0 if not mean else s[0], s[j] / s[i]
    t, steps = (np.ldexp(rng.standard_normal((k, d)), rng.integers(-60, 9)) for k in (3, 4))
    q, measured = turned(3), turned(4)
    found, exact = mapped(q, t, s, (i, j, measured, steps, scales), mean)
    A = [np.array(proofs.exact_rotation(x)) * Fraction(k) for x, k in zip(q, s, strict=True)]
    cost = Fraction(0)
    for e, (a, b) in enumerate(zip(i, j, strict=True)):
        S = np.array(proofs.exact_rotation(measured[e])) * Fraction(scales[e])
        cost += ((A[b] - A[a] @ S) ** 2).sum()
        apart = [Fraction(x) - Fraction(y) for x, y in zip(t[b], t[a], strict=True)]
        cost += ((apart - A[a] @ [Fraction(x) for x in steps[e]]) ** 2).sum()
    if mean:
        cost *= 3 / sum(Fraction(x) ** 2 for x in s)
    assert cost <= exact
    assert cost <= Fraction(found)
    assert exact <= cost * (1 + Fraction(1, 2**40)) + Fraction(1, 2**500)


def test_the_matrix_of_a_tiny_scale_is_exact():
    """|A_1 - s A_0|^2 + |t_1 - t_0|^2 in the plane, without the pinned row."""
    one, s, zeros, none = np.array([[1.0, 0.0]]), 2.0**-120, np.zeros((2, 2)), np.zeros((2, 3))
    graph = checker.Graph(
        2, np.array([0]), np.array([1]), checker.rotations(one), zeros[:1], *2 * [np.ones(1)]
    )
    graph = graph._replace(scales=np.array([s]), free=np.array([False, True]))
    proof = checker.Proof(one.repeat(2, axis=0), zeros, none, np.arange(2), np.zeros(6), 0, 0)
    blocks, normal = checker.certificate_matrix(graph, proof), checker.magnitude(graph)
    r, c = blocks.scales[:, :, None], blocks.scales[:, None, :]
    diagonal = np.ldexp(blocks.high[0] + blocks.low[0], normal - r - c)
    across = np.ldexp(blocks.high[1] + blocks.low[1], normal - r[:1] - c[1:])
    assert diagonal.tolist() == [np.diag([1.0, s * s, s * s]).tolist(), np.eye(3).tolist()]
    assert across.tolist() == [np.diag([0.0, -s, -s]).tolist()]
    bits = integer_reader.nearest(*s.as_integer_ratio()), integer_checker.ONE
    edge = integer_checker.Edge(0, 1, (0, 0, 0, 1), (0, 0), bits[1], bits[1], bits[0])
    other = integer_checker.Proof([], zeros.tolist(), none.astype(int).tolist(), [], 0, 0, [], [])
    A, [(p, q, N, D)], unit = integer_checker.certificate_matrix(
        integer_checker.Graph(2, [edge], set(), {1}), other, 2, {0: -1, 1: 2}, {0: 0, 1: 3}
    )
    found = {rows: Fraction(x, 2**unit) for rows, x in A.items() if x}
    assert found == {(0, 0): s * s, (1, 1): s * s, (2, 2): 1, (3, 3): 1, (4, 4): 1}
    assert (p, q, [[Fraction(x, D << unit) for x in row] for row in N]) == (
        0,
        3,
        [[-s, 0], [0, -s]],
    )


@pytest.mark.parametrize(
    ("own", "allowed"),
    [
        ([1.0, 0.0, -1.0], True),
        ([1.0, 0.0, 2.0**-53 - 1.0], True),
        ([1.0, 0.0, -1.0 - 2.0**-52], False),
        ([0.0, 0.0, 0.0], True),
        ([-(2.0**-1074), 9.0, 0.0], False),
    ],
)
def test_a_trace_at_an_unknown_scale_is_not_negative(own, allowed):
    rows, one = [[0.5, 7.0, 1.5], own], np.ones(1)
    graph = checker.Graph(2, np.array([0]), np.array([1]), None, np.zeros((1, 2)), one, one)
    graph = graph._replace(scales=one, free=np.array([False, True]))
    bits = [[integer_reader.nearest(*x.as_integer_ratio()) for x in row] for row in rows]
    proof = integer_checker.Proof([], [], bits, [], 0, 0, [], [])
    for program, asked in (
        (checker, (graph, np.array(rows), np.zeros(0))),
        (integer_checker, (integer_checker.Graph(2, [], set(), {1}), proof, 2)),
    ):
        if allowed:
            assert float(program.lower_bound(*asked)) == pytest.approx(2.0)
        else:
            with pytest.raises(program.Refused, match="trace"):
                program.lower_bound(*asked)


# --- What is proven is true


def exact_terms(graph):
    """Each measurement's squared residuals: weights, and coefficients of rows of X, exact."""
    terms = []
    for e, (i, j) in enumerate(zip(graph.i.tolist(), graph.j.tolist(), strict=True)):
        d = graph.t.shape[1]
        R = graph.R[e] * Fraction(1, 2**checker.POINT)
        s, kappa = Fraction(float(graph.scales[e])), Fraction(float(graph.kappa[e]))
        b = d + 1
        for c in range(d):
            row = {b * j + 1 + c: Fraction(1)}
            row |= {b * i + 1 + a: -s * R[a, c] for a in range(d)}
            terms.append((kappa, row))
        row = {b * j: Fraction(1), b * i: Fraction(-1)}
        row |= {b * i + 1 + a: -Fraction(float(graph.t[e, a])) for a in range(d)}
        terms.append((Fraction(float(graph.tau[e])), row))
    return terms


@given(seeds)
@settings(max_examples=4, deadline=None)
def test_what_is_proven_is_true_in_rationals(tmp_path_factory, seed):
    path, proof, said = proven(tmp_path_factory.mktemp("exact"), drawn(seed))
    arrays = proofs.arrays_of(proof)
    d, n = arrays["translations"].shape[1], len(arrays["scales"])
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    terms = exact_terms(graph)
    # F of the estimate, whose rows are those of [t A].
    s = [Fraction(float(x)) for x in arrays["scales"]]
    X = {}
    for k, q in enumerate(arrays["rotations"]):
        R = proofs.exact_rotation(q)
        for a in range(d):
            X[k, a] = [Fraction(float(arrays["translations"][k, a])), *(s[k] * x for x in R[a])]
    cost = Fraction(0)
    for weight, row in terms:
        for a in range(d):
            value = sum(x * X[p // (d + 1), a][p % (d + 1)] for p, x in row.items())
            cost += weight * value**2
    if graph.in_mean_unit:
        squares = [s[k] ** 2 for k in range(n) if graph.poses[k]]
        cost *= len(squares) / sum(squares)
    tiny = Fraction(1, 10**30)  # the checker's rotations are within 2^-160
    assert cost <= Fraction(said.upper) + tiny
    assert Fraction(said.upper) <= cost * Fraction(1 + 1e-9) + tiny
    # The certificate matrix is positive semidefinite, and traces are what they must be.
    b, N = d + 1, n * (d + 1)
    A = [[Fraction(0)] * N for _ in range(N)]
    for weight, row in terms:
        for p, x in row.items():
            for q, y in row.items():
                A[p][q] += weight * x * y
    traces = []
    for k, own in enumerate(arrays["multipliers"]):
        Lam = np.full((d, d), Fraction(0))
        Lam[np.triu_indices(d)] = Lam.T[np.triu_indices(d)] = [Fraction(float(x)) for x in own]
        traces.append(sum(Lam[a, a] for a in range(d)))
        for a in range(d):
            for c in range(d):
                A[b * k + 1 + a][b * k + 1 + c] -= Lam[a, c]
    kept = [
        b * k + r
        for k in range(n)
        for r in range(1 if k == 0 else 0, b)
        if r == 0 or graph.poses[k]
    ]
    spare = Fraction(1, 2**140)
    S = [[A[p][q] + spare * (p == q) for q in kept] for p in kept]
    assert proofs.is_positive_semidefinite(S)
    if graph.in_mean_unit:
        bound = min(x for k, x in enumerate(traces) if graph.poses[k]) * int(graph.poses.sum())
    else:
        assert all(x >= 0 for k, x in enumerate(traces) if graph.free[k])
        bound = sum(x for k, x in enumerate(traces) if not graph.free[k])
    assert Fraction(said.lower) <= max(bound, 0)
    assert said.relative_gap < 1e-6
    exact = integer_checker.check(path, proof)
    assert Fraction(said.lower) <= exact.lower <= max(bound, 0)
    assert cost - tiny <= exact.upper <= Fraction(said.upper)


# --- What both read


logarithms = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7)


@given(logarithms, st.sampled_from([1.0, 1e-9, 3.0]))
@settings(max_examples=50, deadline=None)
def test_exponentials_of_similarities(v, size):
    v = [size * x for x in v]
    q, t, s = checker.similarity(tuple(v))
    (a, b, c), sigma = v[:3], v[6]
    generator = np.zeros((4, 4))
    generator[:3, :3] = sigma * np.eye(3) + [[0, -c, b], [c, 0, -a], [-b, a, 0]]
    generator[:3, 3] = v[3:6]
    wanted = expm(generator)
    R = np.array(proofs.exact_rotation(q), dtype=float)
    scale = math.exp(sigma) + np.abs(wanted[:3, 3]).max()
    assert np.abs(s * R - wanted[:3, :3]).max() < 1e-12 * scale
    assert np.abs(np.array(t) - wanted[:3, 3]).max() < 1e-12 * scale
    assert s == pytest.approx(math.exp(sigma), rel=1e-15)
    mine = integer_reader.similarity([integer_reader.nearest(*exact(x)) for x in v])
    assert [float(Fraction(x, integer_checker.ONE)) for x in (*mine[0], *mine[1], mine[2])] == [
        *q,
        *t,
        s,
    ]


def exact(x):
    return x.as_integer_ratio()


@pytest.mark.parametrize(
    "v", [(0.0,) * 7, (0.0,) * 6 + (1.0,), (0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]
)
def test_exponentials_keep_zeros(v):
    q, t, s = checker.similarity(v)
    assert (q[1], q[2], t[1], t[2]) == (0.0, 0.0, 0.0, 0.0)
    assert (s == 1.0) == (v[6] == 0.0)
    assert (q == (0.0, 0.0, 0.0, 1.0)) == (v[0] == 0.0)


@pytest.fixture
def essential(tmp_path):
    """A file of g2o, with the fixed node that is not the first."""
    graph, truth = random_maps(np.random.default_rng(0), 3, turn=0.1)
    path = tmp_path / "essential.g2o"
    ids = np.arange(5, 21, 2)
    certpgo.write(
        path,
        Instance(
            "essential",
            graph.with_unknown_scales(np.arange(graph.num_nodes) != 3),
            ids,
            initial=truth,
            fixed=(3,),
        ),
    )
    return path


CLAIM = {
    "kind": "similarities",
    "d": 3,
    "keep": "all",
    "rotation_information": "tangent",
    "kappa": None,
    "tau": None,
    "landmarks": False,
    "priors": False,
    "origin": None,
    "maps": False,
    "cost": None,
}


def test_both_read_the_numbers_that_the_package_reads(essential):
    graph = certpgo.read(essential, quiet=True).graph
    mine = checker.read_graph(essential.read_bytes(), CLAIM, None)
    theirs = integer_reader.read_graph(essential.read_bytes(), CLAIM, None)
    assert np.flatnonzero(~mine.free).tolist() == [3]
    assert theirs.free == set(np.flatnonzero(mine.free).tolist())
    assert np.array_equal(mine.kappa, graph.kappa)
    assert np.array_equal(mine.tau, graph.tau)
    R = np.ldexp(mine.R.astype(float), -checker.POINT)
    for a, b in (
        (R, graph.rotations),
        (mine.t, graph.translations),
        (mine.scales, graph.scales),
    ):
        assert np.abs(a - b).max() < 1e-13
    for e, edge in enumerate(theirs.edges):
        numbers = [*edge.t, edge.kappa, edge.tau, edge.scale]
        found = [float(Fraction(x, integer_checker.ONE)) for x in numbers]
        assert found == [*mine.t[e], mine.kappa[e], mine.tau[e], mine.scales[e]]


@pytest.mark.parametrize(
    ("begin", "unit"),
    [
        ("", 1),
        ("FIX 9\n", 9),
        ("FIX 12 9\n", 9),
        ("FIX 12\r\nFIX +9 # 1\n", 9),
        ("\ufeffFIX 9\n", 9),
        ("# FIX 3\n", 1),
    ],
)
def test_the_unit_is_the_least_fixed_node_for_all_readers(tmp_path, begin, unit):
    ids, path = [1, 9, 12], tmp_path / "fixed.g2o"
    edges = [f"EDGE_SIM3:EXPMAP {i} {j} 0.1 0 0 1 0 0 0.5\n" for i, j in ((12, 9), (9, 1))]
    path.write_bytes((begin + "".join(edges)).encode())
    own = certpgo.read(path, quiet=True)
    assert np.flatnonzero(~own.graph.free).tolist() == [ids.index(unit)]
    assert (
        checker.read_graph(path.read_bytes(), CLAIM, None).free.tolist() == own.graph.free.tolist()
    )
    theirs = integer_reader.read_graph(path.read_bytes(), CLAIM, None)
    assert theirs.free == set(np.flatnonzero(own.graph.free).tolist())


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("EDGE_SE3:QUAT 5 7 0 0 0 0 0 0 1", "EDGE_SIM3:EXPMAP expected"),
        ("EDGE_SE3_PRIOR 5 0 0 0 0 0 0 0 1", "EDGE_SIM3:EXPMAP expected"),
        ("EDGE_SIM3:EXPMAP 5 7 0 0 0 0 0 0", "numbers"),
        ("EDGE_SIM3:EXPMAP 5 7 11 0 0 0 0 0 0", "within"),
        ("EDGE_SIM3:EXPMAP 5 7 0 0 -11 0 0 0 0", "within"),
        ("EDGE_SIM3:EXPMAP 5 7 0 0 0 0 0 0 70", "within"),
        ("EDGE_SIM3:EXPMAP 5 7 0 0 0 1e999 0 0 0", "finite"),
        ("EDGE_SIM3:EXPMAP 5 5 0 0 0 0 0 0 0", "measured from itself"),
        ("FIX five", "FIX"),
        ("FIX 1_1", "FIX"),
    ],
)
@pytest.mark.parametrize("program", READERS)
def test_unreadable_lines_are_named(essential, program, line, expected):
    text = essential.read_bytes() + line.encode() + b"\n"
    with pytest.raises((program.Unreadable, program.Refused), match=expected):
        program.read_graph(text, CLAIM, None)


def test_translations_may_be_huge():
    turn, shift, growth = (0.1, 0.2, 0.3), (1.0, -2.0, 0.5), 0.5
    _, t, _ = checker.similarity((*turn, *shift, growth))
    _, far, _ = checker.similarity((*turn, *(math.ldexp(x, 300) for x in shift), growth))
    assert far == pytest.approx([math.ldexp(x, 300) for x in t], rel=1e-15)


@pytest.mark.parametrize("program", READERS)
def test_turns_of_ten_radians_and_scales_of_e_to_69_are_read(essential, program):
    for numbers in ("10 0 0 0 0 0 0", "0 0 0 0 0 0 69", "0 0 -10 0 0 0 -69"):
        text = essential.read_bytes() + f"EDGE_SIM3:EXPMAP 5 7 {numbers}\n".encode()
        assert program.read_graph(text, CLAIM, None)


@pytest.mark.parametrize("program", READERS)
def test_information_that_is_not_used_is_read_too(essential, program):
    unused = {**CLAIM, "kappa": 1.0, "tau": 1.0}
    line = "EDGE_SIM3:EXPMAP 5 7 0 0 0 0 0 0 0" + " 1" * 28
    assert program.read_graph(essential.read_bytes() + line.encode() + b"\n", unused, None)
    words = line.split()
    for place in (10, 37):
        spoiled = " ".join([*words[:place], "1_0", *words[place + 1 :]])
        with pytest.raises((program.Unreadable, program.Refused)):
            program.read_graph(essential.read_bytes() + spoiled.encode() + b"\n", unused, None)


@pytest.mark.parametrize("program", READERS)
def test_arrays_have_a_header_of_any_version(small, program):
    path, arrays, _ = small
    claim, members = proofs.claim_of(arrays), {}
    with np.load(path) as archive:
        for name in archive.files:
            members[name] = io.BytesIO()
            np.lib.format.write_array(members[name], archive[name], version=(2, 0))
    for magic, is_read in ((b"\x93", True), (b"\x94", False)):
        whole = io.BytesIO()
        with zipfile.ZipFile(whole, "w") as archive:
            for name, data in members.items():
                archive.writestr(f"{name}.npy", magic + data.getvalue()[1:])
        if is_read:
            assert program.read_archive(whole.getvalue(), claim)
            continue
        with pytest.raises((program.Unreadable, program.Refused)):
            program.read_archive(whole.getvalue(), claim)


def test_a_file_of_g2o_is_proven(essential, tmp_path):
    instance, proof = certpgo.read(essential, quiet=True), tmp_path / "essential.cert"
    answer = certpgo.solve(instance)
    said = write_proof(proof, essential, instance, answer.estimate, answer.certificate)
    assert said.relative_gap < 1e-8
    assert integer_checker.check(essential, proof).about == said.about
    other = replace(instance, graph=instance.graph.with_unknown_scales(~instance.graph.is_point))
    answer = certpgo.solve(other)
    with pytest.raises(InputError, match="not that of the file"):
        write_proof(proof, essential, other, answer.estimate, answer.certificate)


@pytest.mark.parametrize(
    "changes",
    [
        {"scales": -np.ones(11)},
        {"scales": np.full(11, np.nan)},
        {"scales": np.ones(10)},
        {"scales": np.ones(11, dtype=np.float32)},
        {"kappa": np.full(11, 1e300)},
        {"kappa": np.ones(11)},  # the rotation of a point
        {"kappa": np.r_[np.ones(10), 0.0]},
        {"tau": np.zeros(11)},
        {"tau": np.full(11, 1e300)},
        {"free": np.ones(6, dtype=bool)},  # the scale of a point
        {"free": np.ones(5, dtype=bool)},
        {"free": np.array(True)},
        {"points": np.ones(6, dtype=bool)},
        {"edges": np.zeros((11, 2), dtype=np.int64)},
        {"edges": np.tile([0, 6], (11, 1))},
        {"edges": np.tile([0, -1], (11, 1))},
        {"rotations": np.tile(-np.eye(3), (11, 1, 1))},
        {"translations": np.full((11, 3), np.inf)},
        {"num_nodes": np.array(7)},
        {"version": np.array(2)},
        {"kind": np.array("estimate")},
        {"arms": np.zeros((11, 3))},
        {"range_edges": np.zeros((0, 2), dtype=np.int64)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_archives_that_are_no_graph_are_refused(small, changes):
    path, arrays, _ = small
    assert [x.lower > 0.0 for x in verdicts(path, rewritten(path, arrays))] == [True, True]
    tried = rewritten(path, arrays, **changes)
    assert refused(path, tried)
    for program in READERS:
        with pytest.raises((program.Unreadable, program.Refused)):
            program.read_archive(path.read_bytes(), proofs.claim_of(tried))


# --- Attacks


def test_the_unit_is_what_the_graph_says(small):
    path, arrays, _ = small
    with np.load(path) as archive:
        free, points = archive["free"], archive["points"]
    # Another pose of unknown scale, or all: another problem, whose minimum is not the old bound.
    for k in np.flatnonzero(~points).tolist()[1:3]:
        other = free.copy()
        other[k] = not other[k]
        tried = rewritten(path, arrays, free=other)
        least = certpgo.solve(certpgo.read(path, quiet=True)).certificate.cost_upper
        for found in verdicts(path, tried):
            assert found is None or found.lower <= least


def test_estimates_have_positive_scales_and_the_known_ones(small):
    path, arrays, _ = small
    with np.load(path) as archive:
        free, points = archive["free"], archive["points"]
    for k in np.flatnonzero(~points).tolist()[:2]:
        for scale in (0.0, -1.0, np.nan):
            tried = {**arrays, "scales": arrays["scales"].copy()}
            tried["scales"][k] = scale
            assert refused(path, tried)
        tried = {**arrays, "scales": arrays["scales"].copy()}
        tried["scales"][k] *= 1.0 + 1e-12
        assert refused(path, tried) == (not free[k])


def test_any_unit_costs_the_same_if_no_scale_is_known(tmp_path):
    path, proof, said = proven(tmp_path, drawn(1, 3, mean=True))
    arrays = proofs.arrays_of(proof)
    for factor in (2.0**-40, 3.7, 2.0**300):
        scaled = {k: factor * arrays[k] for k in ("scales", "translations")}
        doubles, integers = verdicts(path, {**arrays, **scaled})
        assert doubles.lower == said.lower
        assert float(integers.upper) == pytest.approx(said.upper, rel=1e-13)
        assert doubles.upper == pytest.approx(said.upper, rel=1e-9)


def test_multipliers_of_unknown_scales_have_no_negative_trace(tmp_path):
    path, proof, said = proven(tmp_path, drawn(2, 3, mean=False))
    arrays = proofs.arrays_of(proof)
    with np.load(path) as archive:
        free, points = archive["free"], archive["points"]
    # What is taken off at an unknown scale would allow more at a known one.
    k, known = int(np.argmax(free)), int(np.argmax(~free & ~points))
    on_diagonal = np.equal(*np.triu_indices(3))
    lower = arrays["multipliers"].copy()
    lower[k, on_diagonal] -= 1e-9
    assert refused(path, {**arrays, "multipliers": lower})
    lower[known, on_diagonal] += 0.1 * said.lower
    assert refused(path, {**arrays, "multipliers": lower})


def test_least_traces_count_if_no_scale_is_known(tmp_path):
    path, proof, said = proven(tmp_path, drawn(1, 3, mean=True))
    arrays = proofs.arrays_of(proof)
    arrays["multipliers"][0, 0] -= 0.1 * said.lower
    doubles, integers = verdicts(path, arrays)
    poses = int((~np.load(path)["points"]).sum()) if "points" in np.load(path).files else 6
    assert doubles.lower == pytest.approx(said.lower * (1.0 - 0.1 * poses), abs=1e-6)
    assert float(integers.lower) == pytest.approx(doubles.lower)


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 1},
        {"version": 3},
        {"kind": "poses"},
        {"kind": "rotations"},
        {"version": 1, "kind": "poses"},
        {"version": 3, "kind": "poses"},
        {"keep": "last"},
        {"kappa": 2.0},
        {"tau": 0.5},
        {"rotation_information": "quaternion"},
        {"landmarks": True},
        {"component_sha256": "0" * 64},
        {"cost": "g2o"},
        {"d": 2},
    ],
    ids=str,
)
def test_a_claim_of_another_kind_is_refused(small, changes):
    path, arrays, _ = small
    assert refused(path, proofs.with_claim(arrays, **changes))


@given(seeds)
@settings(max_examples=2, deadline=None)
def test_damaged_proofs_prove_nothing_false(tmp_path_factory, seed):
    rng = rng_of(seed)
    path, proof, said = proven(tmp_path_factory.mktemp("damaged"), drawn(seed))
    arrays = proofs.arrays_of(proof)
    for name in sorted(arrays):
        for _ in range(2):
            tried = {**arrays, name: arrays[name].copy()}
            raw = tried[name].view(np.uint8).reshape(-1)
            raw[rng.integers(len(raw))] ^= np.uint8(1 << rng.integers(8))
            for found in verdicts(path, tried):
                if found is not None:  # of the optimum, within said.lower and said.upper
                    assert found.lower <= said.upper
                    assert found.upper >= said.lower


# --- Writing


def test_an_archive_of_poses_is_proven_as_poses(tmp_path):
    graph, _ = random_maps(rng_of(0), 3, 6, 9)
    path = tmp_path / "poses.npz"
    certpgo.write(path, Instance("poses", in_one_unit(graph), np.arange(6)))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    said = write_proof(tmp_path / "p.cert", path, instance, answer.estimate, answer.certificate)
    assert said.about.startswith("chordal cost F, the poses of 6 nodes")
    assert said.lower <= answer.cost * (1.0 + 1e-12) <= said.upper * (1.0 + 2e-12)


def test_estimates_without_scales_have_ones(tmp_path):
    graph = drawn(3, 3, mean=False)
    path, proof, said = proven(tmp_path, graph)
    instance, answer = certpgo.read(path, quiet=True), certpgo.solve(graph)
    ones = Estimate(answer.estimate.rotations, answer.estimate.translations, scales=np.ones(6))
    other = write_proof(proof, path, instance, ones, answer.certificate)
    assert other.lower == pytest.approx(said.lower)
    assert other.upper > said.upper

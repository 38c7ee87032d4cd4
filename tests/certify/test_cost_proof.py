"""Proofs about g2o's cost: written, checked, forged; and the proof tier."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from strategies import definite, dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo import certify, checker, integer_checker
from certpgo.certify import Tier
from certpgo.certify.cost_proof import NOTHING, claimed
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.proof import quaternions
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import lifted
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum, objective_of
from certpgo.objective.complex_relaxation import is_over_complex_numbers
from certpgo.objective.costs.g2o import G2oCost
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.solve.bounding import reproven
from certpgo.solve.minima import local_minimum
from certpgo.solve.proving import of_cost, problem_of_certificate, write_proof

few = settings(max_examples=10, deadline=None)


def text_of(graph, information):
    """A g2o file of these doubles."""
    d, lines = graph.d, []
    upper = np.triu_indices(d * (d + 1) // 2)
    turns = quaternions(graph.rotations)
    for e, (i, j) in enumerate(graph.edges):
        turn = turns[e] if d == 3 else [2.0 * math.atan2(turns[e, 1], turns[e, 0])]
        tag = "EDGE_SE3:QUAT" if d == 3 else "EDGE_SE2"
        numbers = [*graph.translations[e], *turn, *information[e][upper]]
        lines.append(" ".join([tag, str(i), str(j), *(repr(float(x)) for x in numbers)]))
    return "\n".join(lines) + "\n"


def random_file(folder, seed, d, *, n=6, noise=0.05, condition=5.0, cross=True):
    """A file of a random graph with full information matrices, as read."""
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, n, d, noise=noise)
    information = 10.0 * definite(rng, graph.num_edges, d * (d + 1) // 2, condition)
    if not cross:
        information[:, :d, d:] = information[:, d:, :d] = 0.0
    path = folder / "graph.g2o"
    path.write_text(text_of(graph, information))
    return path, certpgo.read(path, quiet=True)


def proven(folder, seed, d, **options):
    path, instance = random_file(folder, seed, d, **options)
    answer = certpgo.solve(instance, cost="g2o")
    proof = folder / "graph.cert"
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    return path, proof, instance, answer, said


@pytest.fixture(params=[2, 3])
def small(request, tmp_path):
    """A small file, the arrays of its proof, and what it proves."""
    path, proof, instance, answer, said = proven(tmp_path, 5, request.param)
    assert answer.verdict.value == "CERTIFIED"
    return path, proofs.arrays_of(proof), said, instance, answer


def tried(path, arrays):
    proof = path.with_name("tried.cert")
    proof.write_bytes(proofs.repacked(arrays))
    return proofs.verdict(path, proof)


# --- What is proven is true


@pytest.mark.parametrize(
    ("name", "gap"),
    [
        ("MIT", 1e-10),
        ("intel", 2e-10),
        ("kitti_00", 5e-7),
        ("smallGrid3D", 1e-12),
        ("parking-garage", 2e-9),
    ],
)
def test_public_optima_are_proven(name, gap, tmp_path, dataset, dataset_path):
    instance, path, proof = dataset(name), dataset_path(name), tmp_path / "proof.cert"
    answer = certpgo.solve(instance, cost="g2o")
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    assert said == checker.check(path, proof)
    assert said.relative_gap <= gap
    assert said.upper == pytest.approx(answer.cost, rel=1e-10)
    kind = "EdgeSE2" if instance.graph.d == 2 else "EdgeSE3:QUAT"
    assert said.about == (
        f"g2o's chi2 of {kind} with full information, the poses of {instance.graph.num_nodes} "
        f"nodes from {instance.graph.num_edges} measurements, parallel edges added"
    )


@given(seeds, dimensions)
@few
def test_what_is_proven_is_true(tmp_path_factory, seed, d):
    _, _, instance, answer, said = proven(tmp_path_factory.mktemp("proof"), seed, d)
    problem = objective_of(instance, "g2o")
    assert said.lower <= said.upper
    low, high = problem.enclosure(answer.estimate)
    assert low * (1 - 1e-13) <= said.upper <= high * (1 + 1e-13)
    rng = rng_of(seed)
    for near in (1e-6, 1e-3, 0.1, 1.0):
        moved = answer.estimate.rotations @ so.exp(
            near * rng.standard_normal((problem.n, so.tangent_dim(d)))
        )
        t = answer.estimate.translations + near * rng.standard_normal((problem.n, d))
        assert said.lower <= problem.cost(Estimate(moved, t))
    if answer.verdict.value == "CERTIFIED":
        assert said.relative_gap < 1e-9


def exact_surrogate(graph, given, multipliers):
    """The certificate matrix of the minorants' sum in rationals, the first pose pinned."""
    d, b = graph.t.shape[1], graph.t.shape[1] + 1
    A = [[Fraction(0)] * (graph.n * b) for _ in range(graph.n * b)]
    for e in range(len(graph.i)):
        i, j = int(graph.i[e]) * b, int(graph.j[e]) * b
        step = [(i + 1 + a, -Fraction(float(given.arms[e, a]))) for a in range(d)]
        terms = [(j, Fraction(1)), (i, Fraction(-1)), *step]
        for p, x in terms:
            for q, y in terms:
                A[p][q] += Fraction(float(given.tau[e])) * x * y
        for a in range(d):
            for p in (i, j):
                A[p + 1 + a][p + 1 + a] += Fraction(float(given.kappa[e]))
            for c in range(d):
                N = Fraction(float(given.couplings[e, a, c]))
                A[i + 1 + a][j + 1 + c] -= N
                A[j + 1 + c][i + 1 + a] -= N
    for node in range(graph.n):
        for a, c, x in zip(*np.triu_indices(d), multipliers[node], strict=True):
            p, q = node * b + 1 + a, node * b + 1 + c
            A[p][q] -= Fraction(float(x))
            if p != q:
                A[q][p] -= Fraction(float(x))
    return [row[1:] for row in A[1:]]


def bounds_of(arrays):
    return checker.EdgeBounds(*(arrays[name] for name in checker.EdgeBounds._fields))


def assert_true(path, arrays, found):
    """The multipliers and constants of an accepted proof prove its lower bound, exactly."""
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    given = bounds_of(arrays)
    assert proofs.is_positive_semidefinite(exact_surrogate(graph, given, arrays["multipliers"]))
    diagonal = np.equal(*np.triu_indices(graph.t.shape[1]))
    terms = [*arrays["multipliers"][:, diagonal].ravel(), *given.constants]
    assert Fraction(found.lower) <= max(sum(Fraction(float(x)) for x in terms), 0)


@given(seeds, dimensions)
@few
def test_the_bound_is_what_multipliers_and_constants_add_up_to(tmp_path_factory, seed, d):
    path, proof, _, _, said = proven(tmp_path_factory.mktemp("proof"), seed, d, n=4)
    assert_true(path, proofs.arrays_of(proof), said)


@pytest.mark.parametrize(
    ("name", "upper", "lower"),
    [
        ("plane", 0.4004706803702266, 0.4004706803690104),
        ("space", 0.34805456638511073, 0.34805456638450405),
    ],
)
def test_proofs_of_before_are_still_ones(name, upper, lower):
    graph = Path(__file__).parents[1] / "data" / "proofs" / f"version2_{name}.g2o"
    said = checker.check(graph, graph.with_suffix(".cert"))
    assert (said.upper, said.lower) == (upper, lower)


# --- Forged and malformed proofs


def changed(rng, arrays):
    """A proof with one array changed."""
    name = rng.choice(sorted(arrays.keys() - {"claim", "order", "delta"}))
    array = arrays[name].copy()
    kind = rng.integers(4)
    if kind == 0:
        raw = array.view(np.uint8).reshape(-1)
        raw[rng.integers(len(raw))] ^= np.uint8(1 << rng.integers(8))
    elif kind == 1:
        i, j = rng.integers(len(array), size=2)
        array[[i, j]] = array[[j, i]]
    elif kind == 2:
        array.flat[rng.integers(array.size)] *= rng.choice([-1.0, 0.3, 30.0, 1 + 1e-9])
    else:
        array += 10.0 ** rng.uniform(-15, 0) * np.abs(array).max() * rng.choice([-1.0, 1.0])
    return {**arrays, name: array}


def test_changed_proofs_prove_nothing_false(small):
    path, arrays, said, _, _ = small
    rng, accepted, alone = rng_of(1), 0, 0
    for _ in range(150):
        found = tried(path, changed(rng, arrays))
        exact = proofs.verdict(path, path.with_name("tried.cert"), integer_checker)
        for one in (found, exact):
            assert one is None or (one.lower <= said.upper and one.upper >= said.lower)
        if found is not None:
            accepted += 1
            assert exact.upper <= found.upper
            assert exact.lower >= found.lower
        alone += found is None and exact is not None
    assert 0 < accepted < 150
    assert alone < 15  # the other factorizes by hints that may be damaged


@pytest.mark.parametrize("share", [1e-12, 1e-9, 1e-3])
def test_raised_constants_and_multipliers_are_refused(small, share):
    path, arrays, said, _, _ = small
    gap = said.upper - said.lower
    for name in ("constants", "multipliers"):
        for k in (0, 1):
            raised = {**arrays, name: arrays[name].copy()}
            raised[name][k, ...] += 2.0 * gap + share * np.abs(arrays["couplings"]).max()
            assert tried(path, raised) is None
            assert proofs.verdict(path, path.with_name("tried.cert"), integer_checker) is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"version": 1}, "version 1, or of version 2"),
        ({"version": 3}, "version 1, or of version 2"),
        ({"cost": None}, "version 1, or of version 2"),
        ({"cost": "gtsam"}, "version 1, or of version 2"),
        ({"cost": ["g2o"]}, "version 1, or of version 2"),
        ({"version": 2.0}, "integers expected"),
        ({"kind": "rotations"}, "the cost of g2o is about poses"),
        ({"kappa": 1.0}, "the cost of g2o is about poses"),
        ({"tau": 1.0}, "the cost of g2o is about poses"),
        ({"rotation_information": "rpy"}, "the cost of g2o is about poses"),
    ],
)
def test_other_claims_are_unreadable(small, change, expected):
    path, arrays, _, _, _ = small
    proof = path.with_name("tried.cert")
    proof.write_bytes(proofs.repacked(proofs.with_claim(arrays, **change)))
    with pytest.raises(checker.Unreadable, match=expected):
        checker.check(path, proof)
    with pytest.raises(integer_checker.Unreadable):
        integer_checker.check(path, proof)


def test_information_is_about_quaternions_in_space_and_angles_in_the_plane(small):
    path, arrays, _, instance, _ = small
    claim = proofs.claim_of(arrays)
    assert (claim["version"], claim["cost"]) == (2, "g2o")
    meant = {2: "tangent", 3: "quaternion"}[instance.graph.d]
    assert claim["rotation_information"] == meant
    other = {2: "quaternion", 3: "tangent"}[instance.graph.d]
    assert tried(path, proofs.with_claim(arrays, rotation_information=other)) is None


def test_arrays_of_other_shapes_and_values_are_refused(small):
    path, arrays, said, _, _ = small
    assert tried(path, arrays) == said
    for name in checker.EdgeBounds._fields:
        array = arrays[name]
        wrong = [array[:-1], array.astype("<f4"), array[..., None]]
        for value in (np.nan, np.inf):
            wrong.append(array.copy())
            wrong[-1].flat[-1] = value
        for other in wrong:
            assert tried(path, {**arrays, name: other}) is None, name
        assert tried(path, {k: v for k, v in arrays.items() if k != name}) is None


def test_proofs_of_version_1_are_not_about_this_cost(small):
    path, arrays, _, _, _ = small
    claim = {k: v for k, v in proofs.claim_of(arrays).items() if k != "cost"}
    text = json.dumps({**claim, "version": 1}).encode()
    found = tried(path, {**arrays, "claim": np.frombuffer(text, dtype=np.uint8)})
    assert found is None or "kappa of the file" in found.about


LINE = "EDGE_SE2 0 1 1 0 0.5 4 0 0.1 4 0 1\n"


@pytest.mark.parametrize(
    "text",
    [
        LINE + "EDGE_SE2 1 2 1 0 0.5\n",
        LINE + "EDGE_SE2 1 2 1 0 0.5 1e999 0 0 1 0 1\n",
        LINE + "EDGE_SE2 1 2 1 0 0.5 1e200 0 0 1 0 1\n",
        "EDGE_SE2 1 2 1 0 0.5\n",
    ],
)
def test_every_measurement_has_information(text):
    claim = {"d": 2, "keep": "all", "kappa": None, "tau": None, "cost": "g2o"}
    with pytest.raises(checker.Unreadable, match="information expected on every measurement"):
        checker.read_graph(text.encode(), claim, None)


def test_matrices_of_1dsfm_have_no_information():
    text = b"0 1 1 0 0 0 1 0 0 0 1 0.1 0.2 0.3\n"
    claim = {"d": 3, "keep": "all", "kappa": None, "tau": None, "cost": "g2o"}
    with pytest.raises(checker.Unreadable, match="information expected on every measurement"):
        checker.read_graph(text, claim, None)


def test_information_is_read_entry_by_entry():
    claim = {"d": 2, "keep": "last", "kappa": None, "tau": None, "cost": "g2o"}
    text = "".join(
        f"EDGE_SE2 {line}\n"
        for line in ("0 1 9 9 0 9 0 0 9 0 9", "5 3 1 -2 0 1 2 3 4 5 6", "0 1 1 0 0 8 0 0 8 0 8")
    )
    graph = checker.read_graph(text.encode(), claim, None)
    # In the order of the file, in which rows of a proof are.
    assert graph.information.tolist() == [
        [[1, 2, 3], [2, 4, 5], [3, 5, 6]],
        [[8, 0, 0], [0, 8, 0], [0, 0, 8]],
    ]
    assert (graph.i.tolist(), graph.j.tolist()) == ([3, 0], [2, 1])
    assert graph.t.tolist() == [[1, -2], [1, 0]]
    assert graph.q.tolist() == [[1.0, 0.0]] * 2
    entries = range(1, 22)
    text = "EDGE_SE3:QUAT 0 1 1 2 3 0 0 0.6 0.8 " + " ".join(map(str, entries))
    graph = checker.read_graph(text.encode(), {**claim, "d": 3}, None)
    assert graph.information[0][np.triu_indices(6)].tolist() == list(entries)
    assert np.array_equal(graph.information[0], graph.information[0].T)
    assert graph.q.tolist() == [[0.0, 0.0, 0.6, 0.8]]


# --- Writing


@pytest.mark.parametrize("keep", ["all", "first", "last"])
def test_proofs_of_files_with_parallel_edges(tmp_path, keep):
    path = tmp_path / "parallel.g2o"
    lines = [
        f"EDGE_SE2 {i} {j} 1 0.{k} 1.5{k} {10 + k} 1 0 {20 + k} 2 {30 + k}"
        for k, (i, j) in enumerate([(0, 1), (1, 2), (2, 3), (1, 0), (3, 0), (0, 1), (2, 1)])
    ]
    path.write_text("\n".join(lines))
    instance = certpgo.read(path, keep=keep, quiet=True)
    answer = certpgo.solve(instance)
    proven = write_proof(tmp_path / "p.cert", path, instance, answer.estimate, answer.certificate)
    # Proofs are over real numbers, of which bounds may be lower.
    assert proven.lower <= answer.certificate.lower_bound * (1.0 + 1e-6)
    if not is_over_complex_numbers(answer.certificate.regions.bound.form):
        assert proven.lower == pytest.approx(answer.certificate.lower_bound, rel=1e-6)
    assert proven.lower <= proven.upper


def test_bounds_of_lower_costs_are_refused_with_the_reason(small):
    path, _, _, instance, answer = small
    support = replace(answer.certificate.support, lowered=True)
    lowered = replace(answer.certificate, support=support)
    with pytest.raises(NumericalError, match="that of a lower cost, without cross terms"):
        write_proof(path.with_name("x.cert"), path, instance, answer.estimate, lowered)


def test_a_proof_of_an_estimate_that_is_not_optimal(small):
    path, _, said, instance, answer = small
    t = answer.estimate.translations.copy()
    t[0] += 0.01
    worse = Estimate(answer.estimate.rotations, t)
    found = write_proof(path.with_name("worse.cert"), path, instance, worse, answer.certificate)
    assert found.lower == said.lower
    assert found.upper > said.upper


def test_only_the_costs_that_the_checker_knows_are_proven(small):
    path, _, _, instance, answer = small
    found = certpgo.solve(instance, cost="gtsam")
    with pytest.raises(InputError, match="the checker does not know the cost of gtsam"):
        write_proof(path.with_name("x.cert"), path, instance, found.estimate, found.certificate)
    problem = problem_of_certificate(instance, answer.certificate)
    assert problem.title == answer.certificate.objective
    graph = checker.read_graph(
        path.read_bytes(), {"d": instance.graph.d, "keep": "all", "cost": "g2o"} | NO_WEIGHTS, None
    )
    for bare in ({"multipliers": None}, {"support": None}):
        with pytest.raises(NumericalError, match="no lower bound above zero"):
            of_cost(problem, graph, replace(answer.certificate, **bare))
    huge = answer.certificate.multipliers + 1e9 * np.eye(instance.graph.d)
    # A point of higher rank, which a proof takes as it is.
    away = lifted(random_estimate(problem), instance.graph.d + 1)
    there = replace(answer.certificate.support, point=away)
    bad = replace(answer.certificate, multipliers=huge, support=there)
    with pytest.raises(NumericalError, match="cannot be proven"):
        of_cost(problem, graph, bad)


def random_estimate(problem):
    rng = rng_of(1)
    R = so.random(rng, problem.n, problem.d)
    return Estimate(R, 9.0 * rng.standard_normal((problem.n, problem.d)))


NO_WEIGHTS = {"kappa": None, "tau": None}


@pytest.mark.parametrize("d", [2, 3])
def test_measurements_without_minorant_count_nothing(d, tmp_path):
    path, instance = random_file(tmp_path, 3, d, n=8, noise=0.2, condition=300.0)
    problem = objective_of(instance, "g2o")
    claim = {"d": d, "keep": "all", "cost": "g2o"} | NO_WEIGHTS
    graph = checker.read_graph(path.read_bytes(), claim, None)
    point = descend(problem, certpgo.solve(instance).estimate).estimate
    below = problem.surrogate(point)
    constants, kept = below.minorants.constant.copy(), below.minorants.exist
    left_out = np.flatnonzero(kept)[[0, 4]]
    constants[left_out], kept[left_out] = -np.inf, False
    fewer = problem.surrogate_of(replace(below.minorants, constant=constants))
    given = claimed(graph, fewer.minorants)
    assert checker.minorants_hold(graph, given).all()
    for e in left_out:
        assert given.tau[e] == given.kappa[e] == 0.0
        assert not given.couplings[e].any()
        assert NOTHING * np.abs(graph.information).max() <= given.constants[e] < 0.0 or (
            given.constants[e] >= 0.0
        )
    everywhere = claimed(graph, below.minorants)
    assert np.array_equal(given.tau[kept], everywhere.tau[kept])
    # Constants are as sharp as half a dozen attempts make them.
    weights = np.abs(everywhere.constants) + 2 * d * everywhere.kappa
    more = everywhere._replace(constants=everywhere.constants + 1e-11 * weights)
    assert checker.minorants_hold(graph, more)[below.minorants.exist].mean() < 0.2


def test_constants_that_are_too_high_are_lowered(small):
    path, _, _, instance, answer = small
    problem = objective_of(instance, "g2o")
    claim = {"d": instance.graph.d, "keep": "all", "cost": "g2o"} | NO_WEIGHTS
    graph = checker.read_graph(path.read_bytes(), claim, None)
    below = problem.surrogate(answer.estimate)
    weights = np.linalg.norm(below.minorants.N, axis=(1, 2))
    high = replace(below.minorants, constant=below.minorants.constant + 1e-12 * weights)
    given = claimed(graph, high)
    assert checker.minorants_hold(graph, given).all()
    higher = replace(below.minorants, constant=below.minorants.constant + weights)
    with pytest.raises(NumericalError, match="no minorant is proven of"):
        claimed(graph, higher)


# --- The proof tier


@given(seeds, dimensions)
@few
def test_the_proof_tier_agrees_with_the_standard_one_and_is_sharper(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 7, d, noise=0.05)
    information = definite(rng, graph.num_edges, d * (d + 1) // 2, 5.0)
    problem = Sum(graph.with_information(information), G2oCost)
    standard = certpgo.solve(problem)
    found = certpgo.solve(problem, tier="proof").certificate
    judged = certify(problem, standard.estimate, tier="proof")
    for proof in (found, judged):
        assert proof.tier is Tier.PROOF
        assert proof.verdict is standard.verdict
        assert proof.lower_bound <= standard.certificate.cost_upper
        if standard.verdict.value == "CERTIFIED":
            assert proof.gap <= standard.certificate.gap


def test_the_bound_of_the_proof_tier_is_what_it_says(small):
    """The surrogate's matrix less the multipliers, which add up to the bound, is not negative."""
    _, _, _, instance, answer = small
    problem = objective_of(instance, "g2o")
    normalized = NormalizedProblem.of(problem, "proof", 1e-5, 1e-12)
    basin = local_minimum(normalized, answer.estimate, False)
    below = normalized.problem.surrogate_of(basin.bound.support.minorants)
    trace = np.einsum("naa->", basin.bound.multipliers)
    assert basin.bound.value == pytest.approx(trace + below.constant, rel=1e-9)
    S = below.problem.certificate_matrix(basin.bound.multipliers).toarray()
    values = np.linalg.eigvalsh(S)
    assert values[0] > -1e-12 * values[-1]
    assert basin.bound.support.point.rotations.shape == basin.point.rotations.shape
    again = reproven(normalized, basin.bound)
    assert again.value == pytest.approx(basin.bound.value, rel=1e-9)


def test_where_rounding_prevents_it_solve_takes_the_proof_tier(dataset):
    instance = dataset("kitti_00")
    asked = {"cost": "g2o", "rtol": 5e-7, "atol": 0.0}
    standard = certpgo.solve(instance, tier="standard", **asked)
    assert standard.verdict.value == "BOUNDED"
    found = certpgo.solve(instance, **asked)
    assert (found.verdict.value, found.certificate.tier) == ("CERTIFIED", Tier.PROOF)
    assert found.certificate.relative_gap < 1e-6
    assert found.certificate.support is not None

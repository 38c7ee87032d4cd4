"""The checker: what it reads, what it accepts, what it must refuse."""

import json
import math
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import checker
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.components import rotations_alone
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.io.exact import circle, information, quaternion
from certpgo.solve.proving import write_proof

U = 2.0**-53
#: How many proofs are damaged, in their arrays and in the container; more on demand.
MUTATIONS = int(os.environ.get("CERTPGO_MUTATIONS", "200"))
FLIPS = max(1000, MUTATIONS // 10)


def made(seed, d, poses, n=5):
    rng = rng_of(seed)
    return pose_graph(rng, n, d)[0] if poses else rotation_graph(rng, n, d)[0]


@pytest.fixture
def small(tmp_path):
    """A small pose graph's file, and the arrays of its proof."""
    path, proof = proofs.proven(tmp_path, made(3, 3, True, n=6))
    return path, proofs.arrays_of(proof)


def tried(path, arrays, name="tried.cert"):
    """What is proven by these arrays, repacked."""
    proof = path.with_name(name)
    proof.write_bytes(proofs.repacked(arrays))
    return proofs.verdict(path, proof)


# --- Reading: the very numbers that the package reads


CLAIM = {"keep": "all", "rotation_information": "tangent", "kappa": None, "tau": None}


def assert_same_graph(graph, mine):
    rotation = graph.rotations_alone if graph.has_positions else graph
    assert mine.n == graph.num_nodes
    assert np.array_equal(np.stack([mine.i, mine.j], axis=1), graph.edges)
    assert np.array_equal(mine.kappa, rotation.kappa)
    stored = (mine.R / 2**checker.POINT).astype(float)
    assert np.abs(stored - rotation.rotations).max() < 8 * U
    if graph.has_positions:
        assert np.array_equal(mine.tau, graph.tau)
        assert np.array_equal(mine.t, graph.translations)


@pytest.mark.parametrize(
    "name", ["smallGrid3D", "sphere2500", "parking-garage", "MIT", "intel", "kitti_00", "burghers"]
)
@pytest.mark.parametrize("options", [{}, {"keep": "last"}])
def test_reads_the_numbers_that_the_package_reads(name, options, dataset, dataset_path):
    instance = dataset(name, **options)
    claim = {**CLAIM, **options, "d": instance.graph.d}
    text = dataset_path(name).read_bytes()
    assert_same_graph(instance.graph, checker.read_graph(text, claim, None))


def test_reads_information_about_quaternions(dataset, dataset_path):
    option = {"rotation_information": "quaternion"}
    mine = checker.read_graph(
        dataset_path("smallGrid3D").read_bytes(), {**CLAIM, **option, "d": 3}, None
    )
    assert_same_graph(dataset("smallGrid3D", **option).graph, mine)


def test_reads_indefinite_information_by_its_diagonal_blocks(dataset, dataset_path):
    text = dataset_path("cubicle").read_bytes()
    assert_same_graph(dataset("cubicle").graph, checker.read_graph(text, {**CLAIM, "d": 3}, None))


def test_reads_the_component_of_a_1dsfm_scene(dataset, dataset_path):
    graph = dataset_path("Ellis_Island")
    texts = [path.read_bytes() for path in (graph, graph.with_name("cc.txt"))]
    mine = checker.read_graph(texts[0], {**CLAIM, "d": 3}, texts[1])
    assert_same_graph(dataset("Ellis_Island").graph, mine)


@given(st.floats(-1e6, 1e6) | st.floats(-1e-300, 1e-300) | st.floats(-7, 7))
def test_half_angles_are_those_of_the_package(theta):
    try:
        found = tuple(checker.half_angles(np.array([theta]))[0].tolist())
    except checker.Unreadable:  # half of the smallest double is a tie but for its cube
        assert abs(theta) < 2.0**-1070
        return
    assert found == circle.half_angle_pair(theta)


decimal = st.floats(-50, 50).map(lambda x: f"{x:.9g}") | st.sampled_from(["0", "1e3", "-2.50E-1"])


@given(st.lists(decimal, min_size=21, max_size=21), st.integers(0, 5))
def test_weights_are_those_of_the_package(words, more):
    for k in (0, 6, 11, 15, 18, 20):
        words[k] = f"{100 + more}.25"  # diagonally dominant, mostly
    text = " ".join(words)
    try:
        wanted = information.weights(text, information.ROW_MAJOR_3D)
    except certpgo.InputError:
        with pytest.raises(ValueError, match="positive definite"):
            checker.weights(tuple(text.encode().split()), checker.harmonic_mean)
    else:
        assert checker.weights(tuple(text.encode().split()), checker.harmonic_mean) == wanted


@given(seeds, st.sampled_from([0.0, np.pi, 1.0]))
def test_quaternions_of_matrices_are_those_of_the_package(seed, angle):
    axis = rng_of(seed).standard_normal(3)
    R = certpgo.linalg.rotations.exp(angle * axis[None] / np.linalg.norm(axis))
    assert checker.shepperd(tuple(R.ravel().tolist())) == tuple(quaternion.from_matrices(R)[0])


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("EDGE_SE2 0 1 0 0", "5 or 11 numbers"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0", "5 or 11 numbers"),
        ("EDGE_SE2 0 1 0 0 x", "numbers"),
        ("EDGE_SE2 0 1 0 0 1_0", "numbers"),
        ("EDGE_SE2 0 1 0 0 0 1 0 --0 1 0 1", "numbers"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0.0.0 1 0 1", "numbers"),
        ("EDGE_SE2 0 1 0 0 2e6", "angle"),
        ("EDGE_SE2 0 1 0 0 1e999", "angle"),
        ("EDGE_SE2 0 1 1e999 0 0", "not finite"),
        ("EDGE_SE2 0 0 0 0 0", "measured from itself"),
        ("EDGE_SE2 0.5 1 0 0 0", "invalid literal"),
        ("EDGE_SE2 0 1 0 0 0 1 0 0 1 0 -1", "positive definite"),
        ("EDGE_SE2 0 1 0 0 0 1e-999 0 0 1 0 1", "range"),
        ("EDGE_SE3:QUAT 0 1 0 0 0 0 0 0 1", "2D"),
        ("SOMETHING 0 1 2", "14 numbers"),
        ("VERTEX_SE2 0 0 0 0", "2D"),
    ],
)
def test_unreadable_lines_are_named(line, expected):
    with pytest.raises(checker.Unreadable, match=expected):
        checker.read_graph(f"# a comment\n{line}\n".encode(), {**CLAIM, "d": 2}, None)


# --- Accepting


RIGOR = {  # relative gaps of the prototype, poses and rotations
    "smallGrid3D": (1.4e-12, 2.7e-13),
    "sphere2500": (1.0e-9, 1.3e-11),
    "torus3D": (1.6e-11, 4.6e-12),
    "parking-garage": (1.8e-7, 1.2e-7),
    "sphere_bignoise_vertex3": (9.6e-13, 2.0e-13),
}


@pytest.mark.parametrize(
    ("name", "rotations"),
    [
        ("smallGrid3D", False),
        ("smallGrid3D", True),
        ("sphere2500", False),
        ("torus3D", True),
        ("parking-garage", False),
        ("parking-garage", True),
        ("sphere_bignoise_vertex3", True),
    ],
    ids=lambda given: {False: "poses", True: "rotations"}.get(given, given),
)
def test_proves_public_optima(name, rotations, tmp_path, dataset, dataset_path):
    instance = dataset(name)
    if rotations:
        instance = rotations_alone(instance)
    answer = certpgo.solve(instance.graph, cost="chordal")
    path, proof = dataset_path(name), tmp_path / "proof.cert"
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    assert said == checker.check(path, proof)
    assert said.relative_gap <= RIGOR[name][rotations]
    assert said.upper == pytest.approx(answer.cost, rel=1e-9)
    assert proof.stat().st_size <= 140 * instance.graph.num_nodes + 2000


@pytest.mark.parametrize("name", ["kitti_00"])
def test_proves_long_loops(name, tmp_path, dataset, dataset_path):
    instance = dataset(name)
    answer = certpgo.solve(instance.graph, cost="chordal")
    proven = instance, answer.estimate, answer.certificate
    assert write_proof(tmp_path / "proof.cert", dataset_path(name), *proven).relative_gap < 1e-7


def test_a_proof_of_before_is_still_one():
    # Its delta was what a factor in doubles needs.
    graph = Path(__file__).parent / "data" / "proofs" / "version1.g2o"
    said = checker.check(graph, graph.with_suffix(".cert"))
    assert (said.upper, said.lower) == (109.45796947832517, 109.45796947627348)


@given(seeds, dimensions, st.booleans())
@settings(max_examples=40)
def test_what_is_proven_is_true(tmp_path_factory, seed, d, poses):
    path, proof = proofs.proven(tmp_path_factory.mktemp("proof"), made(seed, d, poses))
    said = checker.check(path, proof)
    arrays = proofs.arrays_of(proof)
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    cost = proofs.exact_cost(
        graph, proofs.measured_by(path), arrays["rotations"], arrays.get("translations")
    )
    assert cost <= Fraction(said.upper) <= cost * Fraction(1 + 1e-9) + Fraction(1, 10**20)
    assert proofs.is_positive_semidefinite(
        proofs.exact_matrix(graph, proofs.measured_by(path), arrays["multipliers"], poses)
    )
    diagonal = np.equal(*np.triu_indices(d))
    trace = sum(Fraction(float(x)) for x in arrays["multipliers"][:, diagonal].ravel())
    assert Fraction(said.lower) <= max(trace, 0)
    assert said.relative_gap < 1e-9


@given(seeds, dimensions, st.booleans(), st.floats(-17, -13), st.booleans())
@settings(max_examples=60)
def test_at_the_edge_only_what_is_positive_semidefinite_passes(
    tmp_path_factory, seed, d, poses, digits, add
):
    # Multipliers raised or lowered by about what rounding can tell, in one entry.
    path, proof = proofs.proven(tmp_path_factory.mktemp("edge"), made(seed, d, poses, n=4))
    arrays = proofs.arrays_of(proof)
    rng = rng_of(seed)
    k = tuple(rng.integers(arrays["multipliers"].shape))
    size = np.abs(arrays["multipliers"]).max() * 10.0**digits
    arrays["multipliers"][k] += size if add else -size
    if tried(path, arrays) is not None:
        graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
        A = proofs.exact_matrix(graph, proofs.measured_by(path), arrays["multipliers"], poses)
        assert proofs.is_positive_semidefinite(A)


def test_a_quaternion_of_another_norm_is_the_same_rotation(small):
    path, arrays = small
    said = tried(path, arrays)
    for factor in (4.0, -1.0, 2.0**-900, 2.0**900):
        arrays["rotations"][2] *= factor
        assert tried(path, arrays) == said


def test_weaker_multipliers_prove_less(small):
    path, arrays = small
    said = tried(path, arrays)
    arrays["multipliers"][:, 0] -= 1e-3 * said.lower
    weaker = tried(path, arrays)
    assert weaker is not None
    assert weaker.lower < said.lower


@pytest.mark.parametrize("factor", [0.0, 0.3, 30.0, -1.0])
def test_delta_is_a_hint(small, factor):
    path, arrays = small
    said = tried(path, arrays)
    arrays["delta"] = (factor * arrays["delta"]).astype("<f4")
    assert tried(path, arrays) in (said, None)


@pytest.mark.parametrize("poses", [False, True])
@pytest.mark.parametrize("k", [-40, -7, 1, 40])
def test_the_scale_of_the_weights_changes_nothing(tmp_path, poses, k):
    graph = made(5, 3, poses, n=7)
    weights = (graph.rotations_alone if poses else graph).kappa
    factor = 2.0**k
    scaled = (
        graph.with_weights(factor * weights, factor * graph.tau)
        if poses
        else graph.with_weights(factor * weights)
    )
    (path, proof), (path_k, proof_k) = (
        proofs.proven(tmp_path, g, name) for g, name in ((graph, "one"), (scaled, "other"))
    )
    one, other = proofs.arrays_of(proof), proofs.arrays_of(proof_k)
    assert one.keys() == other.keys()
    for name in one.keys() - {"claim", "multipliers"}:
        assert np.array_equal(one[name], other[name]), name
    assert np.array_equal(factor * one["multipliers"], other["multipliers"])
    a, b = checker.check(path, proof), checker.check(path_k, proof_k)
    assert (b.upper, b.lower) == (factor * a.upper, factor * a.lower)
    assert a.relative_gap == b.relative_gap


def test_what_is_printed_is_rounded_outwards():
    said = str(checker.Answer(1.0 + 2.0**-52, 1.0 - 2.0**-53))
    assert said == (
        "PROVED: F(x) <= 1.00000000000001, F* >= 0.999999999999999, relative gap <= 3.4e-16"
    )
    assert checker.Answer(0.0, 0.0).relative_gap == 0.0
    assert checker.Answer(2.0, 0.0).relative_gap == 1.0


# --- Refusing


def test_a_raised_multiplier_is_refused(small):
    path, arrays = small
    said = tried(path, arrays)
    gap = said.upper - said.lower
    for k in np.flatnonzero(np.equal(*np.triu_indices(3))):
        raised = {**arrays, "multipliers": arrays["multipliers"].copy()}
        raised["multipliers"][1, k] += 3.0 * gap / 3.0 + 1e-9 * said.lower
        assert tried(path, raised) is None


def test_multipliers_without_their_shift_are_refused(small):
    path, arrays = small
    graph = certpgo.read(path, quiet=True).graph
    answer = certpgo.solve(graph)
    Lam = certpgo.Quadratic(graph).multipliers(answer.estimate)
    rows, columns = np.triu_indices(3)
    gap = 1e-13 * np.abs(Lam).max()
    arrays["multipliers"] = Lam[:, rows, columns] + gap * np.equal(rows, columns)
    assert tried(path, arrays) is None


@pytest.mark.parametrize("old", ["1.0", "EDGE"])
def test_another_problem_is_refused(small, old):
    path, arrays = small
    text = path.read_text()
    path.write_text(text + "\n" if old not in text else text.replace(old, f" {old}", 1))
    proof = path.with_name("tried.cert")
    proof.write_bytes(proofs.repacked(arrays))
    with pytest.raises(checker.Refused, match="SHA-256"):
        checker.check(path, proof)


def test_a_changed_problem_with_its_own_hash_is_refused(small):
    import hashlib

    path, arrays = small
    text = path.read_text().split("\n")
    words = text[-2].split()
    words[2], words[3] = str(float(words[2])), str(float(words[3]) + 0.5)
    path.write_text("\n".join([*text[:-2], " ".join(words[:2] + text[-2].split()[2:]), ""]))
    path.write_text(path.read_text().replace(text[-2], _turned(text[-2])))
    sha = hashlib.sha256(path.read_bytes()).hexdigest()
    assert tried(path, proofs.with_claim(arrays, graph_sha256=sha)) is None


def _turned(line):
    """An edge with its quaternion turned by half a radian."""
    words = line.split()
    q = np.array(words[6:10], dtype=float)
    s, c = math.sin(0.25), math.cos(0.25)
    turned = quaternion.product(q[None], np.array([[s, 0.0, 0.0, c]]))[0]
    return " ".join([*words[:6], *map(repr, turned.tolist()), *words[10:]])


@pytest.mark.parametrize("rig", ["identity", "garbage", "nan", "huge", "true root"])
def test_a_rigged_factorization_proves_nothing_false(tmp_path, monkeypatch, rig):
    # A wound-up cycle: the certificate matrix of its multipliers is indefinite.
    instance, wound = winding_cycle(12, 0.0, 1)
    path = tmp_path / "cycle.g2o"
    certpgo.write(path, instance.graph)
    Lam = certpgo.Quadratic(instance.graph).multipliers(wound)
    rows, columns = np.triu_indices(3)
    _, proof = proofs.proven(tmp_path, instance.graph)
    arrays = proofs.arrays_of(proof)
    arrays["multipliers"] = Lam[:, rows, columns] - 1e-9 * np.equal(rows, columns)
    sha = proofs.claim_of(proofs.arrays_of(_reproved(path, tmp_path)))["graph_sha256"]
    arrays = proofs.with_claim(arrays, graph_sha256=sha)
    made_up = {
        "identity": lambda A: np.eye(A.shape[-1]) + 0.0 * A,
        "garbage": lambda A: np.tril(np.random.default_rng(0).standard_normal(A.shape)),
        "nan": lambda A: np.full(A.shape, np.nan),
        "huge": lambda A: 1e200 * np.eye(A.shape[-1]) + 0.0 * A,
        "true root": lambda A: np.eye(A.shape[-1]) * np.sqrt(np.abs(A)),
    }[rig]
    monkeypatch.setattr(np.linalg, "cholesky", made_up)
    assert tried(path, arrays) is None


def _reproved(path, folder):
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance.graph, cost="chordal")
    write_proof(folder / "own.cert", path, instance, answer.estimate, answer.certificate)
    return folder / "own.cert"


def test_arrays_of_other_shapes_kinds_or_values_are_refused(small):
    path, arrays = small
    assert tried(path, arrays) is not None
    for name in arrays.keys() - {"claim"}:
        array = arrays[name]
        for other in (array[:-1], array[::-1][:0], array.astype("<f2"), array.astype(">f8")):
            assert tried(path, {**arrays, name: other}) is None
        assert tried(path, {k: v for k, v in arrays.items() if k != name}) is None
        if array.dtype.kind == "f":
            for value in (np.nan, np.inf, -np.inf):
                other = array.copy()
                other.flat[-1] = value
                assert tried(path, {**arrays, name: other}) is None
    for order in ([0, 0, 1, 2, 3, 4], [0, 1, 2, 3, 4, 6], [-1, 0, 1, 2, 3, 4]):
        assert tried(path, {**arrays, "order": np.array(order, dtype="<i4")}) is None
    rows = np.roll(np.arange(6), 1)
    assert tried(path, {**arrays, "multipliers": arrays["multipliers"][rows]}) is None
    zero = arrays["rotations"].copy()
    zero[0] = 0.0
    assert tried(path, {**arrays, "rotations": zero}) is None


@pytest.mark.parametrize(
    "change",
    [
        {"format": "another"},
        {"version": 2},
        {"kind": "points"},
        {"d": 2},
        {"d": 7},
        {"keep": "some"},
        {"kappa": -1.0},
        {"kappa": "x"},
        {"tau": 0.0},
        {"tau": 1e999},
        {"kind": "rotations"},
        {"rotation_information": "quaternion"},
        {"kappa": 1e-3},
        {"pin": 6},
        {"pin": -1},
        {"exponent": 10**6},
        {"component_sha256": "0" * 64},
    ],
    ids=str,
)
def test_other_claims_are_refused(small, change):
    path, arrays = small
    assert tried(path, proofs.with_claim(arrays, **change)) is None


def test_any_order_and_pin_and_exponent_will_do(small):
    path, arrays = small
    said = tried(path, arrays)
    for pin, exponent in ((0, 0), (5, 3), (2, -3)):
        for order in (np.arange(6), np.arange(6)[::-1]):
            other = {**arrays, "order": order.astype("<i4")}
            found = tried(path, proofs.with_claim(other, pin=pin, exponent=exponent))
            assert found in (said, None)
    assert tried(path, {**arrays, "order": np.arange(6, dtype="<i4")}) == said


def _mutated(rng, arrays):
    """A proof with bits flipped, rows swapped, or numbers scaled, in one array."""
    name = rng.choice(sorted(arrays.keys() - {"claim"}))
    array = arrays[name].copy()
    kind = rng.integers(4)
    if kind == 0:
        raw = array.view(np.uint8).reshape(-1)
        raw[rng.integers(len(raw))] ^= np.uint8(1 << rng.integers(8))
    elif kind == 1:
        i, j = rng.integers(len(array), size=2)
        array[[i, j]] = array[[j, i]]
    elif kind == 2 and array.dtype.kind == "f":
        array.flat[rng.integers(array.size)] *= array.dtype.type(rng.choice([0.3, 30.0, 1 + 1e-9]))
    elif array.dtype.kind == "f":
        array += array.dtype.type(10.0 ** rng.uniform(-12, 0)) * np.abs(array).max()
    return {**arrays, name: array}


def assert_nothing_false(path, arrays, said):
    """Whatever is proven is true: the best cost known is no smaller than the lower bound."""
    found = tried(path, arrays)
    if found is None:
        return False
    assert found.lower <= said.upper
    assert found.upper >= said.lower
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    cost = proofs.exact_cost(
        graph, proofs.measured_by(path), arrays["rotations"], arrays.get("translations")
    )
    assert cost <= Fraction(found.upper)
    return True


def test_mutations_prove_nothing_false(small):
    path, arrays = small
    said = tried(path, arrays)
    rng = rng_of(1)
    accepted = sum(
        assert_nothing_false(path, _mutated(rng, arrays), said) for _ in range(MUTATIONS)
    )
    assert 0 < accepted < MUTATIONS


def test_flips_in_the_container_prove_nothing_false(small):
    path, arrays = small
    said, whole = tried(path, arrays), proofs.repacked(arrays)
    rng, proof = rng_of(2), path.with_name("flipped.cert")
    for _ in range(FLIPS):
        flipped = bytearray(whole)
        flipped[rng.integers(len(flipped))] ^= 1 << int(rng.integers(8))
        proof.write_bytes(flipped)
        found = proofs.verdict(path, proof)
        assert found is None or (found.lower <= said.upper and found.upper >= said.lower)
    proof.write_bytes(whole[: len(whole) // 2])
    assert proofs.verdict(path, proof) is None


def test_a_disconnected_graph_of_poses_is_refused(tmp_path):
    graph = made(1, 3, True)
    two = PoseGraph(
        RotationGraph(
            2 * graph.num_nodes,
            np.concatenate([graph.edges, graph.edges + graph.num_nodes]),
            np.tile(graph.rotations, (2, 1, 1)),
            np.tile(graph.kappa, 2),
        ),
        np.tile(graph.translations, (2, 1)),
        np.tile(graph.tau, 2),
    )
    path, proof = proofs.proven(tmp_path, graph)
    arrays = proofs.arrays_of(proof)
    both = tmp_path / "both.g2o"
    certpgo.write(both, two)
    import hashlib

    sha = hashlib.sha256(both.read_bytes()).hexdigest()
    doubled = {name: np.concatenate([a, a]) for name, a in arrays.items() if name != "claim"}
    doubled["order"] = np.concatenate([arrays["order"], arrays["order"] + graph.num_nodes])
    doubled["order"] = doubled["order"].astype("<i4")
    doubled["claim"] = arrays["claim"]
    found = tried(both, proofs.with_claim(doubled, graph_sha256=sha))
    # The other component's translation is not pinned: whatever passes must be true all the same.
    assert found is None or found.lower <= 2.0 * checker.check(path, proof).upper


# --- By itself


def test_works_as_a_file_by_itself(small, tmp_path):
    path, arrays = small
    proof = path.with_name("own.cert")
    proof.write_bytes(proofs.repacked(arrays))
    alone = tmp_path / "alone"
    alone.mkdir()
    program = alone / "check.py"
    program.write_bytes(Path(checker.__file__).read_bytes())
    code = (
        "import runpy, sys; sys.argv = sys.argv[1:]\n"
        "try: runpy.run_path(sys.argv[0], run_name='__main__')\n"
        "finally: assert not {'certpgo', 'scipy'} & set(sys.modules), 'not by itself'"
    )

    def run(*arguments):
        command = [sys.executable, "-c", code, str(program), *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, cwd=alone, timeout=60)

    done, said = run(path, proof), checker.check(path, proof)
    assert (done.returncode, done.stdout, done.stderr) == (
        0,
        f"{said}\nabout chordal cost F, the poses of 6 nodes from 17 measurements, kappa of the "
        "file, tau of the file, rotational information read as tangent, parallel edges added\n",
        "",
    )
    refused = run(path, path)
    assert refused.returncode == 1
    assert "not a readable proof" in refused.stderr
    proof.write_bytes(proofs.repacked({**arrays, "delta": arrays["delta"] - 1}))
    refused = run(path, proof)
    assert refused.returncode == 6
    assert refused.stdout.startswith("REFUSED: ")
    assert run(path).returncode == 2
    assert run(tmp_path / "nowhere", proof).returncode == 1


def test_the_claim_is_json_that_anyone_can_read(small):
    _, arrays = small
    claim = json.loads(bytes(arrays["claim"]))
    assert claim["format"] == "certpgo proof"
    assert claim["kind"] == "poses"


# --- What was tried against it


LINE = "EDGE_SE2 0 1 1 0 0.5 1 0 0 1 0 1"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("VERTEX_SE2 0 0 0 0\rEDGE_SE2 7 8 0 0 0\n", "plain text"),
        ("VERTEX_SE2 0 0 0 0 \x0bEDGE_SE2 7 8 0 0 0\n", "plain text"),
        ("VERTEX_SE2 0 0 0 0 \u2028EDGE_SE2 7 8 0 0 0\n", "plain text"),
        ("# \rEDGE_SE2 7 8 0 0 0\n", "plain text"),
        ("0 1 1 0 0 0 1 0 0 0 1 0 0 0\n", "2D"),
        ("EDGE_SE2 1 2 0 0 0 .+5 0 0 1 0 1\n", "decimal"),
        ("EDGE_SE2 1 2 0 0 0 1e 0 0 1 0 1\n", "decimal"),
        ("EDGE_SE2 1 2 0 0 0 1 0 0 . 0 1\n", "decimal"),
        ("EDGE_SE2 1 2 0 0 \u0661\n", "plain text"),
        ("EDGE_SE2 1 2 0 0 0 1e-300 0 0 1 0 1e-300\n", "tiny"),
    ],
)
def test_no_line_is_read_as_something_else(text, expected):
    with pytest.raises(checker.Unreadable, match=expected):
        checker.read_graph(f"{LINE}\n{text}".encode(), {**CLAIM, "d": 2}, None)


@pytest.mark.parametrize(
    ("ids", "matrix", "expected"),
    [
        ("9007199254740993 1.0", "1 0 0 0 1 0 0 0 1", "invalid literal"),
        ("0 1.00000000000000001", "1 0 0 0 1 0 0 0 1", "invalid literal"),
        ("0 1", "0 0 0 0 0 0 0 0 0", "rotation matrix"),
        ("0 1", "-1 0 0 0 -1 0 0 0 -1", "rotation matrix"),
        ("0 1", "2 0 0 0 2 0 0 0 2", "rotation matrix"),
    ],
)
def test_1dsfm_lines_are_rotations_between_integers(ids, matrix, expected):
    with pytest.raises(checker.Unreadable, match=expected):
        checker.read_graph(f"{ids} {matrix} 0 0 1\n".encode(), {**CLAIM, "d": 3}, None)


def test_large_ids_stay_apart():
    text = "".join(f"{k} {k + 1} 1 0 0 0 1 0 0 0 1 0 0 1\n" for k in range(2**53, 2**53 + 3))
    graph = checker.read_graph(text.encode(), {**CLAIM, "d": 3}, None)
    assert graph.n == 4
    assert graph.i.tolist() == [0, 1, 2]


def test_row_sums_do_not_underflow():
    # A strong edge beside a weak cycle, wound up: its weights in row sums would vanish.
    R = [circle.half_angle_pair(2 * math.pi / 3)] * 3
    graph = checker.Graph(
        n=5,
        i=np.array([0, 1, 2, 3]),
        j=np.array([1, 2, 0, 4]),
        R=checker.rotations(np.array([*R, (1.0, 0.0)])),
        t=np.zeros((4, 2)),
        kappa=np.array([2.0**-1060] * 3 + [2.0**1000]),
        tau=np.ones(4),
    )
    proof = checker.Proof(
        q=np.array([[1.0, 0.0]] * 5),
        t=None,
        multipliers=np.zeros((5, 3)),
        order=np.arange(5),
        delta=np.zeros(10),
        pin=0,
        exponent=0,
    )
    with pytest.raises(checker.Refused, match="uneven"):
        checker.certificate_matrix(graph, proof)


@pytest.mark.parametrize(
    "change",
    [{"pin": True}, {"pin": 1.0}, {"pin": "1"}, {"exponent": 0.5}, {"d": 3.0}, {"version": True}],
    ids=str,
)
def test_integers_are_integers(small, change):
    path, arrays = small
    assert tried(path, proofs.with_claim(arrays, **change)) is None


def test_the_objective_is_said(small):
    path, arrays = small
    said = tried(path, proofs.with_claim(arrays, kappa=1e-30, tau=1e-30))
    assert said is None or "kappa 1e-30, tau 1e-30" in said.about
    assert "kappa of the file" in tried(path, arrays).about


def test_compressed_arrays_are_refused(small):
    path, arrays = small
    proof = path.with_name("small.cert")
    with proof.open("wb") as file:
        np.savez_compressed(file, **arrays)
    with pytest.raises(checker.Unreadable, match="compressed"):
        checker.check(path, proof)


def test_a_proof_that_needs_too_much_memory_is_refused(small, monkeypatch):
    path, arrays = small
    proof = path.with_name("large.cert")
    proof.write_bytes(proofs.repacked(arrays))

    def exhausted(*arguments):
        raise MemoryError

    monkeypatch.setattr(checker, "residual", exhausted)
    with pytest.raises(checker.Refused, match="memory"):
        checker.check(path, proof)

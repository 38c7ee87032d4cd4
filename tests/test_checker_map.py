"""The checker on graphs with landmarks and priors: what it reads, accepts and must refuse."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import InputError, checker
from certpgo.certify.proof import exact_graph, prove
from certpgo.errors import FormatError
from certpgo.io.datasets.synthetic import helix
from certpgo.io.exact.circle import half_angle_pair
from certpgo.io.precision_kind import position_weights
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.proving import write_proof

#: How many proofs of the small graph are damaged.
MUTATIONS = 300
CLAIM = {"keep": "all", "rotation_information": "tangent", "kappa": None, "tau": None}
MAP = {"landmarks": True, "priors": True}


def map_text(seed, d, poses=4, points=3, odometry=True, priors=2, whole=False, far=0.0):
    """A g2o file of a few poses that see all points, and of which some are measured."""
    rng = rng_of(seed)
    R = so.exp(rng.standard_normal((poses, 1 if d == 2 else 3)))
    t, p = rng.uniform(-3, 3, (poses, d)), rng.uniform(-3, 3, (points, d))
    lines = []

    def noisy(x):
        return " ".join(repr(float(v)) for v in x + 0.05 * rng.standard_normal(len(x)))

    def turned(Q):
        if d == 2:
            return repr(float(np.arctan2(Q[1, 0], Q[0, 0]) + 0.05 * rng.standard_normal()))
        q = certpgo.io.exact.quaternion.to_write(Q[None])[0]
        return " ".join(repr(float(v)) for v in q + 0.02 * rng.standard_normal(4))

    square = "4 0.5 3" if d == 2 else "4 0.5 0.25 3 0.125 5"
    full = "5 0 0 5 0 9" if d == 2 else f"5 0 0 0 0 0 5 0 0 0 0 5 0 0 0 {'9 0 0 9 0 9'}"
    sensor = "" if d == 2 else " 0"
    for k in range(poses if odometry else 0):
        i, j = k, (k + 1) % poses
        step = f"{noisy(R[i].T @ (t[j] - t[i]))} {turned(R[i].T @ R[j])}"
        lines.append(f"{'EDGE_SE2' if d == 2 else 'EDGE_SE3:QUAT'} {i} {j} {step} {full}")
    for k in range(poses):
        for m in range(points):
            tag = "EDGE_SE2_XY" if d == 2 else "EDGE_SE3_TRACKXYZ"
            seen = noisy(R[k].T @ (p[m] - t[k]))
            lines.append(f"{tag} {k} {poses + m}{sensor} {seen} {square}")
    for k in range(priors):
        where = noisy(t[k] + far)
        if whole:
            tag = "EDGE_PRIOR_SE2" if d == 2 else "EDGE_SE3_PRIOR"
            lines.append(f"{tag} {k}{sensor} {where} {turned(R[k])} {full}")
        else:
            tag = "EDGE_SE2_GPS" if d == 2 else "EDGE_SE3_XYZPRIOR"
            lines.append(f"{tag} {k}{sensor} {where} {square}")
    return "\n".join(lines) + "\n"


def proven(path, cost="chordal"):
    """The path of a proof of the optimum of a g2o file, with its instance."""
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, cost=cost)
    proof = path.with_suffix(".cert")
    write_proof(proof, path, instance, answer.estimate, answer.certificate)
    return proof, instance


def tried(path, arrays):
    proof = path.with_name("tried.cert")
    proof.write_bytes(proofs.repacked(arrays))
    return proofs.verdict(path, proof)


def measured_by(path, graph):
    """The measured rotations in rationals, in the checker's order; the identity of positions."""
    d, found, whole = graph.t.shape[1], [], []
    for words in map(str.split, path.read_text().splitlines()):
        if words[0] in ("EDGE_SE2", "EDGE_SE3:QUAT"):
            found.append(words[3 + d :])
        elif words[0] in ("EDGE_PRIOR_SE2", "EDGE_SE3_PRIOR"):
            whole.append(words[2 + (d == 3) + d :])
    texts = iter(found + whole)
    identity = [[Fraction(int(a == b)) for b in range(d)] for a in range(d)]
    found = []
    for kappa in graph.kappa:
        words = next(texts) if kappa > 0 else None
        if words is None:
            found.append(identity)
        elif d == 2:
            found.append(proofs.exact_rotation(half_angle_pair(float(words[0]))))
        else:
            found.append(proofs.exact_rotation(map(float, words[:4])))
    return found


def assert_same_graph(instance, mine):
    graph = instance.graph
    assert mine.n == graph.num_nodes
    assert np.array_equal(np.stack([mine.i, mine.j], axis=1), graph.edges)
    assert np.array_equal(mine.kappa, graph.kappa)
    assert np.array_equal(mine.tau, graph.tau)
    assert np.array_equal(mine.t, graph.translations)
    points = graph.is_point
    assert np.array_equal(np.zeros(mine.n, bool) if mine.points is None else mine.points, points)
    stored = (mine.R / 2**checker.POINT).astype(float)
    assert np.abs(stored - graph.rotations).max() < 2.0**-49
    world = -1 if instance.world is None else instance.world
    assert mine.priors == np.count_nonzero(graph.edges[:, 0] == world)


# --- Reading


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("options", [{}, {"keep": "last"}, {"keep": "first"}])
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("far", [0.0, 4.0e5])
def test_reads_the_graph_that_the_package_reads(tmp_path, d, options, whole, far):
    path = tmp_path / "map.g2o"
    text = map_text(d, d, whole=whole, far=far)
    path.write_text(text + text)  # parallel edges
    instance = certpgo.read(path, quiet=True, **options)
    origin = None if instance.origin is None else instance.origin.tolist()
    assert (origin is None) == (far == 0.0)
    claim = {**CLAIM, **MAP, **options, "d": d, "origin": origin}
    assert_same_graph(instance, checker.read_graph(path.read_bytes(), claim, None))
    for name in MAP:
        fewer = certpgo.read(path, quiet=True, **options, **{name: False})
        claim = {**CLAIM, **MAP, **options, "d": d, "origin": origin, name: False}
        assert_same_graph(fewer, checker.read_graph(path.read_bytes(), claim, None))


@pytest.mark.parametrize(
    "name", ["cityTrees_reduced_1k", "victoriaPark_reduced_1k", "cityTrees10000"]
)
def test_reads_public_maps_as_the_package_does(name, dataset, dataset_path):
    mine = checker.read_graph(dataset_path(name).read_bytes(), {**CLAIM, **MAP, "d": 2}, None)
    assert_same_graph(dataset(name), mine)


def test_points_apart_follow_all_others_as_in_the_package(tmp_path):
    path = tmp_path / "apart.g2o"
    edges = "EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 2 1 0 0\nEDGE_SE2_XY 0 9 1 1\nEDGE_PRIOR_SE2_XY 2 1 1\n"
    for numbers in ((5, 6), (1, 2), (9, 10)):
        seen = "".join(f"LANDMARK2 {k} {m} 1 0\n" for k, m in zip((0, 2), numbers, strict=True))
        path.write_text(edges + seen)
        instance = certpgo.read(path, quiet=True)
        mine = checker.read_graph(path.read_bytes(), {**CLAIM, **MAP, "d": 2}, None)
        assert_same_graph(instance, mine)


number = st.floats(-5, 5).map(lambda x: f"{x:.9g}") | st.sampled_from(["0", "1e0", "-2.50E-1"])


@given(st.lists(number, min_size=6, max_size=6), dimensions, st.integers(5, 20))
def test_weights_of_positions_are_those_of_the_package(words, d, more):
    words = words[: d * (d + 1) // 2]
    for k in (0, 2) if d == 2 else (0, 3, 5):
        words[k] = f"{more + k}.25"
    text = " ".join(words).encode()
    try:
        wanted = position_weights(d, [text], "information")[0][0]
    except InputError:
        with pytest.raises(ValueError, match="positive definite"):
            checker.harmonic_mean(text.split(), 1)
    else:
        assert checker.harmonic_mean(text.split(), 1) == wanted


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("EDGE_SE2_XY 0 1 1 1", "node 1 is a pose and a point"),
        ("EDGE_SE2_XY 0 0 1 1", "node 0 is a pose and a point"),
        ("EDGE_SE2_XY 0 7 1", "4 or 7 numbers"),
        ("EDGE_SE2_XY", "4 or 7 numbers"),
        ("EDGE_SE2_XY 0 7 1 1 1 9 1", "positive definite"),
        ("EDGE_SE2_XY 0 7 1 1 1e-399 0 1e-399", "neither tiny"),
        ("LANDMARK2 0 1 1 1\nLANDMARK2 0 -1 1 1", "points from 0"),
        ("EDGE_PRIOR_SE2 0 1 1 0 0 0", "4 or 10 numbers"),
        ("EDGE_PRIOR_SE2 0 1 1 0 1 0 0 1 0 1e-399", "neither tiny"),
        ("EDGE_SE2_GPS 0 1 1_0", "numbers"),
        ("EDGE_SE3_XYZPRIOR 0 0 1 1 1", "2D"),
    ],
)
def test_unreadable_lines_are_named(line, expected):
    text = f"EDGE_SE2 0 1 1 0 0\n{line}\n".encode()
    with pytest.raises(checker.Unreadable, match=expected):
        checker.read_graph(text, {**CLAIM, **MAP, "d": 2}, None)
    assert checker.read_graph(text, {**CLAIM, "d": 2}, None).n == 2


@pytest.mark.parametrize(
    ("sensors", "use", "readable"),
    [
        ("", 0, True),
        ("", 1, False),
        ("PARAMS_SE3OFFSET 1 0 0 0 0 0 0 1\n", 1, True),
        ("PARAMS_SE3OFFSET 0 0 0 1 0 0 0 1\n", 0, False),
        ("PARAMS_SE3OFFSET 1 0 0 0 1 0 0 1\n", 1, False),
        ("PARAMS_SE3OFFSET 1 0 0 0 0 0 0 0\n", 1, False),
        ("PARAMS_SE3OFFSET 1 0 0 0 0 0 0 1\nPARAMS_SE3OFFSET 1 1 0 0 0 0 0 1\n", 1, False),
        ("PARAMS_SE3OFFSET 2 1 0 0 0 0 0 1\n", 0, True),
    ],
)
def test_sensors_are_at_the_origin_of_their_body(sensors, use, readable):
    text = "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1\n" + sensors
    for line in (f"EDGE_SE3_TRACKXYZ 0 7 {use} 1 1 1", f"EDGE_SE3_PRIOR 0 {use} 1 1 1 0 0 0 1"):
        whole = f"{text}{line}\n".encode()
        if readable:
            assert checker.read_graph(whole, {**CLAIM, **MAP, "d": 3}, None).n == 3
        else:
            with pytest.raises(checker.Unreadable, match="not known to be at its body's origin"):
                checker.read_graph(whole, {**CLAIM, **MAP, "d": 3}, None)


# --- Accepting


@pytest.mark.parametrize(
    ("name", "landmarks"), [("cityTrees_reduced_1k", 66), ("victoriaPark_reduced_1k", 48)]
)
def test_proves_public_maps(name, landmarks, tmp_path, dataset, dataset_path):
    instance, path, proof = dataset(name), dataset_path(name), tmp_path / "map.cert"
    answer = certpgo.solve(instance.graph, cost="chordal")
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    assert said == checker.check(path, proof)
    assert said.relative_gap < 1e-10
    assert said.upper == pytest.approx(answer.cost, rel=1e-9)
    assert f"with {landmarks} landmarks" in said.about
    assert "priors" not in said.about
    # The proof tier without a file knows them too.
    proven = certpgo.certify(Quadratic(instance.graph), answer.estimate, tier="proof")
    assert proven.verdict is certpgo.Verdict.CERTIFIED
    assert proven.gap < 1e-9 * proven.cost_upper
    assert not proven.multipliers[instance.graph.is_point].any()


@pytest.mark.parametrize("far", [0.0, 5.0e5])
def test_proves_positions_of_a_satellite_system(tmp_path, far):
    path, rng = tmp_path / "helix.g2o", np.random.default_rng(0)
    made = helix(6, rng)
    certpgo.write(path, made.graph)
    fixes = made.truth.translations + far + 0.05 * rng.standard_normal((36, 3))
    lines = [
        f"EDGE_SE3_XYZPRIOR {k} 0 {' '.join(map(repr, fixes[k].tolist()))} 400 0 0 400 0 400\n"
        for k in range(0, 36, 2)
    ]
    path.write_text(path.read_text() + "".join(lines))
    proof, instance = proven(path)
    said = checker.check(path, proof)
    assert (instance.origin is None) == (far == 0.0)
    assert said.relative_gap < 1e-9
    assert "of 37 nodes" in said.about
    assert "with 18 priors" in said.about


def test_proves_positions_of_a_planar_robot(tmp_path, dataset, dataset_path):
    graph = dataset("intel").graph
    truth, rng = certpgo.solve(graph).estimate.translations, np.random.default_rng(0)
    fixes = (truth + 0.5 * rng.standard_normal(truth.shape)).tolist()
    lines = [
        f"EDGE_PRIOR_SE2_XY {k} {fixes[k][0]!r} {fixes[k][1]!r} 4 0 4\n"
        for k in range(0, graph.num_nodes, 25)
    ]
    path = tmp_path / "intel.g2o"
    path.write_text(dataset_path("intel").read_text() + "".join(lines))
    proof, _ = proven(path)
    assert checker.check(path, proof).relative_gap < 1e-8


@given(seeds, dimensions, st.booleans(), st.sampled_from([(True, 2), (True, 0), (False, 0)]))
@settings(max_examples=25)
def test_what_is_proven_is_true(tmp_path_factory, seed, d, whole, parts):
    odometry, priors = parts
    path = tmp_path_factory.mktemp("map") / "map.g2o"
    path.write_text(
        map_text(seed, d, 3, 5 if not odometry else 2, odometry, priors=priors, whole=whole)
    )
    proof, _ = proven(path)
    said, arrays = checker.check(path, proof), proofs.arrays_of(proof)
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    measured = measured_by(path, graph)
    cost = proofs.exact_cost(graph, measured, arrays["rotations"], arrays["translations"])
    assert cost <= Fraction(said.upper) <= cost * Fraction(1 + 1e-9) + Fraction(1, 10**20)
    A = proofs.exact_matrix(graph, measured, arrays["multipliers"], True)
    assert proofs.is_positive_semidefinite(A)
    assert said.lower <= said.upper


@given(seeds, dimensions, st.floats(-17, 0), st.booleans(), st.booleans())
@settings(max_examples=40)
def test_only_what_is_positive_semidefinite_passes(
    tmp_path_factory, seed, d, digits, add, odometry
):
    path = tmp_path_factory.mktemp("edge") / "map.g2o"
    path.write_text(map_text(seed, d, 3, 2 if odometry else 5, odometry, priors=2 * odometry))
    proof, _ = proven(path)
    arrays, rng = proofs.arrays_of(proof), rng_of(seed)
    k = tuple(rng.integers(arrays["multipliers"].shape))
    size = np.abs(arrays["multipliers"]).max() * 10.0**digits
    arrays["multipliers"][k] += size if add else -size
    if tried(path, arrays) is not None:
        graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
        assert not arrays["multipliers"][graph.points].any()
        measured = measured_by(path, graph)
        A = proofs.exact_matrix(graph, measured, arrays["multipliers"], True)
        assert proofs.is_positive_semidefinite(A)
        assert np.linalg.eigvalsh(np.array(A, dtype=float))[0] > -1e-9 * np.abs(A).max()


@pytest.mark.parametrize("k", [-60, 60])
def test_the_scale_of_weights_changes_nothing_with_sightings_alone(tmp_path, k):
    path = tmp_path / "seen.g2o"
    text = map_text(7, 2, 3, 5, odometry=False, priors=0)
    path.write_text(text)
    instance = certpgo.read(path, quiet=True)
    for factor in (1.0, 2.0**k):
        graph = instance.graph.with_weights(tau=factor * instance.graph.tau)
        problem = Quadratic(graph)
        x = certpgo.solve(graph).estimate
        found = prove(problem, exact_graph(problem), x, problem.multipliers(x))
        assert found is not None
        total = np.einsum("naa->", found[0])
        assert total == pytest.approx(problem.cost(x), rel=1e-9)


# --- Refusing


@pytest.fixture(params=[2, 3])
def small(request, tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(1, request.param, far=3.0e5))
    proof, instance = proven(path)
    return path, proofs.arrays_of(proof), instance


def test_multipliers_of_points_are_refused(small):
    path, arrays, instance = small
    assert tried(path, arrays) is not None
    point = np.flatnonzero(instance.graph.is_point)[0]
    for size in (1e-3, -1e-3, 5e-324, 1e300):
        for k in range(arrays["multipliers"].shape[1]):
            forged = arrays["multipliers"].copy()
            forged[point, k] = size
            assert tried(path, {**arrays, "multipliers": forged}) is None


def test_a_point_whose_rotation_is_measured_is_refused(small):
    path, arrays, _ = small
    graph = checker.read_graph(path.read_bytes(), proofs.claim_of(arrays), None)
    with np.load(path.with_suffix(".cert")) as archive:
        proof = checker.read_proof(archive, proofs.claim_of(arrays), graph.n)
    proof.multipliers[0] = 0.0
    for node in (0, graph.n - 1):  # a pose, and the world
        points = graph.points.copy()
        points[node] = True
        with pytest.raises(checker.Refused, match="rotation of a point"):
            checker.certificate_matrix(graph._replace(points=points), proof)
    # Without the flag its rotation has no weight at all.
    with pytest.raises(checker.Refused, match="not positive"):
        checker.certificate_matrix(graph._replace(points=None), proof)


def test_a_claim_that_reads_other_lines_proves_nothing(small):
    path, arrays, _ = small
    for changes in (
        {"landmarks": False},
        {"priors": False, "origin": None},
        {"landmarks": False, "priors": False, "origin": None},
        {"priors": False},
        {"landmarks": 1},
        {"landmarks": "yes"},
        {"kind": "rotations"},
        {"component_sha256": "0"},
    ):
        assert tried(path, proofs.with_claim(arrays, **changes)) is None


def test_a_claim_about_lines_that_are_not_there_says_so(tmp_path):
    path, proof = proofs.proven(tmp_path, helix(3, np.random.default_rng(0)).graph)
    arrays = proofs.arrays_of(proof)
    said = tried(path, arrays)
    assert not MAP.keys() & proofs.claim_of(arrays).keys()
    more = tried(path, proofs.with_claim(arrays, **MAP))
    assert (more.upper, more.lower) == (said.upper, said.lower)
    assert "with 0 landmarks, with 0 priors" in more.about


def test_another_origin_is_refused_or_does_not_matter(small):
    path, arrays, _ = small
    said, origin = tried(path, arrays), proofs.claim_of(arrays)["origin"]
    d = len(origin)
    assert said is not None
    for other in (
        None,  # the estimate's world is elsewhere: a high cost, and another matrix
        [0.0] * d,
        [x + 64.0 for x in origin],
        [x + 0.1 for x in origin],  # exact still, as it is near
        [0.1] * d,  # positions are rounded
        [1e-300] * d,
        [float("nan")] * d,
        [float("inf")] * d,
        origin[1:],
        "origin",
        dict.fromkeys("abc"[:d], 0.0),
        [str(x) for x in origin],
        3.0e5,
    ):
        found = tried(path, proofs.with_claim(arrays, origin=other))
        # F is invariant to where the world has its origin, so that bounds hold in any case.
        assert found is None or found.lower <= said.upper <= found.upper * (1 + 1e-12)
    for other in ([0.1] * d, [float("nan")] * d, origin[1:], "origin"):
        assert tried(path, proofs.with_claim(arrays, origin=other)) is None


def test_mutations_prove_nothing_false(small):
    path, arrays, _ = small
    said, rng = tried(path, arrays), np.random.default_rng(0)
    names = sorted(arrays.keys() - {"claim"})
    for _ in range(MUTATIONS):
        name = names[rng.integers(len(names))]
        array = arrays[name].copy()
        place = rng.integers(array.size)
        if array.dtype.kind == "i":
            other = rng.integers(array.size)
            array.flat[[place, other]] = array.flat[[other, place]]
        else:
            kind, value = rng.integers(4), float(array.flat[place])
            array.flat[place] = [value * 1.001, -value, 0.0, value + rng.normal()][kind]
        found = tried(path, {**arrays, name: array})
        assert found is None or found.lower <= said.upper
        assert found is None or found.upper >= said.lower


def test_the_package_refuses_what_the_checker_cannot_read(tmp_path):
    path = tmp_path / "sensor.g2o"
    away = "PARAMS_SE3OFFSET 0 0.5 0 0 0 0 0 1\n"
    path.write_text(away + map_text(3, 3, priors=0))
    with pytest.raises(FormatError, match="sensor 0 is not known to be at its body's origin"):
        proven(path)


def test_proofs_are_about_numbers_of_information(tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(5, 2))
    instance = certpgo.read(path, quiet=True, weights_are="covariance")
    answer = certpgo.solve(instance.graph, cost="chordal")
    with pytest.raises(InputError, match="read as covariance"):
        write_proof(tmp_path / "p.cert", path, instance, answer.estimate, answer.certificate)


def test_some_maps_have_no_proofs(tmp_path):
    path = tmp_path / "map.g2o"
    path.write_text(map_text(5, 2))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, cost="gtsam")
    with pytest.raises(InputError, match="the checker does not know the cost of gtsam"):
        write_proof(tmp_path / "p.cert", path, instance, answer.estimate, answer.certificate)
    assert certpgo.solve(instance, tier="proof", cost="gtsam").certificate.tier.value == "proof"
    alone = replace(instance, graph=instance.graph.rotations_alone)
    with pytest.raises(InputError, match="rotations alone"):
        write_proof(tmp_path / "p.cert", path, alone, answer.estimate, answer.certificate)

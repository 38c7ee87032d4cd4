"""The proof tier, and writing proofs."""

import numpy as np
import proofs
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo import certify, checker
from certpgo.certify import Tier, Verdict
from certpgo.certify.proof import exact_cost, exact_graph, prove, quaternions
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate, PoseGraph
from certpgo.io.datasets.synthetic import corridor, winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.proving import write_proof
from reports.studies.pairs.graphs import drawn


@given(seeds, dimensions)
@settings(max_examples=20)
def test_the_proof_tier_agrees_with_the_standard_one_and_is_sharper(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 8, d)
    answer = certpgo.solve(graph)
    problem = Quadratic(graph)
    proof, standard = (certify(problem, answer.estimate, tier=t) for t in ("proof", "standard"))
    assert proof.tier is Tier.PROOF
    assert proof.verdict is standard.verdict is Verdict.CERTIFIED
    assert proof.lower_bound <= standard.cost_upper
    assert standard.lower_bound <= proof.cost_upper
    assert proof.gap <= standard.gap
    assert proof.cost_upper == pytest.approx(answer.cost, rel=1e-12)


@pytest.mark.parametrize("winding", [1, 2])
@pytest.mark.parametrize("n", [12, 100])
def test_wound_up_cycles_are_refuted_at_the_proof_tier(n, winding):
    instance, wound = winding_cycle(n, 0.1, winding)
    certificate = certify(Quadratic(instance.graph), wound, tier="proof")
    assert certificate.verdict is Verdict.REFUTED
    alone = certify(Quadratic(instance.graph), wound, tier="proof", refine=False)
    assert alone.verdict in (Verdict.UNDECIDED, Verdict.BOUNDED)
    assert alone.lower_bound <= 8 * n * np.sin(0.1 / (2 * n)) ** 2


@pytest.mark.parametrize("engine", factor.engines())
def test_no_engine_is_trusted(engine, monkeypatch):
    graph, _, _ = pose_graph(rng_of(1), 8, 3)
    answer = certpgo.solve(graph)
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    assert certify(Quadratic(graph), answer.estimate, tier="proof").relative_gap < 1e-11


@given(seeds, dimensions)
def test_exact_costs_are_costs_rounded_up(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, d)
    estimate = Estimate(so.random(rng, 5, d), rng.standard_normal((5, d)))
    problem = Quadratic(graph)
    mine = exact_graph(problem)
    upper = exact_cost(problem, mine, estimate)
    assert upper == pytest.approx(problem.cost(estimate), rel=1e-12)
    exact = checker.upper_bound(mine, *_numbers(estimate))
    measured = [proofs.exact_rotation(q) for q in quaternions(graph.rotations)]
    assert proofs.exact_cost(mine, measured, *_numbers(estimate)) <= exact == upper


@pytest.mark.parametrize("power", [-180, -60, -30, 30, 60, 150])
def test_a_proof_does_not_depend_on_the_unit_of_length(power):
    """What is measured in units 2^power as long is the same, to the last bit."""
    graph, _, _ = pose_graph(rng_of(3), 8, 3)
    estimate = certpgo.solve(graph).estimate
    t, tau = np.ldexp(graph.translations, power), np.ldexp(graph.tau, -2 * power)
    other = Quadratic(PoseGraph(graph.rotations_alone, t, tau))
    moved = Estimate(estimate.rotations, np.ldexp(estimate.translations, power))
    found = certify(other, moved, tier="proof")
    expected = certify(Quadratic(graph), estimate, tier="proof")
    assert found.verdict is expected.verdict is Verdict.CERTIFIED
    assert (found.cost_upper, found.lower_bound) == (expected.cost_upper, expected.lower_bound)


def _numbers(estimate):
    return quaternions(estimate.rotations), estimate.translations


def test_a_loose_relaxation_is_proven_as_far_as_it_goes(tmp_path):
    rng = rng_of(4)
    graph, _ = rotation_graph(rng, 7, 3, extra=10, noise=1.5)
    path = tmp_path / "loose.g2o"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance.graph, cost="chordal")
    assert answer.verdict is Verdict.BOUNDED
    said = write_proof(tmp_path / "loose.cert", path, instance, answer.estimate, answer.certificate)
    assert said.lower == pytest.approx(answer.certificate.lower_bound, rel=1e-6)
    assert 1e-4 < said.relative_gap < 0.5


def test_a_cost_of_a_hundred_billionth_of_the_weights_is_proven(tmp_path):
    graph = corridor(1316, rng_of(0)).graph
    path = tmp_path / "corridor.g2o"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, cost="chordal")
    proven = instance, answer.estimate, answer.certificate
    said = write_proof(tmp_path / "corridor.cert", path, *proven)
    assert said.upper < 4e-4
    assert said.relative_gap < 1e-3


def test_translations_are_settled_before_proving():
    graph, _, _ = pose_graph(rng_of(5), 40, 3)
    problem = Quadratic(graph)
    answer = certpgo.solve(graph)
    point = Estimate(answer.estimate.rotations, answer.estimate.translations + 1e-9)
    point = Estimate(point.rotations, point.translations * (1.0 + 1e-10))
    mine = exact_graph(problem)
    Lam, _ = prove(problem, mine, point, answer.certificate.multipliers)
    bound = np.einsum("naa->", Lam)
    assert exact_cost(problem, mine, answer.estimate) - bound < 1e-12 * bound


def test_a_proof_is_about_the_estimate_as_given(tmp_path):
    graph, R, t = pose_graph(rng_of(2), 6, 3)
    path, proof = tmp_path / "graph.g2o", tmp_path / "given.cert"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    given = Estimate(R, t)
    certificate = certify(Quadratic(instance.graph), given)
    said = write_proof(proof, path, instance, given, certificate)
    assert said.upper == pytest.approx(Quadratic(graph).cost(given), rel=1e-12)
    assert said.lower == pytest.approx(certificate.refined_cost, rel=1e-8)


@pytest.mark.parametrize(
    "options",
    [{"keep": "first"}, {"unit_weights": True}, {"kappa": 2.5}, {"rotation_information": "rpy"}],
    ids=str,
)
def test_a_proof_repeats_the_reading_options(tmp_path, options):
    graph, _, _ = pose_graph(rng_of(6), 6, 3, extra=15)
    path = tmp_path / "graph.g2o"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True, **options)
    answer = certpgo.solve(instance.graph, cost="chordal")
    said = write_proof(tmp_path / "it.cert", path, instance, answer.estimate, answer.certificate)
    assert said.relative_gap < 1e-9
    assert said.upper == pytest.approx(answer.cost, rel=1e-12)


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize("by_folder", [True, False])
def test_a_proof_is_about_the_component_beside_a_scene(tmp_path, kept, by_folder):
    graph, _ = rotation_graph(rng_of(5), 6, 3, extra=6, noise=0.1)
    lines = [
        " ".join(map(repr, [int(i), int(j), *map(float, [*R.ravel(), 0.0, 0.0, 1.0])]))
        for (i, j), R in zip(graph.edges, graph.rotations, strict=True)
    ]
    inside = set(range(6))
    if kept:  # a measurement that leads out of the component
        lines.append(" ".join(map(repr, [0, 6, *np.eye(3).ravel().tolist(), 0.0, 0.0, 1.0])))
        (tmp_path / "cc.txt").write_text("\n".join(map(str, inside)))
    (tmp_path / "EGs.txt").write_text("\n".join(lines))
    source = tmp_path if by_folder else tmp_path / "EGs.txt"
    instance = certpgo.read(source, quiet=True)
    assert instance.graph.num_nodes == 6
    answer = certpgo.solve(instance.graph, cost="chordal")
    proof = tmp_path / "scene.cert"
    said = write_proof(proof, source, instance, answer.estimate, answer.certificate)
    assert said.upper == pytest.approx(answer.cost, rel=1e-9)
    assert said.relative_gap < 1e-9
    assert said == checker.check(tmp_path, proof) == checker.check(tmp_path / "EGs.txt", proof)
    assert ("nodes of cc.txt alone" in said.about) is kept


def test_what_cannot_be_proven_is_said_and_nothing_is_written(tmp_path):
    graph, _, _ = pose_graph(rng_of(7), 6, 3)
    certpgo.write(tmp_path / "graph.pyfg", graph)
    certpgo.write(tmp_path / "graph.g2o", graph)
    instance = certpgo.read(tmp_path / "graph.g2o", quiet=True)
    answer = certpgo.solve(instance, cost="chordal")
    out = tmp_path / "out.cert"
    with pytest.raises(InputError, match="convert"):
        write_proof(out, tmp_path / "graph.pyfg", instance, answer.estimate, answer.certificate)
    other, _, _ = pose_graph(rng_of(8), 5, 3)
    certpgo.write(tmp_path / "other.g2o", other)
    with pytest.raises(InputError, match="whole file"):
        write_proof(out, tmp_path / "other.g2o", instance, answer.estimate, answer.certificate)
    same, _, _ = pose_graph(rng_of(9), 6, 3)
    certpgo.write(tmp_path / "same.g2o", same)
    with pytest.raises(NumericalError, match="cannot be proven"):
        write_proof(out, tmp_path / "same.g2o", instance, answer.estimate, answer.certificate)
    nothing = proofs.without_bound(answer.certificate)
    with pytest.raises(NumericalError, match="no lower bound"):
        write_proof(out, tmp_path / "graph.g2o", instance, answer.estimate, nothing)
    assert not out.exists()


def test_refusals_of_the_checker_are_errors_of_the_package(tmp_path):
    graph, proof = tmp_path / "cycle.g2o", tmp_path / "cycle.cert"
    instance, _ = winding_cycle(5, 0.1, 0)
    certpgo.write(graph, instance)
    instance = certpgo.read(graph, quiet=True)
    answer = certpgo.solve(instance.graph, cost="chordal")
    certpgo.write_proof(proof, graph, instance, answer.estimate, answer.certificate)
    graph.write_text(f"{graph.read_text()}\n")
    for error in (certpgo.CertPGOError, checker.Refused):
        with pytest.raises(error, match="its SHA-256 differs"):
            certpgo.check(graph, proof)
    for error in (certpgo.InputError, checker.Unreadable):
        with pytest.raises(error, match="no such file"):
            certpgo.check(graph, tmp_path / "absent.cert")


def test_dir_lists_the_public_names():
    shown = {name for name in dir(certpgo) if not name.startswith("__")}
    assert shown == {*certpgo.__all__, "plot"}


@pytest.mark.parametrize("weight", [1.0, 0.999, 1.0 - 1e-9])
@pytest.mark.parametrize("d", [2, 3])
def test_measurements_that_nearly_cancel_are_still_proven(d, weight):
    half = so.exp(np.pi * np.eye(so.tangent_dim(d))[-1:])[0]
    graph = certpgo.RotationGraph(
        2, [[0, 1], [0, 1]], np.stack([np.eye(d), half]), np.array([1.0, weight])
    )
    answer = certpgo.solve(graph)
    certificate = certify(Quadratic(graph), answer.estimate, tier="proof")
    assert certificate.verdict is Verdict.CERTIFIED


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    "kinds",
    [
        ("matrix weights", "distances"),
        ("mounted sensors", "landmarks"),
        ("directions", "relative translations"),
        ("attitudes",),
        ("distances", "priors", "relative rotations"),
    ],
)
def test_archives_of_all_kinds_are_proven_and_damaged_proofs_refused(tmp_path, kinds, d):
    """What is raised, whether constants, weights of distances or multipliers, is refused."""
    whole, path, proof = drawn(kinds, d, d), tmp_path / "g.npz", tmp_path / "p.cert"
    certpgo.write(path, whole)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    assert said.relative_gap < 1e-7
    assert said.lower <= answer.cost * (1.0 + 1e-9) <= said.upper * (1.0 + 2e-9)
    with np.load(proof) as archive:
        arrays = dict(archive)
    columns = [("constants", slice(None))] * ("constants" in arrays)
    columns += [("tangents", np.s_[:, k]) for k in (0, 1) if "tangents" in arrays]
    for name, at in [*columns, ("multipliers", np.s_[:, 0])]:
        values = arrays[name].copy()
        size = arrays["kappa"] if name == "constants" else values[at]
        values[at] += 1e-3 * np.abs(size).max()
        np.savez(tmp_path / "damaged.npz", **arrays | {name: values})
        with pytest.raises(checker.Refused):
            checker.check(path, tmp_path / "damaged.npz")

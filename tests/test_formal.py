"""The theorem in Coq: what is written for it, and what Coq proves and refuses."""

import re
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import proofs
import pytest
from strategies import point_graph, pose_graph, rng_of, rotation_graph

import certpgo
from certpgo import integer_checker as exact
from certpgo import integer_reader
from certpgo.io.datasets.monocular import random_maps

FORMAL = Path(__file__).parents[1] / "formal"
THEORY = ("Statement", "Definite", "Check", "Bound")
REALS = {
    "ClassicalDedekindReals.sig_forall_dec",
    "FunctionalExtensionality.functional_extensionality_dep",
}
sys.path.insert(0, str(FORMAL))
import certificate  # noqa: E402


def coqc(folder, name):
    """What Coq says about a file."""
    command = ["coqc", "-Q", ".", "Certpgo", f"{name}.v"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.fixture(scope="module")
def theory(tmp_path_factory):
    """A folder with the compiled theory."""
    if shutil.which("coqc") is None:
        pytest.skip("coqc is missing: see formal/README.md")
    folder = tmp_path_factory.mktemp("formal")
    for name in THEORY:
        shutil.copy(FORMAL / f"{name}.v", folder)
        done = coqc(folder, name)
        assert done.returncode == 0, done.stderr
    return folder


def graphs():
    """Poses and rotations, in the plane and in space, and sightings of points."""
    rng = rng_of(1)
    yield "Plane", pose_graph(rng, 6, 2)[0]
    yield "Space", pose_graph(rng, 6, 3)[0]
    yield "Rotations", rotation_graph(rng, 6, 3)[0]
    yield "Points", point_graph(rng, 5, 3, 2)[0]


def made(folder, name, graph):
    """The text of a theorem, and what the integer checker proves."""
    path, proof = proofs.proven(folder, graph, name)
    return certificate.theorem(name, path, proof), exact.check(path, proof), path


def test_similarities_are_refused(tmp_path):
    graph, _ = random_maps(np.random.default_rng(0), 3, turn=0.02)
    path, proof = tmp_path / "maps.npz", tmp_path / "maps.cert"
    certpgo.write(path, certpgo.Instance("maps", graph, np.arange(8)))
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, tier="proof")
    certpgo.write_proof(proof, path, instance, answer.estimate, answer.certificate)
    with pytest.raises(exact.Refused, match="not about similarities"):
        certificate.theorem("Maps", path, proof)


def test_another_cost_is_refused():
    path = Path(__file__).parent / "data" / "proofs" / "version2_plane.g2o"
    with pytest.raises(exact.Refused, match="not about the cost of g2o"):
        certificate.theorem("Plane", path, path.with_suffix(".cert"))


def axioms(said):
    """The names of the axioms that a theorem depends on."""
    return set(re.findall(r"^([A-Z][\w.]*)$", said.split("Axioms:")[1], re.MULTILINE))


def test_measurements_are_written_exactly(tmp_path):
    for name, graph in graphs():
        text, _, path = made(tmp_path, name, graph)
        lines = re.findall(r"^Edge .*$", text, re.MULTILINE)
        assert len(lines) == sum(line.startswith("EDGE") for line in path.read_text().splitlines())
        claim = {"d": graph.d, "priors": False, "landmarks": name == "Points", "maps": False}
        claim |= {"keep": "all", "kappa": None, "tau": None, "origin": None}
        claim |= {"rotation_information": "tangent"}
        read = integer_reader.read_graph(path.read_bytes(), claim, None)
        for line, edge in zip(lines, read.edges, strict=True):
            ids, step, turn, weights = re.fullmatch(
                r"Edge (\d+ \d+) \[(.*)\] \[(.*)\] (\S+ [^\s;\]]+).*", line
            ).groups()
            numbers = [
                [Fraction(float.fromhex(word.strip("()"))) for word in words]
                for words in (step.split("; "), turn.split("; "), weights.split())
            ]
            assert tuple(map(int, ids.split())) == edge[:2]
            assert [x * exact.ONE for x in numbers[0]] == list(edge.t)
            power = numbers[1][3] / edge.q[3]
            assert [x * power for x in edge.q] == numbers[1]
            assert numbers[2][0] * exact.ONE == edge.kappa
            assert numbers[2][1] * exact.ONE == edge.tau * (name != "Rotations")


def test_what_the_statement_implies(theory):
    shutil.copy(FORMAL / "Examples.v", theory)
    done = coqc(theory, "Examples")
    assert done.returncode == 0, done.stderr


def test_six_cameras(theory):
    shutil.copy(FORMAL / "Cycle.v", theory)
    done = coqc(theory, "Cycle")
    assert done.returncode == 0, done.stderr
    assert axioms(done.stdout) == REALS


@pytest.mark.parametrize("name", ["Plane", "Space", "Rotations", "Points"])
def test_what_is_proven(theory, tmp_path, name):
    text, answer, _ = made(tmp_path, name, dict(graphs())[name])
    (theory / f"{name}.v").write_text(text)
    done = coqc(theory, name)
    assert done.returncode == 0, done.stderr
    assert axioms(done.stdout) == REALS
    said = re.search(r"no_estimate_costs_less_than (\S+) [23]", text)[1]
    assert 0 <= 1 - Fraction(said) / answer.lower < 1e-13


@pytest.fixture(scope="module")
def program(theory):
    """The check that Coq extracts, compiled."""
    if shutil.which("ocamlfind") is None:
        pytest.skip("ocamlfind is missing: see formal/README.md")
    shutil.copy(FORMAL / "Extract.v", theory)
    shutil.copy(FORMAL / "run.ml", theory)
    assert coqc(theory, "Extract").returncode == 0
    command = "ocamlfind ocamlopt -package zarith -linkpkg check.mli check.ml run.ml -o run"
    done = subprocess.run(command.split(), cwd=theory, capture_output=True, text=True)
    if "zarith" in done.stderr:
        pytest.skip("OCaml's zarith is missing: see formal/README.md")
    assert done.returncode == 0, done.stderr
    return theory / "run"


def test_the_extracted_program(program, tmp_path):
    for name, graph in graphs():
        text, _, _ = made(tmp_path, name, graph)
        said = re.search(r"no_estimate_costs_less_than (\S+) [23]", text)[1]
        file = tmp_path / f"{name}.v"
        file.write_text(text)
        done = subprocess.run([program, file], capture_output=True, text=True)
        edges = text.count("\nEdge ")
        expected = f"{name}: no estimate costs less than {said} ({edges} edges)\n"
        assert (done.returncode, done.stdout) == (0, expected)
        file.write_text(text.replace(said, f"9{said}"))
        done = subprocess.run([program, file], capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (1, f"{name}: not proven\n")


@pytest.mark.parametrize(
    ("stands", "instead"),
    [
        pytest.param(r"(less_than|_proof) (\d+\.\d)", r"\1 9\2", id="a higher bound"),
        pytest.param(r"(Edge 0 \d \[)[^;]*;", r"\g<1>9;", id="another measurement"),
        pytest.param(r"(Edge 0 \d .*\]) [^][;]+;", r"\1 0 0;", id="no weights"),
        pytest.param(r"\((\d), \[(-?)0x", r"(\1, [\g<2>0xf", id="greater multipliers"),
        pytest.param(r"\(0, \[", "(9, [", id="a node without a place"),
    ],
)
def test_falsehoods_are_refused(theory, tmp_path, stands, instead):
    text, _, _ = made(tmp_path, "False", dict(graphs())["Space"])
    changed, times = re.subn(stands, instead, text.replace("False", "Falsehood"))
    assert times
    (theory / "Falsehood.v").write_text(changed)
    done = coqc(theory, "Falsehood")
    assert done.returncode
    assert re.search(r"true = true|witness", done.stderr), done.stderr

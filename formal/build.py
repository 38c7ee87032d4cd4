"""Proves that no estimates of public sets cost less than L, in Coq: ``make formal``.

    python formal/build.py [--out FOLDER] [NAME ...]

Solves each dataset, writes its theorem with certificate.py, and lets Coq check it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import certificate

import certpgo
from certpgo import io
from certpgo.certify.proof_file import write_proof
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets

HERE = Path(__file__).parent
THEORY = ("Statement", "Definite", "Check", "Bound")
SETS = ("tinyGrid3D", "smallGrid3D", "MIT", "intel", "parking-garage")
AXIOMS = (
    "ClassicalDedekindReals.sig_forall_dec",
    "FunctionalExtensionality.functional_extensionality_dep",
)
HEADER = """# Theorems about public sets

What Coq has proven: no rotations and positions at all cost less than L, for the measurements of
each file; made by `python formal/build.py --out reports/results/formal_proofs.md`. Every theorem
depends on the axioms of Coq's real numbers alone, `ClassicalDedekindReals.sig_forall_dec` and
`FunctionalExtensionality.functional_extensionality_dep`. Seconds are of the processor, for all of
a file: parsing, and the proof.

| data | kind | nodes / edges | L | file, kB | Coq, s |
| --- | --- | --- | --- | --- | --- |
"""
MISSING = "skipped: coqc is missing; formal/README.md says how to install it"


def prove(graph: Path, theorem: Path, rotations: bool = False) -> PoseGraph | RotationGraph:
    """Solve a graph, and write the theorem about it."""
    instance = io.read(graph, quiet=True)
    instance = rotations_alone(instance) if rotations else instance
    answer = certpgo.solve(instance.graph)
    with tempfile.TemporaryDirectory() as folder:
        proof = Path(folder) / "proof.cert"
        write_proof(proof, graph, instance, answer.estimate, answer.certificate)
        theorem.write_text(certificate.theorem(theorem.stem, graph, proof))
    return instance.graph


def compiled(name: str, folder: Path) -> tuple[str, float]:
    """What Coq says about a file of this folder, and the seconds of the processor."""
    before = os.times()
    command = ["coqc", "-Q", ".", "Certpgo", f"{name}.v"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}.v: {done.stderr.strip()}")
    after = os.times()
    seconds = after.children_user + after.children_system
    return done.stdout, seconds - before.children_user - before.children_system


def row(said: str, path: Path, folder: Path) -> str:
    """Prove a theorem, and what a table says about it."""
    name, _, alone = said.partition(" ")
    theorem = folder / f"{said.replace('-', '_').replace(' ', '_')}.v"
    graph = prove(path, theorem, bool(alone))
    answer, seconds = compiled(theorem.stem, folder)
    axioms = re.findall(r"^([A-Z]\w+\.\w+)", answer, re.MULTILINE)
    if set(axioms) != set(AXIOMS):
        raise SystemExit(f"{theorem}: other axioms than the reals': {axioms}")
    bound = theorem.read_text().split("no_estimate_costs_less_than ")[1].split()[0]
    cells = (
        name,
        "rotations" if alone else "poses",
        f"{graph.num_nodes} / {graph.num_edges}",
        bound,
        f"{theorem.stat().st_size >> 10}",
        f"{seconds:.1f}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Compile the theory, then a theorem for each dataset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=SETS, help="or 'NAME rotations'")
    parser.add_argument("--folder", type=Path, default=HERE.parent / "build" / "formal")
    parser.add_argument("--out", type=Path, help="a table, whose other rows are kept")
    arguments = parser.parse_args()
    if shutil.which("coqc") is None:
        print(MISSING)
        return
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    for source in HERE.glob("*.v"):
        shutil.copy(source, folder)
    for name in (*THEORY, "Cycle"):
        print(f"{name}: {compiled(name, folder)[1]:.1f} s", flush=True)
    rows = {}
    if arguments.out and arguments.out.exists():
        lines = arguments.out.read_text().splitlines()
        rows = {tuple(line.split(" | ")[:2]): line for line in lines if line.startswith("| ")}
    for name in arguments.names:
        path = datasets.find(name.partition(" ")[0])
        if path is None:
            print(f"{name}: file not here")
            continue
        line = row(name, path, folder)
        print(line, flush=True)
        rows[tuple(line.split(" | ")[:2])] = line
    if arguments.out:
        head = [line for line in HEADER.splitlines() if line.startswith("| ")]
        body = [line for line in rows.values() if line not in head]
        arguments.out.write_text(HEADER + "\n".join(body) + "\n")


if __name__ == "__main__":
    main()

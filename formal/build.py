"""Proves that no estimates of public sets cost less than L, in Coq: ``make formal``.

    python formal/build.py [--out FOLDER] [NAME ...]

Solves each dataset, writes its theorem with certificate.py, and lets Coq check it.
"""

from __future__ import annotations

import argparse
import os
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
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets

HERE = Path(__file__).parent
THEORY = ("Statement", "Definite", "Check", "Bound")
SETS = ("tinyGrid3D", "smallGrid3D", "MIT", "intel", "parking-garage")
MISSING = "skipped: coqc is missing; formal/README.md says how to install it"


def prove(graph: Path, theorem: Path, rotations: bool = False) -> None:
    """Solve a graph, and write the theorem about it."""
    instance = io.read(graph, quiet=True)
    instance = rotations_alone(instance) if rotations else instance
    answer = certpgo.solve(instance.graph)
    name = theorem.stem
    with tempfile.TemporaryDirectory() as folder:
        proof = Path(folder) / "proof.cert"
        write_proof(proof, graph, instance, answer.estimate, answer.certificate)
        theorem.write_text(certificate.theorem(name, graph, proof))


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


def main() -> None:
    """Compile the theory, then a theorem for each dataset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=SETS)
    parser.add_argument("--out", type=Path, default=HERE.parent / "build" / "formal")
    arguments = parser.parse_args()
    if shutil.which("coqc") is None:
        print(MISSING)
        return
    folder = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    for source in HERE.glob("*.v"):
        shutil.copy(source, folder)
    for name in (*THEORY, "Cycle"):
        said, seconds = compiled(name, folder)
        print(f"{name}: {seconds:.1f} s", flush=True)
    print(said)
    for name in arguments.names:
        path = datasets.find(name)
        if path is None:
            print(f"{name}: file not here")
            continue
        theorem = folder / f"{name.replace('-', '_')}.v"
        prove(path, theorem)
        said, seconds = compiled(theorem.stem, folder)
        statement = next(line for line in theorem.read_text().splitlines() if "Theorem" in line)
        print(f"{statement}\nproved in {seconds:.0f} s, {theorem.stat().st_size >> 10} kB\n{said}")


if __name__ == "__main__":
    main()

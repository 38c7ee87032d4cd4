"""Proves that no estimates of public sets cost less than L, in Coq: ``make formal``.

    python formal/build.py [--program] [--out TABLE] [NAME ...]

Solves each dataset, writes its theorem with certificate.py, and lets Coq check it, and also the
program that Coq extracts, which is faster and rests on more.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from certpgo.graph import Graph

sys.path.insert(0, str(Path(__file__).parent))
import certificate

import certpgo
from certpgo import io
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets
from certpgo.solve.proving import write_proof

HERE = Path(__file__).parent
THEORY = ("Statement", "Definite", "Check", "Bound")
SETS = ("tinyGrid3D", "tinyGrid3D rotations", "smallGrid3D", "MIT", "intel", "parking-garage")
LARGER = ("sphere2500",)  # the kernel would take an hour
AXIOMS = {
    "ClassicalDedekindReals.sig_forall_dec",
    "FunctionalExtensionality.functional_extensionality_dep",
}
HEADER = """# Theorems about public sets

No rotations and positions at all cost less than L, for the measurements of each file. *Coq*: the
seconds its kernel takes, for all of a file. These are theorems, and depend on the axioms of Coq's
real numbers alone, `ClassicalDedekindReals.sig_forall_dec` and
`FunctionalExtensionality.functional_extensionality_dep`. *Program*: the seconds of the same check,
extracted to OCaml with the integers of zarith. Seconds are of the processor. Made by
`python formal/build.py --out reports/results/formal_proofs.md`.

| data | kind | nodes / edges | L | file, kB | Coq, s | program, s |
| --- | --- | --- | --- | --- | --- | --- |
"""
MISSING = "is missing; formal/README.md says how to install it"


def prove(graph: Path, theorem: Path, rotations: bool = False) -> Graph:
    """Solve a graph, and write the theorem about it."""
    instance = io.read(graph, quiet=True)
    instance = rotations_alone(instance) if rotations else instance
    answer = certpgo.solve(instance.graph)
    with tempfile.TemporaryDirectory() as folder:
        proof = Path(folder) / "proof.cert"
        write_proof(proof, graph, instance, answer.estimate, answer.certificate)
        theorem.write_text(certificate.theorem(theorem.stem, graph, proof))
    return instance.graph


def run(command: list[str], folder: Path) -> tuple[str, float]:
    """What a command says in this folder, and the seconds of the processor."""
    before = os.times()
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, preexec_fn=_with_all_of_the_stack
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}: {done.stdout} {done.stderr}".strip())
    after = os.times()
    seconds = after.children_user + after.children_system
    return done.stdout, max(seconds - before.children_user - before.children_system, 0)


def _with_all_of_the_stack() -> None:
    """Lists are walked by recursion."""
    _, most = resource.getrlimit(resource.RLIMIT_STACK)
    resource.setrlimit(resource.RLIMIT_STACK, (most, most))


def coqc(name: str, folder: Path) -> tuple[str, float]:
    """What Coq says about a file, and the seconds of the processor."""
    return run(["coqc", "-Q", ".", "Certpgo", f"{name}.v"], folder)


def build_program(folder: Path) -> bool:
    """Extract the check and compile it to ``folder/run``, if OCaml and zarith are there."""
    found = (
        shutil.which("ocamlfind")
        and not subprocess.run(
            ["ocamlfind", "ocamlopt", "-package", "zarith"], capture_output=True
        ).returncode
    )
    if found:
        coqc("Extract", folder)
        files = ["check.mli", "check.ml", "run.ml"]
        run(
            ["ocamlfind", "ocamlopt", "-package", "zarith", "-linkpkg", *files, "-o", "run"], folder
        )
    else:
        print(f"program skipped: OCaml's zarith {MISSING}")
    return bool(found)


def row(said: str, path: Path, folder: Path, kernel: bool, program: bool) -> str:
    """Prove a theorem, and what a table says about it."""
    name, _, alone = said.partition(" ")
    theorem = folder / f"{said.replace('-', '_').replace(' ', '_')}.v"
    graph = prove(path, theorem, bool(alone))
    bound = theorem.read_text().split("no_estimate_costs_less_than ")[1].split()[0]
    cells = [name, "rotations" if alone else "poses", f"{graph.num_nodes} / {graph.num_edges}"]
    cells += [bound, f"{theorem.stat().st_size >> 10}", "", ""]
    if kernel:
        answer, seconds = coqc(theorem.stem, folder)
        axioms = set(re.findall(r"^([A-Z]\w+\.\w+)", answer, re.MULTILINE))
        if axioms != AXIOMS:
            raise SystemExit(f"{theorem}: other axioms than the reals': {axioms}")
        cells[5] = f"{seconds:.1f}"
    if program:
        answer, seconds = run(["./run", theorem.name], folder)
        if answer.split(" (")[0] != f"{theorem.stem}: no estimate costs less than {bound}":
            raise SystemExit(f"{theorem}: {answer}")
        cells[6] = f"{seconds:.1f}"
    return f"| {' | '.join(cells)} |"


def merged(out: Path, lines: list[str]) -> str:
    """The table with these lines, and the others that it has."""
    kept = out.read_text().splitlines() if out.exists() else []
    head = [line for line in HEADER.splitlines() if line.startswith("| ")]
    rows = {
        tuple(line.split(" | ")[:2]): line
        for line in [*kept, *lines]
        if line.startswith("| ") and line not in head
    }
    return HEADER + "\n".join(rows.values()) + "\n"


def main() -> None:
    """Compile the theory, then a theorem for each dataset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="such as MIT or 'MIT rotations'")
    parser.add_argument("--program", action="store_true", help="the extracted program alone")
    parser.add_argument("--folder", type=Path, default=HERE.parent / "build" / "formal")
    parser.add_argument("--out", type=Path, help="a table, whose other rows are kept")
    arguments = parser.parse_args()
    if shutil.which("coqc") is None:
        print(f"skipped: coqc {MISSING}")
        return
    folder = arguments.folder
    folder.mkdir(parents=True, exist_ok=True)
    for source in (*HERE.glob("*.v"), HERE / "run.ml"):
        shutil.copy(source, folder)
    for name in (*THEORY, "Examples", "Cycle"):
        print(f"{name}: {coqc(name, folder)[1]:.1f} s", flush=True)
    program = build_program(folder)
    for name in arguments.names or (*SETS, *LARGER):
        path = datasets.find(name.partition(" ")[0])
        kernel = not arguments.program and (name not in LARGER or bool(arguments.names))
        if path is None or not (kernel or program):
            print(f"{name} skipped: {'no program' if path else 'the file is not here'}")
            continue
        line = row(name, path, folder, kernel, program)
        print(line, flush=True)
        if arguments.out:
            arguments.out.write_text(merged(arguments.out, [line]))


if __name__ == "__main__":
    main()

"""Mutants of what Coq computes and states: ``python -m reports.studies.formal_mutants``.

Each mutant changes one place of formal/Statement.v, Definite.v or Check.v. It is killed if the
theorem is no longer proven, or if a graph's proof no longer passes.
Writes reports/results/formal_mutants.md.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from certpgo.io import datasets

sys.path.insert(0, str(Path(__file__).parents[2] / "formal"))
from build import prove

FORMAL = Path(__file__).parents[2] / "formal"
OUT = Path(__file__).parents[1] / "results" / "formal_mutants.md"
SECONDS = 600  # for a file
THEORY = ("Statement", "Definite", "Check", "Bound")

HEADER = """# Mutants of the theorem in Coq

{n} mutants of what Coq states (Statement.v) and computes (Definite.v, Check.v) in `formal/`; made
by `python -m reports.studies.formal_mutants`. *Killed by* says what fails: the *proof* that the
check is sound, or the check of one of two *examples*, six cameras in the plane and tinyGrid3D.

| file | stands there | mutant | killed by |
| --- | --- | --- | --- |
"""

#: File, what stands there once, and what instead.
MUTANTS = (
    ("Statement", "M c a * M c b)", "M c a * M c a)"),
    ("Statement", "then 1 else 0", "then 2 else 0"),
    ("Statement", "then 1 else 0", "then 1 else 1"),
    ("Statement", "(a < d)%nat -> (b < d)%nat ->", "(a < 1)%nat -> (b < d)%nat ->"),
    ("Statement", "2 * (x*y - w*z); 2 * (x*z + w*y)", "2 * (x*y + w*z); 2 * (x*z + w*y)"),
    ("Statement", "w*w - x*x + y*y - z*z", "w*w - x*x - y*y - z*z"),
    ("Statement", "(x*x + y*y + z*z + w*w)", "(x*x + y*y + z*z)"),
    ("Statement", "number q 3 in", "number q 0 in"),
    ("Statement", "(rot (j e) a b - sum", "(rot (j e) b a - sum"),
    ("Statement", "(rot (j e) a b - sum", "(rot (j e) a b + sum"),
    ("Statement", "rotation (quaternion e) c b", "rotation (quaternion e) b c"),
    ("Statement", "t (j e) a - t (i e) a", "t (i e) a - t (j e) a"),
    ("Statement", "rot (i e) a c * number", "rot (j e) a c * number"),
    ("Statement", "Q2R (tau e) * sum", "Q2R (kappa e) * sum"),
    ("Statement", "L <= cost d", "L < cost d"),
    ("Definite", "(r, x + y) :: add_linear u' v'", "(r, x) :: add_linear u' v'"),
    ("Definite", "| Gt => (s, y) :: merge v'", "| Gt => merge v'"),
    ("Definite", "(r, x + y, add_linear u v)", "(r, x, add_linear u v)"),
    ("Definite", "(r, x + y, add_linear u v)", "(r, x + y, u)"),
    ("Definite", "| Lt => (r, x, u) :: add A' B\n", "| Lt => (r, x, []) :: add A' B\n"),
    ("Definite", "add A B :: pairs others", "A :: pairs others"),
    ("Definite", "fold_right add [] (Nat", "fold_right (fun A _ => A) [] (Nat"),
    ("Definite", "(s, y * x - e, map", "(s, y * x, map"),
    ("Definite", "(s, y * x - e, map", "(s, y * x + e, map"),
    ("Definite", "let y := - x in", "let y := x in"),
    ("Definite", "(u, y * z)) l') :: rest l'", "(u, y * z)) l') :: []"),
    ("Definite", "(u, y * z)) l')", "(u, y)) l')"),
    ("Definite", "Z.abs (z - l0 * x)", "z - l0 * x"),
    ("Definite", "Z.abs (z - l0 * x)", "0"),
    ("Definite", "fold_right Z.add 0 (map snd l)", "0"),
    ("Definite", "(l0 * l0 + errors l <=? z)", "(l0 * l0 - errors l <=? z)"),
    ("Definite", "(l0 * l0 + errors l <=? z)", "(errors l <=? z)"),
    ("Definite", "(l0 * l0 + errors l <=? z) &&", ""),
    ("Definite", "| _, O => false", "| _, O => true"),
    ("Definite", "nonnegative fuel' (add A' (rest l))", "nonnegative fuel' A'"),
    ("Definite", "Z.of_nat (length tail) * Z.sqrt z", "0"),
    ("Definite", "(2 * z + l0) / (2 * l0)", "z / (2 * l0)"),
    ("Check", "=? Z.shiftl (Qnum q) bits", "<=? Z.shiftl (Qnum q) bits"),
    ("Check", "x * x + s) 0 q", "x + s) 0 q"),
    ("Check", "2 * (xz - wy)", "2 * (xz + wy)"),
    ("Check", "[(r, -1, [(s, z)]); (s, -1, [])] else", "[(r, 0, [(s, z)]); (s, -1, [])] else"),
    ("Check", "(r, -1, [])]", "(r, 0, [])]"),
    ("Check", "Pos.ltb r s", "Pos.ltb s r"),
    ("Check", "square bits w u'", "[]"),
    ("Check", "diagonal (rotated q a) kD]", "diagonal (rotated p a) kD]"),
    ("Check", "(- k * entry N a b)", "(- k * entry N b a)"),
    ("Check", "(- k * entry N a b)", "(k * entry N a b)"),
    (
        "Check",
        "unit P + translation_guard P - 2 * metre P) tau",
        "unit P + translation_guard P) tau",
    ),
    ("Check", "(position p, - step P)", "(position p, step P)"),
    ("Check", "- nth c t 0)", "nth c t 0)"),
    ("Check", "then diagonal (rotated p a) (- x)", "then diagonal (rotated p a) x"),
    ("Check", "then x else 0)", "then x else x)"),
    ("Check", "node (place k) =? k", "node (place k) =? node (place k)"),
    ("Check", "(0 <? norm [x; y; z; w])", "true"),
    ("Check", "(x =? 0) && (y =? 0)", "(x =? 0)"),
    ("Check", "forallb (whole (metre P)) (translation e) &&", ""),
    ("Check", "(stiffness P) ::\n  flat_map edge_forms graph ++", "(stiffness P) ::"),
    ("Check", "(0 <? step P)", "(0 <=? step P)"),
    ("Check", "(2 * metre P <=? unit P + translation_guard P) &&", ""),
    ("Check", "(unit P) <=? bound * Zpos (Qden L)", "(unit P) <=? bound * Zpos (Qden L) + 1"),
    ("Check", "&& placed (pin P)", ""),
    ("Check", "forallb (fun m => placed (fst m)) (multipliers P) &&", ""),
    ("Check", "&& forallb (edge_test d P of_node at_place) graph", ""),
)


def build(folder: Path, names: Sequence[str]) -> str:
    """The first file that Coq does not accept, or nothing."""
    for name in names:
        command = ["coqc", "-Q", ".", "Certpgo", f"{name}.v"]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, timeout=SECONDS)
        except subprocess.TimeoutExpired:
            return name
        if done.returncode:
            return name
    return ""


def outcome(source: Path, examples: Sequence[str], name: str, before: str, after: str) -> str:
    """Where a mutant fails, or nothing."""
    text = (source / f"{name}.v").read_text()
    if text.count(before) != 1:
        raise SystemExit(f"{name}.v has {text.count(before)} places like {before!r}, not one")
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "formal"
        shutil.copytree(source, folder)
        mutant = text.replace(before, after)
        (folder / "Defined.v").write_text(mutant.split("(** The values of forms. *)")[0])
        if build(folder, ["Defined"]):
            raise SystemExit(f"{after!r} in {name}.v has no meaning")
        (folder / f"{name}.v").write_text(mutant)
        return build(folder, [*THEORY[THEORY.index(name) :], *examples])


def main() -> None:
    """Make every mutant, and write what became of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    path = datasets.find("tinyGrid3D")
    if shutil.which("coqc") is None or path is None:
        raise SystemExit("coqc and tinyGrid3D are needed")
    rows = []
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "formal"
        folder.mkdir()
        for source in FORMAL.glob("*.v"):
            shutil.copy(source, folder)
        prove(path, folder / "Tiny.v")
        examples = ["Cycle", "Tiny"]
        if failed := build(folder, [*THEORY, *examples]):
            raise SystemExit(f"{failed}.v does not compile without a mutant")
        for name, before, after in MUTANTS:
            failed = outcome(folder, examples, name, before, after)
            fate = "no" if not failed else "proof" if failed in THEORY else "examples"
            row = f"| {name} | `{before}` | `{after or ' '}` | {fate} |".replace("\n", " ")
            rows.append(row.replace("||", "\\|\\|"))
            print(rows[-1], flush=True)
    arguments.out.write_text(HEADER.format(n=len(rows)) + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

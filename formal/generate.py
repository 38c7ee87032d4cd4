"""Writes a graph and its proof for Coq: ``python formal/generate.py NAME GRAPH PROOF > NAME.v``.

Of what this program writes, only the measurements have to be believed; Coq checks all else.
"""

from __future__ import annotations

import hashlib
import sys
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from certpgo import integer_checker as checker

BITS = 64  # of the columns of the factor
ULP = checker.ULP


def hexadecimal(x: int) -> str:
    """A double, given as an integer times 2^-1074, exactly."""
    said = float(Fraction(x, 1 << ULP)).hex()
    return f"({said})" if x < 0 else said


def near_one(q: checker.Quaternion) -> list[int]:
    """The quaternion times a power of two, with a norm near 1, as doubles."""
    k = checker.norm(q).bit_length() // 2
    return [x << (ULP - k) for x in q]


def units(numbers: Iterable[int]) -> int:
    """The least k such that all doubles are multiples of 2^-k."""
    return max(checker.trimmed([*numbers, checker.ONE])[1], 0)


def written(name: str, path: Path, proof_path: Path) -> Iterator[str]:
    """The lines of the file."""
    text = path.read_bytes()
    with zipfile.ZipFile(proof_path) as archive:
        files = {member.removesuffix(".npy"): archive.read(member) for member in archive.namelist()}
    claim = checker.read_claim(files["claim"])
    if hashlib.sha256(text).hexdigest() != claim["graph_sha256"]:
        raise SystemExit(f"{path} is not the file that was proven about")
    graph = checker.read_graph(text, claim, checker.component(path, claim["component_sha256"]))
    proof, d, poses = checker.read_proof(files, claim, graph), claim["d"], claim["kind"] == "poses"
    yield "From Coq Require Import QArith Qreals Reals List Lra."
    yield "From Certpgo Require Import Statement Check Bound."
    yield "Import ListNotations."
    yield f"(* {checker.about(graph, claim)} *)"
    yield f"Definition {name}_graph : list edge := ["
    lines = []
    for i, j, q, t, kappa, tau, _ in graph.edges:
        turn = "; ".join(map(hexadecimal, near_one(q)))
        step = "; ".join(hexadecimal(x) for x in t)
        tau *= poses
        lines.append(f"Edge {i} {j} [{step}] [{turn}] {hexadecimal(kappa)} {hexadecimal(tau)}")
    yield ";\n".join(lines)
    yield "]%Q."
    # The units.
    far = proof.exponent if poses else 0
    heaviest = max(edge.kappa for edge in graph.edges).bit_length() - ULP
    metre = units(x for edge in graph.edges for x in edge.t) + max(-far, 0)
    turns = [near_one(edge.q) for edge in graph.edges]
    turn = units(x for q in turns for x in q)
    unit = 2 * BITS - 4 - heaviest
    turn_bits = 2 * turn + 1
    rotation_guard = max(70 + turn_bits - heaviest - unit, 0)
    translation_guard = max(2 * metre - unit + 64 - heaviest + 2 * far, 2 * metre - unit, 0)
    lams = []
    trace = 0
    for k in proof.order:
        Lam = [checker.shifted(x, unit - ULP) for x in proof.multipliers[k]]
        trace += sum(Lam[a] for a in ((0, 2), (0, 3, 5))[d - 2])
        lams.append(f"({k}, [{'; '.join(map(hex, Lam))}])")
    yield f"Definition {name}_proof : proof := Proof"
    yield f"  {unit} {metre} {turn} (2 ^ {metre + far}) {rotation_guard} {translation_guard}"
    yield f"  {proof.pin} (2 ^ {unit + heaviest}) ["
    yield ";\n".join(lams)
    yield "]%Z."
    bound = Fraction(trace, 1 << unit)
    L = Context(prec=15, rounding=ROUND_FLOOR).divide(
        Decimal(bound.numerator), Decimal(bound.denominator)
    )
    yield f"Theorem {name} : no_estimate_costs_less_than {L:f} {d} {name}_graph."
    yield "Proof."
    yield f"  apply (proved _ _ {name}_proof {L:f}); [unfold Q2R; simpl; lra|]."
    yield "  vm_cast_no_check (eq_refl true)."
    yield "Qed."
    yield f"Print Assumptions {name}."


def main(arguments: Sequence[str]) -> None:
    """Write it to the standard output."""
    name, graph, proof = arguments
    for line in written(name, Path(graph), Path(proof)):
        print(line)


if __name__ == "__main__":
    main(sys.argv[1:])

"""Writes a graph and its proof as a theorem for Coq.

    python formal/certificate.py NAME GRAPH PROOF [BITS] > NAME.v

Of what this program writes, the measurements are what the theorem is about. All else is hints,
which Coq checks.
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from certpgo import integer_checker as checker
from certpgo import integer_reader

BITS = 60  # of the factor's columns: more take longer, and fewer may not be enough
SPARE = 70  # bits of weights

HEADER = """(** No estimate of the {kind} in {file} costs less than {bound}.

{about}
    An estimate is a rotation for each of {n} nodes{position}. Statement.v defines its cost, of the
    {m} measurements below. These are doubles, written exactly: those that
    certpgo/integer_reader.py reads from the file of SHA-256
    {digest}.
    Nodes are numbered by ascending id. Coq checks the proof when it compiles this file. *)

From Coq Require Import QArith Qreals Reals List Lra.
From Certpgo Require Import Statement Check Bound.
Import ListNotations.
"""

THEOREM = """
Theorem {name} : no_estimate_costs_less_than {bound} {d} {name}_graph.
Proof.
  apply (proved _ _ {name}_proof {bound}); [unfold Q2R; simpl; lra|].
  vm_cast_no_check (eq_refl true).
Qed.

Print Assumptions {name}.
"""


def hexadecimal(x: int) -> str:
    """A double, given as an integer times 2^-1074, exactly."""
    said = float(Fraction(x, checker.ONE)).hex()
    return f"({said})" if x < 0 else said


def indented(said: str) -> str:
    """A paragraph of a comment."""
    return textwrap.fill(said, 100, initial_indent=" " * 4, subsequent_indent=" " * 4)


def near_one(q: checker.Quaternion) -> list[int]:
    """The quaternion of a norm near 1 that is a power of two times this one."""
    k = checker.norm(q).bit_length() // 2
    return [x << (checker.ULP - k) for x in q]


def bits(numbers: Iterable[int]) -> int:
    """The least k >= 0 such that all doubles are multiples of 2^-k."""
    return max(checker.trimmed([*numbers, checker.ONE])[1], 0)


def measurements(graph: checker.Graph, d: int, poses: bool) -> Iterator[str]:
    """A line for each edge: nodes, translation, quaternion, kappa and tau."""
    for edge in graph.edges:
        step, turn = (
            "; ".join(map(hexadecimal, x)) for x in (edge.t or (0,) * d, near_one(edge.q))
        )
        weights = f"{hexadecimal(edge.kappa)} {hexadecimal(edge.tau * poses)}"
        yield f"Edge {edge.i} {edge.j} [{step}] [{turn}] {weights}"


def hints(
    graph: checker.Graph, proof: checker.Proof, d: int, precision: int
) -> tuple[str, Fraction]:
    """The fields of a proof, which Check.v explains, and the bound that it proves."""
    far = proof.exponent if proof.t else 0
    kappa = max(edge.kappa for edge in graph.edges).bit_length() - checker.ULP  # at most 2^kappa
    tau = max(edge.tau for edge in graph.edges).bit_length() - checker.ULP
    heaviest = max(kappa, tau + 2 * far) if proof.t else kappa
    metre = bits(x for edge in graph.edges for x in edge.t) + max(-far, 0)
    turn = bits(x for edge in graph.edges for x in near_one(edge.q))
    unit = max(2 * precision - 4 - kappa, 0)
    rotation_guard = max(SPARE + 2 * turn - kappa - unit, 0)
    translation_guard = max(2 * metre - unit, SPARE + 2 * metre - tau - unit, 0)
    multipliers, trace = [], 0
    for k in proof.order:
        if k in graph.points:  # without a rotation
            multipliers.append(f"({k}, [])")
            continue
        Lam = [checker.shifted(x, unit - checker.ULP) for x in proof.multipliers[k]]
        trace += sum(Lam[a] for a in ((0, 2), (0, 3, 5))[d - 2])
        multipliers.append(f"({k}, [{'; '.join(map(hex, Lam))}])")
    numbers = f"{unit} {metre} {turn} (2 ^ {metre + far}) {rotation_guard} {translation_guard}"
    pin = f"{proof.pin} (2 ^ {unit + heaviest})"
    return f"{numbers} {pin} [\n" + ";\n".join(multipliers) + "]", Fraction(trace, 1 << unit)


def theorem(name: str, path: Path, proof_path: Path, precision: int = BITS) -> str:
    """The file for Coq."""
    plain = checker.read(integer_reader.plain(path, proof_path))
    graph, proof, d, poses = plain.graph, plain.proof, plain.d, plain.kind == "poses"
    if graph.free is not None:
        raise checker.Refused("the theorem is about poses of known scale, not about similarities")
    if proof.minorants:
        raise checker.Refused("the theorem is about F, not about the cost of g2o")
    if proof.rejected:
        raise checker.Refused("the theorem is about a cost in which no measurement is rejected")
    fields, bound = hints(graph, proof, d, precision)
    if bound <= 0:
        raise checker.Refused("the proof's bound is not positive")
    floor = Context(prec=15, rounding=ROUND_FLOOR)
    said = {
        "name": name,
        "file": path.name,
        "kind": plain.kind,
        "about": indented(f"This is about {plain.about}."),
        "n": graph.n,
        "m": len(graph.edges),
        "position": " and a position" if poses else "",
        "digest": plain.sha256,
        "d": d,
        "bound": f"{floor.divide(Decimal(bound.numerator), Decimal(bound.denominator)):f}",
    }
    return "".join(
        (
            HEADER.format(**said),
            f"\nDefinition {name}_graph : list edge := [\n",
            ";\n".join(measurements(graph, d, poses)),
            f"]%Q.\n\nDefinition {name}_proof : proof := Proof {fields}%Z.\n",
            THEOREM.format(**said),
        )
    )


def main(arguments: Sequence[str]) -> int:
    """Write the theorem to the standard output."""
    if len(arguments) not in (3, 4) or not all(word.isdecimal() for word in arguments[3:]):
        sys.stderr.write("usage: certificate.py NAME GRAPH PROOF [BITS]\n")
        return 2
    name, graph, proof = arguments[:3]
    try:
        sys.stdout.write(theorem(name, Path(graph), Path(proof), *map(int, arguments[3:])))
    except (
        checker.Refused,
        checker.Unreadable,
        integer_reader.Refused,
        integer_reader.Unreadable,
    ) as reason:
        sys.stderr.write(f"error: {reason}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Both checkers on the same damaged files: ``python -m reports.studies.damaged_proofs``.

Draws small graphs, with landmarks and priors now and then, proves their optima under F or the cost
of g2o, and changes bits, rows and numbers of the proofs, their headers, and lines of the graphs.
Either both checkers say the same, or the integer checker alone proves a bound: the other factorizes
in doubles, with hints that may be damaged. Rational arithmetic confirms such a bound on F; one on
g2o's cost is compared with the optimum. Writes reports/results/damaged_proofs.md.
"""

from __future__ import annotations

import io
import json
import tempfile
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import CertPGOError, checker, integer_checker, integer_reader
from certpgo.graph.components import rotations_alone
from certpgo.solve.proving import write_proof
from reports.studies._printing import RESULTS, options
from reports.studies.bookkeeping.drawing import draw
from reports.studies.bookkeeping.readers import respelled

OUT = RESULTS / "damaged_proofs.md"
#: How far apart the bounds of both may be: doubles round outwards, residuals to 2^-100.
CLOSE = Fraction(1, 2**40)
#: What may stand in a header, besides what fits.
HEADERS: dict[str, tuple[Any, ...]] = {
    "format": ("another",),
    "version": (0, 1.0, True, "1", 4),
    "cost": ("chordal",),
    "kind": ("poses", "rotations", "similarities"),
    "d": (2, 3, 3.0),
    "keep": ("all", "first", "last", "some"),
    "rotation_information": ("tangent", "rpy", "quaternion", None),
    "kappa": (2.5, 1, -1.0, 0, True, "2", 1e-200, 1e999),
    "tau": (2.5, 7, 0.0, [1.0], 1e-99),
    "pin": (0, 1, 2, -1, 10**6, 0.0),
    "exponent": (-3, 0, 9, 300, 301, 10**30),
    "landmarks": (True, False, 1),
    "priors": (True, False, None),
    "origin": (None, [0.0, 0.0], [0.5, 1.0, 2.0], [1, 2, 3], "here"),
    "component_sha256": ("0" * 64,),
}


def proven(folder: Path, rng: np.random.Generator) -> tuple[Path, dict[str, Any]] | None:
    """A graph file and the arrays of a proof of its optimum, under F or the cost of g2o."""
    path, proof = folder / "drawn.g2o", folder / "drawn.cert"
    drawn = draw(rng, nodes=(3, 6))
    path.write_text(drawn.text)
    try:
        instance = certpgo.read(path, quiet=True)
        if not drawn.world and not drawn.points.any() and rng.random() < 0.3:
            instance = rotations_alone(instance)
        full = instance.graph.has_positions and rng.random() < 0.4
        answer = certpgo.solve(instance, cost="g2o" if full else "chordal")
        write_proof(proof, path, instance, answer.estimate, answer.certificate)
    except CertPGOError:
        return None
    with np.load(proof) as archive:
        return path, {name: archive[name].copy() for name in archive.files}


def damaged(rng: np.random.Generator, arrays: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """A proof with one array, or one word of its header, changed."""
    name = str(rng.choice(sorted(arrays)))
    if name == "claim":
        word = str(rng.choice(sorted(HEADERS)))
        choices = HEADERS[word]
        claim = json.loads(bytes(arrays[name])) | {word: choices[int(rng.integers(len(choices)))]}
        return "header", {**arrays, name: np.frombuffer(json.dumps(claim).encode(), np.uint8)}
    array, kind = arrays[name].copy(), int(rng.integers(5))
    if kind == 0:
        raw = array.view(np.uint8).reshape(-1)
        raw[rng.integers(len(raw))] ^= np.uint8(1 << rng.integers(8))
    elif kind == 1:
        i, j = rng.integers(len(array), size=2)
        array[[i, j]] = array[[j, i]]
    elif kind == 2:
        array = array[:-1] if rng.random() < 0.5 else np.asfortranarray(array)
    elif array.dtype.kind == "f" and kind == 3:
        factor = float(rng.choice([0.3, 30.0, 1.0 + 1e-9, 1.0 + 1e-14]))
        array.flat[rng.integers(array.size)] *= array.dtype.type(factor)
    elif array.dtype.kind == "f":
        array += array.dtype.type(10.0 ** rng.uniform(-16, 0)) * np.abs(array).max(initial=0.0)
    return name, {**arrays, name: array}


def packed(arrays: dict[str, Any]) -> bytes:
    """A proof file of these arrays."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def verdicts(path: Path, proof: Path) -> tuple[Any, Any]:
    """What both checkers prove; None where they refuse, in one line."""
    found: list[Any] = []
    for program in (checker, integer_checker):
        try:
            found.append(program.check(path, proof))
        except (program.Refused, program.Unreadable) as reason:
            if "\n" in str(reason):
                raise ValueError(f"a reason of several lines: {reason}") from None
            found.append(None)
    return found[0], found[1]


def compared(path: Path, proof: Path, known: Any = None) -> str:
    """How both answers compare; a name that begins with "false" is a bug in one of them.

    ``known`` is what the proof said before it was damaged, about the cost of g2o.
    """
    doubles, integers = verdicts(path, proof)
    if known is not None and any(
        said is not None and not (said.lower <= known.upper and known.lower <= said.upper)
        for said in (doubles, integers)
    ):
        return "false: not the optimum's"
    if doubles is None and integers is None:
        return "both refuse"
    if integers is None:
        return "false: the integer checker alone refuses"
    if doubles is None:
        confirmed = known is not None or is_positive_semidefinite(path, proof)
        return "proved by integers alone" if confirmed else "false: proved by integers alone"
    lower, upper = Fraction(doubles.lower), Fraction(doubles.upper)
    agree = (
        doubles.about == integers.about
        and lower <= integers.lower <= lower * (1 + CLOSE)
        and upper * (1 - CLOSE) - CLOSE**4 <= integers.upper <= upper
    )
    return "both prove the same" if agree else "false: other bounds"


def is_positive_semidefinite(path: Path, proof: Path) -> bool:
    """Whether the matrix of a proof is, up to 2^-150 of its largest entry, by rational numbers.

    No node is pinned. The checker's rotations are within 2^-160.
    """
    with np.load(proof) as archive:
        claim = checker.read_claim(archive)
        graph = checker.read_graph(path.read_bytes(), claim, None)
        multipliers = archive["multipliers"].tolist()
    d, b = claim["d"], claim["d"] + 1
    A = np.full((b * graph.n, b * graph.n), Fraction(0))
    for e, (i, j) in enumerate(zip(b * graph.i, b * graph.j, strict=True)):
        kappa, tau = Fraction(float(graph.kappa[e])), Fraction(float(graph.tau[e]))
        R = graph.R[e] * Fraction(1, 2**checker.POINT)
        A[i + 1 : i + b, i + 1 : i + b] += kappa * np.eye(d, dtype=int)
        A[j + 1 : j + b, j + 1 : j + b] += kappa * np.eye(d, dtype=int)
        A[i + 1 : i + b, j + 1 : j + b] -= kappa * R
        A[j + 1 : j + b, i + 1 : i + b] -= kappa * R.T
        if claim["kind"] == "poses":
            rows = [j, i, *range(i + 1, i + b)]
            terms = np.array(
                [Fraction(1), Fraction(-1), *(-Fraction(x) for x in graph.t[e].tolist())]
            )
            A[np.ix_(rows, rows)] += tau * np.outer(terms, terms)
    r, s = np.triu_indices(d)
    for k, row in enumerate(multipliers):
        Lam = np.full((d, d), Fraction(0))
        Lam[r, s] = Lam[s, r] = [Fraction(x) for x in row]
        A[b * k + 1 : b * (k + 1), b * k + 1 : b * (k + 1)] -= Lam
    A += np.eye(len(A), dtype=int) * (abs(A).max() / 2**150)
    unit = max(x.denominator for x in A.flat)
    return leading_minors_are_positive((A * unit).tolist())


def leading_minors_are_positive(rows: list[list[Any]]) -> bool:
    """By elimination without fractions (Bareiss)."""
    A, last = [[int(x) for x in row] for row in rows], 1
    for k, row in enumerate(A):
        if row[k] <= 0:
            return False
        for other in A[k + 1 :]:
            for q in range(len(A) - 1, k - 1, -1):
                other[q] = (row[k] * other[q] - other[k] * row[q]) // last
        last = row[k]
    return True


def compared_reading(text: bytes, claim: dict[str, Any]) -> str:
    """How what both read in a graph file compares."""
    found: list[Any] = []
    options = {"cost": None, "landmarks": False, "priors": False, "origin": None} | claim
    options["maps"] = options["landmarks"] or options["priors"]
    for program, given in ((checker, claim), (integer_reader, options)):
        try:
            found.append(program.read_graph(text, given, None))
        except (program.Refused, program.Unreadable) as reason:
            if "\n" in str(reason):
                raise ValueError(f"a reason of several lines: {reason}") from None
            found.append(None)
    if None in found:
        return "neither reads it" if found == [None, None] else "false: one reads it"
    theirs, mine = measurements(*found)
    return "both read the same" if theirs == mine else "false: they read differently"


def measurements(theirs: Any, mine: Any) -> tuple[Any, Any]:
    """Nodes, points and measurements in both, in some order; rotations in units of 2^-POINT."""
    points = set() if theirs.points is None else set(np.flatnonzero(theirs.points).tolist())
    R = checker.rotations(theirs.q) if theirs.R is None else theirs.R
    rows = zip(theirs.i, theirs.j, R.tolist(), theirs.t, theirs.kappa, theirs.tau, strict=True)
    first = [
        (int(i), int(j), R, t.tolist(), float(kappa), float(tau)) for i, j, R, t, kappa, tau in rows
    ]
    if theirs.information is not None:
        p, d = theirs.information.shape[1], theirs.t.shape[1]
        for k, (row, A) in enumerate(zip(first, theirs.information, strict=True)):
            first[k] = (*row, A[np.triu_indices(p if row[4] else d)].tolist())
    second = []
    for edge in mine.edges:
        N, D = integer_checker.matrix(edge.q, len(edge.t)), integer_checker.norm(edge.q)
        R = [[(x << checker.POINT) // D for x in row] for row in N]
        *t, kappa, tau = map(real, (*edge.t, edge.kappa, edge.tau))
        information = ([*map(real, edge.information)],) if edge.information else ()
        second.append((edge.i, edge.j, R, t, kappa, tau, *information))
    key = str
    return (
        (theirs.n, points, sorted(first, key=key)),
        (mine.n, mine.points, sorted(second, key=key)),
    )


def real(x: int) -> float:
    """A double that is stored as an integer."""
    return float(Fraction(x, integer_checker.ONE))


def outcomes(seed: int, proofs: int, each: int) -> tuple[Counter[tuple[str, str]], list[str]]:
    """What was changed and how answers compared, counted; and the false ones by name."""
    rng, said, false = np.random.default_rng(seed), Counter[tuple[str, str]](), []
    with tempfile.TemporaryDirectory() as name:
        for k in range(proofs):
            made = proven(Path(name), rng)
            if made is None:
                continue
            path, arrays = made
            proof = path.with_name("tried.cert")
            proof.write_bytes(packed(arrays))
            known = integer_checker.check(path, proof) if "couplings" in arrays else None
            text, claim = path.read_bytes(), json.loads(bytes(arrays["claim"]))
            for number in range(each + 1):
                kind = "nothing"
                if number % 4 == 3:
                    kind, other = "the graph", respelled(rng, text)
                    found = compared_reading(other, claim)
                elif number % 4 == 2:
                    kind, whole = "a bit of the file", bytearray(packed(arrays))
                    whole[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
                    proof.write_bytes(whole)
                    found = compared(path, proof, known)
                else:
                    tried = arrays
                    if number:
                        kind, tried = damaged(rng, arrays)
                    proof.write_bytes(packed(tried))
                    found = compared(path, proof, known)
                said[kind, found] += 1
                if found.startswith("false"):
                    false.append(f"seed {seed}, proof {k}, change {number} ({kind}): {found}")
    return said, false


def main() -> int:
    """Compare, and write a table."""
    arguments = options(__doc__, seed=0, proofs=160, each=16, out=OUT)
    said, false = outcomes(arguments.seed, arguments.proofs, arguments.each)
    lines = ["| changed | answers | times |", "| --- | --- | ---: |"]
    lines += [f"| {kind} | {found} | {n} |" for (kind, found), n in sorted(said.items())]
    text = (
        "# Damaged proofs\n\nWhat `certpgo/checker.py` and `certpgo/integer_checker.py` say about "
        "the same\nfiles; made by `python -m reports.studies.damaged_proofs`.\n"
        f"{sum(said.values())} comparisons, {len(false)} of them false. A bound on F that integers "
        "alone prove\nis confirmed in rational arithmetic, and one on g2o's cost does not exclude "
        "the optimum:\ndoubles fail when hints are damaged, or by rounding.\n\n"
    )
    lines += [f"\n{line}" for line in false[:20]]
    arguments.out.write_text(text + "\n".join([*lines, ""]))
    print(*lines, sep="\n")
    return bool(false)


if __name__ == "__main__":
    raise SystemExit(main())

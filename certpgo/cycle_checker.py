"""Verifies proofs by cycles that rotations of a g2o file are nearly optimal, in fractions.

    python cycle_checker.py GRAPH PROOF

needs only this file and Python. docs/checker.md says in section 16 what is proven, and why.
"""

import hashlib
import json
import re
import sys
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from math import ceil, floor, frexp, isqrt
from pathlib import Path
from typing import Any, NamedTuple

TAGS = {"EDGE_SE2": (2, 3, 6), "EDGE_SE3:QUAT": (3, 7, 21)}  # dimension, numbers, information
OTHERS = {"VERTEX_SE2", "VERTEX_SE3:QUAT", "FIX", "PARAMS_SE2OFFSET", "PARAMS_SE3OFFSET"}
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
MOST_BITS = 4096
FINE = 1 << 700  # costs are rounded to multiples of 1/FINE


class Refused(Exception):  # noqa: N818
    """The proof is not valid for this file, with the reason."""


class Unreadable(Exception):  # noqa: N818
    """The graph or proof file cannot be read, with the reason."""


class Answer(NamedTuple):
    """F(x) <= upper and F* >= lower, where ``about`` describes F."""

    upper: Fraction
    lower: Fraction
    about: str

    @property
    def within(self) -> tuple[Any, ...]:
        """Nothing is claimed of distances."""
        return ()

    @property
    def relative_gap(self) -> Fraction:
        """(F(x) - F*)/F(x) at most."""
        return 1 - self.lower / self.upper if self.upper else Fraction(0)

    def __str__(self) -> str:
        sides = (self.upper, ROUND_CEILING), (self.lower, ROUND_FLOOR)
        upper, lower = (
            Context(15, to).divide(*map(Decimal, x.as_integer_ratio())) for x, to in sides
        )
        return f"PROVED: F(x) <= {upper:g}, F* >= {lower:g}"


def product(a: list[Any], b: list[Any]) -> list[Any]:
    """The quaternion of R(a) R(b)."""
    (x, y, z, w), (p, q, r, s) = a, b
    i, j = w * p + x * s + y * r - z * q, w * q - x * r + y * s + z * p
    return [i, j, w * r + x * q - y * p + z * s, w * s - x * p - y * q - z * r]


def whole(q: list[float]) -> list[int]:
    """A quaternion of the same rotation in integers: doubles have powers of two below them."""
    below = max(Fraction(x).denominator for x in q)
    return [int(Fraction(x) * below) for x in q]


def half_angle(theta: float) -> list[float]:
    """A quaternion: the doubles nearest to the sine and the cosine of theta/2, by their series."""
    bits, sums, k, sign = 600 - min(0, frexp(theta)[1]), [0] * 4, 0, 1 if theta > 0 else -1
    x, term = floor(Fraction(abs(theta)) * (1 << bits - 1)), 1 << bits
    while term and abs(theta) <= 64:
        sums[k % 4], k = sums[k % 4] + term, k + 1
        term = term * x // (k << bits)
    ends = [(sums[1] - sums[3] + e, sums[0] - sums[2] + e) for e in (-1 << 200, 1 << 200)]
    low, high = ([float(Fraction(n, 1 << bits)) for n in end] for end in ends)
    if theta and low != high:
        raise ValueError("an angle that is too large, or too close to call")
    return [0, 0, sign * low[0], low[1]] if theta else [0, 0, 0, 1]


def weight(words: list[str], d: int) -> Fraction:
    """Kappa of an upper triangle of information, rounded to a double once."""
    if d == 2:
        return Fraction(float(words[5]))
    a, b, c, p, q, r = map(Fraction, words[15:])
    first, whole = a * p - b * b, a * (p * r - q * q) - b * (b * r - c * q) + c * (b * q - c * p)
    if min(a, first, whole) <= 0:
        raise ValueError("information that is not positive definite")
    return Fraction(float(3 * whole / (2 * (first + a * r - c * c + p * r - q * q))))


def read_graph(text: str, claim: dict[str, Any]) -> list[Any]:
    """The measured rotations: i, j, a quaternion x y z w of any norm, and kappa."""
    edges = []
    for line in text.replace("\r\n", "\n").replace("\t", " ").split("\n"):
        tag, *words = line.split("#")[0].split() or ["FIX"]
        if not line.isprintable() or not line.isascii():
            raise ValueError("plain text expected")
        if tag in OTHERS:
            continue
        d, size, upper = TAGS[tag]
        i, j, *rest = words
        if d != claim["d"] or i == j or not all(map(NUMBER.fullmatch, words)):
            raise ValueError(f"measurements between two nodes expected, in {claim['d']}D: {line}")
        if len(rest) not in (size, size + upper):
            raise ValueError(f"{size} numbers expected, and {upper} of information: {line}")
        q = half_angle(float(rest[2])) if d == 2 else [float(word) for word in rest[3:7]]
        kappa = weight(rest[size:], d) if rest[size:] else Fraction(1)
        kappa /= 4 if rest[size:] and claim["rotation_information"] == "quaternion" else 1
        kappa = kappa if claim["kappa"] is None else Fraction(*claim["kappa"])
        if kappa <= 0:
            raise ValueError(f"a positive weight expected: {line}")
        edges.append((int(i), int(j), whole(q), kappa))
    return edges


def bounds(edges: list[Any], rotations: dict[int, Any], cycles: Any, unit: Fraction) -> Any:
    """F of these rotations, and a lower bound on that of all others.

    A cycle is a torque, its steps (k and -k for the k-th edge and its reverse, from 1), and the
    stiffness of a spring for each: integers, in this unit.
    """
    springs, torques = [0] * len(edges), [[0, 0, 0] for _ in edges]
    for torque, steps, stiffness in cycles:
        if not all(0 < abs(k) <= len(edges) for k in steps):
            raise Refused("a cycle has an edge that the graph has not")
        ends = [edges[abs(k) - 1][:2][:: 1 if k > 0 else -1] for k in steps]
        if any(a[1] != b[0] for a, b in zip(ends, ends[1:] + ends[:1], strict=True)):
            raise Refused("a cycle is not a closed walk")
        u, square = stiffness[0], sum(f * f for f in torque)
        for w in stiffness[1:-1]:
            if u + w <= 0:
                raise Refused("a cycle's springs are too soft for its torque")
            u = (u * w - square) // (u + w)
        if u + stiffness[-1] < 0:
            raise Refused("a cycle's springs are too soft for its torque")
        for k, w in zip(steps, stiffness, strict=True):
            springs[abs(k) - 1] += w
            for axis, f in zip((2,) if len(torque) == 1 else range(3), torque, strict=True):
                torques[abs(k) - 1][axis] += f if k > 0 else -f
    upper = lower = 0
    for (i, j, q, kappa), spring, torque in zip(edges, springs, torques, strict=True):
        x, y, z, w = rotations[j]
        *v, w = product(product(rotations[i], q), [-x, -y, -z, w])
        half = 2 * kappa / (w * w + sum(x * x for x in v))  # by |E - I|^2 = 4 (1 - cos)
        cosine = half * w * w - kappa
        off = [half * w * x - unit * f for x, f in zip(v, torque, strict=True)]
        delta, cost = unit * spring - cosine, 4 * (kappa - cosine)
        n, d = (delta * delta + sum(r * r for r in off)).as_integer_ratio()
        root = Fraction(isqrt(n * d << 400) + 1, d << 200)
        upper += ceil(cost * FINE)
        lower += floor((cost - 4 * (delta + root)) * FINE)
    return Fraction(upper, FINE), Fraction(max(lower, 0), FINE)


def _whole(word: str) -> Any:
    raise Refused(f"a proof holds integers, not {word[:40]}")


def _require_known(claim: dict[str, Any]) -> None:
    """Refuse options without a meaning, and numbers that only take time."""
    choices = ["tangent", "rpy", *["quaternion"] * (claim["d"] == 3)]
    if claim["rotation_information"] not in choices:
        raise ValueError(f"rotation_information must be {' or '.join(choices)}")
    if type(claim["bits"]) is not int or abs(claim["bits"]) > MOST_BITS:
        raise ValueError(f"bits must be an integer up to {MOST_BITS}")
    kappa = [1, 1] if claim["kappa"] is None else claim["kappa"]
    if [type(number) for number in kappa] != [int, int]:
        raise ValueError("kappa must be null, or a numerator and a denominator")


def check(graph_path: str | Path, proof_path: str | Path) -> Answer:
    """Check a proof about a graph file; raises `Refused` or `Unreadable`."""
    try:
        data, stated = Path(graph_path).read_bytes(), Path(proof_path).read_text("ascii")
        claim = json.loads(stated, parse_float=_whole, parse_constant=_whole)
        if (claim["format"], claim["version"]) != ("certpgo cycles", 1):
            raise Unreadable(f"{proof_path}: not a proof by cycles of version 1")
        if hashlib.sha256(data).hexdigest() != claim["graph_sha256"]:
            raise Refused(
                f"{graph_path} is not the file that was proven about: its SHA-256 differs"
            )
        _require_known(claim)
        edges = read_graph(data.decode("ascii"), claim)
        ids = sorted({k for edge in edges for k in edge[:2]})
        rows = [[0] * (6 - 2 * claim["d"]) + row for row in claim["rotations"]]
        if {len(row) for row in rows} != {4} or not ids:
            raise Refused("a rotation for each node expected")
        rotations, unit = dict(zip(ids, rows, strict=True)), 1 / Fraction(2) ** claim["bits"]
        upper, lower = bounds(edges, rotations, claim["cycles"], unit)
    except OSError as error:
        raise Unreadable(f"{error.filename}: {error.strerror}") from None
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as e:
        raise Unreadable(f"not a readable graph and proof ({type(e).__name__}: {e})") from None
    kappa = "of the file" if claim["kappa"] is None else Fraction(*claim["kappa"])
    read = f"kappa {kappa}, rotational information read as {claim['rotation_information']}"
    said = f"chordal cost F, the rotations of {len(ids)} nodes from {len(edges)} measurements"
    return Answer(upper, lower, f"{said} ({read}), by {len(claim['cycles'])} cycles")


def main(arguments: list[str]) -> int:
    """Print what is proven; exit codes: 0 proved, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) != 2:
        sys.stderr.write("usage: cycle_checker.py GRAPH PROOF\n")
        return 2
    try:
        answer = check(*arguments)
        sys.stdout.write(f"{answer}\nabout {answer.about}\n")
    except Refused as reason:
        sys.stdout.write(f"REFUSED: {reason}\n")
        return 6
    except Unreadable as reason:
        sys.stderr.write(f"error: {reason}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

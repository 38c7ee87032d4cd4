"""Verifies proofs that an estimate of a pose graph is nearly optimal, in integers alone.

    python integer_checker.py GRAPH PROOF

needs only this file and Python, and uses no floating-point number. It reads the same files as
checker.py and prints the same lines, but shares no code with it. docs/checker.md says what is
proven (section 1), what a proof file holds (section 10) and why this program is right (section 11).
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sys
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import cache
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

ULP = 1074  # every double is a multiple of 2^-1074, and stored as that integer
FINE = 1400  # fractional bits of costs
PRECISIONS = (88, 184)  # fractional bits of the factor, tried in turn


class Refused(Exception):  # noqa: N818
    """The proof is not valid, with the reason."""


class Unreadable(Exception):  # noqa: N818
    """The graph or proof file cannot be read, with the reason."""


# --- Doubles, as integers times 2^-ULP ------------------------------------------------------------


def nearest(n: int, d: int) -> int:
    """The double nearest to n/d, d > 0; of two, the one with an even last bit."""
    size = abs(n)
    exponent = size.bit_length() - d.bit_length()
    exponent -= size << max(-exponent, 0) < d << max(exponent, 0)
    last = max(exponent - 52, -ULP)
    top, bottom = size << max(-last, 0), d << max(last, 0)
    kept, left = divmod(top, bottom)
    kept += 2 * left > bottom or (2 * left == bottom and kept & 1)
    if kept << (last + ULP) >= 1 << (1024 + ULP):
        raise ValueError("a number that is not finite")
    return (kept if n >= 0 else -kept) << (last + ULP)


_DECIMAL = re.compile(r"([+-]?)(\d*)(?:\.(\d*))?(?:[eE]([+-]?\d+))?", re.ASCII)


def decimal(word: str) -> tuple[int, int]:
    """Integers m and e with the number m 10^e that a word states."""
    match = _DECIMAL.fullmatch(word)
    if match is None or not (match[2] or match[3]):
        raise ValueError(f"a decimal number expected, not {word[:40]}")
    digits, after = match[2] + (match[3] or ""), len(match[3] or "")
    return int(match[1] + digits), int(match[4] or 0) - after


def double(word: str) -> int:
    """The double nearest to a decimal number."""
    m, e = decimal(word)
    e = min(max(e, -4800), 4800)  # beyond, any double but zero would overflow or vanish
    return nearest(m * 10 ** max(e, 0), 10 ** max(-e, 0))


def trimmed(numbers: Sequence[int]) -> tuple[list[int], int]:
    """Smaller integers and a unit with the same numbers, integer times 2^-unit."""
    together = 0
    for x in numbers:
        together |= x
    zeros = (together & -together).bit_length() - 1 if together else ULP
    return [x >> zeros for x in numbers], ULP - zeros


def shifted(x: int, by: int) -> int:
    """The integer below x 2^by."""
    return x << by if by >= 0 else x >> -by


# --- The graph ------------------------------------------------------------------------------------

Quaternion = tuple[int, int, int, int]  # x y z w of any norm; in the plane 0 0 sin cos of half


class Edge(NamedTuple):
    """A measurement from node i, in its frame, of node j."""

    i: int
    j: int
    q: Quaternion
    t: tuple[int, ...]
    kappa: int  # 0: of a position alone
    tau: int
    role: str
    upper: tuple[int, ...] = ()


#: The tags that are read: role, dimension, and whether they measure a rotation.
TAGS = {
    "EDGE_SE2": ("pose", 2, True),
    "EDGE_SE3:QUAT": ("pose", 3, True),
    "EDGE_SE2_XY": ("sighting", 2, False),
    "LANDMARK2": ("apart", 2, False),
    "EDGE_SE3_TRACKXYZ": ("sighting", 3, False),
    "EDGE_PRIOR_SE2": ("prior", 2, True),
    "EDGE_SE2_PRIOR": ("prior", 2, True),
    "EDGE_SE3_PRIOR": ("prior", 3, True),
    "EDGE_PRIOR_SE2_XY": ("prior", 2, False),
    "EDGE_SE2_GPS": ("prior", 2, False),
    "EDGE_SE3_XYZPRIOR": ("prior", 3, False),
}
_OTHERS = re.compile(
    r"VERTEX_(SE2|SE3:QUAT|XY|TRACKXYZ|POINT_XYZ)|FIX|PARAMS_(SE2OFFSET|SE3OFFSET|CAMERACALIB)"
    r"|EDGE_(BEARING_SE2_XY|POINT_XYZ)|LANDMARK3"
)
_PLAIN = {9, *range(32, 127), *range(128, 256)}


def read_edges(text: bytes, claim: dict[str, Any]) -> Iterator[Edge]:
    """The measurements of a g2o or 1DSfM file that a proof's header asks for."""
    formats, sensors, used = set(), {0: True}, set()
    asked = {"pose": True, "prior": claim["priors"]}
    lines = text.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").split(b"\n")
    for number, line in enumerate(lines, 1):
        try:
            if not _PLAIN.issuperset(line) or not (said := line.split(b"#")[0]).isascii():
                raise ValueError("plain text expected, and lines that end in LF or CRLF")
            tag, *words = said.decode().split() or [""]
            role, d, _ = TAGS.get(tag, ("", 3, False))
            if role and asked.get(role, claim["landmarks"]):
                sensor, edge = g2o_edge(tag, words, claim)
                used.add(sensor)
            elif tag == "PARAMS_SE3OFFSET" and claim["d"] == 3 and any_map(claim):
                sensor, at_origin = g2o_sensor(words)
                sensors[sensor] = sensors.get(sensor, True) and at_origin
                continue
            elif role or not tag or _OTHERS.fullmatch(tag):
                continue
            else:
                edge = matrix_edge([tag, *words])
        except ValueError as error:
            raise Unreadable(f"line {number}: {error}") from None
        if edge.i == edge.j and edge.role == "pose":
            raise Unreadable(f"line {number}: node {edge.i} is measured from itself")
        formats.add((d, bool(role)))
        yield edge
    for sensor in sorted(used):
        if not sensors.get(sensor, False):
            raise Unreadable(f"sensor {sensor} is not known to be at its body's origin")
    if len(formats) > 1 or {d for d, _ in formats} != {claim["d"]}:
        raise Unreadable(f"no graph of {claim['d']}D measurements")


def any_map(claim: dict[str, Any]) -> bool:
    """Whether lines other than those between poses are read."""
    return bool(claim["landmarks"] or claim["priors"])


def split(words: list[str], ids: int, *sizes: int) -> tuple[list[int], list[str]]:
    """Ids, and as many decimal numbers as one of the sizes."""
    if len(words) - ids not in sizes:
        raise ValueError(f"{' or '.join(str(ids + size) for size in sizes)} numbers expected")
    if not all(re.fullmatch(r"[+-]?[0-9]+", word) for word in words[:ids]):
        raise ValueError("ids are integers")
    return [int(word) for word in words[:ids]], words[ids:]


def g2o_edge(tag: str, words: list[str], claim: dict[str, Any]) -> tuple[int, Edge]:
    """The sensor, 0 for none, and ids, position, rotation and information, of which some lack."""
    role, d, turned = TAGS[tag]
    has_sensor, p = d == 3 and role != "pose", 3 * d - 3 if turned else d
    size = {(2, True): 3, (3, True): 7}.get((d, turned), d)
    ids, rest = split(words, 2 - (role == "prior") + has_sensor, size, size + p * (p + 1) // 2)
    sensor = ids.pop() if has_sensor else 0
    numbers, information = [double(word) for word in rest[:size]], tuple(rest[size:])
    q: Quaternion = (0, 0, 0, 1)
    if turned and d == 3:
        q = quaternion(numbers[3:])
    elif turned:
        cosine, sine = half_angle(numbers[2])
        q = quaternion([0, 0, sine, cosine])
    one, upper = 1 << ULP, tuple(double(word) for word in information)
    kappa, tau = one * turned, one
    if information and claim["cost"] is None and not (claim["kappa"] and claim["tau"]):
        kappa, tau = weights(information, d)
        if claim["rotation_information"] == "quaternion":
            kappa >>= 2  # half the angle, a quarter of the information
    return sensor, Edge(ids[0], ids[-1], q, tuple(numbers[:d]), kappa, tau, role, upper)


def g2o_sensor(words: list[str]) -> tuple[int, bool]:
    """A sensor, and whether it is at its body's origin."""
    (sensor,), pose = split(words, 1, 7)
    *zeros, w = map(double, pose)
    return sensor, not any(zeros) and 0 < abs(w) < 1 << (ULP + 400)


def matrix_edge(words: list[str]) -> Edge:
    """Ids, a rotation matrix row by row, and a direction, which is not used."""
    (i, j), rest = split(words, 2, 12)
    M = [double(word) for word in rest][:9]
    columns, one = [M[c::3] for c in range(3)], 1 << (2 * ULP)
    products = [sum(x * y for x, y in zip(a, b)) for a in columns for b in columns]
    off = max(abs(x - one * (k % 4 == 0)) for k, x in enumerate(products))
    (a, b, c), (d, e, f), (g, h, k) = M[:3], M[3:6], M[6:]
    determinant = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
    if max(map(abs, M)) >= 2 << ULP or 1000 * off > one or 1000 * determinant <= one << ULP:
        raise ValueError("a rotation matrix expected")
    return Edge(i, j, quaternion(shepperd(M)), (0, 0, 0), 1 << ULP, 1 << ULP, "pose")


def shepperd(M: list[int]) -> list[int]:
    """A quaternion of a matrix, each addition rounded to the nearest double."""

    def add(*terms: int) -> int:
        total = terms[0]
        for term in terms[1:]:
            total = nearest(total + term, 1 << ULP)
        return total

    one, (a, b, c) = 1 << ULP, M[::4]
    trace = add(a, b, c)
    x, y, z = add(M[7], -M[5]), add(M[2], -M[6]), add(M[3], -M[1])
    xy, xz, yz = add(M[3], M[1]), add(M[2], M[6]), add(M[7], M[5])
    if trace >= max(a, b, c):
        return [x, y, z, add(one, trace)]
    if a >= max(b, c):
        return [add(one, add(a, -b, -c)), xy, xz, x]
    if b >= c:
        return [xy, add(one, add(b, -a, -c)), yz, y]
    return [xz, yz, add(one, add(c, -a, -b)), z]


def quaternion(numbers: Sequence[int]) -> Quaternion:
    """The same rotation by small integers."""
    if not any(numbers):
        raise Refused("a rotation is zero")
    x, y, z, w = trimmed(numbers)[0]
    return x, y, z, w


def half_angle(theta: int) -> tuple[int, int]:
    """The doubles nearest to the cosine and the sine of theta/2."""
    if abs(theta) > 10**6 << ULP:
        raise ValueError("an angle beyond 1e6 radians")
    if theta == 0:
        return 1 << ULP, 0
    bits = 320 + max(0, ULP - theta.bit_length())
    cosine, sine = circle(shifted(abs(theta), bits - ULP - 1), bits)  # within 2^21
    sine = sine if theta >= 0 else -sine
    found = {
        (nearest(cosine + e, 1 << bits), nearest(sine + f, 1 << bits))
        for e in (-(1 << 32), 1 << 32)
        for f in (-(1 << 32), 1 << 32)
    }
    if len(found) > 1:
        raise ValueError("an angle too close to call")
    return found.pop()


def circle(x: int, bits: int) -> tuple[int, int]:
    """Cosine and sine of x, 0 <= x < 2^19, in units of 2^-bits: within 2^21 if x is within 1."""
    quarters, left = 0, x
    if 2 * x > 1 << bits:
        half_pi = pi(bits + 40)
        quarters = ((x << 41) + half_pi) // (2 * half_pi)
        left = x - (quarters * half_pi >> 40)
    sums, term, k = [0, 0], 1 << bits, 0
    while abs(term) > 1:
        sums[k % 2] += -term if k & 2 else term
        k += 1
        term = (term * left >> bits) // k
    c, s = sums
    return [(c, s), (-s, c), (-c, -s), (s, -c)][quarters % 4]


@cache
def pi(bits: int) -> int:
    """Half of pi in units of 2^-bits, within 2^12: 8 arctan(1/5) - 2 arctan(1/239)."""
    total = 0
    for factor, n in ((8, 5), (-2, 239)):
        power, k = (1 << bits) // n, 1
        while power:
            total += factor * (power // k if k % 4 == 1 else -(power // k))
            power, k = power // (n * n), k + 2
    return total


@cache
def weights(information: tuple[str, ...], d: int) -> tuple[int, int]:
    """The doubles kappa and tau nearest to what an upper triangle in decimals says."""
    words, n = list(information), len(information)
    if n == d * (d + 1) // 2:
        return 0, harmonic_mean(words, d)
    p = 3 * d - 3
    places = {(a, b): k for k, (a, b) in enumerate((a, b) for a in range(p) for b in range(a, p))}
    first = [words[places[a, b]] for a in range(d) for b in range(a, d)]
    last = [words[places[a, b]] for a in range(d, p) for b in range(a, p)]
    return harmonic_mean(last, p - d, 2 if d == 3 else 1), harmonic_mean(first, d)


def harmonic_mean(words: list[str], d: int, over: int = 1) -> int:
    """The double nearest to d / tr(A^-1) / over, A of this upper triangle."""
    pairs = [decimal(word) for word in words]
    lowest = min(e for _, e in pairs)
    if not -400 <= lowest <= max(e for _, e in pairs) <= 400:
        raise ValueError("an information number out of range")
    upper = iter([m * 10 ** (e - lowest) for m, e in pairs])
    A = [[0] * d for _ in range(d)]
    for a in range(d):
        for b in range(a, d):
            A[a][b] = A[b][a] = next(upper)
    minors = [determinant([row[:k] for row in A[:k]]) for k in range(1, d + 1)]
    if min(minors) <= 0:
        raise ValueError("information that is not positive definite")
    without = [
        [[x for b, x in enumerate(row) if b != k] for a, row in enumerate(A) if a != k]
        for k in range(d)
    ]
    trace = sum(map(determinant, without))
    scale = 10 ** abs(lowest)
    return nearest(
        d * minors[-1] * (scale if lowest > 0 else 1), trace * over * (1 if lowest > 0 else scale)
    )


def determinant(A: list[list[int]]) -> int:
    """By the first row."""
    if not A:
        return 1
    minors = ([row[:k] + row[k + 1 :] for row in A[1:]] for k in range(len(A)))
    return sum((-1) ** k * x * determinant(minor) for k, (x, minor) in enumerate(zip(A[0], minors)))


class Graph(NamedTuple):
    """Edges between nodes 0 ... n-1, by ascending ids; which are points; the number of priors."""

    n: int
    edges: list[Edge]
    points: set[int]


def read_graph(text: bytes, claim: dict[str, Any], kept: set[int] | None) -> Graph:
    """The measurements that F is made of."""
    edges, points = with_own_ids(list(read_edges(text, claim)))
    if kept is not None:
        edges = [edge for edge in edges if {edge.i, edge.j} <= kept]
    if claim["keep"] != "all":
        edges = edges if claim["keep"] == "last" else edges[::-1]
        chosen = {frozenset(edge[:2]): k for k, edge in enumerate(edges)}
        edges = [edges[k] for k in sorted(chosen.values())]
        edges = edges if claim["keep"] == "last" else edges[::-1]
    if not edges:
        raise Unreadable("no measurements")
    number = {k: node for node, k in enumerate(sorted({k for edge in edges for k in edge[:2]}))}
    measured = []
    for edge in edges:
        kappa, tau, t = edge.kappa, edge.tau, edge.t
        if claim["kappa"] is not None:
            kappa = kappa and double(str(claim["kappa"]))
        if claim["tau"] is not None:
            tau = double(str(claim["tau"]))
        for name, weight in (("kappa", kappa or 1 << ULP), ("tau", tau)):
            if not 1 << (ULP - 400) < weight < 1 << (ULP + 400):
                raise Unreadable(f"{name} must be positive, and neither tiny nor huge")
        if edge.role == "prior" and claim["origin"] is not None:
            t = tuple(x - double(str(o)) for x, o in zip(t, claim["origin"]))
            if any(nearest(x, 1 << ULP) != x for x in t):
                raise Refused("a position from the origin of the proof is not a double")
        ends = {"i": number[edge.i], "j": number[edge.j]}
        measured.append(edge._replace(**ends, kappa=kappa, tau=tau, t=t))
    return Graph(len(number), measured, {number[k] for k in points if k in number})


def with_own_ids(edges: list[Edge]) -> tuple[list[Edge], set[int]]:
    """Edges where each pose, each point and the world has an id of its own; those of the points.

    Points that are numbered apart follow all other ids if one of them has the number of another
    node. The world, from which priors are, is last.
    """
    ends = {
        role: {edge.j for edge in edges if edge.role == role}
        for role in ("sighting", "apart", "prior")
    }
    poses = {edge.i for edge in edges if edge.role != "prior"}
    poses |= {edge.j for edge in edges if edge.role in ("pose", "prior") and edge.kappa}
    points, apart, after = ends["sighting"], ends["apart"], 0
    if poses & points:
        raise Unreadable(f"node {min(poses & points)} is a pose and a point")
    if apart & (poses | points):
        after = max(0, *poses, *points) + 1
        if min(apart) < 0:
            raise Unreadable(f"numbers of points from 0 expected, not {min(apart)}")
    points = points | {k + after for k in apart}
    world = max(ends["prior"] | poses | points, default=0) + 1
    edges = [
        edge._replace(i=world)
        if edge.role == "prior"
        else edge._replace(j=edge.j + after)
        if edge.role == "apart"
        else edge
        for edge in edges
    ]
    rank = {"pose": 0, "sighting": 1, "apart": 1, "prior": 2}
    return sorted(edges, key=lambda edge: rank[edge.role]), points


# --- The proof ------------------------------------------------------------------------------------


class Proof(NamedTuple):
    """The content of a proof file; none of it is trusted."""

    q: list[Quaternion]
    t: list[list[int]]  # empty for rotations alone
    multipliers: list[list[int]]
    order: list[int]
    pin: int
    exponent: int


def read_claim(data: bytes) -> dict[str, Any]:
    """The header of a proof; decimals stay decimals."""
    text = bytes(stored(data, "|u1")[0]).decode()
    claim = json.loads(text, parse_float=Decimal, parse_constant=Decimal)
    claim = {"cost": None, "landmarks": False, "priors": False, "origin": None} | claim
    known = {
        "format": ["certpgo proof"],
        "version": [1],
        "cost": [None],
        "kind": ["poses", "rotations"],
        "d": [2, 3],
        "keep": ["all", "first", "last"],
        "rotation_information": ["tangent", "rpy"] + ["quaternion"] * (claim["d"] == 3),
        "landmarks": [False, True],
        "priors": [False, True],
    }
    for name, choices in known.items():
        if not any(claim[name] == x and type(claim[name]) is type(x) for x in choices):
            raise Unreadable(f"{name} must be {' or '.join(map(str, choices))}")
    for name in ("kappa", "tau"):
        if claim[name] is not None and type(claim[name]) not in (int, Decimal):
            raise Unreadable(f"{name} must be a number")
    if type(claim["pin"]) is not int or type(claim["exponent"]) is not int:
        raise Unreadable("pin and exponent are integers")
    if any_map(claim) and (claim["kind"], claim["component_sha256"]) != ("poses", None):
        raise Unreadable("landmarks and priors are for poses, all of a file's")
    origin = claim["origin"]
    if origin is not None and not (
        claim["priors"] and [*map(type, origin)] == [Decimal] * claim["d"]
    ):
        raise Unreadable("an origin is a list of d numbers, for priors")
    return claim


def stored(data: bytes, dtype: str, shape: tuple[int, ...] | None = None) -> list[list[int]]:
    """The rows of an array in a .npy file, of numbers as unsigned integers."""
    long, size = data[6] > 1, int(dtype[2:])
    start = 12 if long else 10
    start += int.from_bytes(data[8:start], "little")
    header = ast.literal_eval(data[12 if long else 10 : start].decode())
    shape = shape or header["shape"]
    if (data[:6], header["descr"], header["shape"]) != (b"\x93NUMPY", dtype, shape):
        raise Refused(f"{dtype} of shape {shape} expected: another graph's proof?")
    words = [int.from_bytes(data[k : k + size], "little") for k in range(start, len(data), size)]
    n, columns = shape if len(shape) > 1 else (1, *shape)
    if (len(data) - start, len(words)) != (size * len(words), n * columns):
        raise Refused("an array is not as long as it says")
    if header["fortran_order"]:
        return [words[k::n] for k in range(n)]
    return [words[k : k + columns] for k in range(0, len(words), columns)]


def doubles(data: bytes, *shape: int) -> list[list[int]]:
    """The rows of an array of doubles."""
    return [[from_bits(word) for word in row] for row in stored(data, "<f8", shape)]


def from_bits(word: int) -> int:
    """The double of 64 bits: sign, exponent, fraction."""
    exponent, fraction = word >> 52 & 2047, word & (1 << 52) - 1
    if exponent == 2047:
        raise Refused("the proof holds numbers that are not finite")
    size = (fraction | 1 << 52) << (exponent - 1) if exponent else fraction
    return -size if word >> 63 else size


def read_proof(files: dict[str, bytes], claim: dict[str, Any], graph: Graph) -> Proof:
    """The arrays of a proof."""
    n, d, poses = graph.n, claim["d"], claim["kind"] == "poses"
    pairs = doubles(files["rotations"], n, 4 if d == 3 else 2)
    q = [quaternion(row if d == 3 else [0, 0, *row[::-1]]) for row in pairs]
    t = doubles(files["translations"], n, d) if poses else []
    multipliers = doubles(files["multipliers"], n, d * (d + 1) // 2)
    (order,) = stored(files["order"], "<i4", (n,))
    if any(
        word >> 23 & 255 == 255 for word in stored(files["delta"], "<f4", (n * (d + poses),))[0]
    ):
        raise Refused("the proof holds numbers that are not finite")
    if sorted(order) != list(range(n)):
        raise Refused("order is no permutation")
    if not (0 <= claim["pin"] < n and abs(claim["exponent"]) <= 300):
        raise Refused("pin or exponent out of range")
    if any(any(multipliers[k]) for k in graph.points):
        raise Refused("a multiplier of a point, which has no rotation")
    return Proof(q, t, multipliers, order, claim["pin"], claim["exponent"])


# --- Rotations and the upper bound ----------------------------------------------------------------


def norm(q: Sequence[int]) -> int:
    """The sum of squares."""
    return sum(x * x for x in q)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion of R(a) R(b)."""
    (x, y, z, w), (p, q, r, s) = a, b
    return (
        w * p + x * s + y * r - z * q,
        w * q - x * r + y * s + z * p,
        w * r + x * q - y * p + z * s,
        w * s - x * p - y * q - z * r,
    )


def matrix(q: Quaternion, d: int) -> list[list[int]]:
    """|q|^2 times the rotation of a quaternion."""
    x, y, z, w = q
    v, cross = (x, y, z), ((0, -z, y), (z, 0, -x), (-y, x, 0))
    same = w * w - x * x - y * y - z * z
    return [
        [2 * (v[a] * v[b] + w * cross[a][b]) + same * (a == b) for b in range(d)] for a in range(d)
    ]


def upper_bound(graph: Graph, proof: Proof, d: int) -> Fraction:
    """F(x), each term rounded up to a multiple of 2^-FINE."""
    norms, N = [norm(q) for q in proof.q], [matrix(q, d) for q in proof.q]
    together = [x for t in (*proof.t, *(edge.t for edge in graph.edges)) for x in t]
    _, unit = trimmed(together)
    total = 0
    for i, j, q, step, kappa, tau, *_ in graph.edges:
        if kappa:
            below = norms[i] * norms[j] * norm(q)
            moved = product(proof.q[i], q)
            cosine = sum(x * y for x, y in zip(proof.q[j], moved))
            total -= shifted(-8 * kappa * (below - cosine * cosine), FINE - ULP) // below
        if proof.t:
            apart = [(b - a) >> (ULP - unit) for a, b in zip(proof.t[i], proof.t[j])]
            arm = [x >> (ULP - unit) for x in step]
            off = [
                norms[i] * x - sum(a * b for a, b in zip(row, arm)) for x, row in zip(apart, N[i])
            ]
            total -= shifted(-tau * norm(off), FINE - ULP - 2 * unit) // norms[i] ** 2
    return Fraction(total, 1 << FINE)


# --- The certificate matrix -----------------------------------------------------------------------

Block = tuple[int, int, list[list[int]], int]  # N/D from a row and a column


class Matrix(NamedTuple):
    """Rows r <= s of entries, integers times 2^-unit, and blocks to add, -kappa R_ij."""

    entries: Counter[tuple[int, int]]
    unit: int
    blocks: list[Block]


def certificate_matrix(
    graph: Graph, proof: Proof, d: int, at: dict[int, int], turn: dict[int, int]
) -> Matrix:
    """A = M - Lam, where node k has rows at[k], its position, and turn[k] ..., its rotation."""
    kappas, tau_unit = trimmed([w for edge in graph.edges for w in (edge.kappa, edge.tau)])
    steps, step_unit = trimmed([1 << ULP, *(x for edge in graph.edges for x in edge.t)])
    Lams, Lam_unit = trimmed([x for row in proof.multipliers for x in row])
    unit = max(tau_unit + 2 * step_unit, Lam_unit)
    weights_by, Lams_by, one = unit - tau_unit, unit - Lam_unit, steps[0]
    A: Counter[tuple[int, int]] = Counter()
    blocks = []
    for k, (i, j, q, *_) in enumerate(graph.edges):
        kappa, tau, step = *kappas[2 * k : 2 * k + 2], steps[1 + d * k : 1 + d * (k + 1)]
        if kappa:
            N = [[-(kappa * x << weights_by) for x in row] for row in matrix(q, d)]
            blocks.append((turn[i], turn[j], N, norm(q)))
            for a in range(d):
                A[turn[i] + a, turn[i] + a] += kappa << weights_by
                A[turn[j] + a, turn[j] + a] += kappa << weights_by
        if proof.t:
            terms = [(at[j], one), (at[i], -one)]
            terms += [(turn[i] + a, -x) for a, x in enumerate(step) if x]
            tau <<= unit - tau_unit - 2 * step_unit
            terms = [term for term in terms if term[0] >= 0]
            for r, x in terms:
                for s, y in terms:
                    if r <= s:
                        A[r, s] += tau * x * y
    for k, row in turn.items():
        upper = iter(Lams[k * d * (d + 1) // 2 :])
        for a in range(d):
            for b in range(a, d):
                A[row + a, row + b] -= next(upper) << Lams_by
    return Matrix(A, unit, blocks)


def scales(A: Matrix, n: int) -> list[int]:
    """Exponents of two by which rows and columns are multiplied: diagonals in [1/4, 1)."""
    if any(A.entries[r, r] <= 0 for r in range(n)):
        raise Refused("the certificate matrix is not positive definite: a diagonal entry")
    return [(A.unit - A.entries[r, r].bit_length()) >> 1 for r in range(n)]


def scaled(A: Matrix, scale: list[int], bits: int) -> tuple[list[dict[int, int]], int]:
    """Rows of integers times 2^-bits, from the diagonal, and what entries are below the truth."""
    rows: list[Counter[int]] = [Counter() for _ in scale]
    for (r, s), x in A.entries.items():
        rows[r][s] += shifted(x, scale[r] + scale[s] + bits - A.unit)
    terms = Counter((r, s) for r, s, _, _ in A.blocks)
    terms += Counter((s, r) for r, s, _, _ in A.blocks)
    for r, s, N, D in A.blocks:
        for a, entries in enumerate(N, r):
            for b, x in enumerate(entries, s):
                by = scale[a] + scale[b] + bits - A.unit
                rows[min(a, b)][max(a, b)] += (x << max(by, 0)) // (D << max(-by, 0))
    return [dict(row) for row in rows], 1 + max(terms.values(), default=0)


# --- Positive semidefiniteness --------------------------------------------------------------------


class Front(NamedTuple):
    """Nodes that are eliminated together, the later ones that they reach, and where those go."""

    pivots: list[int]
    boundary: list[int]
    parent: int


def fronts(pairs: set[tuple[int, int]], order: list[int], spare: int = 4) -> list[Front]:
    """A symbolic elimination; a wrong one could only fail."""
    place = {node: k for k, node in enumerate(order)}
    later: list[set[int]] = [set() for _ in order]
    for i, j in pairs:
        later[min(place[i], place[j])].add(max(place[i], place[j]))
    waiting: list[list[int]] = [[] for _ in order]  # fronts, at the first place of their boundary
    pivots: list[list[int]] = []
    reached: list[set[int]] = []
    parent: dict[int, int] = {}
    for k, reach in enumerate(later):
        reach = reach.union(*(reached[f] for f in waiting[k])) - {k}
        front = max(waiting[k], key=lambda f: len(reached[f]), default=-1)
        if front < 0 or len(reach) + 1 - len(reached[front]) > spare:
            front = len(pivots)
            pivots.append([])
            reached.append(set())
        pivots[front].append(k)
        reached[front] = reach
        parent |= {f: front for f in waiting[k] if f != front}
        if reach:
            waiting[min(reach)].append(front)
    found = sorted(range(len(pivots)), key=lambda f: pivots[f][-1])
    new = {f: k for k, f in enumerate(found)}
    return [
        Front(
            [order[k] for k in pivots[f]],
            [order[k] for k in sorted(reached[f])],
            new.get(parent.get(f, -1), -1),
        )
        for f in found
    ]


class Packing:
    """Integers below 2^(width - 1) in size as one: the sum of x_k 2^(width k), signs included."""

    def __init__(self, width: int) -> None:
        self.width, self.biases = width, [0]

    def bias(self, n: int) -> int:
        """What makes n of them positive: 2^(width - 1) each."""
        while len(self.biases) <= n:
            last = len(self.biases) - 1
            self.biases.append(self.biases[last] | 1 << (self.width * (last + 1) - 1))
        return self.biases[n]

    def unpacked(self, packed: int, n: int) -> list[int]:
        """The n integers."""
        size, half = self.width // 8, 1 << (self.width - 1)
        data = (packed + self.bias(n)).to_bytes(n * size, "little")
        return [
            int.from_bytes(data[k : k + size], "little") - half for k in range(0, n * size, size)
        ]

    def spread(self, packed: int, places: list[int]) -> int:
        """The integers at other places, ascending and counted from the first."""
        n, width, total, start = len(places), self.width, 0, 0
        biased = packed + self.bias(n)
        while start < n:
            stop = start + 1
            while stop < n and places[stop] == places[stop - 1] + 1:
                stop += 1
            run = (biased >> width * start) & ((1 << width * (stop - start)) - 1)
            total += (run - self.bias(stop - start)) << width * (places[start] - places[0])
            start = stop
        return total


def is_positive_semidefinite(
    rows: list[dict[int, int]],
    error: int,
    tree: list[tuple[range, list[int], int]],
    v: list[int],
    precision: int,
) -> bool:
    """Whether A = sum l l^T + E, with E diagonally dominant under the weights v.

    Entries of A are at least ``rows`` and less than ``error`` above, in units of 2^-(2 precision).
    Each front of ``tree`` has pivots, its other rows and a parent.
    """
    one, packing = 1 << 2 * precision, Packing(2 * precision + 8)
    width, n = packing.width, len(rows)
    norms, own, others, done = [0] * n, [0] * n, [0] * n, 0
    for r, row in enumerate(rows):
        for s, x in row.items():
            if abs(x) > one:
                return False
            others[r] += error * v[s]
            others[s] += error * v[r] * (r != s)
    reach = [0] * n
    for pivots, boundary, _ in tree:
        inside, outside = sum(v[r] for r in pivots), sum(v[r] for r in boundary)
        for r in pivots:
            reach[r] += inside + outside
        for r in boundary:
            reach[r] += inside
    left: dict[int, list[tuple[list[int], list[int]]]] = {}
    for front, (pivots, boundary, parent) in enumerate(tree):
        place = {r: k for k, r in enumerate([*pivots, *boundary])}
        here, packed = list(place), [0] * len(place)
        if pivots.start != done:
            return False
        done = pivots.stop
        for r in pivots:
            for s, x in rows[r].items():
                packed[place[r]] += x << width * (place[s] - place[r])
        for below, passed_on in left.pop(front, []):
            places = [place[r] for r in below]
            for k, x in enumerate(passed_on):
                packed[places[k]] += packing.spread(x, places[k:])
        for k, r in enumerate(pivots):
            S, *column = packing.unpacked(packed[k], len(here) - k)
            pivot = S - (reach[r] << precision) // v[r] - 1
            if pivot <= 0:
                return False
            top = isqrt(pivot)
            half = top >> 1
            own[r], total, tail = S - top * top, 0, 0
            for a in range(len(here) - 1, k, -1):
                s, x = here[a], column[a - k - 1]
                y = (x + half) // top
                tail = (tail << width) + y
                packed[a] -= y * tail
                norms[s] += y * y
                rest = abs(x - y * top)
                total += rest * v[s]
                others[s] += rest * v[r]
                if norms[s] > one:
                    return False
            others[r] += total
        if boundary:
            left.setdefault(parent, []).append((here[len(pivots) :], packed[len(pivots) :]))
    return not left and done == n and all(a * w >= b for a, w, b in zip(own, v, others))


# --- Checking -------------------------------------------------------------------------------------


class Answer(NamedTuple):
    """F(x) <= upper and F* >= lower, where ``about`` describes F."""

    upper: Fraction
    lower: Fraction
    about: str

    @property
    def relative_gap(self) -> Fraction:
        """(F(x) - F*)/F(x) at most."""
        return max(Fraction(0), 1 - self.lower / self.upper) if self.upper else Fraction(0)

    def __str__(self) -> str:
        upper, lower = digits(self.upper, 15, 1), digits(self.lower, 15, 0)
        gap = digits(self.relative_gap, 2, 1)
        return f"PROVED: F(x) <= {upper:g}, F* >= {lower:g}, relative gap <= {gap:.1e}"


def digits(x: Fraction, count: int, up: int) -> Decimal:
    """Some digits of a number x >= 0, rounded up or down; for printing."""
    exponent = len(str(x.numerator)) - len(str(x.denominator)) - count - 1
    while True:
        unit = Fraction(10) ** exponent
        m = -(-x // unit) if up else x // unit
        if m < 10**count:
            return Decimal(m).scaleb(exponent)
        exponent += 1


def prove(graph: Graph, proof: Proof, claim: dict[str, Any]) -> tuple[Fraction, Fraction]:
    """Both bounds."""
    d, poses = claim["d"], claim["kind"] == "poses"
    found = fronts({(edge.i, edge.j) for edge in graph.edges}, proof.order)
    at: dict[int, int] = {proof.pin: -1}
    turn: dict[int, int] = {}
    ends, n = [0], 0
    for front in found:
        for node in front.pivots:
            if poses and node != proof.pin:
                at[node], n = n, n + 1
            if node not in graph.points:
                turn[node], n = n, n + d
        ends.append(n)
    tree = []
    for front, start, stop in zip(found, ends, ends[1:]):
        rows = [at[node] for node in front.boundary if at.get(node, -1) >= 0]
        rows += [turn[node] + a for node in front.boundary for a in range(d) if node in turn]
        tree.append((range(start, stop), sorted(rows), front.parent))
    A = certificate_matrix(graph, proof, d, at, turn)
    scale = scales(A, n)
    heavy = set(at.values())
    exponents = [proof.exponent * (r in heavy) - scale[r] for r in range(n)]
    v = [1 << (x - min(exponents)) for x in exponents]
    for precision in PRECISIONS:
        if is_positive_semidefinite(*scaled(A, scale, 2 * precision), tree, v, precision):
            break
    else:
        raise Refused("the certificate matrix was not proven positive semidefinite")
    diagonal = [k for k in range(d * (d + 1) // 2) if k in ((0, 2), (0, 3, 5))[d - 2]]
    trace = sum(row[k] for row in proof.multipliers for k in diagonal)
    return upper_bound(graph, proof, d), max(Fraction(trace, 1 << ULP), Fraction(0))


def check(graph_path: str | Path, proof_path: str | Path) -> Answer:
    """Check a proof about a graph file; raises `Refused` or `Unreadable`."""
    path = Path(graph_path)
    path = path / "EGs.txt" if path.is_dir() else path
    try:
        text = path.read_bytes()
    except OSError as error:
        raise Unreadable(f"{path}: {error.strerror}") from None
    try:
        with zipfile.ZipFile(proof_path) as archive:
            if any(member.compress_type for member in archive.infolist()):
                raise Unreadable(f"{proof_path}: its arrays must not be compressed")
            files = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
        claim = read_claim(files["claim"])
        if hashlib.sha256(text).hexdigest() != claim["graph_sha256"]:
            raise Refused(f"{path} is not the file that was proven about: its SHA-256 differs")
        graph = read_graph(text, claim, component(path, claim["component_sha256"]))
        proof = read_proof(files, claim, graph)
    except (Refused, Unreadable):
        raise
    except OSError as error:
        raise Unreadable(f"{proof_path}: {error.strerror or 'not a readable proof'}") from None
    except Exception as error:  # damaged archives can raise anything
        raise Unreadable(f"{proof_path}: not a readable proof ({type(error).__name__})") from None
    return Answer(*prove(graph, proof, claim), about(graph, claim))


def component(path: Path, sha256: str | None) -> set[int] | None:
    """The nodes of a cc.txt next to the graph, if the proof is about those alone."""
    if sha256 is None:
        return None
    try:
        text = path.with_name("cc.txt").read_bytes()
    except OSError as error:
        raise Unreadable(f"cc.txt beside {path}: {error.strerror}") from None
    if hashlib.sha256(text).hexdigest() != sha256:
        raise Refused("cc.txt is not the file that was proven about: its SHA-256 differs")
    if not re.fullmatch(rb"[0-9\s]*", text):
        raise Unreadable("cc.txt: ids expected")
    return set(map(int, text.split()))


def about(graph: Graph, claim: dict[str, Any]) -> str:
    """The measurements and how they were read: what F is."""
    said = [f"the {claim['kind']} of {graph.n} nodes from {len(graph.edges)} measurements"]
    for name in ("kappa", "tau")[: 1 + (claim["kind"] == "poses")]:
        ones = any(getattr(edge, name) == 1 << ULP for edge in graph.edges)
        none = " (1 without information)" * ones
        said.append(f"{name} {claim[name] or f'of the file{none}'}")
    said.append(f"rotational information read as {claim['rotation_information']}")
    priors = sum(edge.role == "prior" for edge in graph.edges)
    said += [f"with {len(graph.points)} landmarks"] * claim["landmarks"]
    said += [f"with {priors} priors"] * claim["priors"]
    said += ["numbers read as information"] * any_map(claim)
    added = claim["keep"] == "all"
    said.append("parallel edges added" if added else f"only the {claim['keep']} of parallel edges")
    said += ["nodes of cc.txt alone"] * (claim["component_sha256"] is not None)
    return ", ".join(said)


def main(arguments: list[str]) -> int:
    """Print what is proven; exit codes: 0 proved, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) != 2:
        sys.stderr.write("usage: integer_checker.py GRAPH PROOF\n")
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

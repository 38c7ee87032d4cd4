"""Verifies proofs that an estimate of a pose graph is nearly optimal, in integers alone.

    python integer_checker.py GRAPH PROOF

needs only this file and Python, and no floating-point number. It reads the same files as checker.py
and prints the same lines about the chordal cost, but shares no code with it. docs/checker.md says
what is proven (section 1), what a proof holds (section 10) and why this is right (section 11).
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import re
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import cache, reduce
from itertools import chain
from math import isqrt
from operator import lt, mul
from pathlib import Path
from typing import Any, NamedTuple

ULP = 1074  # every double is an integer times 2^-ULP, and stored as that integer
ONE, FAR = 1 << ULP, 1 << 400
FINE = 1400  # fractional bits of costs
PRECISIONS = (88, 184)  # fractional bits of factors, tried in turn
SERIES = 320  # fractional bits of exponentials of similarities


class Refused(Exception):  # noqa: N818
    """The proof is not valid, with the reason."""


class Unreadable(Exception):  # noqa: N818
    """The graph or proof file cannot be read, with the reason."""


# --- Doubles --------------------------------------------------------------------------------------


def nearest(n: int, d: int) -> int:
    """The double nearest to n/d, d > 0; of two, the one with an even last bit."""
    size = abs(n)
    exponent = size.bit_length() - d.bit_length()
    exponent -= size << max(-exponent, 0) < d << max(exponent, 0)
    last = max(exponent - 52, -ULP)
    bottom = d << max(last, 0)
    kept, left = divmod(size << max(-last, 0), bottom)
    kept += 2 * left + (kept & 1) > bottom
    if kept.bit_length() + last > 1024:
        raise ValueError("a number that is not finite")
    return (kept if n >= 0 else -kept) << (last + ULP)


_DECIMAL = re.compile(r"([+-]?)([0-9]*)(?:\.([0-9]*))?(?:[eE]([+-]?[0-9]+))?")


def decimal(word: str) -> tuple[int, int]:
    """Integers m and e with the number m 10^e that a word states."""
    match = _DECIMAL.fullmatch(word)
    if match is None or not (match[2] or match[3]):
        raise ValueError(f"a decimal number expected, not {word[:40]}")
    after = match[3] or ""
    return int(match[1] + match[2] + after), int(match[4] or 0) - len(after)


def double(word: str) -> int:
    """The double nearest to a decimal number; beyond 10^4800 and 10^-4800 m does not matter."""
    m, e = decimal(word)
    return nearest(m * 10 ** min(max(e, 0), 4800), 10 ** min(max(-e, 0), 4800))


def trimmed(numbers: Sequence[int]) -> tuple[list[int], int]:
    """Doubles as smaller integers, times 2^-unit."""
    together = 0
    for x in numbers:
        together |= x
    zeros = (together & -together).bit_length() - 1 if together else ULP
    return [x >> zeros for x in numbers], ULP - zeros


def shifted(x: int, by: int) -> int:
    """The integer x 2^by, rounded down."""
    return x << by if by >= 0 else x >> -by


# --- Rotations ------------------------------------------------------------------------------------

Quaternion = tuple[int, ...]  # x y z w of any norm; in the plane 0 0 sin cos of half the angle


def quaternion(numbers: Sequence[int]) -> Quaternion:
    """The same rotation by small integers; two numbers are a cosine and a sine."""
    if not any(numbers):
        raise Refused("a rotation is zero")
    return tuple(trimmed(numbers if len(numbers) == 4 else [0, 0, *numbers[::-1]])[0])


def norm(q: Sequence[int]) -> int:
    """The sum of squares."""
    return sum(x * x for x in q)


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion of R(a) R(b)."""
    (x, y, z, w), (p, q, r, s) = a, b
    i, j, k = (
        w * p + x * s + y * r - z * q,
        w * q - x * r + y * s + z * p,
        w * r + x * q - y * p + z * s,
    )
    return i, j, k, w * s - x * p - y * q - z * r


def matrix(q: Quaternion, d: int) -> list[list[int]]:
    """|q|^2 times the rotation: that of v -> q v q*."""
    x, y, z, w = q
    same, cross = w * w - x * x - y * y - z * z, ((0, -z, y), (z, 0, -x), (-y, x, 0))
    return [
        [2 * (q[a] * q[b] + w * cross[a][b]) + same * (a == b) for b in range(d)] for a in range(d)
    ]


def half_angle(theta: int) -> tuple[int, int]:
    """The doubles nearest to the cosine and the sine of theta/2."""
    if abs(theta) > 10**6 * ONE:
        raise ValueError("an angle beyond 1e6 radians")
    if theta == 0:
        return ONE, 0
    bits = 320 + max(0, ULP - theta.bit_length())
    cosine, sine = circle(shifted(abs(theta), bits - ULP - 1), bits)
    sine = sine if theta > 0 else -sine
    ends = -(1 << 32), 1 << 32
    found = {
        (nearest(cosine + e, 1 << bits), nearest(sine + f, 1 << bits)) for e in ends for f in ends
    }
    if len(found) > 1:
        raise ValueError("an angle too close to call")
    return found.pop()


def circle(x: int, bits: int) -> tuple[int, int]:
    """Cosine and sine of x, 0 <= x < 2^19, in units of 2^-bits: within 2^32, if x is within 1."""
    quarters = 0
    if x >> (bits - 1):
        quarter = quarter_turn(bits + 40)
        quarters = ((x << 41) + quarter) // (2 * quarter)
        x -= quarters * quarter >> 40
    sums, term, k = [0, 0], 1 << bits, 0
    while abs(term) > 1:
        sums[k % 2] += -term if k & 2 else term
        k += 1
        term = (term * x >> bits) // k
    c, s = sums
    return [(c, s), (-s, c), (-c, -s), (s, -c)][quarters % 4]


@cache
def quarter_turn(bits: int) -> int:
    """Half of pi in units of 2^-bits, within 2^13: 8 arctan(1/5) - 2 arctan(1/239)."""
    total = 0
    for factor, n in ((8, 5), (-2, 239)):
        power, k = (1 << bits) // n, 1
        while power:
            total += factor * (power // k) * (2 - k % 4)
            power, k = power // (n * n), k + 2
    return total


def similarity(logarithm: Sequence[int]) -> tuple[list[int], list[int], int]:
    """The quaternion, translation and scale of [omega, upsilon, sigma], each number rounded once.

    With A = sigma I + omega x, and h = omega / 2: exp(h), the sum of A^k upsilon / (k + 1)!, and
    exp(sigma), by their series in units of 2^-SERIES.
    """
    *v, sigma = (x >> (ULP - SERIES) for x in logarithm)
    if max(map(abs, v[:3])) > 10 << SERIES or abs(sigma) > 69 << SERIES:
        raise ValueError("turns within 10 radians and logarithms of scales within 69 expected")
    (x, y, z), upsilon, one = v[:3], v[3:], 1 << SERIES
    half = (x >> 1, y >> 1, z >> 1, 0)

    def grown(a: list[int]) -> list[int]:
        p, q, r = a
        return [sigma * p + y * r - z * q, sigma * q + z * p - x * r, sigma * r + x * q - y * p]

    return (
        series([0, 0, 0, one], lambda a: product(half, tuple(a)), 1),
        series(upsilon, grown, 2),
        series([one], lambda a: [sigma * a[0]], 1)[0],
    )


def series(term: list[int], step: Callable[[list[int]], Sequence[int]], k: int) -> list[int]:
    """The doubles nearest to the sum of a term and those that follow, each its step over k."""
    total = term
    while not {0, -1}.issuperset(term):
        term, k = [x // (k << SERIES) for x in step(term)], k + 1
        total = [x + y for x, y in zip(total, term, strict=True)]
    return [nearest(x, 1 << SERIES) for x in total]


def shepperd(M: Sequence[int]) -> list[int]:
    """A quaternion of a matrix, row by row, each addition rounded to the nearest double."""

    def add(total: int, *terms: int) -> int:
        for term in terms:
            total = nearest(total + term, ONE)
        return total

    a, b, c = M[::4]
    trace = add(a, b, c)
    x, y, z = add(M[7], -M[5]), add(M[2], -M[6]), add(M[3], -M[1])
    xy, xz, yz = add(M[3], M[1]), add(M[2], M[6]), add(M[7], M[5])
    if trace >= max(a, b, c):
        return [x, y, z, add(ONE, trace)]
    if a >= max(b, c):
        return [add(ONE, add(a, -b, -c)), xy, xz, x]
    if b >= c:
        return [xy, add(ONE, add(b, -a, -c)), yz, y]
    return [xz, yz, add(ONE, add(c, -a, -b)), z]


# --- The graph ------------------------------------------------------------------------------------


class Edge(NamedTuple):
    """A measurement of node j in the frame of node i; kappa = 0 if of its position alone."""

    i: int  # of a prior the world, at first not numbered
    j: int
    q: Quaternion
    t: tuple[int, ...]
    kappa: int
    tau: int
    role: str
    scale: int = ONE  # of similarities


class Graph(NamedTuple):
    """Edges between nodes 0 ... n-1, by ascending ids, and which of these are points."""

    n: int
    edges: list[Edge]
    points: set[int]
    free: set[int] | None = None  # poses of unknown scale; None if it is no graph of similarities
    ids: tuple[int | None, ...] = ()  # of the file, which has none of the world

    @property
    def in_mean_unit(self) -> bool:
        """Whether no scale is known, and the cost is F over the mean of their squares."""
        return self.free is not None and len(self.free) + len(self.points) == self.n


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
MARK = b"\xef\xbb\xbf"  # may begin a file


def read_edges(text: bytes, claim: dict[str, Any]) -> Iterator[Edge]:
    """The measurements of a g2o or 1DSfM file that a proof's header asks for."""
    formats, sensors, used = set(), {0: True}, set()
    asked = {"pose": True, "prior": claim["priors"]}
    similar = claim.get("kind") == "similarities"
    lines = text.removeprefix(MARK).replace(b"\r\n", b"\n").split(b"\n")
    for number, line in enumerate(lines, 1):
        try:
            if not _PLAIN.issuperset(line) or not (said := line.split(b"#")[0]).isascii():
                raise ValueError("plain text expected, and lines that end in LF or CRLF")
            tag, *words = said.decode().split() or [""]
            role, d, _ = TAGS.get(tag, ("", 3, False))
            if similar:
                if tag in ("", "VERTEX_SIM3:EXPMAP", "FIX"):
                    continue
                role, d, edge = "pose", 3, similarity_edge(tag, words, claim)
            elif role and asked.get(role, claim["landmarks"]):
                sensor, edge = g2o_edge(tag, words, claim)
                used.add(sensor)
            elif tag == "PARAMS_SE3OFFSET" and claim["maps"] and claim["d"] == 3:
                (sensor,), pose = split(words, 1, 7)
                *zeros, w = map(double, pose)
                here = not any(zeros) and 0 < abs(w) < FAR * ONE
                sensors[sensor] = sensors.get(sensor, True) and here
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
    if unknown := [sensor for sensor in used if not sensors.get(sensor, False)]:
        raise Unreadable(f"sensor {min(unknown)} is not known to be at its body's origin")
    if len(formats) > 1 or {d for d, _ in formats} != {claim["d"]}:
        raise Unreadable(f"no graph of {claim['d']}D measurements")


def split(words: list[str], ids: int, *sizes: int) -> tuple[list[int], list[str]]:
    """Ids, and as many other words as one of the sizes."""
    if len(words) - ids not in sizes:
        raise ValueError(f"{' or '.join(str(ids + size) for size in sizes)} numbers expected")
    if not all(re.fullmatch(r"[+-]?[0-9]+", word) for word in words[:ids]):
        raise ValueError("ids are integers")
    return [int(word) for word in words[:ids]], words[ids:]


def g2o_edge(tag: str, words: list[str], claim: dict[str, Any]) -> tuple[int, Edge]:
    """The sensor, 0 for none, and a line of ids, a position, a rotation and information."""
    role, d, turned = TAGS[tag]
    has_sensor, p = d == 3 and role != "pose", 3 * d - 3 if turned else d
    size = (4 * d - 5) if turned else d
    ids, rest = split(words, 2 - (role == "prior") + has_sensor, size, size + p * (p + 1) // 2)
    sensor = ids.pop() if has_sensor else 0
    numbers, information = [double(word) for word in rest[:size]], tuple(rest[size:])
    turn = [0, 0, 0, ONE] if not turned else half_angle(numbers[2]) if d == 2 else numbers[3:]
    kappa, tau = ONE, ONE
    for word in information:
        decimal(word)
    if information and None in (claim["kappa"], claim["tau"]):
        kappa, tau = weights(information, turned)
        if claim["rotation_information"] == "quaternion":
            kappa >>= 2  # half the angle, a quarter of the information
    edge = Edge(
        ids[0], ids[-1], quaternion(turn), tuple(numbers[:d]), max(kappa, 1) * turned, tau, role
    )
    return sensor, edge


def similarity_edge(tag: str, words: list[str], claim: dict[str, Any]) -> Edge:
    """A line of two ids, the logarithm of a similarity and information."""
    if tag != "EDGE_SIM3:EXPMAP":
        raise ValueError("EDGE_SIM3:EXPMAP expected, in a graph of similarities")
    (i, j), rest = split(words, 2, 7, 35)
    q, t, scale = similarity([double(word) for word in rest[:7]])
    kappa, tau = ONE, ONE
    for word in rest[7:]:
        decimal(word)
    if len(rest) > 7 and None in (claim["kappa"], claim["tau"]):
        kappa, tau = weights(tuple(rest[7:]), True)
    return Edge(i, j, quaternion(q), tuple(t), kappa, tau, "pose", scale)


def unit_node(text: bytes, ids: set[int]) -> int:
    """The node of scale 1: of those that a file fixes, or else of all, the smallest id."""
    lines = [line.split(b"#")[0].split() for line in text.removeprefix(MARK).split(b"\n")]
    fixed = [word for words in lines if words[:1] == [b"FIX"] for word in words[1:]]
    if not all(re.fullmatch(rb"[+-]?[0-9]+", word) for word in fixed):
        raise Unreadable("FIX: ids expected")
    return min(ids & {int(word) for word in fixed}, default=min(ids))


@cache
def weights(words: tuple[str, ...], turned: bool) -> tuple[int, int]:
    """The doubles kappa and tau that an upper triangle in decimals says, row by row."""
    if not turned:
        return 0, harmonic_mean(words)
    if len(words) == 28:  # of similarities: rotation, translation, scale
        kappa = harmonic_mean([words[k] for k in (0, 1, 2, 7, 8, 13)], 2)
        return kappa, harmonic_mean([words[k] for k in (18, 19, 20, 22, 23, 25)])
    if len(words) == 6:
        return harmonic_mean(words[5:]), harmonic_mean([words[k] for k in (0, 1, 3)])
    return harmonic_mean(words[15:], 2), harmonic_mean([words[k] for k in (0, 1, 2, 6, 7, 11)])


def harmonic_mean(words: Sequence[str], over: int = 1) -> int:
    """The double nearest to size / tr(A^-1) / over, A of this upper triangle."""
    pairs = [decimal(word) for word in words]
    powers = [e for _, e in pairs]
    if not -400 <= min(powers) <= max(powers) <= 400:
        raise ValueError("an information number out of range")
    upper = [m * 10 ** (e - min(powers)) for m, e in pairs]
    d = {1: 1, 3: 2, 6: 3}[len(upper)]
    if d < 3:  # more rows and columns of the identity
        upper = [upper[0], 0, 0, 1, 0, 1] if d == 1 else [*upper[:2], 0, upper[2], 0, 1]
    a, b, c, p, q, r = upper
    first, second = a * p - b * b, p * r - q * q
    whole = a * second - b * (b * r - c * q) + c * (b * q - c * p)
    if min(a, first, whole) <= 0:
        raise ValueError("information that is not positive definite")
    trace = first + second + a * r - c * c - (3 - d) * whole
    n, m = d * whole, trace * over
    return nearest(n * 10 ** max(min(powers), 0), m * 10 ** max(-min(powers), 0))


def matrix_edge(words: list[str]) -> Edge:
    """Ids, a rotation matrix row by row, and a direction, which is not used."""
    (i, j), rest = split(words, 2, 12)
    q = of_matrix([double(word) for word in rest][:9])
    return Edge(i, j, q, (0, 0, 0), ONE, ONE, "pose")


def of_matrix(M: Sequence[int]) -> Quaternion:
    """The quaternion of a matrix near a rotation, row by row."""
    a, b, c = M[::3], M[1::3], M[2::3]
    off = max(abs(sum(map(mul, x, y)) - ONE * ONE * (x is y)) for x in (a, b, c) for y in (a, b, c))
    normal = [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]
    turned = 1000 * sum(map(mul, normal, c)) > ONE**3
    if max(map(abs, M)) >= 2 * ONE or 1000 * off > ONE * ONE or not turned:
        raise ValueError("a rotation matrix expected")
    return quaternion(shepperd(M))


def read_graph(text: bytes, claim: dict[str, Any], kept: set[int] | None) -> Graph:
    """The measurements that F is made of."""
    similar = claim.get("kind") == "similarities"
    if similar and text.startswith(b"PK"):
        return read_archive(text, claim)
    edges, points = with_own_ids(list(read_edges(text, claim)))
    if kept is not None:
        edges = [edge for edge in edges if kept.issuperset(edge[:2])]
    if claim["keep"] != "all":
        places = range(len(edges))[:: -1 if claim["keep"] == "first" else 1]
        chosen = {frozenset(edges[k][:2]): k for k in places}
        edges = [edges[k] for k in sorted(chosen.values())]
    if not edges:
        raise Unreadable("no measurements")
    number = {k: node for node, k in enumerate(sorted({k for edge in edges for k in edge[:2]}))}
    given = {k: None if claim[k] is None else double(str(claim[k])) for k in ("kappa", "tau")}
    if 0 in given.values():
        raise Unreadable("kappa and tau must be positive")
    origin = [double(str(o)) for o in claim["origin"] or ()]
    for k, edge in enumerate(edges):
        kappa = edge.kappa and (edge.kappa if given["kappa"] is None else given["kappa"])
        tau, t = edge.tau if given["tau"] is None else given["tau"], edge.t
        if not all(ONE < weight * FAR < ONE * FAR * FAR for weight in (kappa or ONE, tau)):
            raise Unreadable("kappa and tau must be positive, and neither tiny nor huge")
        if edge.role == "prior" and origin:
            t = tuple(x - o for x, o in zip(t, origin, strict=True))
            if any(nearest(x, ONE) != x for x in t):
                raise Refused("a position from the origin of the proof is not a double")
        edges[k] = edge._replace(i=number[edge.i], j=number[edge.j], t=t, kappa=kappa, tau=tau)
    free = {*number.values()} - {number[unit_node(text, {*number})]} if similar else None
    world = {edge.i for edge in edges if edge.role == "prior"}
    ids = (None if node in world else k for k, node in number.items())
    return Graph(len(number), edges, {number[k] for k in points}, free, tuple(ids))


#: The arrays of an archive that the cost is made of, and others that may be there.
_STATED = {
    *("kind", "version", "num_nodes", "edges", "rotations", "translations", "scales", "kappa"),
    *("tau", "free", "points"),
}
_UNUSED = {
    *("ids", "name", "names", "fixed", "options", "notices", "world", "origin", "assumed"),
    *("absolute", "apart", "moved_by", "times_ns", "stated", "numbers", "outliers", "camera"),
    *("information", "information_index", "information_residual"),
    *(f"{of}_{x}" for of in ("initial", "truth") for x in ("rotations", "translations", "scales")),
}


def read_archive(data: bytes, claim: dict[str, Any]) -> Graph:
    """The similarities in an archive of arrays."""
    given = [claim[name] for name in ("keep", "kappa", "tau", "rotation_information")]
    if given != ["all", None, None, "tangent"]:
        raise Unreadable("an archive of similarities is read as it is, without options")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [name.removesuffix(".npy") for name in archive.namelist()]
            files = dict(zip(names, map(archive.read, archive.namelist()), strict=True))
        if len(files) < len(names) or not _STATED - {"points"} <= {*names} <= _STATED | _UNUSED:
            raise Refused("other arrays expected, in a graph of similarities")
        return _of_arrays(files, claim["d"])
    except Exception as error:  # damaged archives can raise anything
        raise Unreadable(f"not a readable graph of similarities: {error}") from None


def _of_arrays(files: dict[str, bytes], d: int) -> Graph:
    kind, version, n = npy(files["kind"])[3], *map(_integer, ("version", "num_nodes"), [files] * 2)
    if (kind.decode("utf-32-le"), version) != ("graph", 1):
        raise Refused("a graph of version 1 expected")
    m = npy(files["kappa"])[1][0]

    def doubles(name: str, *shape: int) -> list[list[int]]:
        return [[from_bits(x) for x in row] for row in stored(files[name], "<f8", m, *shape)]

    R, t = doubles("rotations", d, d), doubles("translations", d)
    (scales,), (kappas,), (taus,) = map(doubles, ("scales", "kappa", "tau"))
    (free,) = stored(files["free"], "|b1", n)
    (seen,) = stored(files["points"], "|b1", n) if "points" in files else [[0] * n]
    points, unknown = ({k for k in range(n) if flags[k]} for flags in (seen, free))
    edges = []
    for k, (i, j) in enumerate(stored(files["edges"], "<i8", m, 2)):
        kappa, tau, scale = kappas[k], taus[k], scales[k]
        if not (max(i, j) < n and i != j and i not in points and not (kappa and j in points)):
            raise Refused("measurements between different nodes expected, and from poses")
        if not all(ONE < x * FAR < ONE * FAR * FAR for x in (kappa or ONE, tau, scale)):
            raise Refused("positive weights and scales expected, neither tiny nor huge")
        whole = [
            R[k][d * a + b] if max(a, b) < d else ONE * (a == b) for a in range(3) for b in range(3)
        ]
        edges.append(Edge(i, j, of_matrix(whole), tuple(t[k]), kappa, tau, "pose", scale))
    if not edges or points & unknown:
        raise Refused("measurements expected, and points without a scale")
    return Graph(n, edges, points, unknown)


def _integer(name: str, files: dict[str, bytes]) -> int:
    return int.from_bytes(npy(files[name])[3], "little")


def with_own_ids(edges: list[Edge]) -> tuple[list[Edge], set[int]]:
    """Edges where each pose, each point and the world has an id of its own; those of the points.

    Points that are numbered apart follow all other ids if one of them has the number of another
    node. The world, from which priors are, is last.
    """
    ends = {role: {e.j for e in edges if e.role == role} for role in ("sighting", "apart", "prior")}
    poses = {edge.i for edge in edges if edge.role != "prior"}
    poses |= {edge.j for edge in edges if edge.kappa}
    points, apart, after = ends["sighting"], ends["apart"], 0
    if poses & points:
        raise Unreadable(f"node {min(poses & points)} is a pose and a point")
    if apart & (poses | points):
        after = max(0, *poses, *points) + 1
        if min(apart) < 0:
            raise Unreadable(f"numbers of points from 0 expected, not {min(apart)}")
    points = points | {k + after for k in apart}
    world = max(ends["prior"] | poses | points, default=0) + 1
    edges = [edge._replace(i=world) if edge.role == "prior" else edge for edge in edges]
    edges.sort(key=lambda edge: (edge.role == "prior", edge.role != "pose"))  # as in proofs
    return [e._replace(j=e.j + after) if e.role == "apart" else e for e in edges], points


# --- The proof ------------------------------------------------------------------------------------


class Rejected(NamedTuple):
    """A claim min(f_e, price) >= price - kappa |Q - C|^2 - tau |v - t|^2, see `constant`."""

    edge: int
    price: int
    kappa: int
    tau: int
    C: list[list[int]]
    t: tuple[int, ...]


class Within(NamedTuple):
    """How far a node is from where x has it, in any estimate that costs at most the upper bound.

    Seen from the reference: both are compared in the frame of that pose. Numbers stand for doubles.
    """

    node: int | None  # by its id; None: every node
    metres: int | Decimal | None  # None: nothing is said
    degrees: int | Decimal | None  # points have none
    reference: int | None  # the pinned pose, by its id; None: the world

    def __str__(self) -> str:
        far = [(self.metres, "m"), (self.degrees, "degrees")]
        said = " and ".join(f"{x} {unit}" for x, unit in far if x is not None)
        node = "every node" if self.node is None else called(self.node)
        return f"within {said} of every optimum: {node}, seen from {called(self.reference)}"


def called(node: int | None) -> str:
    """A node by its id, which the world has none of."""
    return "the world" if node is None else f"node {node}"


class Proof(NamedTuple):
    """The content of a proof file; none of it is trusted."""

    q: list[Quaternion]
    t: list[list[int]]  # empty for rotations alone
    multipliers: list[list[int]]
    order: list[int]
    pin: int
    exponent: int
    rejected: list[Rejected]  # empty but for a truncated cost
    s: list[int]  # ONE but for similarities


def read_claim(data: bytes) -> dict[str, Any]:
    """The header of a proof; decimals stay decimals."""
    text = bytes(stored(data, "|u1")[0]).decode()
    given = json.loads(text, parse_float=Decimal, parse_constant=Decimal)
    absent = {"cost": None, "landmarks": False, "priors": False, "origin": None}
    claim: dict[str, Any] = {**absent, "within": [], **given}
    if claim["cost"] is not None:
        raise Unreadable("integers check proofs of --cost chordal; without --exact, others too")
    known: dict[str, list[Any]] = {
        "format": ["certpgo proof"],
        "version": [1, 3, 4],
        "kind": ["poses", "rotations", "similarities"],
        "d": [2, 3],
        "keep": ["all", "first", "last"],
        "rotation_information": ["tangent", "rpy", *["quaternion"] * (claim["d"] == 3)],
        "landmarks": [False, True],
        "priors": [False, True],
    }
    for name, choices in known.items():
        if not any(claim[name] == x and type(claim[name]) is type(x) for x in choices):
            raise Unreadable(f"{name} must be {' or '.join(map(str, choices))}")
    if {type(claim[name]) for name in ("kappa", "tau")} - {type(None), int, Decimal}:
        raise Unreadable("kappa and tau must be numbers")
    if not type(claim["pin"]) is type(claim["exponent"]) is int:
        raise Unreadable("pin and exponent are integers")
    maps, origin = claim["landmarks"] or claim["priors"], claim["origin"]
    if maps and (claim["kind"], claim["component_sha256"]) != ("poses", None):
        raise Unreadable("landmarks and priors are for poses, all of a file's")
    stated = claim["priors"] and isinstance(origin, list) and [*map(type, origin)]
    if origin is not None and stated != [Decimal] * claim["d"]:
        raise Unreadable("an origin is a list of d numbers, for priors")
    similar = claim["kind"] == "similarities"
    if similar != (claim["version"] == 4):
        raise Unreadable("proofs of version 4 are those about similarities")
    whole = claim["rotation_information"], claim["component_sha256"]
    if similar and whole != ("tangent", None):
        raise Unreadable(
            "a proof is about all similarities of a file, with information of tangents"
        )
    for one in claim["within"]:
        numbers = [x for x in (one["metres"], one["degrees"]) if x is not None]
        if (
            not numbers
            or {*map(type, numbers)} - {int, Decimal}
            or not all(0 < x < FAR for x in numbers)
        ):
            raise Unreadable("claims of distances are positive numbers of metres or degrees")
        if type(one["node"]) not in (int, type(None)) or (one["degrees"] or 1) > 180:
            raise Unreadable("nodes are named by ids, and angles are of 180 degrees at most")
        if similar or (claim["kind"] == "rotations" and one["metres"] is not None):
            raise Unreadable("no distances are claimed of similarities, nor metres of rotations")
    return {**claim, "maps": maps}


def npy(data: bytes) -> tuple[str, tuple[int, ...], bool, bytes]:
    """The type, the shape, whether it is by columns, and the bytes of an array in a .npy file."""
    begin = 12 if data[6] > 1 else 10
    start = begin + int.from_bytes(data[8:begin], "little")
    header = ast.literal_eval(data[begin:start].decode())
    if data[:6] != b"\x93NUMPY":
        raise Refused("an array expected")
    return header["descr"], header["shape"], header["fortran_order"], data[start:]


def stored(data: bytes, dtype: str, *shape: int) -> list[list[int]]:
    """The rows of an array in a .npy file, with numbers as unsigned integers."""
    size, (descr, found, by_columns, numbers) = int(dtype[2:]), npy(data)
    shape = shape or found
    if (descr, found) != (dtype, shape):
        raise Refused(f"{dtype} of shape {shape} expected: another graph's proof?")
    words = [int.from_bytes(numbers[k : k + size], "little") for k in range(0, len(numbers), size)]
    n, columns = (shape[0], reduce(mul, shape[1:])) if len(shape) > 1 else (1, *shape)
    if (len(numbers), len(words)) != (size * len(words), n * columns):
        raise Refused("an array is not as long as it says")
    if by_columns:
        places = (
            [a + b * shape[1] for a in range(shape[1]) for b in range(shape[2])]
            if len(shape) > 2
            else range(columns)
        )
        return [[words[k + n * place] for place in places] for k in range(n)]
    return [words[k : k + columns] for k in range(0, len(words), columns)]


def from_bits(word: int, fraction: int = 52, size: int = 64) -> int:
    """The number of the bits of a double or single: sign, exponent, fraction."""
    exponent, digits = word >> fraction & (1 << size - fraction - 1) - 1, word & (1 << fraction) - 1
    if exponent == (1 << size - fraction - 1) - 1:
        raise Refused("the proof holds numbers that are not finite")
    digits = (digits | 1 << fraction) << (exponent - 1) if exponent else digits
    return -digits if word >> size - 1 else digits


def read_proof(files: dict[str, bytes], claim: dict[str, Any], graph: Graph) -> Proof:
    """The arrays of a proof."""
    n, d, poses = graph.n, claim["d"], claim["kind"] != "rotations"

    def doubles(name: str, n: int, columns: int) -> list[list[int]]:
        return [[from_bits(word) for word in row] for row in stored(files[name], "<f8", n, columns)]

    q = [quaternion(row) for row in doubles("rotations", n, 2 * d - 2)]
    t = doubles("translations", n, d) if poses else []
    multipliers = doubles("multipliers", n, d * (d + 1) // 2)
    (order,), (delta,) = (
        stored(files["order"], "<i4", n),
        stored(files["delta"], "<f4", n * (d + poses)),
    )
    for word in delta:  # a hint of which this program has no need
        from_bits(word, 23, 32)
    if sorted(order) != list(range(n)):
        raise Refused("order is no permutation")
    if not (0 <= claim["pin"] < n and abs(claim["exponent"]) <= 300):
        raise Refused("pin or exponent out of range")
    if any(any(multipliers[k]) for k in graph.points):
        raise Refused("a multiplier of a point, which has no rotation")
    s = [ONE] * n
    if graph.free is not None:
        s = [from_bits(word) for word in stored(files["scales"], "<f8", n)[0]]
        if any(s[k] != ONE for k in range(n) if k not in graph.free | graph.points):
            raise Refused("a scale that is known to be 1 is another one")
        if min(s) <= 0:
            raise Refused("a scale is not positive")
    rejected: list[Rejected] = []
    if claim["version"] == 3:
        found = stored(files["rejected"], "<i4")[0]
        k, ends = len(found), [-1, *found, len(graph.edges)]
        if not (0 < k < len(graph.edges) and all(map(lt, ends, ends[1:]))):
            raise Refused("rejected measurements must be given by ascending numbers, and not all")
        rows = doubles("rejections", k, 2 + d * d + (1 + d) * poses)
        for e, (price, kappa, *row) in zip(found, rows, strict=True):
            tau, *b = row[d * d :] or [0] * (d + 1)
            C = [row[d * a : d * a + d] for a in range(d)]
            rejected.append(Rejected(e, price, kappa, tau, C, tuple(b)))
    return Proof(q, t, multipliers, order, claim["pin"], claim["exponent"], rejected, s)


# --- Both sides -----------------------------------------------------------------------------------


def upper_bound(graph: Graph, proof: Proof, d: int) -> Fraction:
    """F(x), each term rounded up to a multiple of 2^-FINE; those of rejected ones are cut off.

    With g = s_i s_ij, the term of a rotation is kappa (d (s_j - g)^2 + 2 g s_j (d - tr Q)), Q being
    what the residual turns by. If no scale is known, F is divided by the mean of their squares.
    """
    norms, N = [norm(q) for q in proof.q], [matrix(q, d) for q in proof.q]
    flat = [x for t in (*proof.t, *(edge.t for edge in graph.edges)) for x in t]
    numbers, unit = trimmed(flat)
    (_, *s), fine = trimmed([ONE, *proof.s])
    (_, *scales), more = trimmed([ONE, *(edge.scale for edge in graph.edges)])
    t = [numbers[k : k + d] for k in range(0, len(numbers), d)]
    total, prices = 0, {r.edge: r.price << (FINE - ULP) for r in proof.rejected}
    for k, ((i, j, q, _, kappa, tau, *_), scale) in enumerate(
        zip(graph.edges, scales, strict=True), len(proof.t)
    ):
        term = 0
        if kappa:
            below = norms[i] * norms[j] * norm(q)
            cosine = sum(map(mul, proof.q[j], product(proof.q[i], q)))
            g, own = s[i] * scale, s[j] << more
            less = 8 * g * own * (cosine * cosine - below) - d * (own - g) ** 2 * below
            term -= shifted(kappa * less, FINE - ULP - 2 * (fine + more)) // below
        if proof.t:
            arms = [s[i] * sum(map(mul, row, t[k])) for row in N[i]]
            apart = [norms[i] * (b - a) << fine for a, b in zip(t[i], t[j], strict=True)]
            off = norm([x - arm for x, arm in zip(apart, arms, strict=True)])
            term -= shifted(-tau * off, FINE - ULP - 2 * (unit + fine)) // norms[i] ** 2
        total += min(term, prices.get(k - len(proof.t), term))
    if not graph.in_mean_unit:
        return Fraction(total, 1 << FINE)
    squares = [x * x for k, x in enumerate(s) if k not in graph.points]
    return Fraction(total * len(squares), 1 << FINE) * Fraction(1 << 2 * fine, sum(squares))


def lower_bound(graph: Graph, proof: Proof, d: int) -> Fraction:
    """What F* is at least if A is positive semidefinite.

    The sum of tr(Lam), and what rejected measurements add. A trace counts s^2 times: at unknown
    scales it must not be negative, and if all are unknown, the least one counts for each.
    """
    traces = [sum(row[k] for k in ((0, 2), (0, 3, 5))[d - 2]) for row in proof.multipliers]
    if graph.in_mean_unit:
        total = min(traces[k] for k in graph.free or ()) * len(graph.free or ())
    elif graph.free and any(traces[k] < 0 for k in graph.free):
        raise Refused("the trace of a multiplier of an unknown scale is negative")
    else:
        total = sum(x for k, x in enumerate(traces) if k not in (graph.free or ()))
    return Fraction(
        total + sum(constant(graph.edges[cut.edge], cut, d) for cut in proof.rejected), ONE
    )


def constant(edge: Edge, cut: Rejected, d: int) -> Fraction:
    """What to add to an edge of negative weight, in units of 2^-ULP: it is below min(f_e, price).

    If C and t are p_R and p_t away from the measurement, the price must be at most
    (kappa || beta_R) p_R^2 + (tau || beta_t) p_t^2 for the weights beta and a || b = a b / (a + b).
    Without weights it does not count: f_e is never negative.
    """
    C, N, D = [*chain(*cut.C)], chain(*matrix(edge.q, d)), norm(edge.q)
    turned = norm([D * x - ONE * y for x, y in zip(C, N, strict=True)])
    moved = norm([x - y for x, y in zip(cut.t, edge.t, strict=True)])
    if min(cut.kappa, cut.tau) < 0 or cut.price <= 0 or (cut.kappa and not edge.kappa):
        raise Refused("a price or a weight of a rejected measurement is out of range")
    if not (cut.kappa or cut.tau):
        return Fraction(0)
    reached = Fraction(cut.kappa * edge.kappa * turned, (cut.kappa + edge.kappa or 1) * D * D)
    reached += Fraction(cut.tau * edge.tau * moved, cut.tau + edge.tau)
    if reached < cut.price * ONE * ONE:
        raise Refused("a rejected measurement was not proven to reach its price")
    return cut.price + cut.kappa * (d - Fraction(norm(C), ONE * ONE))


Entries = dict[tuple[int, int], int]
Block = tuple[int, int, list[list[int]], int]  # N/D from a row and a column


def certificate_matrix(
    graph: Graph, proof: Proof, d: int, at: dict[int, int], turn: dict[int, int]
) -> tuple[Entries, list[Block], int]:
    """A = M - Lam in units of 2^-unit: entries of rows r <= s, blocks -kappa R_ij to add, and unit.

    Node k has rows at[k], its position (-1: the pinned one), and turn[k] ..., its rotation.
    """
    terms = [(e.i, e.j, matrix(e.q, d), norm(e.q), e.t, e.kappa, e.tau) for e in graph.edges]
    for cut in proof.rejected:
        i, j, *_ = terms[cut.edge]
        terms[cut.edge] = (i, j, cut.C, ONE, cut.t, -cut.kappa, -cut.tau)
    taus, tau_unit = trimmed([weight for term in terms for weight in term[5:]])
    (_, *scales), fine = trimmed([ONE, *(edge.scale for edge in graph.edges)])
    steps, step_unit = trimmed([ONE, *(x for term in terms for x in term[4])])
    Lams, Lam_unit = trimmed([x for row in proof.multipliers for x in row])
    unit, size = max(tau_unit + 2 * max(step_unit, fine), Lam_unit), d * (d + 1) // 2
    A: Counter[tuple[int, int]] = Counter()
    blocks = []
    for k, (i, j, N, D, *_) in enumerate(terms):
        kappa, tau = (weight << (unit - tau_unit) for weight in taus[2 * k : 2 * k + 2])
        if kappa:
            across = (kappa >> fine) * scales[k]
            blocks.append((turn[i], turn[j], [[-across * x for x in row] for row in N], D))
            for row, weight in ((turn[i], (across >> fine) * scales[k]), (turn[j], kappa)):
                A.update({(row + a, row + a): weight for a in range(d)})
        if proof.t:
            arms = [(at[j], steps[0]), (at[i], -steps[0])]
            arms += [(turn[i] + a, -x) for a, x in enumerate(steps[1 + d * k : 1 + d * (k + 1)])]
            arms, tau = [arm for arm in arms if arm[0] >= 0], tau >> 2 * step_unit
            for r, x in arms:
                for s, y in arms:
                    if r <= s:
                        A[r, s] += tau * x * y
    for k, row in turn.items():
        upper = iter(Lams[size * k : size * (k + 1)])
        for a in range(d):
            for b in range(a, d):
                A[row + a, row + b] -= next(upper) << (unit - Lam_unit)
    return A, blocks, unit


def scaled(
    A: Entries, blocks: list[Block], unit: int, scale: list[int], bits: int
) -> tuple[list[dict[int, int]], int]:
    """Rows of 2^scale A 2^scale in units of 2^-bits, s >= r, and more than they are below it."""
    rows: list[Counter[int]] = [Counter() for _ in scale]
    for (r, s), x in A.items():
        rows[r][s] += shifted(x, scale[r] + scale[s] + bits - unit)
    parallel = Counter((min(r, s), max(r, s)) for r, s, _, _ in blocks)
    for r, s, N, D in blocks:
        for a, entries in enumerate(N, r):
            for b, x in enumerate(entries, s):
                by = scale[a] + scale[b] + bits - unit
                rows[min(a, b)][max(a, b)] += (x << max(by, 0)) // (D << max(-by, 0))
    return [dict(row) for row in rows], 1 + max(parallel.values(), default=0)


# --- Positive semidefiniteness --------------------------------------------------------------------

Front = tuple[list[int], list[int], int]  # what is eliminated, what it reaches, and its parent


def fronts(pairs: set[tuple[int, int]], order: list[int], spare: int = 16) -> list[Front]:
    """A symbolic elimination of nodes; a wrong one could only fail."""
    place = {node: k for k, node in enumerate(order)}
    later: list[set[int]] = [set() for _ in order]
    for i, j in pairs:
        later[min(place[i], place[j])].add(max(place[i], place[j]))
    waiting: list[list[int]] = [[] for _ in order]  # fronts, at the first place they reach
    pivots: list[list[int]] = []
    reached: list[set[int]] = []
    zeros: list[int] = []  # that merging nodes into a front has added
    parent: dict[int, int] = {}
    for k, reach in enumerate(later):
        reach = reach.union(*(reached[f] for f in waiting[k])) - {k}
        front = max(waiting[k], key=lambda f: len(reached[f]), default=-1)
        added = len(reach) + 1 - len(reached[front]) if waiting[k] else 0
        if not waiting[k] or zeros[front] + added * len(pivots[front]) > spare:
            front, added = len(pivots), 0
            pivots.append([])
            reached.append(set())
            zeros.append(0)
        zeros[front] += added * len(pivots[front])
        pivots[front].append(order[k])
        reached[front] = reach
        parent |= {f: front for f in waiting[k] if f != front}
        if reach:
            waiting[min(reach)].append(front)
    found = sorted(range(len(pivots)), key=lambda f: place[pivots[f][-1]])
    new = {f: k for k, f in enumerate(found)} | {-1: -1}
    return [(pivots[f], [order[k] for k in reached[f]], new[parent.get(f, -1)]) for f in found]


class Packing:
    """Numbers below 2^(width - 1) in size as one: the sum of x_k 2^(width k), signs included."""

    def __init__(self, width: int) -> None:
        self.width, self.biases = width, [0]

    def bias(self, n: int) -> int:
        """What makes n numbers positive: 2^(width - 1) for each."""
        for k in range(len(self.biases), n + 1):
            self.biases.append(self.biases[k - 1] | 1 << (self.width * k - 1))
        return self.biases[n]

    def unpacked(self, packed: int, n: int) -> list[int]:
        """The n numbers."""
        size, half = self.width // 8, 1 << (self.width - 1)
        data = (packed + self.bias(n)).to_bytes(n * size, "little")
        return [
            int.from_bytes(data[k : k + size], "little") - half for k in range(0, n * size, size)
        ]

    def packed(self, numbers: Sequence[int]) -> int:
        """The numbers as one."""
        size, half = self.width // 8, 1 << (self.width - 1)
        data = b"".join((x + half).to_bytes(size, "little") for x in numbers)
        return int.from_bytes(data, "little") - self.bias(len(numbers))

    def gathered(self, packed: int, n: int, places: list[int]) -> int:
        """Those of n numbers that are at these places."""
        size, data = (
            self.width // 8,
            (packed + self.bias(n)).to_bytes(n * self.width // 8, "little"),
        )
        chosen = b"".join(data[size * k : size * k + size] for k in places)
        return int.from_bytes(chosen, "little") - self.bias(len(places))

    def spread(self, packed: int, places: list[int]) -> int:
        """The numbers at other places, which ascend and are counted from the first."""
        biased, total, start = packed + self.bias(len(places)), 0, 0
        for k, place in enumerate(places, 1):
            if k == len(places) or places[k] != place + 1:
                run = (biased >> self.width * start) & ((1 << self.width * (k - start)) - 1)
                total += (run - self.bias(k - start)) << self.width * (places[start] - places[0])
                start = k
        return total


def quotients(S: list[int], spare: int) -> list[int]:
    """A column of a Cholesky factor, from a row of what is left; none if it fails. A hint."""
    top = isqrt(max(S[0] - spare, 0))
    return [top, *((2 * x + top) // (2 * top) for x in S[1:])] if top else []


def is_positive_semidefinite(
    rows: list[dict[int, int]],
    error: int,
    tree: list[Front],
    v: list[int],
    precision: int,
    hint: Callable[[list[int], int], list[int]] = quotients,
    columns: list[list[int]] | None = None,
) -> bool:
    """Whether A = sum l l^T + E is found, with E diagonally dominant under the weights v.

    ``columns`` get the l, each from its pivot on: the entries at later pivots and at the boundary.

    Entries of A are no less than those of ``rows`` and no more than ``error`` above, in units of
    2^-(2 precision). The pivots of all fronts in ``tree`` are the rows, in order. Nothing is
    assumed about the columns l, which ``hint`` proposes.
    """
    one, packing, n = 1 << 2 * precision, Packing(2 * precision + 8), len(rows)
    norms, own, others, reach = [0] * n, [0] * n, [0] * n, [0] * n
    for r, row in enumerate(rows):
        for s, x in row.items():
            if abs(x) > one:
                return False
            others[r] += error * v[s]
            others[s] += error * v[r] * (r != s)
    for pivots, boundary, _ in tree:
        inside, outside = sum(v[r] for r in pivots), sum(v[r] for r in boundary)
        for r in pivots:
            reach[r] += inside + outside
        for r in boundary:
            reach[r] += inside
    left: dict[int, list[tuple[list[int], list[int]]]] = {}
    for front, (pivots, boundary, parent) in enumerate(tree):
        here = [*pivots, *boundary]
        place, packed = {r: k for k, r in enumerate(here)}, [0] * len(here)
        for r in pivots:
            for s, x in rows[r].items():
                packed[place[r]] += x << packing.width * (place[s] - place[r])
        for below, passed_on in left.pop(front, []):
            places = [place[r] for r in below]
            for k, x in enumerate(passed_on):
                packed[places[k]] += packing.spread(x, places[k:])
        for k, r in enumerate(pivots):
            S = packing.unpacked(packed[k], len(here) - k)
            column, tail = hint(S, (reach[r] << precision) // v[r] + 1), 0
            if not column:
                return False
            if columns is not None:
                columns.append(column)
            own[r] = S[0] - column[0] * column[0]
            for a in range(len(here) - 1, k, -1):
                s, y = here[a], column[a - k]
                tail = (tail << packing.width) + y
                packed[a] -= y * tail
                norms[s] += y * y
                rest = abs(S[a - k] - y * column[0])
                others[r] += rest * v[s]
                others[s] += rest * v[r]
                if norms[s] > one:
                    return False
        if boundary:
            left.setdefault(parent, []).append((boundary, packed[len(pivots) :]))
    complete = [r for pivots, _, _ in tree for r in pivots] == list(range(n)) and not left
    return complete and all(e * w >= rest for e, w, rest in zip(own, v, others, strict=True))


# --- Distances ------------------------------------------------------------------------------------

Matrix = list[list[int]]


def inverse_blocks(
    tree: list[Front], columns: list[list[int]], rows: dict[int, range], n: int, precision: int
) -> dict[int, Matrix]:
    """At least the blocks of nodes' rows of A^-1, A its first n rows, in units of 2^-64.

    A is at least B = sum l l^T, so A^-1 is at most B^-1. With x and y the entries of l at its pivot
    and below, and Z for B^-1 there, B^-1 has 1/x^2 + y.Z y/x^2 at the pivot, and -Z y/x beside it.
    What is lost by rounding these c numbers down, less than 1 of each, is made up for by 1 on the
    diagonal of each row, and c on the pivot's. Rows from n on count as zeros.
    """
    packing, one, size = Packing(precision + 160), 1 << (2 * precision + 64), precision + 160
    node_of = {r: k for k, own in rows.items() for r in own}
    blocks: dict[int, Matrix] = {k: [] for k in rows}
    above: dict[int, list[int]] = {}  # of fronts, the rows of Z at their boundaries
    below: list[list[int]] = [[] for _ in range(len(tree) + 1)]
    for front, (_, _, parent) in enumerate(tree):
        below[parent].append(front)
    for front in reversed(range(len(tree))):
        pivots, boundary, _ = tree[front]
        here, Z = [*boundary, *reversed(pivots)], above.pop(front, [])
        for c, r in enumerate(here[len(boundary) :], len(boundary)):
            if r >= n:
                Z.append(0)
                continue
            x, *y = columns[r]
            later = c - len(boundary)
            y = y[later:] + y[:later][::-1]
            Zy = packing.unpacked(sum(map(mul, y, Z)), c)
            own = c - (-one - sum(map(mul, y, Zy))) // (x * x)
            if own >> 124:
                raise Refused("the certificate matrix is too near to a singular one for distances")
            beside = [-z // x for z in Zy]
            for k, z in enumerate(beside):
                Z[k] += (1 << size * k) + (z << size * c)
            Z.append(packing.packed([*beside, own]))
        place = {r: k for k, r in enumerate(here)}
        for r in pivots:
            if r in node_of:
                row, k = packing.unpacked(Z[place[r]], len(here)), node_of[r]
                blocks[k].append([row[place[s]] for s in rows[k]])
        for child in below[front]:
            places = [place[r] for r in tree[child][1]]
            above[child] = [packing.gathered(Z[k], len(here), places) for k in places]
    return blocks


def cofactors(M: Matrix) -> Matrix:
    """Those of a 3 x 3 matrix."""
    return [
        [M[a - 2][b - 2] * M[a - 1][b - 1] - M[a - 2][b - 1] * M[a - 1][b - 2] for b in range(3)]
        for a in range(3)
    ]


def turns_less(G: Matrix, square: Fraction, degrees: int) -> bool:
    """Whether rotations differ by no more than an angle, G being their block and rho^2 = square.

    If V is the difference of two rotations by theta, V^T V = 2 (1 - cos(theta)) (I - n n^T), n the
    axis, or 0 in the plane. So with H = G^-1, its cofactors over the determinant, tr(V H V^T) <=
    rho^2 is 2 (1 - cos(theta)) (tr(H) - n.H n) <= rho^2: impossible beyond the angle if
    tr(H) I - H exceeds rho^2 / (2 (1 - cos(angle))) I.
    """
    bits = 320
    x = degrees * quarter_turn(bits) // (90 * ONE)
    apart = (1 << bits) - circle(x, bits)[0] - (1 << 33)  # 1 - cos(angle), or less
    if apart <= 0:
        return False
    p, q = (square * Fraction(1 << bits, 2 * apart)).as_integer_ratio()
    if len(G) == 2:
        (a, b), (_, c) = G
        return q * (a + c) > p * (a * c - b * b)
    C = cofactors(G)
    enough = q * sum(C[a][a] for a in range(3)) - p * sum(map(mul, G[0], C[0]))
    form = [[enough * (a == b) - q * C[a][b] for b in range(3)] for a in range(3)]
    minors = cofactors(form)
    return form[0][0] > 0 and minors[2][2] > 0 and sum(map(mul, form[0], minors[0])) > 0


def refuse_farther(
    graph: Graph, claims: Sequence[Within], G: dict[int, Matrix], square: Fraction, d: int
) -> None:
    """Refuse claims that do not follow from blocks at least those of A^-1, and rho^2 = square.

    With u and V what a node's position and rotation differ by, tr([u V] G^-1 [u V]^T) <= rho^2. So
    |u|^2 <= rho^2 G_tt.
    """
    for claim in claims:
        if claim.node is not None and claim.node not in graph.ids:
            raise Refused(f"there is no node {claim.node}")
        metres, degrees = (None if x is None else double(str(x)) for x in claim[1:3])
        for k in (k for k in G if claim.node in (None, graph.ids[k])):
            far = metres is not None and square * G[k][0][0] > Fraction(metres, ONE) ** 2
            if degrees not in (None, 180 * ONE) and k not in graph.points:
                far |= not turns_less([row[-d:] for row in G[k][-d:]], square, degrees)
            if far:
                raise Refused(f"{called(graph.ids[k])} may be further away than {claim}")


# --- Checking -------------------------------------------------------------------------------------


class Answer(NamedTuple):
    """F(x) <= upper and F* >= lower, where ``about`` describes F; and claims that hold."""

    upper: Fraction
    lower: Fraction
    about: str
    within: tuple[Within, ...] = ()

    @property
    def relative_gap(self) -> Fraction:
        """(F(x) - F*)/F(x) at most."""
        return max(Fraction(0), 1 - self.lower / self.upper) if self.upper else Fraction(0)

    def __str__(self) -> str:
        upper, lower = digits(self.upper, 15, up=True), digits(self.lower, 15, up=False)
        gap = digits(self.relative_gap, 2, up=True)
        return f"PROVED: F(x) <= {upper:g}, F* >= {lower:g}, relative gap <= {gap:.1e}"


def digits(x: Fraction, count: int, up: bool) -> Decimal:
    """The first digits of a number x >= 0, rounded up or down."""
    exponent = len(str(x.numerator)) - len(str(x.denominator)) - count - 1
    while (
        m := -(-x // Fraction(10) ** exponent) if up else x // Fraction(10) ** exponent
    ) >= 10**count:
        exponent += 1
    return Decimal(m).scaleb(exponent) if m else Decimal(0)


def prove(
    graph: Graph, proof: Proof, d: int, claims: Sequence[Within] = ()
) -> tuple[Fraction, Fraction]:
    """Both bounds, and that the claims hold."""
    lower = lower_bound(graph, proof, d)
    found = fronts({(edge.i, edge.j) for edge in graph.edges}, proof.order)
    at, turn, rows, n = {}, {}, dict[int, range](), 0
    for node in (node for pivots, _, _ in found for node in pivots):
        start = n
        if proof.t:
            at[node], n = (-1, n) if node == proof.pin else (n, n + 1)
        if node not in graph.points:
            turn[node], n = n, n + d
        rows[node] = range(start, n)
    tree = [
        ([r for k in pivots for r in rows[k]], sorted(r for k in boundary for r in rows[k]), parent)
        for pivots, boundary, parent in found
    ]
    A, blocks, unit = certificate_matrix(graph, proof, d, at, turn)
    if any(A.get((r, r), 0) <= 0 for r in range(n)):
        raise Refused("a diagonal entry of the certificate matrix is not positive")
    scale = [(unit - A[r, r].bit_length()) >> 1 for r in range(n)]  # to a diagonal in [1/4, 1)
    positions = set(at.values())
    exponents = [proof.exponent * (r in positions) - scale[r] for r in range(n)]
    lowest = min(exponents)
    v = [1 << (exponent - lowest) for exponent in exponents]
    for bits in PRECISIONS:
        columns: list[list[int]] = []
        parts = *scaled(A, blocks, unit, scale, 2 * bits), tree, v, bits
        if is_positive_semidefinite(*parts, columns=columns if claims else None):
            break
    else:
        raise Refused("the certificate matrix was not proven positive semidefinite")
    upper = upper_bound(graph, proof, d)
    if claims:
        if proof.order[-1] != proof.pin or proof.pin in graph.points:
            raise Refused("distances are seen from the pinned pose, the last of the order")
        del rows[proof.pin]
        G, low = {}, min(scale)
        for k, Z in inverse_blocks(tree, columns, rows, n - d, bits).items():
            by = [scale[r] - low for r in rows[k]]
            G[k] = [[Z[a][b] << (by[a] + by[b]) for b in range(len(by))] for a in range(len(by))]
        # For any estimate y that costs at most U: |X - Y| <= |X| + |Y|, |X|^2 = F(x) - L <= U - L.
        square = 4 * (upper - lower) * Fraction(2) ** (2 * low - 64)
        refuse_farther(graph, claims, G, square, d)
    return upper, max(lower, Fraction(0))


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
        claims = tuple(Within(**one, reference=graph.ids[proof.pin]) for one in claim["within"])
    except (Refused, Unreadable):
        raise
    except OSError as error:
        raise Unreadable(f"{proof_path}: {error.strerror or 'not a readable proof'}") from None
    except Exception as error:  # damaged archives can raise anything
        raise Unreadable(f"{proof_path}: not a readable proof ({type(error).__name__})") from None
    bounds = prove(graph, proof, claim["d"], claims)
    return Answer(*bounds, about(graph, claim, proof.rejected), claims)


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


def about(graph: Graph, claim: dict[str, Any], rejected: list[Rejected]) -> str:
    """The measurements and how they were read: what F is."""
    measured = f"the {claim['kind']} of {graph.n} nodes from {len(graph.edges)} measurements"
    said = ["chordal cost F", measured]
    for name in ("kappa", "tau")[: 1 + (claim["kind"] != "rotations")]:
        ones = any(getattr(edge, name) == ONE for edge in graph.edges)
        none = " (1 without information)" * ones
        said.append(f"{name} {claim[name] or f'of the file{none}'}")
    said.append(f"rotational information read as {claim['rotation_information']}")
    said += [f"with {len(graph.points)} landmarks"] * claim["landmarks"]
    said += [f"with {sum(e.role == 'prior' for e in graph.edges)} priors"] * claim["priors"]
    said += ["numbers read as information"] * claim["maps"]
    added = claim["keep"] == "all"
    said.append("parallel edges added" if added else f"only the {claim['keep']} of parallel edges")
    said += ["nodes of cc.txt alone"] * (claim["component_sha256"] is not None)
    if graph.free is not None:
        said.append(f"{len(graph.free)} scales unknown")
        unit = "root mean square scale" if graph.in_mean_unit else "poses of known scale"
        said.append(f"in the unit of the {unit}")
    if rejected:
        low = Context(6, ROUND_FLOOR).divide(min(cut.price for cut in rejected), ONE)
        high = Context(6, ROUND_CEILING).divide(max(cut.price for cut in rejected), ONE)
        said.append(f"truncated: {len(rejected)} rejected ones cost {low:g} to {high:g} at most")
    return ", ".join(said)


def main(arguments: list[str]) -> int:
    """Print what is proven; exit codes: 0 proved, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) != 2:
        sys.stderr.write("usage: integer_checker.py GRAPH PROOF\n")
        return 2
    try:
        answer = check(*arguments)
        lines = [f"{answer}", f"about {answer.about}", *map(str, answer.within)]
        sys.stdout.write("\n".join(lines) + "\n")
    except Refused as reason:
        sys.stdout.write(f"REFUSED: {reason}\n")
        return 6
    except Unreadable as reason:
        sys.stderr.write(f"error: {reason}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Reads a graph and a proof about it, and writes both as integers, for integer_checker.py.

    python integer_reader.py GRAPH PROOF > PLAIN

needs only this file and Python, and no floating-point number. It reads the same files as checker.py
but shares no code with it. The plain proof that it writes is a text of integers that states all
measurements, and all numbers of the proof. docs/plain_proofs.md says what each line means;
docs/checker.md says how graphs are read (section 1) and what a proof holds (section 10).
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import re
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from functools import cache, reduce
from operator import lt, mul
from pathlib import Path
from typing import Any, NamedTuple

ULP = 1074  # every double is an integer times 2^-ULP, and stored as that integer
ONE, FAR = 1 << ULP, 1 << 400
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


@cache
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


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The quaternion of R(a) R(b)."""
    (x, y, z, w), (p, q, r, s) = a, b
    i, j, k = (
        w * p + x * s + y * r - z * q,
        w * q - x * r + y * s + z * p,
        w * r + x * q - y * p + z * s,
    )
    return i, j, k, w * s - x * p - y * q - z * r


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
    information: tuple[int, ...] = ()  # an upper triangle, for the cost of g2o


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
    kappa, tau, whole = ONE, ONE, tuple[int, ...]()
    if claim.get("cost"):
        whole = tuple(map(double, information))
        if any(abs(x) >= FAR * ONE for x in whole):
            raise ValueError("information that is not huge expected")
    for word in () if whole else information:
        decimal(word)
    if information and not whole and None in (claim["kappa"], claim["tau"]):
        kappa, tau = weights(information, turned)
        if claim["rotation_information"] == "quaternion":
            kappa >>= 2  # half the angle, a quarter of the information
    q, t, kappa = quaternion(turn), tuple(numbers[:d]), max(kappa, 1) * turned
    return sensor, Edge(ids[0], ids[-1], q, t, kappa, tau, role, information=whole)


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
    if text.startswith(b"PK"):
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
    if claim.get("cost") and not all(edge.information for edge in edges):
        raise Unreadable("information expected on every measurement")
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
    given = [claim[name] for name in ("kind", "keep", "kappa", "tau", "rotation_information")]
    if given != ["similarities", "all", None, None, "tangent"]:
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


def read_claim(data: bytes) -> dict[str, Any]:
    """The header of a proof; decimals stay decimals."""
    text = bytes(stored(data, "|u1")[0]).decode()
    given = json.loads(text, parse_float=Decimal, parse_constant=Decimal)
    absent = {"cost": None, "landmarks": False, "priors": False, "origin": None}
    claim: dict[str, Any] = {**absent, "within": [], **given}
    if (claim["version"], claim["cost"]) not in ((1, None), (2, "g2o"), (3, None), (4, None)):
        raise Unreadable("not a proof of version 1, or of version 2 about the cost of g2o, 3 or 4")
    known: dict[str, list[Any]] = {
        "format": ["certpgo proof"],
        "version": [1, 2, 3, 4],
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
    meant = ["poses", "tangent" if claim["d"] == 2 else "quaternion", None, None]
    said = [claim[name] for name in ("kind", "rotation_information", "kappa", "tau")]
    if claim["version"] == 2 and said != meant:
        raise Unreadable(f"the cost of g2o is about {meant[0]}, with information of a {meant[1]}")
    similar = claim["kind"] == "similarities"
    if similar != (claim["version"] == 4):
        raise Unreadable("proofs of version 4 are those about similarities")
    whole = claim["rotation_information"], claim["component_sha256"]
    if similar and whole != ("tangent", None):
        raise Unreadable(
            "a proof is about all similarities of a file, with information of tangents"
        )
    for one in claim["within"]:
        if {*one} != {"node", "metres", "degrees"}:
            raise Unreadable("a claim of a distance has a node, metres and degrees")
        numbers = [x for x in (one["metres"], one["degrees"]) if x is not None]
        if (
            not numbers
            or {*map(type, numbers)} - {int, Decimal}
            or not all(1 < x * FAR < FAR * FAR for x in numbers)
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


def pose_lines(files: dict[str, bytes], claim: dict[str, Any], graph: Graph) -> Iterator[str]:
    """A line for each node: what it is, its id, where the estimate has it, and its multiplier."""
    n, d, poses = graph.n, claim["d"], claim["kind"] != "rotations"
    q, multipliers = (
        doubles(files, name, n, columns)
        for name, columns in (("rotations", 2 * d - 2), ("multipliers", d * (d + 1) // 2))
    )
    t = doubles(files, "translations", n, d) if poses else [[]] * n
    s = doubles(files, "scales", n)[0] if graph.free is not None else ["1p0"] * n
    for k, node in enumerate(graph.ids or range(n)):
        name, turn = (
            "world" if node is None else f"{node}",
            q[k] if d == 3 else ["0", "0", *q[k][::-1]],
        )
        if k in graph.points:
            if {*multipliers[k]} != {"0"}:
                raise Refused("a multiplier of a point, which has no rotation")
            yield " ".join(("point", name, *t[k]))
        elif k in (graph.free or ()):
            yield " ".join(("free", name, *turn, *t[k], s[k], *multipliers[k]))
        elif s[k] != "1p0":
            raise Refused("a scale that is known to be 1 is another one")
        else:
            yield " ".join(("pose", name, *turn, *t[k], *multipliers[k]))


def edge_lines(files: dict[str, bytes], claim: dict[str, Any], graph: Graph) -> Iterator[str]:
    """A line for each measurement, and one for what a proof claims about it."""
    poses, similar = claim["kind"] != "rotations", graph.free is not None
    cuts = rejections(files, claim, len(graph.edges)) if claim["version"] == 3 else {}
    bounds = minorants(files, claim["d"], graph) if claim["cost"] else [()] * len(graph.edges)
    for k, (edge, bound) in enumerate(zip(graph.edges, bounds, strict=True)):
        turn = map(str, edge.q) if edge.kappa else ()
        weights = (edge.kappa,) * bool(edge.kappa) + (edge.tau,) * poses
        where = (*edge.t,) * poses + (edge.scale,) * similar
        weights = () if edge.information else weights
        numbers = *words(weights), *turn, *words(where), *words(edge.information)
        yield " ".join(("edge" if edge.kappa else "position", f"{edge.i} {edge.j}", *numbers))
        if k in cuts:
            yield " ".join(("rejected", *cuts[k]))
        if bound:
            yield " ".join(("minorant", *bound))


def rejections(files: dict[str, bytes], claim: dict[str, Any], m: int) -> dict[int, list[str]]:
    """Of rejected measurements, by their numbers: price, kappa, C, and of poses tau and b."""
    d, poses = claim["d"], claim["kind"] == "poses"
    found = stored(files["rejected"], "<i4")[0]
    ends = [-1, *found, m]
    if not (0 < len(found) < m and all(map(lt, ends, ends[1:]))):
        raise Refused("rejected measurements must be given by ascending numbers, and not all")
    rows = doubles(files, "rejections", len(found), 2 + d * d + (1 + d) * poses)
    return dict(zip(found, rows, strict=True))


def minorants(files: dict[str, bytes], d: int, graph: Graph) -> list[tuple[str, ...]]:
    """Of each measurement: tau, kappa, c, b, N and what touches; of positions tau, c and b."""
    m, found = len(graph.edges), list[tuple[str, ...]]()
    (tau,), (kappa,), (c,) = (doubles(files, name, m) for name in ("tau", "kappa", "constants"))
    b, N = doubles(files, "arms", m, d), doubles(files, "couplings", m, d, d)
    touching = doubles(files, "touching", m, 1 if d == 2 else 5)
    for k, edge in enumerate(graph.edges):
        if edge.kappa:
            found.append((tau[k], kappa[k], c[k], *b[k], *N[k], *touching[k]))
        elif {kappa[k], *N[k]} != {"0"}:
            raise Refused("a minorant of a position, with a rotation")
        else:
            found.append((tau[k], c[k], *b[k]))
    return found


def doubles(files: dict[str, bytes], name: str, *shape: int) -> list[list[str]]:
    """The rows of an array of doubles, as they are written."""
    return [[*map(written, row)] for row in stored(files[name], "<f8", *shape)]


# --- What is written ------------------------------------------------------------------------------


def words(numbers: Sequence[int]) -> list[str]:
    """Doubles as mpe, the number m 2^e."""
    found = []
    for x in numbers:
        zeros = (x & -x).bit_length() - 1
        found.append(f"{x >> zeros}p{zeros - ULP}" if x else "0")
    return found


def written(word: int) -> str:
    """The same of the bits of a double."""
    exponent, digits = word >> 52 & 2047, word & (1 << 52) - 1
    if exponent == 2047:
        raise Refused("the proof holds numbers that are not finite")
    digits |= (exponent > 0) << 52
    if not digits:
        return "0"
    zeros = (digits & -digits).bit_length() - 1
    m = digits >> zeros if word < 1 << 63 else -(digits >> zeros)
    return f"{m}p{max(exponent, 1) - 1 + zeros - ULP}"


def plain(graph_path: str | Path, proof_path: str | Path) -> str:
    """The text about a graph and its proof; raises `Refused` or `Unreadable`."""
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
        return "\n".join((*heading(files, claim, graph), "")) + "\n".join(
            (*pose_lines(files, claim, graph), *edge_lines(files, claim, graph), "")
        )
    except (Refused, Unreadable):
        raise
    except OSError as error:
        raise Unreadable(f"{proof_path}: {error.strerror or 'not a readable proof'}") from None
    except Exception as error:  # damaged archives can raise anything
        raise Unreadable(f"{proof_path}: not a readable proof ({type(error).__name__})") from None


def heading(files: dict[str, bytes], claim: dict[str, Any], graph: Graph) -> Iterator[str]:
    """The first lines."""
    n, width = graph.n, claim["d"] + (claim["kind"] != "rotations")
    (order,), (delta,) = stored(files["order"], "<i4", n), stored(files["delta"], "<f4", n * width)
    for word in delta:  # a hint of which integers have no need
        from_bits(word, 23, 32)
    rows = stored(files["rejections"], "<f8") if claim["version"] == 3 else []
    yield "certpgo plain proof 1"
    yield f"graph {claim['graph_sha256']}"
    yield f"about {about(graph, claim, [from_bits(row[0]) for row in rows])}"
    yield f"cost {claim['cost'] or 'chordal'} {claim['kind']} {claim['d']}"
    yield f"pin {claim['pin']} {claim['exponent']}"
    yield " ".join(("order", *map(str, order)))
    for one in claim["within"]:
        metres, degrees = ("-" if x is None else f"{x}" for x in (one["metres"], one["degrees"]))
        yield f"within {'every' if one['node'] is None else one['node']} {metres} {degrees}"


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


def about(graph: Graph, claim: dict[str, Any], prices: list[int]) -> str:
    """The measurements and how they were read: what F is."""
    measured = f"the {claim['kind']} of {graph.n} nodes from {len(graph.edges)} measurements"
    if claim["cost"]:
        edges = "EdgeSE2" if claim["d"] == 2 else "EdgeSE3:QUAT"
        said = [f"g2o's chi2 of {edges} with full information"]
        said += ["and of positions"] * (not all(edge.kappa for edge in graph.edges))
        said.append(measured)
    else:
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
    if prices:
        low = Context(6, ROUND_FLOOR).divide(min(prices), ONE)
        high = Context(6, ROUND_CEILING).divide(max(prices), ONE)
        said.append(f"truncated: {len(prices)} rejected ones cost {low:g} to {high:g} at most")
    return ", ".join(said)


def main(arguments: list[str]) -> int:
    """Write a plain proof; exit codes: 0 written, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) != 2:
        sys.stderr.write("usage: integer_reader.py GRAPH PROOF > PLAIN\n")
        return 2
    try:
        sys.stdout.write(plain(*arguments))
    except Refused as reason:
        sys.stderr.write(f"REFUSED: {reason}\n")
        return 6
    except Unreadable as reason:
        sys.stderr.write(f"error: {reason}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Verifies proofs that an estimate of a pose graph or rotation graph is nearly optimal.

    python checker.py GRAPH PROOF

needs only this file, Python and NumPy. GRAPH is g2o or 1DSfM text, or an archive of similarities;
PROOF contains an estimate x and multipliers Lam, both untrusted. The output is ``PROVED: F(x) <=
..., F* >= ...`` or one line with the reason why not. Here

    F(R, t) = sum kappa |R_j - R_i R_ij|^2 + sum tau |t_j - t_i - R_i t_ij|^2,

without the second sum for rotations alone, or with s R for R and s_ij R_ij for R_ij over
similarities, see `lower_bound`; or g2o's chi2, f = sum e^T Omega e (see `g2o_cost`), for which
PROOF contains a minorant of each summand, or F with summands of rejected measurements cut off at
their prices. F* is the minimum over rotations R and points t, and over unknown scales s > 0. PROOF
may also claim how far every estimate that costs no more than the first bound is from x.

Trusted are IEEE 754 doubles rounded to nearest, Python, and that NumPy's matrix product adds up
products in some order (where exactness matters they are integers below 2^53). The Cholesky factors
are not trusted. docs/checker.md proves the result line by line.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import operator
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

if "numpy" not in sys.modules:  # for small matrices, threads cost more than they save
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

Bools = npt.NDArray[np.bool_]

U = 2.0**-53  # unit of rounding
SPARE = 1.0 + 2.0**-20  # exceeds the rounding of any sum of fewer than 2^30 positive numbers
POINT = 160  # fractional bits of rotations, stored as integers
FINE = 256  # fractional bits of angles, sines and cosines
OFF = 1 << 32  # exceeds the error of `_turn`, in units of 2^-FINE
BITS = 25  # fractional bits in the high parts of factors
FAR = 2.0**400  # products of numbers beyond might underflow or overflow
SERIES = 320  # fractional bits of exponentials of similarities
ATTEMPTS = 3  # factorizations tried for a sufficiently small residual


class Refused(Exception):  # noqa: N818
    """The proof is not valid, with the reason."""


class Farther(Refused):
    """What is proven of a distance is less than the proof claims."""


class Unreadable(Exception):  # noqa: N818
    """The graph or proof file cannot be read, with the reason."""


# --- Numbers --------------------------------------------------------------------------------------


def integers(x: Array) -> tuple[Any, int]:
    """Python integers N and an exponent e with x = N 2^-e exactly."""
    if not np.isfinite(x).all():
        raise Refused("a number is not finite")
    mantissa, exponent = np.frexp(x)
    lowest = int(exponent[x != 0.0].min(initial=53))
    shifts = np.where(x != 0.0, exponent, lowest) - lowest
    return _big(np.ldexp(mantissa, 53)) << _big(shifts), 53 - lowest


def _big(x: npt.NDArray[Any]) -> Any:
    return x.astype(np.int64).astype(object)


def _in_fractions(x: Array) -> tuple[Any, int]:
    """Python integers N and an exponent e >= 0 with x = N 2^-e exactly."""
    N, e = integers(x)
    return N << max(-e, 0), max(e, 0)


def exact_rotations(q: Array) -> tuple[Any, Any]:
    """Integers N (k, d, d) and D (k,) with the rotations R(q)/|q|^2 = N/D exactly.

    ``q`` are quaternions x y z w (k, 4), or half-angle pairs cos sin (k, 2), none zero.
    """
    if not q.any(axis=1).all():
        raise Refused("a rotation is zero")
    parts = integers(q)[0].T
    if len(parts) == 2:
        c, s = parts
        cosine, sine, norm = c * c - s * s, 2 * c * s, c * c + s * s
        entries = [cosine, -sine, sine, cosine]
    else:
        x, y, z, w = parts
        xx, yy, zz, ww = x * x, y * y, z * z, w * w
        xy, xz, yz, xw, yw, zw = 2 * x * y, 2 * x * z, 2 * y * z, 2 * x * w, 2 * y * w, 2 * z * w
        norm = xx + yy + zz + ww
        entries = [ww + xx - yy - zz, xy - zw, xz + yw]
        entries += [xy + zw, ww - xx + yy - zz, yz - xw]
        entries += [xz - yw, yz + xw, ww - xx - yy + zz]
    d = 2 if len(parts) == 2 else 3
    return np.stack(entries, axis=-1).reshape(-1, d, d), norm


def rotations(q: Array) -> Any:
    """Integers (k, d, d): 2^POINT R(q)/|q|^2 rounded down."""
    N, D = exact_rotations(q)
    return (N << POINT) // D[:, None, None]


def _floored(n: Any, shift: int, divisor: Any = 1) -> Any:
    """The integer below n 2^shift / divisor, rounded down; the divisor is positive."""
    return (n << max(shift, 0)) // (divisor << max(-shift, 0))


# --- The graph ------------------------------------------------------------------------------------


class Ranges(NamedTuple):
    """Distances between the positions of nodes i and j, with terms w (d - |t_j - t_i|)^2."""

    i: Ints
    j: Ints
    distances: Array  # (k,): d
    weights: Array  # (k,): w


class Graph(NamedTuple):
    """Measurements i -> j between nodes 0 ... n-1, numbered by ascending ids."""

    n: int
    i: Ints
    j: Ints
    R: Any  # (m, d, d) integers, see `rotations`
    t: Array
    kappa: Array
    tau: Array
    N: Any = None  # (m, d, d) couplings instead of kappa R
    q: Any = None  # the measured rotations as in `rotations`
    information: Any = None  # (m, p, p), translation first, for the cost of g2o
    points: Bools | None = None  # (n,) which nodes are points, without rotations
    priors: int = 0  # how many measurements are from the world, the last node
    scales: Array | None = None  # (m,) measured, of similarities
    free: Bools | None = None  # (n,) which poses have an unknown scale
    arms: Array | None = None  # (m, d) points of the second poses, whose positions are measured
    ranges: Ranges | None = None  # what else is measured
    ids: tuple[int | None, ...] = ()  # (n,) of the file, which has none of the world

    @property
    def poses(self) -> Bools:
        """(n,) which nodes are no points."""
        return np.ones(self.n, dtype=bool) if self.points is None else ~self.points

    @property
    def in_mean_unit(self) -> bool:
        """Whether no scale is known, and the cost is F over the mean of their squares."""
        return self.free is not None and bool(self.free[self.poses].all())


Numbers = tuple[float, ...]


class Edge(NamedTuple):
    """A measurement as its line states it."""

    first: int  # of a prior it is the world, -1 until all ids are known
    second: int
    q: Numbers  # in the plane an angle
    t: Numbers
    kappa: float | None  # None: it measures a position alone
    tau: float | None  # None: it measures a rotation alone
    upper: Numbers = ()  # the information, for the cost of g2o
    what: str = "poses"  # or a "sighting" of a point, one of those numbered "apart", or a "prior"
    sensor: int = 0
    scale: float = 1.0  # of a similarity


_IN_NUMBERS = b"0123456789+-.eE \t\r"
_PLAIN = bytes(range(32, 127)) + b"\t\r\n"
_MARK = b"\xef\xbb\xbf"  # may begin a file
_IGNORED = re.compile(
    rb"VERTEX_(SE2|SE3:QUAT|XY|TRACKXYZ|POINT_XYZ)|FIX|PARAMS_(SE2OFFSET|SE3OFFSET|CAMERACALIB)"
    rb"|EDGE_(SE2_XY|BEARING_SE2_XY|SE3_TRACKXYZ|POINT_XYZ|PRIOR_SE2|PRIOR_SE2_XY|SE2_PRIOR"
    rb"|SE2_GPS|SE3_PRIOR|SE3_XYZPRIOR)|LANDMARK[23]"
)
#: Lines that are read if the proof says so: of points seen by poses, and from the world of whole
#: poses and of positions. Points of LANDMARK2 may be numbered apart from poses.
_SIGHTINGS = (b"EDGE_SE2_XY", b"LANDMARK2", b"EDGE_SE3_TRACKXYZ")
_WHOLE = (b"EDGE_PRIOR_SE2", b"EDGE_SE2_PRIOR", b"EDGE_SE3_PRIOR")
_PRIORS = (*_WHOLE, b"EDGE_PRIOR_SE2_XY", b"EDGE_SE2_GPS", b"EDGE_SE3_XYZPRIOR")


def read_graph(text: bytes, claim: dict[str, Any], component: bytes | None) -> Graph:
    """The measurements in a g2o or 1DSfM text, under the reading options of a proof.

    Those about similarities are in a g2o text, or an archive, see `read_archive`.
    """
    if text.startswith(b"PK"):
        return read_archive(text, claim)
    edges, points = _with_own_ids(list(_edges(text, claim)))
    edges += _placing(edges, claim)
    if component is not None:
        if not re.fullmatch(rb"[0-9\s]*", component):
            raise Unreadable("cc.txt: ids expected")
        kept = {int(word) for word in component.split()}
        edges = [edge for edge in edges if edge[0] in kept and edge[1] in kept]
    if claim["keep"] != "all":
        places = range(len(edges)) if claim["keep"] == "last" else reversed(range(len(edges)))
        chosen = {frozenset(edges[k][:2]): k for k in places}
        edges = [edges[k] for k in sorted(chosen.values())]
    if not edges:
        raise Unreadable("no measurements")
    first, second, q, positions, kappa, tau, upper, what, _, s = zip(*edges, strict=True)
    ids = {k: position for position, k in enumerate(sorted({*first, *second}))}
    turned, moved = (np.array([k is not None for k in of]) for of in (kappa, tau))
    if not (turned | moved).all():
        raise Unreadable("a measurement of nothing: its information is zero")
    weights, t = [np.array([k or 0.0 for k in of]) for of in (kappa, tau)], np.array(positions)
    for k, (name, stated) in enumerate((("kappa", turned), ("tau", moved))):
        if claim[name] is not None:
            weights[k] = np.where(stated, float(claim[name]), 0.0)
        if not ((weights[k] > 1.0 / FAR) & (weights[k] < FAR) | ~stated).all():
            raise Unreadable(f"{name} must be positive, and neither tiny nor huge")
    turns = np.array(q)
    if not (np.isfinite(turns).all() and np.isfinite(t).all()):
        raise Unreadable("a number that is not finite")
    turns = half_angles(turns[:, 0]) if turns.shape[1] == 1 else turns
    i, j = (np.array([ids[k] for k in ends]) for ends in (first, second))
    R = rotations(turns) if claim.get("cost") is None else None
    prior = [k == "prior" for k in what]
    if claim.get("origin") is not None:
        t[prior] = _less(t[prior], np.array(claim["origin"], dtype=np.float64))
    seen = np.array([k in points for k in ids]) if points else None
    graph = Graph(len(ids), i, j, R, t, weights[0], weights[1], None, turns, points=seen)
    graph = graph._replace(priors=sum(prior))
    graph = graph._replace(ids=(*ids,) if not any(prior) else (*[*ids][:-1], None))
    if claim.get("kind") == "similarities":
        unit = min(_fixed(text) & {*ids}, default=min(ids))
        return graph._replace(scales=np.array(s), free=np.array([k != unit for k in ids]))
    if R is not None:
        return graph
    return graph._replace(information=_information(upper, claim["d"]))


def _information(upper: Sequence[Numbers], d: int) -> Array:
    """(m, p, p) matrices of upper triangles, whole ones or those of positions, else zero."""
    information = np.full((len(upper), 3 * d - 3, 3 * d - 3), np.nan)
    sizes = {p * (p + 1) // 2: p for p in (d, 3 * d - 3)}
    for k, numbers in enumerate(upper):
        if p := sizes.get(len(numbers), 0):
            information[k] = 0.0
            a, b = np.triu_indices(p)
            information[k, a, b] = information[k, b, a] = numbers
    if not (abs(information) < FAR).all():
        raise Unreadable("information expected on every measurement, finite and not huge")
    return information


def _with_own_ids(edges: list[Edge]) -> tuple[list[Edge], set[int]]:
    """The edges, where each pose, each point and the world has an id of its own; those of points.

    Points that are numbered apart from poses, as is seen where another node has the number of one,
    follow all other ids, and the world follows the points.
    """
    if all(edge.what == "poses" for edge in edges):
        return edges, set()
    poses = {edge.first for edge in edges if edge.what != "prior"}
    poses |= {e.second for e in edges if e.what in ("poses", "prior") and e.kappa is not None}
    points = {edge.second for edge in edges if edge.what == "sighting"}
    apart, moved_by = {edge.second for edge in edges if edge.what == "apart"}, 0
    if poses & points:
        raise Unreadable(f"node {min(poses & points)} is a pose and a point")
    if apart & (poses | points):
        moved_by = max(0, *poses, *points) + 1
        if min(apart) < 0:
            raise Unreadable(f"numbers of points from 0 expected, not {min(apart)}")
    points |= {k + moved_by for k in apart}
    world = max(poses | points | {edge.second for edge in edges if edge.what == "prior"}) + 1
    for k, edge in enumerate(edges):
        if edge.what == "prior":
            edges[k] = edge._replace(first=world)
        elif edge.what == "apart":
            edges[k] = edge._replace(second=edge.second + moved_by)
    return sorted(edges, key=lambda e: (e.what == "prior", e.what != "poses")), points


def _placing(edges: list[Edge], claim: dict[str, Any]) -> list[Edge]:
    """The position of the world in the first node that it measures, if nothing measures one.

    It may have any weight: whatever else is, the world is there at no cost.
    """
    tau, priors = claim.get("placing"), [edge for edge in edges if edge.what == "prior"]
    if tau is None:
        return []
    if type(tau) is not float or not priors or any(edge.tau is not None for edge in priors):
        raise Unreadable("the world is placed where its attitudes alone are measured")
    d, upper = claim["d"], Numbers()
    if claim.get("cost") is not None:
        upper = tuple(tau * (a == b) for a in range(d) for b in range(a, d))
    return [priors[0]._replace(t=(0.0,) * d, kappa=None, tau=tau, upper=upper)]


def _less(t: Array, origin: Array) -> Array:
    """Positions (k, d) from another origin, if that is exact."""
    moved = t - origin
    (a, b, c), _ = integers(np.stack([t, np.broadcast_to(origin, t.shape), moved]))
    if (a - b != c).any():
        raise Refused("a position from the origin of the proof is not a double")
    return moved


def _edges(text: bytes, claim: dict[str, Any]) -> Iterator[Edge]:
    if _hides(text):
        lines = enumerate(text.replace(b"\r\n", b"\n").split(b"\n"), 1)
        number = next(k for k, line in lines if _hides(line))
        raise Unreadable(f"line {number}: plain text expected, and lines that end in LF or CRLF")
    kinds, used, weigh = set(), set(), partial(weights, mean=cache(harmonic_mean))
    sensors: dict[int, bool] = {0: True}  # without parameters, 0 is the body itself
    more = _SIGHTINGS * claim.get("landmarks", False) + _PRIORS * claim.get("priors", False)
    similar = claim.get("kind") == "similarities"
    for number, line in enumerate(text.removeprefix(_MARK).split(b"\n"), 1):
        said = line.split(b"#")[0]
        words = said.split(None, 1)
        if not words:
            continue
        if not said.isascii():
            raise Unreadable(f"line {number}: plain text expected")
        try:
            if similar and words[0] in (b"VERTEX_SIM3:EXPMAP", b"FIX"):
                continue
            if similar:
                d, edge = 3, _similarity_edge(words, claim, weigh)
            elif words[0] in (b"EDGE_SE3:QUAT", b"EDGE_SE2") and len(words) == 2:
                d = 3 if words[0] == b"EDGE_SE3:QUAT" else 2
                edge = _g2o_edge(words[1], d, claim, weigh)
            elif words[0] in more:
                d = 3 if b"SE3" in words[0] else 2
                edge = _map_edge(words[0], b"".join(words[1:]), d, claim, weigh)
                used.add(edge.sensor)
            elif more and words[0] == b"PARAMS_SE3OFFSET" and claim["d"] == 3:
                sensor, is_here = _sensor(b"".join(words[1:]))
                sensors[sensor] = sensors.get(sensor, True) and is_here
                continue
            elif _IGNORED.fullmatch(words[0]):
                continue
            else:
                d, edge = 3, _1dsfm_edge(said)
        except (ValueError, OverflowError) as error:
            raise Unreadable(f"line {number}: {error}") from None
        kinds.add((d, words[0][:4] in (b"EDGE", b"LAND")))
        if edge.what == "poses" and edge.first == edge.second:
            raise Unreadable(f"line {number}: node {edge.first} is measured from itself")
        yield edge
    for sensor in sorted(used):
        if not sensors.get(sensor, False):
            raise Unreadable(f"sensor {sensor} is not known to be at its body's origin")
    if len(kinds) > 1 or {d for d, _ in kinds} != {claim["d"]}:
        raise Unreadable(f"no graph of {claim['d']}D measurements")


def _hides(text: bytes) -> bool:
    """Whether the text contains control characters, which some programs treat as line breaks."""
    lone = text.count(b"\r") - text.count(b"\r\n")
    return lone > 0 or any(byte < 128 for byte in text.translate(None, _PLAIN))


def _split(text: bytes, *counts: int) -> tuple[list[bytes], list[float]]:
    """The numbers of a line, as they are written and as doubles."""
    words = text.split()
    if len(words) not in counts:
        raise ValueError(f"a measurement of {' or '.join(map(str, counts))} numbers expected")
    try:
        if not text.translate(None, _IN_NUMBERS):
            return words, [*map(float, words)]
    except ValueError:
        pass
    raise ValueError("plain decimal numbers expected")


def _g2o_edge(
    text: bytes,
    d: int,
    claim: dict[str, Any],
    weigh: Callable[[tuple[bytes, ...]], tuple[float, float]],
) -> Edge:
    """``i j x y z qx qy qz qw`` or ``i j x y theta``, with or without information."""
    pose = 9 if d == 3 else 5
    words, numbers = _split(text, pose, pose + (21 if d == 3 else 6))
    t, q = (*numbers[2 : 2 + d],), (*numbers[2 + d : pose],)
    if d == 2 and not abs(q[0]) <= 1e6:
        raise ValueError("an angle beyond 1e6 radians")
    kappa, tau, upper = 1.0, 1.0, Numbers()
    turned, moved = True, True
    if len(words) > pose and 0.0 in (numbers[pose], numbers[-1]):
        turned, moved = _stated(words[pose:], d)
    if claim.get("cost") is not None:
        upper = (*numbers[pose:],)
    elif len(words) > pose and None in (claim["kappa"], claim["tau"]):
        kappa, tau = weigh(_completed(tuple(words[pose:]), turned, moved))
        if claim["rotation_information"] == "quaternion":
            kappa *= 0.25  # half the angle, a quarter of the information
    one = Edge(int(words[0]), int(words[1]), q, t, kappa, tau, upper)
    return one._replace(kappa=kappa if turned else None, tau=tau if moved else None)


def _stated(upper: Sequence[bytes], d: int) -> tuple[bool, bool]:
    """Whether an upper triangle says something of the rotation, and of the translation."""
    whole = np.zeros((3 * d - 3, 3 * d - 3), dtype=bool)
    digits = [word.lower().partition(b"e")[0].strip(b"+-0.") for word in upper]
    whole[np.triu_indices(3 * d - 3)] = [len(left) > 0 for left in digits]
    return bool(whole[:, d:].any()), bool(whole[:d].any())


def _completed(words: tuple[bytes, ...], turned: bool, moved: bool) -> tuple[bytes, ...]:
    """An upper triangle with the identity in place of a block that states nothing."""
    if turned and moved:
        return words
    d = 2 if len(words) == 6 else 3
    free = np.repeat([not moved, not turned], [d, 2 * d - 3])
    places = zip(*np.triu_indices(3 * d - 3), strict=True)
    one = [a == b and free[a] for a, b in places]
    return tuple(b"1" if unit else word for unit, word in zip(one, words, strict=True))


def _similarity_edge(
    words: list[bytes],
    claim: dict[str, Any],
    weigh: Callable[[tuple[bytes, ...]], tuple[float, float]],
) -> Edge:
    """``i j`` and the logarithm of a similarity, with or without its information."""
    if words[0] != b"EDGE_SIM3:EXPMAP":
        raise ValueError("EDGE_SIM3:EXPMAP expected, in a graph of similarities")
    words, numbers = _split(b"".join(words[1:]), 9, 37)
    q, t, scale = similarity((*numbers[2:9],))
    weighed = len(words) > 9 and None in (claim["kappa"], claim["tau"])
    kappa, tau = weigh(tuple(words[9:])) if weighed else (1.0, 1.0)
    return Edge(int(words[0]), int(words[1]), q, t, kappa, tau, scale=scale)


def _fixed(text: bytes) -> set[int]:
    """The ids on lines of nodes to be fixed, of which the smallest one has the scale 1."""
    lines = [line.split(b"#")[0].split() for line in text.removeprefix(_MARK).split(b"\n")]
    words = [word for words in lines if words[:1] == [b"FIX"] for word in words[1:]]
    if not all(re.fullmatch(rb"[+-]?[0-9]+", word) for word in words):
        raise Unreadable("FIX: ids expected")
    return {int(word) for word in words}


#: The arrays of an archive that state its measurements, their types and shapes; those that it may
#: do without; and others that may be there, and have no part in the cost.
_STATED = {
    "kind": ("<U5", ""),
    "version": ("<i8", ""),
    "num_nodes": ("<i8", ""),
    "edges": ("<i8", "m2"),
    "rotations": ("<f8", "mdd"),
    "translations": ("<f8", "md"),
    "scales": ("<f8", "m"),
    "kappa": ("<f8", "m"),
    "tau": ("<f8", "m"),
    "free": ("|b1", "n"),
    "points": ("|b1", "n"),
    "arms": ("<f8", "md"),
    "couplings": ("<f8", "mdd"),
    "information": ("<f8", "cpp"),
    "information_index": ("<i8", "m"),
    "range_edges": ("<i8", "k2"),
    "range_distances": ("<f8", "k"),
    "range_weights": ("<f8", "k"),
}
_OF_RANGES = "range_edges", "range_distances", "range_weights"
_OPTIONAL = {"points", "arms", "couplings", "information", "information_index", "scales", "free"}
_UNUSED = re.compile(
    "ids|name|names|fixed|options|notices|world|origin|assumed|absolute|apart|moved_by|times_ns"
    "|stated|numbers|outliers|camera|information_(residual|about)"
    "|(initial|truth)_(rotations|translations|scales)"
)


def read_archive(data: bytes, claim: dict[str, Any]) -> Graph:
    """The graph in an archive of arrays, `certpgo.io.formats.npz`, as it is.

    Nodes are numbered as there. Rotations are matrices, taken as in `shepperd`. Couplings take the
    place of kappa R_ij in F, whose terms then are 2 d kappa - 2 <N, R_i^T R_j>.
    """
    found, similar = _arrays(data, claim), claim["kind"] == "similarities"
    n = int(found["num_nodes"])
    if (str(found["kind"]), int(found["version"])) != ("graph", 1) or not 0 < n < 1 << 31:
        raise Unreadable("a graph of version 1 expected")
    if similar != ("free" in found) or similar != ("scales" in found):
        raise Unreadable("scales are those of similarities, each with a flag")
    flags = {k: found[k].view(np.uint8) > 0 for k in ("points", "free") if k in found}
    points, free = flags.get("points", np.zeros(n, dtype=bool)), flags.get("free")
    (i, j), names = found["edges"].astype(np.intp).T, ("translations", "kappa", "tau")
    (t, kappa, tau), s, m = (found[name] for name in names), found.get("scales"), len(found["tau"])
    if not (len(i) and 0 <= min(i.min(), j.min()) <= max(i.max(), j.max()) < n and (i != j).all()):
        raise Unreadable(f"measurements between different nodes 0 to {n - 1} expected")
    scaled = points & (np.zeros(n, dtype=bool) if free is None else free)
    if points[i].any() or (points[j] & (kappa != 0.0)).any() or scaled.any():
        raise Unreadable("a point measures nothing, and has neither a rotation nor a scale")
    if ((kappa == 0.0) & (tau == 0.0)).any():
        raise Unreadable("a measurement of nothing: kappa and tau are zero")
    for name, x in (("tau", tau), ("kappa", kappa), ("scales", np.ones(m) if s is None else s)):
        if not ((x > 1.0 / FAR) & (x < FAR) | (x == 0.0) & (name != "scales")).all():
            raise Unreadable(f"{name} must be positive, and neither tiny nor huge")
    N, arms = found.get("couplings"), found.get("arms")
    for values in (t, N, arms):
        if values is not None and not (abs(values) < FAR).all():
            raise Unreadable("a number that is not finite, or huge")
    ranges = _ranges(found, n)
    if similar and not (N is None and arms is None and ranges is None):
        raise Unreadable("similarities have no couplings, arms or distances")
    q = np.array([_of_matrix(matrix) for matrix in found["rotations"]])
    seen = points if points.any() else None
    graph = Graph(n, i, j, rotations(q), t, kappa, tau, N, q, points=seen, scales=s, free=free)
    graph = graph._replace(arms=arms, ranges=ranges, ids=(*range(n),) if not similar else ())
    return graph if claim.get("cost") is None else _informed(graph, found)


def _ranges(found: dict[str, Any], n: int) -> Ranges | None:
    """The distances in an archive; None for none."""
    if "range_edges" not in found or not len(found["range_edges"]):
        return None
    (i, j), d, w = found["range_edges"].astype(np.intp).T, *(found[k] for k in _OF_RANGES[1:])
    if not (0 <= min(i.min(), j.min()) <= max(i.max(), j.max()) < n and (i != j).all()):
        raise Unreadable(f"distances between different nodes 0 to {n - 1} expected")
    if not ((d >= 0.0) & (d < FAR) & (w > 1.0 / FAR) & (w < FAR)).all():
        raise Unreadable("distances from zero, with weights that are neither tiny nor huge")
    return Ranges(i, j, d, w)


def _informed(graph: Graph, found: dict[str, Any]) -> Graph:
    """The graph with the information matrices of an archive."""
    d = graph.t.shape[1]
    p, expected = 3 * d - 3, "information expected on every measurement, finite and not huge"
    if graph.N is not None or not {"information", "information_index"} <= found.keys():
        raise Unreadable(expected)
    index, distinct = found["information_index"], found["information"]
    if distinct.shape[1:] != (p, p) or not 0 <= index.min() <= index.max() < len(distinct):
        raise Unreadable(expected)
    information = distinct[index]
    if not (abs(information) < FAR).all() or (information != _T(information)).any():
        raise Unreadable(f"{expected}, and symmetric")
    unmeasured = information[graph.kappa == 0.0][:, d:], information[graph.tau == 0.0][:, :d]
    if any(rows.any() for rows in unmeasured):
        raise Unreadable("information of what is not measured")
    return graph._replace(information=information)


def _arrays(data: bytes, claim: dict[str, Any]) -> dict[str, Any]:
    """The arrays of an archive that state its measurements, each of its type and shape."""
    options = ("kappa", "tau", "component_sha256", "origin")
    if claim["keep"] != "all" or any(claim.get(name) is not None for name in options):
        raise Unreadable("an archive is read as it is, without options")
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            names = archive.files
            found = {name: np.asarray(archive[name]) for name in _STATED if name in names}
    except Exception:  # damaged archives can raise anything
        raise Unreadable("an archive of arrays expected") from None
    required = _STATED.keys() - _OPTIONAL - {*_OF_RANGES}
    required |= {*_OF_RANGES} if found.keys() & {*_OF_RANGES} else set()
    others = [name for name in names if not (name in _STATED or _UNUSED.fullmatch(name))]
    if len({*names}) < len(names) or others or not required <= found.keys():
        raise Unreadable("other arrays expected, in a graph of poses or similarities")
    sizes: dict[str, int] = {"2": 2, "d": claim["d"]}
    if found["num_nodes"].ndim == 0 and found["num_nodes"].dtype.kind == "i":
        sizes["n"] = int(found["num_nodes"])
    for name, values in found.items():
        dtype, letters = _STATED[name]
        own = zip(letters, values.shape, strict=False)
        shape = tuple(sizes.setdefault(letter, size) for letter, size in own)
        if (values.dtype, values.shape, values.ndim) != (np.dtype(dtype), shape, len(letters)):
            raise Unreadable(f"the array {name!r} must be {dtype} of shape {letters}")
    return found


def _of_matrix(R: Array) -> tuple[float, ...]:
    """A quaternion or half-angle pair of a matrix near a rotation; see `shepperd`."""
    whole = np.eye(3)
    whole[: len(R), : len(R)] = R
    try:
        x, y, z, w = shepperd(tuple(whole.ravel().tolist()))
    except ValueError as error:
        raise Unreadable(str(error)) from None
    return (x, y, z, w) if len(R) == 3 else (w, z)


def _map_edge(
    tag: bytes,
    text: bytes,
    d: int,
    claim: dict[str, Any],
    weigh: Callable[[tuple[bytes, ...]], tuple[float, float]],
) -> Edge:
    """``pose point position``, ``id position`` or ``id pose``; in 3D a sensor after the ids."""
    what = "prior" if tag in _PRIORS else "apart" if tag == b"LANDMARK2" else "sighting"
    ids, whole = (1 if what == "prior" else 2) + (d == 3), tag in _WHOLE
    first = ids + (4 * d - 5 if whole else d)
    words, numbers = _split(text, first, first + (15 * d - 24 if whole else 3 * d - 3))
    sensor = int(words[ids - 1]) if d == 3 else 0
    if whole:
        edge = _g2o_edge(b" ".join([b"-1", words[0], *words[ids:]]), d, claim, weigh)
        return edge._replace(what=what, sensor=sensor)
    tau, upper = 1.0, Numbers()
    if claim.get("cost") is not None:
        upper = (*numbers[first:],)
    elif len(words) > first and claim["tau"] is None:
        tau = harmonic_mean((*words[first:],), 1)
    ends = (-1, int(words[0])) if what == "prior" else (int(words[0]), int(words[1]))
    identity = (0.0, 0.0, 0.0, 1.0) if d == 3 else (0.0,)
    return Edge(*ends, identity, (*numbers[ids:first],), None, tau, upper, what, sensor)


def _sensor(text: bytes) -> tuple[int, bool]:
    """``sensor x y z qx qy qz qw``: its number, and whether it is at its body's origin."""
    words, (_, *zeros, w) = _split(text, 8)
    return int(words[0]), not any(zeros) and 0.0 < abs(w) < FAR


def _1dsfm_edge(text: bytes) -> Edge:
    """``i j``, a matrix R_ij row by row, and an unused direction."""
    words, numbers = _split(text, 14)
    q = shepperd((*numbers[2:11],))
    return Edge(int(words[0]), int(words[1]), q, (0.0, 0.0, 0.0), 1.0, 1.0)


def shepperd(M: tuple[float, ...]) -> tuple[float, ...]:
    """A quaternion of a near-rotation matrix; not normalized, to avoid the square root."""
    A = np.reshape(M, (3, 3))
    if not (np.abs(A).max() < 2.0 and np.abs(A.T @ A - np.eye(3)).max() <= 1e-3 < np.linalg.det(A)):
        raise ValueError("a rotation matrix expected")
    xx, yy, zz = M[0], M[4], M[8]
    x, y, z = M[7] - M[5], M[2] - M[6], M[3] - M[1]
    xy, xz, yz = M[3] + M[1], M[2] + M[6], M[7] + M[5]
    trace = (xx + yy) + zz
    branches = [
        (x, y, z, 1.0 + trace),
        (1.0 + (xx - yy - zz), xy, xz, x),
        (xy, 1.0 + (yy - xx - zz), yz, y),
        (xz, yz, 1.0 + (zz - xx - yy), z),
    ]
    sizes = [trace, xx, yy, zz]
    return branches[sizes.index(max(sizes))]


def similarity(logarithm: tuple[float, ...]) -> tuple[Numbers, Numbers, float]:
    """A quaternion, translation and scale: the exponential of [omega, upsilon, sigma].

    Each number is the sum of a series in integers, rounded once to a double.
    """
    if not all(map(math.isfinite, logarithm)):
        raise ValueError("a number that is not finite")
    if not max(map(abs, logarithm[:3])) <= 10.0 or not abs(logarithm[6]) <= 69.0:
        raise ValueError("turns within 10 radians and logarithms of scales within 69 expected")
    ratios = [x.as_integer_ratio() for x in logarithm]
    a, b, c, *u, s = (_floored(n, SERIES, divisor) for n, divisor in ratios)
    x, y, z = a >> 1, b >> 1, c >> 1
    turning = [[0, -z, y, x], [z, 0, -x, y], [-y, x, 0, z], [-x, -y, -z, 0]]
    growing = [[s, -c, b, u[0]], [c, s, -a, u[1]], [-b, a, s, u[2]], [0, 0, 0, 0]]
    q, t, scale = (_exponential(M) for M in (turning, growing, [[s]]))
    return tuple(q), tuple(t[:3]), scale[0]


def _exponential(M: list[list[int]]) -> list[float]:
    """The last column of exp(M), by its series in units of 2^-SERIES."""
    term = [0] * (len(M) - 1) + [1 << SERIES]
    total, k = term, 0
    while any(x not in (0, -1) for x in term):
        k += 1
        term = [sum(map(operator.mul, row, term)) // (k << SERIES) for row in M]
        total = [x + y for x, y in zip(total, term, strict=True)]
    return [x / (1 << SERIES) for x in total]


def half_angles(theta: Array) -> Array:
    """(m, 2) the doubles nearest to cos(theta/2) and sin(theta/2), by integers in fixed point."""
    pairs, left = np.tile([1.0, 0.0], (len(theta), 1)), np.flatnonzero(theta)
    for bits in (128, 320):
        if not len(left):
            return pairs
        (N, e), exponents = integers(theta[left]), np.frexp(theta[left])[1]
        bits += max(0, -int(exponents.min())) if bits > 128 else 0
        halvings = 8 + max(0, int(exponents.max()))
        x = circle(_floored(N, bits - e - 1 - halvings), bits, halvings)
        ends = [
            np.stack(x, axis=1) + off
            for off in (-(1 << (8 + 2 * halvings)), 1 << (8 + 2 * halvings))
        ]
        low, high = ((end / (1 << bits)).astype(np.float64) for end in ends)
        pairs[left], left = low, left[(low != high).any(axis=1)]
    if len(left):
        raise Unreadable("an angle too close to call")
    return pairs


def circle(x: Any, bits: int, halvings: int) -> tuple[Any, Any]:
    """Cosine and sine of x 2^(halvings - bits) in units of 2^-bits, |x| <= 2^(bits - 9).

    Both are within 2^(7 + 2 halvings), even if x was rounded down: each truncation adds a unit, and
    each doubling at most quadruples the error.
    """
    sums, term, size, k = [0, 0], 1 << bits, 1 << bits, 0
    while size:  # at least the term's, or it is 0 or -1
        sums[k % 2] = sums[k % 2] - term if k & 2 else sums[k % 2] + term
        k += 1
        term, size = (term * x >> bits) // k, (size >> 9) // k
    cosine, sine = sums
    for _ in range(halvings):
        cosine, sine = (cosine * cosine - sine * sine) >> bits, (cosine * sine) >> (bits - 1)
    return cosine, sine


def _turn(angle: Any) -> tuple[Any, Any]:
    """Cosine and sine of an angle of less than 8 radians, all in units of 2^-FINE."""
    return circle(angle >> 12, FINE, 12)


def weights(
    words: tuple[bytes, ...], mean: Callable[[tuple[bytes, ...], int], float]
) -> tuple[float, float]:
    """The weights kappa and tau of an information matrix: its upper triangle, row by row.

    ``mean`` is `harmonic_mean`, or that with a cache.
    """
    if len(words) == 6:
        return mean(words[5:], 1), mean((words[0], words[1], words[3]), 1)
    if len(words) == 28:  # of similarities: rotation, translation, scale
        turned, (a, b, c, _, _, _, _, d, e, _, _, _, _, f) = words[18:], words[:14]
        return mean((a, b, c, d, e, f), 2), mean((*turned[:3], *turned[4:6], turned[7]), 1)
    return mean(words[15:], 2), mean((*words[:3], *words[6:8], words[11]), 1)


def harmonic_mean(words: tuple[bytes, ...], halves: int) -> float:
    """The number size / tr(A^-1) / halves of an upper triangle in decimals, rounded once."""
    upper, powers = [], []
    for word in words:
        whole, _, fraction = word.partition(b".")
        try:
            value, power = int(whole + fraction), 0
        except ValueError:
            mantissa, mark, after = word.lower().partition(b"e")
            whole, _, fraction = mantissa.partition(b".")
            if (fraction and not fraction.isdigit()) or (mark and not after):
                raise ValueError("information must be decimal numbers") from None
            value, power = int(whole + fraction), int(after or 0)
        upper.append(value)
        powers.append(power - len(fraction))
    lowest, highest = min(powers), max(powers)
    if not -400 <= lowest <= highest <= 400:
        raise ValueError("an information number out of range")
    if lowest < highest:
        upper = [x * 10 ** (power - lowest) for x, power in zip(upper, powers, strict=True)]
    if len(upper) == 1:
        minors, above, below = [upper[0]], upper[0], 1
    elif len(upper) == 3:
        a, b, c = upper
        minors, above, below = [a, a * c - b * b], 2 * (a * c - b * b), a + c
    else:
        a, b, c, p, q, r = upper
        xx, yy, zz = p * r - q * q, a * r - c * c, a * p - b * b
        determinant = a * xx - b * (b * r - c * q) + c * (b * q - c * p)
        minors, above, below = [a, zz, determinant], 3 * determinant, xx + yy + zz
    if min(minors) <= 0:
        raise ValueError("information that is not positive definite")
    return float(above * 10 ** max(lowest, 0) / (below * halves * 10 ** max(-lowest, 0)))


# --- The proof ------------------------------------------------------------------------------------


class EdgeBounds(NamedTuple):
    """Claims f_e >= tau |v - b|^2 + 2 d kappa - 2 <N, Q> + constant; see `minorants_hold`."""

    tau: Array  # (m,)
    arms: Array  # (m, d): b
    kappa: Array  # (m,)
    couplings: Array  # (m, d, d): N
    touching: Array  # (m, 1): an angle; or (m, 5): a quaternion w x y z, and a slope
    constants: Array  # (m,)


class Rejections(NamedTuple):
    """Claims min(f_e, c) >= c - kappa |Q - C|^2 - tau |v - b|^2; see `rejections_hold`.

    Where graphs have couplings, min(f_e, c) >= k - 2 <N, Q> - tau |v - b|^2, with k in place of
    kappa and N in place of C; see `coupled_rejections_hold`.
    """

    rejected: Ints  # (k,) numbers of measurements, ascending
    prices: Array  # (k,): c
    kappa: Array  # (k,) not negative, as tau
    centres: Array  # (k, d, d): C, to be rounded down to multiples of 2^-POINT
    tau: Array  # (k,)
    arms: Array  # (k, d): b


class Within(NamedTuple):
    """How far a node is from where x has it, in any estimate that costs at most the upper bound.

    Seen from the reference: both are compared in the frame of that pose.
    """

    node: int | None  # by its id; None: every node
    metres: float | None  # None: nothing is said
    degrees: float | None  # points have none
    reference: int | None  # the pinned pose, by its id; None: the world

    def __str__(self) -> str:
        far = [(self.metres, "m"), (self.degrees, "degrees")]
        said = " and ".join(f"{Decimal(str(x))} {unit}" for x, unit in far if x is not None)
        node = "every node" if self.node is None else called(self.node)
        return f"within {said} of every optimum: {node}, seen from {called(self.reference)}"


def called(node: int | None) -> str:
    """A node by its id, which the world has none of."""
    return "the world" if node is None else f"node {node}"


class Proof(NamedTuple):
    """The content of a proof file; none of it is trusted."""

    q: Array  # (n, 4) or (n, 2): the estimate's rotations
    t: Array | None  # (n, d): its translations; None for rotations alone
    multipliers: Array  # (n, d(d+1)/2): upper triangles of Lam, row by row
    order: Ints  # (n,) elimination order of the nodes
    delta: Array  # (n b,) subtracted from the diagonal before factorizing
    pin: int  # the pose whose translation is pinned
    exponent: int  # base-2 exponent of the translations' weights in row sums
    minorants: EdgeBounds | None = None  # for the cost of g2o
    rejections: Rejections | None = None  # for a truncated cost
    s: Array | None = None  # (n,): the estimate's scales, of similarities
    tangents: Array | None = None  # (k, 2): see `with_tangents`


_OPTIONS: dict[str, tuple[Any, ...]] = {
    "kind": ("poses", "rotations", "similarities"),
    "d": (2, 3),
    "keep": ("all", "first", "last"),
    "rotation_information": ("tangent", "quaternion", "rpy"),
}


def read_claim(archive: Any) -> dict[str, Any]:
    """The header of a proof: its graph file, reading options and cost."""
    claim = json.loads(bytes(archive["claim"]))
    kinds = (1, None), (2, "g2o"), (3, None), (4, None)
    if claim["format"] != "certpgo proof" or (claim["version"], claim.get("cost")) not in kinds:
        raise Unreadable("not a proof of version 1, or of version 2 about the cost of g2o, 3 or 4")
    if any(type(claim[name]) is not int for name in ("version", "d", "pin", "exponent")):
        raise Unreadable("integers expected")
    for name, choices in _OPTIONS.items():
        if claim[name] not in choices:
            raise Unreadable(f"{name} must be one of {choices}")
    if claim["d"] == 2 and claim["rotation_information"] == "quaternion":
        raise Unreadable("in the plane, rotational information is about the angle")
    for name in ("kappa", "tau"):
        if claim[name] is not None and type(claim[name]) not in (int, float):
            raise Unreadable(f"{name} must be a number")
    meant = ["poses", "tangent" if claim["d"] == 2 else "quaternion", None, None]
    said = [claim[name] for name in ("kind", "rotation_information", "kappa", "tau")]
    if claim["version"] == 2 and said != meant:
        raise Unreadable(f"the cost of g2o is about {meant[0]}, with information of a {meant[1]}")
    if (claim["version"] == 4) != (claim["kind"] == "similarities"):
        raise Unreadable("proofs of version 4 are those about similarities")
    if claim["version"] == 4 and claim["rotation_information"] != "tangent":
        raise Unreadable("the information of similarities is about logarithms, tangents")
    _check_map(claim)
    _check_within(claim)
    return dict(claim)


def _check_within(claim: dict[str, Any]) -> None:
    """Claims of distances are numbers of metres, degrees, or both, of a node or of all."""
    for one in claim.get("within", []):
        node, metres, degrees = (one[name] for name in ("node", "metres", "degrees"))
        known = [x for x in (metres, degrees) if x is not None]
        if not known or any(type(x) not in (int, float) or not 0.0 < x < FAR for x in known):
            raise Unreadable("claims of distances are positive numbers of metres or degrees")
        if (node is not None and type(node) is not int) or (degrees or 1.0) > 180.0:
            raise Unreadable("nodes are named by ids, and angles are of 180 degrees at most")
        if claim["version"] == 4 or (claim["kind"] == "rotations" and metres is not None):
            raise Unreadable("no distances are claimed of similarities, nor metres of rotations")


def _check_map(claim: dict[str, Any]) -> None:
    """Which other lines are read: ``landmarks`` and ``priors``, and ``origin`` of the latter."""
    landmarks, priors = (claim.get(name, False) for name in ("landmarks", "priors"))
    if type(landmarks) is not bool or type(priors) is not bool:
        raise Unreadable("landmarks and priors are true or false")
    if (landmarks or priors) and (claim["kind"], claim["component_sha256"]) != ("poses", None):
        raise Unreadable("landmarks and priors are for poses, all of a file's")
    if claim["kind"] == "similarities" and claim["component_sha256"] is not None:
        raise Unreadable("a proof is about all similarities of a file")
    origin = claim.get("origin")
    if origin is not None and not (priors and [*map(type, origin)] == [float] * claim["d"]):
        raise Unreadable("an origin is a list of d numbers, for priors")


def read_proof(archive: Any, claim: dict[str, Any], n: int, m: int = 0, ranges: int = 0) -> Proof:
    """The arrays of a proof about n nodes, m measurements and some distances."""
    d, poses = claim["d"], claim["kind"] != "rotations"
    b = d + 1 if poses else d

    def array(name: str, dtype: str, *shape: int) -> Any:
        values = archive[name]
        if values.dtype != np.dtype(dtype) or values.shape != shape:
            raise Refused(f"{name} must be {dtype} of shape {shape}: another graph's proof?")
        if not np.isfinite(values).all():
            raise Refused(f"{name} holds numbers that are not finite")
        return values

    minorants = None
    if claim.get("cost") is not None:
        minorants = EdgeBounds(
            array("tau", "<f8", m),
            array("arms", "<f8", m, d),
            array("kappa", "<f8", m),
            array("couplings", "<f8", m, d, d),
            array("touching", "<f8", m, 1 if d == 2 else 5),
            array("constants", "<f8", m),
        )
    rejections, k = None, len(archive["rejected"]) if claim["version"] == 3 else 0
    if claim["version"] == 3:
        rows = array("rejections", "<f8", k, 2 + d * d + (1 + d) * poses)
        rejections = Rejections(
            rejected=array("rejected", "<i4", k).astype(np.intp),
            prices=rows[:, 0],
            kappa=rows[:, 1],
            centres=rows[:, 2 : 2 + d * d].reshape(k, d, d),
            tau=rows[:, 2 + d * d] if poses else np.zeros(k),
            arms=rows[:, 3 + d * d :] if poses else np.zeros((k, d)),
        )
        chosen = np.r_[-1, rejections.rejected, m]
        if not (0 < k < m and (chosen[:-1] < chosen[1:]).all()):
            raise Refused("rejected measurements must be given by ascending numbers, and not all")
    proof = Proof(
        q=array("rotations", "<f8", n, 4 if d == 3 else 2),
        t=array("translations", "<f8", n, d) if poses else None,
        multipliers=array("multipliers", "<f8", n, d * (d + 1) // 2),
        order=array("order", "<i4", n).astype(np.intp),
        delta=array("delta", "<f4", n * b).astype(np.float64),
        pin=claim["pin"],
        exponent=claim["exponent"],
        minorants=minorants,
        rejections=rejections,
        s=array("scales", "<f8", n) if claim["kind"] == "similarities" else None,
        tangents=array("tangents", "<f8", ranges, 2) if ranges else None,
    )
    if not np.array_equal(np.sort(proof.order), np.arange(n)):
        raise Refused("order is no permutation")
    if not (0 <= proof.pin < n and abs(proof.exponent) <= 300):
        raise Refused("pin or exponent out of range")
    return proof


# --- The upper bound ------------------------------------------------------------------------------


def upper_bound(
    graph: Graph, q: Array, t: Array | None, cut: Rejections | None = None, s: Array | None = None
) -> float:
    """A double not below F(x), computed in integers; terms of rejected ones are cut off.

    Of similarities s R, it is a double not below their cost, in units of the known scales, or of
    the root mean square scale.
    """
    i, j, (m, d) = graph.i, graph.j, graph.t.shape
    own, step, e, f = np.ones(graph.n, object), np.ones(m, object), 0, 0
    if graph.scales is not None and s is not None:
        _refuse_scales(graph, s)
        (own, e), (step, f) = _in_fractions(s), _in_fractions(graph.scales)
    N, D = exact_rotations(q)
    if graph.N is None:
        (pairs, _), (measured, _), (kappa, unit) = map(integers, (q, graph.q, graph.kappa))
        # With the scales a of A_j and g of s_ij A_i, |A_j - s_ij A_i R_ij|^2 is d (a - g)^2 plus
        # 8 a g sin^2 of half the angle between them, whose cosine is that of quaternions.
        cosine = (_between(pairs[i], pairs[j]) * measured).sum(axis=1)
        norm = D[i] * D[j] * (measured * measured).sum(axis=1)
        a, g = own[j] << f, own[i] * step
        turned = kappa * (8 * a * g * (norm - cosine * cosine) + d * (a - g) ** 2 * norm)
    else:
        stated, unit = integers(np.c_[graph.N.reshape(m, d * d), graph.kappa])
        between, norm = np.swapaxes(N[i], 1, 2) @ N[j], D[i] * D[j]
        along = (stated[:, :-1].reshape(m, d, d) * between).sum(axis=(1, 2))
        turned = 2 * (d * stated[:, -1] * norm - along)
    terms, unit = -_floored(-turned, FINE - 2 * (e + f), norm), unit + FINE
    if t is not None:
        arms = np.zeros((0, d)) if graph.arms is None else graph.arms
        at, exponent = integers(np.concatenate([t, graph.t, arms]))
        (tau, f), scale = integers(graph.tau), D[i]
        apart = (D[i] << e)[:, None] * (at[j] - at[i])
        apart -= own[i][:, None] * (N[i] * at[graph.n : graph.n + m, None, :]).sum(axis=2)
        if graph.arms is not None:
            moved = (D[i] * own[j])[:, None] * (N[j] * at[graph.n + m :, None, :]).sum(axis=2)
            apart, scale = D[j][:, None] * apart + moved, D[i] * D[j]
        squares = tau * (apart * apart).sum(axis=1)
        others, f = -_floored(-squares, FINE - 2 * (exponent + e), scale**2), f + FINE
        terms, unit = (terms << max(f - unit, 0)) + (others << max(unit - f, 0)), max(unit, f)
    if cut is not None:
        prices, f = integers(cut.prices)
        terms, prices, unit = terms << max(f - unit, 0), prices << max(unit - f, 0), max(unit, f)
        terms[cut.rejected] = np.minimum(terms[cut.rejected], prices)
    if not graph.in_mean_unit:
        return _rounded_up(terms.sum(), unit)
    squares = own[graph.poses] ** 2
    return _rounded_up((terms.sum() * len(squares)) << (2 * e), unit, squares.sum())


def _refuse_scales(graph: Graph, s: Array) -> None:
    """Refuse an estimate whose scales (n,) are not positive, or not those that are known."""
    if not (s > 0.0).all():
        raise Refused("a scale is not positive")
    if graph.free is not None and (s[~graph.free & graph.poses] != 1.0).any():
        raise Refused("a scale that is known to be 1 is another one")


def _rounded_up(n: int, e: int, divisor: int = 1) -> float:
    """A double not below n 2^-e / divisor; the divisor is positive."""
    return math.nextafter((n << max(-e, 0)) / (divisor << max(e, 0)), math.inf)


# --- The cost of g2o ------------------------------------------------------------------------------


def g2o_cost(graph: Graph, q: Array, t: Any) -> float:
    """A double not below f(x) = sum e^T Omega e, computed in integers.

    e = (y, x) with y = R_ij^T (R_i^T (t_j - t_i) - t_ij), and x the angle of E = R_ij^T R_i^T R_j,
    or the vector part of its unit quaternion (w, x) with w >= 0.
    """
    d, n = graph.t.shape[1], graph.n
    (N, D), (M, C) = exact_rotations(q), exact_rotations(graph.q)
    arms = np.zeros((0, d)) if graph.arms is None else graph.arms
    both, e = integers(np.concatenate([t, graph.t, arms]))
    (at, step, arm), scale = np.split(both, [n, n + len(graph.t)]), D[graph.i]
    apart = at[graph.j] - at[graph.i]
    if graph.arms is not None:
        apart = D[graph.j][:, None] * apart + np.einsum("mab,mb->ma", N[graph.j], arm)
        scale = scale * D[graph.j]
    moved = np.einsum("mab,ma->mb", N[graph.i], apart)
    moved = np.einsum("mab,ma->mb", M, moved - scale[:, None] * step)
    y = _floored(moved, POINT - e, (scale * C)[:, None])
    pairs, measured = integers(q)[0], integers(graph.q)[0]
    between = _between(measured, _between(pairs[graph.i], pairs[graph.j]))
    x, either = _angles(between) if d == 2 else _vector_parts(between)
    Omega, unit = integers(graph.information)
    cross = (y[:, None, :] @ Omega[:, :d, d:] @ x[:, :, None])[:, 0, 0]
    x[either & (cross < 0)] *= -1  # f takes both values there
    r, off = np.concatenate([y, x], axis=1), 2  # within off
    total = (r[:, None, :] @ Omega @ r[:, :, None]).sum()
    sizes = abs(graph.information).sum(axis=1) * (abs(r).astype(np.float64) + off)
    more, k = float(2.0 * SPARE * off * sizes.sum()).as_integer_ratio()
    total += (more << max(unit, 0)) // k + 1
    return _rounded_up(total, unit + 2 * POINT)


def _between(a: Any, b: Any) -> Any:
    """The products of a's conjugates with b: those of R(a)^T R(b)."""
    if a.shape[1] == 2:
        (c, s), (cb, sb) = a.T, b.T
        return np.stack([c * cb + s * sb, c * sb - s * cb], axis=1)
    (x, y, z, w), (p, q, r, v) = a.T, b.T
    parts = [w * p - v * x - y * r + z * q, w * q - v * y - z * p + x * r]
    parts += [w * r - v * z - x * q + y * p, w * v + x * p + y * q + z * r]
    return np.stack(parts, axis=1)


def _vector_parts(q: Any) -> tuple[Any, Bools]:
    """(m, 3) x of unit quaternions (w, x), w >= 0, in units of 2^-POINT, within 2; where w = 0."""
    norm = (q * q).sum(axis=1)
    root = np.frompyfunc(math.isqrt, 1, 1)(norm << (2 * POINT))
    x = np.where(q[:, 3:] < 0, -q[:, :3], q[:, :3])
    return (x << (2 * POINT)) // root[:, None], q[:, 3] == 0


def _angles(pairs: Any) -> tuple[Any, Bools]:
    """(m, 1) angles in units of 2^-POINT, within 2, of half-angle pairs; which are pi or -pi.

    They are guesses, and what turning back by them leaves.
    """
    c, s = pairs.T
    cosine, sine, norm = c * c - s * s, 2 * c * s, c * c + s * s
    x, y = ((part / norm).astype(np.float64) for part in (cosine, abs(sine)))
    guess = _big(np.ldexp(np.arctan2(y, x), 60)) << (FINE - 60)
    c, s = _turn(guess)
    left, ahead = (abs(sine) * c - cosine * s) // norm, (cosine * c + abs(sine) * s) // norm
    found = (guess >= 0) & (guess < 4 << FINE) & (abs(left) < 1 << (FINE - 40))
    if not (found & (ahead > 1 << (FINE - 1))).all():
        raise Refused("an angle was not found")
    angles = (guess + left + left**3 // (6 << (2 * FINE))) >> (FINE - POINT)
    return (angles * np.where(sine < 0, -1, 1))[:, None], (sine == 0) & (cosine < 0)


def _definite(A: Any) -> Bools:
    """(m,) which symmetric matrices (m, k, k) of integers are positive definite."""
    definite = _well_definite(A)
    left, places = A[~definite], np.flatnonzero(~definite)
    while len(left) and left.shape[1]:  # Gaussian elimination without fractions
        pivot = left[:, :1, :1]
        places, pivot, left = (x[pivot[:, 0, 0] > 0] for x in (places, pivot, left))
        left = pivot * left[:, 1:, 1:] - left[:, 1:, :1] * left[:, :1, 1:]
    definite[places] = True
    return definite


def _well_definite(A: Any) -> Bools:
    """(m,) which of these matrices, k < 8, are found to be positive definite by doubles.

    With about 1 on the diagonal, A - C C^T exceeds what rounds in it.
    """
    try:
        A = A.astype(np.float64)
        scales = -(np.frexp(np.maximum(np.einsum("maa->ma", A), 0.0))[1] >> 1)
        A = np.ldexp(A, scales[:, :, None] + scales[:, None, :])
        C = np.linalg.cholesky(A - 2.0**-30 * np.eye(A.shape[1]))
    except (np.linalg.LinAlgError, OverflowError):
        return np.zeros(len(A), dtype=bool)
    E = A - C @ np.swapaxes(C, 1, 2)
    own = np.einsum("maa->ma", E)
    dominant = own - (abs(E).sum(axis=2) - abs(own)) > 2.0**-36
    small = (abs(C).max(axis=2) < 4.0) & (abs(A).max(axis=2) < 4.0)
    return np.asarray((dominant & small).all(axis=1))


def surrogate(graph: Graph, given: EdgeBounds) -> Graph:
    """The graph whose F is the sum of the minorants without their constants."""
    return graph._replace(t=given.arms, kappa=given.kappa, tau=given.tau, N=given.couplings)


def minorants_hold(graph: Graph, given: EdgeBounds) -> Bools:
    """(m,) which minorants are proven to be nowhere above terms of f that are never negative.

    With v = R_i^T (t_j - t_i) and Q = R_i^T R_j. The minimum over y of e^T Omega e - tau |y - y'|^2
    is x^T S x + 2 beta.x + gamma, fractions of integers, rounded down to multiples of 2^-unit.
    Terms of positions alone are completed by a multiple of |x|^2, which is zero for some Q, and
    those of rotations alone by one of |y|^2, which is zero for some v.
    """
    (m, d), p = graph.t.shape, graph.information.shape[1]
    alone, still = graph.kappa == 0.0, graph.tau == 0.0
    full, e = integers(np.c_[graph.information.reshape(m, p * p), given.tau])
    Omega, tau = full[:, :-1].reshape(m, p, p), full[:, -1, None, None]
    Omega[alone, d:, d:] = Omega[alone, :1, :1] * np.eye(p - d, dtype=int)
    Omega[still, :d, :d] = Omega[still, d : d + 1, d : d + 1] * np.eye(d, dtype=int)
    T, P, W = Omega[:, :d, :d], Omega[:, :d, d:], Omega[:, d:, d:]
    A = T - tau * np.eye(d, dtype=int)
    inverse = _adjugate(A)
    det = (A[:, :1] @ inverse[:, :, :1])[:, 0, 0]
    definite = _definite(Omega)
    same = definite & alone & (given.arms == graph.t).all(axis=1) & (given.constants <= 0.0)
    same &= ~A.any(axis=(1, 2))
    fits = definite & _definite(A)
    det = np.where(fits, det, 1)
    R, norm = exact_rotations(graph.q)
    (b, t), et = integers(np.stack([given.arms, graph.t]))
    RT, PT = np.swapaxes(R, 1, 2), np.swapaxes(P, 1, 2)
    y = RT @ (b - t)[:, :, None]
    yT = np.swapaxes(y, 1, 2)
    S = det[:, None, None] * W - PT @ inverse @ P
    beta = -(tau * (PT @ inverse @ y))[:, :, 0]
    gamma = -(tau * (det[:, None, None] * (yT @ y) + tau * (yT @ inverse @ y)))[:, 0, 0]

    unit = POINT - math.frexp(float(abs(graph.information).max()))[1]
    unturned = ~(alone & ((given.kappa != 0.0) | given.couplings.any(axis=(1, 2))))
    unturned &= ~still | (given.tau == 0.0)
    (kappa, constant), ec = integers(np.stack([given.kappa, given.constants]))
    wanted = -_floored(-2 * d * kappa - constant, unit - ec)
    N, en = integers(given.couplings)
    N = _floored(RT @ N, unit - en, norm[:, None, None])
    if d == 3:
        wanted -= _floored(gamma, unit - e - 2 * et, det * norm**2)
        S = _floored(S, unit - e, det[:, None, None])
        linear = _floored(2 * beta, unit - e - et, (det * norm)[:, None])
        fits &= _spatial_hold(S, linear, N, given.touching, wanted, unit)
        return np.asarray((same | fits) & unturned)
    S, beta = S[:, 0, 0], beta[:, 0]
    fits &= S > 0
    S = np.where(fits, S, 1)
    # s x^2 + 2 beta x + gamma = s (x + beta / s)^2 + gamma - beta^2 / s
    wanted -= _floored(gamma * S - beta**2, unit - e - 2 * et, S * det * norm**2)
    s, turned = _floored(S, unit - e, det), _floored(beta, FINE - et, S * norm)
    (alpha, ea), u, v = integers(given.touching), N[:, 0, 0] + N[:, 1, 1], N[:, 1, 0] - N[:, 0, 1]
    fits &= _planar_hold(s, turned, u, v, _floored(alpha[:, 0], FINE - ea), wanted)
    return np.asarray((same | fits) & unturned)


def _adjugate(A: Any) -> Any:
    """Adjugates of symmetric matrices (m, d, d)."""
    if A.shape[1] == 2:
        entries = [A[:, 1, 1], -A[:, 0, 1], -A[:, 0, 1], A[:, 0, 0]]
        return np.stack(entries, axis=1).reshape(-1, 2, 2)
    (a, b, c), (_, p, q), (_, _, r) = (A[:, k].T for k in range(3))
    xy, xz, yz = c * q - b * r, b * q - c * p, b * c - a * q
    entries = [p * r - q * q, xy, xz, xy, a * r - c * c, yz, xz, yz, a * p - b * b]
    return np.stack(entries, axis=1).reshape(-1, 3, 3)


def _planar_hold(s: Any, h: Any, u: Any, v: Any, alpha: Any, wanted: Any) -> Bools:
    """Whether s (x + h)^2 + 2 u cos(x) + 2 v sin(x) >= wanted for all x, and s, u, v a little more.

    With phi = x + h, the cosine and sine of x are those of phi turned back: the sum is that of
    s phi^2, 2 a cos(phi) and 2 b sin(phi). And phi^2 >= alpha^2 + 2 r (cos(alpha) - cos(phi)) with
    r = alpha / sin(alpha), as phi^2 is convex in cos(phi) up to pi.
    """
    fits = (abs(h) < 8 << FINE) & (alpha >= 0) & (alpha < 4 << FINE)
    fits &= np.maximum(np.maximum(s, abs(u)), abs(v)) < 1 << 200
    s, h, u, v, alpha = (np.where(fits, x, 0) for x in (s, h, u, v, alpha))
    (c, n), (cosine, sine) = _turn(h), _turn(alpha)
    a, b = (u * c - v * n) >> FINE, (u * n + v * c) >> FINE
    fits &= (alpha == 0) | (sine > OFF)
    turned = fits & (alpha != 0)
    sine = np.where(turned, sine, 2 * OFF)
    r = [(alpha << FINE) // (sine + OFF), (alpha << FINE) // (sine - OFF) + 1]
    low, high = (np.where(turned, x, 1 << FINE) for x in r)
    sr = s * low >> FINE, ((s + 1) * high >> FINE) + 1
    fits &= sr[1] < 1 << 220
    least = np.minimum(*(2 * (p * cosine >> FINE) - 2 * abs(a - p) for p in sr))  # concave in p
    lowest = (s * alpha**2 >> (2 * FINE)) + least - 2 * abs(b) - 24
    return np.asarray(fits & (lowest >= wanted))


def _spatial_hold(S: Any, linear: Any, N: Any, touching: Array, wanted: Any, unit: int) -> Bools:
    """(m,) whether x^T S x + l.x + 2 <N, E> >= wanted for all unit quaternions (w, x), w >= 0.

    Numbers are in units of 2^-unit; S, l and N may be a unit more in each entry. With w0 >= 0,
    |q0| <= 1 and k >= |k x0 + l|, l.x >= (q.q0) (l.x) - k + k (q.q0)^2: a quadratic form in q.
    """
    (q0, e), (k, ek), bits = integers(touching[:, :4]), integers(touching[:, 4]), 64
    q0, k = _floored(q0, bits - e), _floored(k, unit - ek)
    needed = k[:, None] * q0[:, 1:] + (linear << bits)
    fits = (q0[:, 0] >= 0) & ((q0 * q0).sum(axis=1) <= 1 << (2 * bits)) & (k >= 0)
    fits &= (needed * needed).sum(axis=1) <= (k << bits) ** 2
    trace = N[:, 0, 0] + N[:, 1, 1] + N[:, 2, 2]
    form = np.zeros((len(S), 4, 4), dtype=object)
    form[:, 0, 0] = 2 * trace
    form[:, 0, 1:] = 2 * (N[:, [2, 0, 1], [1, 2, 0]] - N[:, [1, 2, 0], [2, 0, 1]])
    form[:, 1:, 0] = form[:, 0, 1:]
    eye = np.eye(4, dtype=int)
    form[:, 1:, 1:] = S + 2 * (N + np.swapaxes(N, 1, 2) - trace[:, None, None] * eye[1:, 1:])
    form -= (wanted + k + 28)[:, None, None] * eye
    form += (k[:, None, None] * q0[:, :, None] * q0[:, None, :]) >> (2 * bits)
    half = (q0[:, :, None] * linear[:, None, :]) >> (bits + 1)
    form[:, :, 1:] += half
    form[:, 1:, :] += np.swapaxes(half, 1, 2)
    return np.asarray(fits & _definite(form))


# --- Rejected measurements ------------------------------------------------------------------------


def rejections_hold(graph: Graph, given: Rejections) -> Bools:
    """(k,) which prices are reached: (kappa || beta_R) p_R^2 + (tau || beta_t) p_t^2 >= c > 0.

    Here a || b = a b / (a + b), and p_R and p_t are how far C and b are from the measurement; with
    weights beta. Then c - beta_R |Q - C|^2 - beta_t |v - b|^2 is nowhere above min(f_e, c).
    """
    e, count = given.rejected, len(given.rejected)
    weights = [given.prices, given.kappa, given.tau, graph.kappa[e], graph.tau[e]]
    c, turn, move, kappa, tau = integers(np.stack(weights))[0]
    # Measured rotations are less than a unit above their integers.
    apart = np.maximum(abs(_centres(given) - graph.R[e]) - 1, 0).reshape(count, -1)
    (b, t), unit = integers(np.stack([given.arms, graph.t[e]]))
    steps, unit = (b - t) << max(-unit, 0), max(unit, 0)
    turning, moving = (np.where(both == 0, 1, both) for both in (turn + kappa, move + tau))
    reached = (turn * kappa * moving * (apart * apart).sum(axis=1)) << (2 * unit)
    reached += (move * tau * turning * (steps * steps).sum(axis=1)) << (2 * POINT)
    signs = (c > 0) & (turn >= 0) & (move >= 0)
    return np.asarray(signs & (reached >= (c * turning * moving) << (2 * POINT + 2 * unit)))


def coupled_rejections_hold(graph: Graph, given: Rejections) -> Bools:
    """(k,) which claims are nowhere above the price, nor above terms 2 d kappa - 2 <N_e, Q> + ...

    The least of tau_e |v - t|^2 + tau |v - b|^2 over v is (tau_e || tau) |b - t|^2, as above. What
    is left is linear in Q.
    """
    e, count, d = given.rejected, len(given.rejected), graph.t.shape[1]
    sizes = [given.prices, given.kappa, graph.kappa[e], graph.tau[e], given.tau]
    numbers, _ = integers(np.concatenate([*sizes, given.centres.ravel(), graph.N[e].ravel()]))
    c, k, kappa, tau, move = np.split(numbers[: 5 * count], 5)
    N, own = np.split(numbers[5 * count :].reshape(2 * count, d, d), 2)
    (b, t), es = integers(np.stack([given.arms, graph.t[e]]))
    both = np.where(tau + move == 0, 1, tau + move)
    squares = ((b - t) * (b - t)).sum(axis=1)
    between = _floored(tau * move * squares, -2 * es, both)
    fits = _linear_hold(N, k - c) & _linear_hold(N - own, k - 2 * d * kappa - between)
    return np.asarray(fits & (c > 0) & (move >= 0))


def _linear_hold(N: Any, wanted: Any) -> Bools:
    """(k,) whether 2 <N, Q> >= wanted for all rotations Q, of integers in one unit.

    In the plane <N, Q> = u cos + v sin; in space it is a quadratic form of unit quaternions.
    """
    if N.shape[1] == 2:
        u, v = N[:, 0, 0] + N[:, 1, 1], N[:, 1, 0] - N[:, 0, 1]
        return np.asarray((wanted <= 0) & (wanted * wanted >= 4 * (u * u + v * v)))
    shift, none = 1 << 64, np.zeros_like(N)  # what rounds there is below 2^-58 units
    touching = np.tile([1.0, 0.0, 0.0, 0.0, 0.0], (len(N), 1))
    return _spatial_hold(none, none[:, 0], N * shift, touching, wanted * shift, 0)


def _centres(given: Rejections) -> Any:
    """Integers (k, d, d): C in units of 2^-POINT, rounded down."""
    C, e = integers(given.centres)
    return _floored(C, POINT - e)


def truncated(graph: Graph, given: Rejections) -> tuple[Graph, Array]:
    """The graph with edges of negative weight, and constants (k,): below the truncated cost.

    kappa |Q - C|^2 is kappa (d + |C|^2) less the coupling, of which 2 d kappa are on the diagonal.
    A measurement without weights is nowhere below zero, and its price does not count.
    """
    if graph.N is not None:
        return _truncated_couplings(graph, graph.N, given)
    e, C, d = given.rejected, _centres(given), graph.t.shape[1]
    used = (given.kappa != 0.0) | (given.tau != 0.0)
    if not (rejections_hold(graph, given) | (~used & (given.prices > 0.0))).all():
        raise Refused("a rejected measurement was not proven to reach its price")
    (prices, kappa), unit = integers(np.stack([given.prices, given.kappa]))
    less = (C * C).reshape(len(e), -1).sum(axis=1) - (d << (2 * POINT))
    constants = [-_rounded_up(n, unit + 2 * POINT) for n in kappa * less - (prices << (2 * POINT))]
    R, t, weights = graph.R.copy(), graph.t.copy(), [graph.kappa.copy(), graph.tau.copy()]
    R[e], t[e], weights[0][e], weights[1][e] = C, given.arms, -given.kappa, -given.tau
    below = graph._replace(R=R, t=t, kappa=weights[0], tau=weights[1])
    return below, np.where(used, constants, 0.0)


def _truncated_couplings(graph: Graph, couplings: Array, given: Rejections) -> tuple[Graph, Array]:
    """The same of a graph with couplings."""
    e, used = given.rejected, given.centres.any(axis=(1, 2)) | (given.tau != 0.0)
    if not (coupled_rejections_hold(graph, given) | (~used & (given.prices > 0.0))).all():
        raise Refused("a rejected measurement was not proven to reach its price")
    N, t, weights = couplings.copy(), graph.t.copy(), [graph.kappa.copy(), graph.tau.copy()]
    N[e], t[e], weights[0][e], weights[1][e] = given.centres, given.arms, 0.0, -given.tau
    below = graph._replace(N=N, t=t, kappa=weights[0], tau=weights[1])
    return below, np.where(used, given.kappa, 0.0)


# --- Measured distances ---------------------------------------------------------------------------


def ranges_cost(ranges: Ranges, t: Array) -> float:
    """A double not below sum w (d - |t_j - t_i|)^2, computed in integers.

    With s = |t_j - t_i|^2, terms are w (d^2 + s - 2 d s^(1/2)).
    """
    both, e = integers(np.r_[t.ravel(), ranges.distances])
    at, d = both[: t.size].reshape(t.shape), both[t.size :]
    w, f = integers(ranges.weights)
    s = ((at[ranges.j] - at[ranges.i]) ** 2).sum(axis=1)
    root = np.frompyfunc(math.isqrt, 1, 1)(s << (2 * FINE))  # not above s^(1/2)
    return _rounded_up((w * (((d * d + s) << FINE) - 2 * d * root)).sum(), f + 2 * e + FINE)


def with_tangents(graph: Graph, ranges: Ranges, tangents: Array) -> Graph:
    """The graph with an edge of weight tau for each distance, of either sign.

    Claims (tau, c) are w (d - s^(1/2))^2 >= tau s + c for all s >= 0. For tau < w the least of the
    difference is -w d^2 tau / (w - tau) - c, at s^(1/2) = w d / (w - tau).
    """
    (w, tau, c), _ = integers(np.stack([ranges.weights, tangents[:, 0], tangents[:, 1]]))
    (d, *_), e = _in_fractions(np.stack([ranges.distances, ranges.distances]))
    held = (tau < w) & ((c * (w - tau) << (2 * e)) + w * d * d * tau <= 0)
    if not held.all():
        raise Refused("a tangent of a distance was not proven")
    k, dim = len(w), graph.t.shape[1]
    none, turns = np.zeros((k, dim)), None
    if graph.R is not None:
        one = np.zeros((k, dim, dim), dtype=object)
        one[:, range(dim), range(dim)] = 1 << POINT
        turns = np.concatenate([graph.R, one])
    return graph._replace(
        i=np.r_[graph.i, ranges.i],
        j=np.r_[graph.j, ranges.j],
        R=turns,
        t=np.concatenate([graph.t, none]),
        kappa=np.r_[graph.kappa, np.zeros(k)],
        tau=np.r_[graph.tau, tangents[:, 0]],
        N=None if graph.N is None else np.concatenate([graph.N, np.zeros((k, dim, dim))]),
        arms=None if graph.arms is None else np.concatenate([graph.arms, none]),
    )


# --- The certificate matrix -----------------------------------------------------------------------


class Blocks(NamedTuple):
    """A symmetric matrix by blocks, equilibrated: high + low, within 2^-100 per entry.

    Entries of ``high`` are multiples of 2^(-2 BITS), those of ``low`` at most half of that.
    """

    pairs: Ints  # (k, 2) distinct pairs of nodes p < q
    high: tuple[Array, Array]  # diagonal blocks (n, b, b) and blocks of the pairs (k, b, b)
    low: tuple[Array, Array]
    weights: Array  # (n, b) positive, for comparing row sums
    scales: Ints  # (n, b): rows and columns were multiplied by 2^scale


def magnitude(graph: Graph) -> int:
    """The exponent of a power of two above the largest kappa, or tau where no kappa is given."""
    return math.frexp(float(graph.kappa.max()) or float(graph.tau.max()))[1]


def certificate_matrix(graph: Graph, proof: Proof) -> Blocks:
    """A = M - blkdiag(0, Lam), with the pinned row and column zero off the diagonal.

    Its entries are sums of integers; only those of kappa R_ij are truncated. Couplings N take the
    place of these, and kappa s_ij R_ij of similarities, with kappa s_ij^2 at node i. Points have
    rows of rotations too, with a positive diagonal and else zero. It is equilibrated by powers of
    two, so that diagonal entries lie between 1/4 and 1.
    """
    n, d, i, j = graph.n, graph.t.shape[1], graph.i, graph.j
    b = d if proof.t is None else d + 1
    (kappa, ek), (tau, et) = map(integers, (graph.kappa, graph.tau))
    levers = graph.t if graph.arms is None else np.concatenate([graph.t, graph.arms])
    (t, arms), es = np.split(integers(levers)[0], [len(i)]), integers(levers)[1]
    Lam, el = integers(proof.multipliers)
    s, ew = (1, 0) if graph.scales is None else _in_fractions(graph.scales)
    N, en = (None, ek + ew + POINT) if graph.N is None else integers(graph.N)
    unit = max(en, ek + 2 * ew, et + 2 * es, et, el)  # entries are integers times 2^-unit
    # Normalized by a power of two to a largest kappa of about 1, for weights of any scale.
    normal = magnitude(graph)

    upper, diagonal = (np.zeros((k, b, b), dtype=object) for k in (len(i), n))
    if N is None:
        upper[:, -d:, -d:] = (-kappa * s << (unit - en))[:, None, None] * graph.R
    else:
        upper[:, -d:, -d:] = -N << (unit - en)
    degrees = np.zeros(n, dtype=object)
    np.add.at(degrees, i, kappa * s * s << (unit - ek - 2 * ew))
    np.add.at(degrees, j, kappa << (unit - ek))
    for k in range(b - d, b):
        diagonal[:, k, k] = degrees
    if proof.t is not None:
        mass, lever = tau << (unit - et), tau[:, None] * t
        moment = lever << (unit - et - es)
        np.add.at(diagonal[:, 0, 0], i, mass)
        np.add.at(diagonal[:, 0, 0], j, mass)
        np.add.at(diagonal[:, 0, 1:], i, moment)
        diagonal[:, 1:, 0] = diagonal[:, 0, 1:]
        upper[:, 0, 0], upper[:, 1:, 0] = -mass, -moment
        if graph.arms is not None:
            arm = tau[:, None] * arms << (unit - et - es)
            np.add.at(diagonal[:, 0, 1:], j, arm)
            diagonal[:, 1:, 0] = diagonal[:, 0, 1:]
            upper[:, 0, 1:] = -arm
            more = (tau[:, None] * arms << (unit - et - 2 * es))[:, :, None] * arms[:, None, :]
            np.add.at(diagonal[:, 1:, 1:], j, more)
            across = (lever << (unit - et - 2 * es))[:, :, None] * arms[:, None, :]
            upper[:, 1:, 1:] -= across
        lever <<= unit - et - 2 * es
        np.add.at(diagonal[:, 1:, 1:], i, lever[:, :, None] * t[:, None, :])
    for k, (a, c) in enumerate(zip(*np.triu_indices(d), strict=True)):
        diagonal[:, a - d, c - d] -= Lam[:, k] << (unit - el)
        diagonal[:, c - d, a - d] = diagonal[:, a - d, c - d]
    if graph.points is not None:
        _refuse_turned_points(graph, graph.points, proof)
        if unit + normal < 0:
            raise Refused("the weights are too uneven")
        for k in range(b - d, b):
            diagonal[graph.points, k, k] = 1 << (unit + normal)

    turned = i > j
    upper[turned] = np.swapaxes(upper[turned], 1, 2)
    distinct, place = np.unique(np.minimum(i, j) * n + np.maximum(i, j), return_inverse=True)
    pairs = np.stack(np.divmod(distinct, n), axis=1)
    if len(pairs) < len(upper):
        between = np.zeros((len(pairs), b, b), dtype=object)
        np.add.at(between, place, upper)
    else:
        between = upper[np.argsort(place)]
    if proof.t is not None:
        diagonal[proof.pin, 0, 1:] = diagonal[proof.pin, 1:, 0] = 0
        between[pairs[:, 0] == proof.pin, 0, :] = 0
        between[pairs[:, 1] == proof.pin, :, 0] = 0
    truncated = np.zeros(between.shape)  # bounds in units of 2^-POINT; the rest is exact
    if N is None:
        weights = abs(graph.kappa) * (1.0 if graph.scales is None else graph.scales)
        truncated[:, -d:, -d:] = np.bincount(place, weights)[:, None, None]
    return _equilibrated(diagonal, pairs, between, truncated, unit, normal, proof.exponent)


def _refuse_turned_points(graph: Graph, points: Bools, proof: Proof) -> None:
    """Refuse a graph or a proof in which the rotation of a point occurs."""
    turned = graph.kappa != 0.0
    if graph.N is not None:
        turned = turned | graph.N.any(axis=(1, 2))
    if graph.arms is not None:
        turned = turned | graph.arms.any(axis=1)
    leaving = points[graph.i] & (turned | graph.t.any(axis=1))
    if (leaving | (points[graph.j] & turned)).any():
        raise Refused("the rotation of a point is measured")
    if proof.multipliers[points].any():
        raise Refused("a point has no rotation, and its multipliers must be zero")


def _equilibrated(
    diagonal: Any,
    pairs: Ints,
    between: Any,
    truncated: Array,
    unit: int,
    normal: int,
    exponent: int,
) -> Blocks:
    entries = np.einsum("naa->na", diagonal)
    if not (entries > 0).all():
        raise Refused("a diagonal entry of the certificate matrix is not positive")
    lengths = np.frompyfunc(int.bit_length, 1, 1)(entries).astype(np.intp)
    scales = (unit + normal - lengths) >> 1  # from [2^(l-1), 2^l) to [1/4, 1)
    own = scales[:, :, None] + scales[:, None, :]
    p, q = pairs.T
    across = scales[p][:, :, None] + scales[q][:, None, :]
    errors = np.ldexp(truncated, across - normal - POINT)
    if not errors.max(initial=0.0) < 2.0**-102:
        raise Refused("the weights are too uneven")
    high, low = zip(
        _parts(diagonal, own - normal - unit), _parts(between, across - normal - unit), strict=True
    )
    weights = np.ldexp(1.0, -scales)
    weights[:, 0] = np.ldexp(weights[:, 0], exponent)
    if not ((weights > 1.0 / FAR) & (weights < FAR)).all():
        raise Refused("the weights are too uneven")
    return Blocks(pairs, high, low, weights, scales)


def _parts(entries: Any, shifts: Ints) -> tuple[Array, Array]:
    """N 2^shift, entry by entry, as the nearest multiple of 2^(-2 BITS) and the remainder."""
    high, low = (np.empty(entries.shape) for _ in range(2))
    for k in range(0, len(entries), 1 << 16):  # integers take much more memory than doubles
        some, shift = entries[k : k + (1 << 16)], shifts[k : k + (1 << 16)] + 2 * BITS + 62
        if (shift > 0).any():
            some, shift = some << _big(np.maximum(shift, 0)), np.minimum(shift, 0)
        moved = some >> _big(-shift)
        rest = (moved & ((1 << 62) - 1)).astype(np.int64)
        up = rest >> 61  # to the nearest one
        high[k : k + (1 << 16)] = ((moved >> 62).astype(np.float64) + up) * 4.0**-BITS
        low[k : k + (1 << 16)] = np.ldexp((rest - (up << 62)).astype(np.float64), -62 - 2 * BITS)
    return high, low


# --- The order of elimination ---------------------------------------------------------------------


class Front(NamedTuple):
    """Nodes that are eliminated together, and the later nodes in their columns of the factor."""

    pivots: list[int]
    boundary: list[int]
    children: list[int]


def fronts(n: int, pairs: Ints, allowance: int = 12, widest: int = 16) -> list[Front]:
    """The fronts of eliminating 0 ... n-1 in order, children before parents.

    ``pairs`` are (k, 2) with p < q. A node joins a child's front if that adds at most ``allowance``
    blocks of zeros, or an eighth of the front, until that eliminates ``widest`` nodes.
    """
    later: list[set[int]] = [set() for _ in range(n)]
    for p, q in pairs.tolist():
        later[p].add(q)
    waiting: list[list[int]] = [[] for _ in range(n)]  # fronts, by their first boundary node
    found: list[Front] = []
    reaches: list[set[int]] = []
    for p in range(n):
        reach = later[p].union(*(reaches[c] for c in waiting[p]))
        reach.discard(p)
        home, zeros = -1, math.inf
        for c in (c for c in waiting[p] if len(found[c].pivots) < widest):
            added = (len(reach) + 1 - len(reaches[c])) * len(found[c].pivots)
            home, zeros = (c, added) if added < zeros else (home, zeros)
        size = len(found[home].pivots) * len(reaches[home]) if home >= 0 else 0
        if zeros <= max(allowance, size / 8):
            found[home].pivots.append(p)
            found[home].children.extend(c for c in waiting[p] if c != home)
            reaches[home] = reach
        else:
            home = len(found)
            found.append(Front([p], [], waiting[p]))
            reaches.append(reach)
        if reach:
            waiting[min(reach)].append(home)
        waiting[p] = []
        later[p] = set()
    roots = [k for k, reach in enumerate(reaches) if not reach]
    walk: list[int] = []
    while roots:
        walk.append(roots.pop())
        roots.extend(found[walk[-1]].children)
    walk.reverse()
    renumbered = {k: position for position, k in enumerate(walk)}
    return [
        Front(found[k].pivots, sorted(reaches[k]), sorted(renumbered[c] for c in found[k].children))
        for k in walk
    ]


# --- Positive semidefiniteness --------------------------------------------------------------------


class Residual(NamedTuple):
    """The residual A - L L^T by row (n b,) of the equilibrated matrix."""

    diagonal: Array  # its diagonal entries
    needed: Array  # lower bounds on them that suffice for diagonal dominance


class Panel(NamedTuple):
    """The columns of L of a front: the first of its rows are its pivots."""

    rows: Ints  # in the order of elimination
    L: Array  # (f, k), rounded to doubles
    children: list[int]


class Stack(NamedTuple):
    """Fronts of about one size, none below another, that are eliminated at once.

    All have K pivots and M boundary nodes: where one has fewer, node n, which does not exist.
    """

    nodes: Ints  # (s, K + M) pivots, then the boundary
    pivots: int  # K
    members: Ints  # (s,) numbers of the fronts
    parents: list[tuple[int, slice]]  # stacks that fronts pass on to, and which ones do
    slots: Ints  # (s,) where their parents are in these
    into: Ints  # (s, M) places of the boundary in parents


def stacks(tree: list[Front], n: int, p: Ints, q: Ints) -> tuple[list[Stack], list[Ints]]:
    """All fronts, children before parents; and for each stack what to assemble of A.

    That is the numbers of its blocks, those at p[k] and q[k] of which the earlier is a pivot, and
    (4, ...) their places: slot, row, column. Fronts are put together if that takes little more
    work.
    """
    count, wide = len(tree), np.array([(len(x.pivots), len(x.boundary)) for x in tree])
    parent, height = np.full(count, count), [0] * count
    for number, front in enumerate(tree):
        parent[front.children] = number
        height[number] = 1 + max((height[child] for child in front.children), default=-1)
    stack, shapes = np.zeros(count + 1, dtype=np.intp), list[tuple[int, int]]()
    K = M = size = work = level = 0
    for number in np.lexsort((wide[:, 0], wide.sum(axis=1), np.array(height))).tolist():
        k, m = wide[number].tolist()
        K, M, size, work = max(K, k), max(M, m), size + 1, work + k * (k + m) ** 2
        if not shapes or height[number] != level or size * K * (K + M) ** 2 > work + 16384:
            K, M, size, work, level = k, m, 1, k * (k + m) ** 2, height[number]
            shapes.append((K, M))
        shapes[-1], stack[number] = (K, M), len(shapes) - 1
    stack[count], each = len(shapes), np.arange(len(shapes) + 1)
    numbers = np.lexsort((stack[parent], stack[:count]))
    slot, ends = np.zeros(count + 1, dtype=np.intp), np.searchsorted(stack[numbers], each)
    slot[numbers] = np.arange(count) - ends[stack[numbers]]

    home = np.repeat(np.arange(count), wide.sum(axis=1))
    node = np.array([k for x in tree for k in (*x.pivots, *x.boundary)])
    place = np.arange(len(home)) - np.searchsorted(home, home)
    own, known = place < wide[home, 0], home * n + node  # ascending
    place += np.where(own, 0, np.array(shapes)[stack[home], 0] - wide[home, 0])

    def placed(front: Ints, node: Ints) -> Ints:
        return place[np.searchsorted(known, front * n + node)]

    into, pivot_of = np.zeros(len(home), dtype=np.intp), np.zeros(n, dtype=np.intp)
    into[~own], pivot_of[node[own]] = placed(parent[home[~own]], node[~own]), home[own]
    at = pivot_of[np.minimum(p, q)]
    blocks = np.stack([np.arange(len(p)), slot[at], placed(at, p), placed(at, q)])
    of_stack, of_block = (np.argsort(stack[x], kind="stable") for x in (home, at))
    parts = np.split(of_stack, np.searchsorted(stack[home][of_stack], each[1:-1]))
    found = []
    for (K, M), some, (first, last) in zip(shapes, parts, pairwise(ends), strict=True):
        members = numbers[first:last]
        nodes, to = np.full((len(members), K + M), n), np.zeros((len(members), K + M), np.intp)
        nodes[slot[home[some]], place[some]] = node[some]
        to[slot[home[some]], place[some]] = into[some]
        above = stack[parent[members]]
        cuts = [0, *(1 + np.flatnonzero(np.diff(above))).tolist(), len(members)]
        # Roots pass nothing on; where the graph is not connected, other fronts may be with them.
        passing = [(int(above[c]), slice(c, d)) for c, d in pairwise(cuts)]
        passing = [(parent, some) for parent, some in passing if parent < len(shapes)]
        found.append(Stack(nodes, K, members, passing, slot[parent[members]], to[:, K:]))
    chosen = np.split(blocks[:, of_block], np.searchsorted(stack[at][of_block], each[1:-1]), axis=1)
    return found, chosen


def residual(
    blocks: Blocks, order: Ints, delta: Array, panels: list[Panel] | None = None
) -> Residual | None:
    """Bounds on A - L L^T for some L; None if no L was found. ``panels`` get L.

    L = L1 + L2 is a multifrontal Cholesky factor of A - diag(delta). The bounds hold for any L. The
    large part H of the residual is added up without rounding, in multiples of 2^(-2 BITS); G is the
    remainder.
    """
    n, b = blocks.weights.shape
    p, q, A = _in_order(blocks, order)
    tree = fronts(n, np.stack([p, q], axis=1)[p < q])
    found, chosen = stacks(tree, n, p, q)
    v, delta = (np.append(x[order], np.zeros(b)) for x in (blocks.weights, delta.reshape(n, b)))
    passed: list[list[tuple[Ints, Ints, Ints, Array]]] = [[] for _ in found]
    sums, kept = list[tuple[npt.NDArray[Any], ...]](), dict[int, Panel]()
    for stack, received, (which, slot, *at) in zip(found, passed, chosen, strict=True):
        rows, k = _rows(stack.nodes, b), stack.pivots * b
        received.insert(0, (slot, *(_rows(place[:, None], b) for place in at), A[:, which]))
        H, G = _assembled(received, *rows.shape)
        received.clear()
        none = rows >= n * b
        np.einsum("saa->sa", H)[:, :k][none[:, :k]] = 1.0
        w, less = v[rows], delta[rows[:, :k]]
        factor = _factor(H[:, :, :k] + G[:, :, :k], less)
        if factor is None:
            return None
        L, inverse = factor
        L1 = np.rint(L * 2.0**BITS) * 2.0**-BITS
        L1[none] = 0.0
        H -= L1 @ _T(L1)
        L2 = _refined(H[:, :, :k], G[:, :, :k], less, L, L1, inverse)
        L2[none] = 0.0
        if panels is not None:
            for number, at, its, real in zip(stack.members, rows, L1 + L2, ~none, strict=True):
                its = its[np.ix_(real, real[:k])]
                kept[number] = Panel(at[real], its, tree[number].children)
        M = L1 + 0.5 * L2
        cross = M @ _T(L2)
        G -= cross + _T(cross)
        for parent, some in stack.parents:
            into, left = _rows(stack.into[some], b), np.stack([H[some, k:, k:], G[some, k:, k:]])
            passed[parent].append((stack.slots[some], into, into, left))
        # The pivots' rows and columns are now complete.
        E = H[:, :, :k] + G[:, :, :k]
        own, reached = np.zeros(rows.shape), w[:, :k].sum(axis=1, keepdims=True) + 0.0 * w
        own[:, :k] = np.einsum("saa->sa", E[:, :k])
        E = np.abs(E)
        np.einsum("saa->sa", E[:, :k])[...] = 0.0
        others = _times(E, w[:, :k])
        others[:, :k] += _times(_T(E[:, k:]), w[:, k:])
        reached[:, :k] += w[:, k:].sum(axis=1, keepdims=True)
        M, L2 = np.abs(M), np.abs(L2)
        if not L2.max() < 1.0:
            return None
        sizes = _times(M, _times(_T(L2), w)) + _times(L2, _times(_T(M), w))
        norms = np.einsum("srk,srk->sr", L1, L1)
        sums.append((rows, own, others, reached, sizes, k * sizes, norms))
    if panels is not None:
        panels.extend(kept[number] for number in range(len(tree)))
    index = np.concatenate([rows.ravel() for rows, *_ in sums])
    own, others, reached, sizes, rounded, norms = (
        np.bincount(index, np.concatenate([x.ravel() for x in part]))[: n * b].astype(np.float64)
        for part in list(zip(*sums, strict=True))[1:]
    )
    holding = np.bincount(index, minlength=n * b)[: n * b]  # fronts with a row
    largest = max(np.abs(high).max(initial=0.0) for high in blocks.high)
    if not largest + norms.max() < 2.0 ** (52 - 2 * BITS):
        return None
    # Summands of an entry of G are rounded 2 holding + 1 times more than their fronts have columns.
    sizes += reached * 2.0 ** (-2 * BITS - 1)
    errors = U * (rounded + (2.0 * holding + 4.0) * sizes) + reached * 2.0**-100
    needed = (others + errors) * SPARE / v[: n * b]
    back = np.argsort(_rows(order, b))
    return Residual((own - abs(own) * 2.0**-40)[back], needed[back])


def _in_order(blocks: Blocks, order: Ints) -> tuple[Ints, Ints, Array]:
    """Positions p and q of all blocks in the order, mirrored ones too; and both parts there."""
    places = np.argsort(order)[blocks.pairs].T
    p, q = np.concatenate([[np.arange(len(order))] * 2, places, places[::-1]], axis=1)
    parts = [
        np.concatenate([diagonal[order], between, np.swapaxes(between, 1, 2)])
        for diagonal, between in (blocks.high, blocks.low)
    ]
    return p, q, np.stack(parts)


def _rows(nodes: Ints, b: int) -> Ints:
    return (nodes[..., None] * b + np.arange(b)).reshape(*nodes.shape[:-1], -1)


def _T(A: Array) -> Array:  # noqa: N802
    return np.swapaxes(A, 1, 2)


def _times(A: Array, x: Array) -> Array:
    return (A @ x[:, :, None])[:, :, 0]


def _assembled(parts: list[tuple[Ints, Ints, Ints, Array]], s: int, f: int) -> list[Array]:
    """Two sums (s, f, f) of blocks (2, ...) with their places: slots, rows and columns."""
    index = [
        ((slot[:, None] * f + rows)[:, :, None] * f + columns[:, None, :]).ravel()
        for slot, rows, columns, _ in parts
    ]
    values = np.concatenate([blocks.reshape(2, -1) for *_, blocks in parts], axis=1)
    added = [np.bincount(np.concatenate(index), part, s * f * f) for part in values]
    return [part.reshape(s, f, f).view(np.float64) for part in added]


def _factor(F: Array, delta: Array) -> tuple[Array, Array] | None:
    """Columns (s, f, k) of Cholesky factors, and the inverses of their pivot rows."""
    k = delta.shape[1]
    pivots = np.einsum("saa->sa", F[:, :k])
    # Rounding can make a tiny pivot negative: then a larger diagonal, which `_refined` corrects.
    for less in delta, -16.0 * U * F.shape[1] * np.abs(pivots).max(axis=1, keepdims=True):
        pivots -= less
        try:
            C = np.linalg.cholesky(F[:, :k])
            inverse = _inverse(C)
        except np.linalg.LinAlgError:
            if len(F) == 1:
                continue
            pivots += less
            found = [_factor(F[[slot]], delta[[slot]]) for slot in range(len(F))]
            L, inverses = zip(*(one or (None, None) for one in found), strict=True)
            return None if None in found else (np.concatenate(L), np.concatenate(inverses))
        return np.concatenate([C, F[:, k:] @ _T(inverse)], axis=1), inverse
    return None


def _inverse(C: npt.NDArray[Any]) -> Array:
    """Those of lower triangular matrices (s, k, k)."""
    if (k := C.shape[1]) <= 24:
        return np.linalg.inv(C)
    X, h = np.zeros_like(C), k // 2
    X[:, :h, :h], X[:, h:, h:] = _inverse(C[:, :h, :h]), _inverse(C[:, h:, h:])
    X[:, h:, :h] = -X[:, h:, h:] @ (C[:, h:, :h] @ X[:, :h, :h])
    return X


def _refined(H: Array, G: Array, delta: Array, L: Array, L1: Array, inverse: Array) -> Array:
    """L - L1, corrected for the rounding of L, from columns of H (minus L1 L1^T) and of G.

    Their remainder is (C W C^T, ...) with C the pivot rows of L. C (I + step) is the factor of
    C (I + W) C^T, and step is nearly the lower half of W if that is small.
    """
    k, L2 = delta.shape[1], L - L1
    one = np.eye(k)
    for _ in range(5):
        L = L1 + L2
        left = H + ((G - L1 @ _T(L2[:, :k])) - L2 @ _T(L[:, :k]))
        np.einsum("saa->sa", left[:, :k])[...] -= delta
        left = left @ _T(inverse)
        W = inverse @ left[:, :k]
        step, sizes = (np.tri(k) - 0.5 * one) * W, np.abs(W).max(axis=(1, 2))
        for slot in np.flatnonzero(~(sizes < 2.0**-8)):
            try:
                root = np.linalg.cholesky(one + W[slot])
                step[slot], inverse[slot] = root - one, _inverse(root[None])[0] @ inverse[slot]
            except np.linalg.LinAlgError:
                step[slot], left[slot] = 0.0, 0.0
        below = left[:, k:] - L[:, k:] @ _T(step)
        L2[:, :k] += L[:, :k] @ step
        L2[:, k:] += below - below @ _T(step)
        if not sizes.max() > 2.0**-32:
            break
    return L2


def is_positive_semidefinite(
    blocks: Blocks, order: Ints, delta: Array, panels: list[Panel] | None = None
) -> bool:
    """Whether every matrix within 2^-100 of the blocks was proven positive semidefinite.

    If so, it is at least L L^T, and ``panels`` hold that L.
    """
    for _ in range(ATTEMPTS):
        if panels is not None:
            panels.clear()
        found = residual(blocks, order, delta, panels)
        if found is None:
            return False
        if np.all(found.diagonal >= found.needed):
            return True
        # Machines round differently: double the amount of rows that lack some.
        delta = np.maximum(delta, 2.0 * (found.needed - found.diagonal + delta))
    return False


# --- Distances ------------------------------------------------------------------------------------


def inverse_blocks(panels: list[Panel], n: int, b: int) -> Array:
    """(n, b, b), by the order: at least the nodes' blocks of A^-1, A without the last node's rows.

    A is at least L L^T, so A^-1 is at most (L L^T)^-1. Let P be the pivots' rows of a front's
    columns, and Q the others. In its rows the inverse is J Z J^T + (P P^T)^-1 in the pivots, with
    J = [-(Q P^-1)^T; I], where Z is that of the others, of which its parent has an upper bound.
    What rounding may be is added to the diagonal, for rows of L times weights w, powers of two, and
    so for the block over w w^T. The last node's rows count as zeros.
    """
    blocks, above = np.zeros((n, b, b)), dict[int, Array]()
    for number in reversed(range(len(panels))):
        rows, L, children = panels[number]
        f, k = L.shape
        Z = np.zeros((f, f))
        Z[k:, k:] = above.pop(number, 0.0)
        if rows[k - 1] == n * b - 1:
            k -= b
        P, Q, R = L[:k, :k], L[k:, :k], Z[k:, k:]
        try:
            X = np.linalg.inv(P)
        except np.linalg.LinAlgError:
            raise Refused("a factor has no inverse") from None
        C = Q @ X
        Z[k:, :k] = -(R @ C)
        Z[:k, k:] = Z[k:, :k].T
        own = X.T @ X - C.T @ Z[k:, :k]
        Z[:k, :k] = 0.5 * (own + own.T)
        diagonal = np.einsum("aa->a", Z)
        w = np.ldexp(1.0, np.frexp(np.maximum(diagonal, 1.0))[1] >> 1)
        v, o = w[:k, None], w[k:, None]
        diagonal += w * w * _lacking(v * P, o * Q, R / (o * o.T), X / v.T, o * C / v.T)
        of_nodes = Z[:k, :k].reshape(k // b, b, k // b, b)
        blocks[rows[:k:b] // b] = np.einsum("iaic->iac", of_nodes)
        for child in children:
            passed = panels[child]
            into = np.searchsorted(rows, passed.rows[passed.L.shape[1] :])
            above[child] = Z[into[:, None], into]
    return blocks


def unscaled(graph: Graph, blocks: Blocks, G: Array) -> tuple[Any, Fraction]:
    """Integers and their unit: blocks of the inverse without the scales of `certificate_matrix`."""
    N, e = integers(G)
    by = blocks.scales[:, :, None] + blocks.scales[:, None, :]
    return N << _big(by - by.min()), Fraction(2) ** (int(by.min()) - e - magnitude(graph))


def _lacking(P: Array, Q: Array, R: Array, X: npt.NDArray[Any], C: npt.NDArray[Any]) -> float:
    """What the block computed with X for P^-1 and C for Q P^-1 may lack, in Frobenius norms.

    Entries of P and Q may be off by a unit of rounding; those of R, the rows of Z, are exact.
    """
    unit = (len(P) + len(Q) + 16.0) * U
    p, q, r, x, c = map(_norm, (P, Q, R, X, C))
    e, f = _norm(np.eye(len(P)) - X @ P), _norm(Q - C @ P)
    e += unit * (x * p + 1.0)  # at least |I - X P| = |E|, and P^-1 = (I - E)^-1 X
    if not e < 0.5:
        raise Refused("a factor is too ill-conditioned for distances")
    own = 2.0 * e * x  # at least |P^-1 - X|
    across = (f + unit * (c * p + q)) * (x + own)  # at least |Q P^-1 - C| = |(Q - C P) P^-1|
    missed = own * (2.0 * x + own) + across * r * (1.0 + 2.0 * c + across)
    return SPARE * (missed + 4.0 * unit * (x * x + r * (1.0 + c) ** 2))


def _norm(M: npt.NDArray[Any]) -> float:
    return math.sqrt(float((M * M).sum()))


def turns_less(G: Any, square: Fraction, degrees: float) -> Bools:
    """(k,) which rotations differ by no more than an angle, from integers G_RR (k, d, d).

    If V is the difference of two rotations by theta, V^T V = 2 (1 - cos(theta)) (I - n n^T), n the
    axis, or 0 in the plane. So with H = G_RR^-1, its adjugate over the determinant, tr(V H V^T) <=
    rho^2 = square is 2 (1 - cos(theta)) (tr(H) - n.H n) <= rho^2.
    """
    angle = Fraction(degrees) * 103993 / (33102 * 180)  # 103993 / 33102 is less than pi
    apart = (1 << FINE) - _turn(int(angle * (1 << FINE)))[0] - OFF  # 1 - cos(angle), or less
    if apart <= 0:
        return np.zeros(len(G), dtype=bool)
    p, q = (square * Fraction(1 << FINE, 2 * apart)).as_integer_ratio()
    adjugates, d = _adjugate(G), G.shape[1]
    enough = q * np.einsum("kaa->k", adjugates) - p * (G[:, 0] * adjugates[:, 0]).sum(axis=1)
    form = enough[:, None, None] * np.eye(d, dtype=int)
    return _definite(form - q * adjugates if d == 3 else form)


def refuse_farther(
    graph: Graph, pin: int, G: Any, unit: Fraction, square: Fraction, claims: Sequence[Within]
) -> None:
    """Refuse claims that do not follow from integers G (n, b, b) times unit, see `inverse_blocks`.

    With u and V what a node's position and rotation differ by, tr([u V] G^-1 [u V]^T) <= rho^2,
    the square. So |u|^2 <= rho^2 G_tt.
    """
    square, d = square * unit, graph.t.shape[1]
    for claim in claims:
        some = np.array([k for k in range(graph.n) if claim.node in (None, graph.ids[k])], int)
        if not len(some):
            raise Refused(f"there is no node {claim.node}")
        some = some[some != pin]
        if claim.metres is not None and len(some):
            node = max(some, key=lambda k: G[k, 0, 0])
            if (squared := square * G[node, 0, 0]) > Fraction(claim.metres) ** 2:
                _refuse_claim(claim, graph.ids[node], math.sqrt(squared), "m")
        far, angle = some[graph.poses[some]], claim.degrees or 180.0
        while angle < 180.0 and len(far := far[~turns_less(G[far, -d:, -d:], square, angle)]):
            node, angle = far[0], min(1.1 * angle, 180.0)
        if claim.degrees not in (None, angle):
            _refuse_claim(claim, graph.ids[node], angle, "degrees")


def _refuse_claim(claim: Within, node: int | None, proven: float, unit: str) -> None:
    least = Context(3, ROUND_CEILING).create_decimal_from_float(proven)
    asked = claim.metres if unit == "m" else claim.degrees
    seen = f"{called(node)} seen from {called(claim.reference)}"
    raise Farther(f"within {least:g} {unit} of every optimum ({seen}), not {asked:g}")


# --- The result -----------------------------------------------------------------------------------


class Answer(NamedTuple):
    """F(x) <= upper and F* >= lower, where ``about`` describes F, and claims that were verified."""

    upper: float
    lower: float
    about: str = ""
    within: tuple[Within, ...] = ()

    @property
    def relative_gap(self) -> float:
        """A double not below (F(x) - F*)/F(x)."""
        if self.upper <= self.lower:
            return 0.0
        gap = math.nextafter(self.upper - self.lower, math.inf)
        return min(1.0, math.nextafter(gap / self.upper, math.inf))

    def __str__(self) -> str:
        up, down = Context(15, ROUND_CEILING), Context(15, ROUND_FLOOR)
        gap = Context(2, ROUND_CEILING).create_decimal_from_float(self.relative_gap)
        upper, lower = (
            up.create_decimal(Decimal(self.upper)),
            down.create_decimal(Decimal(self.lower)),
        )
        return f"PROVED: F(x) <= {upper:g}, F* >= {lower:g}, relative gap <= {gap:.1e}"


def prove(graph: Graph, proof: Proof, claims: tuple[Within, ...] = ()) -> Answer:
    """Both bounds; raises `Refused` if they, or the claims, are not proven."""
    given, constants, of_couplings = proof.minorants, np.zeros(0), graph.N is not None
    if given is None:
        upper = upper_bound(graph, proof.q, proof.t, proof.rejections, proof.s)
        if proof.rejections is not None:
            graph, constants = truncated(graph, proof.rejections)
    else:
        upper = g2o_cost(graph, proof.q, proof.t)
        if not minorants_hold(graph, given).all():
            raise Refused("a minorant was not proven, or that information is positive definite")
        graph, constants = surrogate(graph, given), given.constants
    if graph.ranges is not None and proof.tangents is not None and proof.t is not None:
        of_ranges = ranges_cost(graph.ranges, proof.t)
        upper = math.nextafter(upper + of_ranges, math.inf)
        graph = with_tangents(graph, graph.ranges, proof.tangents)
        constants = np.r_[constants, proof.tangents[:, 1]]
    lower = lower_bound(graph, proof.multipliers, constants)
    blocks, panels = certificate_matrix(graph, proof), list[Panel]()
    kept = panels if claims else None
    if not is_positive_semidefinite(blocks, proof.order, proof.delta, kept):
        raise Refused("the certificate matrix was not proven positive semidefinite")
    if claims:
        if proof.order[-1] != proof.pin or not graph.poses[proof.pin]:
            raise Refused("distances are seen from the pinned pose, the last of the order")
        G = inverse_blocks(panels, graph.n, blocks.weights.shape[1])[np.argsort(proof.order)]
        N, unit = unscaled(graph, blocks, G)
        # For any estimate y that costs at most U: |X - Y| <= |X| + |Y|, |X|^2 = F(x) - L <= U - L.
        refuse_farther(graph, proof.pin, N, unit, 4 * (Fraction(upper) - Fraction(lower)), claims)
    # Terms of couplings are 2 d kappa less what may be more.
    return Answer(upper, lower if of_couplings else max(lower, 0.0), within=claims)


def lower_bound(graph: Graph, multipliers: Array, constants: Array) -> float:
    """What F* is at least if the certificate matrix is positive semidefinite.

    That is the sum of tr(Lam_i) and the constants, rounded down. With A_i = s_i R_i, tr(Lam_i)
    counts s_i^2 times: where s_i is unknown, it must not be negative, and counts as zero; and where
    all are, the least one counts n times in the cost over the mean of s_i^2.
    """
    on_diagonal = np.equal(*np.triu_indices(graph.t.shape[1]))
    terms = multipliers[:, on_diagonal]
    if graph.free is not None:
        Lam, e = integers(terms)
        traces = Lam.sum(axis=1)
        if graph.in_mean_unit:
            return -_rounded_up(-int(traces[graph.poses].min()) * int(graph.poses.sum()), e)
        if (traces[graph.free] < 0).any():
            raise Refused("the trace of a multiplier of an unknown scale is negative")
        terms = terms[~graph.free]
    return math.nextafter(math.fsum(np.concatenate([terms.ravel(), constants])), -math.inf)


def check(graph_path: str | Path, proof_path: str | Path) -> Answer:
    """Check a proof about a graph file.

    Parameters
    ----------
    graph_path : g2o or 1DSfM text, with the SHA-256 given in the proof
    proof_path : a file by `certpgo.write_proof`, or from any other source

    Raises
    ------
    Refused
        The proof is not valid for this file.
    Unreadable
        One of the files cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> certpgo.write("helix.g2o", helix(3, np.random.default_rng(0)))
    >>> instance = certpgo.read("helix.g2o")
    >>> result = certpgo.solve(instance, cost="chordal")
    >>> proven = instance, result.estimate, result.certificate
    >>> _ = certpgo.write_proof("helix.cert", "helix.g2o", *proven)
    >>> print(certpgo.check("helix.g2o", "helix.cert"))
    PROVED: F(x) <= ..., F* >= ..., relative gap <= ...
    """
    path = Path(graph_path)
    path = path / "EGs.txt" if path.is_dir() else path
    try:
        text = path.read_bytes()
    except OSError as error:
        raise Unreadable(f"{path}: {error.strerror}") from None

    def measured(claim: dict[str, Any]) -> Graph:
        component = _component(path, text, claim)
        try:
            return read_graph(text, claim, component)
        except Unreadable as error:
            raise Unreadable(f"{path}: {error}") from None

    return checked(proof_path, measured)


def checked(proof_path: str | Path, measured: Callable[[dict[str, Any]], Graph]) -> Answer:
    """Check a proof about what was measured, as its header says that a graph file is read."""
    try:
        with open(proof_path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            if any(member.compress_type for member in archive.zip.infolist()):
                raise Unreadable(f"{proof_path}: its arrays must not be compressed")
            claim = read_claim(archive)
            graph = measured(claim)
            ranges = 0 if graph.ranges is None else len(graph.ranges.i)
            proof = read_proof(archive, claim, graph.n, len(graph.i), ranges)
            given = claim.get("within", [])
            claims = tuple(Within(**one, reference=graph.ids[proof.pin]) for one in given)
    except (Refused, Unreadable):
        raise
    except FileNotFoundError:
        raise Unreadable(f"{proof_path}: no such file") from None
    except Exception as error:  # damaged archives can raise anything
        raise Unreadable(f"{proof_path}: not a readable proof ({type(error).__name__})") from None
    try:
        with np.errstate(all="ignore"):
            about = _about(graph, claim, proof.rejections)
            return prove(graph, proof, claims)._replace(about=about)
    except OverflowError:
        raise Refused("numbers beyond the range of doubles") from None
    except MemoryError:
        raise Refused("more memory is needed than there is") from None


def _about(graph: Graph, claim: dict[str, Any], cut: Rejections | None = None) -> str:
    """Describes F, as the reading options come from the proof."""
    measured = f"the {claim['kind']} of {graph.n} nodes from {len(graph.i)} measurements"
    said = ["chordal cost F", measured]
    if claim.get("cost") is not None:
        edges = "EdgeSE2" if claim["d"] == 2 else "EdgeSE3:QUAT"
        said[0] = f"g2o's chi2 of {edges} with full information"
        said[1:1] = ["and of positions"] * bool((graph.kappa == 0.0).any())
    else:
        for k in ("kappa", "tau")[: 1 + (claim["kind"] != "rotations")]:
            none = " (1 without information)" * bool((getattr(graph, k) == 1.0).any())
            said.append(f"{k} {claim[k] or f'of the file{none}'}")
        said.append(f"rotational information read as {claim['rotation_information']}")
    if claim.get("landmarks"):
        said.append(f"with {0 if graph.points is None else int(graph.points.sum())} landmarks")
    said += [f"with {graph.priors} priors"] * bool(claim.get("priors"))
    if graph.ranges is not None:
        said.append(f"and squared errors of {len(graph.ranges.i)} distances")
    said += ["numbers read as information"] * any(map(claim.get, ("landmarks", "priors")))
    added = claim["keep"] == "all"
    said.append("parallel edges added" if added else f"only the {claim['keep']} of parallel edges")
    said += ["nodes of cc.txt alone"] * (claim["component_sha256"] is not None)
    if graph.free is not None:
        said.append(f"{int(graph.free.sum())} scales unknown")
        unit = "root mean square scale" if graph.in_mean_unit else "poses of known scale"
        said.append(f"in the unit of the {unit}")
    if cut is not None:
        low = Context(6, ROUND_FLOOR).plus(Decimal(cut.prices.min()))
        high = Context(6, ROUND_CEILING).plus(Decimal(cut.prices.max()))
        said.append(f"truncated: {len(cut.prices)} rejected ones cost {low:g} to {high:g} at most")
    return ", ".join(said)


def _component(path: Path, text: bytes, claim: dict[str, Any]) -> bytes | None:
    """The nodes to keep, if the proof is restricted to those of a cc.txt next to the graph."""
    if hashlib.sha256(text).hexdigest() != claim["graph_sha256"]:
        raise Refused(f"{path} is not the file that was proven about: its SHA-256 differs")
    if claim["component_sha256"] is None:
        return None
    try:
        component = path.with_name("cc.txt").read_bytes()
    except OSError as error:
        raise Unreadable(f"cc.txt beside {path}: {error.strerror}") from None
    if hashlib.sha256(component).hexdigest() != claim["component_sha256"]:
        raise Refused("cc.txt is not the file that was proven about: its SHA-256 differs")
    return component


def main(arguments: list[str]) -> int:
    """Print what is proven; exit codes: 0 proved, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) != 2:
        sys.stderr.write("usage: checker.py GRAPH PROOF\n")
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

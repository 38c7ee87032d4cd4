"""Verifies that an estimate of a pose graph is proven nearly optimal, in integers alone.

    python integer_checker.py PLAIN
    python integer_checker.py GRAPH PROOF

needs only this file and Python, and no floating-point number. PLAIN is a text of integers: all
measurements, and all numbers of a proof. docs/plain_proofs.md says what each line means, and
docs/checker.md why what is proven is true (section 11). The second form has integer_reader.py,
which must be in the same folder, write that text from a graph file and a proof file.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import cache
from importlib import import_module
from itertools import chain
from math import isqrt
from operator import mul, sub
from pathlib import Path
from typing import Any, NamedTuple

ULP = 1074  # every double is an integer times 2^-ULP, and stored as that integer
ONE = 1 << ULP
FINE = 1400  # fractional bits of costs
PRECISIONS = (88, 184)  # fractional bits of factors, tried in turn


class Refused(Exception):  # noqa: N818
    """The proof is not valid, with the reason."""


class Unreadable(Exception):  # noqa: N818
    """A file cannot be read, with the reason."""


# --- The plain proof ------------------------------------------------------------------------------

Quaternion = tuple[int, ...]  # x y z w of any norm; in the plane 0 0 sin cos of half the angle


class Edge(NamedTuple):
    """A measurement of node j in the frame of node i; kappa = 0 if of its position alone.

    Under the cost of g2o kappa and tau are 1 otherwise.
    """

    i: int
    j: int
    q: Quaternion
    t: tuple[int, ...]  # empty for rotations alone
    kappa: int
    tau: int
    scale: int = ONE  # of similarities
    information: tuple[int, ...] = ()  # an upper triangle, under the cost of g2o


class Graph(NamedTuple):
    """Edges between nodes 0 ... n-1, and which of these are points."""

    n: int
    edges: list[Edge]
    points: set[int]
    free: set[int] | None = None  # poses of unknown scale; None if it is no graph of similarities
    ids: tuple[int | None, ...] = ()  # by which nodes are called; the world has none

    @property
    def in_mean_unit(self) -> bool:
        """Whether no scale is known, and the cost is F over the mean of their squares."""
        return self.free is not None and len(self.free) + len(self.points) == self.n


class Rejected(NamedTuple):
    """A claim min(f_e, price) >= price - kappa |Q - C|^2 - tau |v - t|^2, see `constant`."""

    edge: int
    price: int
    kappa: int
    tau: int
    C: list[list[int]]
    t: tuple[int, ...]


class Minorant(NamedTuple):
    """A claim f_e >= tau |v - b|^2 + 2 d kappa - 2 <N, Q> + constant, see `minorant_holds`."""

    tau: int
    kappa: int
    constant: int
    arm: tuple[int, ...]  # b
    N: tuple[int, ...]  # row by row
    touching: tuple[int, ...]  # an angle, or a quaternion w x y z and a slope; none of positions


class Within(NamedTuple):
    """How far a node is from where x has it, in any estimate that costs at most the upper bound.

    Seen from the reference: both are compared in the frame of that pose.
    """

    node: int | None  # by its id; None: every node
    metres: Decimal | None  # None: nothing is said
    degrees: Decimal | None  # points have none
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
    """An estimate and what is claimed about it; none of it is trusted."""

    q: list[Quaternion]
    t: list[list[int]]  # empty for rotations alone
    multipliers: list[list[int]]
    order: list[int]
    pin: int
    exponent: int
    rejected: list[Rejected]  # empty but for a truncated cost
    s: list[int]  # ONE but for similarities
    minorants: list[Minorant] = []  # noqa: RUF012  # of all edges, for the cost of g2o


class Plain(NamedTuple):
    """What a plain proof is about, and its proof."""

    sha256: str  # of the graph file
    about: str
    kind: str  # "poses", "rotations" or "similarities"
    d: int
    graph: Graph
    proof: Proof
    within: tuple[Within, ...]


def number(word: str) -> int:
    """The number m 2^e of a word m or mpe."""
    m, _, e = word.partition("p")
    if e and int(e) > ULP:
        raise ValueError("a number beyond doubles")
    return int(m) << (ULP + int(e or 0))


def grouped(words: Sequence[str], *sizes: int) -> list[list[int]]:
    """Numbers, so many in each group."""
    if len(words) != sum(sizes):
        raise ValueError(f"{sum(sizes)} numbers expected, not {len(words)}")
    numbers = map(number, words)
    return [[next(numbers) for _ in range(size)] for size in sizes]


def quaternion(numbers: Sequence[int], d: int) -> Quaternion:
    """The same rotation by small integers."""
    if not any(numbers) or (d == 2 and any(numbers[:2])):
        raise Refused("a rotation is zero, or not in the plane")
    return tuple(trimmed(numbers)[0])


class Lines:
    """The lines of a plain proof, as they are read."""

    def __init__(self) -> None:
        self.said: dict[str, list[str]] = {}
        self.d, self.poses, self.similar, self.full = 0, True, False, False
        self.claims: list[tuple[int | None, Decimal | None, Decimal | None]] = []
        self.ids: list[int | None] = []
        self.points, self.free = set[int](), set[int]()
        self.q: list[Quaternion] = []
        self.t: list[list[int]] = []
        self.multipliers: list[list[int]] = []
        self.s: list[int] = []
        self.edges: list[Edge] = []
        self.rejected: list[Rejected] = []
        self.minorants: list[Minorant] = []

    def add(self, line: str) -> None:
        """One more line."""
        d, poses, similar = self.d, self.d * self.poses, self.similar
        match line.split(" "):
            case ["graph" | "about" | "pin" | "order" as word, *words] if word not in self.said:
                self.said[word] = words
            case ["cost", cost, kind, dimension] if not d:
                self.cost(cost, kind, dimension)
            case ["within", node, metres, degrees] if metres != degrees and not similar:
                claim = None if node == "every" else int(node), distance(metres), distance(degrees)
                if not poses and claim[1]:
                    raise ValueError("rotations have no metres")
                self.claims.append(claim)
            case ["pose", name, *words] if d:
                q, t, Lam = grouped(words, 4, poses, d * (d + 1) // 2)
                self.node(name, q, t, Lam, ONE)
            case ["free", name, *words] if similar:
                q, t, (s,), Lam = grouped(words, 4, d, 1, d * (d + 1) // 2)
                self.free.add(len(self.ids))
                self.node(name, q, t, Lam, s)
            case ["point", name, *words] if poses:
                self.points.add(len(self.ids))
                (t,) = grouped(words, d)
                self.node(name, [0, 0, 0, ONE], t, [0] * (d * (d + 1) // 2), ONE)
            case ["edge" | "position" as what, i, j, *words] if self.full:
                self.informed(int(i), int(j), what == "edge", words)
            case ["minorant", *words] if self.full:
                self.minorant(words)
            case ["edge", i, j, *words] if d:
                (kappa,), tau, q, t, scale = grouped(words, 1, self.poses, 4, poses, similar)
                turn, weight = quaternion(q, d), (*tau, ONE)[0]
                self.edge(Edge(int(i), int(j), turn, (*t,), kappa, weight, (*scale, ONE)[0]))
            case ["position", i, j, *words] if poses:
                (weight,), t, scale = grouped(words, 1, d, similar)
                self.edge(Edge(int(i), int(j), (0, 0, 0, 1), (*t,), 0, weight, (*scale, ONE)[0]))
            case ["rejected", *words] if self.edges and not (similar or self.full):
                (price, kappa), C, tau, t = grouped(words, 2, d * d, self.poses, poses)
                rows = [C[d * a : d * a + d] for a in range(d)]
                e = len(self.edges) - 1
                if self.rejected and self.rejected[-1].edge == e:
                    raise ValueError("a measurement is rejected twice")
                self.rejected.append(Rejected(e, price, kappa, (*tau, 0)[0], rows, (*t,)))
            case _:
                raise ValueError(f"another line expected than {line[:40]!r}")

    def cost(self, cost: str, kind: str, dimension: str) -> None:
        """What the other lines are about."""
        if dimension not in ("2", "3"):
            raise ValueError("2 or 3 dimensions expected")
        kinds = {"chordal": ("poses", "rotations", "similarities"), "g2o": ("poses",)}
        if kind not in kinds.get(cost, ()):
            raise ValueError("the chordal cost expected, or that of g2o for poses")
        self.said["cost"], self.d, self.full = [kind], int(dimension), cost == "g2o"
        self.poses, self.similar = kind != "rotations", kind == "similarities"

    def node(self, name: str, q: list[int], t: list[int], Lam: list[int], s: int) -> None:
        """One more node."""
        if s <= 0:
            raise ValueError("a scale that is not positive")
        self.ids.append(None if name == "world" else int(name))
        self.q.append(quaternion(q, self.d))
        self.t += [t] * self.poses
        self.multipliers.append(Lam)
        self.s.append(s)

    def edge(self, edge: Edge) -> None:
        """One more measurement, after all nodes."""
        n = len(self.ids)
        if not (0 <= edge.i < n and 0 <= edge.j < n and edge.i != edge.j):
            raise ValueError("a measurement between two nodes expected")
        if edge.i in self.points or (edge.kappa and edge.j in self.points):
            raise ValueError("a point, which has no rotation, measures or is turned")
        if edge.kappa < 0 or min(edge.tau, edge.scale) <= 0:
            raise ValueError("a weight or scale that is not positive")
        self.edges.append(edge)

    def informed(self, i: int, j: int, turned: bool, words: list[str]) -> None:
        """One more measurement under the cost of g2o."""
        d = self.d
        p = 3 * d - 3 if turned else d
        q, t, upper = grouped(words, 4 * turned, d, p * (p + 1) // 2)
        turn = quaternion(q, d) if turned else (0, 0, 0, 1)
        self.edge(Edge(i, j, turn, (*t,), ONE * turned, ONE, ONE, (*upper,)))

    def minorant(self, words: list[str]) -> None:
        """What is claimed about the last measurement."""
        d, turned = self.d, bool(self.edges and self.edges[-1].kappa)
        if len(self.minorants) != len(self.edges) - 1:
            raise ValueError("one minorant after each measurement expected")
        if turned:
            scalars, b, N, touching = grouped(words, 3, d, d * d, 1 if d == 2 else 5)
        else:
            (tau, constant), b = grouped(words, 2, d)
            scalars, N, touching = [tau, 0, constant], [0] * (d * d), []
        tau, kappa, constant = scalars
        self.minorants.append(Minorant(tau, kappa, constant, (*b,), (*N,), (*touching,)))


def distance(word: str) -> Decimal | None:
    """A positive number of metres or degrees, or none."""
    if word == "-":
        return None
    x = Decimal(word)
    if not (len(word) < 500 and Decimal("1e-120") < x < Decimal("1e120")):
        raise ValueError("a distance out of range")
    return x


def read(text: str) -> Plain:
    """A plain proof."""
    lines, first = Lines(), "certpgo plain proof 1\n"
    if not text.startswith(first) or not text.endswith("\n"):
        raise Unreadable("not a plain proof of version 1, or not all of it")
    at = 1
    try:
        for line in text[len(first) : -1].split("\n"):
            at += 1
            lines.add(line)
        (kind,), (pin, exponent) = lines.said["cost"], map(int, lines.said["pin"])
        (sha256,), order = lines.said["graph"], [*map(int, lines.said["order"])]
        about = " ".join(lines.said["about"])
    except (ValueError, ArithmeticError, KeyError) as error:
        raise Unreadable(f"line {at}: {error}") from None
    n = len(lines.ids)
    if not lines.edges or sorted(order) != [*range(n)]:
        raise Refused("order is no permutation of the nodes, or nothing is measured")
    if not (0 <= pin < n and abs(exponent) <= 300):
        raise Refused("pin or exponent out of range")
    if lines.full and len(lines.minorants) != len(lines.edges):
        raise Refused("a measurement without a minorant")
    free = lines.free if lines.similar else None
    graph = Graph(n, lines.edges, lines.points, free, tuple(lines.ids))
    hints = order, pin, exponent
    claims = lines.rejected, lines.s, lines.minorants
    proof = Proof(lines.q, lines.t, lines.multipliers, *hints, *claims)
    within = tuple(Within(*claim, graph.ids[pin]) for claim in lines.claims)
    return Plain(sha256, about, kind, lines.d, graph, proof, within)


# --- Numbers --------------------------------------------------------------------------------------


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


def conjugate(q: Quaternion) -> Quaternion:
    """The quaternion of R(q)^T."""
    x, y, z, w = q
    return -x, -y, -z, w


def matrix(q: Quaternion, d: int) -> list[list[int]]:
    """|q|^2 times the rotation: that of v -> q v q*."""
    x, y, z, w = q
    same, cross = w * w - x * x - y * y - z * z, ((0, -z, y), (z, 0, -x), (-y, x, 0))
    return [
        [2 * (q[a] * q[b] + w * cross[a][b]) + same * (a == b) for b in range(d)] for a in range(d)
    ]


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

    The sum of tr(Lam), and what rejected measurements or minorants add. A trace counts s^2 times:
    at unknown scales it must not be negative, and if all are unknown, the least counts for each.
    """
    traces = [sum(row[k] for k in ((0, 2), (0, 3, 5))[d - 2]) for row in proof.multipliers]
    if graph.in_mean_unit:
        total = min(traces[k] for k in graph.free or ()) * len(graph.free or ())
    elif graph.free and any(traces[k] < 0 for k in graph.free):
        raise Refused("the trace of a multiplier of an unknown scale is negative")
    else:
        total = sum(x for k, x in enumerate(traces) if k not in (graph.free or ()))
    total += sum(given.constant for given in proof.minorants)
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


# --- The cost of g2o ------------------------------------------------------------------------------

Matrix = list[list[int]]
BITS = 320  # fractional bits of angles, cosines and sines
OFF = 1 << 32  # what cosines and sines are off by at most, in units of 2^-BITS


def symmetric(upper: Sequence[int], n: int) -> Matrix:
    """The n x n matrix of an upper triangle, row by row."""
    numbers, A = iter(upper), [[0] * n for _ in range(n)]
    for a in range(n):
        for b in range(a, n):
            A[a][b] = A[b][a] = next(numbers)
    return A


def parts(A: Matrix, d: int) -> tuple[Matrix, Matrix, Matrix]:
    """T, P^T and W of an information [[T, P], [P^T, W]], translation first."""
    return [row[:d] for row in A[:d]], [row[:d] for row in A[d:]], [row[d:] for row in A[d:]]


def times(A: Iterable[Sequence[int]], x: Sequence[int]) -> list[int]:
    """A x."""
    return [sum(map(mul, row, x)) for row in A]


def inner(x: Sequence[int], y: Sequence[int]) -> int:
    """x.y."""
    return sum(map(mul, x, y))


def cofactors(M: Matrix) -> Matrix:
    """Those of a 3 x 3 matrix."""
    return [
        [M[a - 2][b - 2] * M[a - 1][b - 1] - M[a - 2][b - 1] * M[a - 1][b - 2] for b in range(3)]
        for a in range(3)
    ]


def adjugate(A: Matrix) -> Matrix:
    """That of a symmetric matrix, 2 x 2 or 3 x 3."""
    return cofactors(A) if len(A) == 3 else [[A[1][1], -A[0][1]], [-A[0][1], A[0][0]]]


def is_definite(A: Matrix) -> bool:
    """Whether a symmetric matrix is positive definite, by elimination without fractions (Bareiss).

    Entries of more than 400 bits are rounded down to fewer, which takes less than n from x.A x, and
    n from the diagonal makes up for that: such a matrix might be refused wrongly.
    """
    n, by = len(A), max(x.bit_length() for row in A for x in row) - 400
    by = max(by, 0)
    A = [
        [(x >> by) - n * (by > 0 and r == s) for s, x in enumerate(row)] for r, row in enumerate(A)
    ]
    last = 1
    for k, row in enumerate(A):
        pivot = row[k]
        if pivot <= 0:
            return False
        for r in range(k + 1, n):
            first, other = row[r], A[r]
            for s in range(r, n):
                other[s] = (pivot * other[s] - first * row[s]) // last
        last = pivot
    return True


@cache
def is_information(upper: tuple[int, ...], n: int) -> bool:
    """Whether the n x n matrix of an upper triangle is positive definite."""
    return is_definite(symmetric(trimmed(upper)[0], n))


def g2o_cost(graph: Graph, proof: Proof, d: int) -> Fraction:
    """f(x) = sum e^T Omega e, each term rounded up to a multiple of 2^-FINE.

    e = (y, x) with y = R_ij^T (R_i^T (t_j - t_i) - t_ij), and x the angle of E = R_ij^T R_i^T R_j,
    or the vector part of its unit quaternion (w, x), w >= 0. Where E turns by pi, f takes two
    values, of which the larger counts.
    """
    back = [[*zip(*matrix(q, d), strict=True)] for q in proof.q]  # |q|^2 R^T
    norms, total = [norm(q) for q in proof.q], 0
    (_, *flat), unit = trimmed([ONE, *chain(*proof.t, *(edge.t for edge in graph.edges))])
    t = [flat[k : k + d] for k in range(0, len(flat), d)]
    for edge, step in zip(graph.edges, t[graph.n :], strict=True):
        i, j, q, *_ = edge
        (_, *upper), e = trimmed([ONE, *edge.information])
        T, PT, W = parts(symmetric(upper, 3 * d - 3 if edge.kappa else d), d)
        v = times(back[i], [b - a for a, b in zip(t[i], t[j], strict=True)])
        v = [x - norms[i] * s for x, s in zip(v, step, strict=True)]
        # y is this over D, and x an enclosed vector over another integer.
        y, D = times(zip(*matrix(q, d), strict=True), v), norms[i] * norm(q) << unit
        ends, C = [[0] * len(W)], 1
        if edge.kappa:
            between = product(conjugate(q), product(conjugate(proof.q[i]), proof.q[j]))
            ends, C = angles(between) if d == 2 else vector_parts(between)
        # Of a convex function the largest value in an interval is that at one of its ends.
        largest = max(
            inner(y, times(T, y)) * C * C
            + 2 * inner(times(PT, y), x) * C * D
            + inner(x, times(W, x)) * D * D
            for x in ends
        )
        total -= (-largest << FINE) // ((C * D) ** 2 << e)
    return Fraction(total, 1 << FINE)


def vector_parts(q: Quaternion) -> tuple[Matrix, int]:
    """Two ends x/C, and C, between which is the vector part of a unit quaternion (w, x), w >= 0."""
    *x, w = q if q[3] >= 0 else (-a for a in q)
    n = norm(q)
    root = isqrt(n << 2 * BITS)  # 1/|q| is in [root, root + 1] / (n 2^BITS)
    ends = [[a * r for a in x] for r in (root, root + 1)]
    return ends + [[-a for a in x] for x in ends] * (w == 0), n << BITS


def angles(q: Quaternion) -> tuple[Matrix, int]:
    """Two ends x/C, and C, between which is the angle of a rotation in the plane."""
    _, _, s, c = q if q[3] >= 0 else (-a for a in q)
    half = angle(abs(s), c)
    ends = [2 * half - 4, 2 * half + 4]
    ends = [-x for x in ends] if s < 0 else ends
    return [[x] for x in ends + [-x for x in ends] * (c == 0)], 1 << BITS


def angle(s: int, c: int) -> int:
    """Of the direction (c, s), both >= 0, within 2 units of 2^-BITS.

    It is halved eight times: c + |(c, s)| and s have half the angle of c and s.
    """
    fine = BITS + 64
    if s > c:
        return (quarter_turn(fine) >> 64) - angle(c, s)
    by = fine - c.bit_length()
    s, c = shifted(s, by), shifted(c, by)
    for _ in range(8):
        c += isqrt(c * c + s * s)
    x = (s << fine) // c  # the tangent
    total, power, k = 0, x, 1
    while power:
        total += (2 - k % 4) * (power // k)
        power, k = power * x * x >> 2 * fine, k + 2
    return total >> (64 - 8)


def minorant_holds(edge: Edge, given: Minorant, d: int) -> bool:
    """Whether Omega is definite, and f_e >= tau |v - b|^2 + 2 d kappa - 2 <N, Q> + c everywhere.

    That is for all v and rotations Q. With E = R_ij^T Q, x of E as in `g2o_cost`, A = T - tau I and
    y = R_ij^T (b - t_ij), the least value over v of f_e - tau |v - b|^2 is x.S x + 2 beta.x + gamma
    with S = W - P^T A^-1 P, beta = -tau P^T A^-1 y, gamma = -tau |y|^2 - tau^2 y.A^-1 y.
    """
    (_, tau, *upper), e = trimmed([ONE, given.tau, *edge.information])
    turned = edge.kappa != 0
    Omega = symmetric(upper, 3 * d - 3 if turned else d)
    T, PT, W = parts(Omega, d)
    A = [[x - tau * (a == b) for b, x in enumerate(row)] for a, row in enumerate(T)]
    if not is_information(edge.information, len(Omega)):
        return False
    if not turned and given.arm == edge.t:
        return given.constant <= 0 and (not any(map(any, A)) or is_definite(A))
    if not is_definite(A):
        return False
    numbers = [given.kappa, given.constant, *given.touching, *given.arm, *edge.t, *given.N]
    (_, kappa, constant, *numbers), g = trimmed([ONE, *numbers])
    touching, numbers = numbers[: len(given.touching)], numbers[len(given.touching) :]
    b, t, N = numbers[:d], numbers[d : 2 * d], numbers[2 * d :]
    back, D = [*zip(*matrix(edge.q, d), strict=True)], norm(edge.q)
    y, inverse = times(back, [p - q for p, q in zip(b, t, strict=True)]), adjugate(A)
    det, PA = inner(A[0], inverse[0]), [times(inverse, row) for row in PT]
    gamma = -tau * (det * inner(y, y) + tau * inner(y, times(inverse, y)))
    wanted = (2 * d * kappa + constant) * det * D * D
    if not turned:
        return gamma >= wanted << (e + g)
    S = [[det * x for x in row] for row in W]
    S = [
        [x - inner(q, r) for x, r in zip(row, PT, strict=True)]
        for row, q in zip(S, PA, strict=True)
    ]
    beta = [-tau * inner(row, y) for row in PA]
    turned_N = [[inner(row, N[k::d]) for k in range(d)] for row in back]
    residual = Residual(S, beta, gamma, turned_N, wanted, det, D, e, g)
    if d == 3:
        return spatial_holds(residual, touching)
    sizes = (max(x.bit_length() for x in numbers) for numbers in (chain(*Omega), N))
    return planar_holds(residual, touching[0], 200 - max(map(sub, sizes, (e, g))))


class Residual(NamedTuple):
    """x.S x + 2 beta.x + gamma + 2 <N, E> >= wanted, to be shown for all rotations E."""

    S: Matrix  # over det, in units of 2^-e
    beta: list[int]  # over det D, 2^-(e + g)
    gamma: int  # over det D^2, 2^-(e + 2g)
    N: Matrix  # over D, 2^-g
    wanted: int  # over det D^2, 2^-g
    det: int
    D: int
    e: int
    g: int


def spatial_holds(given: Residual, touching: list[int]) -> bool:
    """Whether it holds for all unit quaternions q = (w, x), w >= 0.

    For w0 >= 0, |q0| <= 1 and k >= |k x0 + l|, l.x >= (q.q0) (l.x) - k + k (q.q0)^2. So it is
    enough that a quadratic form in q is positive: here in units of 2^-(e + 3g), over det D^2.
    """
    S, beta, gamma, N, wanted, det, D, e, g = given
    *q0, k = touching
    if any(beta):  # l = 2 beta
        needed = [(k * x * det * D << e) + (2 * y << g) for x, y in zip(q0[1:], beta, strict=True)]
        steep = norm(needed) <= (k * det * D << (e + g)) ** 2
        if min(q0[0], k) < 0 or norm(q0) > 1 << 2 * g or not steep:
            return False
    else:
        k = 0
    trace, D2 = N[0][0] + N[1][1] + N[2][2], D * D
    z = [0, N[2][1] - N[1][2], N[0][2] - N[2][0], N[1][0] - N[0][1]]
    half = [0, *(x * D << g for x in beta)]
    rest = (wanted + k * det * D2 << e + 2 * g) - (gamma << g)
    form = [[0] * 4 for _ in range(4)]
    for r in range(4):
        for s in range(4):
            turned = z[r + s] if r * s == 0 else N[r - 1][s - 1] + N[s - 1][r - 1]
            if r == s:
                turned = trace if r == 0 else turned - trace
            form[r][s] = (2 * det * D * turned << e + 2 * g) - rest * (r == s)
            form[r][s] += S[r - 1][s - 1] * D2 << 3 * g if r * s else 0
            form[r][s] += q0[r] * half[s] + q0[s] * half[r] + (k * q0[r] * q0[s] * det * D2 << e)
    return is_definite(form)


def planar_holds(given: Residual, alpha: int, unit: int) -> bool:
    """Whether it holds for all angles x, shown in units of 2^-unit.

    With h = beta/s and phi = x + h the sum is s phi^2 + 2 a cos(phi) + 2 b sin(phi) + gamma -
    beta^2/s, and phi^2 >= alpha^2 + 2 r (cos(alpha) - cos(phi)) with r = alpha / sin(alpha): phi^2
    is convex in cos(phi) up to pi.
    """
    ((s,),), (beta,), gamma, N, wanted, det, D, e, g = given
    if s <= 0:
        return False
    least = (wanted * s << (e + g)) - gamma * s + beta * beta
    needed = -(shifted(-least, unit - e - 2 * g) // (det * D * D * s))
    h, alpha = shifted(beta, BITS - g) // (D * s), shifted(alpha, BITS - g)
    u, v = (shifted(x, unit - g) // D for x in (N[0][0] + N[1][1], N[1][0] - N[0][1]))
    s = shifted(s, unit - e) // det
    if not (abs(h) < 8 << BITS and 0 <= alpha < 4 << BITS and max(s, abs(u), abs(v)) < 1 << 220):
        return False
    (c, n), (cosine, sine) = circle(abs(h), BITS), circle(alpha, BITS)
    n = n if h >= 0 else -n
    a, b = (u * c - v * n) >> BITS, (u * n + v * c) >> BITS
    low, high = 1 << BITS, 1 << BITS  # r
    if alpha:
        if sine <= 2 * OFF:
            return False
        low, high = (alpha << BITS) // (sine + OFF), (alpha << BITS) // (sine - OFF) + 1
    ends = s * low >> BITS, ((s + 1) * high >> BITS) + 1  # of p = s r
    if ends[1] >> 240:
        return False
    lowest = min(2 * (p * cosine >> BITS) - 2 * abs(a - p) for p in ends)  # concave in p
    return (s * alpha * alpha >> 2 * BITS) + lowest - 2 * abs(b) - 24 >= needed


# --- The certificate matrix -----------------------------------------------------------------------

Entries = dict[tuple[int, int], int]
Block = tuple[int, int, list[list[int]], int]  # N/D from a row and a column


def certificate_matrix(
    graph: Graph, proof: Proof, d: int, at: dict[int, int], turn: dict[int, int]
) -> tuple[Entries, list[Block], int]:
    """A = M - Lam in units of 2^-unit: entries of rows r <= s, blocks -kappa R_ij to add, and unit.

    Node k has rows at[k], its position (-1: the pinned one), and turn[k] ..., its rotation.
    """
    terms = [(e.i, e.j, matrix(e.q, d), norm(e.q), e.t, e.kappa, e.tau) for e in graph.edges]
    for k, given in enumerate(proof.minorants):
        N = [[*given.N[d * a : d * a + d]] for a in range(d)]
        terms[k] = (*terms[k][:2], N, ONE, given.arm, given.kappa, given.tau)
    for cut in proof.rejected:
        i, j, *_ = terms[cut.edge]
        terms[cut.edge] = (i, j, cut.C, ONE, cut.t, -cut.kappa, -cut.tau)
    taus, tau_unit = trimmed([weight for term in terms for weight in term[5:]])
    (_, *scales), fine = trimmed([ONE, *(edge.scale for edge in graph.edges)])
    steps, step_unit = trimmed([ONE, *(x for term in terms for x in term[4])])
    Lams, Lam_unit = trimmed([x for row in proof.multipliers for x in row])
    unit, size = max(tau_unit + 2 * max(step_unit, fine), Lam_unit, 0), d * (d + 1) // 2
    A: Counter[tuple[int, int]] = Counter()
    blocks = []
    for k, (i, j, N, D, *_) in enumerate(terms):
        kappa, tau = (weight << (unit - tau_unit) for weight in taus[2 * k : 2 * k + 2])
        if graph.edges[k].kappa:
            across = (kappa >> fine) * scales[k]
            own = (across >> fine) * scales[k]
            if proof.minorants:  # N itself
                own, across = kappa, 1 << unit
            blocks.append((turn[i], turn[j], [[-across * x for x in row] for row in N], D))
            for row, weight in ((turn[i], own), (turn[j], kappa)):
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


def turns_less(G: Matrix, square: Fraction, degrees: Fraction) -> bool:
    """Whether rotations differ by no more than an angle, G being their block and rho^2 = square.

    If V is the difference of two rotations by theta, V^T V = 2 (1 - cos(theta)) (I - n n^T), n the
    axis, or 0 in the plane. So with H = G^-1, its cofactors over the determinant, tr(V H V^T) <=
    rho^2 is 2 (1 - cos(theta)) (tr(H) - n.H n) <= rho^2: impossible beyond the angle if
    tr(H) I - H exceeds rho^2 / (2 (1 - cos(angle))) I.
    """
    bits = 320
    x = degrees.numerator * quarter_turn(bits) // (90 * degrees.denominator)
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
        metres, degrees = (None if x is None else Fraction(x) for x in claim[1:3])
        for k in (k for k in G if claim.node in (None, graph.ids[k])):
            far = metres is not None and square * G[k][0][0] > metres**2
            if degrees is not None and degrees != 180 and k not in graph.points:
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
    for k, (edge, minorant) in enumerate(
        zip(graph.edges, proof.minorants, strict=bool(proof.minorants))
    ):
        if not minorant_holds(edge, minorant, d):
            raise Refused(f"the minorant of measurement {k} was not proven, or that f is convex")
    upper = (g2o_cost if proof.minorants else upper_bound)(graph, proof, d)
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
        given = *scaled(A, blocks, unit, scale, 2 * bits), tree, v, bits
        if is_positive_semidefinite(*given, columns=columns if claims else None):
            break
    else:
        raise Refused("the certificate matrix was not proven positive semidefinite")
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
    """Check a proof about a graph file; raises `Refused` or `Unreadable`.

    Both are read by integer_reader.py, in the folder or the package of this file.
    """
    name = "integer_reader"
    if not __package__:
        sys.path.insert(0, str(Path(__file__).parent))  # which PYTHONSAFEPATH leaves out
    reader: Any = import_module(f"{__package__}.{name}" if __package__ else name)
    try:
        text = reader.plain(graph_path, proof_path)
    except reader.Refused as reason:
        raise Refused(str(reason)) from None
    except reader.Unreadable as error:
        raise Unreadable(str(error)) from None
    return checked(read(text))


def checked(plain: Plain) -> Answer:
    """What is proven."""
    bounds = prove(plain.graph, plain.proof, plain.d, plain.within)
    return Answer(*bounds, plain.about, plain.within)


def main(arguments: list[str]) -> int:
    """Print what is proven; exit codes: 0 proved, 6 refused, 1 unreadable, 2 usage error."""
    if len(arguments) not in (1, 2):
        sys.stderr.write("usage: integer_checker.py PLAIN, or GRAPH PROOF\n")
        return 2
    try:
        if len(arguments) == 1:
            answer = checked(read(Path(arguments[0]).read_text()))
        else:
            answer = check(*arguments)
        lines = [f"{answer}", f"about {answer.about}", *map(str, answer.within)]
        sys.stdout.write("\n".join(lines) + "\n")
    except Refused as reason:
        sys.stdout.write(f"REFUSED: {reason}\n")
        return 6
    except (Unreadable, OSError, UnicodeDecodeError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

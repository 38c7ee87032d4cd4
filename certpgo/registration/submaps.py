"""Sub-maps and scans of unknown scale, brought into one frame and unit by matched points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, GraphError, InputError
from certpgo.graph import Estimate, Instance
from certpgo.graph.edges import components_of
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.moments import Matches, matched_graph
from certpgo.registration.ransac import RansacSettings, refine, register
from certpgo.registration.scans import Scan
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.reweighing import reweigh

#: Standard deviation of matched points at first, over the median distance from their middle; and
#: at least, as coordinates are rounded.
NOISE, ROUNDED = 0.01, 1e-9
#: When two scans match: their points were matched by others.
SETTINGS = RansacSettings(matches=6, inliers=6)
#: What a line of matches has.
LINE = "SCAN POINT SCAN POINT, with points numbered from 0"


@dataclass(frozen=True, eq=False)
class ScanMatches:
    """Points of two scans that are said to be the same.

    Attributes
    ----------
    i, j : numbers of the scans
    rows : (k, 2) numbers of the points, of i and of j
    """

    i: int
    j: int
    rows: IntArray


@dataclass(frozen=True, eq=False)
class SubmapRegistration:
    """Scans in one frame and unit.

    Attributes
    ----------
    estimate : a pose and a scale for each scan, p_world = s R p + t; the first scan stays as it is
    pairs : the matches that agree with one similarity of their two scans
    total : (m,) how many matches each of these pairs had
    left_out : pairs of scans whose matches agree with none
    residuals : (m,) how far apart the matches of each pair are at the estimate, root mean square,
        over the noise that the pair alone shows; about 1 where pairs agree with one another
    instance : the graph of which the certificate is: scans, and points that stand for matches
    solution : its certified solution
    """

    estimate: Estimate
    pairs: tuple[Matches, ...]
    total: IntArray
    left_out: tuple[tuple[int, int], ...]
    residuals: FloatArray
    instance: Instance
    solution: CertifiedSolution


def register_submaps(scans: Sequence[Scan], matches: Sequence[ScanMatches]) -> SubmapRegistration:
    """Bring scans of unknown scale into one frame and unit, by matched points.

    Of each pair of scans, RANSAC finds the similarity with which most matches agree. These matches
    make the cost, sum |s_i R_i p + t_i - s_j R_j q - t_j|^2 over their variances, which are those
    that each pair shows, in the units of its scans. It is solved and certified by
    `certpgo.reweigh`: the certificate is about the last weights, and the matches that agree in
    pairs.

    Parameters
    ----------
    scans : two or more, each in a frame and unit of its own
    matches : of pairs of scans, some of which may be wrong

    Raises
    ------
    GraphError
        A scan is joined to no others; it is named.
    InputError
        Fewer than two scans.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.registration.scans import Scan
    >>> from certpgo.registration.submaps import ScanMatches, register_submaps
    >>> points = np.random.default_rng(0).standard_normal((50, 3))
    >>> scans = [Scan("one", points), Scan("twice", 2.0 * points + [1.0, 0.0, 0.0])]
    >>> same = np.repeat(np.arange(50)[:, None], 2, axis=1)
    >>> found = register_submaps(scans, [ScanMatches(0, 1, same)])
    >>> found.solution.verdict.value, found.estimate.scales.round(6).tolist()
    ('CERTIFIED', [1.0, 0.5])
    """
    if len(scans) < 2:
        raise InputError("registration needs two or more scans")
    pairs, total, left_out = list[Matches](), list[int](), dict[tuple[int, int], int]()
    for pair in matches:
        p, q = scans[pair.i].points[pair.rows[:, 0]], scans[pair.j].points[pair.rows[:, 1]]
        agreeing = _agreeing(pair.i, pair.j, p, q)
        if agreeing is None:
            left_out[pair.i, pair.j] = len(p)
            continue
        pairs.append(agreeing)
        total.append(len(p))
    _refuse_apart([scan.name for scan in scans], pairs, left_out)
    n = len(scans)
    graph = matched_graph(n, pairs)
    found = reweigh(graph)
    whole = found.estimate
    estimate = whole.subset(np.arange(n)).anchored(0)
    instance = Instance("scans", found.graph, np.arange(graph.num_nodes))
    residuals = np.array([_residual(pair, estimate) for pair in pairs])
    return SubmapRegistration(
        estimate,
        tuple(pairs),
        np.array(total),
        tuple(left_out),
        residuals,
        instance,
        found.answer,
    )


def _agreeing(i: int, j: int, p: FloatArray, q: FloatArray) -> Matches | None:
    """The matches that agree with one similarity, and their noise; None if too few do."""
    if len(p) < SETTINGS.matches:
        return None
    sigma = np.array([NOISE * _size(points) for points in (p, q)])
    if not sigma.all():
        return None
    first = register(
        p, q, _noise(sigma, len(p)), np.random.default_rng([i, j]), SETTINGS, scaled=True
    )
    if first is None:
        return None
    # Once more with the noise that the matches show.
    sigma = sigma * max(np.sqrt(first.chi2), ROUNDED)
    start = first.R, first.t, first.scale
    motion = refine(p, q, _noise(sigma, len(p)), start, SETTINGS, scaled=True)
    if motion is None:
        return None
    chosen = motion.inliers
    return Matches(i, j, p[chosen], q[chosen], (float(sigma[0]), float(sigma[1])))


def _size(points: FloatArray) -> float:
    """The median distance from the middle."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _noise(sigma: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Covariances (k, 3, 3) of the points of both scans."""
    first, second = (np.tile(s**2 * np.eye(3), (k, 1, 1)) for s in sigma)
    return first, second


def _residual(pair: Matches, estimate: Estimate) -> float:
    """How far apart matches are at an estimate, over their noise, root mean square."""
    R, t, s = estimate.rotations, estimate.translations, estimate.scales
    if t is None or s is None:
        raise InputError("an estimate of scans of unknown scale has positions and scales")
    (i, j), (a, b) = (pair.i, pair.j), pair.sigma
    off = s[i] * pair.p @ R[i].T + t[i] - s[j] * pair.q @ R[j].T - t[j]
    variance = (s[i] * a) ** 2 + (s[j] * b) ** 2
    return float(np.sqrt(np.mean(off**2) / variance))


def _refuse_apart(
    names: Sequence[str], pairs: Sequence[Matches], left_out: dict[tuple[int, int], int]
) -> None:
    """Refuse scans that no chain of pairs joins to the first one.

    Parameters
    ----------
    left_out : how many matches the pairs have of which too few agree
    """
    ends = np.array([(pair.i, pair.j) for pair in pairs], dtype=np.intp).reshape(-1, 2)
    part = components_of(len(names), ends)
    apart = next((k for k in range(len(names)) if part[k] != part[0]), None)
    if apart is None:
        return
    out_of_it = {
        count: (i, j)
        for (i, j), count in left_out.items()
        if (part[i] == part[apart]) != (part[j] == part[apart])
    }
    least, most = SETTINGS.inliers, max(out_of_it, default=0)
    why = f"no {least} matches that agree join it to {names[0]}"
    if not out_of_it:
        why = f"no matches join it to {names[0]}"
    elif most < least:
        i, j = (names[k] for k in out_of_it[most])
        few = counted(most, "matched point{s}")
        why = f"{few} of {i} and {j} are too few, {least} that agree are needed"
    raise GraphError(f"{names[apart]}: {why}")


def read_matches(path: str | Path, scans: Sequence[Scan]) -> list[ScanMatches]:
    """Read matched points of scans: lines of a scan's name, a point, another scan's name, a point.

    Points are numbered from 0, in the order of the scan's file, of which points that are not finite
    are not counted. What follows # is a comment.

    Raises
    ------
    FormatError
        A line does not follow that, or names a scan or point that there is not.
    InputError
        The file cannot be read, or two scans have one name.
    """
    path, number_of = Path(path), {scan.name: k for k, scan in enumerate(scans)}
    if len(number_of) < len(scans):
        raise InputError(f"{path}: matches name scans by their files, but two have one name")
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise FormatError(path, None, f"text expected: lines {LINE}") from None
    found: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for line, content in enumerate(text.splitlines(), 1):
        words = content.partition("#")[0].split()
        if not words:
            continue
        if len(words) != 4 or not (words[1].isdecimal() and words[3].isdecimal()):
            raise FormatError(path, line, f"{LINE} expected")
        ends = []
        for name, point in (words[:2], words[2:]):
            if name not in number_of:
                raise FormatError(path, line, f"no scan {name}")
            last = len(scans[number_of[name]].points) - 1
            if int(point) > last:
                raise FormatError(path, line, f"{name} has points 0 to {last}, no {point}")
            ends.append((number_of[name], int(point)))
        (i, a), (j, b) = sorted(ends)
        if i == j:
            raise FormatError(path, line, "points of two scans expected")
        found.setdefault((i, j), []).append((a, b))
    if not found:
        raise FormatError(path, None, f"no matches: lines {LINE} expected")
    return [ScanMatches(i, j, np.array(rows)) for (i, j), rows in sorted(found.items())]

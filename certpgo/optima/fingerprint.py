"""What identifies a problem: a digest of its measurements, however they are written.

Two graphs have the same digest under a cost if they state the same measurements: the same nodes by
the order of their ids, the same ordered pairs, and numbers that agree to nine digits. The order of
lines, comments, the format of the file, how numbers are written, the initial estimate and what ids
are called beyond their order do not count. The direction of an edge counts, as (i, j) and (j, i)
weigh translations in different frames; that of a distance does not. Of similarities, measured
scales count, and which poses have an unknown one.

Under F the weights kappa, tau and what goes with them count, under the costs of other programs the
information matrices. So reading options that change these change the digest.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from certpgo.graph import Graph, Instance
from certpgo.graph.dataset import graph_of
from certpgo.graph.information import Information
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.costs import CHORDAL

#: Fractional bits of the entries of rotations, and significant bits of other numbers: libraries
#: differ in the last bits of sines and inverses, which nearly never reach these.
BITS = 32
#: Version of the digest: part of what is hashed.
VERSION = 1

Rows = npt.NDArray[np.uint64]


@dataclass(frozen=True)
class Fingerprint:
    """Digests of a problem, SHA-256 in hexadecimal.

    Attributes
    ----------
    digest : of its numbers to nine digits, by which it is recognised
    exact : of the numbers that its file states, to the last bit: only problems that agree in it
        have bounds in common without any allowance
    """

    digest: str
    exact: str


def fingerprint(graph: Graph | Instance, cost: str = CHORDAL) -> Fingerprint | None:
    """The digests of a problem; None without its cost's information, or with other kinds of nodes.

    Parameters
    ----------
    graph : the measurements, or the instance that was read
    cost : ``"chordal"``, or one of `certpgo.objective.costs`, which need information

    Examples
    --------
    The order of the measurements does not count:

    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> graph = winding_cycle(5, 0.1, 0)[0].graph
    >>> fingerprint(graph) == fingerprint(graph.with_edges([4, 2, 0, 1, 3]))
    True
    >>> fingerprint(graph) == fingerprint(graph.with_weights(2.0))
    False
    """
    measured = graph_of(graph)
    ranges = measured.ranges
    if len(measured.blocks) > (ranges is not None) or measured.has_others:
        return None
    stated = None if measured.information is None else _upper(measured.information)
    if cost == CHORDAL:
        weights = _weights(measured)
    elif stated is None or not measured.has_positions:
        return None
    else:
        weights = np.column_stack([stated, _measures(measured)])
    header = {
        "version": VERSION,
        "kind": measured.kind,
        "d": measured.d,
        "nodes": measured.num_nodes,
        "points": np.flatnonzero(measured.is_point).tolist(),
        "weights": "kappa, tau" if cost == CHORDAL else "information",
    }
    if measured.has_scales:
        header["free"] = np.flatnonzero(measured.free).tolist()
    turns, numbers = _turns(measured), np.column_stack([_translations(measured), weights])
    follow = cost == CHORDAL and stated is not None and weights.shape[1] == 2
    tables = [_rows(measured.edges, turns, numbers, stated if follow else None)]
    if ranges is not None:
        of_ranges = np.column_stack([ranges.distances, ranges.weights])
        pairs = np.sort(ranges.edges, axis=1)
        tables.append(_rows(pairs, np.empty((ranges.num_edges, 0)), of_ranges))
    rounded, whole = zip(*tables, strict=True)
    return Fingerprint(_digest(header, rounded), _digest(header, whole))


def _turns(graph: Graph) -> FloatArray:
    """(m, 2 or 9) what determines measured rotations: in the plane, cosine and sine."""
    R = graph.rotations
    return np.asarray(R[:, :, 0] if R.shape[1] == 2 else R.reshape(-1, 9))


def _translations(graph: Graph) -> FloatArray:
    """(m, 0, d or 2 d) translations, and arms where there are any."""
    if not graph.has_positions:
        return np.empty((graph.num_edges, 0))
    if graph.arms is None:
        return graph.translations
    return np.column_stack([graph.translations, graph.arms])


def _weights(graph: Graph) -> FloatArray:
    """(m, k) weights of F, and scales."""
    columns = [graph.kappa]
    if graph.has_positions:
        columns.append(graph.tau)
    if graph.has_scales:
        columns.append(graph.scales)
    if graph.couplings is not None:
        columns.append(graph.couplings.reshape(graph.num_edges, -1))
    return np.column_stack(columns)


def _upper(information: Information) -> FloatArray:
    """(m, p (p + 1) / 2) upper triangles of information matrices."""
    rows, columns = np.triu_indices(information.distinct.shape[1])
    return np.asarray(information.distinct[:, rows, columns][information.index]) + 0.0


def _measures(graph: Graph) -> BoolArray:
    """(m, 2) whether edges measure a rotation, and a translation."""
    return np.column_stack([graph.measures_rotation, graph.measures_translation])


def _rows(
    edges: IntArray, turns: FloatArray, numbers: FloatArray, stated: FloatArray | None = None
) -> tuple[Rows, Rows]:
    """The bits of a row per measurement, rounded and whole, in an order that contents decide.

    Weights that follow from information ``stated`` in a file count as that, to the last bit.
    """
    k, spare = turns.shape[1], np.uint64(52 - BITS)
    entries = np.column_stack([edges, turns, numbers])
    entries += 0.0  # no -0
    whole = entries.view(np.uint64)
    near = entries.copy()
    near[:, 2 : k + 2] = np.rint(np.ldexp(turns, BITS)) + 0.0
    rounded = near.view(np.uint64)
    # Carries into the exponent are what they should be.
    half = np.uint64(1) << (spare - np.uint64(1))
    rounded[:, k + 2 :] = ((rounded[:, k + 2 :] + half) >> spare) << spare
    # Any order does that depends on contents alone, so one sum per row is sorted, not all columns.
    odd = np.cumprod(np.full(rounded.shape[1], 0x9E3779B97F4A7C15, dtype=np.uint64))
    order = np.argsort(rounded @ odd, kind="stable")
    if stated is not None:
        whole = np.column_stack([whole[:, :-2], rounded[:, -2:], stated.view(np.uint64)])
    return rounded[order], whole[order]


def _digest(header: Mapping[str, object], tables: Sequence[Rows]) -> str:
    found = hashlib.sha256(json.dumps(header).encode())
    for rows in tables:
        found.update(f"{rows.shape}".encode())
        found.update(np.ascontiguousarray(rows, dtype="<u8").data)
    return found.hexdigest()

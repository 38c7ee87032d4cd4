"""The split of a flow of torques over given cycles that asks least of the edges, as a cone program.

Per cycle of m springs w_1 ... w_m and torque f, with u_1 = w_1, the fold of springs is

    (w_k - u_k) (u_(k-1) + w_k) >= w_k^2 + |f|^2    (k = 2 ... m-1),        u_(m-1) + w_m >= 0:

rotated second-order cones. Clarabel solves it; what it returns proves nothing before it is rounded
and checked in integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from certpgo.certify.cone_program import Cones, solved
from certpgo.graph.cycles import Cycles
from certpgo.linalg.arrays import CSC, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Split:
    """Torques and springs of cycles, as a solver found them.

    Attributes
    ----------
    torques : (c, p), p = 1 in the plane and 3 in space
    springs : (p,) stiffness of each edge of each cycle, in the order of the cycles
    value : the smallest ratio, or the smallest loss
    status : what the solver says of its solution
    """

    torques: FloatArray
    springs: FloatArray
    value: float
    status: str


class SplitProgram:
    """The program of cycles on edges with torques (m, p) and stiffnesses c (m,).

    Parameters
    ----------
    seconds : after which the solver gives up
    """

    def __init__(
        self, cycles: Cycles, torques: FloatArray, stiffness: FloatArray, seconds: float = math.inf
    ) -> None:
        self.cycles, self.phi, self.c, self.seconds = cycles, torques, stiffness, seconds
        self.m, self.p = torques.shape
        self.f = np.arange(len(cycles) * self.p).reshape(len(cycles), self.p)
        self.w = self.f.size + np.arange(len(cycles.edges))
        place = np.arange(len(cycles.edges)) - cycles.starts[cycles.owners]
        self.inner = np.flatnonzero((place > 0) & (place < cycles.lengths[cycles.owners] - 1))
        self.u = self.w.copy()  # after the first spring, that spring
        self.u[self.inner] = self.f.size + len(self.w) + np.arange(len(self.inner))
        self.size = self.f.size + len(self.w) + len(self.inner)

    def smallest_ratio(self) -> Split:
        """The split with sum_C w_eC <= c_e - (1 - ratio) |c_e| whose ratio is smallest.

        That is ratio c_e unless a residual is beyond 90 degrees. The equations of the edges of a
        spanning forest follow from the others.
        """
        total = self.size + 1
        capacity = [
            (self.cycles.edges, self.w, np.ones(len(self.w))),
            (np.arange(self.m), np.full(self.m, self.size), -np.abs(self.c)),
        ]
        cost = np.zeros(total)
        cost[self.size] = 1.0
        kept = self.cycles.chords
        flow = Cones("zero", self._flow(kept, total), self.phi[kept].ravel())
        taken = _matrix(capacity, self.m, total)
        least = Cones("nonnegative", taken, self.c - np.abs(self.c))
        return self._solved(cost, flow, least)

    def smallest_loss(self) -> Split:
        """The split whose loss, sum_e delta_e + sqrt(delta_e^2 + |r_e|^2), is smallest.

        Here delta_e = sum_C w_eC - c_e and r_e = phi_e - sum_C f_C.
        """
        total = self.size + self.m
        sums = _matrix([(self.cycles.edges, self.w, np.ones(len(self.w)))], self.m, total)
        flow = self._flow(np.arange(self.m), total)
        roots = self.size + np.arange(self.m)
        height, ones = 2 + self.p, np.ones(self.m)
        rows = height * np.arange(self.m)
        cones = _matrix([(rows, roots, -ones)], height * self.m, total)
        cones += _placed(sums, -1.0, rows + 1, height * self.m)
        each = (rows[:, None] + 2 + np.arange(self.p)).ravel()
        cones += _placed(flow, 1.0, each, height * self.m)
        right = np.zeros((self.m, height))
        right[:, 1], right[:, 2:] = -self.c, self.phi
        cost = np.asarray(sums.sum(axis=0)).ravel()
        cost[roots] += 1.0
        found = self._solved(cost, Cones("second order", cones, right.ravel(), height))
        return Split(found.torques, found.springs, found.value - float(self.c.sum()), found.status)

    def _flow(self, edges: IntArray, total: int) -> CSC:
        """The torques of the cycles on some edges, edge by edge."""
        row = np.full(self.m, -1)
        row[edges] = np.arange(len(edges))
        on = np.flatnonzero(row[self.cycles.edges] >= 0)
        rows = row[self.cycles.edges[on]][:, None] * self.p + np.arange(self.p)
        columns = self.f[self.cycles.owners[on]]
        signs = np.repeat(self.cycles.signs[on].astype(float), self.p)
        return _matrix([(rows.ravel(), columns.ravel(), signs)], len(edges) * self.p, total)

    def _folds(self, total: int) -> list[Cones]:
        """The folds, and their ends."""
        k, height = self.inner, 3 + self.p
        rows, ones = height * np.arange(len(k)), np.ones(len(k))
        w, u, before = self.w[k], self.u[k], self.u[k - 1]
        entries = [
            (rows, w, -2.0 * ones),
            (rows, u, ones),
            (rows, before, -ones),
            (rows + 1, u, ones),
            (rows + 1, before, ones),
            (rows + 2, w, -2.0 * ones),
        ]
        f = self.f[self.cycles.owners[k]]
        each = (rows[:, None] + 3 + np.arange(self.p)).ravel()
        entries.append((each, f.ravel(), np.full(f.size, -2.0)))
        last = self.cycles.starts[1:] - 1
        c, ends = np.arange(len(self.cycles)), np.ones(len(self.cycles))
        ends_ = [(c, self.u[last - 1], -ends), (c, self.w[last], -ends)]
        folded = _matrix(entries, height * len(k), total)
        return [
            Cones("second order", folded, np.zeros(height * len(k)), height),
            Cones("nonnegative", _matrix(ends_, len(c), total), np.zeros(len(c))),
        ]

    def _solved(self, cost: FloatArray, *parts: Cones) -> Split:
        if not len(self.cycles):
            return Split(np.zeros((0, self.p)), np.zeros(0), 0.0, "Solved")
        found = solved(cost, [*parts, *self._folds(len(cost))], self.seconds)
        return Split(found.x[self.f], found.x[self.w], found.value, found.status)


def _matrix(entries: list[Any], height: int, width: int) -> CSC:
    rows, columns, values = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sparse.csc_array((values, (rows, columns)), shape=(height, width))


def _placed(matrix: CSC, factor: float, rows: IntArray, height: int) -> CSC:
    """A matrix times a factor, its rows at others of a higher one."""
    of = matrix.tocoo()
    return sparse.csc_array(
        (factor * of.data, (rows[of.row], of.col)), shape=(height, matrix.shape[1])
    )

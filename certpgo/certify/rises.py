"""What taking back a rejected measurement costs at least: proven rises of F.

At the optimum of the kept measurements, the minorant m_e of a rejected one with weight W_e proves
that F of both rises by its constant c'_e, if S_K - B_e W_e B_e^T is positive semidefinite. One
factorization serves many measurements that hardly share resistance: from F_K + sum_g m_g >= V, as
m_g <= c'_g,

    F_K + f_e >= F_K + m_e >= V - sum_(g != e) c'_g.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo.certify.resistances import together
from certpgo.certify.truncated_bound import Truncated, bound_with, resistances
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.truncated import Truncation, largest

#: Load of each measurement, and what those proven together may share.
LOAD, SHARED = 0.8, 0.18
#: Columns of measurements that are grouped at once.
MANY = 1500


def rises(normalized: Truncated, point: Estimate) -> FloatArray:
    """(k,) by how much F of the kept measurements rises at least if one more is taken, proven.

    Zero where nothing is proven, or a stop was requested.

    Parameters
    ----------
    point : the optimum of the kept measurements
    """
    problem = normalized.problem
    proven = np.zeros(len(problem.rejected))
    found = resistances(problem, point)
    if found is None:
        return proven
    uncut = problem.with_prices_of(point)
    own = replace(normalized, problem=uncut)
    at, cost = uncut.truncation(point), uncut.kept.enclosure(point)[1]
    W, _ = at.loaded(found.blocks, LOAD)
    size = max(MANY // found.b, 1)
    parts = [np.arange(at, min(at + size, len(W))) for at in range(0, len(W), size)]
    waiting = [group for part in parts for group in together(found, W, part, SHARED + 0.0 * part)]
    while waiting and not normalized.stop.should_stop():
        group = waiting.pop()
        risen = _proven(own, point, cost, at, W, group)
        if risen is None and len(group) > 1:
            waiting += [group[::2], group[1::2]]
        elif risen is not None:
            proven[group] = np.maximum(risen, 0.0)
    return proven


def _proven(
    normalized: Truncated,
    point: Estimate,
    cost: float,
    at: Truncation,
    W: FloatArray,
    group: IntArray,
) -> FloatArray | None:
    """The rises of measurements that are proven together; None if they are not."""
    chosen = np.zeros_like(W)
    chosen[group] = W[group]
    bound = bound_with(normalized, point, cost, chosen)
    if bound is None:
        return None
    most = largest(at.subset(group).minorants(W[group]))
    rest = bound.value - cost - (most.sum() - most)
    # The sums, in any order.
    return np.asarray(rest - 1e-15 * (len(group) + 8) * (np.abs(most).sum() + cost))

"""Cone programs: the least c.x with b - A x in a product of cones, as Clarabel finds it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from certpgo.linalg.arrays import CSC, FloatArray


class Cones(NamedTuple):
    """Cones of one kind and size, and the rows of A and b that are in them, one after another.

    Attributes
    ----------
    kind : zero, nonnegative, second order, or semidefinite, of which rows are an upper triangle
    size : rows of each; sides of a semidefinite one
    """

    kind: str
    A: CSC
    b: FloatArray
    size: int = 1


class ConeSolution(NamedTuple):
    """What the solver found: x (n,), c.x, and what it says of it."""

    x: FloatArray
    value: float
    status: str


def solved(cost: FloatArray, parts: Sequence[Cones], seconds: float) -> ConeSolution:
    """The solution of the program of costs (n,), unless the solver gives up after some seconds."""
    import clarabel  # type: ignore[import-untyped]

    made = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "second order": clarabel.SecondOrderConeT,
        "semidefinite": clarabel.PSDTriangleConeT,
    }
    cones: list[Any] = []
    for kind, _, b, size in parts:
        rows = size * (size + 1) // 2 if kind == "semidefinite" else size
        cones += [made[kind](size)] * (len(b) // rows)
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.time_limit = False, seconds
    A = sparse.csc_matrix(sparse.vstack([part.A for part in parts]))
    P = sparse.csc_matrix((len(cost), len(cost)))
    right = np.concatenate([part.b for part in parts])
    found = clarabel.DefaultSolver(P, cost, A, right, cones, settings).solve()
    return ConeSolution(np.asarray(found.x), float(found.obj_val), str(found.status))

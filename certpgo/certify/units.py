"""Conversion of certificates from a normalized problem to the units of the graph.

The unit is a power of two, so that only underflow and overflow can round; there, lower bounds are
rounded down and upper bounds up.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from certpgo.certify.certificate import Certificate
from certpgo.errors import InputError
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.objective import Objective


def unit_of(problem: Objective) -> float:
    """The power of two nearest W.

    Raises
    ------
    InputError
        W is beyond the range of doubles.
    """
    with np.errstate(over="ignore"):
        scale = problem.scale
    if not math.isfinite(scale) or scale <= 0.0:
        raise InputError(f"the weights add up to {scale}, beyond the range of doubles")
    return math.ldexp(1.0, max(-1000, min(1000, round(math.log2(scale)))))


def in_units(unit: float, found: Certificate) -> Certificate:
    """The certificate of the problem with weights multiplied by ``unit``."""
    bounds = found.bounds
    if bounds is not None:
        spectral, fiedler = scaled_down(unit, bounds.spectral), unit * bounds.fiedler
        bounds = replace(bounds, spectral=spectral, fiedler=fiedler)
    return replace(
        found,
        cost_computed=unit * found.cost_computed,
        cost_upper=scaled_up(unit, found.cost_upper),
        lower_bound=scaled_down(unit, found.lower_bound),
        gap=scaled_up(unit, found.gap),
        scale=unit * found.scale,
        rounding=scaled_up(unit, found.rounding),
        multipliers=None if found.multipliers is None else scaled_blocks(unit, found.multipliers),
        shift=scaled_up(unit, found.shift),
        refined_cost=scaled_up(unit, found.refined_cost),
        better_cost=None if found.better_cost is None else scaled_up(unit, found.better_cost),
        bounds=bounds,
    )


def scaled_up(unit: float, x: float) -> float:
    """A double not below ``unit`` times x, ``unit`` a power of two."""
    y = unit * x
    return y if y / unit >= x else math.nextafter(y, math.inf)


def scaled_down(unit: float, x: float) -> float:
    """A double not above ``unit`` times x, ``unit`` a power of two."""
    return -scaled_up(unit, -x)


def scaled_blocks(unit: float, blocks: FloatArray) -> FloatArray:
    """Symmetric blocks (n, d, d) such that ``unit`` times the given ones minus these are >= 0."""
    scaled = np.asarray(unit * blocks)
    inexact = (scaled / unit != blocks).any(axis=(1, 2))
    if not inexact.any():
        return scaled
    d = blocks.shape[1]
    rows = np.arange(d)
    diagonal = scaled[np.ix_(inexact, rows, rows)][:, rows, rows]
    for _ in range(d):  # each entry of a row is off by at most half a step
        diagonal = np.nextafter(diagonal, -np.inf)
    scaled[np.flatnonzero(inexact)[:, None], rows, rows] = diagonal
    return scaled

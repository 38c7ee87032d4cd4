"""Minorants of the cost of g2o as proof files claim them: the checker verifies them."""

from __future__ import annotations

import numpy as np

from certpgo import checker
from certpgo.errors import NumericalError
from certpgo.graph.edges import polar_factors
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.minorants import Minorants

#: Shares of an edge's weights by which its constant is lowered until the checker accepts it.
LOWER = tuple(4.0**k for k in range(-27, -11))
#: What a measurement without a minorant costs at least, relative to the largest weight.
NOTHING = -(2.0**-140)


def claimed(graph: checker.Graph, minorants: Minorants, tested: bool = True) -> checker.EdgeBounds:
    """Minorants of a graph's edges with constants that the checker accepts, or might, if untested.

    Raises
    ------
    NumericalError
        There are none for some measurement.
    """
    kept = minorants.exist
    found = minorants.subset(kept)
    # What the checker has on the diagonal; any number would do.
    kappa = np.trace(polar_factors(found.N)[1], axis1=1, axis2=2) / graph.t.shape[1]
    m, d = graph.t.shape
    touching = np.zeros((len(found.tau), 0)) if found.touching is None else found.touching

    def of_all(values: FloatArray) -> FloatArray:
        out = np.zeros((m, *values.shape[1:]))
        out[kept] = values
        return out

    centre = 2.0 * d * kappa
    nothing = NOTHING * float(np.abs(graph.information).max())
    constants = np.where(kept, of_all(np.nextafter(found.constant - centre, -np.inf)), nothing)
    given = checker.EdgeBounds(
        tau=of_all(found.tau),
        arms=of_all(found.b),
        kappa=of_all(kappa),
        couplings=of_all(found.N),
        touching=of_all(touching),
        constants=constants,
    )
    if not tested:
        return given
    weights = np.abs(constants) + of_all(centre)
    held = checker.minorants_hold(graph, given)
    for share in LOWER:
        if held.all():
            break
        lowered = np.where(held, given.constants, constants - share * weights)
        given = given._replace(constants=lowered)
        held = checker.minorants_hold(graph, given)
    if not held.all():
        raise NumericalError(f"no minorant is proven of {counted(sum(~held), 'measurement{s}')}")
    return given


def scaled(unit: float, given: checker.EdgeBounds) -> checker.EdgeBounds:
    """The minorants of the weights times a power of two."""
    touching = given.touching.copy()
    if touching.shape[1] == 5:
        touching[:, 4] *= unit
    return given._replace(
        tau=unit * given.tau,
        kappa=unit * given.kappa,
        couplings=unit * given.couplings,
        touching=touching,
        constants=unit * given.constants,
    )

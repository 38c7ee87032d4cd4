"""Proofs about the cost of g2o: minorants that the checker verifies, and multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo import checker
from certpgo.certify.certificate import Certificate, Tier
from certpgo.certify.proof import Witness, prove
from certpgo.certify.surrogate_case import OwnCostCase
from certpgo.certify.tolerances import refuse_unprovable
from certpgo.errors import NumericalError
from certpgo.graph import Instance
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import (
    CHORDAL,
    InformationProblem,
    costs_of,
    information_problem,
)
from certpgo.objective.information_problem import surrogate_of
from certpgo.objective.surrogate import Surrogate

#: Shares of an edge's weights by which its constant is lowered until the checker accepts it.
LOWER = tuple(4.0**k for k in range(-27, -11))
#: What a measurement without a minorant costs at least, relative to the largest weight.
NOTHING = -(2.0**-140)


@dataclass(frozen=True, eq=False)
class CostEvidence:
    """What proves a lower bound on g2o's cost, in the units of the file; none of it is trusted."""

    multipliers: FloatArray
    witness: Witness
    minorants: checker.EdgeBounds


def problem_of_certificate(instance: Instance, certificate: Certificate) -> InformationProblem:
    """The problem whose cost a certificate is about.

    Raises
    ------
    InputError
        There are no proofs about that cost.
    """
    others = [name for name in costs_of(instance) if name != CHORDAL]
    problems = [information_problem(instance, name) for name in others]
    problem = next(p for p in problems if p.edge_cost.title == certificate.objective)
    refuse_unprovable(problem)
    return problem


def cost_evidence(
    problem: InformationProblem, graph: checker.Graph, certificate: Certificate
) -> CostEvidence:
    """Minorants, multipliers and witness of a bound for the file's exact numbers.

    Parameters
    ----------
    graph : the measurements of the file, to the last bit

    Raises
    ------
    NumericalError
        There are none.
    """
    if certificate.support is None or certificate.multipliers is None:
        raise NumericalError("there is no lower bound above zero to prove")
    if certificate.support.lowered:
        said = "the bound is that of a lower cost, without cross terms or large eigenvalues"
        raise NumericalError(f"{said}; proof files hold minorants of the cost itself")
    case = OwnCostCase.of(problem, Tier.PROOF, certificate.rtol, certificate.atol)
    unit, fallback = case.unit, certificate.multipliers / case.unit
    graph = graph._replace(information=graph.information / unit)
    below = surrogate_of(case.problem, certificate.support.minorants)
    given, point = claimed(graph, below), certificate.support.point
    found = prove(below.at(point)[0], checker.surrogate(graph, given), point, fallback)
    if found is None:
        raise NumericalError("the lower bound cannot be proven without trusting a factorization")
    return CostEvidence(unit * found[0], found[1], scaled(unit, given))


def claimed(graph: checker.Graph, below: Surrogate) -> checker.EdgeBounds:
    """The minorants of a surrogate with constants that the checker accepts.

    Raises
    ------
    NumericalError
        There are none for some measurement.
    """
    kept, rotation = below.minorants.exist, below.problem.graph.rotation
    found = below.minorants.subset(kept)
    m, d = graph.t.shape
    touching = np.zeros((len(found.tau), 0)) if found.touching is None else found.touching

    def of_all(values: FloatArray) -> FloatArray:
        out = np.zeros((m, *values.shape[1:]))
        out[kept] = values
        return out

    centre = 2.0 * d * rotation.kappa
    nothing = NOTHING * float(np.abs(graph.information).max())
    constants = np.where(kept, of_all(np.nextafter(found.constant - centre, -np.inf)), nothing)
    given = checker.EdgeBounds(
        tau=of_all(found.tau),
        arms=of_all(found.b),
        kappa=of_all(rotation.kappa),
        couplings=of_all(found.N),
        touching=of_all(touching),
        constants=constants,
    )
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

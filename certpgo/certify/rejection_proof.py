"""Proofs about a truncated cost: edges of negative weight that the checker verifies."""

from __future__ import annotations

import numpy as np

from certpgo import checker
from certpgo.certify.certificate import Certificate, Tier
from certpgo.certify.dual import dual_bound
from certpgo.certify.proof import Witness, prove
from certpgo.certify.resistances import packed
from certpgo.certify.truncated_case import TruncatedCase
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.truncated import Truncation
from certpgo.objective.truncated_problem import TruncatedProblem

#: Shares by which centres move away from measurements until these reach their prices.
OUT = tuple(2.0**-k for k in range(50, 26, -4))


def rejection_evidence(
    problem: TruncatedProblem, graph: checker.Graph, certificate: Certificate
) -> tuple[FloatArray, Witness, checker.Rejections]:
    """Multipliers, witness and claims of a bound for the file's exact numbers.

    Parameters
    ----------
    graph : all measurements of the file, to the last bit

    Raises
    ------
    InputError
        The certificate is about another cost.
    NumericalError
        There is no proof.
    """
    if certificate.objective != problem.title:
        raise InputError("proofs about rejected measurements are of the chordal cost F, truncated")
    if not np.array_equal(np.stack([graph.i, graph.j], axis=1), problem.graph.edges):
        raise NumericalError("the checker has the measurements in another order")
    case = TruncatedCase.of(problem, Tier.PROOF, certificate.rtol, certificate.atol)
    unit = case.unit
    graph = graph._replace(kappa=graph.kappa / unit, tau=graph.tau / unit)
    point = certificate.refined
    point = case.at_rest(point, case.problem.truncation(point).plain())
    W = case.problem.truncation(point).plain()
    proven = _proof(case, graph, point, W)
    if proven is None:
        point = case.at_rest(case.optimum_of_kept(point), np.zeros_like(W))
        W, loads = np.zeros_like(W), np.zeros(len(W))
        if (found := case.resistances(point)) is not None:
            W, loads = packed(found, case.problem.truncation(point), isotropic=True)
        while (proven := _proof(case, graph, point, W)) is None and W.any():
            W[loads >= np.median(loads[W.any(axis=(1, 2))])] = 0.0
    if proven is None:
        raise NumericalError("the lower bound cannot be proven without trusting a factorization")
    multipliers, witness, given = proven
    weights = {name: unit * getattr(given, name) for name in ("prices", "kappa", "tau")}
    return unit * multipliers, witness, given._replace(**weights)


def _proof(
    case: TruncatedCase, graph: checker.Graph, point: Estimate, W: FloatArray
) -> tuple[FloatArray, Witness, checker.Rejections] | None:
    """A proof with minorants of these weights, in the case's units; None if there is none."""
    given = _claimed(graph, case.problem, case.problem.truncation(point), W)
    below, _ = case.problem.surrogate(point, W)
    # That of the kept measurements may have to be a loose one.
    bound = None if W.any() else dual_bound(below, point)
    fallback = None if bound is None else bound.multipliers
    found = prove(below, checker.truncated(graph, given)[0], point, fallback, at_rest=True)
    return None if found is None else (*found, given)


def _claimed(
    graph: checker.Graph, problem: TruncatedProblem, at: Truncation, W: FloatArray
) -> checker.Rejections:
    """What minorants with weights W claim; those whose prices are not reached get none."""
    moved, C = at.moved, at.centres(W)
    from_measured = C - np.dstack([at.translations, at.graph.rotation.rotations])[:, :, 1 - moved :]

    def claimed() -> checker.Rejections:
        return checker.Rejections(
            rejected=problem.rejected.astype(np.intp),
            prices=at.prices,
            kappa=W[:, moved, moved],
            centres=C[:, :, moved:],
            tau=W[:, 0, 0] * moved,
            arms=C[:, :, 0] * moved,
        )

    held = np.zeros(len(C), dtype=bool)
    for share in OUT:
        given = claimed()
        held = checker.rejections_hold(graph, given)
        if held.all():
            return given
        C = C + np.where(held, 0.0, share)[:, None, None] * from_measured
    W[~held] = 0.0
    return claimed()

"""Writing proofs: multipliers and a witness for the exact numbers of a graph file.

They are of points to more digits than other purposes need. `certpgo.certify.proof_file` has the
layout of the files; nothing here is trusted, since the checker decides.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any, cast

import numpy as np

from certpgo import checker
from certpgo.certify.certificate import CHORDAL, Certificate, Tier
from certpgo.certify.cost_proof import claimed, scaled
from certpgo.certify.dual import dual_bound
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.proof import Witness, proof_of, proposed, prove
from certpgo.certify.proof_file import arrays_of, claim_and_graph, provable
from certpgo.certify.rejection_proof import claimed_rejections
from certpgo.certify.resistances import packed
from certpgo.certify.truncated_bound import below_with, resistances
from certpgo.errors import (
    GraphError,
    InputError,
    NumericalError,
    refuse,
    require,
    require_numbers,
    require_path,
)
from certpgo.graph import Estimate, Instance
from certpgo.graph.relaxed_point import Point
from certpgo.io.writing import atomically
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.threads import one_thread
from certpgo.objective import choose_cost as costs
from certpgo.objective.choose_cost import Sum
from certpgo.objective.complex_relaxation import is_over_complex_numbers
from certpgo.objective.objective import Objective
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.tangents import quadratic_of, tangents_at
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.descent import rested
from certpgo.solve.rejection_bounds import at_rest, optimum_of_kept


def write_proof(
    path: str | Path,
    source: str | Path,
    instance: Instance,
    estimate: Estimate,
    certificate: Certificate,
    *,
    prices: FloatArray | None = None,
    within: tuple[float | None, float | None] | None = None,
    reference: int | None = None,
) -> checker.Answer:
    """Write the proof that an estimate of a graph file is as good as its certificate says.

    It is about the certificate's cost, F or that of g2o or F truncated, of the numbers in the file,
    to the last bit, and is only written if the checker accepts it.

    Parameters
    ----------
    path : path of the proof
    source : the g2o or 1DSfM file (or folder) that the instance was read from
    instance : the whole graph of the file, connected
    estimate : the estimate for the upper bound
    certificate : certificate of that estimate, or of another of the same graph
    prices : (m,) where the certificate is about a truncated cost: of rejected measurements, and
        infinite for kept ones, as in ``rejection.problem.prices``
    within : metres and degrees that no node of any optimum is further away, to be proven as well;
        None for either says nothing of it
    reference : the pose whose frame that is in, by its number; by default the heaviest one

    Returns
    -------
    The bounds verified by the checker, and what it verified of distances.

    Raises
    ------
    InputError
        The source has another format, or the instance is only a part of it; or the certificate is
        about a cost for which there are no proofs, or nothing can be said of distances.
    NumericalError
        There is no proof, or the checker refuses it, as optima may be further away.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> certpgo.write("helix.g2o", helix(3, np.random.default_rng(0)))
    >>> instance = certpgo.read("helix.g2o")
    >>> result = certpgo.solve(instance, cost="chordal")
    >>> proven = certpgo.write_proof(
    ...     "helix.cert", "helix.g2o", instance, result.estimate, result.certificate
    ... )
    >>> proven.lower <= proven.upper
    True
    """
    require_path(path, "a proof")
    require_path(source, "a graph")
    require(instance, Instance, "the instance that was read")
    require(estimate, Estimate, "an Estimate")
    require(certificate, Certificate, "a Certificate")
    source = provable(source, instance)
    seen = None if within is None else seen_from(instance, within, reference)
    problem = None
    if prices is None and not instance.graph.has_scales and certificate.objective != CHORDAL:
        problem = problem_of_certificate(instance, certificate)
    cost = None if problem is None or problem.cost_name == costs.CHORDAL else problem.cost_name
    claim, graph = claim_and_graph(source, instance, cost)
    claim |= {} if prices is None else {"version": 3}
    if within is not None:
        claim["within"] = [{"node": None, "metres": within[0], "degrees": within[1]}]
    answers: list[checker.Answer] = []

    def evidence(find: Finder) -> BoundEvidence:
        if prices is not None:
            cut = TruncatedCost(costs.objective_of(instance, costs.CHORDAL), prices)
            return _of_rejections(cut, graph, certificate, seen)
        if problem is None:
            return _of_f(instance, graph, certificate, seen, find)
        return of_cost(problem, graph, certificate, seen, find)

    def accepted(beside: Path) -> None:
        # What is proposed untested is nearly always accepted.
        for find in (proposed, prove) if prices is None else (prove,):
            found = evidence(find)
            pinned = {"pin": found.witness.pin, "exponent": found.witness.exponent}
            header = np.frombuffer(json.dumps(claim | pinned).encode(), dtype=np.uint8)
            with beside.open("wb") as file:
                np.savez(file, claim=header, **arrays_of(_proof(instance, estimate, found)))
            try:
                answers.append(checker.checked(beside, lambda _: graph))
                return
            except checker.Farther as reason:
                raise NumericalError(str(reason)) from None
            except (checker.Refused, checker.Unreadable) as reason:
                said = str(reason)
        raise NumericalError(f"the checker does not accept the proof: {said}")

    with one_thread:
        atomically(Path(path), accepted)
    return answers[0]


def seen_from(
    instance: Instance, within: tuple[float | None, float | None], reference: int | None
) -> int:
    """The pose from which distances are seen.

    Raises
    ------
    InputError
        There is none, or nothing can be claimed.
    """
    metres, degrees = within
    require_numbers(metres=metres, degrees=degrees)
    if metres is None and degrees is None:
        raise InputError("a distance of optima is in metres, in degrees or in both")
    if instance.graph.has_scales:
        raise InputError("how far optima are is not proven of poses of unknown scale")
    if metres is not None and not instance.graph.has_positions:
        raise InputError("rotations alone are some degrees apart, not metres")
    chordal = costs.objective_of(instance, costs.CHORDAL).chordal
    if reference is None:
        return int(chordal.anchor)
    require(reference, Integral, "the number of a node")
    if reference not in chordal.poses:
        raise InputError(f"node {reference} is none of the poses")
    return int(reference)


@dataclass(frozen=True, eq=False)
class BoundEvidence:
    """What proves a lower bound for a file's exact numbers, in their units; nothing is trusted."""

    multipliers: FloatArray
    witness: Witness
    minorants: checker.EdgeBounds | None = None
    tangents: FloatArray | None = None
    rejections: checker.Rejections | None = None

    @classmethod
    def of(
        cls, found: tuple[FloatArray, Witness] | None, unit: float, **claims: Any
    ) -> BoundEvidence:
        """What was found for weights over a unit.

        Raises
        ------
        NumericalError
            Nothing was found.
        """
        if found is None:
            said = "the lower bound cannot be proven without trusting a factorization"
            raise NumericalError(said)
        return cls(unit * found[0], found[1], **claims)


def _proof(instance: Instance, estimate: Estimate, found: BoundEvidence) -> checker.Proof:
    """The content of a proof."""
    proof = proof_of(estimate, found.multipliers, found.witness, found.minorants)
    if instance.graph.has_scales:
        similar = cast("Quadratic", costs.objective_of(instance))
        proof = proof._replace(s=similar.scales.of(estimate))
    return proof._replace(rejections=found.rejections, tangents=found.tangents)


#: `prove`, or `proposed`.
Finder = Callable[..., tuple[FloatArray, Witness] | None]


def _of_f(
    instance: Instance,
    graph: checker.Graph,
    certificate: Certificate,
    reference: int | None,
    find: Finder,
) -> BoundEvidence:
    """The evidence of a bound on F, of poses or of similarities."""
    if certificate.multipliers is None:
        raise NumericalError("there is no lower bound above zero to prove")
    normalized = _normalized(costs.objective_of(instance, costs.CHORDAL), certificate)
    problem, unit = normalized.problem, normalized.unit
    graph = _over(graph, unit)
    point = rested(problem, certificate.refined)
    fallback = _fallback(problem, point, certificate, unit)
    return BoundEvidence.of(find(problem, graph, point, fallback, reference=reference), unit)


def problem_of_certificate(instance: Instance, certificate: Certificate) -> Sum:
    """The problem whose cost a certificate is about.

    Raises
    ------
    InputError
        There are no proofs about that cost.
    """
    for name in costs.costs_of(instance):
        problem = None
        with suppress(GraphError):
            problem = costs.objective_of(instance, name)
        if isinstance(problem, Sum) and problem.title == certificate.objective:
            refuse(problem.unprovable)
            if not costs.COSTS[name].provable:
                raise InputError(f"{instance.name}: the checker does not know the cost of {name}")
            return problem
    what = "rotations alone" if not instance.graph.has_positions else instance.name
    raise InputError(f"{certificate.objective} is no cost of {what}, so no proof is about it")


def of_cost(
    problem: Sum,
    graph: checker.Graph,
    certificate: Certificate,
    reference: int | None = None,
    find: Finder = prove,
) -> BoundEvidence:
    """The evidence of a bound on a sum of terms: those of a program, and of distances.

    Parameters
    ----------
    graph : the measurements of the file, to the last bit
    reference : a pose, as of `certpgo.certify.proof.prove`
    find : that, or `proposed` for what is left to be tested

    Raises
    ------
    NumericalError
        There is none.
    """
    support = certificate.support
    if certificate.multipliers is None or (support is None and not problem.is_lifted):
        raise NumericalError("there is no lower bound above zero to prove")
    if support is not None and support.lowered:
        said = "the bound is that of a lower cost, without cross terms or large eigenvalues"
        raise NumericalError(f"{said}; proof files hold minorants of the cost itself")
    normalized = _normalized(problem, certificate)
    problem, unit = normalized.problem, normalized.unit
    point: Point = certificate.refined if support is None else support.point
    minorants = tangents_at(problem, point, None if support is None else support.minorants)
    below = quadratic_of(problem, minorants)
    edges = np.arange(len(minorants.tau)) < problem.measured.num_edges
    tangents = np.stack([minorants.tau, minorants.constant], axis=1)[~edges]
    given, measured = None, _over(graph, unit)
    if graph.information is not None:
        given = claimed(measured, minorants.subset(edges), tested=find is prove)
        measured = checker.surrogate(measured, given)
    if measured.ranges is not None:
        measured = checker.with_tangents(measured, measured.ranges, tangents)
    if isinstance(point, Estimate):
        point = rested(below, point)
    fallback = _fallback(below, point, certificate, unit)
    found = find(below, measured, point, fallback, reference=reference)
    return BoundEvidence.of(
        found,
        unit,
        minorants=None if given is None else scaled(unit, given),
        tangents=unit * tangents if len(tangents) else None,
    )


def _of_rejections(
    posed: TruncatedCost, graph: checker.Graph, certificate: Certificate, reference: int | None
) -> BoundEvidence:
    """The evidence of a bound on F truncated, whose graph has all measurements."""
    if certificate.objective != posed.title:
        raise InputError("proofs about rejected measurements are of the chordal cost F, truncated")
    if not np.array_equal(np.stack([graph.i, graph.j], axis=1), posed.measured.edges):
        raise NumericalError("the checker has the measurements in another order")
    normalized = _normalized(posed, certificate)
    problem, unit = normalized.problem, normalized.unit
    graph = _over(graph, unit)
    point = certificate.refined
    point = at_rest(problem, point, problem.truncation(point).plain())
    W = problem.truncation(point).plain()
    found, given = _with_minorants(problem, graph, point, W, reference)
    if found is None:
        point = at_rest(problem, optimum_of_kept(normalized, point), np.zeros_like(W))
        W, loads = np.zeros_like(W), np.zeros(len(W))
        if (of_kept := resistances(problem, point)) is not None:
            W, loads = packed(of_kept, problem.truncation(point), isotropic=True)
        while (proven := _with_minorants(problem, graph, point, W, reference))[
            0
        ] is None and W.any():
            W[loads >= np.median(loads[W.any(axis=(1, 2))])] = 0.0
        found, given = proven
    names = ("prices", "kappa", "tau", *(() if graph.N is None else ("centres",)))
    weights = {name: unit * getattr(given, name) for name in names}
    tangents = _tangents(problem, point, W)
    return BoundEvidence.of(
        found,
        unit,
        rejections=given._replace(**weights),
        tangents=unit * tangents if len(tangents) else None,
    )


def _over(graph: checker.Graph, unit: float) -> checker.Graph:
    """The graph with all weights divided by a power of two."""
    ranges = graph.ranges and graph.ranges._replace(weights=graph.ranges.weights / unit)
    N = None if graph.N is None else graph.N / unit
    whole = graph._replace(kappa=graph.kappa / unit, tau=graph.tau / unit, N=N, ranges=ranges)
    if graph.information is None:
        return whole
    return whole._replace(information=graph.information / unit)


def _tangents(problem: TruncatedCost, point: Estimate, W: FloatArray) -> FloatArray:
    """(k, 2) weights and constants of the minorants of distances."""
    found = problem.minorants(point, W)
    rows = np.arange(problem.measured.num_edges, len(found.tau))
    return np.stack([found.tau[rows], found.constant[rows]], axis=1)


def _with_minorants(
    problem: TruncatedCost,
    graph: checker.Graph,
    point: Estimate,
    W: FloatArray,
    reference: int | None,
) -> tuple[tuple[FloatArray, Witness] | None, checker.Rejections]:
    """What is found with minorants of weights W, and what these claim."""
    given = claimed_rejections(graph, problem, problem.truncation(point), W)
    below = below_with(problem, point, W)
    # That of the kept measurements may have to be a loose one.
    bound = None if W.any() else dual_bound(below, point)
    fallback = None if bound is None else bound.multipliers
    measured = checker.truncated(graph, given)[0]
    if graph.ranges is not None:
        measured = checker.with_tangents(measured, graph.ranges, _tangents(problem, point, W))
    return prove(below, measured, point, fallback, reference=reference), given


def _fallback(
    problem: Quadratic, point: Point, certificate: Certificate, unit: float
) -> FloatArray | None:
    """Multipliers (n, d, d) over real numbers that prove less than a point's own, in case."""
    known = certificate.regions
    if known is None or not is_over_complex_numbers(known.bound.form):
        return None if certificate.multipliers is None else certificate.multipliers / unit
    found = dual_bound(problem, point)
    return None if found is None else found.multipliers


def _normalized(problem: Objective, certificate: Certificate) -> NormalizedProblem[Any]:
    return NormalizedProblem.of(problem, Tier.PROOF, certificate.rtol, certificate.atol)

"""Measurements of a session that disagree with the rest, beside the answer without them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from certpgo.certify import Certificate, Verdict
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.labels import Label
from certpgo.linalg.arrays import IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.initialization import Start
from certpgo.optimize.methods._robust import connected
from certpgo.solve.outliers import Disagreement, disagreement, select
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings
from certpgo.solve.warm_start import found_anew


@dataclass(frozen=True, eq=False, repr=False)
class Suspicion(Brief):
    """Measurements that disagree with the rest; taking them out is the caller's decision.

    Attributes
    ----------
    edges : (k,) their numbers in the session, for `certpgo.Session.remove`
    nodes : names of the two nodes of each
    disagreement : how they were found, with their indices in ``session.graph``
    certificate : of the optimum with them
    without : the certified answer without them

    Examples
    --------
    Three cameras, whose last of 13 measurements is a quarter turn off:

    >>> import numpy as np
    >>> from certpgo import RotationGraph, Session
    >>> edges = np.array([(0, 1), (1, 2), (2, 0)] * 4 + [(0, 1)])
    >>> R = np.tile(np.eye(2), (13, 1, 1))
    >>> R[-1] = [[0.0, -1.0], [1.0, 0.0]]
    >>> session = Session()
    >>> session.add(RotationGraph(3, edges, R, kappa=np.full(13, 1e4)))
    >>> found = session.suspicion()
    >>> found.edges.tolist(), found.nodes, found.without.verdict.value
    ([12], ((0, 1),), 'CERTIFIED')
    """

    edges: IntArray
    nodes: tuple[tuple[Label, Label], ...]
    disagreement: Disagreement
    certificate: Certificate
    without: CertifiedSolution

    def __str__(self) -> str:
        """Which they are, and F with and without them, with both verdicts."""
        pairs = ", ".join(f"{i}-{j}" for i, j in self.nodes[:SHOWN])
        more = ", ..." if len(self.nodes) > SHOWN else ""
        here, there = self.certificate, self.without.certificate
        return (
            f"{self.disagreement} ({pairs}{more}): F is {here.cost_upper:.6g}, "
            f"{here.verdict.value}, with them, {there.cost_upper:.6g}, {there.verdict.value}, "
            "without"
        )


#: Pairs of nodes that a sentence names.
SHOWN = 5


def _hidden(problem: Quadratic | Sum, estimate: Estimate) -> Disagreement | None:
    """What a robust fit rejects, though least squares spreads its error below the stated noise."""
    with suppress(NumericalError, np.linalg.LinAlgError):
        chosen = select(problem, fit=estimate)
        if chosen.scale == 1.0 and chosen.rejected.any():
            edges = np.flatnonzero(chosen.rejected)
            angles = problem.residual_angles(chosen.estimate)[edges]
            return Disagreement(edges, problem.graph.num_edges, float(angles.max()))
    return None


def suspicion(
    problem: Quadratic | Sum,
    estimate: Estimate,
    certificate: Certificate,
    numbers: IntArray,
    names: Sequence[Label],
    settings: SolveSettings,
) -> Suspicion | None:
    """The measurements of a problem that disagree with the rest; None if there are none.

    By their residuals, and where the optimum is not certified, by a robust fit in any case. Not
    with nodes of unknown scale, whose residuals are in the unit of the map.

    Parameters
    ----------
    estimate, certificate : the optimum of all measurements
    numbers : (m,) of the measurements, to name them
    names : of the nodes
    settings : of the search without them
    """
    if problem.takes_scales:
        return None
    found = disagreement(problem, estimate, refit=True)
    if found is None and certificate.verdict is not Verdict.CERTIFIED:
        found = _hidden(problem, estimate)
    if found is None:
        return None
    weights = np.ones(problem.graph.num_edges)
    weights[found.edges] = 0.0
    # What nothing else connects stays.
    weights = connected(problem.chordal, weights, problem.edge_costs(estimate))
    out = np.flatnonzero(weights == 0.0)
    if len(out) == 0:
        return None
    start = Start(estimate, "the optimum with them")
    without = found_anew(problem.reweighted(weights), settings, start)
    pairs = problem.graph.edges[out].tolist()
    nodes = tuple((names[i], names[j]) for i, j in pairs)
    return Suspicion(numbers[out], nodes, found, certificate, without)

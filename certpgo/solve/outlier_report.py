"""Rejected measurements one by one: what accepting each costs, and which are proven wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from certpgo.certify.certificate import Certificate
from certpgo.errors import InputError, require_numbers
from certpgo.graph import Instance
from certpgo.graph.display import Brief
from certpgo.graph.succession import succession
from certpgo.io.csv_files import write_csv
from certpgo.linalg.arrays import IntArray
from certpgo.objective.choose_cost import CHORDAL
from certpgo.optimize.monitor import Monitor, silent
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import (
    LEVEL,
    budgets,
    cores,
    odometry,
    proven_rises,
    proven_worth,
    rises_over,
)
from certpgo.solve.rejection import Rejection
from certpgo.solve.result import CertifiedSolution

#: Kept measurements that a sentence names.
SHOWN = 8


@dataclass(frozen=True)
class RejectedEdge:
    """A rejected measurement; the fields are the columns of the CSV.

    Attributes
    ----------
    edge : its number, see `certpgo.Instance`; of a graph its index
    i, j : ids of its nodes
    degrees, metres : its residuals at the estimate; None for what it does not measure
    cost, price : its term there, and what leaving it out costs
    rise : the cost of the kept measurements rises by that at least if it is accepted, proven
    rise_over_odometry : the same of those from each pose to the next alone; None if these leave
        nodes free
    budget : what ``rise`` of a right one exceeds with the probability of the report
    ambiguous : whether its price is no part of the bound on the truncated cost
    core : number of the set that it is in, of measurements that cannot all be right; None for none
    of_cost : the name of the cost, see `certpgo.solve`
    """

    edge: int
    i: int
    j: int
    degrees: float | None
    metres: float | None
    cost: float
    price: float
    rise: float
    rise_over_odometry: float | None
    budget: float
    ambiguous: bool
    core: int | None
    of_cost: str = CHORDAL

    @property
    def is_refuted(self) -> bool:
        """Whether it is wrong, if the kept measurements are right."""
        return self.rise > self.budget

    @property
    def is_refuted_by_odometry(self) -> bool:
        """Whether it is wrong, if those from each node to the next are right."""
        return self.rise_over_odometry is not None and self.rise_over_odometry > self.budget


@dataclass(frozen=True, eq=False, repr=False)
class OutlierReport(Brief):
    """What is proven about each rejected measurement.

    Attributes
    ----------
    rejection : the verdict about all of them
    edges : those of lowest rise first
    cores : sets of measurements, by number, of which no two share one and none is right as a whole
    cores_over_odometry : the same, where they may share measurements from each node to the next
    doubtful_kept : (k,) kept measurements, by number, of which it is not proven that leaving any
        single one out, for a price of the same quantile, costs more, whatever else changes; None
        under the cost of another program, of which nothing of the kind is proven
    doubtful_pairs : (k, 2) ids of their nodes
    order : from what it is known which pose follows which: ``"time"``, ``"name"`` or ``"id"``
    level : probability that right measurements are called wrong
    is_complete : whether the proofs were not stopped; else what is not proven may be provable
    interrupted : whether Ctrl-C or the monitor stopped them
    """

    rejection: Rejection
    edges: tuple[RejectedEdge, ...]
    cores: tuple[IntArray, ...]
    cores_over_odometry: tuple[IntArray, ...]
    doubtful_kept: IntArray | None
    doubtful_pairs: IntArray
    order: str
    level: float
    is_complete: bool = True
    interrupted: bool = False

    def in_words(self, kept: Certificate | None = None) -> Iterator[tuple[str, str]]:
        """The findings, as names and values; ``kept`` as in `Rejection.in_words`."""
        count = len(self.edges)
        refuted = sum(edge.is_refuted for edge in self.edges)
        alone = sum(edge.is_refuted_by_odometry for edge in self.edges)
        yield from self.rejection.in_words(kept)
        yield "proven wrong", f"{refuted} of {count}, if the kept ones are right"
        steps = f"if those from each pose to the next by {self.order} are right"
        if self.edges and self.edges[0].rise_over_odometry is not None:
            yield "", f"{alone} of {count}, {steps}"
        wrong = f"{len(self.cores)}: so many sets that share none cannot be right as a whole"
        yield "wrong at least", wrong
        odometry = len(self.cores_over_odometry)
        yield "", f"{odometry}, {steps}"
        yield from self._worth()
        noise = self.rejection.noise
        yield "level", f"{self.level:.3g}: probability, at most, that {noise} refutes a right one"

    def _worth(self) -> Iterator[tuple[str, str]]:
        """Which kept measurements are worth keeping, if that is known."""
        if self.doubtful_kept is None:
            return
        problem = self.rejection.problem
        total = int((~problem.is_rejected & problem.graph.is_measured).sum())
        of_kept = f"{total - len(self.doubtful_kept)} of {total} kept ones"
        yield "worth keeping", f"{of_kept}: leaving any single one of them out costs more, proven"
        if len(self.doubtful_kept):
            names = ", ".join(f"{i}-{j}" for i, j in self.doubtful_pairs[:SHOWN].tolist())
            more = ", ..." if len(self.doubtful_kept) > SHOWN else ""
            yield "", f"not proven of {names}{more}"


def outlier_report(
    answer: CertifiedSolution,
    *,
    level: float = LEVEL,
    time_limit: float | None = None,
    monitor: Monitor = silent,
) -> OutlierReport:
    """What is proven about each measurement that a robust answer rejects.

    Parameters
    ----------
    answer : of `certpgo.solve_robustly`
    level : probability with which noise as the weights state it, or as estimated, refutes a right
        measurement
    time_limit : seconds after which nothing more is proven; rises are then zero
    monitor : may stop the search for proofs

    Raises
    ------
    InputError
        The answer rejects nothing, or the level is not between 0 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> from certpgo.solve.outlier_report import outlier_report
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> report = outlier_report(certpgo.solve_robustly(instance.graph))
    >>> len(report.edges) == int(instance.outliers.sum()), all(e.is_refuted for e in report.edges)
    (True, True)
    """
    if answer.rejection is None:
        rejects = bool(len(answer.solution.rejected))
        why = "what it rejects is not certified, see answer.solution.note"
        raise InputError(why if rejects else "the answer rejects no measurement")
    require_numbers(level=level)
    found, stop = answer.rejection, Stop(monitor)
    problem, rejected = found.problem.whole, found.problem.rejected
    graph, named = problem.graph, answer.instance
    if named is None:
        named = Instance("graph", problem.measured, np.arange(graph.num_nodes))
    order = succession(named)
    kept, trusted = ~found.problem.is_rejected, odometry(problem.measured, order)
    trusted = np.append(trusted, np.zeros(len(kept) - len(trusted), dtype=bool))
    budget = budgets(problem, level, found.scale)
    with stop.within(time_limit):
        rise = proven_rises(found.problem, found.estimate, stop)
        over = rises_over(problem, trusted & kept, rejected, stop)
        sets = cores(problem, kept, rejected, budget, stop)
        shared = cores(problem, kept, rejected, budget, stop, trusted & kept)
        worth = None
        if problem.is_chordal:
            worth = proven_worth(found.problem, found.certificate.best, found.prices_of_all, stop)
    core = {int(e): number for number, members in enumerate(sets) for e in members[-1:]}
    angles = problem.residual_angles(found.estimate)
    lengths = problem.residual_lengths(found.estimate)
    costs, ambiguous = problem.edge_costs(found.estimate), found.certificate.obstacle.ambiguous
    pairs, numbers = named.pairs, named.known_numbers
    edges = [
        RejectedEdge(
            edge=int(numbers[e]),
            i=int(pairs[e, 0]),
            j=int(pairs[e, 1]),
            degrees=math.degrees(angles[e]) if graph.measures_rotation[e] else None,
            metres=None
            if lengths is None or not graph.measures_translation[e]
            else float(lengths[e]),
            cost=float(costs[e]),
            price=float(found.problem.prices[e]),
            rise=float(rise[k]),
            rise_over_odometry=None if over is None else float(over[k]),
            budget=float(budget[e]),
            ambiguous=e in ambiguous,
            core=core.get(e),
            of_cost=problem.cost_name,
        )
        for k, e in enumerate(rejected.tolist())
    ]
    ordered = tuple(sorted(edges, key=lambda edge: edge.rise))
    of_kept = np.flatnonzero(kept & graph.is_measured & (True if worth is None else ~worth))
    return OutlierReport(
        found,
        ordered,
        tuple(numbers[members] for members in sets),
        tuple(numbers[members] for members in shared),
        None if worth is None else numbers[of_kept],
        pairs[of_kept],
        order.by,
        level,
        is_complete=stop.ended_by is None,
        interrupted=stop.interrupted,
    )


def write_report(path: Path, edges: Sequence[RejectedEdge]) -> None:
    """Write the rejected measurements as CSV in full precision.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    names = [field.name for field in fields(RejectedEdge)]
    rows = (
        [*(getattr(edge, name) for name in names), edge.is_refuted, edge.is_refuted_by_odometry]
        for edge in edges
    )
    write_csv(path, [*names, "refuted", "refuted_by_odometry"], rows)

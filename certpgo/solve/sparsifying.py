"""Graphs with fewer loop closures, and what the optimum and its certificate lose.

Loop closures are chosen by algebraic connectivity or by the measured spectrum, see
`certpgo.optimize.connectivity`; both graphs are then solved and certified.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Any, Literal, get_args

import numpy as np

from certpgo.certify.wording import named_cost
from certpgo.errors import InputError, require
from certpgo.graph import Graph, Instance
from certpgo.graph.display import Speaking
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import IntArray
from certpgo.objective.choose_cost import objective_of
from certpgo.optimize.connectivity import Connectivity, SpectralMargin, choose
from certpgo.solve.fit import Fit
from certpgo.solve.loop_closures import loop_closures, with_rotations
from certpgo.solve.metrics import TrajectoryErrors, trajectory_errors
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.settings import SolveSettings, settings_from

#: What loop closures are chosen by: where they are, or also what they measure.
By = Literal["connectivity", "spectrum"]


@dataclass(frozen=True, eq=False, repr=False)
class Sparsified(Speaking):
    """A graph with some of its loop closures, beside the whole one.

    Attributes
    ----------
    instance : the sparse graph
    kept : (k,) its measurements' indices in the whole graph, ascending
    chosen : (c,) those of the loop closures among them
    loops : loop closures of the whole graph
    full : lambda_2 of the whole graph's Laplacian weighted by kappa, 1/rad^2
    connectivity : that of the sparse graph
    bound : no choice of as many loop closures has a larger one
    whole, answer : certified answers of the whole and the sparse graph
    cost : that of the whole graph at the sparse one's answer
    moved : root mean square distance and angle between the two answers

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import sphere
    >>> graph = sphere(10, np.random.default_rng(0), rotation_noise=0.05).graph
    >>> sparse = certpgo.sparsify(graph, 0.25)
    >>> len(sparse.chosen) == round(0.25 * sparse.loops), sparse.answer.verdict.value
    (True, 'CERTIFIED')
    >>> bool(sparse.connectivity <= sparse.bound <= 1.01 * sparse.full), bool(sparse.loss > 0.0)
    (True, True)
    """

    instance: Instance
    kept: IntArray
    chosen: IntArray
    loops: int
    full: float
    connectivity: float
    bound: float
    whole: CertifiedSolution
    answer: CertifiedSolution
    cost: float
    moved: TrajectoryErrors

    @property
    def loss(self) -> float:
        """By how much the cost of all measurements rises, relative to their best known cost."""
        least = self.whole.cost
        return (self.cost - least) / least if least > 0.0 else 0.0

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of the measurements kept, where their source states the noise."""
        return replace(self.answer, instance=self.instance).fit

    @property
    def _headline(self) -> str:
        kept = f"{len(self.chosen)} of {counted(self.loops, 'loop closure{s}')} kept"
        return f"{kept}; the sparse graph is {self.answer._headline}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield (
            "connectivity",
            (
                f"{self.connectivity:.4g} of {self.full:.4g} with all; "
                f"no choice of as many exceeds {self.bound:.4g}"
            ),
        )
        yield "whole", self.whole.certificate.in_brief
        yield "sparse", f"{self.answer.certificate.in_brief} of the measurements kept"
        loss = f"{self.cost:.10g} for all measurements, {100.0 * self.loss:.3g} % more"
        yield "loss", f"{named_cost(self.whole.certificate.objective)} = {loss}"
        if self.fit is not None:
            yield "chi^2", str(self.fit)
        metres = "" if self.moved.ate_m is None else f"{self.moved.ate_m:.4g} m and "
        yield "moved", f"{metres}{self.moved.ate_deg:.4g} degrees (root mean square)"

    def _picture(self) -> str:
        return self.instance._picture()


def sparsify(
    graph: Instance | Graph,
    keep: float,
    settings: SolveSettings | None = None,
    *,
    cost: str | None = None,
    by: By = "connectivity",
    **options: Any,
) -> Sparsified:
    """Keep loop closures that connect a graph well, and solve it with and without the others.

    Steps of odometry, between a pose and the next one by time, name or id, see
    `certpgo.graph.succession`, are always kept; where they do not connect the graph, so is a
    spanning tree. Sightings, priors and distances are kept too. Among
    the others, the choice approximately maximises lambda_2 of the graph Laplacian weighted by kappa
    (Doherty et al., arXiv 2403.19879). That depends on where loop closures are, not on what they
    measure; ``by="spectrum"`` raises its margin above the smallest eigenvalues of the measured
    rotations (`SpectralMargin`), which wrong ones narrow.

    Parameters
    ----------
    keep : loop closures to keep: an integer is their number, a float a fraction of them
    cost : as in `certpgo.solve`, of both
    by : ``"connectivity"`` or ``"spectrum"``
    settings, options : as in `certpgo.solve`

    Raises
    ------
    InputError
        ``keep`` or ``by`` is out of range, or the graph has no loop closures.
    GraphError
        It is not connected, or only measurements of other kinds than relative rotations connect it.
    NumericalError
        An eigenvector was not found.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import sphere
    >>> graph = sphere(10, np.random.default_rng(0), rotation_noise=0.05).graph
    >>> sparse = certpgo.sparsify(graph, 30)
    >>> len(sparse.chosen), sparse.instance.graph.num_edges == len(sparse.kept)
    (30, True)
    """
    settings = settings_from(settings, options)
    if not isinstance(by, str) or by not in get_args(By):
        raise InputError(f"by is 'connectivity' or 'spectrum', not {by!r}")
    whole, rotations = with_rotations(graph)
    loops = loop_closures(rotations)
    count = _number(keep, int(loops.sum()))
    connectivity = Connectivity(rotations.problem)
    margin = SpectralMargin(connectivity) if by == "spectrum" else None
    choice = choose(connectivity, loops, count, margin)
    full = connectivity(np.ones(len(loops)))[0]
    chosen = rotations.edges[choice.chosen]
    left_out = np.setdiff1d(rotations.edges[loops], chosen)
    kept = np.setdiff1d(np.arange(whole.graph.num_edges), left_out)
    sparse = whole.with_edges(kept)
    problem = objective_of(whole, cost)
    best = search(problem, settings)
    answer = search(objective_of(sparse, problem.cost_name), settings)
    poses = whole.poses
    return Sparsified(
        instance=sparse,
        kept=kept,
        chosen=chosen,
        loops=int(loops.sum()),
        full=full,
        connectivity=choice.connectivity,
        bound=choice.bound,
        whole=best,
        answer=answer,
        cost=problem.cost(answer.estimate),
        moved=trajectory_errors(answer.estimate.subset(poses), best.estimate.subset(poses)),
    )


def _number(keep: float, loops: int) -> int:
    """How many loop closures to keep."""
    if loops == 0:
        raise InputError("the graph has no loop closures to choose from")
    require(keep, Real, "how many loop closures to keep, or their share,")
    if isinstance(keep, int):
        if not 1 <= keep <= loops:
            raise InputError(f"1 to {loops} loop closures can be kept, not {keep}")
        return keep
    if not 0.0 < keep <= 1.0:
        raise InputError(f"the fraction of loop closures must be in (0, 1], not {keep:g}")
    return max(1, round(keep * loops))

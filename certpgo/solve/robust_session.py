"""A session that rejects measurements which disagree with the rest, and takes them back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Graph
from certpgo.graph.capabilities import require_capable
from certpgo.graph.concatenate import joined
from certpgo.graph.labels import WORLD, Label
from certpgo.graph.origins import Measured
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.solve.outliers import (
    agrees,
    noise_scale,
    outlying,
    select,
    states_noise,
)
from certpgo.solve.rejection import Rejection, certify_rejection
from certpgo.solve.row_numbers import ASSUMED
from certpgo.solve.session import Session
from certpgo.solve.session_status import Standing
from certpgo.solve.settings import SolveSettings
from certpgo.solve.terms import chordal_problem

#: A descent that shows whether new measurements agree; outliers would make it long.
TRIAL = NewtonSettings(tolerance=1e-6, max_iterations=30)


class RobustSession(Session):
    """A `Session` whose certificate is about the measurements that agree with one another.

    Where the measurements of the moment disagree, all that ever came are judged again by the robust
    fit of `certpgo.solve_robustly`: what was accepted too early is put aside, and what was put
    aside returns when the evidence does. Between two such fits, what was put aside returns as soon
    as nothing speaks against it any more. `settle` judges all once more: the measurements are then
    those that `certpgo.solve_robustly` keeps.

    Parameters
    ----------
    settings, every, options : as in `Session`, but for the cost, which is F

    Raises
    ------
    InputError
        A cost is given.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> session = certpgo.RobustSession(every=None)
    >>> session.add(instance.graph)
    >>> session.settle().verdict.value
    'CERTIFIED'
    >>> bool(np.array_equal(session.rejected, np.flatnonzero(instance.outliers)))
    True
    """

    def __init__(
        self, settings: SolveSettings | None = None, *, every: int | None = 100, **options: Any
    ) -> None:
        if "cost" in options:
            raise InputError("a robust session is about the chordal cost F, not about another")
        super().__init__(settings, every=every, cost=CHORDAL, **options)
        #: Each rejected measurement, with the names of its nodes.
        self._put_aside: dict[int, tuple[Graph, list[Label]]] = {}

    def _take(self, graph: Graph, labels: Sequence[Label], numbers: Sequence[int]) -> None:
        require_capable(graph, "robust session")
        super()._take(graph, labels, numbers)

    @property
    def rejected(self) -> IntArray:
        """(k,) numbers of the measurements that are put aside, ascending."""
        return np.array(sorted(self._put_aside), dtype=np.intp)

    def refresh(self) -> Standing:
        """Judge what is new, then prove the optimum of what is kept, as `Session.refresh`."""
        problem = self._problem
        self._adopt(newton(problem, self.estimate, TRIAL).estimate)
        if not agrees(problem, self.estimate):
            self._judge()
        elif self._put_aside:
            self._reconsider()
        return super().refresh()

    def settle(self) -> Standing:
        """Judge all measurements once more, and refresh."""
        self._judge()
        return super().refresh()

    def rejection(self, *, quantile: float | None = None) -> Rejection | None:
        """What is proven at the estimate about what is put aside; None if nothing is.

        Its edges are the numbers of measurements, as in `rejected`.

        Parameters
        ----------
        quantile : as in `certpgo.solve_robustly`

        Examples
        --------
        >>> import numpy as np
        >>> import certpgo
        >>> from certpgo.io.datasets.thesis import langevin_graph
        >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
        >>> session = certpgo.RobustSession(every=None)
        >>> session.add(instance.graph)
        >>> _ = session.settle()
        >>> print(session.rejection().verdict)
        CERTIFIED
        """
        if not self._put_aside:
            return None
        whole, numbers = self._everything()
        rejected = np.flatnonzero(np.isin(numbers, self.rejected))
        scale = 1.0 if states_noise(whole) else self._noise()
        how: dict[str, Any] = {"quantile": quantile, "scale": scale}
        found = certify_rejection(whole, self.estimate, rejected, **how)
        return replace(found, numbers=numbers)

    def _judge(self) -> None:
        """Choose by a robust fit to everything which measurements to keep."""
        whole, numbers = self._everything()
        chosen = select(whole)
        self._keep(set(numbers[~chosen.rejected].tolist()))
        self._adopt(chosen.estimate)

    def _reconsider(self) -> None:
        """Take back what agrees with the rest now."""
        whole, numbers = self._everything()
        scale = 1.0 if states_noise(whole) else self._noise()
        agreeing = ~outlying(whole, whole.edge_costs(self.estimate), scale)
        self._keep({*self._numbers.edges, *numbers[agreeing].tolist()})

    @property
    def _problem(self) -> Quadratic:
        return chordal_problem(self.graph, self._called)

    def _noise(self) -> float:
        problem = self._problem
        return noise_scale(problem, problem.edge_costs(self.estimate))

    def _keep(self, kept: set[int]) -> None:
        """Keep the measurements with these numbers, and put the others aside."""
        aside, kept = self._put_aside, {*kept, ASSUMED}
        for number in sorted(kept & aside.keys()):
            self._take(*aside.pop(number), [number])
        graph, names = self.graph, self.nodes
        for place, number in enumerate(self._numbers.edges):
            if number not in kept:
                ends = np.unique(graph.edges[place])
                one = graph.with_edges(np.array([place])).subgraph(ends)
                aside[number] = one, [names[k] for k in ends]
        self.remove(set(self._numbers.edges) - kept)

    @property
    def _with_worlds(self) -> list[Measured]:
        aside = [
            (one, names.index(WORLD) if WORLD in names else None, self._origin)
            for one, names in self._put_aside.values()
        ]
        return [*super()._with_worlds, *aside]

    def _move_world(self, measured: Sequence[Graph], origin: FloatArray | None) -> None:
        for number, one in zip(self._put_aside, measured[1:], strict=True):
            self._put_aside[number] = one, self._put_aside[number][1]
        super()._move_world(measured[:1], origin)

    def _everything(self) -> tuple[Quadratic, IntArray]:
        """All measurements that ever came, in that order, and their numbers."""
        kept, aside, place = self.graph, self._put_aside, self._poses.numbers
        nodes = [np.arange(kept.num_nodes)]
        nodes += [np.array([place[name] for name in names]) for _, names in aside.values()]
        parts = [kept, *(one for one, _ in aside.values())]
        numbers = np.concatenate([self.edges, np.fromiter(aside, dtype=np.intp)])
        order = np.argsort(numbers)
        whole = joined(parts, kept.num_nodes, kept.is_point, nodes).with_edges(order)
        return chordal_problem(whole, self._called), numbers[order]

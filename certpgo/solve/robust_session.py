"""A session that rejects measurements which disagree with the rest, and takes them back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.capabilities import require_capable
from certpgo.graph.concatenate import joined
from certpgo.graph.labels import WORLD, Label
from certpgo.graph.observations import Observations
from certpgo.graph.origins import Measured
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.descent import descend
from certpgo.optimize.riemannian_newton import NewtonSettings
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
    settings, every, options : as in `Session`

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
        super().__init__(settings, every=every, **options)
        #: Each rejected measurement, an edge or a row of a block, with the names of its nodes.
        self._edges_aside: dict[int, tuple[Graph, list[Label]]] = {}
        self._rows_aside: dict[int, tuple[Observations, list[Label]]] = {}

    def _take(self, graph: Graph, labels: Sequence[Label], numbers: Sequence[int]) -> None:
        require_capable(graph, "robust session")
        super()._take(graph, labels, numbers)

    @property
    def _put_aside(self) -> dict[int, tuple[Graph | Observations, list[Label]]]:
        return {**self._edges_aside, **self._rows_aside}

    @property
    def rejected(self) -> IntArray:
        """(k,) numbers of the measurements that are put aside, ascending."""
        return np.array(sorted(self._put_aside), dtype=np.intp)

    def refresh(self) -> Standing:
        """Judge what is new, then prove the optimum of what is kept, as `Session.refresh`."""
        problem = self._problem
        found = descend(problem, self.estimate, TRIAL, tolerance=TRIAL.tolerance)
        self._adopt(found.estimate)
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
        self._keep({*self._numbers.rows.tolist(), *numbers[agreeing].tolist()})

    def _noise(self) -> float:
        problem = self._problem
        return noise_scale(problem, problem.edge_costs(self.estimate))

    def _keep(self, kept: set[int]) -> None:
        """Keep the measurements with these numbers, and put the others aside."""
        edges, others, kept = self._edges_aside, self._rows_aside, {*kept, ASSUMED}
        for number in sorted(kept & edges.keys()):
            self._take(*edges.pop(number), [number])
        for number in sorted(kept & others.keys()):
            block, names = others.pop(number)
            self._measured.replace(self._beside(self.graph, block, names), self._terms)
            self._numbers.blocks.setdefault(type(block), []).append(number)
            self._adopt(self.estimate)
        graph, labels, rows = self.graph, self.nodes, self._numbers.rows
        for place, number in enumerate(rows.tolist()):
            if number in kept:
                continue
            ends = np.unique(graph.pairs[place])
            names = [labels[k] for k in ends]
            if place < graph.num_edges:
                one = graph.with_blocks().with_edges(np.array([place])).subgraph(ends)
                edges[number] = one, names
            else:
                others[number] = _row(graph.blocks, place - graph.num_edges, ends), names
        self.remove(set(rows.tolist()) - kept)

    def _beside(self, graph: Graph, block: Observations, names: Sequence[Label]) -> Graph:
        """All nodes' measurements with others between nodes of these names."""
        own, numbers = dict(zip(map(type, graph.blocks), graph.blocks, strict=True)), self._poses
        nodes, n = [np.array([numbers.numbers[name] for name in names])], graph.num_nodes
        same = own.get(type(block))
        parts = [block] if same is None else [same, block]
        nodes = nodes if same is None else [np.arange(n), *nodes]
        own[type(block)] = block.joined(n, parts, nodes)
        return graph.with_blocks(*own.values())

    @property
    def _with_worlds(self) -> list[Measured]:
        aside = [
            (one, names.index(WORLD) if WORLD in names else None, self._origin)
            for one, names in self._edges_aside.values()
        ]
        return [*super()._with_worlds, *aside]

    def _move_world(self, measured: Sequence[Graph], origin: FloatArray | None) -> None:
        for number, one in zip(self._edges_aside, measured[1:], strict=True):
            self._edges_aside[number] = one, self._edges_aside[number][1]
        super()._move_world(measured[:1], origin)

    def _everything(self) -> tuple[Quadratic | Sum, IntArray]:
        """The problem of all measurements, edges as they came, and the number of each row."""
        whole, place = self.graph, self._poses.numbers
        edges, others = [*self._numbers.edges], {k: [*of] for k, of in self._numbers.blocks.items()}
        parts, nodes = [whole], [np.arange(whole.num_nodes)]
        for number, (one, names) in self._edges_aside.items():
            parts.append(one)
            nodes.append(np.array([place[name] for name in names]))
            edges.append(number)
        if len(parts) > 1:
            whole = joined(parts, whole.num_nodes, whole.is_point, nodes)
        order = np.argsort(edges)
        whole = whole.with_edges(order)
        for number, (block, names) in self._rows_aside.items():
            whole = self._beside(whole, block, names)
            others.setdefault(type(block), []).append(number)
        rows = [np.array(edges)[order], *(np.array(of) for of in others.values())]
        return self._terms.problem(whole, self._called), np.concatenate(rows).astype(np.intp)


def _row(blocks: Sequence[Observations], place: int, ends: IntArray) -> Observations:
    """A row of blocks, counted through, between its two nodes, ascending."""
    while place >= blocks[0].num_edges:
        place, blocks = place - blocks[0].num_edges, blocks[1:]
    found = blocks[0].subset(np.array([place]))
    return replace(found, num_nodes=len(ends), edges=np.searchsorted(ends, found.edges))

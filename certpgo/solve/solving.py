"""`certpgo.solve`: the certified pipeline for a graph, in a choice of costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from certpgo.certify.certificate import of_instance
from certpgo.errors import InputError, kind_of, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.accept_paths import AnyPath, estimated, measured
from certpgo.io.writing import AnyAnswer
from certpgo.objective.choose_cost import Certifiable, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.initialization import Start
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.notebook import watched
from certpgo.solve.outliers import Disagreement, ignore
from certpgo.solve.result import GIVEN, CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.settings import SolveSettings, settings_from

if TYPE_CHECKING:
    from certpgo.objective.kernels import Kernel

#: Name of the initial values of an instance.
STORED = "the initial values of the file"


def solve(
    graph: Graph | Instance | Certifiable | AnyPath,
    settings: SolveSettings | None = None,
    *,
    cost: str | None = None,
    kernel: Kernel | str | None = None,
    initial: Estimate | AnyAnswer | AnyPath | None = None,
    monitor: Monitor | None = None,
    on_disagreement: Callable[[Disagreement], object] | None = None,
    **options: Any,
) -> CertifiedSolution:
    """The best estimate of a graph, with a certificate of how good it is.

    The Riemannian staircase from rank d (Boumal 2015; Rosen et al., IJRR 2019), with Newton's
    method on poses and certificates that account for rounding.

    Parameters
    ----------
    graph : the measurements of n poses or rotations, connected, or the instance that was read, or
        the path of its file, see `certpgo.read`; or a problem, which has its cost
    cost : ``"chordal"``, the F of this package; or for measurements with information matrices one
        of `certpgo.objective.costs`, such as ``"g2o"`` or ``"gtsam"``: what these programs
        minimise. By default that of `certpgo.objective.choose_cost.own_cost`: of the program of
        the file that was read
    kernel : a robust kernel of the costs of edges, such as ``"huber:1.5"``, of rotations alone also
        ``"huber:5deg"``, see `certpgo.objective.kernels.Kernel`; by default none
    settings : limits, tolerances and tuning, see `SolveSettings`
    initial : initial estimate, n poses, in metres, or an answer, or the path of a file; by default
        one is computed. An instance's own initial values are tried too, see ``try_file_start``
    monitor : is called with each iteration, and may stop the search; by default a notebook shows
        how far a long search is
    on_disagreement : is called with measurements that disagree with the rest, after the first
        descent
    options : single settings instead: ``time_limit``, ``max_rank``, ``tier``, ``rtol``, ``atol``
        and any other field of `SolveSettings`

    Returns
    -------
    The verdict is CERTIFIED; BOUNDED with a proven gap if the relaxation is not tight; or UNDECIDED
    if the search ended before a useful bound was found. Ctrl-C stops the search like a monitor; a
    second one raises KeyboardInterrupt.

    Raises
    ------
    GraphError
        The graph is not connected.
    InputError
        An initial estimate of another graph, invalid limits or tolerances, weights beyond the range
        of doubles.
    SpecError
        An unknown tier, setting or kernel.
    NumericalError
        No initialization could be computed.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(6, 0.3, 0)
    >>> result = certpgo.solve(instance.graph, time_limit=10.0)
    >>> result.verdict.value
    'CERTIFIED'
    >>> print(f"{result.cost:.6f}")  # 8 n sin^2(theta / (2 n)), the error distributed evenly
    0.029994
    """
    chosen = settings_from(settings, options)
    posed: Any = measured(graph)
    start = None if initial is None else estimated(initial, posed)
    if cost is not None:
        require(cost, str, "the name of a cost")
    known = (Graph, Instance)
    problems = (Quadratic, Sum)
    if not isinstance(posed, (*known, *problems)):
        raise InputError(
            f"solve takes a graph, a problem, an instance or a path, not {kind_of(posed)}"
        )
    source = posed if isinstance(posed, Instance) else None
    problem = objective_of(posed, cost, kernel)
    given = None if start is None else Start(start, GIVEN)
    stored = _stored(source) if chosen.try_file_start else None
    with watched(monitor) as shown:
        found = search(problem, chosen, given, shown, on_disagreement or ignore, stored)
    if source is None:
        return found
    certificate = of_instance(found.certificate, source, found.estimate)
    return replace(found, instance=source, certificate=certificate)


def _stored(source: Instance | None) -> Start | None:
    """The instance's own initial values, if every node has them."""
    if source is None or source.initial is None:
        return None
    lacks = source.graph.has_positions and source.initial.translations is None
    return None if lacks else Start(source.initial, STORED)

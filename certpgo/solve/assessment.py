"""How far an estimate is from the best one found, in degrees, metres and cost."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from certpgo.certify import Certificate
from certpgo.certify.certificate import of_instance
from certpgo.errors import CertPGOError, InputError, InputNotice, kind_of
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.priors import with_world_placed
from certpgo.io.accept_paths import AnyPath, as_instance, measured
from certpgo.io.digits import Digits, Writing
from certpgo.io.gtsam_values import FACTOR_GRAPH, estimate_from_values
from certpgo.linalg.arrays import BoolArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, Judged, objective_of
from certpgo.solve import metrics
from certpgo.solve.fit import Fit
from certpgo.solve.judging import certify

#: Number of costliest edges listed.
EDGES = 5


@dataclass(frozen=True)
class Distance:
    """Distance between two estimates, each measure after its best alignment.

    That is a rigid motion, or a similarity where no scale is known.

    Attributes
    ----------
    mean_deg, worst_deg : angles between rotations, degrees
    mean_m, worst_m : distances between positions, metres; None without translations
    """

    mean_deg: float
    worst_deg: float
    mean_m: float | None = None
    worst_m: float | None = None


@dataclass(frozen=True)
class CostlyEdge:
    """An edge and its contribution to F.

    Attributes
    ----------
    edge : its number in the source, from 0, see `certpgo.Instance`
    ids : ids of its nodes
    cost : its term of F at the estimate as given
    share : ``cost`` over F
    angle : angle between R_i R_ij and R_j, radians; None where no rotation is measured
    metres : norm of t_j - t_i - R_i t_ij; None where no translation is measured
    """

    edge: int
    ids: tuple[int, int]
    cost: float
    share: float
    angle: float | None
    metres: float | None


@dataclass(frozen=True)
class Rounding:
    """The effect of rounding to a file's digits.

    Attributes
    ----------
    digits : precision of the file's poses
    cost : increase of F if the best estimate is written with these digits; None where they are too
        few for rotations
    """

    digits: Digits
    cost: float | None


@dataclass(frozen=True, eq=False)
class Assessment:
    """An estimate compared with the best one found.

    Attributes
    ----------
    certificate : the certificate of the estimate
    cost : F of the estimate as given, as computed
    best : the best estimate found: a better one from another basin, or else the refined one
    best_cost : F of ``best``
    best_is_optimal : whether ``best`` is proven optimal within the tolerance
    excess : F of the estimate as given minus ``best_cost``; not negative
    distance : from the estimate as given to ``best``
    edges : edges with the largest terms of F, in descending order
    rounding : effect of the file's digits; None for an estimate in full precision
    farthest : the largest translation residual, metres; None where no translation is measured
    fit : chi^2 of the estimate as given; None where that is not known, see `certpgo.solve.fit`
    best_fit : the same of ``best``: what says something of measurements and their noise
    """

    certificate: Certificate
    cost: float
    best: Estimate
    best_cost: float
    best_is_optimal: bool
    excess: float
    distance: Distance
    edges: tuple[CostlyEdge, ...]
    rounding: Rounding | None
    farthest: float | None = None
    fit: Fit | None = None
    best_fit: Fit | None = None

    @property
    def relative_excess(self) -> float:
        """``excess / best_cost``."""
        return self.excess / self.best_cost if self.best_cost > 0.0 else math.inf


def assess(
    problem: Judged,
    estimate: Estimate,
    certificate: Certificate,
    *,
    instance: Instance | None = None,
    writing: Writing | None = None,
    fitting: Callable[[Estimate], Fit | None] | None = None,
) -> Assessment:
    """Compare an estimate with the best one found while certifying it.

    Parameters
    ----------
    certificate : certificate of this estimate for this problem
    instance : whose problem it is: names edges, and its `poses` are those between which the
        distance is; by default nodes have the ids 0 ... n-1, and all count
    writing : number format of the estimate's file, see `certpgo.io.digits.writing_of`
    fitting : returns chi^2 of an estimate
    """
    c = certificate
    nodes = _poses(problem) if instance is None else instance.poses
    best, cost = c.best, c.best_cost
    if not cost < c.cost_upper:  # any improvement is rounding
        best, cost = estimate, c.cost_upper
    fit = best_fit = None if fitting is None else fitting(estimate)
    if fitting is not None and not c.cost_upper - cost <= c.tolerance:
        found, which = fitting(best), "the best estimate found"
        if c.proves_optimal(cost):
            which = "the optimum"
        best_fit = None if found is None else replace(found, of=which)
    return Assessment(
        certificate=c,
        cost=problem.cost(estimate),
        best=best,
        best_cost=cost,
        best_is_optimal=c.proves_optimal(cost),
        excess=c.cost_upper - cost if math.isfinite(c.cost_upper) else math.inf,
        distance=distance(
            estimate.subset(nodes), best.subset(nodes), scaled=problem.graph.in_mean_unit
        ),
        edges=costly_edges(problem, estimate, instance),
        rounding=None if writing is None else rounding_cost(problem, estimate, best, writing),
        farthest=_farthest(problem, estimate),
        fit=fit,
        best_fit=best_fit,
    )


def distance(estimate: Estimate, other: Estimate, *, scaled: bool = False) -> Distance:
    """The distance between two estimates, each in any frame; if ``scaled``, in any unit."""
    turn = metrics.angular_errors(estimate, other)
    if estimate.translations is None or other.translations is None:
        return Distance(turn.mean_deg, turn.worst_deg)
    move = metrics.position_errors(estimate, other, scaled=scaled)
    return Distance(turn.mean_deg, turn.worst_deg, move.mean, move.worst)


def costly_edges(
    problem: Judged, estimate: Estimate, instance: Instance | None = None, count: int = EDGES
) -> tuple[CostlyEdge, ...]:
    """The edges with the largest terms of F; none where F is zero or not finite."""
    terms, lengths = problem.edge_costs(estimate), problem.residual_lengths(estimate)
    total = float(terms.sum())
    if not 0.0 < total < math.inf:
        return ()
    pairs = problem.graph.edges if instance is None else instance.pairs
    numbers = np.arange(len(terms)) if instance is None else instance.known_numbers
    angles = problem.residual_angles(estimate)
    turned, moved = measured_parts(problem)
    known = np.flatnonzero(turned | moved)
    return tuple(
        CostlyEdge(
            edge=int(numbers[e]),
            ids=(int(pairs[e, 0]), int(pairs[e, 1])),
            cost=float(terms[e]),
            share=float(terms[e]) / total,
            angle=float(angles[e]) if turned[e] else None,
            metres=float(lengths[e]) if lengths is not None and moved[e] else None,
        )
        for e in known[np.argsort(-terms[known], kind="stable")[:count]].tolist()
    )


def measured_parts(problem: Judged) -> tuple[BoolArray, BoolArray]:
    """(m,) which edges measure a rotation, and which a translation."""
    graph = problem.chordal.graph
    turned, moved = graph.measures_rotation, graph.measures_translation
    counted = np.ones(len(turned), dtype=bool)
    counted[problem.rejected] = False  # residuals of rejected ones say nothing
    return turned & counted, moved & counted


def _farthest(problem: Judged, estimate: Estimate) -> float | None:
    """The largest translation residual, metres; None where no translation is measured."""
    lengths, (_, moved) = problem.residual_lengths(estimate), measured_parts(problem)
    return float(lengths[moved].max()) if lengths is not None and moved.any() else None


def rounding_cost(
    problem: Judged, estimate: Estimate, best: Estimate, writing: Writing
) -> Rounding:
    """The increase of F when the best estimate is written like the file of the estimate.

    It is first aligned with the estimate, as the rounding error depends on the size of the numbers.
    """
    nodes = _poses(problem)
    S = metrics.align(best.subset(nodes), estimate.subset(nodes))
    moved = best.moved(S)
    if moved.translations is not None and estimate.translations is not None:
        offset = (estimate.translations - moved.translations).mean(axis=0)
        moved = moved.with_translations(moved.translations + offset)
    try:
        rise = problem.cost(writing.rounded(moved)) - problem.cost(best)
    except CertPGOError:
        return Rounding(writing.digits, None)
    return Rounding(writing.digits, max(rise, 0.0))


def _poses(problem: Judged) -> IntArray:
    """The nodes that have a rotation."""
    return problem.chordal.poses


def certify_values(
    graph: Graph | Instance | AnyPath | Any,
    values: Any,
    *,
    cost: str | None = None,
    ids: ArrayLike | None = None,
    **options: Any,
) -> Certificate:
    """Certify GTSAM's Values, or any object with ``keys()`` and ``atPose3``, ``atRot3`` and so on.

    Keys are matched with node ids, else by the index of Symbols, else in ascending order if there
    are equally many; the last two give an `InputNotice`. Poses work for rotation graphs too. The
    world of an instance has no key.

    Parameters
    ----------
    graph : a graph, whose ids are 0 ... n-1, an instance with its own ids, the path of its file,
        or GTSAM's NonlinearFactorGraph, see `certpgo.from_gtsam`
    values : poses or rotations, 2D or 3D like the graph
    cost : ``"chordal"``, or for an instance with information matrices ``"gtsam"`` or ``"g2o"``; by
        default ``"gtsam"`` for a factor graph, and ``"chordal"`` for all else
    ids : (n,) integers, the key of each node, to avoid guessing the match
    options : options of `certify`: tier, rtol, atol, refine

    Raises
    ------
    InputError
        The keys do not match, or the values are of another kind.

    Examples
    --------
    Any object with this interface of GTSAM's Values can be certified:

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(9, 0.3, 1)
    >>> class Rotation:
    ...     def __init__(self, R):
    ...         self.R = R
    ...     def matrix(self):
    ...         return self.R
    >>> class Values:
    ...     def keys(self):
    ...         return range(9)
    ...     def atRot3(self, key):
    ...         return Rotation(around.rotations[key])
    >>> certpgo.certify_values(instance, Values()).verdict.value
    'REFUTED'
    """
    if type(graph).__name__ == FACTOR_GRAPH:
        return _certify_factors(graph, values, cost, ids, options)
    posed = measured(graph)
    instance = as_instance(posed, "certify_values")
    if not callable(getattr(values, "keys", None)):
        raise InputError(f"GTSAM's Values expected, not {kind_of(values)}: certify takes estimates")
    of, keys = instance.graph, _keys_of(instance)
    n, points = len(keys), instance.graph.is_point[: instance.world]
    if ids is not None:
        keys = np.asarray(ids)
        if keys.shape != (n,) or keys.dtype.kind not in "iu" or len(np.unique(keys)) != n:
            raise InputError(f"ids must be {n} distinct integers, the key of each node")
    estimate, notice = estimate_from_values(
        values, keys, of.d, of.has_positions, points=points, exact=ids is not None
    )
    if notice:
        warnings.warn(notice, InputNotice, stacklevel=2)
    estimate = with_world_placed(of, instance.with_world(estimate))
    return certify(objective_of(posed, CHORDAL if cost is None else cost), estimate, **options)


def _keys_of(instance: Instance) -> IntArray:
    """(n,) the source's own numbers of the nodes but the world."""
    ids = instance.ids[: instance.world]
    return ids if instance.apart is None else ids - instance.moved_by * instance.apart[: len(ids)]


def _certify_factors(
    graph: Any, values: Any, cost: str | None, ids: ArrayLike | None, options: dict[str, Any]
) -> Certificate:
    """The certificate of values for their factor graph, whose keys are the nodes."""
    if ids is not None:
        raise InputError("ids are for graphs of other sources: a factor graph has its own keys")
    from certpgo.objective.gtsam_graph import judged_factors

    problem, estimate, instance = judged_factors(graph, values, cost or "gtsam")
    found = certify(problem, estimate, **options)
    return found if instance is None else of_instance(found, instance, estimate)

"""A certificate in plain words, and what is known of its estimate."""

from __future__ import annotations

import math
from collections.abc import Iterable

from certpgo.certify.certificate import CHORDAL, Certificate
from certpgo.certify.wording import part
from certpgo.graph import Instance
from certpgo.graph.graph import length_unit
from certpgo.graph.phrases import counted, few, shown_id
from certpgo.linalg.arrays import IntArray
from certpgo.solve.assessment import Assessment
from certpgo.solve.metrics import TrajectoryErrors
from certpgo.solve.outliers import Disagreement

#: Number of edges shown; --json has more.
EDGES = 3
#: Share of the tolerance above which the effect of a file's digits is reported.
NOTABLE = 0.01
#: Ratio of angles from which they are not those of one estimate.
ELSEWHERE = 1.001


def provenance(instance: Instance, certificate: Certificate) -> Iterable[tuple[str, str]]:
    """What stands between the source and the verdict: averaged weights and fixed nodes."""
    if certificate.objective == CHORDAL and instance.averaged:
        yield "weights", f"kappa and tau average {instance.averaged}"
    yield from fixed(instance)


def fixed(instance: Instance) -> Iterable[tuple[str, str]]:
    """Which nodes the source fixes, and whether they are held, if there are any."""
    if instance.fixed:
        named = few(instance.ids[list(instance.fixed)].tolist())
        # One fixed pose alone is no constraint: it chooses the frame.
        alone = len(instance.fixed) == 1 and instance.world is None
        yield "fixed", f"{named} by the file{'' if instance.held or alone else ', not held here'}"


def redundancy(instance: Instance) -> Iterable[tuple[str, str]]:
    """That no measurement checks another, if so."""
    graph = instance.graph
    if instance.graph.ranges is None and graph.num_edges < graph.num_nodes:
        yield (
            "redundancy",
            "none: a tree fits any measurements, so the verdict says nothing of them",
        )


def hint(disagreement: Disagreement, certificate: Certificate | None = None) -> str:
    """How many measurements disagree, and which command rejects them."""
    found = f"{disagreement}" if certificate is None else disagreeing(disagreement, certificate)
    return f"{found}; certpgo solve --robust rejects such measurements"


def disagreeing(disagreement: Disagreement, certificate: Certificate) -> str:
    """How many measurements disagree, and whether the angle is that at another estimate."""
    elsewhere = disagreement.worst_angle > ELSEWHERE * certificate.max_residual_angle
    return f"{disagreement}{' at another fit' if elsewhere else ''}"


def few_edges(instance: Instance, edges: IntArray) -> str:
    """The first edges by node ids, and the number of others."""
    pairs = instance.pairs[edges[:EDGES]]
    named = ", ".join(ends(instance, i, j) for i, j in pairs.tolist())
    more = len(edges) - len(pairs)
    return f"{named} and {more} more" if more else named


def ends(instance: Instance, first: int, second: int, joint: str = "to") -> str:
    """An edge by the ids of its nodes, the world by this name."""
    of_world = instance.world is not None and first == instance.ids[instance.world]
    return f"{'the world' if of_world else shown_id(first)} {joint} {shown_id(second)}"


def accuracy(errors: TrajectoryErrors) -> Iterable[tuple[str, str]]:
    """Absolute and relative trajectory errors as names and values."""
    aligned, steps = "after alignment", "from each to the next"
    unit = "m"
    if errors.scaled:
        aligned, unit = "after the best similarity", "of the truth's units"
    over = counted(errors.poses, "pose{s}")
    for name, metres, degrees, how in (
        ("ATE", errors.ate_m, errors.ate_deg, aligned),
        ("RPE", errors.rpe_m, errors.rpe_deg, steps),
    ):
        parts = [] if metres is None else [f"{metres:.6g} {unit}"]
        parts += [] if degrees is None else [f"{degrees:.6g} degrees"]
        if parts:
            yield name, f"{', '.join(parts)}  (root mean square, {over}, {how})"


def comparison(a: Assessment, instance: Instance) -> Iterable[tuple[str, str]]:
    """The distance to the best estimate, the costliest edges, and the effect of rounding."""
    yield from distances(a, instance)
    yield from _edges(a, instance)
    yield from digits(a)


def distances(a: Assessment, instance: Instance) -> Iterable[tuple[str, str]]:
    """The distance to the best estimate, if that costs less."""
    c, d = a.certificate, a.distance
    if not a.excess > c.tolerance:
        return
    unit = length_unit(instance.graph)
    which = "the optimum" if a.best_is_optimal else "the best estimate found"
    lengths = (
        ""
        if d.mean_m is None
        else f", {d.mean_m:.3g} {unit} on average and {d.worst_m:.3g} {unit} at most"
    )
    degrees = f"{d.mean_deg:.3g} degrees on average and {d.worst_deg:.3g} degrees at most"
    poses = " (landmarks are left out)" if instance.graph.is_point.any() else ""
    yield "distance", f"to {which}: {degrees}{lengths}{poses}"
    # A cost that is nearly all lost would be 100 % less.
    shown = math.isfinite(c.cost_upper) and a.excess < 0.995 * c.cost_upper
    share = f" ({part(a.excess / c.cost_upper)})" if shown else ""
    yield "", f"{which} costs {a.excess:.4g}{share} less"


def _edges(a: Assessment, instance: Instance) -> Iterable[tuple[str, str]]:
    unit = length_unit(instance.graph)
    for k, edge in enumerate(a.edges[:EDGES]):
        share = f"{ends(instance, *edge.ids)}: {100.0 * edge.share:.3g} % of the cost"
        degrees = [] if edge.angle is None else [f"{math.degrees(edge.angle):.4g} degrees"]
        lengths = [] if edge.metres is None else [f"{edge.metres:.3g} {unit}"]
        residual = ", ".join([*degrees, *lengths])
        yield "" if k else "costliest edges", f"{share}, residual {residual}"


def digits(a: Assessment) -> Iterable[tuple[str, str]]:
    """By how much rounding to the file's digits raises the cost, if notable."""
    if a.rounding is None:
        return
    written, cost = a.rounding.digits, a.rounding.cost
    if cost is None:
        yield "digits", f"{written} in the file are too few for rotations"
    elif cost > NOTABLE * a.certificate.tolerance:
        share = f", {cost / a.best_cost:.1e} of it" if a.best_cost > a.certificate.tolerance else ""
        yield (
            "digits",
            f"rounding to the file's {written} raises even the lowest cost by {cost:.1g}{share}",
        )

"""A certificate in plain words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from certpgo.assess.assessment import Assessment
from certpgo.certify import Certificate
from certpgo.certify.certificate import CHORDAL
from certpgo.graph import Instance
from certpgo.linalg.arrays import IntArray
from certpgo.solvers.certified.disagreement import Disagreement

#: Number of edges shown; --json has more.
EDGES = 3
#: Share of the tolerance above which the effect of a file's digits is reported.
NOTABLE = 0.01

_MEANINGS = {
    "CERTIFIED": "no estimate can be better by more than the tolerance; this is proven",
    "BOUNDED": "the gap to the best possible estimate is proven, but exceeds the tolerance",
    "REFUTED": "a lower-cost estimate exists that local descent from this one does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
_RIGHT_BASIN = "not the optimum, but local descent from here reaches it; this is proven"
_RIGHT_ROTATIONS = "not the optimum, but with its best translations it is; this is proven"
_HINT = "a hint of the gap to the best possible estimate; this tier proves nothing"
_TRUSTS = {
    "screen": "a plain factorization whose rounding errors are not bounded: a hint, no proof",
    "standard": (
        "a factorization with bounded rounding errors, provided that the linear algebra library "
        "keeps the usual error bound"
    ),
    "proof": (
        "the residual of a factorization, measured in integers and exact products: only IEEE 754 "
        "arithmetic, Python and NumPy's sums of products are trusted"
    ),
}


_ANGLES = ", and its library's sine and arctangent to 4 units in the last place"


def meaning(certificate: Certificate) -> str:
    """What the verdict means."""
    verdict = certificate.verdict.value
    if certificate.tier.value == "screen" and verdict == "BOUNDED":
        return _HINT
    in_right_basin = verdict == "BOUNDED" and certificate.basin_is_global
    if in_right_basin:
        return _RIGHT_BASIN if certificate.descended else _RIGHT_ROTATIONS
    return _MEANINGS[verdict]


def trusts(certificate: Certificate) -> Iterable[tuple[str, str]]:
    """The assumptions of the proof, unless nothing was proven."""
    if certificate.verdict.value != "UNDECIDED":
        angles = certificate.tier.value == "proof" and "EdgeSE2" in certificate.objective
        yield "proof rests on", _TRUSTS[certificate.tier.value] + (_ANGLES if angles else "")


def objective(reading: Mapping[str, str], certificate: Certificate | None = None) -> str:
    """The cost that the verdict refers to."""
    if certificate is not None and certificate.objective != CHORDAL:
        return certificate.objective
    return f"F with {reading_sentence(reading)}"


def stated_objective(reading: Mapping[str, str], certificate: Certificate) -> str:
    """The cost that the verdict refers to, and that others minimise others."""
    others = " (other tools minimise other errors)" if certificate.objective == CHORDAL else ""
    return f"{objective(reading, certificate)}{others}"


def reading_sentence(reading: Mapping[str, str]) -> str:
    """How a file was read, in words."""
    if not reading:
        return "as generated"
    weights, information = reading.get("weights", "file"), reading.get("information", "all")
    of_file = weights == "file" and information != "none"
    if information == "none" and weights in ("file", "unit"):
        sentence = "weights 1: the file has no information"
    elif weights == "unit":
        sentence = "all weights 1, ignoring those of the file"
    elif weights == "mahalanobis":
        sentence = "Mahalanobis weights from the file's information matrices"
    elif of_file:
        rest = ", 1 where it has none" if information == "some" else ""
        sentence = f"weights from the file's information matrices{rest}"
    else:
        sentence = f"weights {weights}"
    about = reading.get("rotation_information", "tangent")
    if of_file and about != "tangent":
        sentence += f" (rotational part read as {about})"
    keep = reading.get("keep", "all")
    parallel = "parallel edges added" if keep == "all" else f"only the {keep} of parallel edges"
    return f"{sentence}; {parallel}"


def part(share: float) -> str:
    """A share in percent, or in scientific notation if it is small."""
    return f"{100.0 * share:.3g} %" if share >= 1e-3 else f"{share:.2e}"


def hint(disagreement: Disagreement) -> str:
    """How many measurements disagree, and what to try."""
    return f"{disagreement}: try certpgo solve --robust"


def few_edges(instance: Instance, edges: IntArray) -> str:
    """The first edges by node ids, and the number of others."""
    pairs = instance.ids[instance.graph.edges[edges[:EDGES]]]
    named = ", ".join(f"{i} to {j}" for i, j in pairs.tolist())
    more = len(edges) - len(pairs)
    return f"{named} and {more} more" if more else named


def numbers(certificate: Certificate) -> Iterable[tuple[str, str]]:
    """Cost, bound, gap and tolerance as names and values."""
    yield "cost F, at most", f"{certificate.cost_upper:.12g}"
    if math.isfinite(certificate.lower_bound):
        claim = "no estimate of this graph costs less"
        claim = f"likely: {claim}" if certificate.tier.value == "screen" else claim
        yield "lower bound", f"{certificate.lower_bound:.12g}  ({claim})"
        positive = certificate.cost_upper > 0.0
        share = f"  ({part(certificate.relative_gap)} of the cost)" if positive else ""
        yield "gap", f"{certificate.gap:.3g}{share}"
    yield "tolerance", f"{certificate.tolerance:.3g}"
    yield "largest residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost_upper - certificate.tolerance:
        name, what = ("after descent", "after local descent")
        if not certificate.descended:
            name, what = "translations", "with its best translations"
        yield name, f"{certificate.refined_cost:.12g}  (its cost {what})"
    if certificate.better_cost is not None:
        yield "lower cost", f"{certificate.better_cost:.12g}"


def comparison(a: Assessment) -> Iterable[tuple[str, str]]:
    """The distance to the best estimate, the costliest edges, and the effect of rounding."""
    yield from distances(a)
    yield from _edges(a)
    yield from digits(a)


def distances(a: Assessment) -> Iterable[tuple[str, str]]:
    """The distance to the best estimate, if that costs less."""
    c, d = a.certificate, a.distance
    if not a.excess > c.tolerance:
        return
    which = "the optimum" if a.best_is_optimal else "the best estimate found"
    apart = f"{which} is {d.mean_deg:.3g} degrees away on average, {d.worst_deg:.3g} at most"
    if d.mean_m is not None:
        apart += f"; {d.mean_m:.3g} m on average, {d.worst_m:.3g} m at most"
    yield "distance", apart
    share = f" ({part(a.excess / c.cost_upper)})" if math.isfinite(c.cost_upper) else ""
    yield "", f"and costs {a.excess:.4g}{share} less than this one"


def _edges(a: Assessment) -> Iterable[tuple[str, str]]:
    for k, edge in enumerate(a.edges[:EDGES]):
        share = f"{edge.ids[0]} to {edge.ids[1]}: {100.0 * edge.share:.3g} % of F"
        degrees = [] if edge.angle is None else [f"{math.degrees(edge.angle):.4g} degrees"]
        metres = [] if edge.metres is None else [f"{edge.metres:.3g} m"]
        residual = ", ".join([*degrees, *metres])
        yield "" if k else "costliest edges", f"{share}, residual {residual}"


def digits(a: Assessment) -> Iterable[tuple[str, str]]:
    """The increase of F by rounding to the file's digits, if notable."""
    if a.rounding is None:
        return
    written, cost = a.rounding.digits, a.rounding.cost
    if cost is None:
        yield "digits", f"the file's {written} are too few for rotations"
    elif cost > NOTABLE * a.certificate.tolerance:
        share = f", {cost / a.best_cost:.1e} of F" if a.best_cost > a.certificate.tolerance else ""
        yield (
            "digits",
            f"rounding to the file's {written} raises even the best F by {cost:.1g}{share}",
        )

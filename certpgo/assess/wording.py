"""What a certificate says, in words that need no paper."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from certpgo.assess.assessment import Assessment
from certpgo.certify import Certificate
from certpgo.graph import Instance
from certpgo.linalg.arrays import IntArray
from certpgo.solvers.certified.disagreement import Disagreement

#: Edges of a kind that are shown; --json has more.
EDGES = 3
#: What a file's digits cost is said from this part of the tolerance on.
NOTABLE = 0.01

_MEANINGS = {
    "CERTIFIED": "no other answer can be better by more than the tolerance, and this is proven",
    "BOUNDED": "how far this answer can be from the best is proven, but exceeds the tolerance",
    "REFUTED": "a better answer is in hand, which improving this one step by step does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
_RIGHT_BASIN = "not the best answer, but improving it reaches the best, and this is proven"
_HINT = "a hint of how far this answer can be from the best; at this tier nothing is proven"
_TRUSTS = {
    "screen": "a factorization as it is, its rounding errors unbounded: a hint, no proof",
    "standard": (
        "a factorization whose rounding errors are bounded, if the linear algebra library keeps "
        "the usual error bound of such factorizations"
    ),
    "proof": (
        "what a factorization leaves over, measured in integers and exact products: IEEE 754 "
        "arithmetic, Python and sums of products by NumPy are all that is trusted"
    ),
}


def meaning(certificate: Certificate) -> str:
    """What the verdict means."""
    verdict = certificate.verdict.value
    if certificate.tier.value == "screen" and verdict == "BOUNDED":
        return _HINT
    return _RIGHT_BASIN if _is_near(certificate) else _MEANINGS[verdict]


def trusts(certificate: Certificate) -> str:
    """What the proof rests on."""
    return _TRUSTS[certificate.tier.value]


def judged_by(reading: Mapping[str, str]) -> str:
    """Which cost it is that the verdict is about."""
    return f"F with {reading_sentence(reading)}"


def reading_sentence(reading: Mapping[str, str]) -> str:
    """Which problem a file was read as, in words."""
    if not reading:
        return "as generated"
    weights = reading.get("weights", "file")
    said = {
        "file": "weights from the file's information matrices",
        "unit": "all weights 1, whatever the file says",
    }.get(weights, f"weights {weights}")
    about = reading.get("rotation_information", "tangent")
    if weights == "file" and about != "tangent":
        said += f" (rotational part read as {about})"
    keep = reading.get("keep", "all")
    parallel = "parallel edges added" if keep == "all" else f"only the {keep} of parallel edges"
    return f"{said}; {parallel}"


def _is_near(certificate: Certificate) -> bool:
    """Whether the best answer is the one that this one leads to."""
    return certificate.verdict.value == "BOUNDED" and certificate.basin_is_global


def part(share: float) -> str:
    """A share in percent, or as a power of ten where it is small."""
    return f"{100.0 * share:.3g} %" if share >= 1e-3 else f"{share:.2e}"


def hint(disagreement: Disagreement) -> str:
    """Which measurements disagree, and what can be done."""
    return f"{disagreement}: try certpgo solve --robust"


def few_edges(instance: Instance, edges: IntArray) -> str:
    """The first edges, by the ids of their nodes, and how many more there are."""
    pairs = instance.ids[instance.graph.edges[edges[:EDGES]]]
    named = ", ".join(f"{i} to {j}" for i, j in pairs.tolist())
    more = len(edges) - len(pairs)
    return f"{named} and {more} more" if more else named


def numbers(certificate: Certificate) -> Iterable[tuple[str, str]]:
    """Cost, bound, gap and tolerance; names and values."""
    yield "cost F", f"{certificate.cost_upper:.12g}"
    if math.isfinite(certificate.lower_bound):
        said = "no answer of this graph costs less"
        said = f"likely: {said}" if certificate.tier.value == "screen" else said
        yield "lower bound", f"{certificate.lower_bound:.12g}  ({said})"
        positive = certificate.cost_upper > 0.0
        share = f"  ({part(certificate.relative_gap)} of the cost)" if positive else ""
        yield "gap", f"{certificate.gap:.3g}{share}"
    yield "tolerance", f"{certificate.tolerance:.3g}"
    yield "worst residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost_upper - certificate.tolerance:
        yield (
            "improved",
            f"{certificate.refined_cost:.12g}  (its cost after improving it step by step)",
        )
    if certificate.better_cost is not None:
        yield "better answer", f"{certificate.better_cost:.12g}"


def comparison(a: Assessment) -> Iterable[tuple[str, str]]:
    """How far the best answer in hand is, where the cost sits, and what digits cost."""
    yield from distances(a)
    yield from _edges(a)
    yield from digits(a)


def distances(a: Assessment) -> Iterable[tuple[str, str]]:
    """How far the best answer in hand is, where that is another."""
    c, d = a.certificate, a.distance
    if not a.excess > c.tolerance:
        return
    which = "the best possible answer" if a.best_is_optimal else "the best answer found"
    apart = f"{which} is {d.mean_deg:.3g} degrees away on average, {d.worst_deg:.3g} at most"
    if d.mean_m is not None:
        apart += f"; {d.mean_m:.3g} m on average, {d.worst_m:.3g} m at most"
    yield "distance", apart
    share = f" ({part(a.excess / c.cost_upper)})" if math.isfinite(c.cost_upper) else ""
    yield "", f"and costs {a.excess:.4g}{share} less than this one"


def _edges(a: Assessment) -> Iterable[tuple[str, str]]:
    for k, edge in enumerate(a.edges[:EDGES]):
        metres = "" if edge.metres is None else f", {edge.metres:.3g} m"
        said = f"{edge.ids[0]} to {edge.ids[1]}: {100.0 * edge.share:.3g} % of F"
        yield (
            "" if k else "costliest edges",
            f"{said}, off by {math.degrees(edge.angle):.4g} degrees{metres}",
        )


def digits(a: Assessment) -> Iterable[tuple[str, str]]:
    """What the file's digits cost, where that is notable."""
    if a.rounding is None:
        return
    written, cost = a.rounding.digits, a.rounding.cost
    if cost is None:
        yield "digits", f"the file's {written} are too few for rotations"
    elif cost > NOTABLE * a.certificate.tolerance:
        share = f", {cost / a.best_cost:.1e} of F" if a.best_cost > a.certificate.tolerance else ""
        yield (
            "digits",
            f"the file's {written} make even the best answer cost {cost:.1g} more{share}",
        )

"""What to do after a verdict that is not CERTIFIED; the quickstart's table, for one certificate."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from certpgo.certify import Certificate, Verdict


def advice(
    certificate: Certificate, graph: str, estimate: str = "", *, searched: bool = False
) -> list[tuple[str, str]]:
    """Sentences on what to do next, each with a command or an empty text.

    Parameters
    ----------
    graph, estimate : their files, as named in commands
    searched : whether the certified search found the estimate, not another program
    """
    match certificate.verdict:
        case Verdict.CERTIFIED:
            return []
        case Verdict.REFUTED:
            steps = _after_refuted(shlex.quote(graph), shlex.quote(estimate))
        case Verdict.UNDECIDED:
            steps = _after_undecided(shlex.quote(graph), searched)
        case _:
            steps = _after_bounded(certificate, shlex.quote(graph), shlex.quote(estimate), searched)
    return list(steps)


def _after_bounded(
    certificate: Certificate, graph: str, estimate: str, searched: bool
) -> Iterator[tuple[str, str]]:
    given = estimate if estimate != "''" else "best.g2o"
    if certificate.basin_is_global:
        yield (
            "The basin is right: take the estimate that descent ends at, which is optimal.",
            f"certpgo certify {graph} {given} --best polished.g2o",
        )
        yield (
            "Or keep yours: the distance below is how far it is from the best one. If the gap is a "
            "surprise, compare the objective with what your solver minimises.",
            "",
        )
        return
    if "round" in certificate.reason:
        yield (
            "Rounding limits this proof; the tier proof has less of it.",
            (f"certpgo certify {graph} {given} --tier proof"),
        )
    if searched:
        yield (
            "Search longer, if the time limit ended it.",
            f"certpgo solve {graph} --time-limit 600",
        )
    else:
        yield "Search further from it.", f"certpgo solve {graph} --initial {given}"
    if "distances" not in certificate.objective:
        yield (
            "If measurements may be wrong, reject those that disagree.",
            f"certpgo solve {graph} --robust",
        )
    yield "If the gap stays, it is still a guarantee, and may be small enough to act on.", ""


def _after_refuted(graph: str, estimate: str) -> Iterator[tuple[str, str]]:
    given = estimate if estimate != "''" else "best.g2o"
    yield (
        "The estimate is in the wrong basin: take the better one that was found.",
        f"certpgo certify {graph} {given} --best better.g2o",
    )
    yield (
        "Start your solver from the certified search instead of odometry.",
        f"certpgo solve {graph} -o start.g2o",
    )


def _after_undecided(graph: str, searched: bool) -> Iterator[tuple[str, str]]:
    yield (
        "Read the reason above. If a time limit ended the search, raise it.",
        (f"certpgo solve {graph} --time-limit 600"),
    )
    yield "If costs are not finite, look at the weights.", f"certpgo info {graph}"
    if not searched:
        yield "Let the certified search begin elsewhere.", f"certpgo solve {graph}"
    yield "Weaker bounds may still hold.", f"certpgo bounds {graph}"

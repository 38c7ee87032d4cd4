"""Everything with everything: each pair of kinds, costs and operations on a small graph, tried.

    python -m reports.studies.pairs --out reports/results/pairs.md

What is refused, is so by the message in its cell. Prints the share of all pairs that are refused.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from reports.studies.pairs.asking import OPERATIONS, Answer, Asked, answered
from reports.studies.pairs.graphs import KINDS, NOTHING

#: Costs by their names in options, and the operations that take one.
COSTS = ("chordal", "g2o", "gtsam")
PLAIN = "relative poses"


def asked() -> Iterator[Asked]:
    """All pairs: kinds with operations, costs with operations and kinds, and kinds with kinds."""
    names = list(KINDS)
    for kind in names:
        for operation in OPERATIONS:
            yield Asked("kind and operation", (kind,), operation)
    for cost in COSTS:
        for operation, way in OPERATIONS.items():
            if way.takes_cost:
                yield Asked("cost and operation", (PLAIN,), operation, cost)
        for kind in names[1:]:
            yield Asked("cost and kind", (kind,), "solve", cost)
    for k, one in enumerate(names[1:], 1):
        for other in names[k + 1 :]:
            if frozenset({one, other}) not in NOTHING:
                yield Asked("kind and kind", (one, other), "solve")


def table(found: list[tuple[Asked, Answer]]) -> Iterator[str]:
    """The page: shares, then everything that is refused with its message."""
    yield "# Everything with everything\n"
    yield (
        "Small graphs in the plane and in space, each with two features, given to each command, in "
        "a g2o file or else in an archive. `python -m reports.studies.pairs --out FILE` tries them "
        "again. What a file's format has no record of cannot be written: it is counted by itself, "
        "and so is what ended without an answer or a reason.\n"
    )
    yield "| pairs of | tried | certified | other answers | no record | refused | share | broken |"
    yield "|---|---:|---:|---:|---:|---:|---:|---:|"
    groups = [*dict.fromkeys(one.group for one, _ in found)]
    for name in (*groups, "all"):
        own = [answer for one, answer in found if name in (one.group, "all")]
        counts = Counter(answer.how for answer in own)
        refused = counts["refused"] / len(own)
        columns = ("certified", "answered", "unwritten", "refused")
        known = " | ".join(str(counts[how]) for how in columns)
        yield f"| {name} | {len(own)} | {known} | {refused:.1%} | {counts['broken']} |"
    yield "\n## What is refused\n"
    yield "| what | operation | cost | message |"
    yield "|---|---|---|---|"
    for one, answer in found:
        if answer.how in ("refused", "unwritten", "broken"):
            kinds = " and ".join(one.kinds)
            yield f"| {kinds} | {one.operation} | {one.cost or 'own'} | {answer.said} |"


def main() -> int:
    """Try, print, and return 1 if something ended without an answer or a message."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", help="words that a group, kind or operation begins with")
    options = parser.parse_args()
    found = []
    with TemporaryDirectory() as folder:
        for one in asked():
            words = (one.group, *one.kinds, one.operation)
            if options.only is None or any(word.startswith(options.only) for word in words):
                found.append((one, answered(one, Path(folder), options.seed)))
    lines = "\n".join(table(found))
    if options.out is not None:
        options.out.write_text(f"{lines}\n", encoding="utf-8")
    print(lines)
    return int(any(answer.how == "broken" for _, answer in found))


if __name__ == "__main__":
    sys.exit(main())

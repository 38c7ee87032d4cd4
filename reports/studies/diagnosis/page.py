"""The page of the study, from its records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from reports.studies.diagnosis.mistakes import MISTAKES, NO_CAUSES

HEAD = """# Why is my map wrong?

Made by `python -m reports.studies.diagnosis`. The guide *Why is my map wrong?* says what is tried.

Maps are walks of 60 poses on a lattice with 40 loop closures, whose noise is as stated, half of
them in the plane. One mistake is planted in each, and `certpgo.diagnose` is asked. *Recall*: how
often a right finding comes first, and how often it is among the first five. *Precision*: how often
a finding of these kinds that comes first is right, over all maps with mistakes, bad estimates and
clean ones.
"""


def text(records: dict[str, Any]) -> str:
    """The whole page."""
    graphs, clean = [*records["graphs"].values()], records["clean"].values()
    ratios = [found[1] for graph in graphs for found in graph["mistakes"].values()]
    false = sum(len(kinds) for kinds, _ in clean)
    bad = [found for graph in graphs for found in graph["bad"].items()]
    causes = [name for name, (kinds, _) in bad if {*kinds[:1]} - {*NO_CAUSES}]
    right = [
        mistake.is_named(found[0])
        for graph in graphs
        for mistake in MISTAKES
        if (found := graph["mistakes"].get(mistake.name))
    ]
    lines = [
        HEAD,
        f"**Named first: {sum(right)} of {len(right)}, {np.mean(right):.1%}. Findings in "
        f"{len(clean)} clean maps: {false}. Causes told of {len(bad)} estimates that are merely "
        f"bad: {len(causes)}.**",
        "",
        *_table(graphs, [*clean]),
        "",
        "## Estimates that are merely bad",
        "",
        "What comes first, which is to be what an optimizer did, or nothing.",
        "",
        *_bad(graphs),
        "",
        "## Time",
        "",
        "CPU time over that of `certpgo.solve` of the same map in the same process. Planted: "
        f"median {np.median(ratios):.2f}, nine of ten up to {np.quantile(ratios, 0.9):.2f}, at "
        f"most {max(ratios):.2f}. Public sets, medians of three in turn:",
        "",
        "| set | poses | solve, s | diagnose / solve | found |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, row in records["sets"].items():
        found = ", ".join(row["kinds"]) or "nothing"
        lines.append(
            f"| {name} | {row['poses']:,} | {row['solve']:.2f} | {row['ratio']:.2f} | {found} |"
        )
    return "\n".join(lines) + "\n"


def _table(graphs: list[Any], clean: list[Any]) -> Iterator[str]:
    """How each mistake is named."""
    yield "| mistake | maps | first | in the first five | precision | else first | time |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for mistake in MISTAKES:
        name = mistake.name
        own = [graph["mistakes"][name] for graph in graphs if name in graph["mistakes"]]
        first = [kinds for kinds, _ in own if mistake.is_named(kinds)]
        five = sum(bool({*kinds[:5]} & {*mistake.kinds}) for kinds, _ in own)
        others = Counter(
            kinds[0] if kinds else "nothing" for kinds, _ in own if not mistake.is_named(kinds)
        )
        said = ", ".join(f"{kind} ({times})" for kind, times in others.most_common(3))
        time = np.median([ratio for _, ratio in own])
        yield (
            f"| {name} | {len(own)} | {len(first)} | {five} | "
            f"{_precision(mistake.kinds, graphs, clean):.3f} | {said} | {time:.2f} |"
        )


def _precision(kinds: tuple[str, ...], graphs: list[Any], clean: list[Any]) -> float:
    """How often findings of some kinds that come first are right."""
    right = wrong = 0
    for graph in graphs:
        for mistake in MISTAKES:
            found = graph["mistakes"].get(mistake.name, ([], 0.0))[0]
            if found and found[0] in kinds:
                is_right = found[0] in (*mistake.kinds, *mistake.also)
                right, wrong = right + is_right, wrong + (not is_right)
        wrong += sum(
            bool(found) and found[0] in {*kinds} - {*NO_CAUSES}
            for found, _ in graph["bad"].values()
        )
    wrong += sum(bool(found) and found[0] in kinds for found, _ in clean)
    return right / max(right + wrong, 1)


def _bad(graphs: list[Any]) -> Iterator[str]:
    yield "| estimate | maps | first |"
    yield "| --- | --- | --- |"
    for name in graphs[0]["bad"]:
        own = Counter(
            kinds[0] if kinds else "nothing" for kinds, _ in (g["bad"][name] for g in graphs)
        )
        said = ", ".join(f"{kind} ({times})" for kind, times in own.most_common())
        yield f"| {name} | {sum(own.values())} | {said} |"

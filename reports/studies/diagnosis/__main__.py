"""How often mistakes that are planted are named first, and how often one is found in clean maps.

    python -m reports.studies.diagnosis [graphs] [clean]

Every mistake in so many graphs, half of them in the plane, and so many clean ones. Prints a table:
how often a right finding comes first, how often it is among the first five, and what came first
instead; then the CPU time over that of a search.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

import certpgo
from reports.studies.diagnosis.mistakes import MISTAKES, Mistake, Planted, clean


@dataclass(frozen=True)
class Tried:
    """One mistake in one graph: the kinds of findings, best first, and seconds over a search's."""

    mistake: Mistake
    kinds: tuple[str, ...]
    ratio: float

    @property
    def is_first(self) -> bool:
        """Whether a right finding comes first."""
        return self.kinds[:1] != () and self.kinds[0] in self.mistake.kinds


def examined(planted: Planted) -> tuple[tuple[str, ...], float]:
    """The kinds of findings, and CPU seconds over those of a search."""
    before = time.process_time()
    with suppress(certpgo.CertPGOError):
        certpgo.solve(planted.instance)
    usual = time.process_time() - before
    before = time.process_time()
    found = certpgo.diagnose(planted.instance, planted.estimate, truth=planted.truth)
    seconds = time.process_time() - before
    return tuple(one.kind for one in found.findings), seconds / usual


def trials(graphs: int) -> Iterator[Tried]:
    """Every mistake in every graph."""
    for number in range(graphs):
        d = 2 + number % 2
        made = clean(d, number)
        best = certpgo.solve(made).estimate
        for mistake in MISTAKES:
            if d in mistake.dimensions:
                planted = mistake.plant(made, best, np.random.default_rng(number))
                yield Tried(mistake, *examined(planted))


def main() -> None:
    """Print the table."""
    given = [int(number) for number in sys.argv[1:]]
    graphs, count = (*given, *(10, 200)[len(given) :])
    found = list(trials(graphs))
    print("| mistake | tried | first | in the first five | else |\n|---|---|---|---|---|")
    for mistake in MISTAKES:
        own = [one for one in found if one.mistake is mistake]
        first = sum(one.is_first for one in own)
        five = sum(bool({*one.kinds[:5]} & {*mistake.kinds}) for one in own)
        others = Counter(one.kinds[0] if one.kinds else "none" for one in own if not one.is_first)
        said = ", ".join(f"{kind} ({times})" for kind, times in others.most_common(3))
        print(f"| {mistake.name} | {len(own)} | {first} | {five} | {said} |")
    right = sum(one.is_first for one in found)
    print(f"\nnamed first: {right} of {len(found)}, {right / len(found):.1%}")
    ratios = np.sort([one.ratio for one in found])
    print(f"CPU time over that of solve: median {np.median(ratios):.2f}, largest {ratios[-1]:.2f}")
    false = Counter[str]()
    for number in range(count):
        made = clean(2 + number % 2, 1000 + number)
        false.update(examined(Planted(made, certpgo.solve(made).estimate))[0])
    print(f"findings in {count} clean graphs: {sum(false.values())} {dict(false) or ''}")


if __name__ == "__main__":
    main()

"""Public functions on tiny graphs that break arithmetic.

    python -m reports.studies.tiny_graphs 10000

Graphs of `reports.harness.certifiers.campaign.uneven_graph`, by seed. Prints how often each
function gave which verdict or documented refusal, and every exception that is none of these; exit
code 1 if there was one.
"""

import argparse
import multiprocessing
import sys
import warnings
from collections import Counter
from collections.abc import Callable

import numpy as np

from certpgo import CertPGOError, Estimate, certify, solve
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from reports.harness.certifiers.campaign import uneven_graph

#: Graphs that a process is given at once.
BLOCK = 25


def outcomes(seed: int) -> Counter[str]:
    """What each function makes of one graph, and of a random estimate of it."""
    rng = np.random.default_rng(np.random.SeedSequence((15, seed)))
    graph = uneven_graph(rng)
    problem = Quadratic(graph)
    n, d = graph.num_nodes, graph.d
    far = 10.0 ** rng.uniform(-9.0, 9.0) * rng.standard_normal((n, d))
    estimate = Estimate(so.random(rng, n, d), far)
    functions: dict[str, Callable[[], object]] = {
        "certify": lambda: certify(problem, estimate).verdict.value,
        "certify, proof": lambda: certify(problem, estimate, tier="proof").verdict.value,
        "certify, unrefined": lambda: certify(problem, estimate, refine=False).verdict.value,
        "solve": lambda: solve(graph).verdict.value,
        "solve from there": lambda: solve(graph, initial=estimate).verdict.value,
    }
    found: Counter[str] = Counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, function in functions.items():
            try:
                found[f"{name}: {function()}"] += 1
            except CertPGOError as error:
                found[f"{name}: refused: {type(error).__name__}"] += 1
            except Exception as error:
                found[f"{name}: seed {seed}: FAILED: {error!r}"] += 1
    return found


def block(first: int) -> Counter[str]:
    """The sum of the outcomes of a block of seeds."""
    return sum((outcomes(seed) for seed in range(first, first + BLOCK)), Counter())


def main() -> None:
    """Run, print, and exit with 1 if anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("graphs", type=int, nargs="?", default=10_000)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    found: Counter[str] = Counter()
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        for counts in pool.imap_unordered(block, range(0, options.graphs, BLOCK)):
            found += counts
    for outcome, count in sorted(found.items()):
        print(f"{count:8}  {outcome}")
    sys.exit(any("FAILED" in outcome for outcome in found))


if __name__ == "__main__":
    main()

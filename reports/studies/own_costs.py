"""Public graphs under the costs of g2o and GTSAM, with the files' full information matrices.

    python -m reports.studies.own_costs [NAME ...]

Prints a row of Markdown per graph and cost: the optimum with its verdict, relative gap and the
surrogates that were minimised, how many times it the chordal optimum costs, and seconds, on one
core: of the chordal optimum, and of everything. Graphs without a file, or with information that is
not positive definite, are named on standard error. Ctrl-C ends a row.
"""

import argparse
import sys
import time

from certpgo import datasets, solve
from certpgo.costs import COSTS, information_problem
from certpgo.errors import CertPGOError
from reports.harness.experiments.timing import one_core

NAMES = (
    *("intel", "MIT", "manhattan", "kitti_00", "kitti_05", "ring", "ais2klinik", "city10000"),
    *("cityTrees10000", "Klaus3", "toyExample"),
    *("M3500a", "M3500b", "M3500c", "tinyGrid3D", "smallGrid3D", "sphere2500", "torus3D"),
    *("parking-garage", "sphere_bignoise_vertex3", "cubicle"),
)
HEADER = (
    "| graph | cost | optimum f | verdict | gap / f | surrogates | f, chordal / f | s | s in all |"
)


def row(name: str, cost: str) -> str:
    """One graph under one cost."""
    instance = datasets.load(name, download=False, quiet=True)
    problem = information_problem(instance, cost)
    begin = time.perf_counter()
    chordal = solve(instance.graph)
    between = time.perf_counter()
    found = solve(instance, cost=cost)
    whole = time.perf_counter() - between
    certificate = found.certificate
    surrogates = (found.solution.note or "").partition("; ")[2].partition(" ")[0]
    ratio = problem.cost(chordal.estimate) / found.cost
    return (
        f"| {name} | {cost} | {found.cost:.10g} | {certificate.verdict.value} "
        f"| {certificate.relative_gap:.1e} | {surrogates} | {ratio:.5g} "
        f"| {between - begin:.2f} | {whole:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    names = parser.parse_args().names
    with one_core() as how:
        print(how, file=sys.stderr)
        print(HEADER, "|---" * HEADER[:-1].count("|") + "|", sep="\n", flush=True)
        for name in names:
            for cost in COSTS:
                try:
                    print(row(name, cost), flush=True)
                except CertPGOError as error:
                    print(f"{name}: {error}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()

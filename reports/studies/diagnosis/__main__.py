"""How often mistakes that are planted are named first, and how often one is found in clean maps.

    OPENBLAS_NUM_THREADS=1 python -m reports.studies.diagnosis [graphs] [clean] [--again]

Every mistake in so many graphs, half of them in the plane, and so many clean ones; estimates of the
same graphs that are merely bad; then CPU time over that of a search on public sets. Records are
kept in reports/results/diagnosis.json after each graph, those that are there are not made again,
and the page beside it is made from them.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo.io import datasets
from reports.studies.diagnosis import page
from reports.studies.diagnosis.mistakes import BAD, MISTAKES, Planted, clean

OUT = Path(__file__).parents[2] / "results" / "diagnosis.json"
#: Public sets, and how often each is timed.
SETS = (
    "MIT",
    "intel",
    "kitti_00",
    "kitti_05",
    "manhattan",
    "city10000",
    "smallGrid3D",
    "parking-garage",
    "sphere2500",
    "torus3D",
    "cubicle",
    "victoriaPark_reduced_1k",
)
TIMES = 3

Records = dict[str, Any]


def seconds(of: Callable[[], Any]) -> float:
    """CPU seconds of a call, which may be refused."""
    before = time.process_time()
    with suppress(certpgo.CertPGOError):
        of()
    return time.process_time() - before


def examined(planted: Planted) -> tuple[tuple[str, ...], float]:
    """The kinds of findings, and CPU seconds over those of a search."""
    usual = seconds(lambda: certpgo.solve(planted.instance))
    before = time.process_time()
    found = certpgo.diagnose(planted.instance, planted.estimate, truth=planted.truth)
    spent = time.process_time() - before
    return tuple(one.kind for one in found.findings), spent / usual


def of_graph(number: int) -> Iterator[tuple[str, str, list[Any]]]:
    """Every mistake and every bad estimate in one graph: section, name, kinds and ratio."""
    d = 2 + number % 2
    made = clean(d, number)
    best = certpgo.solve(made).estimate
    for mistake in MISTAKES:
        if d in mistake.dimensions:
            planted = mistake.plant(made, best, np.random.default_rng(number))
            yield "mistakes", mistake.name, [*examined(planted)]
    for name, worsened in BAD.items():
        bad = certpgo.Estimate(*worsened(made, best, np.random.default_rng(number)))
        yield "bad", name, [*examined(Planted(made, bad))]


def of_clean(number: int) -> list[Any]:
    """What is found in a clean graph and its best estimate."""
    made = clean(2 + number % 2, 1000 + number)
    return [*examined(Planted(made, certpgo.solve(made).estimate))]


def of_set(name: str) -> dict[str, Any]:
    """CPU seconds of a search and of a diagnosis in turn, medians, and what is found."""
    instance = datasets.load(name)
    both, found = [], certpgo.diagnose(instance)
    for _ in range(TIMES):
        usual = seconds(lambda: certpgo.solve(instance))
        both.append((usual, seconds(lambda: certpgo.diagnose(instance))))
    solve, diagnose = np.median(both, axis=0).tolist()
    kinds = [one.kind for one in found.findings]
    return {
        "poses": instance.graph.num_nodes,
        "solve": solve,
        "ratio": diagnose / solve,
        "kinds": kinds,
    }


def main() -> None:
    """Run what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("graphs", nargs="?", type=int, default=10)
    parser.add_argument("clean", nargs="?", type=int, default=200)
    parser.add_argument("--again", action="store_true", help="forget all records")
    parser.add_argument("--out", type=Path, default=OUT, help="records; the page is beside them")
    options = parser.parse_args()
    known = options.out.exists() and not options.again
    records: Records = json.loads(options.out.read_text()) if known else {}

    def keep() -> None:
        options.out.write_text(json.dumps(records, indent=None).replace("}, ", "},\n") + "\n")

    for number in range(options.graphs):
        if str(number) not in records.get("graphs", {}):
            of: Records = {"mistakes": {}, "bad": {}}
            for section, name, found in of_graph(number):
                of[section][name] = found
            records.setdefault("graphs", {})[str(number)] = of
            keep()
            print(f"graph {number + 1} of {options.graphs}", flush=True)
    for number in range(options.clean):
        if str(number) not in records.get("clean", {}):
            records.setdefault("clean", {})[str(number)] = of_clean(number)
            if number % 20 == 19 or number == options.clean - 1:
                keep()
                print(f"clean graph {number + 1} of {options.clean}", flush=True)
    for name in SETS:
        if name not in records.get("sets", {}):
            records.setdefault("sets", {})[name] = of_set(name)
            keep()
            print(name, flush=True)
    options.out.with_suffix(".md").write_text(page.text(records))


if __name__ == "__main__":
    main()

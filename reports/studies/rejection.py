"""Wrong loop closures in streams: which are rejected, beside the batch method.

    python -m reports.studies.rejection [DATASET ...] [--out FILE]

Measurements come one by one, by larger node, then by place in the file; a robust session refreshes
after every 100th and judges all again after the last. By the labels of the files: precision, of the
rejected measurements the share that is wrong, and recall, of the wrong ones the share rejected, at
the end, and of `certpgo.solve_robustly` for the whole graph. "early": wrong measurements that were
kept after some refresh; "left": those still there at the end; "back": correct ones that were
rejected after some refresh and are there at the end. Printed as CSV; process seconds.
"""

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np

from certpgo import RobustSession, datasets, solve_robustly
from certpgo.graph.streaming import arrivals, streamed
from certpgo.linalg.arrays import BoolArray, IntArray

GRAPHS = tuple(f"grid1000_{share}p_outliers" for share in (10, 30, 50))


def quality(rejected: IntArray, wrong: BoolArray) -> tuple[str, str]:
    """Precision and recall."""
    true = float(wrong[rejected].sum())
    return f"{true / max(len(rejected), 1):.3f}", f"{true / max(wrong.sum(), 1):.3f}"


def row(name: str) -> dict[str, object]:
    """The results for a dataset."""
    instance = datasets.load(name, download=False, quiet=True)
    order = arrivals(instance.graph)
    wrong = np.asarray(instance.outliers)[order]
    session, begin = RobustSession(), time.process_time()
    ever_kept, ever_rejected = np.zeros_like(wrong), np.zeros_like(wrong)
    for count, (one, nodes) in enumerate(streamed(instance.graph), 1):
        session.add(one, nodes)
        if count % 100 == 0:
            ever_kept[session.edges] = True
            ever_rejected[session.rejected] = True
    standing = session.settle()
    seconds = time.process_time() - begin
    kept = np.zeros_like(wrong)
    kept[session.edges] = True
    begin = time.process_time()
    batch = solve_robustly(instance.graph)
    alone = time.process_time() - begin
    place = np.argsort(order)
    ours, theirs = quality(session.rejected, wrong), quality(place[batch.solution.rejected], wrong)
    return {
        "graph": name,
        "edges": len(wrong),
        "wrong": int(wrong.sum()),
        "precision": ours[0],
        "recall": ours[1],
        "batch precision": theirs[0],
        "batch recall": theirs[1],
        "verdict": standing.verdict.value,
        "F": f"{standing.cost:.8g}",
        "batch F of the kept": f"{batch.certificate.cost_upper:.8g}",
        "early": int((ever_kept & wrong).sum()),
        "left": int((kept & wrong).sum()),
        "back": int((ever_rejected & kept & ~wrong).sum()),
        "s": f"{seconds:.1f}",
        "batch s": f"{alone:.1f}",
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=GRAPHS, metavar="DATASET")
    parser.add_argument("--out", type=Path, help="write the table to this file, too")
    options = parser.parse_args()
    table = [row(name) for name in options.names]
    for file in [sys.stdout] if options.out is None else [sys.stdout, options.out.open("w")]:
        writer = csv.DictWriter(file, list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()

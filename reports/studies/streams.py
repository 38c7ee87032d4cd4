"""Graphs as streams: a session beside solving every prefix anew, and beside GTSAM's iSAM2.

    python -m reports.studies.streams [DATASET ...] [--no-isam] [--out FILE]

Measurements come one by one, by larger node, then by place in the file. After every 100th and the
last, the session refreshes its certificate, and `certpgo.solve` solves the same prefix from
scratch. Printed as CSV, in process seconds: the session's time for the whole stream, the sum of
these batch solves, that of the last one alone; the largest difference of F from the batch's, over
1e-9 F + 1e-12 W; how many verdicts were weaker than the batch's, and how many bounds false (above
the batch's cost). Latencies, in milliseconds, are of single measurements: of `add`, refreshes
included, of `standing` after it (where that is asked for each time), and of iSAM2's update, which
has no certificate; where that fails by Cholesky's factorization, with QR, which is marked.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import gtsam
import numpy as np

from certpgo import Instance, Session, Verdict, solve
from certpgo.graph.streaming import arrivals, streamed
from certpgo.io import datasets
from certpgo.objective.choose_cost import information_problem
from certpgo.objective.gtsam_graph import factors_of
from reports.studies._printing import print_table

GRAPHS = ("manhattan", "sphere2500", "city10000", "kitti_00")
EVERY = 100
#: From the best verdict to the worst.
RANKED = (Verdict.CERTIFIED, Verdict.BOUNDED, Verdict.UNDECIDED)


def timed(step: Callable[[], object]) -> float:
    """Process seconds of a step."""
    begin = time.process_time()
    step()
    return time.process_time() - begin


def quantiles(seconds: list[float]) -> list[str]:
    """Median and 99 % in milliseconds."""
    return [f"{1e3 * q:.3g}" for q in np.quantile(seconds, [0.5, 0.99])]


def beside_batches(instance: Instance) -> dict[str, object]:
    """A session and the batch solves of its prefixes."""
    graph, order = instance.graph, arrivals(instance.graph)
    session, latencies, batches = Session(every=EVERY), [], []
    off, weaker, false = 0.0, 0, 0
    for count, (one, nodes) in enumerate(streamed(graph), 1):
        latencies.append(timed(lambda one=one, nodes=nodes: session.add(one, nodes)))
        if count == len(order):
            latencies[-1] += timed(session.refresh)
        if count % EVERY and count < len(order):
            continue
        edges = order[:count]
        prefix = graph.with_edges(edges).subgraph(np.arange(graph.edges[edges].max() + 1))
        found = []
        batches.append(timed(lambda prefix=prefix, found=found: found.append(solve(prefix))))
        best, now = found[0].certificate, session.standing
        allowed = 1e-9 * best.cost_upper + 1e-12 * best.scale
        off = max(off, abs(now.cost - best.cost_upper) / allowed)
        weaker += RANKED.index(now.verdict) > RANKED.index(best.verdict)
        false += now.lower_bound > best.cost_upper
    total, batch = sum(latencies), sum(batches)
    median, most = quantiles(latencies)
    return {
        "F": f"{now.cost:.10g}",
        "verdict": now.verdict.value,
        "off": f"{off:.2g}",
        "weaker": weaker,
        "false": false,
        "session s": f"{total:.2f}",
        "batches s": f"{batch:.2f}",
        "ratio": f"{total / batch:.2f}",
        "last batch s": f"{batches[-1]:.3f}",
        "add median ms": median,
        "add 99 % ms": most,
    }


def asked_each_time(instance: Instance) -> list[str]:
    """Quantiles of adding and asking what is proven, at each measurement."""
    session = Session(every=EVERY)

    def step(one: object, nodes: list[int]) -> None:
        session.add(one, nodes)
        _ = session.standing

    return quantiles([timed(lambda one=one: step(*one)) for one in streamed(instance.graph)])


def by_isam(instance: Instance, factorization: str = "CHOLESKY") -> list[str]:
    """GTSAM's iSAM2 on the same stream: seconds in all, and quantiles of updates."""
    factors = factors_of(information_problem(instance, "gtsam"))
    d = instance.graph.d
    pose, read = getattr(gtsam, f"Pose{d}"), f"calculateEstimatePose{d}"
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization(factorization)
    isam, known, seconds = gtsam.ISAM2(parameters), set(), []
    for edge in arrivals(instance.graph).tolist():
        new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factor = factors.at(edge)
        i, j = factor.keys()
        if not known:
            noise = gtsam.noiseModel.Isotropic.Sigma(3 * d - 3, 1e-3)
            new.add(getattr(gtsam, f"PriorFactorPose{d}")(i, pose(), noise))
            values.insert(i, pose())
            known.add(i)
        new.add(factor)
        begin = time.process_time()
        if j not in known:
            at = values.atPose2(i) if d == 2 and values.exists(i) else None
            at = values.atPose3(i) if d == 3 and values.exists(i) else at
            values.insert(j, (at or getattr(isam, read)(i)).compose(factor.measured()))
        elif i not in known:
            values.insert(i, getattr(isam, read)(j).compose(factor.measured().inverse()))
        known |= {i, j}
        try:
            isam.update(new, values)
        except RuntimeError:  # indeterminate, by rounding
            return by_isam(instance, "QR") if factorization != "QR" else ["failed", "", ""]
        seconds.append(time.process_time() - begin)
    mark = " (QR)" if factorization == "QR" else ""
    return [f"{sum(seconds):.2f}{mark}", *quantiles(seconds)]


def rows(graphs: list[str], isam: bool) -> Iterator[dict[str, object]]:
    """One per graph."""
    for name in graphs:
        instance = datasets.load(name, download=False, quiet=True)
        row = {"graph": name, "edges": instance.graph.num_edges, **beside_batches(instance)}
        row["asked median ms"], row["asked 99 % ms"] = asked_each_time(instance)
        if isam:
            names = ("iSAM2 s", "iSAM2 median ms", "iSAM2 99 % ms")
            row |= dict(zip(names, by_isam(instance), strict=True))
        yield row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=GRAPHS, metavar="DATASET")
    parser.add_argument("--no-isam", action="store_true", help="without GTSAM")
    parser.add_argument("--out", type=Path, help="write the table to this file, too")
    options = parser.parse_args()
    table = []
    for row in rows(options.names, not options.no_isam):
        table.append(row)
        print(*(f"{name}={value}" for name, value in row.items()), file=sys.stderr, flush=True)
    print_table(table, options.out)


if __name__ == "__main__":
    main()

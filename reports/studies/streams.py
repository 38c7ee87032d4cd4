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

import sys
from collections.abc import Iterator

import numpy as np

from certpgo import Instance, NumericalError, Session, Verdict, solve
from certpgo.graph import Graph
from certpgo.graph.streaming import streamed
from certpgo.io import datasets
from certpgo.registry import load_file
from reports.harness.speed.sessions import EVERY, GRAPHS, fed, prefix, timed
from reports.studies._printing import options, print_table

#: From the best verdict to the worst.
RANKED = (Verdict.CERTIFIED, Verdict.BOUNDED, Verdict.UNDECIDED)


def quantiles(seconds: list[float]) -> list[str]:
    """Median and 99 % in milliseconds."""
    return [f"{1e3 * q:.3g}" for q in np.quantile(seconds, [0.5, 0.99])]


def beside_batches(graph: Graph) -> dict[str, object]:
    """A session and the batch solves of its prefixes."""
    batches: list[float] = []
    found = {"off": 0.0, "weaker": 0, "false": 0}

    def compare(count: int, session: Session) -> None:
        part, answers = prefix(graph, count), []
        batches.append(timed(lambda: answers.append(solve(part))))
        best, now = answers[0].certificate, session.standing
        allowed = 1e-9 * best.cost_upper + 1e-12 * best.scale
        found["off"] = max(found["off"], abs(now.cost - best.cost_upper) / allowed)
        found["weaker"] += RANKED.index(now.verdict) > RANKED.index(best.verdict)
        found["false"] += now.lower_bound > best.cost_upper

    session, latencies = fed(graph, compare)
    total, batch = sum(latencies), sum(batches)
    median, most = quantiles(latencies)
    return {
        "F": f"{session.standing.cost:.10g}",
        "verdict": session.standing.verdict.value,
        "off": f"{found['off']:.2g}",
        "weaker": found["weaker"],
        "false": found["false"],
        "session s": f"{total:.2f}",
        "batches s": f"{batch:.2f}",
        "ratio": f"{total / batch:.2f}",
        "last batch s": f"{batches[-1]:.3f}",
        "add median ms": median,
        "add 99 % ms": most,
    }


def asked_each_time(instance: Instance) -> list[str]:
    """Quantiles of adding and asking what is proven, at each measurement."""
    session = Session(every=EVERY, cost="chordal")

    def step(one: object, nodes: list[int]) -> None:
        session.add(one, nodes)
        _ = session.standing

    return quantiles([timed(lambda one=one: step(*one)) for one in streamed(instance.graph)])


def by_isam(instance: Instance) -> list[str]:
    """GTSAM's iSAM2 on the same stream: seconds in all, and quantiles of updates."""
    try:
        seconds, factorization = load_file("baselines", "_isam2").updates(instance)
    except NumericalError:  # indeterminate, by rounding
        return ["failed", "", ""]
    mark = " (QR)" if factorization == "QR" else ""
    return [f"{sum(seconds):.2f}{mark}", *quantiles(seconds)]


def rows(graphs: list[str], isam: bool) -> Iterator[dict[str, object]]:
    """One per graph."""
    for name in graphs:
        instance = datasets.load(name, download=False, quiet=True)
        row = {"graph": name, "edges": instance.graph.num_edges, **beside_batches(instance.graph)}
        row["asked median ms"], row["asked 99 % ms"] = asked_each_time(instance)
        if isam:
            names = ("iSAM2 s", "iSAM2 median ms", "iSAM2 99 % ms")
            row |= dict(zip(names, by_isam(instance), strict=True))
        yield row


def main() -> None:
    """Print the table."""
    asked = options(__doc__, names=GRAPHS, no_isam=False, out=None)
    table = []
    for row in rows(asked.names, not asked.no_isam):
        table.append(row)
        print(*(f"{name}={value}" for name, value in row.items()), file=sys.stderr, flush=True)
    print_table(table, asked.out)


if __name__ == "__main__":
    main()

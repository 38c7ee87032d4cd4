"""The page of the studies of graphs that grow: streams, wrong loop closures, maps, sparse graphs.

python -m reports.studies.streams --out DIR/streams.csv
python -m reports.studies.rejection --out DIR/rejection.csv
python -m reports.studies.merging --out DIR/merging.csv
python -m reports.studies.sparsify --out DIR/sparsify.csv
python -m reports.studies.online DIR [--out FILE]
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

#: Where the page belongs.
PAGE = Path(__file__).parents[1] / "results" / "online.md"
HEAD = """# Graphs that grow

Made by `python -m reports.studies.online` from what four studies print, which say in detail how
they measure. Times are process seconds on one core, of F, the chordal cost.
"""
SECTIONS = {
    "streams": """## Streams

Measurements come one by one, by larger node. After every 100th a `certpgo.Session` is compared with
`certpgo.solve` of the same prefix: *off* is the largest difference of F, over 1e-9 F + 1e-12 W;
*weaker* counts verdicts weaker than the batch's, *false* bounds above its cost. *ratio* is the
session's time over the sum of all those batch solves, *last batch* the one of the whole. Latencies
are of one measurement: of adding it, refreshes included (*add*), of asking for what is proven after
each (*asked*), and of an update of GTSAM's iSAM2, which has no certificate and minimises GTSAM's
cost; marked QR where Cholesky's factorization failed.
""",
    "rejection": """## Wrong loop closures

Streams for a `certpgo.RobustSession`, which ends with the measurements that
`certpgo.solve_robustly` keeps. *early* counts wrong measurements that were kept for a while, *left*
those kept at the end, *back* correct ones that were put aside and returned. `+20` are graphs with
20 random loop closures added; measurements without labels count as correct.
""",
    "merging": """## Maps merged

Graphs cut into maps of consecutive nodes, without any relative pose of the maps. *off* is the
difference of F from the whole graph's, over 1e-9 F. With 20 wrong measurements between the maps:
*precision* and *recall* of those named, and the F of the rest.
""",
    "sparsify": """## Loop closures chosen

A fifth of the loop closures, or half where some are wrong, by `certpgo.sparsify` (*connectivity*,
*spectrum*), by MAC as its authors run it (20 Frank-Wolfe steps from the heaviest; rounded to the
largest fractions, or by Madow's samples of five seeds), the heaviest, evenly spread and random
ones; and all. *of bound*: the connectivity as a share of the bound on all choices. *wrong*: loop
closures kept of those that are labelled wrong. *loss*: by how much F of all other measurements
exceeds its optimum. *moved*: root mean square distance to that optimum; of Ellis Island, to the
truth of 227 cameras, after the alignment that minimises the sum of angles, with the *median*. MAC's
paper (arXiv 2403.19879) has its results as curves, so that its method is run here.

Connectivity asks where loop closures are, not what they measure, and prefers those that connect
distant nodes, as wrong ones do. The spectrum's margin is lambda_2 minus the mean of the smallest d
eigenvalues of the measured rotations' matrix (after Moreira 2020, section 6.3). Without wrong
measurements the two choices are alike, and neither has the least F of all measurements. Ellis
Island's real wrong measurements have no labels: its median error falls, while the root mean square
rises, since cameras that few measurements hold turn away.
""",
}


def table(path: Path) -> Iterator[str]:
    """The lines of a table."""
    with path.open() as file:
        header, *rows = csv.reader(file)
    yield f"| {' | '.join(header)} |"
    yield f"| {' | '.join('---' for _ in header)} |"
    for row in rows:
        yield f"| {' | '.join(row)} |"


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path, help="with the CSV files of the studies")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    parts = [HEAD]
    for name, said in SECTIONS.items():
        lines = table(options.folder / f"{name}.csv")
        parts.append(f"{said}\n{chr(10).join(lines)}\n")
    options.out.write_text("\n".join(parts))


if __name__ == "__main__":
    main()

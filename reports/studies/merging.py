"""Graphs cut into maps of consecutive nodes, and merged by what is measured between them.

    python -m reports.studies.merging [DATASET ...] [--out FILE]

Each map has node numbers of its own, and no relative pose of maps is given. Printed as CSV: the
verdicts of the maps and of the merged graph, its F and by how much that exceeds the best F of the
whole graph, over 1e-9 F; how many measurements lie between the maps, what they add to F, and the
largest of their terms. Then with `WRONG` random measurements between the maps as well, left out
robustly: of those named as disagreeing the share that is wrong, of the wrong ones the share that is
named, and the F of the rest. Process seconds of merging, without wrong ones, and of one solve.
"""

import time
from collections.abc import Iterator

import numpy as np

from certpgo import Graph, Instance, merge, solve
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.concatenate import joined
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from reports.studies._printing import options, print_table

GRAPHS = ("sphere2500", "city10000")
PARTS = (2, 4, 8)
#: Wrong measurements between maps.
WRONG = 20
#: Ids of a map's nodes are 0 ... OFFSET - 1.
OFFSET = 100_000


def cut(graph: Graph, parts: int) -> tuple[list[Instance], Graph, np.ndarray]:
    """Maps of consecutive nodes, what lies between them, and the ids of all nodes with offset."""
    groups = np.array_split(np.arange(graph.num_nodes), parts)
    owner = np.repeat(np.arange(parts), [len(group) for group in groups])
    own = np.concatenate([np.arange(len(group)) for group in groups])
    maps = [
        Instance(f"map {k}", graph.subgraph(group), own[group]) for k, group in enumerate(groups)
    ]
    across = owner[graph.edges[:, 0]] != owner[graph.edges[:, 1]]
    return maps, graph.with_edges(across), own + OFFSET * owner


def wrong_ones(graph: Graph, ids: np.ndarray) -> Graph:
    """Random measurements between random nodes of different maps."""
    rng, d, n = np.random.default_rng(0), graph.d, graph.num_nodes
    pairs = rng.integers(0, n, (50 * WRONG, 2))
    owner = ids // OFFSET
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]][:WRONG]
    R = so.exp(rng.uniform(-2.0, 2.0, (WRONG, so.tangent_dim(d))))
    t = 5.0 * rng.standard_normal((WRONG, d))
    kappa, tau = np.median(graph.kappa), np.median(graph.tau)
    rotation = RotationGraph(n, pairs, R, np.full(WRONG, kappa))
    return PoseGraph(rotation, t, np.full(WRONG, tau))


def between(graph: Graph, ids: np.ndarray) -> Instance:
    """Measurements whose nodes have these ids."""
    nodes = np.unique(graph.edges)
    return Instance("between", graph.subgraph(nodes), ids[nodes])


def rows(name: str) -> Iterator[dict[str, object]]:
    """One for each number of maps."""
    graph = datasets.load(name, download=False, quiet=True).graph
    begin = time.process_time()
    whole = solve(graph, cost="chordal")
    alone = time.process_time() - begin
    for parts in PARTS:
        maps, joints, ids = cut(graph, parts)
        begin = time.process_time()
        merged = merge(maps, between(joints, ids), offset=OFFSET)
        seconds = time.process_time() - begin
        both = joined([joints, wrong_ones(graph, ids)], graph.num_nodes)
        robust = merge(maps, between(both, ids), offset=OFFSET, robust=True)
        wrong = robust.between[-WRONG:]
        named = np.isin(robust.disagreeing, wrong).sum()
        yield {
            "graph": name,
            "maps": parts,
            "their verdicts": " ".join(sorted({part.verdict.value for part in merged.parts})),
            "verdict": merged.answer.verdict.value,
            "F": f"{merged.answer.cost:.10g}",
            "off": f"{abs(merged.answer.cost - whole.cost) / (1e-9 * whole.cost):.2g}",
            "between": len(merged.between),
            "raised": f"{merged.raised:.5g}",
            "largest term": f"{merged.terms.max():.3g}",
            "disagree": len(merged.disagreeing),
            "precision": f"{named / max(len(robust.disagreeing), 1):.3f}",
            "recall": f"{named / WRONG:.3f}",
            "robust verdict": robust.answer.verdict.value,
            "robust F": f"{robust.answer.certificate.cost_upper:.10g}",
            "s": f"{seconds:.2f}",
            "solve s": f"{alone:.2f}",
        }


def main() -> None:
    """Print the table."""
    asked = options(__doc__, names=GRAPHS, out=None)
    table = [row for name in asked.names for row in rows(name)]
    print_table(table, asked.out)


if __name__ == "__main__":
    main()

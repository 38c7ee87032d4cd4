"""Wrong loop closures in streams: which are rejected, beside the batch method.

    python -m reports.studies.rejection [GRAPH[@FRAMES][+K] ...] [--out FILE]

Graphs are datasets or files; with +K, as many wrong loop closures are added, whose relative poses
are random, with the median weights of the graph. With @FRAMES, a folder of a depth camera's frames
that has their poses, measurements beyond `WRONG` of these are wrong (the graph is what `certpgo
reconstruct FRAMES --graph` writes). Other measurements without labels count as correct.
Measurements come one by one, by larger node, then by place in the file; a robust session refreshes
after every 100th and judges all again after the last. By the labels: precision, of the
rejected measurements the share that is wrong, and recall, of the wrong ones the share rejected, at
the end, and of `certpgo.solve_robustly` for the whole graph. "early": wrong measurements that were
kept after some refresh; "left": those still there at the end; "back": correct ones that were
rejected after some refresh and are there at the end. Printed as CSV; process seconds.
"""

import time
from pathlib import Path

import numpy as np

from certpgo import (
    Estimate,
    Instance,
    RobustSession,
    read_sequence,
    solve_robustly,
)
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.concatenate import joined
from certpgo.graph.streaming import arrivals, streamed
from certpgo.io.datasets.source import resolve
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, IntArray
from reports.studies._printing import options, print_table

GRAPHS = (*(f"grid1000_{share}p_outliers" for share in (10, 30, 50)), "kitti_00+20", "kitti_05+20")
#: Nodes that a wrong loop closure is apart at least.
APART = 50
#: Metres and degrees beyond which a measurement of frames is wrong.
WRONG = 0.1, 3.0


def quality(rejected: IntArray, wrong: BoolArray) -> tuple[str, str]:
    """Precision and recall."""
    true = float(wrong[rejected].sum())
    return f"{true / max(len(rejected), 1):.3f}", f"{true / max(wrong.sum(), 1):.3f}"


def read(name: str) -> Instance:
    """A graph with labels, and the wrong loop closures that are asked for."""
    rest, _, count = name.partition("+")
    source, _, frames = rest.partition("@")
    found = resolve(source).graph(quiet=True)
    labels = found.outliers
    if labels is None:
        labels = np.zeros(found.graph.num_edges, dtype=bool)
    if frames:
        labels = beyond(found, read_sequence(frames).truth.subset(found.ids))
    named = f"{Path(source).stem}{'+' if count else ''}{count}"
    instance = Instance(named, found.graph, found.ids, outliers=labels)
    return with_wrong_loops(instance, int(count)) if count else instance


def beyond(instance: Instance, truth: Estimate) -> BoolArray:
    """Which measurements are further than `WRONG` from true poses."""
    graph, (i, j) = instance.graph, instance.graph.edges.T
    back = np.swapaxes(truth.rotations[i], 1, 2)
    moved = (back @ (truth.translations[j] - truth.translations[i])[:, :, None])[:, :, 0]
    shift = np.linalg.norm(moved - graph.translations, axis=1)
    turn = np.swapaxes(graph.rotations, 1, 2) @ back @ truth.rotations[j]
    return (shift > WRONG[0]) | (so.angle(turn) > np.radians(WRONG[1]))


def with_wrong_loops(instance: Instance, count: int) -> Instance:
    """The graph with random measurements between random nodes."""
    rng, graph = np.random.default_rng(0), instance.graph
    n, d, q = graph.num_nodes, graph.d, so.tangent_dim(graph.d)
    first = rng.integers(0, n - APART, count)
    edges = np.column_stack([first, rng.integers(first + APART, n)])
    length = np.median(np.linalg.norm(graph.translations, axis=1))
    median = np.median(graph.kappa), np.median(graph.tau)
    kappa, tau = (np.full(count, value) for value in median)
    R, t = so.exp(rng.uniform(-2, 2, (count, q))), 5.0 * length * rng.standard_normal((count, d))
    wrong = PoseGraph(RotationGraph(n, edges, R, kappa), t, tau)
    labels = np.concatenate([instance.outliers, np.ones(count, dtype=bool)])
    return Instance(instance.name, joined([graph, wrong], n), instance.ids, outliers=labels)


def row(name: str) -> dict[str, object]:
    """The results for a graph."""
    instance = read(name)
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
        "graph": instance.name,
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
    asked = options(__doc__, names=GRAPHS, out=None)
    table = [row(name) for name in asked.names]
    print_table(table, asked.out)


if __name__ == "__main__":
    main()

"""The package's reader against the checker's own, on the same mutated g2o files."""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo import CertPGOError, Instance, PoseGraph, checker
from reports.studies.bookkeeping.drawing import draw, read_bytes
from reports.studies.bookkeeping.judging import Findings
from reports.studies.fuzz_readers import MUTATIONS

#: Entries of rotations: both are within rounding of the same.
SAME = 1e-14


def judge(rng: np.random.Generator, found: Findings) -> None:
    """Both read the same measurements, or one refuses."""
    text = draw(rng, nodes=(2, 5)).text.encode()
    for _ in range(int(rng.integers(0, 4))):
        choices = MUTATIONS["text"]
        text = choices[int(rng.integers(len(choices)))](rng, text)
    options: dict[str, Any] = {"keep": str(rng.choice(["all", "all", "first", "last"]))}
    if rng.random() < 0.2:
        options["rotation_information"] = "quaternion"
    if rng.random() < 0.1:
        options["kappa"] = 2.0
    if rng.random() < 0.1:
        options["tau"] = 3.0
    try:
        instance = read_bytes(text, **options)
    except CertPGOError as error:
        found.said[f"read refused: {type(error).__name__}"] += 1
        found.require("\n" not in str(error), f"read: a message of several lines: {error}")
        return
    for cost in (None, "g2o"):
        compare(found, text, instance, options, cost)


def compare(
    found: Findings, text: bytes, instance: Instance, options: dict[str, Any], cost: str | None
) -> None:
    """Compare what was read with what the checker reads for a proof about it."""
    graph = instance.graph
    poses = isinstance(graph, PoseGraph)
    rotation = graph.rotation if isinstance(graph, PoseGraph) else graph
    if cost is not None and (instance.information is None or not poses):
        return
    claim = {
        "d": graph.d,
        "keep": options["keep"],
        "rotation_information": options.get("rotation_information", "tangent"),
        "kappa": options.get("kappa"),
        "tau": options.get("tau"),
        "landmarks": poses and graph.points is not None,
        "priors": instance.world is not None,
        "origin": None if instance.origin is None else instance.origin.tolist(),
    }
    if cost is not None:
        claim |= {"cost": cost, "rotation_information": "quaternion" if graph.d == 3 else "tangent"}
    name = f"checker, {cost or 'chordal'}"
    try:
        other = checker.read_graph(text, claim, None)
    except (checker.Unreadable, checker.Refused) as error:
        found.said[f"{name} refused"] += 1
        found.require("\n" not in str(error), f"{name}: a message of several lines")
        return
    found.said[f"{name}: both read it"] += 1
    pairs = np.stack([other.i, other.j], axis=1)
    if (other.n, pairs.tolist()) != (graph.num_nodes, graph.edges.tolist()):
        found.false.append(f"{name}: {other.n} nodes, edges {pairs.tolist()}")
        return
    seen = graph.points if isinstance(graph, PoseGraph) else None
    seen = np.zeros(other.n, bool) if seen is None else seen
    theirs = np.zeros(other.n, bool) if other.points is None else other.points
    found.require((seen == theirs).all(), f"{name}: other points")
    if isinstance(graph, PoseGraph):
        found.require((other.t == graph.translations).all(), f"{name}: other translations")
        if cost is None:
            found.require((other.tau == graph.tau).all(), f"{name}: other tau")
    if cost is None:
        found.require((other.kappa == rotation.kappa).all(), f"{name}: other kappa")
        R = (np.array(other.R, dtype=object) / 2**checker.POINT).astype(float)
        off = np.abs(R - rotation.rotations).max()
        found.require(off <= SAME, f"{name}: rotations differ by {off:.3g}")
    elif instance.information is not None:
        same = (other.information == instance.information.matrices).all()
        found.require(same, f"{name}: other information")

"""Priors of a file: edges from the world, a node that is added to the graph."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import PoseGraph
from certpgo.graph.information import Information
from certpgo.graph.priors import origin_of, with_priors
from certpgo.graph.wording import counted
from certpgo.io.contents import BODY, Priors, TaggedLines
from certpgo.linalg.arrays import FloatArray, IntArray, numbered


def numbered_priors(path: Path, content: TaggedLines, ids: IntArray) -> Priors | None:
    """All priors of a file in its order, about nodes 0 ... n-1 with these ids; None if none.

    Raises
    ------
    FormatError
        One is about a node without measurements or initial value, or about a sensor that is
        unknown or not at its body's origin.
    """
    if not content.priors:
        return None
    columns = zip(
        *(
            (p.nodes, p.rotations, p.translations, p.kappa, p.tau, p.sensors)
            for p in content.priors
        ),
        strict=True,
    )
    order = np.argsort(np.concatenate(content.prior_lines))
    nodes, R, t, kappa, tau, sensors = (np.concatenate(column)[order] for column in columns)
    for sensor in np.unique(sensors[sensors != BODY]).tolist():
        if sensor not in content.sensors:
            # Without a line of parameters, 0 is the body itself.
            if sensor == 0:
                continue
            raise FormatError(path, None, f"a prior is about sensor {sensor}, which is unknown")
        turned, moved = content.sensors[sensor]
        if moved.any() or (turned != np.eye(len(moved))).any():
            said = f"a prior is about sensor {sensor}, which is not at its body's origin"
            raise FormatError(path, None, said)
    place = numbered(ids, nodes)
    foreign = nodes[place < 0]
    if len(foreign):
        raise FormatError(path, None, f"prior of node {foreign[0]}: no such node")
    information = joined_information([p.information for p in content.priors])
    return Priors(place, R, t, kappa, tau, information and information.subset(order), sensors)


def joined_information(parts: Sequence[Information | None]) -> Information | None:
    """The information matrices of several parts, one after another; None unless each has some."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    offsets = np.cumsum([0, *(len(part.distinct) for part in known)])
    index = [part.index + offset for part, offset in zip(known, offsets[:-1], strict=True)]
    distinct = np.concatenate([part.distinct for part in known])
    return Information(distinct, np.concatenate(index), known[0].residual)


def anchored_graph(graph: PoseGraph, priors: Priors) -> tuple[PoseGraph, FloatArray | None, str]:
    """The graph with the world as its last node, the world's origin, and a notice."""
    origin = origin_of(priors.translations)
    joined = with_priors(
        graph,
        priors.nodes,
        priors.rotations if priors.kappa.any() else None,
        priors.translations - origin,
        kappa=priors.kappa,
        tau=priors.tau,
    )
    positions = int(np.count_nonzero(priors.kappa == 0.0))
    said = counted(len(priors.nodes), "prior{s}, measured from a node that stands for the world")
    if positions:
        said += f"; {positions} of them positions alone"
    return joined, origin if origin.any() else None, said

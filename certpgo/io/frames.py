"""The frames in which estimates are written, and the initial values of graphs."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance
from certpgo.linalg.arrays import IntArray

#: See `certpgo.write`.
Anchor = Literal["file", "identity", "prior", "none"]


def anchored(
    estimate: Estimate, ids: IntArray, instance: Instance | None, anchor: Anchor | None
) -> Estimate:
    """An estimate of nodes (n,) as it is written, see `certpgo.write`, without the world."""
    if anchor is None:
        anchor = "none" if instance is None else "file"
    if anchor not in ("file", "identity", "prior", "none"):
        raise InputError(f"anchor must be file, identity, prior or none, not {anchor!r}")
    initial = None if instance is None else instance.initial
    if instance is not None and instance.world is not None:
        if anchor in ("file", "none"):
            return instance.in_world(estimate)
        estimate = estimate.subset(np.arange(instance.world))
        ids, initial = ids[:-1], None if initial is None else instance.in_world(initial)
    node = first_pose(ids, instance)
    if anchor == "none":
        return estimate
    if anchor == "identity":
        return estimate.anchored(node)
    if anchor == "prior":
        if instance is None or not instance.fixed or initial is None:
            raise InputError("anchor 'prior' needs a graph with a fixed node and its initial value")
        node = instance.fixed[0]
    if initial is not None and _same_pose(estimate, initial, node):
        return estimate
    return estimate.anchored(node, initial)


def with_answer(instance: Instance, estimate: Estimate) -> Instance:
    """The instance with an estimate as its initial values, in the frame of the source.

    Nodes that are held stay where they are, without rounding. Of others that the source fixes only
    the one by which the frame is chosen stays fixed: all others have moved.
    """
    held, before = list(instance.held), instance.initial
    if not held and instance.world is None:
        first = frame_node(instance)
        found = estimate.anchored(first, before)
        return replace(instance, initial=found, fixed=tuple({first} & {*instance.fixed}))
    found = instance.with_world(in_file_frame(estimate, instance))
    if before is None:
        return replace(instance, initial=found)
    R, t = found.rotations.copy(), found.translations
    R[held] = before.rotations[held]
    if t is not None and before.translations is not None:
        t = t.copy()
        t[held] = before.translations[held]
    return replace(instance, initial=replace(found, rotations=R, translations=t))


def in_file_frame(estimate: Estimate, instance: Instance) -> Estimate:
    """An estimate in the frame in which `write` writes it by default."""
    return anchored(estimate, instance.ids, instance, None)


def first_pose(ids: IntArray, instance: Instance | None) -> int:
    """The pose with the smallest id, or of those that are held; a point holds no rotation."""
    nodes = np.arange(len(ids)) if instance is None else instance.poses
    if instance is not None and instance.held:  # what is held stays where it is
        nodes = nodes[np.isin(nodes, instance.held)]
    return int(nodes[np.argmin(ids[nodes])])


def frame_node(instance: Instance) -> int:
    """The pose by which a graph's frame is chosen: the first that is fixed, else the first."""
    fixed = [k for k in instance.poses.tolist() if k in instance.fixed]
    return fixed[0] if fixed else first_pose(instance.ids, instance)


def _same_pose(a: Estimate, b: Estimate, node: int) -> bool:
    """Whether the node need not be moved, which avoids rounding."""
    if not np.array_equal(a.rotations[node], b.rotations[node]):
        return False
    if a.translations is None or b.translations is None:
        return True
    return np.array_equal(a.translations[node], b.translations[node])

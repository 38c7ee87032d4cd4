"""Several poses that a source holds where they are: their relative poses are not estimated.

Measurements of a held pose become measurements of the first one, from where the held pose is on
it. The held pose stays as a node that one more edge joins to the first one, in their relative
pose: the least cost of that edge is zero wherever the others are, so that the minimum, and every
lower bound, is that of the problem with the constraint. A world, from which priors are measured,
is held too, and keeps its edge as an exact prior. Points alone are held on a world, which is added
where there is none: what sees them measures from the world, which carries them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.concatenate import joined
from certpgo.graph.constructors import PoseGraph, RotationGraph
from certpgo.graph.dataset import Instance
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph
from certpgo.graph.labels import WORLD, unused
from certpgo.graph.mounted import Frames, mounted
from certpgo.graph.phrases import counted, few
from certpgo.graph.priors import origin_of
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: What becomes of fixed nodes that are not held: one chooses the frame, more are constraints.
FREED = "all are estimated, and only differences between poses are measured"
#: What six digits of a file leave of a held pose's place, radians and relative to the graph's size.
DIGITS = 1e-5
#: The reading option that says which it is.
HELD = "held"


def with_held(instance: Instance, *, hold: bool = True) -> Instance:
    """The instance whose fixed nodes are held at their initial values, if that is a constraint.

    One fixed pose is none, unless there is a world. A notice says what is held, or why nothing is.

    Parameters
    ----------
    hold : else all nodes are estimated; of similarities, the scale too whose unit is the map's

    Raises
    ------
    InputError
        There are distances, or all measurements are between fixed nodes; or what is to be released
        is not known without the constraints.
    """
    if instance.graph.has_scales and not hold:
        return _without_unit(instance, instance.graph)
    fixed = np.unique(np.array(instance.fixed, dtype=np.intp))
    constrained = len(fixed) + (instance.world is not None) > 1 and len(fixed) > 0
    if instance.held and not hold:
        named = few(instance.ids[list(instance.fixed)].tolist())
        said = f"holds nodes {named} by constraints: it cannot be read with these released"
        raise InputError(f"{instance.source or instance.name}: the file {said}")
    if not constrained or instance.stated is not None:
        return instance
    # An .npz file keeps what was said when it was read, perhaps by another choice.
    others = tuple(notice for notice in instance.notices if FREED not in notice)
    instance = replace(instance, notices=others)
    poses = fixed[~instance.graph.is_point[fixed]]
    if instance.graph.has_scales:
        said = f"{counted(len(fixed), 'node{s}')} fixed by the file: {FREED}"
        return replace(instance, notices=(*instance.notices, said))
    if not hold or instance.initial is None:
        said = f"{counted(len(fixed), 'node{s}')} fixed by the file: {FREED}"
        if hold:
            said += "; to hold them takes initial values of all nodes"
        return replace(instance, notices=(*instance.notices, said))
    named = few(instance.ids[fixed].tolist())
    where, release = instance.source or instance.name, "(--no-fixed releases them)"
    if blocks := instance.graph.blocks:
        kind = blocks[0].kind.plural
        raise InputError(f"{where}: nodes {named} are fixed, and {kind} are measured {release}")
    source, values = instance, instance.initial
    instance = instance.with_edges(instance.graph.is_measured)  # where the world is, is known now
    if not len(poses) and instance.world is None:
        instance, values = _with_world(instance, values, fixed)
    world = instance.world
    root = int(poses[0]) if len(poses) or world is None else world
    others = fixed[fixed != root]
    held = np.append(others, [] if world in (None, root) else world).astype(np.intp)
    there = values.anchored(root)
    if np.isin(instance.graph.edges, [root, *held.tolist()]).all():
        nodes = f"nodes {named} are fixed, and all measurements are between them"
        raise InputError(f"{where}: {nodes}: nothing is to be estimated {release}")
    graph, between = _on_one(instance, there, root, held)
    within, stated = int((~between).sum()), instance.graph.edges[between]
    graph = _with_exact(instance, graph, there, root, others)
    added, known = graph.num_edges - len(stated), instance.outliers
    said = f"{counted(len(fixed), 'node{s}')} held where the file fixes them ({named}): "
    said += f"relative poses of these are constraints {release}"
    if within:
        said += f"; {counted(within, 'measurement{s}')} between them left out"
    return replace(
        instance,
        graph=graph,
        released=source,
        stated=np.concatenate([stated, graph.edges[len(stated) :]]),
        numbers=np.append(instance.known_numbers[between], np.full(added, -1)),
        outliers=None if known is None else np.append(known[between], np.zeros(added, dtype=bool)),
        options={**instance.options, "fixed": HELD},
        notices=(*instance.notices, said),
    )


def _with_world(
    instance: Instance, values: Estimate, points: IntArray
) -> tuple[Instance, Estimate]:
    """The instance and its initial values with a world, near some points, that measures nothing."""
    n, names = len(instance.ids), instance.names
    origin = origin_of(_poses(values, points)[1])
    grown = replace(
        instance,
        graph=joined([instance.graph], n + 1, np.append(instance.graph.is_point, False)),
        ids=np.append(instance.ids, instance.ids.max() + 1),
        names=names and (*names, unused(str(WORLD), names)),
        apart=None if instance.apart is None else np.append(instance.apart, False),
        world=n,
        origin=origin if origin.any() else None,
        truth=None,
        initial=None,
    )
    truth, initial = instance.truth and grown.with_world(instance.truth), grown.with_world(values)
    return replace(grown, truth=truth, initial=initial), initial


def _without_unit(instance: Instance, graph: Graph) -> Instance:
    """The instance without the scale that is the unit; several that are known are measured.

    So is that of a world.
    """
    known = np.flatnonzero(~graph.free & ~graph.is_point)
    if len(known) > 1:
        said = f"{len(known)} scales are known, more than a unit: they are not released"
        return replace(instance, notices=(*instance.notices, said))
    if instance.world is not None:
        said = "positions are measured in the unit of the world, which is not released"
        return replace(instance, notices=(*instance.notices, said))
    said = "no scale is held: the unit is the root mean square of all"
    free = graph.with_unknown_scales(~graph.is_point)
    return replace(instance, graph=free, fixed=(), notices=(*instance.notices, said))


def as_stated(instance: Instance) -> Instance:
    """The instance as its source states it: what is held are fixed nodes, at the initial values.

    As it is where that is not known, or of other measurements or weights than its graph has.
    """
    source = instance.released
    if source is None or not _same(instance, with_held(source)):
        return instance
    values = instance.initial
    if values is None:  # as of rotations alone, which are held by those of the source
        values = source.initial
    elif source.world is None:
        values = instance.in_world(values)
    n = source.graph.num_nodes
    return replace(
        source,
        ids=instance.ids[:n],
        names=instance.names[:n],
        times_ns=instance.times_ns,
        initial=values,
    )


def _same(one: Instance, other: Instance) -> bool:
    """Whether the measurements of two instances, constraints apart, are the same."""
    arrays = []
    for instance in (one, other):
        graph = instance.graph.with_edges(instance.is_measured)
        own = [graph.edges, graph.rotations, graph.kappa]
        if graph.has_positions:
            own += [graph.translations, graph.tau]
            if graph.information is not None:
                own.append(graph.information.matrices)
        arrays.append(own)
    here, there = arrays
    return len(here) == len(there) and all(map(np.array_equal, here, there))


def refuse_held(instance: Instance) -> None:
    """Refuse an instance with held poses where measurements from elsewhere are to be added.

    Those of a held pose would be of its own node, and move that: the edge that joins it to the
    first one is a constraint only as long as it is the node's last.

    Raises
    ------
    InputError
        Poses are held.
    """
    if instance.held:
        named = few(instance.ids[list(instance.fixed)].tolist())
        raise InputError(
            f"{instance.name}: nodes {named} are held where the file fixes "
            "them, which measurements from elsewhere do not know: release them (--no-fixed; "
            "fixed=False), or have all in one file"
        )


def displaced(instance: Instance, estimate: Estimate) -> str:
    """That an estimate moves held nodes relative to each other, in a sentence; else empty.

    Such an estimate breaks the constraints, and its cost contains those of their edges.
    """
    if not instance.held or instance.initial is None:
        return ""
    nodes = np.array(instance.held)
    is_pose = ~instance.graph.is_point[nodes]
    root = int(nodes[is_pose][0])
    here, there = estimate.anchored(root), instance.initial.anchored(root)
    turns = np.swapaxes(there.rotations[nodes], 1, 2) @ here.rotations[nodes]
    turned, off, size = float(so.angle(turns[is_pose]).max()), 0.0, 0.0
    if here.translations is not None and there.translations is not None:
        off = float(np.linalg.norm(here.translations - there.translations, axis=1)[nodes].max())
        size = float(np.abs(there.translations).max())
    if turned <= DIGITS and off <= DIGITS * size:
        return ""
    return (
        f"nodes that the graph's file fixes are not where it holds them, by up to "
        f"{np.degrees(turned):.3g} degrees and {off:.3g} m: the cost contains that of the broken "
        "constraints, weighed as the best measurement (--no-fixed releases them)"
    )


def _on_one(
    instance: Instance, there: Estimate, root: int, held: IntArray
) -> tuple[Graph, BoolArray]:
    """The measurements with those of held nodes as of one, and which these are, (m,): not all."""
    graph, place = instance.graph, np.arange(instance.graph.num_nodes)
    place[held] = root
    edges = place[graph.edges]
    between = edges[:, 0] != edges[:, 1]
    rest, (i, j) = graph.with_edges(between), graph.edges[between].T
    frames = Frames.none(graph.num_nodes, graph.d)
    R, t = _poses(there, held)
    frames.rotations[held], frames.translations[held] = R, t
    return mounted(rest, edges[between], frames.subset(i), frames.subset(j)), between


def _poses(values: Estimate, nodes: IntArray) -> tuple[FloatArray, FloatArray]:
    """Rotations and translations of some nodes, zeros where there are none."""
    R, t = values.rotations[nodes], values.translations
    return R, np.zeros(R.shape[:2]) if t is None else t[nodes]


def _with_exact(
    instance: Instance, graph: Graph, there: Estimate, root: int, others: IntArray
) -> Graph:
    """The graph with an edge to each held node, weighed as the best measurement is."""
    d, n, world = graph.d, graph.num_nodes, instance.world
    seen, (R, t) = np.stack([np.full(len(others), root), others], axis=1), _poses(there, others)
    if world not in (None, root) and instance.initial is not None:
        seen = np.concatenate([[[world, root]], seen])
        in_world = _poses(instance.initial, np.array([root]))
        R, t = (np.concatenate(pair) for pair in zip(in_world, (R, t), strict=True))
    is_point = graph.is_point[seen[:, 1]]
    kappa = np.where(is_point, 0.0, graph.kappa.max() or 1.0)
    rotation = RotationGraph(n, seen, np.where(is_point[:, None, None], np.eye(d), R), kappa)
    if not graph.has_positions:
        return joined([graph, rotation], n)
    tau = np.full(len(seen), graph.tau.max() or 1.0)
    absolute = seen[:, 0] == world if world is not None else None
    own = graph.information and graph.information.stating(kappa, tau)
    assumed = np.ones(len(seen), bool)
    exact = PoseGraph(rotation, t, tau, None, graph.is_point, assumed, absolute, own)
    return joined([graph, exact], n, graph.is_point)

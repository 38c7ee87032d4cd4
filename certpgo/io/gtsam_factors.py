"""GTSAM's factor graphs as instances: any objects with the methods of its Python bindings.

GTSAM is not imported. Keys are the nodes' ids. GTSAM orders tangent vectors of Pose3 rotation
first, of Pose2 translation first; information here is translation first. A factor of a single pose
measures from a world at the identity: its residual is that of a relative pose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.held import with_held
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import counted, few, listed, shown_id
from certpgo.graph.priors import with_world_placed
from certpgo.graph.ranges import Ranges
from certpgo.io.build_graph import anchored
from certpgo.io.edge_weights import weighed
from certpgo.io.format import ReadOptions
from certpgo.io.gtsam_inertial import VELOCITY, Inertial, still, with_velocities
from certpgo.io.gtsam_values import estimate_from_values
from certpgo.io.nodes import Nodes, distinct
from certpgo.io.records import Rows
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, numbered

#: What messages call the graph.
SOURCE = Path("factor graph")


class _Kind(NamedTuple):
    """A type of factor.

    Attributes
    ----------
    measures : a pose, rotation, position or distance
    method : that returns it
    points : which of its nodes are points
    """

    measures: str
    d: int
    method: str
    points: tuple[bool, ...] = (False,)


#: Factors by the names of their types.
KINDS: Mapping[str, _Kind] = {
    name.format(d): _Kind(measures, d, method, points)
    for name, measures, method, points in (
        ("BetweenFactorPose{}", "pose", "measured", (False, False)),
        ("PriorFactorPose{}", "pose", "prior", (False,)),
        ("PoseRotationPrior{}D", "rotation", "measured", (False,)),
        ("PoseTranslationPrior{}D", "position", "measured", (False,)),
        ("PriorFactorPoint{}", "position", "prior", (True,)),
        ("RangeFactorPose{}", "distance", "measured", (False, False)),
        ("RangeFactor{}D", "distance", "measured", (False, True)),
        ("RangeFactor{}", "distance", "measured", (True, True)),
    )
    for d in (2, 3)
} | {"GPSFactor": _Kind("position", 3, "measurementIn")}


@dataclass(frozen=True)
class _Factor:
    """A factor with what it measures.

    Attributes
    ----------
    number : its place in the factor graph
    keys : of its nodes
    value : (d + 1, d + 1) pose, (d, d) rotation, (d,) position, or distance
    information : of the residual, translation before rotation; None for a constraint
    kernel : of robust noise, or None
    """

    number: int
    kind: _Kind
    keys: tuple[int, ...]
    value: FloatArray
    information: FloatArray | None
    kernel: Any

    @property
    def is_prior(self) -> bool:
        """Whether it measures a single node, from the world."""
        return len(self.keys) == 1


class FactorGraph(NamedTuple):
    """A factor graph as an instance.

    Attributes
    ----------
    instance : its `numbers` are the places of factors in the graph
    kernels : of robust noise, by these numbers
    """

    instance: Instance
    kernels: dict[int, Any]


def instance_of_factors(graph: Any, values: Any = None) -> FactorGraph:
    """The instance of a factor graph, whose default cost is GTSAM's, twice its error.

    One prior on a pose fixes the frame at no cost, and is left out where nothing else is measured
    in the world. Priors with constrained noise hold poses where they are.

    Parameters
    ----------
    values : GTSAM's Values, the initial values of all nodes; or None

    Raises
    ------
    InputError
        Factors of other types, or noise without a cost, named with their counts; two dimensions;
        no relative pose; a value that lacks, or is of another type.
    """
    inertial = Inertial(graph, values)
    factors = [*_factors(graph, inertial), *_turns(inertial)]
    [d, *other] = sorted({factor.kind.d for factor in factors}) or [0]
    if other or not any(f.kind.measures != "position" and not f.is_prior for f in factors):
        raise InputError("a graph of BetweenFactorPose2 or of BetweenFactorPose3 is expected")
    ids, is_point = _nodes(factors, inertial.owners)
    priors = [factor for factor in factors if factor.is_prior]
    kept, fixed = _frame(priors, alone=not inertial.steps)
    if inertial.steps and (fixed or not kept):
        raise InputError("gravity is one of the world: a prior with Gaussian noise is expected")
    between = [f for f in factors if not f.is_prior and f.kind.measures != "distance"]
    instance = _of_poses(between, ids, is_point, d)
    order, world = [*between], None
    if kept:
        instance, order, world = _with_priors(instance, kept, d), [*between, *kept], len(ids)
    numbers = np.array([factor.number for factor in order])
    ranges = [factor for factor in factors if factor.kind.measures == "distance"]
    blocks: list[Observations] = [_ranges(instance, ranges, ids)] if ranges else []
    of_blocks = [factor.number for factor in ranges]
    if inertial.steps:
        blocks.append(steps := inertial.block(len(ids) + 1, ids))
        each = np.array([step.number for step in inertial.steps])
        of_blocks += np.repeat(each, steps.num_edges // len(each)).tolist()
        instance = replace(instance, notices=(*instance.notices, inertial.notice))
    instance = replace(
        instance,
        graph=instance.graph.with_blocks(*blocks),
        world=world,
        fixed=tuple(numbered(ids, np.array([f.keys[0] for f in fixed], dtype=np.intp)).tolist()),
    )
    assumed = np.full(instance.graph.num_edges - len(numbers), -1)
    instance = replace(instance, numbers=np.r_[numbers, assumed, of_blocks].astype(np.intp))
    if values is not None:
        estimate, _ = estimate_from_values(values, ids, d, True, points=is_point, exact=True)
        if inertial.steps and estimate.translations is not None:
            t = with_velocities(estimate.translations, ids, inertial.owners, inertial.unit)
            estimate = estimate.with_translations(t)
        placed = with_world_placed(instance.graph, instance.with_world(estimate))
        instance = replace(instance, initial=placed)
    if fixed and fixed[0].information is not None:
        said = f"the prior of {shown_id(fixed[0].keys[0])} chooses the frame, at no cost: left out"
        instance = replace(instance, notices=(*instance.notices, said))
    kernels = {f.number: f.kernel for f in (*order, *ranges) if f.kernel is not None}
    return FactorGraph(_held(instance, fixed), kernels)


def _turns(inertial: Inertial) -> list[_Factor]:
    """The rotations of inertial factors."""
    kind = _Kind("rotation", 3, "", (False, False))
    return [
        _Factor(s.number, kind, (s.keys[0], s.keys[2]), s.rotation, s.turn_information, None)
        for s in inertial.steps
    ]


def _factors(graph: Any, inertial: Inertial) -> list[_Factor]:
    """All others; an InputError names those without a term, by type and with their number."""
    found, unknown = [], Counter[str]()
    for number in range(graph.size()):
        if (factor := graph.at(number)) is None or number in inertial.numbers:
            continue
        if type(factor).__name__ == VELOCITY and int(factor.keys()[0]) in inertial.owners:
            found.append(_rest(number, factor, inertial))
            continue
        kind = KINDS.get(name := type(factor).__name__)
        if kind is None:
            unknown[name] += 1
        elif not unknown:
            found.append(_factor(number, factor, kind))
    if unknown:
        named = listed([f"{count} {name}" for name, count in unknown.most_common()])
        total = counted(sum(unknown.values()), "factor{s}")
        raise InputError(f"{total} of {graph.size()} without a term that can be certified: {named}")
    return found


def _rest(number: int, factor: Any, inertial: Inertial) -> _Factor:
    """A body at rest: the point of its velocity is where it is."""
    kind, key = _Kind("position", 3, "", (False, True)), int(factor.keys()[0])
    information = still(factor, inertial.unit)
    return _Factor(number, kind, (inertial.owners[key], key), np.zeros(3), information, None)


def _factor(number: int, factor: Any, kind: _Kind) -> _Factor:
    value = getattr(factor, kind.method)()
    keys = tuple(int(key) for key in factor.keys())  # noqa: SIM118 - not a mapping
    if max(keys) >= 2**63:
        raise InputError(f"keys below 2^63 expected, not {max(keys)}")
    if kind.measures in ("pose", "rotation"):
        value = value.matrix()
    noise, kernel = factor.noiseModel(), None
    if type(noise).__name__ == "Robust":
        noise, kernel = noise.noise(), noise.robust()
    information = _information(noise, kind, len(keys) == 1, named := _named(factor, keys))
    if information is None and kernel is not None:
        raise InputError(f"{named} has Constrained noise in a robust one: no constraint")
    return _Factor(number, kind, keys, np.array(value, dtype=np.float64), information, kernel)


def _named(factor: Any, keys: Sequence[int]) -> str:
    """Such as ``the BetweenFactorPose3 between x1 and x2``."""
    ends = " and ".join(map(shown_id, keys))
    return f"the {type(factor).__name__} {'of' if len(keys) == 1 else 'between'} {ends}"


def _information(noise: Any, kind: _Kind, prior: bool, named: str) -> FloatArray | None:
    """The information of noise, translation first; None where it is a constraint of a pose."""
    if hasattr(noise, "isConstrained") and noise.isConstrained():
        if prior and kind.measures == "pose" and not np.any(noise.sigmas()):
            return None
        raise InputError(
            f"{named} has Constrained noise: what holds a whole pose is taken, by its prior"
        )
    if not hasattr(noise, "information"):
        said = "no" if noise is None else type(noise).__name__
        raise InputError(f"{named} has {said} noise: only Gaussian noise has a cost here")
    full = np.asarray(noise.information(), dtype=np.float64)
    if kind.measures == "pose" and kind.d == 3:
        full = full[np.ix_(order := [3, 4, 5, 0, 1, 2], order)]
    return 0.5 * (full + full.T)


def _nodes(factors: Sequence[_Factor], velocities: Mapping[int, int]) -> tuple[IntArray, BoolArray]:
    """The keys of all nodes, ascending, and which are points."""
    keys = [key for factor in factors for key in factor.keys] + [*velocities]
    points = [one for factor in factors for one in factor.kind.points] + [True] * len(velocities)
    ids, flags = distinct(np.array(keys, dtype=np.intp)), np.zeros((2, len(keys)), dtype=bool)
    place = numbered(ids, np.array(keys, dtype=np.intp))
    flags = np.zeros((2, len(ids)), dtype=bool)
    flags[np.array(points, dtype=np.intp), place] = True
    if (both := flags.all(axis=0)).any():
        raise InputError(f"{shown_id(int(ids[np.argmax(both)]))} is a pose and a point")
    return ids, flags[1]


def _frame(priors: Sequence[_Factor], *, alone: bool) -> tuple[list[_Factor], list[_Factor]]:
    """The priors that cost something, and those that hold a pose or choose the frame.

    Parameters
    ----------
    alone : whether nothing else is measured in the world
    """
    held = [factor for factor in priors if factor.information is None]
    keys = Counter(factor.keys[0] for factor in held)
    if twice := [key for key, count in keys.items() if count > 1]:
        raise InputError(f"{few(twice)} held by several priors: one is expected")
    kept = [factor for factor in priors if factor.information is not None]
    if alone and len(kept) == 1 and not held and kept[0].kind.measures == "pose":
        return [], kept
    return kept, held


def _rows(measured: Sequence[_Factor], ids: IntArray, d: int) -> tuple[Rows, tuple[str, ...]]:
    """Measurements of poses, rotations and positions, with zeros for what one does not measure."""
    k, p = len(measured), 3 * (d - 1)
    R, t, full = np.tile(np.eye(d), (k, 1, 1)), np.zeros((k, d)), np.zeros((k, p, p))
    for row, factor in enumerate(measured):
        turned, moved = (factor.kind.measures != other for other in ("position", "rotation"))
        chosen = slice(0 if moved else d, p if turned else d)
        full[row, chosen, chosen] = factor.information
        if turned:
            R[row] = factor.value[:d, :d]
        if moved:
            t[row] = factor.value[:d, d] if turned else factor.value
    nodes = numbered(ids, np.array([factor.keys for factor in measured], dtype=np.intp))

    def named(row: int) -> str:
        return f"the factor of {' and '.join(map(shown_id, measured[row].keys))}"

    found = weighed(SOURCE, full, R, ReadOptions(), named)
    information = found.information and found.information.of_residual("gtsam")
    return Rows(nodes, R, t, found.kappa, found.tau, information), found.notices


def _of_poses(between: Sequence[_Factor], ids: IntArray, is_point: BoolArray, d: int) -> Instance:
    rows, notices = _rows(between, ids, d)
    rotation = RotationGraph(len(ids), rows.nodes, rows.rotations, rows.kappa)
    points = is_point if is_point.any() else None
    graph = PoseGraph(
        rotation, rows.translations, rows.tau, points=points, information=rows.information
    )
    options = {"rotation_information": "tangent"}
    return Instance(str(SOURCE), graph, ids, options=options, notices=notices)


def _with_priors(instance: Instance, priors: Sequence[_Factor], d: int) -> Instance:
    """The instance with priors of its nodes, measured from the world."""
    rows, notices = _rows(priors, instance.ids, d)
    graph, origin, notice = anchored(instance.graph, rows)
    return replace(
        instance,
        graph=graph,
        ids=Nodes(instance.ids, None, None).with_world(SOURCE).ids,
        world=len(instance.ids),
        origin=origin,
        notices=(*instance.notices, *notices, notice),
    )


def _ranges(instance: Instance, measured: Sequence[_Factor], ids: IntArray) -> Ranges:
    nodes = numbered(ids, np.array([factor.keys for factor in measured], dtype=np.intp))
    distances = np.array([float(factor.value) for factor in measured])
    weights = np.array([factor.information for factor in measured], dtype=np.float64).ravel()
    return Ranges(instance.graph.num_nodes, nodes, distances, weights)


def _held(instance: Instance, fixed: Sequence[_Factor]) -> Instance:
    """The instance that holds poses whose priors are constraints, unless one chooses the frame."""
    held = [factor for factor in fixed if factor.information is None]
    if len(held) + (instance.world is not None) < 2 or not held:
        return instance
    if instance.initial is None:
        named = few([factor.keys[0] for factor in held])
        raise InputError(f"to hold {named} takes values of all nodes: from_gtsam(graph, values)")
    initial = instance.in_world(instance.initial)
    R, t = initial.rotations.copy(), np.array(initial.translations)
    nodes, d = list(instance.fixed), instance.graph.d
    R[nodes] = [factor.value[:d, :d] for factor in held]
    t[nodes] = [factor.value[:d, d] for factor in held]
    there = instance.with_world(replace(initial, rotations=R, translations=t))
    return with_held(replace(instance, initial=there))

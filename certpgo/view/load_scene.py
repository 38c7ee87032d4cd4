"""Scenes of graphs, estimates, clouds and meshes, from files or objects."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from certpgo.errors import FormatError, InputError, NoMeasurements, kind_of
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.graph import length_unit
from certpgo.io.datasets.source import Source, resolve
from certpgo.io.estimates import (
    is_in_order,
    matched_truth,
    posed_as,
    read_estimate,
    truth_among,
    truth_in_words,
    warn_of,
)
from certpgo.io.format import LabelledPoses, format_of
from certpgo.io.matching import MAX_DIFFERENCE, Matching
from certpgo.io.surfaces import Surface, is_ply, read_surface
from certpgo.io.timestamps import timed
from certpgo.linalg.arrays import BoolArray, IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.initialization import start_of
from certpgo.optimize.methods.spanning_tree import SpanningTree
from certpgo.optimize.similarity_starts import first_start
from certpgo.optimize.solution import Solution
from certpgo.solve.result import CertifiedSolution
from certpgo.view.layout import Arrangement, layout
from certpgo.view.placements import aligned, placement, residuals, weights
from certpgo.view.scene import AT_POSITIONS, Placement, Scene, drawn_edges
from certpgo.view.sureness import Sureness
from certpgo.view.tracks import scene_of_trajectories

#: What there is to look at: a path, the name of a dataset, what that was resolved to, or an object.
Thing: TypeAlias = (
    str
    | Path
    | Source
    | Graph
    | Instance
    | Estimate
    | tuple[str, Estimate]
    | Solution
    | CertifiedSolution
    | Surface
)

#: Name of the estimate that comes with a graph's file.
INITIAL_VALUES = "initial values"
#: What a file may hold.
_HOLDS = "a graph, a trajectory or other estimate, or a PLY cloud or mesh expected"


def scene_of(
    *things: Thing,
    truth: str | Path | Estimate | None = None,
    rejected: ArrayLike | None = None,
    data: Path | None = None,
    timestamps: str | Path | None = None,
    max_difference: float = MAX_DIFFERENCE,
    truth_offset: float = 0.0,
) -> Scene:
    """The scene of a graph with estimates, of trajectories, or of clouds and meshes alone.

    Parameters
    ----------
    things : at most one graph, its estimates in the order before, after (or pairs of a name and
        an estimate), and clouds or meshes in the frame of the last of them. Without a graph,
        estimates are trajectories, which are matched by ids or times. A file with a graph adds its
        initial values as an estimate that comes first; without any estimate, one is composed along
        the odometry.
    truth : of a graph, by default the one that it was read with
    rejected : indices or flags of measurements that the last estimate does without; by default
        those of a robust answer, or the outliers that are known
    data : folder to search first for datasets
    timestamps, max_difference : how poses are matched, as for `certpgo.read_estimate`
    truth_offset : seconds added to the truth's timestamps

    Raises
    ------
    InputError
        There is nothing to draw, or a second graph; an estimate of another graph.
    FormatError
        A file that cannot be read, with its path and what was expected.
    """
    found = _Found(data, Matching.of(timestamps, max_difference), truth_offset)
    # The graph first: what other files mean may depend on it.
    for thing in things:
        found.add(thing)
    if found.instance is not None:
        return _of_graph(found, timed(found.instance, timestamps), truth, rejected)
    if rejected is not None:
        raise InputError("rejected measurements need their graph")
    return scene_of_trajectories(
        found.estimates, found.surfaces, truth, found.how, found.truth_offset
    )


@dataclass
class _Found:
    """What was named, by kind."""

    data: Path | None
    how: Matching
    truth_offset: float
    instance: Instance | None = None
    estimates: list[tuple[str, Path | Estimate]] = field(default_factory=list)
    surfaces: list[tuple[str, Surface]] = field(default_factory=list)
    rejected: IntArray | None = None
    answer: CertifiedSolution | None = None

    def add(self, thing: Thing) -> None:
        """Read and keep a thing."""
        match thing:
            case str() | Path():
                self._add_file(resolve(str(thing), self.data))
            case Source():
                self._add_file(thing)
            case Instance():
                self._add_graph(thing)
            case Graph():
                self._add_graph(Instance("graph", thing, np.arange(thing.num_nodes)))
            case Estimate():
                self.estimates.append((self._fresh("estimate"), thing))
            case Solution():
                self.rejected = thing.rejected
                self.estimates.append((self._fresh("answer"), thing.estimate))
            case CertifiedSolution():
                self.add(thing.solution)
                self.answer = thing
            case (str() as name, Estimate() as estimate):
                self.estimates.append((self._fresh(name), estimate))
            case Surface():
                self.surfaces.append((self._fresh("mesh" if len(thing.faces) else "cloud"), thing))
            case _:
                raise InputError(
                    "a path, graph, instance, estimate, answer, cloud or mesh is shown, not "
                    f"{kind_of(thing)}"
                )

    def _add_file(self, source: Source) -> None:
        path = source.path()
        if path.is_file() and is_ply(path):
            self.surfaces.append((self._fresh(path.stem), read_surface(path)))
            return
        form = format_of(path)
        if form.read_graph is not None:
            try:
                self._add_graph(source.graph(quiet=True))
                return
            except NoMeasurements:
                pass
            except InputError:
                if self.instance is None or form.read_poses is None:
                    raise
        if form.read_poses is None:
            raise FormatError(path, None, f"{_HOLDS}, not {form.holds}")
        self.estimates.append((self._fresh(path.stem), path))

    def _add_graph(self, instance: Instance) -> None:
        if self.instance is not None:
            raise InputError(f"{instance.source or instance.name}: a second graph; one is shown")
        self.instance = instance

    def _fresh(self, name: str) -> str:
        """The name, with a number if something has it; no slash, which would nest."""
        taken = {other for other, _ in [*self.estimates, *self.surfaces]}
        name = name.replace("/", " ")
        numbered = (f"{name} {k}" for k in range(2, len(taken) + 3))
        return name if name not in taken else next(n for n in numbered if n not in taken)


def _of_graph(
    found: _Found,
    instance: Instance,
    truth: str | Path | Estimate | None,
    rejected: ArrayLike | None,
) -> Scene:
    graph = instance.graph
    named = [
        (name, _read(what, instance, found.how) if isinstance(what, Path) else what)
        for name, what in found.estimates
    ]
    estimates = [(name, _whole(instance, what)) for name, what in named]
    if not estimates or is_spread(instance.initial):
        estimates.insert(0, start(instance))
    places = None if graph.has_positions else layout(graph)
    poses = instance.poses
    last = estimates[-1][1]
    drawn = []
    for name, estimate in estimates:
        moved = estimate
        if estimate is not last:
            moved = aligned(estimate, last, poses, poses, scaled=graph.in_mean_unit)
        drawn.append(_placed(instance, name, moved, places))
    return Scene(
        instance.name,
        graph.d,
        instance.ids,
        drawn_edges(instance),
        instance.measurements.kinds,
        _flags(rejected, found.rejected, instance),
        graph.is_point,
        tuple(drawn),
        _truth(instance, truth, found.how.of_truth(found.truth_offset), last, places),
        weights(instance),
        tuple(found.surfaces),
        AT_POSITIONS[length_unit(graph)] if places is None else places.sentence,
        places is None,
        length_unit(graph),
        "" if found.answer is None else found.answer.certificate.in_brief,
        _sureness(found.answer, instance, last),
    )


def _sureness(
    answer: CertifiedSolution | None, instance: Instance, last: Estimate
) -> Sureness | None:
    """What a certificate knows of the last estimate, if that is the answer's."""
    if answer is None or answer.estimate is not last:
        return None
    return Sureness(instance, answer.problem, answer.certificate, last)


def _read(path: Path, instance: Instance, how: Matching) -> Estimate:
    return read_estimate(
        path, instance, timestamps=how.timestamps, max_difference=how.max_difference
    )


def _placed(
    instance: Instance, name: str, estimate: Estimate, places: Arrangement | None
) -> Placement:
    """The placement of all nodes but the world, with the residuals of all edges."""
    there = instance.in_world(estimate)
    nodes = np.arange(there.num_nodes)
    order = nodes[np.argsort(instance.ids[nodes], kind="stable")]
    return placement(
        name,
        order,
        there.subset(order),
        None if places is None else places.places,
        residuals(instance, estimate),
    )


def _whole(instance: Instance, estimate: Estimate) -> Estimate:
    """An estimate of all nodes, in their order, with the world if that was left out."""
    estimate = posed_as(estimate, instance)
    graph, n = instance.graph, instance.graph.num_nodes
    if instance.world is not None and estimate.num_nodes == n - 1:
        estimate = instance.with_world(estimate)
    if (estimate.num_nodes, estimate.d) != (n, graph.d):
        raise InputError(
            f"{instance.name}: an estimate of {n} nodes in {graph.d}D expected, not of "
            f"{estimate.num_nodes} in {estimate.d}D"
        )
    if graph.has_positions and estimate.translations is None:
        raise InputError(f"{instance.name}: an estimate with positions expected")
    return estimate


def start(instance: Instance) -> tuple[str, Estimate]:
    """The initial values of a graph with their name; without any, or all at a point, others.

    Raises
    ------
    InputError
        There are none, and the graph is not connected.
    """
    if instance.initial is not None and is_spread(instance.initial):
        return INITIAL_VALUES, instance.initial
    if not instance.graph.is_connected:
        raise InputError(
            f"{instance.source or instance.name}: an estimate is needed to draw a graph that is "
            "not connected and has no initial values"
        )
    if instance.graph.has_scales:
        return "start", first_start(Quadratic(instance.graph.with_blocks())).estimate
    graph = instance.graph
    problem = Quadratic(graph.with_blocks() if graph.has_positions else graph)
    if graph.is_partial:
        return "start", start_of(problem).estimate
    return "dead reckoning", SpanningTree(tree="odometry").solve(problem).estimate


def is_spread(initial: Estimate | None) -> bool:
    """Whether there are initial values, not all at one point, as some programs write them."""
    if initial is None or initial.translations is None:
        return initial is not None
    return bool(np.ptp(initial.translations, axis=0).any())


def _truth(
    instance: Instance,
    given: str | Path | Estimate | None,
    how: Matching,
    answer: Estimate,
    places: Arrangement | None,
) -> Placement | None:
    """The truth's placement, in the answer's frame."""
    if given is None:
        given = instance.truth
    if given is None:
        return None
    known: IntArray
    if isinstance(given, Estimate) and given.keys.identify and not is_in_order(given, instance):
        known, truth, _ = truth_among(LabelledPoses.of(given), instance, how)
    elif isinstance(given, Estimate):
        truth = instance.in_world(_whole(instance, given))
        known = np.arange(truth.num_nodes)
    else:
        known, truth, match = matched_truth(Path(given), instance, how)
        warn_of(Path(given), [truth_in_words(match, instance)])
    kept = np.flatnonzero(known != instance.world)
    nodes, truth = known[kept], truth.subset(kept)
    common = np.flatnonzero(np.isin(nodes, instance.poses))
    like, scaled = instance.in_world(answer), instance.graph.in_mean_unit
    moved = aligned(truth, like, common, nodes[common], scaled=scaled)
    order = np.argsort(instance.ids[nodes], kind="stable")
    where = None if places is None else places.places
    return placement("truth", nodes[order], moved.subset(order), where)


def _flags(given: ArrayLike | None, answered: IntArray | None, instance: Instance) -> BoolArray:
    """(m,) rejected measurements: as given, or of the answer, or known outliers; no distances."""
    m = instance.graph.num_edges
    flags = np.zeros(len(instance.graph.pairs), dtype=bool)
    if given is None:
        if answered is not None:
            flags[answered] = True
        elif instance.outliers is not None:
            flags[:m] = instance.outliers
        return flags
    try:
        flags[:m][np.asarray(given, dtype=None if np.size(given) else np.intp)] = True
    except IndexError:
        raise InputError(f"rejected must be {m} flags, or indices from 0 to {m - 1}") from None
    return flags

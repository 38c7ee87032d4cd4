"""A graph as read, with what else its source says."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from certpgo.errors import GraphError, require
from certpgo.graph.concatenate import with_others
from certpgo.graph.display import Speaking
from certpgo.graph.estimate import Estimate
from certpgo.graph.graph import Graph
from certpgo.graph.keys import NO_TIME, Keys
from certpgo.graph.kinds import PRIORS, Kind, Measurements, kinds_of
from certpgo.graph.labels import WORLD, Label, Landmark, numbering
from certpgo.graph.phrases import (
    averaged,
    components_in_words,
    counted,
    few,
    reading_sentence,
    shown_id,
    shown_path,
)
from certpgo.graph.picture import closures, drawn
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    chosen_rows,
    frozen_flags,
    frozen_floats,
    frozen_indices,
)

#: kappa of information that is the identity: in the plane, in space, and there about quaternions.
OF_ONES = (0.0, 1.0, 0.5, 0.125)


@dataclass(frozen=True, eq=False, repr=False)
class Instance(Speaking):
    """A graph as read, with other information from its source.

    Attributes
    ----------
    name : short name
    graph : the measurements, nodes 0 ... n-1
    ids : (n,) the source's own node ids; node k is ``ids[k]``
    truth : ground truth, or None
    initial : the source's initial values (e.g. its VERTEX lines), or None
    fixed : nodes that the source fixes (FIX lines, priors)
    source : path or name of a generator
    options : the reading options used (parallel edges, weights, ...), and ``"information"``:
        ``"none"`` or ``"some"`` where not all of a file's edges have it
    notices : what the reader assumed, skipped or found unusual, one sentence each
    counts : of the source's lines that notices are about, by what they are, ``{s}`` their plural
    names : (n,) the source's own names of the nodes, e.g. of images; may be empty
    outliers : (m,) whether each measurement is a known outlier, or None if unknown
    world : the node that is the world, the last one, from which priors are measured; or None
    origin : (d,) where the graph's world has its origin in the source's frame, metres: near priors
        that are far from the source's; None for zero
    apart : (n,) which nodes are landmarks that the source numbers apart from poses, as in
        LANDMARK2; None for none
    moved_by : what their ids have more than the source's own numbers
    stated : (m, 2) nodes that the source names in each measurement, where the graph has those that
        hold them, see `certpgo.graph.held`; None for the graph's own
    released : as the source states it, where nodes are held: what is written; None if not known
    numbers : (m,) what lists and tables call the `measurements`: their numbers among all of the
        source, -1 for a constraint. None for 0 ... m-1, where none of the source is left out
    times_ns : the nodes' times, nanoseconds, of all nodes but the world, `NO_TIME` for a node
        without one; or None
    camera : focal lengths and centre of the one camera of all poses, pixels; empty for none

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, _ = winding_cycle(5, 0.1, 0)
    >>> instance.name, instance.graph.num_nodes, instance.truth.num_nodes
    ('winding_cycle-5', 5, 5)
    """

    name: str
    graph: Graph
    ids: IntArray
    truth: Estimate | None = None
    initial: Estimate | None = None
    fixed: tuple[int, ...] = ()
    source: str = ""
    options: Mapping[str, str] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    outliers: BoolArray | None = None
    world: int | None = None
    origin: FloatArray | None = None
    apart: BoolArray | None = None
    moved_by: int = 0
    times_ns: IntArray | None = None
    stated: IntArray | None = None
    released: Instance | None = None
    numbers: IntArray | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    camera: tuple[float, ...] = ()

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "options": dict(self.options)}  # proxies cannot be pickled

    def __post_init__(self) -> None:
        require(self.graph, Graph, "the graph of an instance")
        require(self.names, list | tuple, "a tuple of names")
        object.__setattr__(self, "ids", frozen_indices(self.ids))
        object.__setattr__(self, "options", MappingProxyType(dict(self.options)))
        n = self.graph.num_nodes
        ordered = np.sort(self.ids, axis=None)  # several times faster than np.unique's hashing
        if self.ids.shape != (n,) or (ordered[1:] == ordered[:-1]).any():
            raise GraphError(f"ids must be {n} distinct integers")
        if self.names and len({*map(str, self.names)}) != n:
            raise GraphError(f"names must be {n} distinct strings, or none")
        self._check_arrays(n)
        self._check_world(n)
        for what, value in (("truth", self.truth), ("initial", self.initial)):
            if value is None:
                continue
            require(value, Estimate, f"an Estimate as {what}")
            if (value.num_nodes, value.d) != (n, self.graph.d):
                raise GraphError(f"{what} is for another graph: {value.num_nodes} nodes, not {n}")
            object.__setattr__(self, what, value.keyed(self.keys))

    def _check_arrays(self, n: int) -> None:
        """Freeze the arrays that may be there, and refuse those of another length."""
        m, poses = self.graph.num_edges, len(self.ids[: self.world])
        rows = len(self.graph.pairs)
        for name, freeze, shape, what in (
            ("times_ns", frozen_indices, (poses,), f"of {poses} nodes"),
            ("outliers", frozen_flags, (m,), f"{m} flags, one per edge"),
            ("stated", frozen_indices, (m, 2), f"{m} pairs of nodes, one per edge"),
            ("numbers", frozen_indices, (rows,), f"{rows} numbers, one per measurement"),
            ("apart", frozen_flags, (n,), f"{n} flags, one per node"),
            ("origin", frozen_floats, (self.graph.d,), f"{self.graph.d} coordinates"),
        ):
            if (given := getattr(self, name)) is None:
                continue
            value = freeze(given)
            if value.shape != shape:
                raise GraphError(f"{name} must be {what}, not {value.shape}")
            object.__setattr__(self, name, value)

    def _check_world(self, n: int) -> None:
        if self.world not in (None, n - 1):
            raise GraphError(f"the world must be the last node, {n - 1}, not {self.world}")
        if self.stated is not None and self.graph.blocks:
            others = self.graph.blocks[0].kind.plural
            raise GraphError(f"nodes are held where the source fixes them: {others} do not know it")
        if self.stated is None and (self.graph.edges[:, 1] == self.world).any():
            raise GraphError("edges leave the world, and none leads to it")

    @classmethod
    def labelled(
        cls,
        name: str,
        graph: Graph,
        labels: Sequence[Label],
        *,
        origin: FloatArray | None = None,
    ) -> Instance:
        """The instance whose nodes have these `labels`; the world, if it is there, is the last.

        Raises
        ------
        GraphError
            Labels that occur twice, or leave no id for a landmark or the world.
        """
        ids, names, apart, moved_by, world = numbering(labels)
        return cls(
            name,
            graph,
            ids,
            names=names,
            world=world,
            origin=origin,
            apart=apart,
            moved_by=moved_by,
        )

    @cached_property
    def labels(self) -> tuple[Hashable, ...]:
        """What the nodes are called among other graphs, as in a session or in merged maps.

        That is `certpgo.WORLD` for the world, a name where the source has names, and otherwise the
        id; of a landmark that is numbered apart from poses its own number, as a
        `certpgo.graph.labels.Landmark`.
        """
        labels: list[Label] = [*(self.names or self.ids.tolist())]
        if self.apart is not None and not self.names:
            for k in np.flatnonzero(self.apart).tolist():
                labels[k] = Landmark(int(self.ids[k]) - self.moved_by)
        if self.world is not None:
            labels[self.world] = WORLD
        return tuple(labels)

    @property
    def held(self) -> tuple[int, ...]:
        """The nodes held where the source fixes them, with the world; see `certpgo.graph.held`."""
        if self.stated is None:
            return ()
        return self.fixed if self.world is None else (*self.fixed, self.world)

    def pose_called(self, name: int) -> int | None:
        """The pose with an id; None if there is none."""
        return next((k for k in self.poses.tolist() if self.ids[k] == name), None)

    @property
    def anchor(self) -> int | None:
        """A pose that stands still: the world, or the first that is held; None if there is none."""
        still = [self.world, *(k for k in self.held if not self.graph.is_point[k])]
        return next((node for node in still if node is not None), None)

    @property
    def is_measured(self) -> BoolArray:
        """(m,) which edges are measurements, and hold no nodes or the world."""
        flags = self.graph.is_measured.copy()
        if self.numbers is not None:
            return np.asarray(flags & (self.numbers[: len(flags)] >= 0))
        flags[len(flags) - max(len(set(self.held)) - 1, 0) :] = False  # as they were appended
        return flags

    @property
    def num_measurements(self) -> int:
        """How many edges measure."""
        return int(np.count_nonzero(self.is_measured))

    @property
    def pairs(self) -> IntArray:
        """(m, 2) ids of the nodes that the source names in each of the `measurements`."""
        # Where nodes are held, there are edges alone.
        return np.asarray(self.ids[self.graph.pairs if self.stated is None else self.stated])

    @cached_property
    def known_numbers(self) -> IntArray:
        """(m,) the number of each of the `measurements` in the source, see `numbers`."""
        if self.numbers is not None:
            return self.numbers
        measured = ~self.measurements.are(Kind.HELD, Kind.ASSUMED)
        return np.where(measured, np.cumsum(measured) - 1, -1)

    @cached_property
    def measurements(self) -> Measurements:
        """All measurements with their kinds: the graph's edges, then those of its blocks."""
        graph = self.graph
        kinds = kinds_of(graph, graph.from_world | (graph.edges[:, 0] == self.world))
        kinds[~self.is_measured] = Kind.HELD if self.held else Kind.ASSUMED
        others = [block.kinds for block in graph.blocks]
        return Measurements(graph.num_nodes, graph.pairs, np.concatenate([kinds, *others]))

    @property
    def kinds(self) -> tuple[int, int, int]:
        """Numbers of points, of sightings of these, and of priors."""
        are = self.measurements.are
        sightings, priors = are(Kind.SIGHTING), are(*PRIORS)
        return int(self.graph.is_point.sum()), int(sightings.sum()), int(priors.sum())

    @property
    def kinds_in_words(self) -> list[str]:
        """Numbers of points, and of measurements but relative poses, where there are any."""
        points = int(self.graph.is_point.sum())
        of_points = [counted(points, "landmark{s}")] if points else []
        return [*of_points, *self.measurements.without(Kind.BETWEEN, Kind.ROTATION).in_words]

    @property
    def states_noise(self) -> bool:
        """Whether the source states how accurate every measurement is, by other weights than 1."""
        reading, graph = self.options, self.graph
        if graph.information is not None:
            found = graph.information.distinct
            return bool((found != np.eye(found.shape[1])).any())
        of_file = reading.get("weights", "file") in ("file", "mahalanobis")
        if not reading or not of_file or reading.get("information", "all") != "all":
            return False
        if not np.isin(graph.tau, (0.0, 1.0)).all():
            return True
        return not np.isin(graph.kappa, OF_ONES).all()

    @property
    def averaged(self) -> str:
        """What the weights kappa and tau leave out of the information matrices; or empty."""
        information = self.graph.information
        return "" if information is None else averaged(information.anisotropy)

    @property
    def _headline(self) -> str:
        return f"Instance {self.name}: {self.graph.size_in_words}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        if self.source:
            yield "source", shown_path(self.source)
        if found := self.kinds_in_words:
            yield "among these", ", ".join(found)
        yield "read with", reading_sentence(self.options)
        *weights, _, _ = self.graph._facts()
        yield from weights
        if self.averaged:
            yield "", f"kappa and tau average {self.averaged}"
        yield "connected", components_in_words(self.measurements.component_sizes)
        yield "initial", "values are in the source" if self.initial is not None else "no values"
        yield "truth", "known" if self.truth is not None else "not known"
        if self.fixed:
            yield "fixed", f"{few(self.ids[list(self.fixed)].tolist())} in the source"
        for sentence in self.notices:
            yield "notice", sentence
        if self.measurements.is_connected:
            yield "next", "certpgo.solve(instance); certpgo.certify(instance, estimate)"
        else:
            yield "next", 'certpgo.graph.components.connected_parts(instance, "each")'

    def _picture(self) -> str:
        from certpgo.graph.trees import tree_initialization

        graph, known = self.graph, self.initial if self.truth is None else self.truth
        if not graph.has_positions:
            return graph._picture()
        if known is None and graph.is_connected and not graph.is_partial:
            known = tree_initialization(graph)
        if known is None or known.translations is None:
            return graph._picture()
        return drawn(known.translations, closures(graph.edges), self.poses)

    def named(self, node: int) -> str:
        """What a node is called: ``"node 7"`` by its id, or ``"the world"``."""
        return "the world" if node == self.world else f"node {shown_id(int(self.ids[node]))}"

    @property
    def poses(self) -> IntArray:
        """The nodes that are poses of the trajectory, ascending: no points, and not the world."""
        nodes = self.graph.pose_nodes
        return nodes if self.world is None else nodes[nodes != self.world]

    @property
    def keys(self) -> Keys:
        """What the source calls the nodes, the world among them."""
        times, graph = self.times_ns, self.graph
        if times is not None and self.world is not None:
            times = np.append(times, NO_TIME)
        points = graph.is_point if graph.is_point.any() else None
        return Keys(self.ids, times, self.names, points, self.camera)

    def with_edges(self, chosen: IntArray | BoolArray) -> Instance:
        """The instance with only the chosen edges, by index or flag, of all nodes.

        Flags of all `measurements`, where there are more than edges, choose among these.
        """
        numbers, m, released = self.known_numbers, self.graph.num_edges, self.released
        flags: BoolArray = np.asarray(chosen)
        others = np.ones(len(numbers) - m, dtype=bool)
        if flags.dtype == bool and flags.shape == numbers.shape:
            chosen, others = flags[:m], flags[m:]
        chosen = chosen_rows(chosen, m, "measurements")
        graph = self.graph.with_edges(chosen)
        if not others.all():
            graph = with_others(graph, others)
        if released is not None:
            left_out = np.setdiff1d(numbers[:m], numbers[:m][chosen])
            released = released.with_edges(~np.isin(released.known_numbers, left_out))
        return replace(
            self,
            released=released,
            graph=graph,
            outliers=None if self.outliers is None else self.outliers[chosen],
            stated=None if self.stated is None else self.stated[chosen],
            numbers=np.concatenate([numbers[:m][chosen], numbers[m:][others]]),
        )

    def in_world(self, estimate: Estimate) -> Estimate:
        """An estimate's poses in the world's frame, without the world; as it is without priors."""
        if self.world is None:
            return estimate
        there = estimate.anchored(self.world).subset(np.arange(self.world))
        if self.origin is None or there.translations is None:
            return there
        return there.with_translations(there.translations + self.origin)

    def with_world(self, estimate: Estimate) -> Estimate:
        """An estimate of the poses in the world's frame, with the world; reverses `in_world`."""
        if self.world is None:
            return estimate
        d, t, s, keys = estimate.d, estimate.translations, estimate.scales, self.keys
        if t is not None:
            t = t if self.origin is None else t - self.origin
            t = np.concatenate([t, np.zeros((1, d))])
        if (times := estimate.keys.times_ns) is not None:
            keys = replace(keys, times_ns=np.append(times, NO_TIME))
        s = None if s is None else np.append(s, 1.0)
        return Estimate(np.concatenate([estimate.rotations, np.eye(d)[None]]), t, keys, s)


def graph_of(measured: Graph | Instance) -> Graph:
    """The measurements alone."""
    return measured.graph if isinstance(measured, Instance) else measured

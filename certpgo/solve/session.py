"""A graph that grows and shrinks, with an estimate and a certificate that keep up.

What stays proven between certificates, in exact arithmetic:

- terms of F, the cost of whatever name, are never negative, so that F*, the optimum, never falls
  when measurements are added, not even with new nodes: a lower bound stays one;
- F of the estimate, extended by the new nodes' poses, rises by the new measurements' own terms;
- a bound of a graph without some measurements holds for every graph that contains it. So when
  measurements are removed, the best bound holds that was proven before the first of them came.

All sums are rounded outward. Hence the gap is at most what it was, plus the terms added since.
But where no scale is known, a new node changes the mean that F is over, and no bound stays.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import suppress
from numbers import Integral
from typing import Any

import numpy as np

from certpgo.certify import Certificate, Tier, Verdict
from certpgo.certify.certificate import tier_called
from certpgo.certify.tolerances import allowed, difference_up, gap_of
from certpgo.errors import GraphError, InputError, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.concatenate import with_rows
from certpgo.graph.display import Speaking
from certpgo.graph.kinds import places_world
from certpgo.graph.labels import WORLD, Label, called
from certpgo.graph.origins import Measured, in_frame, in_one_world
from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.initialization import Start
from certpgo.solve.growing_measurements import GrowingMeasurements
from certpgo.solve.naming import instance_of, labels_of
from certpgo.solve.odometry import Track
from certpgo.solve.result import GIVEN
from certpgo.solve.row_numbers import RowNumbers
from certpgo.solve.session_outliers import Suspicion, suspicion
from certpgo.solve.session_status import Standing
from certpgo.solve.settings import SolveSettings, settings_from
from certpgo.solve.terms import Terms
from certpgo.solve.warm_start import Found, descended, searched

#: Share of `SolveSettings.same_cost` by which new measurements may raise F before a new descent.
UNNOTICED = 0.5
#: Share of measurements that may be new for a descent from the last optimum; else from scratch.
NEW = 0.5


class Session(Speaking):
    """Measurements that come one after another, their best estimate, and its certificate.

    Parameters
    ----------
    settings : see `SolveSettings`
    every : number of new measurements after which `add` refreshes; None for never
    cost : as for `certpgo.solve`: by default that of the program of the first measurements' file
    options : single settings instead, as for `certpgo.solve`

    Raises
    ------
    InputError
        ``every`` is not positive; a setting out of its range.
    SpecError
        An unknown setting or cost.

    Examples
    --------
    Five steps along a hexagon, then the measurement that closes it, 0.3 radians off:

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> graph = winding_cycle(6, 0.3, 0)[0].graph
    >>> session = certpgo.Session()
    >>> for k in range(6):
    ...     session.add(graph.with_edges([k]))
    >>> standing = session.standing  # valid at once; the estimate is not the best
    >>> standing.verdict.value, standing.lower_bound
    ('UNDECIDED', 0.0)
    >>> session.certificate.verdict.value, f"{session.standing.cost:.6f}"
    ('CERTIFIED', '0.029994')
    >>> session.remove([5]).cost < 1e-3, session.refresh().verdict.value
    (False, 'CERTIFIED')
    """

    def __init__(
        self,
        settings: SolveSettings | None = None,
        *,
        every: int | None = 100,
        cost: str | None = None,
        **options: Any,
    ) -> None:
        if every is not None:
            require(every, Integral, "a number of measurements, or None,")
        if every is not None and every < 1:
            raise InputError(f"certificates are refreshed every k measurements, not every {every}")
        self.settings = settings_from(settings, options)
        self.every = every
        self._asked, self._terms = cost, Terms.chosen(cost)
        self._tier = tier_called(self.settings.tier or Tier.STANDARD)
        self._measured = GrowingMeasurements()
        self._numbers = RowNumbers()
        self._track: Track | None = None
        self._origin: FloatArray | None = None  # of the world, as in `Instance`
        self._places = False  # whether an edge that is no measurement puts the world somewhere
        self._cost = 0.0
        self._fit: bool | None = True  # whether the estimate meets all; None if not known
        self._bounds: list[tuple[int, float]] = []  # of the measurements before number k; ascending
        # The last descent: how many measurements there were, F there, and its verdict.
        self._settled, self._optimum, self._verdict = 0, 0.0, Verdict.CERTIFIED
        self._found: Found | None = None  # if nothing changed since
        self._standing: Standing | None = None  # likewise
        self.pending = 0  #: Measurements since the last refresh.

    @property
    def _headline(self) -> str:
        return f"{type(self).__name__}, {self.standing._headline}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from self.standing._facts()
        yield "pending", f"{counted(self.pending, 'measurement{s}')} since the last certificate"
        yield "next", "session.add(graph); session.refresh(); session.certificate"

    def add(self, measurements: Graph | Instance, nodes: Sequence[Label] | None = None) -> None:
        """Add measurements, perhaps of new nodes, whose poses are composed from them.

        Parameters
        ----------
        measurements : a graph, or an instance
        nodes : the names of the graph's nodes in this session: ids, for example; by default the
            `labels` of an instance, and a graph's numbers 0, 1, ... `certpgo.WORLD` is the node
            that priors are measured from, and the only name of an instance's world

        Raises
        ------
        GraphError
            A node is not connected with those that came before, or is a pose here and a point
            there, or the measurements are of another kind or dimension; the session is as before.
        InputError
            These are no measurements, or have held poses, which others would move, or not one name
            per node, or lack what the cost needs; or edges lead to the world, or its origin is too
            far from that of the others to be joined exactly.
        SpecError
            There is no cost of the session's name.
        """
        labels = labels_of(measurements, nodes)
        if self._track is None:
            self._terms = Terms.chosen(self._asked, measurements)
        part = self._terms.part(measurements, self._track)
        if WORLD in labels:
            origin = measurements.origin if isinstance(measurements, Instance) else None
            part = self._in_world(part, labels, origin)
        # Graphs of rotations do not say which of their edges hold nodes: instances do.
        known = part if part.has_positions else measurements
        before = self._numbers.count
        self._take(part, labels, self._numbers.following(part, known.is_measured))
        self._terms = self._terms.after(part)
        self._places |= bool(places_world(part).any())
        self.pending += self._numbers.count - before
        if self.every is not None and self.pending >= self.every:
            # What is free so far, such as where north is, measurements to come determine.
            with suppress(GraphError):
                self.refresh()

    def _take(self, graph: Graph, labels: Sequence[Label], numbers: Sequence[int]) -> None:
        """Keep measurements with these numbers, and compose the poses of new nodes."""
        track = self._track or Track(graph)
        unit = track.mean_over
        self._measured.add(graph, track.extend(graph, labels))
        if unit != track.mean_over:
            self._bounds, self._optimum = [], -math.inf
        self._track, self._found, self._standing = track, None, None
        self._numbers.append(graph, numbers)

    def _in_world(self, graph: Graph, labels: Sequence[Label], origin: FloatArray | None) -> Graph:
        """New measurements with the world where those that came have it."""
        world = labels.index(WORLD)
        if self._track is None or WORLD not in self._track.numbers:
            self._origin = origin
            return graph
        if origin is self._origin and not self._places and not places_world(graph).any():
            return graph
        self._poses.steps(graph, labels)  # refuses before anything changes
        known = self._with_worlds
        common, (*others, same) = in_one_world([*known, (graph, world, origin)])
        if any(one is not before for one, (before, _, _) in zip(others, known, strict=True)):
            self._move_world(others, common)
        return same

    @property
    def _with_worlds(self) -> list[Measured]:
        """All measurements, with the number and the origin of the world."""
        return [(self.graph, self._poses.numbers.get(WORLD), self._origin)]

    def _move_world(self, measured: Sequence[Graph], origin: FloatArray | None) -> None:
        """Go on with `_with_worlds` from another origin, which changes no optimum and no bound."""
        (graph,) = measured
        best = in_frame(self.estimate, self._poses.numbers[WORLD], self._origin, origin)
        if graph.num_edges < len(self._numbers.edges):
            self._numbers.keep_edges(~places_world(self.graph))
            self._places = False
        self._measured.replace(graph, self._terms)
        self._origin = origin
        self._adopt(best)

    def remove(self, edges: Iterable[int]) -> Standing:
        """Remove measurements; the estimate stays until the next refresh.

        Parameters
        ----------
        edges : their numbers, in the order in which they came: 0, 1, ...

        Raises
        ------
        InputError
            There is no such measurement.
        GraphError
            The others do not determine all nodes; the session is as before.
        """
        removed = self._numbers.chosen(edges)
        if not removed:
            return self.standing
        kept = ~np.isin(self._numbers.rows, removed)
        if not kept.any():
            raise InputError("a session keeps at least one measurement")
        part = with_rows(self._all, kept)
        # Refuses measurements that do not determine their nodes.
        self._terms.problem(part, self._called)
        self._numbers.keep(kept)
        self._bounds = [(k, bound) for k, bound in self._bounds if k <= removed[0]]
        self._settled = min(self._settled, len(self._numbers))
        self._measured.replace(part, self._terms)
        self._adopt(self.estimate)
        return self.standing

    def refresh(self) -> Standing:
        """Descend to the optimum of all measurements and prove it, unless that changes nothing.

        Raises
        ------
        GraphError
            The measurements do not determine all nodes yet; `add` goes on without a refresh then.
        NumericalError
            No estimate could be computed.
        """
        if not self._is_settled(self.standing):
            self._solve()
        self.pending = 0
        return self.standing

    @property
    def standing(self) -> Standing:
        """What is proven now, without any factorization."""
        self._measure()
        if self._standing is not None:
            return self._standing
        cost, lower, rigorous = self._cost, self.lower_bound, self._tier is not Tier.SCREEN
        gap = gap_of(cost, lower, rigorous=rigorous)
        absolute = self.settings.atol * self._measured.scale.total
        tolerance = allowed(cost, self.settings.rtol, absolute)
        tolerance = cost if gap > tolerance and self._fits() else tolerance
        counts, title = self._numbers.num_measurements, self._measured.title(self._terms)
        proven = len(self.nodes), counts, cost, lower, gap, tolerance
        self._standing = Standing.of(*proven, title, rigorous=rigorous)
        return self._standing

    def _fits(self) -> bool:
        """Whether the estimate meets all measurements, so that its cost is rounding."""
        self._fit = self._terms.fits(self._all, self.estimate) if self._fit is None else self._fit
        return self._fit

    @property
    def lower_bound(self) -> float:
        """No estimate of the measurements has a smaller F; 0 before the first certificate."""
        return self._bounds[-1][1] if self._bounds else 0.0

    @property
    def certificate(self) -> Certificate:
        """The certificate of the estimate for all measurements, which is refreshed if necessary."""
        return (self._found or self._solve()).certificate

    def suspicion(self) -> Suspicion | None:
        """Measurements that disagree with the rest, and the certified answer without them.

        None if all terms of F are as `certpgo.Disagreement` expects, or if scales are unknown.
        """
        proven = self.certificate
        return suspicion(
            self._problem, self.estimate, proven, self.edges, self.nodes, self.settings
        )

    @property
    def estimate(self) -> Estimate:
        """The poses of `nodes`: optimal at the last refresh, those of newer nodes composed."""
        found = self._poses.estimate
        some = self._measured.last
        return found if some is None or some.has_positions else found.with_translations(None)

    @property
    def nodes(self) -> tuple[Hashable, ...]:
        """The names of the nodes, in the order of the estimate; `certpgo.WORLD` is the world."""
        return () if self._track is None else tuple(self._track.numbers)

    @property
    def newest(self) -> int | None:
        """The last pose of the last graph with new ones, by its place in `nodes`, if any."""
        return None if self._track is None else self._track.newest

    @property
    def edges(self) -> IntArray:
        """(m,) numbers of the edges of `graph`, then of its blocks; -1 for no measurement."""
        return self._numbers.rows

    @property
    def graph(self) -> Graph:
        """All measurements, between nodes in the order of `nodes`."""
        return self._all

    def as_instance(self, name: str = "session") -> tuple[Instance, Estimate]:
        """All measurements and the estimate, nodes by id, the world last.

        ``instance.in_world(estimate)`` has the poses in the frame of the priors, if there are any.
        """
        instance, order = instance_of(name, self._all, self.nodes, self._origin)
        return instance, self.estimate.subset(order)

    def _called(self, node: int) -> str:
        """What a message calls a node of `graph`."""
        return called(self.nodes[node])

    @property
    def _all(self) -> Graph:
        """All measurements."""
        self._measure()
        return self._measured.joint(self._poses)

    def _measure(self) -> None:
        """Add the terms of what came since to F of the estimate, which was extended by it."""
        if not self._measured.has_new:
            return
        part, nodes = self._measured.collect(self._poses, self._terms)
        if self._poses.num_scaled:  # the unit of all may be another
            self._cost, self._fit = self._terms.upper(self._all, self.estimate), None
            return
        here = self._poses.estimate_of(nodes)
        rise = self._terms.upper(part, here)
        if self._fit or rise > self.settings.rtol * self._cost:
            self._fit = self._terms.fits(part, here) and self._fit
        self._cost = difference_up(self._cost, -rise)

    @property
    def _poses(self) -> Track:
        if self._track is None:
            raise InputError("the session has no measurements yet")
        return self._track

    def _adopt(self, better: Estimate) -> None:
        """Go on from this estimate of the measurements."""
        part = self._all
        self._poses.estimate = better
        self._cost, self._fit = self._terms.upper(part, better), None
        self._found, self._standing, self._optimum = None, None, -math.inf

    def _is_settled(self, standing: Standing) -> bool:
        """Whether new measurements agree with the estimate, so that it is still the optimum."""
        same = UNNOTICED * self.settings.same_cost * self._optimum
        stays = standing.cost - self._optimum <= same or (self._optimum >= 0.0 and self._fits())
        return stays and standing.verdict is self._verdict

    @property
    def _problem(self) -> Quadratic | Sum:
        return self._terms.problem(self._all, self._called)

    def _solve(self) -> Found:
        """A descent from the estimate; a search from scratch where that is not certified."""
        self._measure()
        best, settings, found = self.estimate, self.settings, None
        if self._settled >= (1.0 - NEW) * len(self._numbers):
            plain = self._measured.plain(self._poses, self._terms)
            composed = self._poses.num_given
            found = descended(plain, lambda: self._problem, best, settings, composed)
        begin = Start(best, GIVEN) if self._settled else None
        found = found or searched(self._problem, settings, begin)
        self._poses.estimate = found.estimate
        self._cost, self._found, self._fit, self._standing = found.cost, found, None, None
        if found.lower_bound > self.lower_bound:
            self._bounds.append((self._numbers.count, found.lower_bound))
        self._settled, self._optimum = len(self._numbers), found.cost
        self._verdict, self.pending = self.standing.verdict, 0
        return found

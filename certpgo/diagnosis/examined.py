"""What is examined: the measurements, and what is known of their optimum, each computed once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from certpgo.diagnosis.standing import whole_poses
from certpgo.diagnosis.study import Study, studied_problem, study
from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance
from certpgo.graph.keys import NO_TIME, SECOND
from certpgo.graph.kinds import RELATIVE, Kind
from certpgo.graph.succession import Succession, succession
from certpgo.io.estimates import truth_among
from certpgo.io.format import LabelledPoses
from certpgo.io.matching import Matching
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import Certifiable, objective_of
from certpgo.objective.sum import Sum
from certpgo.optimize.monitor import Monitor, silent
from certpgo.solve.fit import Fit
from certpgo.solve.inconsistency import odometry
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.solving import solve

#: Seconds of a search unless they are given: in all, and for each measurement. A map with a mistake
#: in it seldom has an optimum that is proven.
SECONDS, EACH = 2.0, 1e-3
#: Share of a cost above it that is not asked about.
SLIGHT = 0.01
#: Residuals that digits of files leave: radians, and parts of a length.
DIGITS = 1e-5


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of nodes, and the whole true trajectory by its own clock.

    Attributes
    ----------
    nodes : (n,) seconds of the nodes; not a number where there is none
    times : (K,) seconds of the trajectory, rising
    positions : (K, d) metres
    allowed : by how much matched times may differ, seconds
    """

    nodes: FloatArray
    times: FloatArray
    positions: FloatArray
    allowed: float = 0.01

    @classmethod
    def of(cls, poses: LabelledPoses, instance: Instance, how: Matching) -> Clock | None:
        """Of poses and nodes with times; None unless both have some that differ."""
        stamps, t = poses.times_ns, poses.translations
        if stamps is None or t is None or how.timestamps is not None:
            return None
        if instance.times_ns is None or not instance.keys.times_differ:
            return None
        kept = np.unique(stamps, return_index=True)[1]
        kept = kept[stamps[kept] != NO_TIME]
        of_nodes = np.full(instance.graph.num_nodes, np.nan)
        known = np.flatnonzero(instance.times_ns != NO_TIME)
        zero = int(instance.times_ns[known].min())  # seconds since then are exact enough
        of_nodes[known] = (instance.times_ns[known] - zero) / SECOND
        times = (stamps[kept] - zero) / SECOND + how.offset
        return cls(of_nodes, times, t[kept][:, : instance.graph.d], how.max_difference)


@dataclass(frozen=True, eq=False)
class KnownTruth:
    """Known poses of some nodes.

    Attributes
    ----------
    nodes : (k,) which, ascending
    poses : k of them, from any frame; positions alone are points in their keys
    clock : what is known of times; None for nothing
    """

    nodes: IntArray
    poses: Estimate
    clock: Clock | None = None

    @classmethod
    def of(cls, poses: LabelledPoses, instance: Instance, how: Matching) -> KnownTruth:
        """The truth among poses of a file; of no node, with the clock, where no times match.

        Raises
        ------
        InputError
            No pose is of a node, and that is not for their times.
        """
        clock = Clock.of(poses, instance, how)
        try:
            nodes, known, _ = truth_among(poses, instance, how)
        except InputError:
            if clock is None:
                raise
            nowhere = np.zeros(0, dtype=np.intp)
            return cls(nowhere, Estimate(poses.rotations, poses.translations), clock)
        return cls(nodes, known, clock)


@dataclass(frozen=True, eq=False)
class Examined:
    """A map with what a user says of it.

    Attributes
    ----------
    instance : the measurements, connected
    estimate : of all nodes, that is asked about; None for none
    truth : of some nodes; None if it is not known
    cost : name of the cost; by default the instance's own
    least : the least cost that is known; None to search for it
    posed : the cost of the measurements, if it is known already
    known : the best estimate of the measurements, the same
    time_limit : seconds of a search; None for the usual ones
    monitor : of all searches
    tried : counts hypotheses
    progress : is called with each of these
    """

    instance: Instance
    estimate: Estimate | None = None
    truth: KnownTruth | None = None
    cost: str | None = None
    least: float | None = None
    posed: Certifiable | None = None
    known: CertifiedSolution | None = None
    time_limit: float | None = None
    monitor: Monitor = silent
    tried: list[str] = field(default_factory=list)
    progress: Callable[[str], None] = lambda _: None

    def trying(self, kind: str) -> None:
        """Note that a hypothesis is tried."""
        self.tried.append(kind)
        self.progress(kind)

    @cached_property
    def problem(self) -> Certifiable:
        """The cost of the measurements."""
        if self.posed is not None:
            return self.posed
        if self.least is None:
            return self.answer.problem
        return objective_of(self.instance, self.cost)

    @cached_property
    def studied(self) -> Sum | None:
        """The same as squares over the stated noise; None if that is not known."""
        return studied_problem(self.problem)

    @cached_property
    def first(self) -> Study | None:
        """All measurements at the best estimate; None where nothing is known of residuals."""
        if self.studied is None:
            return None
        return study(self.studied, self.answer.estimate, self.anchor)

    @cached_property
    def answer(self) -> CertifiedSolution:
        """The best estimate of the measurements as they are."""
        return self.solved(self.instance) if self.known is None else self.known

    def solved(self, instance: Instance) -> CertifiedSolution:
        """The best estimate of other measurements, under the same cost."""
        limit = self.time_limit
        if limit is None:
            limit = SECONDS + EACH * instance.graph.num_measurements
        return solve(instance, cost=self.cost, time_limit=limit, monitor=self.monitor)

    @property
    def best(self) -> float:
        """The least cost known."""
        return self.answer.cost if self.least is None else self.least

    def is_above(self, cost: float, least: float) -> bool:
        """Whether a cost is above another one by more than digits and tolerances explain."""
        graph = self.instance.graph
        digits = 2.0 * float(graph.kappa.sum())
        if graph.has_positions:
            digits += float(graph.tau @ (graph.translations**2).sum(axis=1))
        floor = max(self.answer.certificate.tolerance, DIGITS**2 * digits)
        return cost - least > max(SLIGHT * least, floor)

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of the best estimate, where the source states the noise."""
        return self.answer.fit

    @property
    def anchor(self) -> int:
        """A pose that stands still."""
        return self.problem.tangent_layout.still(self.instance.anchor)

    @property
    def world(self) -> int | None:
        """The node that stands for the world; None if nothing is measured in it."""
        graph = self.instance.graph
        return graph.world if self.instance.world is None else self.instance.world

    @cached_property
    def order(self) -> Succession:
        """Which pose follows which."""
        return succession(self.instance)

    @cached_property
    def steps(self) -> BoolArray:
        """(m,) the first measurement from each pose to the next."""
        return odometry(self.instance.graph, self.order)

    @cached_property
    def kinds(self) -> dict[str, BoolArray]:
        """(m,) which measurements are of which kind, in words."""
        measured = self.instance.measurements
        relative = measured.are(*RELATIVE)
        steps = np.zeros(len(relative), dtype=bool)
        steps[: len(self.steps)] = self.steps
        closures = "loop closures" if (steps & relative).any() else "relative poses"
        found = {
            "odometry": relative & steps,
            closures: relative & ~steps,
            "pose priors": measured.are(Kind.PRIOR),
            "position priors": measured.are(Kind.POSITION),
            "attitude priors": measured.are(Kind.ATTITUDE),
            "sightings": measured.are(Kind.SIGHTING),
            "distances": measured.are(Kind.RANGE),
            "other measurements": measured.are(Kind.OTHER),
        }
        return {name: rows for name, rows in found.items() if rows.any()}

    @cached_property
    def whole(self) -> BoolArray:
        """(m,) which measurements are of a pose relative to another one."""
        return whole_poses(self.instance.graph)

"""What to do after a verdict; the quickstart's table, for one certificate."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from certpgo.certify import Certificate, Tier, Verdict
from certpgo.certify.obstacle import LimitedBy
from certpgo.graph import Instance
from certpgo.objective.choose_cost import objective_of, own_cost
from certpgo.objective.costs import CHORDAL
from certpgo.optimize.solution import Status

#: A sentence, and a command or an empty text.
Step = tuple[str, str]
#: Commands with an option --kernel.
TAKE_KERNELS = ("solve", "certify")
_ENDED = "The search ended by itself, and more time would not help. The gap"
_SOLVED = "The relaxation is solved, so more time would not raise the bound. The gap"
_GUARANTEE = "is still a guarantee, and may be small enough to act on."
_FURTHER = "Search further from it, unless certpgo solve found it and ended by itself."
_REJECT = "If measurements may be wrong, reject those that disagree."


class _Given(NamedTuple):
    """What commands are about: files, and the options of reading and cost."""

    instance: Instance
    graph: str
    estimate: str
    reading: tuple[str, ...]
    cost: tuple[str, ...]
    searched: bool
    stopped: bool
    disagreeing: bool
    judged_by: str
    judging: tuple[str, ...]
    kernel: str | None

    @property
    def provable(self) -> bool:
        """Whether there are proofs about this cost of this graph."""
        return not objective_of(self.instance, self.judged_by, self.kernel).unprovable

    @property
    def is_of_poses(self) -> bool:
        """Whether measurements may be rejected: without distances, unknown scales and kernels."""
        graph = self.instance.graph
        return self.kernel is None and graph.ranges is None and not graph.has_scales

    @property
    def _named(self) -> str:
        return self.estimate or "best.g2o"

    def solve(self, *options: str) -> str:
        return shlex.join(("certpgo", "solve", self.graph, *self.cost, *self.reading, *options))

    def search_on(self) -> str:
        return self.solve("--initial", self._named)

    def reject(self) -> str:
        return shlex.join(("certpgo", "solve", self.graph, *self.reading, "--robust"))

    def certify(self, *options: str) -> str:
        files = ("certpgo", "certify", self.graph, self._named)
        return shlex.join((*files, *self.cost, *self.reading, *self.judging, *options))

    def at(self, tier: str) -> str:
        """What was done, at another tier."""
        return (self.solve if self.searched else self.certify)("--tier", tier)

    def diagnose(self) -> str:
        files = (self.graph, *([self.estimate] if self.estimate and not self.searched else []))
        return shlex.join(("certpgo", "diagnose", *files, *self.cost, *self.reading))

    def look(self, command: str) -> str:
        return shlex.join(("certpgo", command, self.graph, *self.reading))


def advice(
    certificate: Certificate,
    instance: Instance,
    graph: str,
    estimate: str = "",
    *,
    reading: Sequence[str] = (),
    judging: Sequence[str] = (),
    cost: str,
    kernel: str | None = None,
    searched: bool = False,
    disagreeing: bool = False,
) -> list[Step]:
    """Sentences on what to do next, each with a command or an empty text.

    Parameters
    ----------
    instance : the graph
    graph, estimate : their files, as named in commands
    reading : the command-line options with which they were read
    judging : those with which ``certify`` matched and judged the estimate
    cost, kernel : the name of the cost that judged them, and its kernel as it was given
    searched : whether the certified search found the estimate, not another program
    disagreeing : whether some measurements disagree with the rest
    """
    obstacle = certificate.obstacle
    given = _Given(
        instance,
        graph,
        estimate,
        tuple(reading),
        cost_options(instance, cost) + (("--kernel", kernel) if kernel else ()),
        searched=searched,
        stopped=obstacle.ended_early,
        disagreeing=disagreeing,
        judged_by=cost,
        judging=tuple(judging),
        kernel=kernel,
    )
    interrupted = searched and obstacle.stopped is Status.INTERRUPTED
    if interrupted and certificate.verdict is not Verdict.CERTIFIED:
        on = given.search_on() if estimate else given.solve()
        return [("The search was interrupted; go on with it.", on)]
    match certificate.verdict:
        case Verdict.CERTIFIED:
            steps = _after_certified(given)
        case Verdict.REFUTED:
            steps = _after_refuted(certificate, given)
        case Verdict.UNDECIDED:
            steps = _after_undecided(certificate, given)
        case _:
            steps = _after_bounded(certificate, given)
    if kernel:
        return [step for step in steps if not step[1] or step[1].split()[1] in TAKE_KERNELS]
    return list(steps)


def cost_options(instance: Instance, cost: str) -> tuple[str, ...]:
    """The options with which a graph is judged by a cost: none where it is the graph's own."""
    return () if cost == own_cost(instance) else ("--cost", cost)


def _after_certified(given: _Given) -> Iterator[Step]:
    if given.is_of_poses and given.disagreeing:
        yield (
            "This is the best estimate of all measurements, of which some disagree with the rest. "
            "If they may be wrong, reject them.",
            given.reject(),
        )
        yield "Or see which mistake explains them.", given.diagnose()


def _after_bounded(certificate: Certificate, given: _Given) -> Iterator[Step]:
    if certificate.tier is Tier.SCREEN:
        yield "This tier proves nothing; the standard tier proves a gap.", given.at("standard")
        return
    if certificate.basin_is_global:
        yield (
            "The basin is right. Take the estimate that descent ends at, which is optimal.",
            given.certify("--best", "polished.g2o"),
        )
        yield (
            "Or keep yours: the distance says how far it is from the best one. If the gap is a "
            "surprise, see which mistake explains it, or compare the objective with what your "
            "solver minimises.",
            given.diagnose(),
        )
        return
    if certificate.better is not None and certificate.proves_optimal(certificate.best_cost):
        yield (
            "Take the estimate that was found from elsewhere, which is optimal.",
            given.certify("--best", "better.g2o"),
        )
        return
    yield from _with_less_rounding(certificate, given)
    if given.is_of_poses and given.disagreeing:
        yield _REJECT, given.reject()
    final = certificate.obstacle.is_final
    if not given.searched and not final:
        yield _FURTHER, given.search_on()
    elif given.stopped and not final:
        yield "The search was stopped early. Search longer.", given.solve("--time-limit", "600")
    if given.is_of_poses and not given.disagreeing:
        yield _REJECT, given.reject()
    if given.is_of_poses and given.searched:
        yield "See which mistake explains it.", given.diagnose()
    by_itself = given.searched and not given.stopped
    stays = _SOLVED if final else _ENDED if by_itself else "If the gap stays, it"
    yield f"{stays} {_GUARANTEE}", ""


def _with_less_rounding(certificate: Certificate, given: _Given) -> Iterator[Step]:
    rounding = certificate.limited_by is LimitedBy.ROUNDING
    if rounding and certificate.tier is Tier.STANDARD and given.provable:
        yield "Rounding limits this proof; the tier proof has less of it.", given.at("proof")


def _after_refuted(certificate: Certificate, given: _Given) -> Iterator[Step]:
    wrong = "The estimate is in the wrong basin. " if certificate.settled else ""
    yield f"{wrong}Take the better one that was found.", given.certify("--best", "better.g2o")
    yield (
        "Start your solver from the certified search instead of odometry.",
        given.solve("-o", "start.g2o"),
    )


def _after_undecided(certificate: Certificate, given: _Given) -> Iterator[Step]:
    if not (certificate.descended or given.searched):
        yield "Let local descent run first: bounds come from stationary points.", given.certify()
    if given.searched and given.stopped:
        yield "The search was stopped early. Give it more time.", given.solve("--time-limit", "600")
    elif given.searched:
        yield "The search ended by itself: the reason above says what was in the way.", ""
    elif given.stopped:
        yield "The search for a bound was stopped. Give it more time.", given.certify()
    yield from _with_less_rounding(certificate, given)
    if not math.isfinite(certificate.cost_upper):
        yield "The cost is not finite: look at the weights.", given.look("info")
    if not given.searched:
        yield "Let the certified search begin elsewhere.", given.solve()
    if given.judged_by == CHORDAL and given.is_of_poses:
        yield "Weaker bounds may still hold.", given.look("bounds")

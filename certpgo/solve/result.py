"""What `certpgo.solve` returns: an estimate with its certificate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real

import numpy as np

from certpgo.certify import Certificate, Verdict
from certpgo.certify.region import ProvenDistance, Region
from certpgo.errors import InputError, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.display import Speaking, Text
from certpgo.graph.phrases import cost_shown, counted
from certpgo.graph.picture import circle_of, closures, drawn
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import Certifiable
from certpgo.optimize.marginals import Marginals
from certpgo.optimize.solution import Level, Solution
from certpgo.optimize.unobservable import Undetermined, undetermined
from certpgo.solve.accuracy_wording import fixed
from certpgo.solve.assessment import CostlyEdge, costly_edges
from certpgo.solve.fit import Fit, fit_of
from certpgo.solve.likelihood import LEVEL, excess_of_truth, excesses
from certpgo.solve.outliers import Disagreement, disagreement
from certpgo.solve.rejection import Rejection, headline
from certpgo.solve.settings import SolveSettings

#: Name of the caller's initial estimate.
GIVEN = "the given estimate"


@dataclass(frozen=True, eq=False, repr=False)
class CertifiedSolution(Speaking):
    """An estimate with its certificate; printed, it says what was found and what is proven.

    Attributes
    ----------
    solution : the estimate, and how it was found
    certificate : what is proven about it
    start : the initialization: a method, or "the given estimate"
    levels : the steps of the staircase; only one if it did not climb
    settings : settings of the search
    problem : what the certificate is about: the measurements, those kept if some were rejected
    found_disagreement : that which the search found, in a tuple; None if it did not look
    rejection : what is proven about measurements that `certpgo.solve_robustly` rejected; else None
    noise_scale : standard deviation of the noise that rejections assume, over the stated one
    at_stated_noise : the answer at the stated noise, where another is assumed and it rejects others
    instance : what was solved, if it was read rather than a bare graph: `certpgo.write` takes the
        node ids from it

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> result = certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph)
    >>> result.solution.status.value, len(result.levels)
    ('converged', 1)
    >>> result.certificate.lower_bound <= result.cost
    True
    """

    solution: Solution
    certificate: Certificate
    start: str
    levels: tuple[Level, ...]
    settings: SolveSettings
    problem: Certifiable = field(repr=False)
    found_disagreement: tuple[Disagreement | None] | None = None
    instance: Instance | None = field(default=None, repr=False)
    rejection: Rejection | None = None
    noise_scale: float = 1.0
    at_stated_noise: CertifiedSolution | None = field(default=None, repr=False)

    @property
    def noise(self) -> str:
        """By how much the noise was scaled, and what the stated one would reject; or empty."""
        if self.noise_scale == 1.0:
            return ""
        said = f"taken as {self.noise_scale:.3g} times the stated"
        if (other := self.at_stated_noise) is None:
            return said
        here, there = len(self.solution.rejected), len(other.solution.rejected)
        said += f", as hardly more than a tree agrees with that: {here} rejected"
        said += f"; at the stated noise {there} rejected"
        if other.rejection is None:
            return said
        return f"{said}, truncated cost {cost_shown(other.rejection.certificate.cost_upper)}"

    @property
    def estimate(self) -> Estimate:
        """The best estimate found."""
        return self.solution.estimate

    @property
    def cost(self) -> float:
        """F of the estimate; of all measurements, also where the certificate is about fewer.

        That F is ``certificate.cost_upper``.
        """
        return self.solution.cost

    @property
    def verdict(self) -> Verdict:
        """The certificate's verdict."""
        return self.certificate.verdict

    @property
    def rejected(self) -> IntArray:
        """(k,) indices of the measurements that were rejected, ascending; empty unless robust."""
        return self.solution.rejected

    @cached_property
    def disagreement(self) -> Disagreement | None:
        """Measurements that disagree with the rest; `certpgo.solve_robustly` rejects them."""
        if self.found_disagreement is not None:
            return self.found_disagreement[0]
        return disagreement(self.problem, self.estimate)

    @cached_property
    def costliest(self) -> tuple[CostlyEdge, ...]:
        """The measurements with the largest terms of the cost, descending, with their residuals.

        Nodes are named by their ids; rejected measurements are not among them.
        """
        instance, weights = self.instance, self.solution.weights
        if instance is not None:
            instance = self.solution.judged_instance(instance)
        elif weights is not None:
            ids, numbers = np.arange(self.graph.num_nodes), np.flatnonzero(weights)
            instance = Instance("graph", self.graph, ids, numbers=numbers)
        return costly_edges(self.problem, self.estimate, instance)

    def summary(self) -> str:
        """What was found, what is proven, and what to do next: the text that is printed."""
        return Text(self)

    @property
    def graph(self) -> Graph:
        """The measurements that the certificate is about."""
        return self.problem.chordal.graph

    @property
    def _headline(self) -> str:
        return f"{self.certificate.stated}. {headline(self.certificate, self.rejection)}"

    def __repr__(self) -> str:
        count = self.graph.num_measurements
        kept = "" if self.solution.kept is None else f" of {count} kept measurements"
        return f"<CertifiedSolution: {self.certificate.in_brief}{kept}, {self.estimate!r}>"

    def _facts(self) -> Iterator[tuple[str, str]]:
        solution, found = self.solution, self.disagreement
        if self.noise:
            yield "noise", self.noise
        yield "graph", self.graph.size_in_words
        if solution.kept is not None:
            rest = "; the rest disagreed with them" if len(self.rejected) else ": none is rejected"
            yield "kept", f"{self.graph.num_measurements} measurements{rest}"
        if self.rejection is not None:
            yield from self.rejection.in_words(self.certificate)
        standing = self.certificate
        if self.rejection is not None:
            standing = self.rejection.standing(standing)
        yield from self.certificate._proven(standing.far(self._named))
        if self.fit is not None:
            yield "chi^2", self.fit.warning.removeprefix("chi^2 is ") or str(self.fit)
        steps, seconds = counted(solution.iterations, "iteration{s}"), solution.seconds.values()
        yield "ended", f"{solution.status} after {steps}, {sum(seconds):.3g} s; {solution.note}"
        if self.undetermined is not None:
            yield "undetermined", self.undetermined.in_words(self._named)
        if self.instance is not None:
            yield from fixed(self.instance)
        if found is not None:
            yield "outliers?", f"{found}: certpgo.solve_robustly(graph) rejects them"
        if self.verdict in (Verdict.CERTIFIED, Verdict.BOUNDED):
            more = "" if self.graph.has_scales else "; answer.covariance(node)"
            yield "next", f"certpgo.write(path, answer){more}"
        else:
            yield "next", "the reason says what was in the way"

    def _named(self, node: int) -> str:
        return f"node {node}" if self.instance is None else self.instance.named(node)

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 and its degrees of freedom, where the source of the graph states the noise."""
        return self.fit_at(self.estimate)

    def fit_at(self, estimate: Estimate) -> Fit | None:
        """The same of another estimate of these measurements."""
        instance = self.instance
        if instance is None:
            graph = self.problem.measured
            instance = Instance("graph", graph, np.arange(graph.num_nodes))
        return fit_of(instance, self.problem, estimate, self.solution.weights)

    def _picture(self) -> str:
        graph, t = self.graph, self.estimate.translations
        if t is None or not graph.has_positions:
            return circle_of(graph.num_nodes, graph.edges)
        return drawn(t, closures(graph.edges), graph.pose_nodes)

    @cached_property
    def undetermined(self) -> Undetermined | None:
        """What the measurements leave open there; None if they determine all nodes."""
        if not self.graph.is_partial:
            return None  # it is connected
        if self.graph.has_scales:
            return None
        world = None if self.instance is None else self.instance.world
        anchor = self.problem.tangent_layout.still(world)
        return undetermined(self.problem, self.estimate, anchor)

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the nodes relative to the first pose; see `certpgo.Marginals`."""
        held = () if self.instance is None else self.instance.held
        anchor = None if self.instance is None or not held else self.instance.anchor
        layout = self.problem.tangent_layout
        return Marginals(self.problem, self.estimate, layout.still(anchor), held)

    def region(
        self,
        node: int,
        reference: int | None = None,
        *,
        level: float | None = None,
        excess: float | None = None,
        exact: bool = False,
    ) -> Region | None:
        """Where a node is, seen from a pose, in every estimate of low cost; see `Region`.

        By default in all that a likelihood-ratio test at 95 % does not exclude, far ones as near
        ones: without linearization, but the level is that of small noise. None if nothing can be
        proven.

        Parameters
        ----------
        reference : by default that of ``certificate.distance``
        level : probability of the region under the stated noise, 0.95 by default
        excess : instead, the cost of estimates that are inside over the cost of this one
        exact : whether the level is exact: the region holds the true poses with at least this
            probability, however large the noise is. It is larger

        Raises
        ------
        InputError
            There is no such node or pose, or its scale is unknown; both a level and an excess are
            given, or a level over similarities.
        NumericalError
            No estimate costs as little as the true poses do at an exact level.
        """
        require(node, Integral, "the number of a node")
        most = self._excesses(level, excess, exact)
        more = float(most[int(node)]) if 0 <= node < len(most) else 0.0  # refused there
        if excess is None and more == np.inf:
            return None
        return self.certificate.region(node, reference, excess=more)

    def regions(
        self,
        reference: int | None = None,
        *,
        level: float | None = None,
        excess: float | None = None,
        exact: bool = False,
    ) -> ProvenDistance | None:
        """The balls and angles of the `region` of each node.

        Raises
        ------
        InputError, NumericalError
            As for `region`.
        """
        found, most = self.certificate.regions, self._excesses(level, excess, exact)
        return None if found is None else found.distance(reference, most)

    def _excesses(self, level: float | None, excess: float | None, exact: bool) -> FloatArray:
        """(n,) what estimates in the region of each node may cost more."""
        n, known = self.problem.n, self.certificate
        if excess is not None:
            if level is not None or exact:
                raise InputError("a region is of a level or of an excess, not of both")
            require(excess, Real, "an excess over the cost")
            return np.full(n, float(excess))
        level = LEVEL if level is None else level
        if not exact:
            return excesses(self.problem, level)
        more = excess_of_truth(self.problem, level, known.cost_upper, known.lower_bound)
        return np.full(n, more)

    def covariance(self, node: int) -> FloatArray:
        """(b, b) covariance of a node relative to the first pose, see `certpgo.Marginals`."""
        return self.marginals.covariance(node)

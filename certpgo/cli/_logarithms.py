"""The result of certpgo solve --scales-within: the cost of logarithms, and its bound."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from certpgo.cli._outputs import Outputs, Result
from certpgo.cli._show import facts
from certpgo.cli._truth import KnownPoses

if TYPE_CHECKING:
    from certpgo import SolveSettings
    from certpgo.graph import Estimate, Instance
    from certpgo.optimize.monitor import Monitor
    from certpgo.solve.logarithms import LogarithmFit
    from certpgo.solve.metrics import TrajectoryErrors


@dataclass(frozen=True)
class FittedLogarithms(Result):
    """The result for a connected graph with nodes of unknown scale."""

    part: Instance
    fit: LogarithmFit
    within: float
    truth: KnownPoses | None = None

    @property
    def _bound(self) -> float:
        return self.fit.lower_bound(self.within)

    @property
    def _accuracy(self) -> TrajectoryErrors | None:
        return None if self.truth is None else self.truth.errors(self.fit.estimate)

    @property
    def _relative_gap(self) -> float | None:
        """What separates cost and bound, over the cost; None where that is not a number."""
        cost, bound = self.fit.cost, self._bound
        return (cost - bound) / cost if cost > 0.0 and math.isfinite(bound) else None

    @property
    def standing(self) -> str:
        """That Ctrl-C ended the descent or the search for the bound; else empty."""
        ended = {self.fit.solution.status.value, self.fit.nearby.solution.status.value}
        return "the best map so far has no certificate" if "interrupted" in ended else ""

    def write(self, outputs: Outputs) -> None:
        """Write the estimate."""
        outputs.write(self.fit.estimate, instance=self.part)

    def show(self, outputs: Outputs) -> None:
        """Print the cost, and what is proven of it."""
        facts(self._said(outputs))

    def _said(self, outputs: Outputs) -> Iterator[tuple[str, str]]:
        from certpgo.certify.wording import part
        from certpgo.graph.phrases import cost_shown
        from certpgo.solve import accuracy_wording as wording

        solution, accuracy = self.fit.solution, self._accuracy
        yield "graph", self.part.name
        yield "cost", f"{cost_shown(self.fit.cost)}  (of logarithms; no certificate is about it)"
        yield (
            "at least",
            f"{cost_shown(self._bound)}  (proven, up to the rounding of measurements in the units "
            f"of the nodes, of maps whose scales, over these, are within a factor {self.within:g} "
            "of their root mean square)",
        )
        if (share := self._relative_gap) is not None:
            yield "between them", f"{part(share)} of the cost"
        yield "ended", f"{solution.status.value}, {solution.iterations} steps"
        if accuracy is not None:
            yield from wording.accuracy(accuracy)
        if outputs.estimate is not None:
            yield "written", str(outputs.estimate)

    def report(self, outputs: Outputs) -> dict[str, Any]:
        """The result for --json."""
        solution, accuracy = self.fit.solution, self._accuracy
        return {
            "graph": self.part.name,
            "objective": "cost of logarithms over similarities",
            "verdict": None,
            "cost": self.fit.cost,
            "lower_bound": self._bound,
            "relative_gap": self._relative_gap,
            "scales_within": self.within,
            "status": solution.status.value,
            "iterations": solution.iterations,
            "accuracy": None if accuracy is None else asdict(accuracy),
            "written": None if outputs.estimate is None else str(outputs.estimate),
        }


def fitted(
    part: Instance,
    initial: Estimate | None,
    settings: SolveSettings,
    monitor: Monitor,
    within: float,
    truth: KnownPoses | None,
) -> FittedLogarithms:
    """The result of the descent on the cost of logarithms."""
    from certpgo import fit_logarithms

    fit = fit_logarithms(part, settings, initial=initial, monitor=monitor)
    return FittedLogarithms(None, part, fit, within, truth)

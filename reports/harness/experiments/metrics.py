"""Every metric: its unit, which way is better, how far it may move, and what it needs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Literal

#: Costs, bounds and eigenvalues may move by this part. Other BLAS kernels move them by 3e-10 in the
#: fixed set, another factorization engine by 2e-7; a certificate calls 1e-5 equal.
SAME = 1e-6
#: What is this close to zero is zero to rounding.
ZERO = 1e-12
#: Angles and shares may move by this part: what ends at a tolerance of its own is that exact. Other
#: kernels move interior points' angles by 1e-8.
SAME_ANGLE = 1e-4
#: Ratios of times may move by this factor. Those of milliseconds moved by 1.4 with three jobs a
#: core, and the timing protocol asks for a core of its own.
TIMES = 1.5

#: A count may move by this part, rounded down: one below 20 is exact, and a long iteration that
#: ends at a tolerance may end a little earlier or later with other BLAS kernels (98 for 99 steps).
COUNTS = 0.05
#: With another factorization engine a count may move by one as well: a matrix that is nearly
#: singular is one engine's failure and another's success.
OTHER_ENGINE = 1

Better = Literal["", "lower", "higher"]
#: What a value that moved means.
Direction = Literal["worse", "different", "better", "noted"]


class Tolerance(Enum):
    """How far a metric may move before it counts as different."""

    #: By `SAME` of its value.
    RELATIVE = "relative"
    #: By `SAME_ANGLE` of its value.
    ANGLE = "angle"
    #: By `SAME` of F: a difference of costs.
    COST_DIFFERENCE = "cost difference"
    #: By `SAME` of one, or of its value where that is larger.
    OF_ONE = "of one"
    #: By the factor of `TIMES`, between runs of the same factorization engine.
    TIME_RATIO = "time ratio"
    #: By any amount: it depends on the clock or the memory of a machine.
    MACHINE = "machine"


class Needs(Enum):
    """What a metric is computed from."""

    GRAPH = "the graph alone, without an estimate"
    RESIDUAL_BOUND = "the graph, with or without an estimate: a residual-angle bound"
    ESTIMATE = "an estimate"
    CERTIFICATE = "a certificate of the estimate"
    OPTIMUM = "F of the optimum, which the certified pipeline finds first"
    TRUTH = "ground truth, on the nodes where it is known"
    WEIGHTS = "the weights of a robust method, and for some the labels of wrong measurements"
    FIRST = "the estimate of the row's first method"
    TIMING = "the timing protocol, against the table's reference"
    PROCESS = "a process of its own"


@dataclass(frozen=True)
class Metric:
    """A number that records hold.

    Attributes
    ----------
    key : its name in records and columns
    unit : ``"F"`` for the unit of costs, ``"deg"``, ``"%"``, ``"s"``, ``"GB"``; empty for a number
    better : which values are better; empty where another value is only different
    tolerance : how far it may move
    needs : what it is computed from
    """

    key: str
    unit: Literal["", "F", "deg", "%", "s", "GB"] = ""
    better: Better = ""
    tolerance: Tolerance = Tolerance.RELATIVE
    needs: Needs = Needs.ESTIMATE

    @property
    def is_time(self) -> bool:
        """Whether it is a time, or a ratio of times."""
        return self.unit == "s" or self.tolerance is Tolerance.TIME_RATIO

    def allowed(self, before: float, after: float, cost: float, times: float) -> float:
        """How far it may move.

        Parameters
        ----------
        cost : F before
        times : the factor by which ratios of times may move
        """
        match self.tolerance:
            case Tolerance.MACHINE:
                return float("inf")
            case Tolerance.TIME_RATIO:
                return (times - 1.0) * min(abs(before), abs(after))
            case Tolerance.ANGLE:
                return max(SAME_ANGLE * abs(before), ZERO)
        scale = {Tolerance.COST_DIFFERENCE: abs(cost), Tolerance.OF_ONE: 1.0}
        return max(SAME * max(abs(before), scale.get(self.tolerance, 0.0)), ZERO)


def _registry() -> Iterable[Metric]:
    for key in ("lambda1", "lambda2", "lambda3", "fiedler"):
        yield Metric(key, needs=Needs.GRAPH)
    for key in ("alpha_max_deg", "normalized_alpha_max_deg"):
        yield Metric(key, "deg", "", Tolerance.ANGLE, Needs.RESIDUAL_BOUND)
    yield Metric("cost", "F", "lower")
    yield Metric("f_ml", "", "higher")
    yield Metric("mean_symmetry", "", "", Tolerance.OF_ONE)
    yield Metric("own_bound", "F", "higher")
    for key in ("max_residual_deg", "median_residual_deg"):
        yield Metric(key, "deg", "", Tolerance.ANGLE)
    yield Metric("within_2_deg_percent", "%", "higher", Tolerance.ANGLE)
    yield Metric("total_seconds", "s", "", Tolerance.MACHINE)
    yield Metric("lower_bound", "F", "higher", Tolerance.RELATIVE, Needs.CERTIFICATE)
    yield Metric("gap", "F", "lower", Tolerance.COST_DIFFERENCE, Needs.CERTIFICATE)
    yield Metric("relative_gap", "", "lower", Tolerance.OF_ONE, Needs.CERTIFICATE)
    # At least the share of F over that of the optimum.
    yield Metric("over_bound", "", "lower", Tolerance.RELATIVE, Needs.CERTIFICATE)
    yield Metric("certify_seconds", "s", "", Tolerance.MACHINE, Needs.CERTIFICATE)
    # F above the optimum; and 100 where F is the optimum, so that the mean is a share.
    yield Metric("error", "F", "lower", Tolerance.COST_DIFFERENCE, Needs.OPTIMUM)
    # The relaxation's value at the point found, less the optimum: negative where that point is not
    # feasible.
    yield Metric("relaxation_error", "F", "", Tolerance.COST_DIFFERENCE, Needs.OPTIMUM)
    yield Metric("global_percent", "%", "higher", Tolerance.ANGLE, Needs.OPTIMUM)
    for norm in ("", "_l1"):
        for which in ("mean", "median", "rmse"):
            yield Metric(f"{which}{norm}_deg", "deg", "lower", Tolerance.ANGLE, Needs.TRUTH)
    for key in ("f_gt", "f_gt_anchored"):
        yield Metric(key, "", "lower", Tolerance.ANGLE, Needs.TRUTH)
    yield Metric("kept_percent", "%", "", Tolerance.ANGLE, Needs.WEIGHTS)
    for key in ("precision", "recall"):
        yield Metric(key, "", "higher", Tolerance.ANGLE, Needs.WEIGHTS)
    yield Metric("apart_deg", "deg", "", Tolerance.ANGLE, Needs.FIRST)
    yield Metric("ratio", "", "lower", Tolerance.TIME_RATIO, Needs.TIMING)
    for key in ("median_seconds", "reference_seconds"):
        yield Metric(key, "s", "", Tolerance.MACHINE, Needs.TIMING)
    yield Metric("memory_gb", "GB", "", Tolerance.MACHINE, Needs.PROCESS)


#: Every metric, by its key.
METRICS: Mapping[str, Metric] = MappingProxyType({metric.key: metric for metric in _registry()})
#: Counts of work, of which fewer are better; a change of any other count is only a difference.
WORK = ("iterations", "factorizations", "products", "nonzeros")


def metric_of(key: str) -> Metric:
    """The metric of that key; one that is not in the registry moves by `SAME`."""
    return METRICS.get(key, Metric(key))


def count_allowed(before: int, same_engine: bool) -> int:
    """How far a count may move, between runs of the same factorization engine or of two."""
    return max(math.floor(COUNTS * before), 0 if same_engine else OTHER_ENGINE)


def needing(keys: Iterable[str], *needs: Needs) -> tuple[str, ...]:
    """Those of the keys whose metrics need one of these, in their order."""
    return tuple(key for key in keys if key in METRICS and METRICS[key].needs in needs)

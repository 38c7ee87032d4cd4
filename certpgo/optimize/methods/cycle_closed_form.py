"""The global optimum of a single cycle, and the stationary points that wind around it.

Composed around the cycle, the measurements differ from the identity by a rotation of angle theta
about some axis. The residuals of an estimate multiply to that rotation, so their angles add up to
at least theta. At the optimum all residuals share that axis, their angles add up to theta, and
kappa sin(angle) is the same on each edge. With equal weights the angles are equal, theta / n:
Eriksson et al., section 4.1.

Only the weakest edge can have more than a right angle: of two, the sum of 1 - cos would decrease by
moving angle from one to the other, and the cost by giving the larger angle to the smaller weight.
As a function of the weakest edge's angle a in [0, pi], the sum of all angles is concave, increases
from 0 and is at least a, so that some a in [0, theta] reaches theta, and Newton's method from 0
converges to it: slowly only if theta is near pi and the other edges add up to nearly that alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Estimate, Graph
from certpgo.graph.capabilities import require_capable
from certpgo.graph.cycles import walk
from certpgo.graph.trees import compose
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

#: Newton steps; each squares the error, or at worst removes a third of it.
MAX_STEPS = 100
#: Rounding of a residual's entries: three rotation matrices and their product.
ROUNDING = 2.0 * so.ROUNDING_DEFECT


@dataclass(frozen=True)
class CycleClosedForm:
    """The optimum of a single cycle: the closing error is distributed. Refuses other graphs.

    Optimal by Theorem 4.2 of Eriksson et al. (equal weights) and its extension to weights: the
    residuals share axis and sign and add up to at most pi.

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> print(f"{get_solver('cycle_closed_form')().solve(problem).cost:.6f}")
    0.029994
    """

    poses: ClassVar[bool] = False
    rotations: ClassVar[bool] = True
    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The rotations, the first at the identity; GraphError unless the graph is a cycle."""
        watch = Stopwatch()
        graph = problem.rotation.graph
        with watch.phase("isotropic method"):
            estimate = stationary_point(graph)
        cost = problem.cost(estimate)
        # Rounding of sqrt(F), a norm of residuals, is relative to sqrt(W).
        rounding = ROUNDING * problem.d * np.sqrt(problem.rotation.scale)
        total = np.degrees(np.abs(problem.rotation.residual_angles(estimate)).sum())
        return Solution(
            estimate,
            cost,
            Status.CLOSED_FORM,
            lower_bound=float(max(np.sqrt(cost) - rounding, 0.0) ** 2),
            seconds=watch.seconds,
            note=f"closing error {total:.4g} degrees, distributed",
        )


def stationary_point(graph: Graph, winding: int = 0) -> Estimate:
    """The stationary point whose residuals turn ``winding`` extra times about the closing axis.

    Winding 0 is the global optimum. At the others kappa sin(angle) is the same on each edge, too,
    and the angles, all at most or all at least a right angle (except the weakest edge's), add up to
    theta + 2 pi winding. If theta is 0 the axis is z.

    Raises
    ------
    GraphError
        The graph is not a cycle, or has no stationary point of this winding.
    InputError
        Its edges have matrix weights.
    """
    require_capable(graph, "isotropic method")
    around = walk(graph)
    composed = compose(graph, around.parents).rotations
    last, edge = int(around.nodes[-1]), int(around.edges[-1])
    closing = graph.rotations[edge] if around.forward[-1] else graph.rotations[edge].T
    error = so.log((composed[last] @ closing)[None])[0]
    if graph.d == 2:
        theta, axis = float(error[0]), np.ones(1)
    else:
        theta = float(np.linalg.norm(error))
        axis = error / theta if theta > 0.0 else np.array([0.0, 0.0, 1.0])
    angles = shares(graph.kappa[around.edges], theta + 2.0 * np.pi * winding)
    if angles is None:
        raise GraphError(f"this cycle has no stationary point of winding {winding}")
    before = np.concatenate([[0.0], np.cumsum(angles)[:-1]])
    R = np.empty_like(composed)
    R[around.nodes] = so.exp(-before[:, None] * axis) @ composed[around.nodes]
    return Estimate(R)


def shares(kappa: FloatArray, total: float) -> FloatArray | None:
    """Angles with sum ``total`` and equal kappa sin(angle); None if there are none.

    All are at most a right angle, except perhaps that of the smallest weight, or, if the total is
    too large for that, at least a right angle. For totals up to pi they minimise the cost
    sum 4 kappa (1 - cos(angle)) of a cycle.
    """
    if total < 0.0:
        mirrored = shares(kappa, -total)
        return None if mirrored is None else -mirrored
    weakest = int(np.argmin(kappa))
    ratio = kappa[weakest] / kappa
    for supplement in (False, True):
        target = len(kappa) * np.pi - total if supplement else total
        found = None if target < 0.0 else _up_to_a_right_angle(ratio, weakest, target)
        if found is not None:
            return np.pi - found if supplement else found
    return None


def _up_to_a_right_angle(ratio: FloatArray, weakest: int, total: float) -> FloatArray | None:
    a, eps = 0.0, np.finfo(float).eps
    for _ in range(MAX_STEPS):
        # arcsin(ratio sin a), without its rounding near a right angle.
        across = np.hypot(np.cos(a), np.sqrt(1.0 - ratio**2) * np.sin(a))
        angles = np.arctan2(ratio * np.sin(a), across)
        angles[weakest] = a
        missing = total - angles.sum()
        # Only rounding is missing; a small slope would amplify it.
        if missing <= 2.0 * eps * total:
            return np.asarray(angles)
        slope = 1.0 + (ratio * np.cos(a) / across).sum() - ratio[weakest] * np.sign(np.cos(a))
        if slope <= 0.0:
            return None
        a = min(a + missing / slope, np.pi)
    return None


SOLVER = CycleClosedForm

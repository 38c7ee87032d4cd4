"""Two valleys of a cycle: regions that hold both, or only one, as the cost says."""

from __future__ import annotations

from typing import Any

import numpy as np

import certpgo
from certpgo import Certificate
from certpgo.errors import NumericalError
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.objective.quadratic import Quadratic

#: Nodes of the cycles, closing errors in degrees, and excesses in units of what the second costs.
LENGTHS, CLOSING, SHARES = (6, 12, 24), (90.0, 143.0, 172.0), (0.25, 0.5, 1.0, 2.0)

Row = dict[str, Any]


def of_cycle(n: int, degrees: float) -> Row:
    """A cycle whose closing error is that much, and the valley of the other winding.

    The node opposite of the reference is turned by half a turn more there.
    """
    instance, other = winding_cycle(n, np.radians(degrees), -1, d=2)
    problem = Quadratic(instance.graph)
    answer = certpgo.solve(instance.graph, cost="chordal")
    node, needed = n // 2, problem.enclosure(other)[1] - answer.cost
    deviation = float(np.sqrt(answer.covariance(node)[-1, -1]))
    found = [_region(answer.certificate, node, share * needed, other) for share in SHARES]
    return {
        "nodes": n,
        "closing error": degrees,
        "cost": answer.cost,
        "other cost": problem.cost(other),
        "local degrees": [float(np.degrees(np.sqrt(s * needed) * deviation)) for s in SHARES],
        "degrees": [degrees for degrees, _ in found],
        "holds": [holds for _, holds in found],
    }


def _region(
    certificate: Certificate, node: int, excess: float, other: certpgo.Estimate
) -> tuple[float, bool]:
    region = certificate.region(node, 0, excess=excess * (1.0 + 1e-9))
    if region is None:
        raise NumericalError("nothing is proven of regions")
    return region.degrees, region.holds(other)


def rows() -> list[Row]:
    """Of all cycles."""
    return [of_cycle(n, degrees) for n in LENGTHS for degrees in CLOSING]

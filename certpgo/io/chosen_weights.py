"""Weights that replace those of a file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real

import numpy as np

from certpgo.errors import InputError, require
from certpgo.graph import Graph, Instance
from certpgo.graph.mahalanobis import mahalanobis as mahalanobis_weights
from certpgo.graph.phrases import counted

#: Notice about lowered Mahalanobis weights, with the number of edges.
CLIPPED = (
    "edge{s} whose rotational information exceeds what a semidefinite weight can express: it is "
    "lowered there, and F is at most the cost with all of it"
)


@dataclass(frozen=True)
class ChosenWeights:
    """Weights in place of a file's, as the options of `certpgo.read` choose them.

    Attributes
    ----------
    kappa, tau : of every edge that measures a rotation, or a translation; or None
    unit : whether all weights are 1
    mahalanobis : whether rotations are weighed by all of the file's rotational information

    Raises
    ------
    InputError
        Contradictory choices, or a weight that is not positive and finite.
    """

    kappa: float | None
    tau: float | None
    unit: bool
    mahalanobis: bool

    def __post_init__(self) -> None:
        if self.unit and (self.kappa is not None or self.tau is not None):
            raise InputError(
                "unit weights (--unit-weights) exclude a kappa or tau (--kappa, --tau)"
            )
        if self.mahalanobis and str(replace(self, mahalanobis=False)) != "file":
            raise InputError("Mahalanobis weights exclude kappa, tau and unit weights")
        for name, value in (("kappa", self.kappa), ("tau", self.tau)):
            if value is not None:
                require(value, Real, f"a number as {name}")
            if value is not None and not 0.0 < value < np.inf:
                raise InputError(f"{name} must be positive and finite, not {value}")

    @property
    def override_all(self) -> bool:
        """Whether the file's weights are not used."""
        return self.unit or (self.kappa is not None and self.tau is not None)

    def apply(self, instance: Instance) -> Instance:
        """The instance with these weights in place of the file's."""
        if str(self) == "file":
            return instance
        if self.mahalanobis:
            return _with_mahalanobis(instance)
        graph = self._overridden(instance.graph)
        if graph.has_positions and (ranges := graph.ranges) and self.unit:
            graph = graph.with_ranges(replace(ranges, weights=np.ones(ranges.num_edges)))
        return replace(instance, graph=graph)

    def _overridden(self, graph: Graph) -> Graph:
        kappa, tau = (1.0, 1.0) if self.unit else (self.kappa, self.tau)
        if graph.has_positions:  # what is not measured keeps no weight
            turned, moved = graph.measures_rotation, graph.measures_translation
            return graph.with_weights(
                None if kappa is None else np.where(turned, kappa, 0.0),
                None if tau is None else np.where(moved, tau, 0.0),
            )
        return graph if kappa is None else graph.with_weights(kappa)

    def __str__(self) -> str:
        if self.unit:
            return "unit"
        if self.mahalanobis:
            return "mahalanobis"
        if self.kappa is None and self.tau is None:
            return "file"
        return ",".join(
            f"{name}={'file' if value is None else repr(float(value))}"
            for name, value in (("kappa", self.kappa), ("tau", self.tau))
        )


def _with_mahalanobis(instance: Instance) -> Instance:
    graph = instance.graph
    if graph.information is None:
        raise InputError(
            f"{instance.source or instance.name}: Mahalanobis weights need poses with "
            "rotational information, about a tangent vector or a quaternion, on every edge"
        )
    graph, clipped = mahalanobis_weights(graph, graph.information.about_tangents())
    notices = instance.notices
    if clipped:
        notices += (counted(clipped, CLIPPED),)
    return replace(instance, graph=graph, notices=notices)

"""GTSAM's inertial factors, see `certpgo.io.gtsam_factors`: preintegrated steps with fixed biases.

A velocity is a point, see `certpgo.graph.preintegrated`. Of a factor's covariance, which GTSAM has
of a residual by logarithms, remain the rotation's, and for each of the three coordinates alike, of
velocity and position the variances and what correlates these.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.phrases import counted, few, shown_id
from certpgo.graph.preintegrated import Preintegrated
from certpgo.linalg.arrays import FloatArray, IntArray, numbered

#: Factors of steps, and those of biases alone, which are fixed.
STEPS, BIASES = (
    ("ImuFactor", "CombinedImuFactor"),
    (
        "PriorFactorConstantBias",
        "BetweenFactorConstantBias",
    ),
)
#: A prior of a velocity, and how uneven its noise may be.
VELOCITY, UNEVEN = "PriorFactorVector", 1e-9


@dataclass(frozen=True)
class InertialStep:
    """What a factor measures, without gravity, at its bias.

    Attributes
    ----------
    number : its place in the factor graph
    keys : of pose i, its velocity, pose j and its velocity
    gravity : (3,) in the world, m/s^2
    covariance : (9, 9) of rotation, position and velocity
    """

    number: int
    keys: tuple[int, int, int, int]
    seconds: float
    rotation: FloatArray
    velocity: FloatArray
    position: FloatArray
    gravity: FloatArray
    covariance: FloatArray

    @property
    def turn_information(self) -> FloatArray:
        """(3, 3) of the rotation."""
        return np.asarray(np.linalg.inv(self.covariance[:3, :3]))

    @property
    def variances(self) -> tuple[float, float, float]:
        """Of a coordinate of e_v, and of e_p less its lag, which is the third."""
        C = self.covariance.reshape(3, 3, 3, 3)
        mean = np.einsum("iaja->ij", C) / 3.0
        of_v, of_p, both = mean[2, 2], mean[1, 1], mean[1, 2]
        lag = float(np.clip(both / of_v, 0.0, self.seconds))
        return float(of_v), float(of_p - 2.0 * lag * both + lag**2 * of_v), lag


class Inertial:
    """The inertial factors of a graph.

    Parameters
    ----------
    values : of biases; None for those that measurements were integrated with

    Raises
    ------
    InputError
        Robust noise, or a factor whose two biases differ.
    """

    def __init__(self, graph: Any, values: Any = None) -> None:
        self.steps: list[InertialStep] = []
        self.numbers = set[int]()
        for number in range(graph.size()):
            name = type(factor := graph.at(number)).__name__
            if name in STEPS:
                self.steps.append(_step(number, factor, values))
            if name in (*STEPS, *BIASES):
                self.numbers.add(number)
        if not self.steps:
            self.numbers.clear()  # biases alone are not known here

    @property
    def owners(self) -> dict[int, int]:
        """Keys of velocities, and those of their poses."""
        ends = [(s.keys[at + 1], s.keys[at]) for s in self.steps for at in (0, 2)]
        owners: dict[int, int] = {}
        for velocity, pose in ends:
            if owners.setdefault(velocity, pose) != pose:
                raise InputError(f"{shown_id(velocity)} is the velocity of two poses")
        return owners

    @property
    def unit(self) -> float:
        """T of all velocities, seconds."""
        longest = max(step.seconds - step.variances[2] for step in self.steps)
        return float(2.0 ** math.ceil(math.log2(2.0 * longest)))

    def block(self, n: int, ids: IntArray) -> Preintegrated:
        """The steps between n nodes: those with these keys, and the world."""
        steps = self.steps
        nodes = numbered(ids, np.array([step.keys for step in steps], dtype=np.intp))
        variances = np.array([step.variances for step in steps])
        lags, dv = variances[:, 2], np.array([step.velocity for step in steps])
        dp = np.array([step.position for step in steps])
        return Preintegrated(
            n,
            np.column_stack([nodes, np.full(len(steps), n - 1)]),
            np.array([step.seconds for step in steps]),
            np.full(len(steps), self.unit),
            lags,
            dv,
            dp - lags[:, None] * dv,
            np.array([step.gravity for step in steps]),
            1.0 / variances[:, :2],
        )

    @property
    def notice(self) -> str:
        """What is said of them."""
        many = counted(len(self.steps), "preintegrated factor{s}")
        return (
            f"{many} with fixed biases: their cost is one of F, without what correlates rotations "
            "with steps, and with the same variance of all coordinates"
        )


def still(factor: Any, unit: float) -> FloatArray:
    """(3, 3) information, translation alone, of a prior that says that a pose is at rest.

    Raises
    ------
    InputError
        It says another velocity, or has another noise than an isotropic one.
    """
    named = f"the prior of the velocity {shown_id(int(factor.keys()[0]))}"
    if np.any(factor.prior()):
        raise InputError(f"{named} is not zero: only a body at rest has a term here")
    noise = factor.noiseModel()
    if not hasattr(noise, "information") or type(noise).__name__ == "Robust":
        raise InputError(f"{named} has {type(noise).__name__} noise: Gaussian noise is expected")
    information = np.asarray(noise.information(), dtype=np.float64)
    even = information[0, 0] * np.eye(3)
    if not np.abs(information - even).max() <= UNEVEN * information[0, 0]:
        raise InputError(f"{named} has noise of a direction: isotropic noise is expected")
    return np.asarray(even / unit**2)


def _step(number: int, factor: Any, values: Any) -> InertialStep:
    keys = [int(key) for key in factor.keys()]  # noqa: SIM118 - not a mapping
    named = f"the {type(factor).__name__} between {shown_id(keys[0])} and {shown_id(keys[2])}"
    noise = factor.noiseModel()
    if not hasattr(noise, "covariance") or type(noise).__name__ == "Robust":
        raise InputError(f"{named} has {type(noise).__name__} noise: Gaussian noise is expected")
    measured, bias = factor.preintegratedMeasurements(), _bias(keys[4:], values, named)
    gtsam = importlib.import_module("gtsam")
    dt, hat = float(measured.deltaTij()), measured.biasHat()
    begin = gtsam.NavState(gtsam.Pose3(), np.zeros(3))
    gravity = (measured.predict(begin, hat).velocity() - measured.deltaVij()) / dt
    end = measured.predict(begin, hat if bias is None else bias)
    # Of the factor with two biases, what is left where these are fixed.
    information = np.linalg.inv(np.asarray(noise.covariance(), dtype=np.float64))[:9, :9]
    return InertialStep(
        number,
        (keys[0], keys[1], keys[2], keys[3]),
        dt,
        np.asarray(end.attitude().matrix(), dtype=np.float64),
        np.asarray(end.velocity() - gravity * dt, dtype=np.float64),
        np.asarray(end.position() - 0.5 * gravity * dt**2, dtype=np.float64),
        np.asarray(gravity, dtype=np.float64),
        np.asarray(np.linalg.inv(information), dtype=np.float64),
    )


def _bias(keys: Sequence[int], values: Any, named: str) -> Any:
    """The bias at which a factor is evaluated; None for its own."""
    if values is None:
        return None
    missing = [key for key in keys if not values.exists(key)]
    if missing:
        raise InputError(f"the values hold no bias at key {few(missing)}")
    first, *others = (values.atConstantBias(key) for key in keys)
    if any(not first.equals(other, 0.0) for other in others):
        raise InputError(f"{named} has two different biases: they are fixed here, and one")
    return first


def with_velocities(
    t: FloatArray, ids: IntArray, owners: Mapping[int, int], unit: float
) -> FloatArray:
    """Positions (n, 3) where those of velocities held these, m/s."""
    moved = np.array(t)
    at, poses = (
        numbered(ids, np.array(list(of), dtype=np.intp)) for of in (owners, owners.values())
    )
    moved[at] = t[poses] + unit * t[at]
    return moved

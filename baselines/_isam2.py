"""GTSAM's iSAM2 on a graph's measurements, one after another."""

from __future__ import annotations

import time

from certpgo.errors import NumericalError
from certpgo.graph import Instance
from certpgo.graph.streaming import arrivals
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.gtsam_graph import factors_of

from ._programs import GTSAM, sentence

#: Standard deviation of the prior on the first pose.
FIXED = 1e-3


def updates(instance: Instance, count: int | None = None) -> tuple[list[float], str]:
    """Processor seconds of each update, under GTSAM's cost, and the factorization that was used.

    It has no certificate. Where Cholesky's factorization fails by rounding, QR is used.

    Parameters
    ----------
    count : how many measurements; all by default

    Raises
    ------
    NumericalError
        Both fail.
    """
    for factorization in ("CHOLESKY", "QR"):
        try:
            return _updates(instance, factorization, count), factorization
        except RuntimeError as error:
            reason = sentence(error)
    raise NumericalError(f"GTSAM: {reason}")


def _updates(instance: Instance, factorization: str, count: int | None) -> list[float]:
    gtsam = GTSAM.library()
    factors = factors_of(objective_of(instance, "gtsam"))
    kind = f"Pose{instance.graph.d}"
    pose, dimension = getattr(gtsam, kind), 3 * instance.graph.d - 3
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization(factorization)
    isam, known, seconds = gtsam.ISAM2(parameters), set(), []
    estimate_of = getattr(isam, f"calculateEstimate{kind}")
    for edge in arrivals(instance.graph)[:count].tolist():
        new, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        factor = factors.at(edge)
        i, j = factor.keys()
        if not known:
            noise = gtsam.noiseModel.Isotropic.Sigma(dimension, FIXED)
            new.add(getattr(gtsam, f"PriorFactor{kind}")(i, pose(), noise))
            values.insert(i, pose())
        new.add(factor)
        begin = time.process_time()
        if j not in known:
            at = estimate_of(i) if i in known else pose()
            values.insert(j, at.compose(factor.measured()))
        elif i not in known:
            values.insert(i, estimate_of(j).compose(factor.measured().inverse()))
        known |= {i, j}
        isam.update(new, values)
        seconds.append(time.process_time() - begin)
    return seconds

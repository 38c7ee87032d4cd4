"""How far an estimate is from the truth, whatever explains it."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.errors import CertPGOError
from certpgo.graph.phrases import counted
from certpgo.solve.accuracy_wording import accuracy
from certpgo.solve.metrics import trajectory_errors


def agreement(examined: Examined) -> str:
    """Of how many poses the truth is known, and how far off these are; empty without one."""
    truth, instance = examined.truth, examined.instance
    if truth is None:
        return ""
    known = np.flatnonzero(np.isin(truth.nodes, instance.poses))
    said = f"of {len(known)} of {counted(len(instance.poses), 'pose{s}')}"
    if not len(known):
        return said
    given = examined.answer.estimate if examined.estimate is None else examined.estimate
    estimate, poses = given.subset(truth.nodes[known]), truth.poses.subset(known)
    if poses.translations is None:
        estimate = estimate.with_translations(None)
    with suppress(CertPGOError):
        errors = trajectory_errors(estimate, poses, scaled=instance.graph.in_mean_unit)
        name, off = next(iter(accuracy(errors)))
        said = f"{said}: {name} {off}"
    return said

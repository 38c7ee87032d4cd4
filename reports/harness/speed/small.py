"""Small problems: rotations of a cycle, and grids in space."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from certpgo.graph import Instance
from certpgo.graph.information import Information
from certpgo.io.datasets import synthetic
from certpgo.objective.choose_cost import CHORDAL
from certpgo.solve.solving import solve
from reports.harness.speed.measuring import Comparison, Group, Timers
from reports.harness.speed.solving import (
    FULL,
    ISOTROPIC,
    OF_G2O,
    OPTIMIZERS,
    certified,
    certifying,
    of_gtsam,
    of_optimizer,
    or_missing,
    solving,
)

SECTION = "small problems"
#: Rotations of a cycle, and poses along an edge of a grid.
CYCLES, SIDES = (3, 10, 30, 100), (2, 3, 5)
#: How often a step is run each time.
CALLS = 5


def groups(quick: bool) -> Iterator[Group]:
    """Solving and certifying; on grids next to GTSAM, whose methods are for poses."""
    rounds = 2 if quick else 7
    own = (Comparison(certifying(CHORDAL), solving(CHORDAL), 0.5),)
    for n in CYCLES[:2] if quick else CYCLES:
        subject = f"rotations of a cycle of {n}"
        yield Group(SECTION, subject, functools.partial(_cycle, n), own, rounds)
    for side in SIDES[:1] if quick else SIDES:
        subject = f"grid of {side**3} poses"
        beside = (
            Comparison(solving(CHORDAL), ISOTROPIC),
            Comparison(solving("g2o"), OF_G2O),
            Comparison(solving("gtsam"), FULL),
            *own,
        )
        yield Group(SECTION, subject, functools.partial(_grid, side), beside, rounds)


@contextmanager
def _cycle(n: int) -> Iterator[Timers]:
    yield certified(synthetic.winding_cycle(n, 0.3, 0)[0], CHORDAL, CALLS)


@contextmanager
def _grid(side: int) -> Iterator[Timers]:
    instance = _with_information(synthetic.grid3d(side, np.random.default_rng(0)))
    start = solve(instance, cost=CHORDAL).estimate
    yield {
        **certified(instance, CHORDAL, CALLS),
        **certified(instance, "g2o", CALLS),
        **certified(instance, "gtsam", CALLS),
        ISOTROPIC: or_missing(lambda: of_gtsam(instance, CHORDAL, CALLS)),
        FULL: or_missing(lambda: of_gtsam(instance, "gtsam", CALLS)),
        OF_G2O: or_missing(lambda: of_optimizer(OPTIMIZERS[OF_G2O], instance, start, CALLS)),
    }


def _with_information(instance: Instance) -> Instance:
    """The same with information matrices tau I and 2 kappa I, which own costs need."""
    graph = instance.graph
    diagonals = np.repeat(np.c_[graph.tau, 2.0 * graph.kappa], 3, axis=1)
    stated = Information.of(diagonals[:, :, None] * np.eye(6))
    return replace(instance, graph=graph.with_information(stated))

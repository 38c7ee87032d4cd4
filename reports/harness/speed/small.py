"""Small problems: rotations of a cycle, laps in the plane and grids in space."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
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
#: Rotations of a cycle, poses of two laps or more in the plane, poses along an edge of a grid.
CYCLES, LAPS, SIDES = (3, 10, 30, 100), (16, 100), (2, 3, 5)
#: Poses from which solving is to take less than GTSAM, and what it is to take at most up to there
#: and beyond, over GTSAM's chordal initialization and Gauss-Newton, under F, g2o's and its cost.
MANY, UP_TO, BEYOND = 100, (1.0, 3.0, 4.0), (0.3, 0.8, 1.0)
#: How often a step is run each time.
CALLS = 5


def groups(quick: bool) -> Iterator[Group]:
    """Solving and certifying; of poses next to GTSAM, whose methods are for these."""
    rounds = 2 if quick else 7
    own = (Comparison(certifying(CHORDAL), solving(CHORDAL), 0.5),)
    for n in CYCLES[:2] if quick else CYCLES:
        subject = f"rotations of a cycle of {n}"
        yield Group(SECTION, subject, functools.partial(_cycle, n), own, rounds)
    for n in LAPS[:1] if quick else LAPS:
        made = functools.partial(_laps, n)
        yield Group(SECTION, f"laps of {n} poses", made, _next_to_gtsam(n), rounds)
    for side in SIDES[:1] if quick else SIDES:
        made = functools.partial(_grid, side)
        yield Group(SECTION, f"grid of {side**3} poses", made, _next_to_gtsam(side**3), rounds)


def _next_to_gtsam(n: int) -> tuple[Comparison, ...]:
    of_f, of_g2o, of_gtsam = BEYOND if n >= MANY else UP_TO
    return (
        Comparison(solving(CHORDAL), ISOTROPIC, of_f),
        Comparison(solving("g2o"), OF_G2O, of_g2o),
        Comparison(solving("gtsam"), FULL, of_gtsam),
        Comparison(certifying(CHORDAL), solving(CHORDAL), 0.5),
    )


@contextmanager
def _cycle(n: int) -> Iterator[Timers]:
    yield certified(synthetic.winding_cycle(n, 0.3, 0)[0], CHORDAL, CALLS)


def _laps(n: int) -> AbstractContextManager[Timers]:
    rng, laps = np.random.default_rng(0), max(2, n // 20)
    return _poses(synthetic.corridor(n, rng, laps=laps, information=400.0, noise=0.05))


def _grid(side: int) -> AbstractContextManager[Timers]:
    return _poses(synthetic.grid3d(side, np.random.default_rng(0)))


@contextmanager
def _poses(made: Instance) -> Iterator[Timers]:
    instance = _with_information(made)
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
    """The same with information matrices that are read as its weights, which own costs need."""
    graph = instance.graph
    stated = Information.isotropic(graph.kappa, graph.tau, graph.d)
    return replace(instance, graph=graph.with_information(stated))

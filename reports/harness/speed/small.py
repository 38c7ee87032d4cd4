"""Small problems: rotations of a cycle, and grids in space."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from certpgo.graph import Instance
from certpgo.io.datasets import synthetic
from certpgo.objective.choose_cost import CHORDAL
from reports.harness.speed.measuring import Comparison, Group, Timers
from reports.harness.speed.solving import ISOTROPIC, certified, certifying, of_gtsam, solving

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
        beside = (Comparison(solving(CHORDAL), ISOTROPIC), *own)
        yield Group(SECTION, subject, functools.partial(_grid, side), beside, rounds)


@contextmanager
def _cycle(n: int) -> Iterator[Timers]:
    yield certified(synthetic.winding_cycle(n, 0.3, 0)[0], CHORDAL, CALLS)


@contextmanager
def _grid(side: int) -> Iterator[Timers]:
    instance: Instance = synthetic.grid3d(side, np.random.default_rng(0))
    yield {
        **certified(instance, CHORDAL, CALLS),
        ISOTROPIC: of_gtsam(instance, CHORDAL, CALLS),
    }

"""Which pose follows which: by times, by numbers in names, or by ids."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from certpgo.graph.dataset import Instance
from certpgo.graph.display import Brief
from certpgo.graph.keys import NO_TIME
from certpgo.linalg.arrays import BoolArray, IntArray

#: A pause is longer than this many median steps of time.
PAUSE = 20
#: A name's last number, with what is before and after it.
NUMBERED = re.compile(r"(.*?)(\d{1,18})(\D*)", re.DOTALL)
#: Bits of an id below the letter of a GTSAM symbol.
SYMBOL = 56


@dataclass(frozen=True, eq=False, repr=False)
class Succession(Brief):
    """The order of poses, in one sequence or several.

    Attributes
    ----------
    places : (n,) that differ by one for a pose and the next, and by more for all other nodes
    by : ``"time"``, ``"name"`` or ``"id"``, what the order is known from
    """

    places: IntArray
    by: str

    def are_steps(self, edges: IntArray) -> BoolArray:
        """(m,) which edges (m, 2) are from a pose to the next, or back."""
        return np.asarray(np.abs(np.diff(self.places[edges], axis=1)[:, 0]) == 1)


def succession(instance: Instance) -> Succession:
    """Which pose follows which.

    By time where all poses have different ones; else by the numbers in their names where they have
    names with numbers; else by ids. Names that differ in more than their last number, and GTSAM
    symbols of other letters, are of other sequences. Nothing follows after a pause, which is longer
    than 20 median steps of time, or where a number or an id is left out.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Instance, RotationGraph
    >>> edges = np.array([[0, 1], [1, 2], [2, 3]])
    >>> graph = RotationGraph(4, edges, np.tile(np.eye(2), (3, 1, 1)), np.ones(3))
    >>> two = Instance("two maps", graph, np.array([0, 1, 1000, 1001]))
    >>> succession(two).are_steps(edges).tolist()
    [True, False, True]
    """
    poses, named = instance.poses, None
    if instance.names:
        named = [NUMBERED.fullmatch(instance.names[k]) for k in poses.tolist()]
    sequence = instance.ids[poses] >> SYMBOL
    key, by = instance.ids[poses], "id"
    if named is not None and all(named):
        around = [(name[1], name[3]) for name in named if name is not None]
        kinds = {kind: k for k, kind in enumerate(sorted(set(around)))}
        sequence = np.array([kinds[kind] for kind in around], dtype=np.intp)
        key, by = np.array([int(name[2]) for name in named if name is not None]), "name"
    times = None if instance.times_ns is None else instance.times_ns[poses]
    if times is not None and (times != NO_TIME).all() and len(np.unique(times)) == len(times):
        key, by = times, "time"
    order = np.lexsort((key, sequence))
    steps = np.diff(key[order])
    together = np.diff(sequence[order]) == 0
    follows = together & _usual(steps, together, by)
    # Other nodes come before all, apart from each other.
    places = -2 * np.arange(2, instance.graph.num_nodes + 2)
    places[poses[order]] = np.cumsum(np.concatenate([[0], np.where(follows, 1, 2)]))[: len(poses)]
    return Succession(places, by)


def _usual(steps: IntArray, together: BoolArray, by: str) -> BoolArray:
    """(k - 1,) which steps leave nothing out."""
    known = steps[together]
    if not len(known):
        return together
    if by == "time":
        return np.asarray(steps <= PAUSE * np.median(known))
    values, counts = np.unique(known, return_counts=True)
    return np.asarray(steps == values[np.argmax(counts)])

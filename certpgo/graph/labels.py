"""What a node is called wherever several graphs meet: in sessions, streams and merged maps.

An id means something within its file alone: the id that a reader gives the world is that of a pose
in another file, and so may be the id of a landmark. A label means the same node everywhere.
"""

from __future__ import annotations

import enum
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph.phrases import shown_id
from certpgo.linalg.arrays import BoolArray, IntArray

#: A name or an id, `WORLD`, or a `Landmark`.
Label = Hashable


class Reserved(enum.Enum):
    """Nodes that have the same label in every graph."""

    WORLD = "the world"

    def __repr__(self) -> str:
        return self.name

    def __str__(self) -> str:
        return self.value


#: The node that priors are measured from. There is one for all graphs.
WORLD: Final = Reserved.WORLD


@dataclass(frozen=True)
class Landmark:
    """A landmark by its own number, which a pose may have too.

    Examples
    --------
    >>> from certpgo.graph.labels import Landmark
    >>> str(Landmark(7)), Landmark(7) == 7
    ('landmark 7', False)
    """

    number: int

    def __str__(self) -> str:
        return f"landmark {self.number}"


def called(label: Label) -> str:
    """What a message calls a node, such as ``node 7`` or ``the world``."""
    return str(label) if isinstance(label, Reserved | Landmark) else f"node {shown(label)}"


def shown(label: Label) -> str:
    """A label in tables, such as ``7``, ``x7`` or ``the world``."""
    return shown_id(label) if isinstance(label, int) else str(label)


class Numbering(NamedTuple):
    """Labels as an `Instance` holds them; see its attributes of the same names."""

    ids: IntArray
    names: tuple[str, ...]
    apart: BoolArray | None
    moved_by: int
    world: int | None


def numbering(labels: Sequence[Label]) -> Numbering:
    """Ids that stand for labels, or names if some are; the world, if it is there, is the last.

    Raises
    ------
    GraphError
        No id is left for a landmark or the world.
    """
    n, world = len(labels), len(labels) - 1 if labels and labels[-1] is WORLD else None
    known = labels[:world]
    if not all(isinstance(label, int | np.integer | Landmark) for label in known):
        names = tuple(map(str, known))
        if world is not None:
            names += (unused(str(WORLD), names),)
        return Numbering(np.arange(n), names, None, 0, world)
    apart = np.array([isinstance(label, Landmark) for label in labels], dtype=bool)
    ids, moved_by = _ids(known)
    if world is not None:
        ids.append(max(ids, default=-1) + 1)
    if max(ids, default=0) > np.iinfo(np.intp).max:
        raise GraphError("the ids leave none for landmarks or the world")
    own = np.array(ids, dtype=np.intp)
    return Numbering(own, (), apart if apart.any() else None, moved_by, world)


def _ids(labels: Sequence[Label]) -> tuple[list[int], int]:
    """Distinct ids, and by what those of landmarks exceed their numbers."""
    landmarks = {label.number for label in labels if isinstance(label, Landmark)}
    others = {int(label) for label in labels if isinstance(label, int | np.integer)}
    moved_by = 0
    if landmarks & others:
        moved_by = max(-1, *others) + 1 - min(0, *landmarks)
    ids = (k.number + moved_by if isinstance(k, Landmark) else k for k in labels)
    return [int(k) for k in ids if isinstance(k, int | np.integer)], moved_by


def in_order(labels: Sequence[Label]) -> IntArray:
    """The nodes by ascending id, and the world last, as readers order them."""
    nodes = [k for k, label in enumerate(labels) if label is not WORLD]
    ids = numbering([labels[k] for k in nodes]).ids
    world = [k for k, label in enumerate(labels) if label is WORLD]
    return np.array([*np.array(nodes, dtype=np.intp)[np.argsort(ids)], *world], dtype=np.intp)


def unused(name: str, used: Sequence[str]) -> str:
    """The name, with underscores until it is not among those that are used."""
    while name in used:
        name += "_"
    return name

"""What files of tagged lines contain, by kind of line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from certpgo.graph.information import Information, joined_information
from certpgo.io.dialect import Kind
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: No sensor's id.
BODY = -(2**63)
_NONE = np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Rows:
    """Lines of one kind; columns that the kind does not have are empty.

    Attributes
    ----------
    nodes : (k, 1 or 2) ids of the nodes, or of a sensor; of names see `Records`
    rotations : (k, d, d), the identity for positions
    translations : (k, d) or distances (k, 1), metres
    kappa, tau : (k,) weights; kappa is 0 for positions and distances
    information : matrices; None where some lack it
    sensors : (k,) ids of the sensors that measure or are measured; `BODY` for the body itself
    apart : (k,) whether points may be numbered apart, so that poses have the same numbers
    bodily : (k,) whether a prior is of the body's position, whatever sensor it names
    scales : (k,) of similarities
    stamps : (k, 2) times of poses, see `certpgo.io.timestamps.decimals`
    lines : (k,) numbers of the lines
    """

    nodes: IntArray
    rotations: FloatArray
    translations: FloatArray
    kappa: FloatArray
    tau: FloatArray
    information: Information | None = None
    sensors: IntArray = field(default_factory=lambda: _NONE)
    apart: BoolArray = field(default_factory=lambda: _NONE.astype(np.bool_))
    bodily: BoolArray = field(default_factory=lambda: _NONE.astype(np.bool_))
    scales: FloatArray = field(default_factory=lambda: np.empty(0))
    stamps: IntArray = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    lines: IntArray = field(default_factory=lambda: _NONE)

    @classmethod
    def none(cls, d: int) -> Rows:
        """No lines."""
        nodes, R, t, weights = np.empty((0, 2), np.intp), np.empty((0, d, d)), (0, d), np.empty(0)
        return cls(nodes, R, np.empty(t), weights, weights)

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """Lines one after another; their columns are those of the first part with any lines."""
        known = [part for part in parts if len(part)]
        if len(known) < 2:
            return [*known, *parts][0]
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in known])
            for name in known[0]._columns()
        }
        information = joined_information([part.information for part in known])
        return replace(known[0], **columns, information=information)

    def subset(self, chosen: IntArray | BoolArray) -> Rows:
        """Some lines, by index or mask."""
        columns: dict[str, Any] = {name: getattr(self, name)[chosen] for name in self._columns()}
        information = self.information and self.information[chosen]
        return replace(self, **columns, information=information)

    def in_order(self) -> Rows:
        """The lines in the order of the file."""
        if (self.lines[1:] > self.lines[:-1]).all():
            return self
        return self.subset(np.argsort(self.lines))

    def __len__(self) -> int:
        return len(self.nodes)

    def _columns(self) -> list[str]:
        names = (column.name for column in fields(self) if column.name != "information")
        return [name for name in names if len(getattr(self, name)) == len(self)]


@dataclass
class Records:
    """The contents of a file.

    Attributes
    ----------
    d : dimension of space; 0 if not known yet
    rows : by kind, one part per chunk and tag
    fixed : ids of nodes that the file fixes
    names : of nodes, if these have names: their numbers are the ids, until `certpgo.io.nodes`
        numbers nodes in the order of their vertices
    counts : what is to be noted, with how often
    cameras : the different numbers of cameras after those of poses
    """

    d: int = 0
    rows: dict[Kind, list[Rows]] = field(default_factory=dict)
    fixed: list[int] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    cameras: set[tuple[float, ...]] = field(default_factory=set)

    @property
    def camera(self) -> tuple[float, ...]:
        """The numbers of the camera of all poses; empty if there is none, or several."""
        return next(iter(self.cameras)) if len(self.cameras) == 1 else ()

    def extend(self, other: Records) -> None:
        """Append the next chunk."""
        self.d = other.d or self.d
        self.fixed.extend(other.fixed)
        self.counts.update(other.counts)
        self.cameras |= other.cameras
        for kind, parts in other.rows.items():
            self.rows.setdefault(kind, []).extend(parts)

    def take(self, kind: Kind) -> Rows:
        """All lines of a kind, in the order of the file, which are then no longer here."""
        return Rows.joined(self.rows.pop(kind, [Rows.none(self.d)])).in_order()

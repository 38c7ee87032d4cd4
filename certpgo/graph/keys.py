"""What tells the poses of an estimate apart: ids, names and timestamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.errors import GraphError
from certpgo.linalg.arrays import BoolArray, IntArray, frozen_flags, frozen_indices

#: The timestamp of a node without one, such as a point.
NO_TIME = int(np.iinfo(np.int64).min)
#: Nanoseconds in a second.
SECOND = 10**9
#: Nanoseconds by which a timestamp may differ from an id in seconds, from rounding in the text.
ROUNDED = 1000


@dataclass(frozen=True, eq=False)
class Keys:
    """What a source calls the poses of an estimate.

    Attributes
    ----------
    ids : (n,) distinct integers, or None
    times_ns : (n,) timestamps, integers, nanoseconds, `NO_TIME` where there is none; or None. Files
        state up to nine decimals of seconds since 1970, which are not exact in double precision.
    names : (n,) distinct strings, e.g. of images; may be empty
    points : (n,) which are points, whose rotations mean nothing; or None for none
    camera : focal lengths and centre of the one camera of all poses, pixels; empty for none

    Raises
    ------
    GraphError
        Arrays of different lengths, ids or names that occur twice, or times that are not integers.

    Examples
    --------
    >>> from certpgo.graph.keys import Keys
    >>> Keys(ids=[10, 20, 30]).subset([2, 0]).ids
    array([30, 10])
    """

    ids: IntArray | None = None
    times_ns: IntArray | None = None
    names: tuple[str, ...] = ()
    points: BoolArray | None = None
    camera: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("ids", "times_ns"):
            value = getattr(self, name)
            if value is not None:
                if np.asarray(value).dtype.kind not in "iu":
                    raise GraphError(f"{name} must be integers")
                object.__setattr__(self, name, frozen_indices(value))
        if self.points is not None:
            object.__setattr__(self, "points", frozen_flags(self.points))
        for name in ("ids", "names"):
            value = getattr(self, name)
            if value is not None and len(np.unique(value)) < len(value):
                raise GraphError(f"{name} must be distinct")

    def require(self, n: int) -> None:
        """Refuse keys of another number of poses by a GraphError."""
        for name in ("ids", "times_ns", "points"):
            value = getattr(self, name)
            if value is not None and value.shape != (n,):
                raise GraphError(f"{name} must be {(n,)}, not {value.shape}")
        if self.names and len(self.names) != n:
            raise GraphError(f"names must be {n}, or none, not {len(self.names)}")

    @property
    def identify(self) -> bool:
        """Whether anything tells poses apart but their order."""
        return self.ids is not None or self.times_ns is not None or bool(self.names)

    @property
    def ids_are_times(self) -> bool:
        """Whether the ids are the timestamps, as integers: one number for both in the source."""
        ids, times = self.ids, self.times_ns
        if ids is None or times is None or (times == NO_TIME).any():
            return False
        if np.array_equal(ids, times):
            return True
        seconds = (times + SECOND // 2) // SECOND
        near = np.abs(times - seconds * SECOND) <= ROUNDED
        return bool(near.all()) and np.array_equal(ids, seconds)

    @property
    def in_nanoseconds(self) -> bool:
        """Whether the source states whole nanoseconds."""
        ids, times = self.ids, self.times_ns
        return ids is not None and times is not None and bool(((ids == times) & (ids != 0)).any())

    @property
    def times_differ(self) -> bool:
        """Whether there are times, and no two are the same, as those of several robots may be."""
        if self.times_ns is None:
            return False
        known = self.times_ns[self.times_ns != NO_TIME]
        return 0 < len(known) == len(np.unique(known))

    def ids_of(self, n: int) -> IntArray:
        """The ids of n poses; without any, their numbers."""
        return np.arange(n) if self.ids is None else self.ids

    def is_point(self, n: int) -> BoolArray:
        """Whether each of n poses is a point."""
        return np.zeros(n, dtype=bool) if self.points is None else self.points

    @property
    def are_positions(self) -> bool:
        """Whether all are points: a trajectory of positions alone, whose rotations mean nothing."""
        return self.points is not None and bool(self.points.all())

    def facts(self) -> Iterator[tuple[str, str]]:
        """Names and values of what there is, for people."""
        if self.ids is not None and len(self.ids):
            yield "ids", f"{self.ids.min()} to {self.ids.max()}"
        known = None if self.times_ns is None else self.times_ns[self.times_ns != NO_TIME]
        if known is not None and len(known):
            yield "times", f"{in_seconds(int(known.min()))} to {in_seconds(int(known.max()))} s"

    def subset(self, chosen: IntArray) -> Keys:
        """The keys of some poses, by index, in that order."""
        chosen = np.asarray(chosen)
        if chosen.dtype.kind == "b":
            chosen = np.flatnonzero(chosen)
        return Keys(
            None if self.ids is None else self.ids[chosen],
            None if self.times_ns is None else self.times_ns[chosen],
            tuple(self.names[k] for k in chosen.tolist()) if self.names else (),
            None if self.points is None else self.points[chosen],
            self.camera,
        )


def in_seconds(time_ns: int) -> str:
    """The decimal of a time in seconds, exactly."""
    whole, rest = divmod(abs(time_ns), SECOND)
    text = f"{whole}.{rest:09d}".rstrip("0").rstrip(".")
    return f"-{text}" if time_ns < 0 else text


#: Of an estimate in the order of its graph's nodes.
NO_KEYS = Keys()

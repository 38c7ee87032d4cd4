"""Dialects of tagged lines: what follows each tag of g2o, TORO, iSAM and PyFG files.

A line is a tag, perhaps a time, ids or names of nodes, the numbers of a pose, position or distance,
and perhaps those of its precision.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from certpgo.io.chunks import without_comments
from certpgo.io.exact import quaternion
from certpgo.io.exact.information import ROW_MAJOR_2D, ROW_MAJOR_3D, InformationLayout
from certpgo.io.format import RotationInformation, WeightsAre
from certpgo.io.precision_kind import POSITIONS
from certpgo.linalg.arrays import FloatArray

Kind = Literal["pose", "point", "edge", "sighting", "range", "prior", "fix", "sensor", "skip"]
#: Rotations (k, d, d), translations (k, d), and how many quaternions are off norm 1.
Poses = tuple[FloatArray, FloatArray, int]


@dataclass(frozen=True)
class Tag:
    """The contents of lines with one tag.

    Attributes
    ----------
    kind : initial value of a pose or a point, measurement of a pair of poses, (sighting) of a point
        from a pose, of a distance, or (prior) of one pose or position, fixed nodes, a sensor's pose
        on its body, or something to skip and count
    d : dimension of space; 0 for either
    numbers : how many there are before those of the precision; d for positions
    what : for the notice on skipped lines, or on edges; empty for those that are never skipped
    sensor : whether the id of a sensor, or of a switch, follows those of nodes
    apart : whether points may be numbered apart, so that poses have the same numbers
    timed : whether a time follows the tag
    loose : whether more may follow, which is not read
    more : how many numbers of a camera may follow, which are kept as they are; 0 for none
    """

    kind: Kind
    d: int = 0
    numbers: int = 0
    what: str = ""
    sensor: bool = False
    apart: bool = False
    timed: bool = False
    loose: bool = False
    more: int = 0

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return 2 if self.kind in ("edge", "sighting", "range") else 1

    @property
    def ids(self) -> int:
        """Number of ids or names."""
        return self.nodes + self.sensor

    @property
    def is_position(self) -> bool:
        """Whether it is about a position alone."""
        return self.numbers == self.d


@dataclass(frozen=True)
class Dialect:
    """A format of tagged lines.

    Attributes
    ----------
    name : of the format
    tags : by their text
    poses : from d and the numbers (k, p) of a pose
    scales : from the numbers (k, p) of a similarity to its scales (k,); None where there are none
    layouts : order of the precision in 2D and 3D, by d
    refused : tags that are refused, with what is expected instead
    rotation_information : what the format's rotational information refers to
    residual : see `certpgo.graph.information.Information`
    precision : what the numbers are that every measurement has after its own; None if they may be
        missing, and are information unless the reader chooses otherwise
    named : whether nodes have names, each with a vertex, instead of ids
    isotropic : whether information gives weights alone, and is not kept
    """

    name: str
    tags: Mapping[bytes, Tag]
    poses: Callable[[int, FloatArray], Poses]
    layouts: Mapping[int, InformationLayout] = field(
        default_factory=lambda: {2: ROW_MAJOR_2D, 3: ROW_MAJOR_3D}
    )
    refused: Mapping[bytes, str] = field(default_factory=dict)
    rotation_information: RotationInformation = "tangent"
    residual: str | None = None
    precision: WeightsAre | None = None
    named: bool = False
    isotropic: bool = False
    scales: Callable[[FloatArray], FloatArray] | None = None

    def precision_size(self, tag: Tag) -> int:
        """How many numbers a precision has."""
        if tag.kind not in ("edge", "sighting", "range", "prior"):
            return 0
        if tag.kind == "range":
            return 1
        return (POSITIONS if tag.is_position else self.layouts)[tag.d].size

    def expected(self, tag: Tag) -> str:
        """What follows a tag, for messages."""
        size = self.precision_size(tag)
        if not self.named:
            ids = "1 id" if tag.ids == 1 else f"{tag.ids} ids"
            rest = f", then {size} or no information numbers" if size else ""
            return f"{ids} and {tag.numbers} numbers{rest}"
        parts = ["a time"] if tag.timed else []
        parts.append("a name" if tag.ids == 1 else f"{tag.ids} names")
        if tag.kind == "range":
            return ", ".join([*parts, "a distance and a variance"])
        parts.append(f"{tag.numbers} numbers")
        if size:
            parts.append(f"{size} numbers of a {self.precision}")
        return f"{', '.join(parts[:-1])} and {parts[-1]}"


def quaternion_poses(d: int, numbers: FloatArray) -> Poses:
    """Poses of x y theta (d = 2) or x y z qx qy qz qw (d = 3)."""
    if d == 2:
        return rpy_poses(d, numbers)
    t, q = numbers[:, :3], numbers[:, 3:]
    return quaternion.rotations(q), t, quaternion.off_norm(q)


def rpy_poses(d: int, numbers: FloatArray) -> Poses:
    """Poses of x y theta (d = 2) or x y z roll pitch yaw (d = 3)."""
    t, angles = numbers[:, :d], numbers[:, d:]
    if d == 2:
        return quaternion.planar_rotations(angles[:, 0]), t, 0
    return quaternion.rotations(quaternion.from_roll_pitch_yaw(angles)), t, 0


def pose_texts(R: FloatArray, translations: FloatArray | None) -> list[str]:
    """The numbers that `quaternion_poses` reads; zeros without translations."""
    t = np.zeros(R.shape[:2]) if translations is None else translations
    angles = quaternion.to_write(R) if R.shape[-1] == 3 else np.arctan2(R[:, 1, :1], R[:, 0, :1])
    return [" ".join(map(repr, row)) for row in np.hstack([t, angles]).tolist()]


def first_tags(head: bytes) -> set[bytes]:
    """The first words of the lines in the first bytes of a file, without comments."""
    lines = (line.split(None, 1) for line in without_comments(head).splitlines())
    return {words[0] for words in lines if words}

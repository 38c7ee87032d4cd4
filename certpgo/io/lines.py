"""Files of tagged lines (g2o, TORO, iSAM), read in chunks.

Every line is a tag, integer ids, the numbers of a pose, and perhaps an information matrix. A chunk
of lines is parsed at once, grouped by tag.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.information import Information, of_positions
from certpgo.io.chunks import parsed, refuse_loops, without_comments
from certpgo.io.contents import BODY, Priors, Sightings, TaggedLines
from certpgo.io.exact import quaternion
from certpgo.io.exact.information import InformationLayout
from certpgo.io.exact.weighing import weigh
from certpgo.io.format import ReadOptions, RotationInformation
from certpgo.io.stated import POSITIONS, as_information, position_weights
from certpgo.linalg.arrays import FloatArray, IntArray

#: Notice about edges without information, with their number.
UNINFORMED = "edge{s} without information: kappa = tau = 1"
#: How unknown tags begin that are of values, parameters and raw data, as other programs have them.
_NO_MEASUREMENTS = (b"VERTEX", b"PARAM", b"DATA", b"ROBOTLASER", b"RAWLASER", b"FLASER")
#: Rotations (k, d, d), translations (k, d), and how many quaternions are off norm 1.
Poses = tuple[FloatArray, FloatArray, int]


@dataclass(frozen=True)
class Tag:
    """The contents of lines with one tag.

    Attributes
    ----------
    kind : measurement, of a pair, (prior) of one pose or position or (sighting) of a point from a
        pose, initial value of a pose or a point, fixed nodes, a sensor's pose on its body, or
        something to skip and count
    d : dimension of space
    numbers : number of parameters after the ids; d for positions
    what : for the notice on skipped lines
    sensor : whether the id of a sensor follows those of nodes
    apart : whether points may be numbered apart, so that poses have the same numbers
    """

    kind: Literal["edge", "prior", "sighting", "vertex", "point", "fix", "sensor", "skip"]
    d: int = 0
    numbers: int = 0
    what: str = ""
    sensor: bool = False
    apart: bool = False

    @property
    def ids(self) -> int:
        """Number of ids after the tag."""
        return (2 if self.kind in ("edge", "sighting") else 1) + self.sensor

    @property
    def is_position(self) -> bool:
        """Whether it measures a position alone."""
        return self.kind in ("prior", "sighting") and self.numbers == self.d


@dataclass(frozen=True)
class Dialect:
    """A format of tagged lines.

    Attributes
    ----------
    name : of the format
    tags : by their text
    layouts : order of the information in 2D and 3D, by d
    poses : from d and the numbers (k, p) of a pose
    refused : tags that are refused, with what is expected instead
    rotation_information : what the format's rotational information refers to
    residual : see `Information`
    """

    name: str
    tags: Mapping[bytes, Tag]
    layouts: Mapping[int, InformationLayout]
    poses: Callable[[int, FloatArray], Poses]
    refused: Mapping[bytes, str] = field(default_factory=dict)
    rotation_information: RotationInformation = "tangent"
    residual: str | None = None


def rpy_poses(d: int, numbers: FloatArray) -> Poses:
    """Poses of x y theta (d = 2) or x y z roll pitch yaw (d = 3)."""
    t, angles = numbers[:, :d], numbers[:, d:]
    if d == 2:
        return quaternion.planar_rotations(angles[:, 0]), t, 0
    return quaternion.rotations(quaternion.from_roll_pitch_yaw(angles)), t, 0


def first_tags(head: bytes) -> set[bytes]:
    """The first words of the lines in the first bytes of a file, without comments."""
    lines = (line.split(None, 1) for line in without_comments(head).splitlines())
    return {words[0] for words in lines if words}


def read_lines(path: Path, dialect: Dialect, options: ReadOptions) -> TaggedLines:
    """The contents of the file; a FormatError names the line and what was expected."""
    parser = _Parser(dialect, options)
    content = TaggedLines(0)
    for part in parsed(path, parser.parse, options.progress):
        content.extend(part)
    return content


class _Parser:
    """Parses lists of lines; remembers only the dimension, and how many lines there were."""

    def __init__(self, dialect: Dialect, options: ReadOptions) -> None:
        self._dialect = dialect
        self._options = options
        self._d = self._lines = 0

    def parse(self, lines: list[bytes]) -> TaggedLines:
        """The contents of the lines."""
        content = TaggedLines(self._d)
        for name, (bodies, numbers) in self._by_tag(lines).items():
            tag = self._tag(name)
            if tag.kind == "skip" or self._leaves_out(tag) or self._is_planar_sensor(tag, content):
                content.counts[f"{name.decode()} line{{s}} skipped: {tag.what}"] += len(bodies)
            elif tag.kind == "fix":
                content.fixed.extend(_integers([x for body in bodies for x in body.split()]))
            else:
                if content.d not in (0, tag.d):
                    raise InputError(f"{name.decode()} in a file of {content.d}D poses")
                content.d = tag.d
                self._poses(name.decode(), tag, bodies, content)
                if tag.kind == "prior":
                    content.prior_lines.append(np.array(numbers))
                elif tag.kind == "sighting":
                    content.sighting_lines.append(np.array(numbers))
        self._d = content.d
        return content

    def _leaves_out(self, tag: Tag) -> bool:
        """Whether lines of a kind are skipped by choice."""
        priors, landmarks = self._options.skip_priors, self._options.skip_landmarks
        if tag.kind == "sensor":
            return priors and landmarks
        return priors if tag.kind == "prior" else landmarks and tag.kind in ("sighting", "point")

    @staticmethod
    def _is_planar_sensor(tag: Tag, content: TaggedLines) -> bool:
        return tag.kind == "sensor" and content.d == 2

    def _by_tag(self, lines: list[bytes]) -> dict[bytes, tuple[list[bytes], list[int]]]:
        """What follows each tag, and the numbers of these lines."""
        groups: dict[bytes, tuple[list[bytes], list[int]]] = {}
        for number, line in enumerate(lines, self._lines):
            head = line.split(None, 1)
            if head:
                bodies, numbers = groups.setdefault(head[0], ([], []))
                bodies.append(head[1] if len(head) == 2 else b"")
                numbers.append(number)
        self._lines += len(lines)
        return groups

    def _tag(self, name: bytes) -> Tag:
        if name in self._dialect.refused:
            raise InputError(self._dialect.refused[name])
        if name in self._dialect.tags:
            return self._dialect.tags[name]
        if name.startswith(_NO_MEASUREMENTS):
            return Tag("skip", what=f"no tag of {self._dialect.name}, and no measurement")
        known = ", ".join(tag.decode() for tag in self._dialect.tags)
        shown = name[:40].decode("ascii", "backslashreplace")
        raise InputError(f"{self._dialect.name} has no tag {shown!r}; known: {known}")

    def _poses(self, name: str, tag: Tag, bodies: list[bytes], content: TaggedLines) -> None:
        ids, numbers, texts = _fields(name, tag, bodies, self._information_size(tag))
        if tag.kind == "sighting":
            content.sightings.append(self._sightings(tag, ids, numbers, texts))
        elif tag.kind == "point":
            content.points.append((ids[:, 0], numbers))
        elif tag.is_position:
            content.priors.append(self._positions(tag.d, ids, numbers, texts))
        else:
            rotations, translations, off_norm = self._dialect.poses(tag.d, numbers)
            content.counts["quaternion{s} off norm 1 by more than 1e-3, normalized"] += off_norm
            self._whole_poses(tag, ids, rotations, translations, texts, content)

    def _whole_poses(
        self,
        tag: Tag,
        ids: IntArray,
        rotations: FloatArray,
        translations: FloatArray,
        texts: list[bytes],
        content: TaggedLines,
    ) -> None:
        if tag.kind == "vertex":
            content.vertices.append(ids[:, 0])
            content.values.append((rotations, translations))
        elif tag.kind == "sensor":
            for sensor, *pose in zip(ids[:, 0].tolist(), rotations, translations, strict=True):
                content.add_sensor(sensor, (pose[0], pose[1]))
        elif tag.kind == "prior":
            weighed = TaggedLines(tag.d)
            self._weigh(tag.d, texts, weighed)
            content.counts.update(weighed.counts)
            (weights,), (information,) = weighed.weights, weighed.information
            sensors = ids[:, 1] if tag.sensor else np.full(len(ids), BODY)
            content.priors.append(
                Priors(ids[:, 0], rotations, translations, *weights, information, sensors)
            )
        else:
            refuse_loops(ids)
            content.edges.append(ids)
            content.measured.append((rotations, translations))
            self._weigh(tag.d, texts, content)

    def _information_size(self, tag: Tag) -> int:
        if tag.is_position:
            return POSITIONS[tag.d].size
        return self._dialect.layouts[tag.d].size if tag.kind in ("edge", "prior") else 0

    def _positions(
        self, d: int, ids: IntArray, positions: FloatArray, texts: list[bytes]
    ) -> Priors:
        """Positions alone."""
        k, (tau, matrices) = len(ids), self._weighed_positions(d, texts)
        sensors = ids[:, 1] if d == 3 else np.full(k, BODY)
        identity, information = np.tile(np.eye(d), (k, 1, 1)), None
        if matrices is not None:
            residual = self._dialect.residual
            information = Information(of_positions(matrices), np.arange(k), residual)
        return Priors(ids[:, 0], identity, positions, np.zeros(k), tau, information, sensors)

    def _sightings(
        self, tag: Tag, ids: IntArray, positions: FloatArray, texts: list[bytes]
    ) -> Sightings:
        weights = self._weighed_positions(tag.d, texts)
        sensors = ids[:, 2] if tag.sensor else np.full(len(ids), BODY)
        return Sightings(ids[:, :2], positions, *weights, sensors, tag.apart)

    def _weighed_positions(
        self, d: int, texts: list[bytes]
    ) -> tuple[FloatArray, FloatArray | None]:
        """Weights, and matrices unless some are not stated."""
        ignored = self._options.ignore_information
        given = [b""] * len(texts) if ignored else texts
        tau, matrices = position_weights(d, given, self._options.weights_are)
        return tau, matrices if all(given) else None

    def _weigh(self, d: int, texts: list[bytes], content: TaggedLines) -> None:
        kappa, tau = np.ones(len(texts)), np.ones(len(texts))
        content.weights.append((kappa, tau))
        if self._options.ignore_information:
            content.information.append(None)
            return
        stated = np.array([bool(text) for text in texts])
        content.counts[UNINFORMED] += int(np.sum(~stated))
        layout = self._dialect.layouts[d]
        given = as_information([t for t in texts if t], layout, self._options.weights_are)
        weighed = weigh(given, layout)
        kappa[stated], tau[stated] = weighed.kappa, weighed.tau
        content.counts["edge{s} with information indefinite as a whole, diagonal blocks used"] += (
            weighed.indefinite
        )
        if self._options.rotation_information == "quaternion":
            kappa[stated] *= 0.25  # half the angle, a quarter of the information; exact
        matrices = weighed.distinct[:, np.array(layout.positions)]
        # Only small roll, pitch and yaw are tangent vectors.
        whole = stated.all() and not (d == 3 and self._dialect.rotation_information == "rpy")
        content.information.append(
            Information(matrices, weighed.which, self._dialect.residual) if whole else None
        )


def _fields(
    name: str, tag: Tag, bodies: list[bytes], information: int
) -> tuple[IntArray, FloatArray, list[bytes]]:
    """Ids (k, 1 or 2), pose numbers (k, p), information texts (k), empty if absent."""
    width = tag.ids + tag.numbers
    fields: list[bytes] = []
    for body in bodies:
        values = body.split(None, width)
        if len(values) == width:
            values.append(b"")
        elif len(values) < width:
            raise InputError(_count_message(name, tag, information, len(values)))
        fields += values
    texts = fields[width :: width + 1]
    if any(texts) and not (information and _complete(bodies, width + information)):
        found = max(len(body.split()) for body in bodies)
        raise InputError(_count_message(name, tag, information, found))
    columns = [fields[k :: width + 1] for k in range(width)]
    ids = [_integers(column) for column in columns[: tag.ids]]
    numbers = [floats(column) for column in columns[tag.ids :]]
    return np.array(ids, dtype=np.intp).T, np.stack(numbers, axis=-1), texts


def _complete(bodies: list[bytes], size: int) -> bool:
    # For many lines `weigh` counts the numbers; a single line is counted for its message.
    return len(bodies) > 1 or len(bodies[0].split()) == size


def _count_message(name: str, tag: Tag, information: int, found: int) -> str:
    ids = "id" if tag.ids == 1 else "ids"
    rest = f", then {information} or no information numbers" if information else ""
    return f"{name} takes {tag.ids} {ids} and {tag.numbers} numbers{rest}; {found} values found"


def _integers(fields: list[bytes]) -> list[int]:
    # Python reads 1_0 as ten; file formats do not.
    try:
        values = list(map(int, fields))
        if b"_" in b"".join(fields):
            raise ValueError
    except ValueError:
        raise InputError(f"ids must be integers, not {_offending(fields, int)!r}") from None
    if values and not -(2**63) <= min(values) <= max(values) < 2**63:
        raise InputError("ids must fit 64-bit signed integers (GTSAM symbols do not; renumber)")
    return values


def floats(fields: list[bytes], after: str = "ids") -> FloatArray:
    """Finite numbers, from words that follow something else; an InputError shows another word."""
    try:
        values = np.array(list(map(float, fields)))
        if b"_" in b"".join(fields):
            raise ValueError
    except ValueError:
        found = _offending(fields, float)
        raise InputError(f"numbers expected after the {after}, not {found!r}") from None
    if not np.isfinite(values).all():
        raise InputError("numbers must be finite")
    return values


def _offending(fields: list[bytes], kind: Callable[[bytes], object]) -> str:
    """The first word not of that kind."""
    for word in fields:
        try:
            kind(word)
            if b"_" not in word:
                continue
        except ValueError:
            pass
        return word[:40].decode("ascii", "backslashreplace")
    return ""

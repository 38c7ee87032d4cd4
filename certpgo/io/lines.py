"""Files of tagged lines (g2o, TORO, iSAM), read in chunks.

Every line is a tag, integer ids, the numbers of a pose, and perhaps those of an information
matrix. A chunk of lines is parsed at once; when it fails it is parsed again line by line, by the
same code, to name the line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.io.format import Progress, ReadOptions, RotationInformation
from certpgo.io.information import Layout, WeightReader
from certpgo.linalg.arrays import FloatArray, IntArray

_CHUNK_BYTES = 8 << 20
_COMMENT = re.compile(rb"#[^\n]*")

#: Rotations (k, d, d), translations (k, d), and how many quaternions are off norm 1.
Poses = tuple[FloatArray, FloatArray, int]


@dataclass(frozen=True)
class Tag:
    """What the lines of one tag hold.

    Attributes
    ----------
    kind : measurement, initial value, nodes held fixed, or something to skip and count
    d : dimension of space
    numbers : numbers of the pose after the ids
    what : for skipped lines, what they are, for the notice
    """

    kind: Literal["edge", "vertex", "fix", "skip"]
    d: int = 0
    numbers: int = 0
    what: str = ""

    @property
    def ids(self) -> int:
        """Integers after the tag."""
        return 2 if self.kind == "edge" else 1


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
    rotation_information : what the format's rotational information is about
    """

    name: str
    tags: Mapping[bytes, Tag]
    layouts: Mapping[int, Layout]
    poses: Callable[[int, FloatArray], Poses]
    refused: Mapping[bytes, str] = field(default_factory=dict)
    rotation_information: RotationInformation = "tangent"


@dataclass
class Lines:
    """What the lines of a file said; lists hold one array a chunk."""

    d: int = 0
    edges: list[IntArray] = field(default_factory=list)
    measured: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    weights: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    vertices: list[IntArray] = field(default_factory=list)
    values: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    fixed: list[int] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def extend(self, other: Lines) -> None:
        """Append what the next chunk said."""
        self.d = other.d or self.d
        self.counts.update(other.counts)
        for name in ("edges", "measured", "weights", "vertices", "values", "fixed"):
            getattr(self, name).extend(getattr(other, name))


def read_lines(path: Path, dialect: Dialect, options: ReadOptions) -> Lines:
    """Everything the file says.

    Raises
    ------
    FormatError
        With the line and what was expected there.
    """
    parser = _Parser(dialect, options)
    said = Lines()
    for first, lines in chunks(path, options.progress):
        try:
            said.extend(parser.parse(lines, said.d))
        except InputError as error:
            _name_the_line(path, first, lines, parser, said.d)
            raise FormatError(path, None, str(error)) from None
    return said


def _name_the_line(path: Path, first: int, lines: list[bytes], parser: _Parser, d: int) -> None:
    for number, line in enumerate(lines, first):
        try:
            d = parser.parse([line], d).d or d
        except InputError as error:
            raise FormatError(path, number, str(error)) from None


def chunks(path: Path, progress: Progress | None = None) -> Iterator[tuple[int, list[bytes]]]:
    """Pieces of a file as (number of the first line, lines), comments removed."""
    total, done, number, rest = path.stat().st_size, 0, 1, b""
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            done += len(chunk)
            whole, newline, tail = (rest + chunk).rpartition(b"\n")
            rest = tail
            if newline:
                lines = _COMMENT.sub(b"", whole).split(b"\n")
                yield number, lines
                number += len(lines)
            if progress is not None:
                progress(done, total)
    if rest:
        yield number, [_COMMENT.sub(b"", rest)]


class _Parser:
    """Parses lists of lines; keeps nothing between them but weights already computed."""

    def __init__(self, dialect: Dialect, options: ReadOptions) -> None:
        self._dialect = dialect
        self._options = options
        self._weights = {d: WeightReader(layout) for d, layout in dialect.layouts.items()}

    def parse(self, lines: Iterable[bytes], d: int) -> Lines:
        """What the lines say, in a file that so far is d-dimensional (0: not known yet)."""
        said = Lines(d=d)
        for name, bodies in self._by_tag(lines).items():
            tag = self._tag(name)
            if tag.kind == "skip":
                said.counts[f"skipped {name.decode()} ({tag.what})"] += len(bodies)
            elif tag.kind == "fix":
                said.fixed.extend(_integers([x for body in bodies for x in body.split()]))
            else:
                if said.d not in (0, tag.d):
                    raise InputError(f"{name.decode()} in a file of {said.d}D poses")
                said.d = tag.d
                self._poses(name.decode(), tag, bodies, said)
        return said

    @staticmethod
    def _by_tag(lines: Iterable[bytes]) -> dict[bytes, list[bytes]]:
        groups: dict[bytes, list[bytes]] = {}
        for line in lines:
            head = line.split(None, 1)
            if len(head) == 2:
                groups.setdefault(head[0], []).append(head[1])
            elif head:
                groups.setdefault(head[0], []).append(b"")
        return groups

    def _tag(self, name: bytes) -> Tag:
        if name in self._dialect.refused:
            raise InputError(self._dialect.refused[name])
        if name in self._dialect.tags:
            return self._dialect.tags[name]
        known = ", ".join(tag.decode() for tag in self._dialect.tags)
        shown = name[:40].decode("ascii", "backslashreplace")
        raise InputError(f"{self._dialect.name} has no tag {shown!r}; known: {known}")

    def _poses(self, name: str, tag: Tag, bodies: list[bytes], said: Lines) -> None:
        ids, numbers, texts = _fields(name, tag, bodies, self._information_size(tag))
        rotations, translations, off_norm = self._dialect.poses(tag.d, numbers)
        said.counts["quaternions off norm 1 by more than 1e-3, normalized"] += off_norm
        if tag.kind == "vertex":
            said.vertices.append(ids[:, 0])
            said.values.append((rotations, translations))
            return
        loop = ids[:, 0] == ids[:, 1]
        if loop.any():
            raise InputError(f"{name} measures node {ids[np.argmax(loop), 0]} from itself")
        said.edges.append(ids)
        said.measured.append((rotations, translations))
        said.weights.append(self._weigh(tag.d, texts, said.counts))

    def _information_size(self, tag: Tag) -> int:
        return self._dialect.layouts[tag.d].size if tag.kind == "edge" else 0

    def _weigh(
        self, d: int, texts: list[bytes], counts: Counter[str]
    ) -> tuple[FloatArray, FloatArray]:
        kappa, tau = np.ones(len(texts)), np.ones(len(texts))
        if self._options.ignore_information:
            return kappa, tau
        stated = np.array([bool(text) for text in texts])
        counts["edges without information: kappa = tau = 1"] += int(np.sum(~stated))
        kappa[stated], tau[stated], indefinite = self._weights[d]([t for t in texts if t])
        counts["information matrices indefinite as a whole, diagonal blocks used"] += indefinite
        if self._options.rotation_information == "quaternion":
            kappa[stated] *= 0.25  # half the angle, a quarter of the information; exact
        return kappa, tau


def _fields(
    name: str, tag: Tag, bodies: list[bytes], information: int
) -> tuple[IntArray, FloatArray, list[bytes]]:
    """Ids (k, 1 or 2), pose numbers (k, p), information texts (k), empty where there is none."""
    width = tag.ids + tag.numbers
    ids: list[bytes] = []
    numbers: list[bytes] = []
    texts: list[bytes] = []
    for body in bodies:
        values = body.split(None, width)
        if len(values) < width:
            raise InputError(_count_message(name, tag, information, len(values)))
        ids += values[: tag.ids]
        numbers += values[tag.ids : width]
        texts.append(values[width].strip() if len(values) > width else b"")
    if any(texts) and not information:
        found = max(len(body.split()) for body in bodies)
        raise InputError(_count_message(name, tag, information, found))
    if len(bodies) == 1 and texts[0]:
        found = len(bodies[0].split())
        if found != width + information:
            raise InputError(_count_message(name, tag, information, found))
    return (
        np.array(_integers(ids), dtype=np.intp).reshape(-1, tag.ids),
        _floats(numbers).reshape(-1, tag.numbers),
        texts,
    )


def _count_message(name: str, tag: Tag, information: int, found: int) -> str:
    ids = "id" if tag.ids == 1 else "ids"
    rest = f", then {information} or no information numbers" if information else ""
    return f"{name} takes {tag.ids} {ids} and {tag.numbers} numbers{rest}; {found} values found"


def _integers(fields: list[bytes]) -> list[int]:
    try:
        values = list(map(int, fields))
    except ValueError:
        raise InputError("ids must be integers") from None
    if values and not -(2**63) <= min(values) <= max(values) < 2**63:
        raise InputError("ids must fit 64-bit signed integers (GTSAM symbols do not; renumber)")
    if any(b"_" in field for field in fields):
        raise InputError("ids must be integers")
    return values


def _floats(fields: list[bytes]) -> FloatArray:
    try:
        values = np.array(list(map(float, fields)))
    except ValueError:
        raise InputError("numbers expected after the ids") from None
    if not np.isfinite(values).all():
        raise InputError("numbers must be finite")
    # Python reads 1_0 as ten; no file format does.
    if b"_" in b"".join(fields):
        raise InputError("numbers expected after the ids")
    return values

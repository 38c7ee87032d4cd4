"""Lines about nodes with names, whose numbers are covariances (.pyfg), read in chunks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import FormatError, InputError
from certpgo.graph.edges import in_range
from certpgo.graph.information import Information, of_positions
from certpgo.io.assemble import FARTHEST
from certpgo.io.chunks import parsed, printable, text_lines, without_comments
from certpgo.io.exact import quaternion
from certpgo.io.exact.information import ROW_MAJOR_2D, ROW_MAJOR_3D
from certpgo.io.exact.weighing import weigh
from certpgo.io.format import ReadOptions
from certpgo.io.lines import floats, rpy_poses
from certpgo.io.priors import joined_information
from certpgo.io.stated import as_information, position_weights
from certpgo.io.timestamps import decimals
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

Kind = Literal["pose", "point", "edge", "sighting", "range", "prior", "position"]
#: What the nodes of a measurement must be, in the order of their names; None for either.
ENDS: dict[Kind, tuple[Literal["pose", "point"] | None, ...]] = {
    "edge": ("pose", "pose"),
    "sighting": ("pose", "point"),
    "range": (None, None),
    "prior": ("pose",),
    "position": (None,),
}
_LAYOUTS = {2: ROW_MAJOR_2D, 3: ROW_MAJOR_3D}


@dataclass(frozen=True)
class NamedTag:
    """The contents of lines with one tag: a time, names, numbers and a covariance.

    Attributes
    ----------
    kind : initial value of a pose or a point, measurement of a pair, of a point from a pose or of
        a distance, or prior of a pose or of a position
    d : dimension of space; 0 for either
    numbers : how many there are before those of the covariance
    covariance : how many numbers it has
    timed : whether a time follows the tag
    """

    kind: Kind
    d: int
    numbers: int
    covariance: int = 0
    timed: bool = True

    @property
    def names(self) -> int:
        """How many nodes are named."""
        return len(ENDS.get(self.kind, (None,)))

    @property
    def size(self) -> int:
        """How many words follow the tag."""
        return self.timed + self.names + self.numbers + self.covariance

    def __str__(self) -> str:
        parts = ["a time"] if self.timed else []
        parts.append("a name" if self.names == 1 else f"{self.names} names")
        if self.kind == "range":
            return ", ".join([*parts, "a distance and a variance"])
        parts.append(f"{self.numbers} numbers")
        if self.covariance:
            parts.append(f"{self.covariance} numbers of a covariance")
        return f"{', '.join(parts[:-1])} and {parts[-1]}"


#: Tags by kind, in the plane and in space.
NAMES: dict[Kind, dict[int, str]] = {
    "pose": {2: "VERTEX_SE2", 3: "VERTEX_SE3:QUAT"},
    "point": {2: "VERTEX_XY", 3: "VERTEX_XYZ"},
    "edge": {2: "EDGE_SE2", 3: "EDGE_SE3:QUAT"},
    "sighting": {2: "EDGE_SE2_XY", 3: "EDGE_SE3_XYZ"},
    "prior": {2: "VERTEX_SE2:PRIOR", 3: "VERTEX_SE3:QUAT:PRIOR"},
    "position": {2: "VERTEX_XY:PRIOR", 3: "VERTEX_XYZ:PRIOR"},
    "range": {2: "EDGE_RANGE", 3: "EDGE_RANGE"},
}


def _tag(kind: Kind, d: int) -> NamedTag:
    whole, position = 4 * d - 5, d * (d + 1) // 2
    if kind == "range":
        return NamedTag(kind, 0, 1, 1)
    if kind in ("point", "sighting", "position"):
        covariance = 0 if kind == "point" else position
        return NamedTag(kind, d, d, covariance, timed=kind != "point")
    return NamedTag(kind, d, whole, 0 if kind == "pose" else _LAYOUTS[d].size)


TAGS = {name.encode(): _tag(kind, d) for kind, names in NAMES.items() for d, name in names.items()}


@dataclass(frozen=True, eq=False)
class NamedPart:
    """Lines of one kind.

    Attributes
    ----------
    names : of the nodes of each line
    rotations, translations : (k, d, d) and (k, d)
    numbers : (k,) distances; zeros for other kinds
    kappa, tau : (k,) weights; those of distances are tau
    information : matrices; None where they are ignored, and for distances
    stamps : (k, 2) times of poses, see `decimals`; empty for other kinds
    """

    names: list[tuple[str, ...]]
    rotations: FloatArray
    translations: FloatArray
    numbers: FloatArray
    kappa: FloatArray
    tau: FloatArray
    information: Information | None = None
    stamps: IntArray = field(default_factory=lambda: decimals([]))

    def subset(self, chosen: BoolArray) -> NamedPart:
        """Some lines, by mask (k,)."""
        return NamedPart(
            list(compress(self.names, chosen.tolist())),
            self.rotations[chosen],
            self.translations[chosen],
            self.numbers[chosen],
            self.kappa[chosen],
            self.tau[chosen],
            self.information and self.information.subset(chosen),
        )


@dataclass
class NamedLines:
    """The contents of a file; lists have one part per chunk and tag."""

    d: int = 0
    parts: dict[Kind, list[NamedPart]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)

    def extend(self, other: NamedLines) -> None:
        """Append the next chunk."""
        self.d = other.d or self.d
        self.counts.update(other.counts)
        for kind, parts in other.parts.items():
            self.parts.setdefault(kind, []).extend(parts)

    def joined(self, kind: Kind) -> NamedPart:
        """All lines of a kind; perhaps none."""
        parts = self.parts.get(kind, [])
        if not parts:
            d, none = self.d, np.empty(0)
            return NamedPart([], np.empty((0, d, d)), np.empty((0, d)), none, none, none)
        columns = zip(
            *((p.rotations, p.translations, p.numbers, p.kappa, p.tau) for p in parts), strict=True
        )
        R, t, numbers, kappa, tau = (np.concatenate(column) for column in columns)
        names = [name for part in parts for name in part.names]
        information = joined_information([part.information for part in parts])
        stamps = np.concatenate([part.stamps for part in parts])
        return NamedPart(names, R, t, numbers, kappa, tau, information, stamps)


def is_named(path: Path, head: bytes) -> bool:
    """Whether the first bytes of a file are of lines with names, rather than g2o's with numbers.

    A whole line tells; in a file with the suffix .pyfg, also one with too many or too few words.
    """
    for line in without_comments(head).splitlines():
        words = line.split()
        tag = TAGS.get(words[0]) if words else None
        if tag is None or len(words) < 2 + tag.timed or _is_number(words[1 + tag.timed]):
            continue
        if len(words) == 1 + tag.size or path.suffix == ".pyfg":
            return True
    return False


def read_named(path: Path, options: ReadOptions) -> NamedLines:
    """The contents of the file; a FormatError names the line and what was expected."""
    parser, content = _Parser(options), NamedLines()
    for part in parsed(path, parser.parse, options.progress):
        content.extend(part)
    return content


def lines_with_names(path: Path) -> Iterator[tuple[int, Kind, tuple[str, ...]]]:
    """The number of each line of a file that can be read, its kind, and the names on it."""
    for number, line in text_lines(path):
        words = without_comments(line).split()
        if words:
            tag = TAGS[words[0]]
            first = 1 + tag.timed
            names = words[first : first + tag.names]
            yield number, tag.kind, tuple(name.decode() for name in names)


class _Parser:
    """Parses lists of lines; remembers only the dimension."""

    def __init__(self, options: ReadOptions) -> None:
        self._options = options
        self._d = 0

    def parse(self, lines: list[bytes]) -> NamedLines:
        """The contents of the lines."""
        content = NamedLines(self._d)
        groups: dict[bytes, list[list[bytes]]] = {}
        for line in lines:
            words = line.split()
            if words:
                groups.setdefault(words[0], []).append(words)
        for name, rows in groups.items():
            tag = self._tag(name)
            if tag.d and content.d not in (0, tag.d):
                raise InputError(f"{name.decode()} in a file of {content.d}D poses")
            content.d = tag.d or content.d
            for row in rows:
                if len(row) != 1 + tag.size:
                    found = f"{len(row) - 1} values found"
                    raise InputError(f"{name.decode()} takes {tag}; {found}")
            names = _names(tag, rows)
            if skipped := self._skipped(tag):
                content.counts[f"{name.decode()} line{{s}} skipped: {skipped}"] += len(rows)
                continue
            content.parts.setdefault(tag.kind, []).append(self._part(tag, names, rows, content))
        self._d = content.d
        return content

    def _skipped(self, tag: NamedTag) -> str:
        """What lines of a kind are about that are skipped by choice; else empty."""
        if tag.kind in ("prior", "position") and self._options.skip_priors:
            return "priors"
        return "landmarks" if tag.kind == "sighting" and self._options.skip_landmarks else ""

    @staticmethod
    def _tag(name: bytes) -> NamedTag:
        if name in TAGS:
            return TAGS[name]
        known = ", ".join(tag.decode() for tag in TAGS)
        shown = name[:40].decode("ascii", "backslashreplace")
        raise InputError(f"pyfg has no tag {shown!r}; known: {known}")

    def _part(
        self,
        tag: NamedTag,
        names: list[tuple[str, ...]],
        rows: list[list[bytes]],
        content: NamedLines,
    ) -> NamedPart:
        k, last = len(rows), 1 + tag.timed + tag.names
        if tag.timed:
            floats([row[1] for row in rows], "tag")
        stamps = decimals([row[1] for row in rows] if tag.kind == "pose" else [])
        words = [word for row in rows for word in row[last : last + tag.numbers]]
        numbers = floats(words, "names").reshape(k, tag.numbers)
        if (np.abs(numbers[:, : max(tag.d, 1)]) > FARTHEST).any():
            raise InputError(f"positions and distances up to {FARTHEST:.0e} expected")
        texts = [b" ".join(row[last + tag.numbers :]) for row in rows]
        if tag.kind == "range":
            return self._ranges(names, numbers[:, 0], texts)
        if tag.numbers == tag.d:
            R, t, off_norm = np.tile(np.eye(tag.d), (k, 1, 1)), numbers, 0
        elif tag.d == 2:
            R, t, off_norm = rpy_poses(2, numbers)
        else:
            t, q = numbers[:, :3], numbers[:, 3:]
            R, off_norm = quaternion.rotations(q), quaternion.off_norm(q)
        content.counts["quaternion{s} off norm 1 by more than 1e-3, normalized"] += off_norm
        return NamedPart(names, R, t, np.zeros(k), *self._weights(tag, texts), stamps)

    def _ranges(
        self, names: list[tuple[str, ...]], distances: FloatArray, texts: list[bytes]
    ) -> NamedPart:
        if (distances < 0.0).any():
            raise InputError(f"a distance must not be negative, as {distances.min():g} is")
        k, weights = len(names), np.ones(len(names))
        if not self._options.ignore_information:
            variances = floats(texts, "names")
            if not (variances > 0.0).all():
                raise InputError(f"a variance must be positive, not {variances.min():g}")
            with np.errstate(over="ignore"):
                weights = 1.0 / variances
            if not in_range(weights).all():
                raise InputError(f"variances between {1.0 / FAR:.2g} and {FAR:.2g} expected")
        none = np.empty((k, 0))
        return NamedPart(names, none[:, :, None], none, distances, np.zeros(k), weights)

    def _weights(
        self, tag: NamedTag, texts: list[bytes]
    ) -> tuple[FloatArray, FloatArray, Information | None]:
        """Weights kappa and tau, and information matrices unless they are ignored."""
        k = len(texts)
        ignored = self._options.ignore_information or not tag.covariance
        position = tag.numbers == tag.d
        if ignored:
            return np.zeros(k) if position else np.ones(k), np.ones(k), None
        floats([word for text in dict.fromkeys(texts) for word in text.split()], "names")
        if position:
            tau, matrices = position_weights(tag.d, texts, "covariance")
            return np.zeros(k), tau, Information(of_positions(matrices), np.arange(k))
        layout = _LAYOUTS[tag.d]
        weighed = weigh(as_information(texts, layout, "covariance"), layout)
        matrices = weighed.distinct[:, np.array(layout.positions)]
        return weighed.kappa, weighed.tau, Information(matrices, weighed.which)


def is_name(name: str) -> bool:
    """Whether a name can be written and read again."""
    try:
        word = name.encode()
    except UnicodeEncodeError:
        return False
    return word.split() == [word] and b"#" not in word and not _is_number(word) and printable(word)


def _names(tag: NamedTag, rows: list[list[bytes]]) -> list[tuple[str, ...]]:
    first = 1 + tag.timed
    names = [tuple(map(_name, row[first : first + tag.names])) for row in rows]
    for pair in names:
        if len(set(pair)) < len(pair):
            raise InputError(f"{pair[0]} is measured from itself")
    return names


def _name(word: bytes) -> str:
    if _is_number(word):
        raise InputError(f"a name expected, such as A0, not the number {word.decode()!r}")
    try:
        return word.decode()
    except UnicodeDecodeError:
        shown = word[:40].decode("ascii", "backslashreplace")
        raise InputError(f"names in UTF-8 expected, not {shown!r}") from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def located(path: Path, names: dict[str, str]) -> FormatError:
    """The first line with a name that is repeated, unknown or of another kind than expected.

    Parameters
    ----------
    names : of all nodes, with ``"pose"`` or ``"point"``
    """
    seen: set[str] = set()
    for number, kind, (first, *_) in lines_with_names(path):
        if kind in ("pose", "point"):
            if first in seen:
                return FormatError(path, number, f"{first} appears twice")
            seen.add(first)
    for number, kind, found in lines_with_names(path):
        for name, expected in zip(found, ENDS.get(kind, ()), strict=False):
            if name not in names:
                said = f"{name} is unknown: no VERTEX line names it"
                return FormatError(path, number, said)
            if expected not in (None, names[name]):
                said = f"{name} is a {names[name]}, and a {expected} is expected there"
                return FormatError(path, number, said)
    return FormatError(path, None, "the names on its lines do not fit one another")

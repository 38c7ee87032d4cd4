"""The reader of tagged lines: one loop for all dialects.

A chunk of lines is parsed at once, grouped by tag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import InputError, nearest
from certpgo.graph.edges import in_range
from certpgo.graph.information import Information, of_positions
from certpgo.graph.phrases import few
from certpgo.io.chunks import decimal_comma, parsed, printable, refuse_loops
from certpgo.io.dialect import Dialect, Tag
from certpgo.io.edge_weights import INDEFINITE, PARTIAL, partial_counts
from certpgo.io.exact.weighing import weigh
from certpgo.io.format import ReadOptions
from certpgo.io.precision_kind import as_information, position_weights
from certpgo.io.records import BODY, Records, Rows
from certpgo.io.timestamps import decimals
from certpgo.linalg.arrays import FloatArray, IntArray

#: Notice about edges without information, with their number.
UNINFORMED = "edge{s} without information: kappa = tau = 1"
OFF_NORM = "quaternion{s} off norm 1 by more than 1e-3, normalized"
#: Largest translation or distance, metres.
FARTHEST = 1e90
#: How unknown tags begin that are of values, parameters and raw data, as other programs have them.
_NO_MEASUREMENTS = (b"VERTEX", b"PARAM", b"DATA", b"ROBOTLASER", b"RAWLASER", b"FLASER")
Weights = tuple[FloatArray, FloatArray, Information | None]


def read_lines(
    paths: Sequence[Path], dialect: Dialect, options: ReadOptions
) -> tuple[Records, list[int]]:
    """The contents of files, and the numbers of their first lines, counted through all.

    A FormatError names the line and what was expected.
    """
    parser, content, firsts = _Parser(dialect, options), Records(), list[int]()
    for path in paths:
        firsts.append(parser.next_line)
        for part in parsed(path, parser.parse, options.progress):
            content.extend(part)
    content.names = parser.names
    return content, firsts


class _Parser:
    """Parses lists of lines; remembers the dimension, the names, and how many lines there were."""

    def __init__(self, dialect: Dialect, options: ReadOptions) -> None:
        self._dialect = dialect
        self._options = options
        self._d, self.next_line = 0, 1
        self._named: dict[bytes, int] = {}
        self._after = "names" if dialect.named else "ids"

    @property
    def names(self) -> list[str]:
        """The names so far."""
        return [word.decode() for word in self._named]

    def parse(self, lines: list[bytes]) -> Records:
        """The contents of the lines."""
        content = Records(self._d)
        for name, (bodies, numbers) in self._by_tag(lines).items():
            tag = self._tag(name)
            if what := self._skipped(tag, content.d):
                content.counts[f"{name.decode()} line{{s}} skipped: {what}"] += len(bodies)
            elif tag.kind == "fix":
                content.fixed.extend(_integers([x for body in bodies for x in body.split()]))
            else:
                if tag.d and content.d not in (0, tag.d):
                    raise InputError(f"{name.decode()} in a file of {content.d}D poses")
                content.d = tag.d or content.d
                columns, texts = self._fields(name.decode(), tag, bodies)
                if tag.kind == "edge" and tag.what:
                    content.counts[tag.what] += len(bodies)
                rows = self._rows(tag, columns, texts, content.counts)
                rows = replace(rows, lines=np.array(numbers))
                content.rows.setdefault(tag.kind, []).append(rows)
        self._d = content.d
        return content

    def _by_tag(self, lines: list[bytes]) -> dict[bytes, tuple[list[bytes], list[int]]]:
        """What follows each tag, and the numbers of these lines."""
        groups: dict[bytes, tuple[list[bytes], list[int]]] = {}
        for number, line in enumerate(lines, self.next_line):
            head = line.split(None, 1)
            if head:
                bodies, numbers = groups.setdefault(head[0], ([], []))
                bodies.append(head[1] if len(head) == 2 else b"")
                numbers.append(number)
        self.next_line += len(lines)
        return groups

    def _tag(self, name: bytes) -> Tag:
        dialect = self._dialect
        if name.decode("utf-8", "replace") in self._options.skip:
            return Tag("skip", what="left out as chosen, whatever they measure")
        if name in dialect.refused:
            raise InputError(dialect.refused[name])
        if name in dialect.tags:
            return dialect.tags[name]
        if name.startswith(_NO_MEASUREMENTS) and not dialect.named:
            return Tag("skip", what=f"no tag of {dialect.name}, and no measurement")
        known = [tag.decode() for tag in dialect.tags]
        shown = name[:40].decode("ascii", "backslashreplace")
        near = nearest(shown, known)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known: {few(known)}"
        raise InputError(
            f"{dialect.name} has no tag {shown!r} (--skip {shown} leaves such lines out); {hint}"
        )

    def _skipped(self, tag: Tag, d: int) -> str:
        """What skipped lines are about; empty for lines that are read."""
        priors, landmarks = self._options.skip_priors, self._options.skip_landmarks
        skipped = {
            "skip": True,
            "prior": priors,
            "sighting": landmarks,
            "point": landmarks,
            "sensor": d == 2 or (priors and landmarks),
        }
        return tag.what if skipped.get(tag.kind) else ""

    def _fields(
        self, name: str, tag: Tag, bodies: list[bytes]
    ) -> tuple[list[list[bytes]], list[bytes]]:
        """Columns of words, and texts (k) of precisions, empty if absent."""
        width, fields = tag.timed + tag.ids + tag.numbers, list[bytes]()
        for body in bodies:
            values = body.split(None, width)
            if len(values) == width:
                values.append(b"")
            elif len(values) < width:
                raise InputError(self._miscounted(name, tag, len(values)))
            fields += values
        texts = fields[width :: width + 1]
        if not (tag.loose or self._complete(texts, self._dialect.precision_size(tag))):
            found = max(len(body.split()) for body in bodies)
            raise InputError(self._miscounted(name, tag, found))
        return [fields[k :: width + 1] for k in range(width)], texts

    def _complete(self, texts: list[bytes], size: int) -> bool:
        if self._dialect.precision:
            return all(len(text.split()) == size for text in texts)
        if not any(texts):
            return True
        # For many lines `weigh` counts the numbers; a single line is counted for its message.
        return size > 0 and (len(texts) > 1 or len(texts[0].split()) == size)

    def _miscounted(self, name: str, tag: Tag, found: int) -> str:
        return f"{name} takes {self._dialect.expected(tag)}; {found} values found"

    def _rows(
        self,
        tag: Tag,
        columns: list[list[bytes]],
        texts: list[bytes],
        counts: Counter[str],
    ) -> Rows:
        k, lead = len(texts), tag.timed + tag.ids
        ids = self._ids(tag, columns[tag.timed : lead])
        if tag.timed:
            floats(columns[0], "tag")
        numbers = np.stack([floats(column, self._after) for column in columns[lead:]], axis=-1)
        if self._dialect.named and (np.abs(numbers[:, : max(tag.d, 1)]) > FARTHEST).any():
            raise InputError(f"positions and distances up to {FARTHEST:.0e} expected")
        nodes = ids[:, : tag.nodes]
        if tag.kind == "range":
            return self._ranges(nodes, numbers, texts)
        if tag.is_position:
            R, t = np.tile(np.eye(tag.d), (k, 1, 1)), numbers
        else:
            R, t, off_norm = self._dialect.poses(tag.d, numbers)
            counts[OFF_NORM] += off_norm
        rows = Rows(nodes, R, t, *self._weights(tag, texts, R, counts))
        if tag.kind in ("prior", "sighting"):
            sensors = ids[:, -1] if tag.sensor else np.full(k, BODY)
            flags = np.full(k, tag.apart), np.full(k, tag.is_position)
            return replace(rows, sensors=sensors, apart=flags[0], bodily=flags[1])
        if tag.kind == "pose" and tag.timed:
            return replace(rows, stamps=decimals(columns[0]))
        return rows

    def _ids(self, tag: Tag, columns: list[list[bytes]]) -> IntArray:
        """Ids (k, 1 to 3), or numbers of names."""
        convert = self._numbers_of if self._dialect.named else _integers
        ids = np.array([convert(column) for column in columns], dtype=np.intp).T
        if tag.kind == "edge" or (tag.nodes == 2 and self._dialect.named):
            called = (lambda k: self.names[k]) if self._dialect.named else "node {}".format
            refuse_loops(ids, called)
        return ids

    def _numbers_of(self, names: list[bytes]) -> list[int]:
        for word in dict.fromkeys(names):
            if word not in self._named:
                _check_name(word)
                self._named[word] = len(self._named)
        return [self._named[word] for word in names]

    def _ranges(self, nodes: IntArray, distances: FloatArray, texts: list[bytes]) -> Rows:
        if (distances < 0.0).any():
            raise InputError(f"a distance must not be negative, as {distances.min():g} is")
        k, weights = len(texts), np.ones(len(texts))
        if not self._options.ignore_information:
            variances = floats([text.strip() for text in texts], self._after)
            if not (variances > 0.0).all():
                raise InputError(f"a variance must be positive, not {variances.min():g}")
            with np.errstate(over="ignore"):
                weights = 1.0 / variances
            if not in_range(weights).all():
                raise InputError(f"variances between {1.0 / FAR:.2g} and {FAR:.2g} expected")
        return Rows(nodes, np.empty((k, 0, 0)), distances, np.zeros(k), weights)

    def _weights(
        self, tag: Tag, texts: list[bytes], rotations: FloatArray, counts: Counter[str]
    ) -> Weights:
        """Weights kappa and tau, and matrices unless some are missing or ignored."""
        k, options, dialect = len(texts), self._options, self._dialect
        kappa, tau = np.zeros(k) if tag.is_position else np.ones(k), np.ones(k)
        if options.ignore_information or not dialect.precision_size(tag):
            return kappa, tau, None
        if dialect.precision:
            floats([word for text in dict.fromkeys(texts) for word in text.split()], self._after)
        kind = dialect.precision or options.weights_are
        if tag.is_position:
            tau, positions = position_weights(tag.d, texts, kind)
            whole = Information(of_positions(positions), np.arange(k), dialect.residual)
            counts[PARTIAL] += int(np.count_nonzero(whole.is_partial))
            return kappa, tau, whole if all(texts) else None
        stated = np.array([bool(text) for text in texts])
        counts[UNINFORMED] += int(np.sum(~stated))
        layout = dialect.layouts[tag.d]
        weighed = weigh(as_information([text for text in texts if text], layout, kind), layout)
        kappa[stated], tau[stated] = weighed.kappa, weighed.tau
        counts[INDEFINITE] += weighed.indefinite
        if options.rotation_information == "quaternion":
            kappa[stated] *= 0.25  # half the angle, a quarter of the information; exact
        # Only small roll, pitch and yaw are tangent vectors.
        no_tangents = tag.d == 3 and dialect.rotation_information == "rpy"
        if not stated.all() or no_tangents or dialect.isotropic:
            return kappa, tau, None
        matrices = weighed.distinct[:, np.array(layout.positions)]
        information = Information(matrices, weighed.which, dialect.residual)
        counts.update(partial_counts(information, kappa, tau))
        return kappa, tau, information.in_first_frames(rotations)


def is_name(name: str) -> bool:
    """Whether a name can be written and read again."""
    try:
        word = name.encode()
    except UnicodeEncodeError:
        return False
    return word.split() == [word] and b"#" not in word and not is_number(word) and printable(word)


def is_number(word: bytes) -> bool:
    """Whether a word is a number, and so no name."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _check_name(word: bytes) -> None:
    if is_number(word):
        raise InputError(f"a name expected, such as A0, not the number {word.decode()!r}")
    try:
        word.decode()
    except UnicodeDecodeError:
        shown = word[:40].decode("ascii", "backslashreplace")
        raise InputError(f"names in UTF-8 expected, not {shown!r}") from None


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


def floats(fields: list[bytes], after: str) -> FloatArray:
    """Finite numbers, from words that follow something else; an InputError shows another word."""
    try:
        values = np.array(list(map(float, fields)))
        if b"_" in b"".join(fields):
            raise ValueError
    except ValueError:
        found = _offending(fields, float)
        said = f"numbers expected after the {after}, not {found!r}{decimal_comma(found)}"
        raise InputError(said) from None
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

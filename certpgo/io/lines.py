"""The reader of tagged lines: one loop for all dialects.

A chunk of lines is parsed at once, grouped by tag.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import InputError, nearest
from certpgo.graph.edges import in_range
from certpgo.graph.information import Information, of_positions
from certpgo.graph.phrases import few
from certpgo.io.chunks import is_number, parsed, printable, refuse_loops, shown
from certpgo.io.dialect import Dialect, Tag
from certpgo.io.edge_weights import ALONE, INDEFINITE, PARTIAL, partial_counts
from certpgo.io.exact.weighing import stated_blocks, weigh
from certpgo.io.fields import Fields, by_tag, distinct_texts, floats, integers, plain_fields
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
        self._plain = {name: tag for name, tag in dialect.tags.items() if self._is_plain(name, tag)}

    @property
    def names(self) -> list[str]:
        """The names so far."""
        return [word.decode() for word in self._named]

    def parse(self, text: bytes) -> Records:
        """The contents of the lines in a text."""
        content = Records(self._d)
        plain, others = plain_fields(text, self._plain, self.next_line)
        # Points last: those of another space than poses are left out.
        for name in sorted(plain, key=lambda name: self._plain[name].kind == "point"):
            self._add(content, name, self._plain[name], plain[name])
        for name, lines in by_tag(others).items():
            tag, bodies = self._tag(name), [body for _, body in lines]
            if what := self._skipped(tag, content.d):
                content.counts[f"{shown(name)} line{{s}} skipped: {what}"] += len(lines)
            elif tag.kind == "fix":
                content.fixed.extend(integers([x for body in bodies for x in body.split()]))
            else:
                fields = self._fields(name.decode(), tag, bodies)
                fields = replace(fields, lines=np.array([number for number, _ in lines]))
                self._add(content, name, tag, fields)
        self._d = content.d
        self.next_line += text.count(b"\n") + 1
        return content

    def _add(self, content: Records, name: bytes, tag: Tag, fields: Fields) -> None:
        """Append the rows of one tag."""
        if tag.d and content.d not in (0, tag.d):
            strange = f"{name.decode()}{{s}} in a file of {content.d}D poses"
            if tag.kind != "point" or self._dialect.named:
                raise InputError(strange.format(s=""))
            content.counts[f"{strange} skipped"] += len(fields)
            return
        content.d = tag.d or content.d
        if found := self._wrong_count(tag, fields.texts):
            raise InputError(self._miscounted(name.decode(), tag, found))
        if tag.more:
            words = [text.split() for text in fields.texts if text]
            content.cameras |= {tuple(floats(row, self._after).tolist()) for row in words}
        if tag.kind == "edge" and tag.what:
            content.counts[tag.what] += len(fields)
        rows = replace(self._rows(tag, fields, content.counts), lines=fields.lines)
        content.rows.setdefault(tag.kind, []).append(rows)

    def _is_plain(self, name: bytes, tag: Tag) -> bool:
        """Whether the lines of a tag are read whatever else there is, and have ids and numbers."""
        if self._dialect.named or name.decode() in self._options.skip or self._skipped(tag, 0):
            return False
        return tag.kind not in ("skip", "fix", "sensor") and not tag.timed

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
        found = shown(name)
        near = nearest(found, known)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known: {few(known)}"
        raise InputError(
            f"{dialect.name} has no tag {found!r} (--skip {found} leaves such lines out); {hint}"
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

    def _fields(self, name: str, tag: Tag, bodies: list[bytes]) -> Fields:
        """What follows a tag, word by word."""
        lead, words = tag.timed + tag.ids, list[bytes]()
        width = lead + tag.numbers
        for body in bodies:
            values = body.split(None, width)
            if len(values) == width:
                values.append(b"")
            elif len(values) < width:
                raise InputError(self._miscounted(name, tag, len(values)))
            words += values
        texts, which = distinct_texts(words[width :: width + 1])
        columns = [words[k :: width + 1] for k in range(width)]
        ids = self._ids(columns[tag.timed : lead])
        if tag.timed:
            floats(columns[0], "tag")
        numbers = np.stack([floats(column, self._after) for column in columns[lead:]], axis=-1)
        times = tuple(columns[0]) if tag.timed else ()
        return Fields(np.arange(len(bodies)), ids, numbers, texts, which, times)

    def _wrong_count(self, tag: Tag, texts: list[bytes]) -> int:
        """How many values a line has whose precision is too short or too long; 0 if none is."""
        size, required = self._dialect.precision_size(tag), self._dialect.precision is not None
        if tag.more and {len(text.split()) for text in texts} <= {0, tag.more}:
            return 0
        if tag.loose or not (required or any(texts)):
            return 0
        # Of many texts `weigh` counts the numbers; a single one is counted for its message.
        counted = required or len(texts) == 1
        if all(len(text.split()) == size for text in texts) if counted else size:
            return 0
        return tag.ids + tag.timed + tag.numbers + max(len(text.split()) for text in texts)

    def _miscounted(self, name: str, tag: Tag, found: int) -> str:
        return f"{name} takes {self._dialect.expected(tag)}; {found} values found"

    def _rows(self, tag: Tag, fields: Fields, counts: Counter[str]) -> Rows:
        k, ids, numbers = len(fields), fields.ids, fields.numbers
        if tag.kind == "edge" or (tag.nodes == 2 and self._dialect.named):
            called = (lambda k: self.names[k]) if self._dialect.named else "node {}".format
            refuse_loops(ids, called)
        if self._dialect.named and (np.abs(numbers[:, : max(tag.d, 1)]) > FARTHEST).any():
            raise InputError(f"positions and distances up to {FARTHEST:.0e} expected")
        nodes = ids[:, : tag.nodes]
        if tag.kind == "range":
            return self._ranges(nodes, numbers, fields)
        if tag.is_position:
            R, t = np.tile(np.eye(tag.d), (k, 1, 1)), numbers
        else:
            R, t, off_norm = self._dialect.poses(tag.d, numbers)
            counts[OFF_NORM] += off_norm
        rows = Rows(nodes, R, t, *self._weights(tag, fields, R, counts))
        if self._dialect.scales is not None:
            rows = replace(rows, scales=self._dialect.scales(numbers))
        if tag.kind in ("prior", "sighting"):
            sensors = ids[:, -1] if tag.sensor else np.full(k, BODY)
            flags = np.full(k, tag.apart), np.full(k, tag.is_position)
            return replace(rows, sensors=sensors, apart=flags[0], bodily=flags[1])
        if tag.kind == "pose" and tag.timed:
            return replace(rows, stamps=decimals(fields.times))
        return rows

    def _ids(self, columns: list[list[bytes]]) -> IntArray:
        """Ids (k, 1 to 3), or numbers of names."""
        convert = self._numbers_of if self._dialect.named else integers
        return np.array([convert(column) for column in columns], dtype=np.intp).T

    def _numbers_of(self, names: list[bytes]) -> list[int]:
        for word in dict.fromkeys(names):
            if word not in self._named:
                _check_name(word)
                self._named[word] = len(self._named)
        return [self._named[word] for word in names]

    def _ranges(self, nodes: IntArray, distances: FloatArray, fields: Fields) -> Rows:
        if (distances < 0.0).any():
            raise InputError(f"a distance must not be negative, as {distances.min():g} is")
        k, weights = len(fields), np.ones(len(fields))
        if not self._options.ignore_variances:
            variances = floats([text.strip() for text in fields.texts], self._after)
            if not (variances > 0.0).all():
                raise InputError(f"a variance must be positive, not {variances.min():g}")
            with np.errstate(over="ignore"):
                weights = (1.0 / variances)[fields.which]
            if not in_range(weights).all():
                raise InputError(f"variances between {1.0 / FAR:.2g} and {FAR:.2g} expected")
        return Rows(nodes, np.empty((k, 0, 0)), distances, np.zeros(k), weights)

    def _weights(
        self, tag: Tag, fields: Fields, rotations: FloatArray, counts: Counter[str]
    ) -> Weights:
        """Weights kappa and tau, and matrices unless some are missing or ignored."""
        k, options, dialect, texts = len(fields), self._options, self._dialect, fields.texts
        kappa, tau = np.zeros(k) if tag.is_position else np.ones(k), np.ones(k)
        if not dialect.precision_size(tag) or (tag.is_position and options.ignore_information):
            return kappa, tau, None
        if dialect.precision and not options.ignore_information:
            floats([word for text in texts for word in text.split()], self._after)
        kind = dialect.precision or options.weights_are
        if tag.is_position:
            weights, matrices = position_weights(tag.d, texts, kind)
            whole = Information(of_positions(matrices), fields.which, dialect.residual)
            counts[PARTIAL] += int(np.count_nonzero(whole.is_partial))
            return kappa, weights[fields.which], whole if all(texts) else None
        known = np.array([bool(text) for text in texts])
        stated, number = known[fields.which], np.cumsum(known) - 1
        which = number[fields.which[stated]]
        if not options.ignore_information:
            counts[UNINFORMED] += int(np.sum(~stated))
        layout = dialect.layouts[tag.d]
        if options.ignore_information:
            of_text = stated_blocks([text for text in texts if text], layout)
            kappa[stated], tau[stated] = (weights[which] for weights in of_text)
            counts[ALONE] += int(np.count_nonzero((kappa == 0.0) | (tau == 0.0)))
            return kappa, tau, None
        weighed = weigh(as_information([text for text in texts if text], layout, kind), layout)
        kappa[stated], tau[stated] = weighed.kappa[which], weighed.tau[which]
        counts[INDEFINITE] += int(np.count_nonzero(weighed.indefinite[which]))
        if options.rotation_information == "quaternion":
            kappa[stated] *= 0.25  # half the angle, a quarter of the information; exact
        # Only small roll, pitch and yaw are tangent vectors.
        no_tangents = tag.d == 3 and dialect.rotation_information == "rpy"
        if not stated.all() or no_tangents or dialect.isotropic:
            return kappa, tau, None
        information = Information(
            weighed.numbers[:, np.array(layout.positions)], which, dialect.residual
        )
        counts.update(partial_counts(information, kappa, tau))
        return kappa, tau, information.in_first_frames(rotations)


def is_name(name: str) -> bool:
    """Whether a name can be written and read again."""
    try:
        word = name.encode()
    except UnicodeEncodeError:
        return False
    return word.split() == [word] and b"#" not in word and not is_number(word) and printable(word)


def _check_name(word: bytes) -> None:
    if is_number(word):
        raise InputError(f"a name expected, such as A0, not the number {word.decode()!r}")
    try:
        word.decode()
    except UnicodeDecodeError:
        raise InputError(f"names in UTF-8 expected, not {shown(word)!r}") from None

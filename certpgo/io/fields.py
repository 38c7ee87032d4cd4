"""What follows the tags of lines: ids or names, numbers, and the texts of precisions.

The kernel reads plain lines; the others are read word by word, with messages about what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from certpgo.errors import InputError
from certpgo.io.chunks import decimal_comma, shown
from certpgo.io.dialect import Tag
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray, IntArray

#: Numbered lines.
Numbered = list[tuple[int, bytes]]


@dataclass(frozen=True, eq=False)
class Fields:
    """The contents of k lines with one tag.

    Attributes
    ----------
    lines : (k,) their numbers
    ids : (k, a), or numbers of names
    numbers : (k, b)
    texts : the different texts of precisions; empty for none
    which : (k,) the text of each line
    times : (k) words, if a time follows the tag
    """

    lines: IntArray
    ids: IntArray
    numbers: FloatArray
    texts: list[bytes]
    which: IntArray
    times: tuple[bytes, ...] = ()

    def __len__(self) -> int:
        return len(self.lines)


def plain_fields(
    text: bytes, tags: dict[bytes, Tag], first: int
) -> tuple[dict[bytes, Fields], Numbered]:
    """The plain lines by tag, and the others, which are not blank.

    Parameters
    ----------
    tags : of lines with ids and finite numbers; only they may be plain
    first : number of the first line
    """
    if not compiled.AVAILABLE:
        lines = enumerate(text.split(b"\n"), first)
        return {}, [(number, line) for number, line in lines if line.strip()]
    shapes = tuple((name, tag.ids, tag.numbers) for name, tag in tags.items())
    parts, rest = compiled.kernel.tagged_lines(text, shapes, first)
    found = {
        name: Fields(
            np.frombuffer(places, np.int64),
            np.frombuffer(ids, np.int64).reshape(-1, a),
            np.frombuffer(numbers, np.float64).reshape(-1, b),
            texts,
            np.frombuffer(which, np.int64),
        )
        for (name, a, b), (places, ids, numbers, which, texts) in zip(shapes, parts, strict=True)
        if texts
    }
    return found, rest


def by_tag(lines: Numbered) -> dict[bytes, Numbered]:
    """What follows the tags, with the numbers of the lines."""
    groups: dict[bytes, Numbered] = {}
    for number, line in lines:
        head = line.split(None, 1)
        groups.setdefault(head[0], []).append((number, head[1] if len(head) == 2 else b""))
    return groups


def distinct_texts(texts: Iterable[bytes]) -> tuple[list[bytes], IntArray]:
    """The different texts in the order of their first occurrence, and the number of each one."""
    number: dict[bytes, int] = {}
    which = [number.setdefault(text, len(number)) for text in texts]
    return list(number), np.array(which, dtype=np.intp)


def integers(words: list[bytes]) -> list[int]:
    """Ids of 64 bits; an InputError shows another word."""
    # Python reads 1_0 as ten; file formats do not.
    try:
        values = list(map(int, words))
        if b"_" in b"".join(words):
            raise ValueError
    except ValueError:
        raise InputError(f"ids must be integers, not {_offending(words, int)!r}") from None
    if values and not -(2**63) <= min(values) <= max(values) < 2**63:
        symbols = "symbols of GTSAM do if their letters are ASCII"
        raise InputError(f"ids must fit 64-bit signed integers ({symbols}); renumber these nodes")
    return values


def floats(words: list[bytes], after: str) -> FloatArray:
    """Finite numbers, from words that follow something else; an InputError shows another word."""
    try:
        values = np.array(list(map(float, words)))
        if b"_" in b"".join(words):
            raise ValueError
    except ValueError:
        found = _offending(words, float)
        said = f"numbers expected after the {after}, not {found!r}{decimal_comma(found)}"
        raise InputError(said) from None
    if not np.isfinite(values).all():
        raise InputError("numbers must be finite")
    return values


def _offending(words: list[bytes], kind: Callable[[bytes], object]) -> str:
    """The first word not of that kind."""
    for word in words:
        try:
            kind(word)
            if b"_" not in word:
                continue
        except ValueError:
            pass
        return shown(word)
    return ""

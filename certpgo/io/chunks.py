"""Text files in chunks, with errors that name the line."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError
from certpgo.io.compressed import opened
from certpgo.io.format import Progress
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import FloatArray, IntArray

T = TypeVar("T")

_CHUNK_BYTES = 8 << 20
#: Longer lines are refused: they are no text, and would be joined again and again.
LONGEST_LINE = 4 << 20
TOO_LONG = f"lines of at most {LONGEST_LINE >> 20} MB expected"
_COMMENT = re.compile(rb"#[^\n]*")
_PRINTED = bytes({*range(32, 256)} - {127}) + b"\t\r\n"


def without_comments(text: bytes) -> bytes:
    """The text without comments, from ``#`` to the end of a line."""
    return _COMMENT.sub(b"", text) if b"#" in text else text


def parsed(
    path: Path, parse: Callable[[bytes], T], progress: Progress | None = None
) -> Iterator[T]:
    """``parse`` applied to each chunk of lines, without comments and the last line end.

    A chunk that fails is parsed again in smaller and smaller parts to locate the line. Lines end in
    LF or CRLF.

    Raises
    ------
    FormatError
        With the line of an InputError of ``parse``, or of a control character, including a carriage
        return within a line.
    """
    for first, text in _chunks(path, progress):
        text = without_comments(text)
        try:
            result = parse(text)
        except InputError as error:
            raise _at_line(path, first, text.split(b"\n"), parse, error) from None
        yield result


def _at_line(
    path: Path,
    first: int,
    lines: list[bytes],
    parse: Callable[[bytes], T],
    error: InputError,
) -> FormatError:
    """The error of the first line that fails, by bisection."""
    while len(lines) > 1:
        half = len(lines) // 2
        try:
            parse(b"\n".join(lines[:half]))
            first, lines = first + half, lines[half:]
        except InputError as nearer:
            lines, error = lines[:half], nearer
    try:
        parse(lines[0])
    except InputError as at_line:
        error = at_line
    return FormatError(path, first, str(error))


def shown(word: bytes) -> str:
    """The beginning of a word for messages, whatever its bytes."""
    return word[:40].decode("ascii", "backslashreplace")


def printable(text: bytes) -> bool:
    """Whether there are no control characters but tabs and line ends."""
    return not text.translate(None, _PRINTED)


def text_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Each line with its number, including comments; FormatError as in `parsed`."""
    for first, text in _chunks(path, None):
        yield from enumerate(text.split(b"\n"), first)


def _chunks(path: Path, progress: Progress | None) -> Iterator[tuple[int, bytes]]:
    """Parts of a file as (number of the first line, lines without the last line end)."""
    total, number = readable(path).stat().st_size, 1
    with opened(path) as file:
        head = file.read(len(BOM_UTF8))
        done, rest = len(head), head.removeprefix(BOM_UTF8)
        while chunk := file.read(_CHUNK_BYTES):
            done = min(done + len(chunk), total)  # of a compressed file more is read
            text = rest + chunk
            end = text.rfind(b"\n") + 1
            whole, rest = text[:end], text[end:]
            if whole:
                _refuse_controls(path, number, whole)
                yield number, whole[:-1]
                number += whole.count(b"\n")
            if len(rest) > LONGEST_LINE:
                raise FormatError(path, number, TOO_LONG)
            if progress is not None:
                progress(done, total)
    if rest:
        _refuse_controls(path, number, rest)
        yield number, rest


def _refuse_controls(path: Path, first: int, text: bytes) -> None:
    """Refuse control characters, which programs read differently, as blanks or line ends.

    The proof checker refuses the same.
    """
    plain = b"\r" not in text or text.count(b"\r") == text.count(b"\r\n")
    if plain and not text.translate(None, _PRINTED):
        return
    for number, line in enumerate(text.replace(b"\r\n", b"\n").split(b"\n"), first):
        for control in line.translate(None, _PRINTED.replace(b"\r", b""))[:1]:
            what = "a carriage return" if control == ord("\r") else f"the character {control:#04x}"
            raise FormatError(path, number, f"{what} within a line: LF or CRLF end lines")


def read_rows(
    path: Path,
    columns: int,
    expected: str,
    convert: Callable[[FloatArray], tuple[FloatArray, ...]],
    progress: Progress | None = None,
    first: Callable[[list[bytes]], NDArray[Any]] | None = None,
) -> tuple[NDArray[Any], ...]:
    """A table of numbers, converted in chunks of rows.

    Parameters
    ----------
    columns : numbers per line
    expected : contents of a line, for the message
    convert : from rows (k, columns) to arrays (k, ...); its InputErrors name the line
    first : from the first words of the rows to an array (k, ...), which then comes first
    """

    def parse(text: bytes) -> tuple[NDArray[Any], ...]:
        rows = rows_of(text)
        converted = convert(floats_of_rows(rows, columns, expected))
        return converted if first is None else (first([words[0] for words in rows]), *converted)

    parts = list(parsed(path, parse, progress))
    if not sum(len(part[0]) for part in parts):
        raise FormatError(path, None, f"no lines of {expected}")
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def rows_of(text: bytes) -> list[list[bytes]]:
    """The words of all lines that are not blank."""
    return [words for line in text.split(b"\n") if (words := line.split())]


def lines_of_rows(path: Path) -> IntArray:
    """The number of each line that is neither blank nor a comment."""
    lines = text_lines(path)
    return np.array([number for number, line in lines if without_comments(line).split()])


def floats_of_rows(rows: list[list[bytes]], columns: int, expected: str) -> FloatArray:
    """The finite numbers (k, columns) in the words of rows.

    Raises
    ------
    InputError
        There is something else; with what was expected, and what it seems to be.
    """
    try:
        table = np.array([float(word) for words in rows for word in words])
        if any(b"_" in word for words in rows for word in words):  # Python reads 1_0 as ten
            raise ValueError
    except ValueError:
        raise InputError(f"{expected} expected{_in_fact(rows)}") from None
    if not {len(words) for words in rows} <= {columns}:
        raise InputError(f"{expected} expected")
    if not np.isfinite(table).all():
        unknown = "; a pose that is not known (NaN) has no line" if np.isnan(table).any() else ""
        raise InputError(f"{expected} expected{unknown}")
    return table.reshape(-1, columns)


def _in_fact(rows: list[list[bytes]]) -> str:
    """What the first words that are no numbers seem to be."""
    texts = (word.decode("utf-8", "replace") for words in rows for word in words)
    word = next((text for text in texts if "," in text), "")
    hint = decimal_comma(word)
    if word.strip(",").count(",") > 1 or (word.endswith(",") and not hint):
        return f"; these are separated by commas ({max(map(len, rows))} columns by blanks)"
    return hint


def decimal_comma(word: str) -> str:
    """A hint for messages about a word that is a number but for its decimal comma; or nothing."""
    try:
        float(word.replace(",", ".", 1))
    except ValueError:
        return ""
    return " (a decimal comma: decimal points expected)" if "," in word else ""


def is_number(word: bytes) -> bool:
    """Whether a word is a number, and so no name."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def first_words(head: bytes) -> list[bytes]:
    """The words of the first line that is not blank, without comments."""
    lines = (line.split() for line in without_comments(head).splitlines())
    return next((words for words in lines if words), [])


def first_row(head: bytes) -> list[float]:
    """The numbers on the first line that is not blank; empty if there is anything else."""
    try:
        return [float(word) for word in first_words(head)]
    except ValueError:
        return []


def whole(numbers: FloatArray) -> FloatArray:
    """The numbers, if all are integers below 2^53; else an InputError."""
    if not ((numbers == np.rint(numbers)) & (np.abs(numbers) < 2.0**53)).all():
        raise InputError("ids must be integers")
    return numbers


def refuse_loops(
    pairs: FloatArray | IntArray, called: Callable[[int], str] = "node {}".format
) -> None:
    """Refuse an edge (i, i) among (k, 2) pairs of ids by an InputError."""
    loop = pairs[:, 0] == pairs[:, 1]
    if loop.any():
        raise InputError(f"{called(int(pairs[np.argmax(loop), 0]))} is measured from itself")

"""Graphs from a pipe, read as their lines come."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from certpgo.errors import FormatError, InputError, InputNotice, NoEdges
from certpgo.graph import Instance
from certpgo.io.chunks import LONGEST_LINE, TOO_LONG
from certpgo.io.format import format_of
from certpgo.io.reading import read

#: Name of the pipe in messages.
NAME = "standard input"


def _warn(sentence: str) -> None:
    warnings.warn(sentence, InputNotice, stacklevel=4)


def piped(
    stream: BinaryIO,
    most: int,
    *,
    name: str = NAME,
    counts: Counter[str] | None = None,
    say: Callable[[str], object] = _warn,
    **options: Any,
) -> Iterator[Instance]:
    r"""The measurements of the lines that have come, as soon as some have; at most ``most`` lines.

    Each piece is read like a file of its own, of the format of the first one. Priors and landmarks
    are left out: they refer to lines elsewhere in a file. So is a last line without an end
    that cannot be read: who wrote it may have been ended there.

    Parameters
    ----------
    stream : with ``read1``, such as ``sys.stdin.buffer``
    name : of the stream in messages
    counts : is given what `Instance.counts` counts, of all pieces so far
    say : is called with a sentence about a last line without an end
    options : those of `certpgo.read`

    Raises
    ------
    FormatError
        As `certpgo.read`, with the line of the stream.
    InputError
        There are nodes of unknown scale.
    NoEdges
        The stream ended without any.

    Examples
    --------
    >>> import io
    >>> from certpgo.io.stream import piped
    >>> lines = "EDGE_SE2 0 1 1 0 0\nEDGE_SE2 1 2 1 0 0\nEDGE_SE2 0 2 2 0 0\n"
    >>> [part.ids.tolist() for part in piped(io.BytesIO(lines.encode()), 2)]
    [[0, 1, 2], [0, 2]]
    """
    chosen: dict[str, Any] = {**options, "priors": False, "landmarks": False, "quiet": True}
    counts = Counter() if counts is None else counts
    form, found = None, False
    with TemporaryDirectory() as folder:
        path = Path(folder) / "piece"
        for number, lines in _pieces(stream, most):
            path.write_bytes(b"".join(lines))
            form = form or format_of(path).name
            # Lines are numbered from the beginning of the stream.
            path.write_bytes(b"\n" * number + b"".join(lines))
            try:
                part = read(path, format=form, **chosen)
            except NoEdges as error:
                counts.update(error.counts)
            except FormatError as error:
                if lines[-1].endswith(b"\n"):
                    raise FormatError(name, error.line, error.expected) from None
                say(f"{name}:{number + 1}: the last line is cut off, and left out")
            else:
                if not lines[-1].endswith(b"\n"):
                    say(f"{name}:{number + 1}: the last line has no end, and may be cut off")
                counts.update(part.counts)
                if part.graph.has_scales:  # each piece has another node whose scale is the unit
                    raise InputError(
                        f"{name}: pieces have no common unit: a file of similarities has"
                    )
                yield part
                found = True
    if not found:
        raise NoEdges(Path(name), None, "no measurements")


def _pieces(stream: BinaryIO, most: int) -> Iterator[tuple[int, list[bytes]]]:
    """Whole lines that have come, and how many came before them; a last one without end alone."""
    number, rest = 0, b""
    while True:
        text = stream.read1()  # type: ignore[attr-defined]
        lines = (rest + text).splitlines(keepends=True)
        rest = lines.pop() if text and lines and not lines[-1].endswith(b"\n") else b""
        for first in range(0, len(lines), most):
            yield number + first, lines[first : first + most]
        number += len(lines)
        if len(rest) > LONGEST_LINE:
            raise FormatError(NAME, number + 1, TOO_LONG)
        if not text:
            return

"""Graphs from a pipe, read as their lines come."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from certpgo.errors import FormatError, NoEdges
from certpgo.graph import Instance
from certpgo.io.chunks import LONGEST_LINE, TOO_LONG
from certpgo.io.format import format_of
from certpgo.io.reading import read

#: Name of the pipe in messages.
NAME = "standard input"


def piped(stream: BinaryIO, most: int, **options: Any) -> Iterator[Instance]:
    r"""The measurements of the lines that have come, as soon as some have; at most ``most`` lines.

    Each piece is read like a file of its own, of the format of the first one. Priors and landmarks
    are left out: they refer to lines elsewhere in a file.

    Parameters
    ----------
    stream : with ``read1``, such as ``sys.stdin.buffer``
    options : those of `certpgo.read`

    Raises
    ------
    FormatError
        As `certpgo.read`, with the line of the stream.
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
    form, found = None, False
    with TemporaryDirectory() as folder:
        path = Path(folder) / NAME
        for number, lines in _pieces(stream, most):
            path.write_bytes(b"".join(lines))
            form = form or format_of(path).name
            # Lines are numbered from the beginning of the stream.
            path.write_bytes(b"\n" * number + b"".join(lines))
            try:
                with suppress(NoEdges):
                    yield read(path, format=form, **chosen)
                    found = True
            except FormatError as error:
                raise FormatError(NAME, error.line, error.expected) from None
    if not found:
        raise NoEdges(Path(NAME), None, "no measurements")


def _pieces(stream: BinaryIO, most: int) -> Iterator[tuple[int, list[bytes]]]:
    """Whole lines that have come, and how many came before them."""
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

"""Files as they are or compressed, which their first bytes tell, and limits on their size."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase, BufferedReader, RawIOBase
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError
from certpgo.io.pipes import readable

_MAGIC = b"\x1f\x8b"
_SUFFIX = ".gz"
#: Archives of graphs expand at most 50 times; adjacency matrices with repeated rows more, up to
#: complete graphs of a thousand nodes, which are small.
RATIO, SMALL = 100, 16 << 20


@contextmanager
def opened(path: Path) -> Iterator[BufferedIOBase]:
    """The content of a file, without its compression.

    Raises
    ------
    FormatError
        It is compressed, and damaged; or it expands out of proportion to its size.
    OSError
        It cannot be read.
    """
    with readable(path).open("rb") as file:
        if not _begins_compressed(file.peek(len(_MAGIC))):
            yield file
            return
        try:
            with gzip.GzipFile(fileobj=file) as content:
                yield BufferedReader(_Bounded(path, content))
        except (EOFError, zlib.error, gzip.BadGzipFile):
            raise FormatError(path, None, "the compressed file is damaged or incomplete") from None


def is_compressed(path: Path) -> bool:
    """Whether a file begins as gzip's do; OSError if it cannot be read."""
    with readable(path).open("rb") as file:
        return _begins_compressed(file.peek(len(_MAGIC)))


def uncompressed_name(path: Path) -> Path:
    """The path without the suffix of compression."""
    return path.with_suffix("") if path.suffix == _SUFFIX else path


def largest(path: Path) -> int:
    """The largest allowed size of a decompressed file, bytes."""
    return max(RATIO * readable(path).stat().st_size, SMALL)


def refuse_bombs(path: Path, size: int) -> None:
    """Refuse a file that claims to expand to ``size`` bytes, if that is disproportionate."""
    if size > largest(path):
        raise FormatError(path, None, f"expands to {size >> 20} MB, out of proportion to its size")


class _Bounded(RawIOBase):
    """What a compressed file contains, up to the largest allowed size."""

    def __init__(self, path: Path, content: gzip.GzipFile) -> None:
        self._path, self._content, self._done = path, content, 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        count = self._content.readinto(buffer)
        self._done += count
        refuse_bombs(self._path, self._done)
        return count


def _begins_compressed(head: bytes) -> bool:
    return head.startswith(_MAGIC)

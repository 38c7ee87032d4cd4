"""Limits on the size of decompressed files."""

from __future__ import annotations

from pathlib import Path

from certpgo.errors import FormatError

#: Archives of graphs expand at most 50 times; adjacency matrices with repeated rows more, up to
#: complete graphs of a thousand nodes, which are small.
RATIO, SMALL = 100, 16 << 20


def largest(path: Path) -> int:
    """The largest allowed size of a decompressed file, bytes."""
    return max(RATIO * path.stat().st_size, SMALL)


def refuse_bombs(path: Path, size: int) -> None:
    """Refuse a file that claims to expand to ``size`` bytes, if that is disproportionate."""
    if size > largest(path):
        raise FormatError(path, None, f"expands to {size >> 20} MB, out of proportion to its size")

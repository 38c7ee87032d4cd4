"""How large a compressed file may become when it is read."""

from __future__ import annotations

from pathlib import Path

from certpgo.errors import FormatError

#: Archives of graphs expand at most some 50 times; adjacency matrices further where rows repeat,
#: up to complete graphs of a thousand nodes, which are small.
RATIO, SMALL = 100, 16 << 20


def largest(path: Path) -> int:
    """Bytes that what is compressed in a file may expand to."""
    return max(RATIO * path.stat().st_size, SMALL)


def refuse_bombs(path: Path, size: int) -> None:
    """Refuse a file that says it expands to ``size`` bytes, where that is out of proportion.

    Raises
    ------
    FormatError
        It is.
    """
    if size > largest(path):
        raise FormatError(path, None, f"expands to {size >> 20} MB, out of proportion to its size")

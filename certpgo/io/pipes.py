"""Pipes in place of files: they give their content once, and files are read several times."""

from __future__ import annotations

import os
import shutil
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from certpgo.errors import FormatError

#: Copies of what came through pipes, by device and inode, while `pipes_kept` is active.
_copies: dict[tuple[int, int], Path] = {}
_folder: list[Path] = []
_one_at_a_time = threading.Lock()


@contextmanager
def pipes_kept() -> Iterator[None]:
    """Let pipes be read as files during the block, which is short: a pipe may have a next content.

    Named pipes, ``/dev/stdin``, and what shells make of ``<(...)``.
    """
    if _folder:
        yield
        return
    with TemporaryDirectory(prefix="certpgo-") as folder:
        _folder.append(Path(folder))
        try:
            yield
        finally:
            _folder.clear()
            _copies.clear()


def is_pipe(path: Path) -> bool:
    """Whether a path leads to a pipe."""
    try:
        return stat.S_ISFIFO(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def readable(path: Path) -> Path:
    """Where the content of a file can be read again and again: of a pipe, the copy of it.

    Raises
    ------
    FormatError
        It is a pipe, outside `pipes_kept`, or a device.
    OSError
        The pipe cannot be read.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):  # who opens it says why
        return path
    if stat.S_ISCHR(found.st_mode) and not path.samefile(os.devnull):
        raise FormatError(path, None, "a file or a pipe expected, not a device")
    if not stat.S_ISFIFO(found.st_mode):
        return path
    if not _folder:
        raise FormatError(path, None, "a pipe, which can be read only once: a file expected")
    key = found.st_dev, found.st_ino
    with _one_at_a_time:
        if key not in _copies:
            copy = _folder[0] / str(len(_copies))
            with path.open("rb") as pipe, copy.open("wb") as file:
                shutil.copyfileobj(pipe, file)
            _copies[key] = copy
        return _copies[key]

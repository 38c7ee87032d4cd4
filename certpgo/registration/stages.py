"""Stages of a long computation: over threads, with progress, and kept on disk by content."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputNotice
from certpgo.io.archives import arrays_in
from certpgo.io.writing import atomically, folder_to_write
from certpgo.solve.many import results_of

#: Raised when what a stage computes changes: older results are not read.
VERSION = 3

Item = TypeVar("Item")
Result = TypeVar("Result")
#: Is told the stage, how many of its items are done, and how many there are.
Progress = Callable[[str, int, int], object]
Arrays = dict[str, NDArray[Any]]


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def each(
    stage: str, work: Callable[[Item], Result], items: Sequence[Item], progress: Progress
) -> list[Result]:
    """The results of ``work`` for all items, in their order, by threads; Ctrl-C ends it."""
    results: list[Result] = []
    progress(stage, 0, len(items))
    for result in results_of(lambda item, _: work(item), items):
        results.append(result)
        progress(stage, len(results), len(items))
    return results


class Cache:
    """Results by what they were computed from; a folder, or nothing at all.

    Parameters
    ----------
    folder : where to keep results, made if necessary; None to keep none

    Raises
    ------
    InputError
        The folder cannot be made.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = None if folder is None else folder_to_write(folder)

    def arrays(self, key: Iterable[object], make: Callable[[], Arrays]) -> Arrays:
        """What ``make`` returns, read where it was kept before under this key."""
        if self.folder is None:
            return make()
        path = self.folder / f"{digest(VERSION, *key)}.npz"
        if path.exists():
            try:
                return arrays_in(path)
            except FormatError as error:
                warnings.warn(f"{error}; it is made again", InputNotice, stacklevel=2)
        made = make()
        atomically(path, lambda temporary: _save(temporary, made))
        return made


#: Keeps nothing.
UNKEPT = Cache(None)


def _save(path: Path, arrays: Arrays) -> None:
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def digest(*parts: object) -> str:
    """A name for the content of parts, which have a repr of their values."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def user_cache() -> Path:
    """The folder in which the command keeps results."""
    import platformdirs

    return Path(platformdirs.user_cache_dir("certpgo")) / "frames"

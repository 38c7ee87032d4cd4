"""Where outputs go; those that cannot be written, or replace an input, are refused at once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.datasets.source import Source
    from certpgo.graph import Instance


def refuse_unwritable(out: Path | None) -> None:
    """Refuse an output whose folder is missing or not writable, or that is a folder itself.

    Raises
    ------
    InputError
        There is no such folder, it cannot be written to, or the output is a folder.
    """
    from certpgo.io.writing import is_stream

    if out is None:
        return
    if out.is_dir():
        raise InputError(f"{out}: cannot be written: it is a folder")
    folder = Path(os.path.realpath(out)).parent
    if is_stream(out):  # written to, so its folder need not be
        writable = os.access(out, os.W_OK)
    else:
        writable = folder.is_dir() and os.access(folder, os.W_OK)
    if not writable:
        raise InputError(f"{out}: cannot be written: no such folder, or no write permission")


def refuse_overwriting(
    outputs: Iterable[Path | None],
    inputs: Iterable[Source | str | Path | None],
    data: Path | None = None,
) -> None:
    """Refuse to overwrite a file that is read.

    Parameters
    ----------
    outputs : files to write, or None
    inputs : files, folders or dataset names to read, or None
    data : folder to search for datasets first

    Raises
    ------
    InputError
        An output is also an input, under any path, or is named twice.
    """
    written = [out for out in outputs if out is not None]
    for k, out in enumerate(written):
        if any(_is_same(out, earlier) for earlier in written[:k]):
            raise InputError(f"{out}: given for two outputs; one would overwrite the other")
    read = [path for source in inputs if written and source for path in _files(source, data)]
    for out in written:
        for path in read:
            if _is_same(out, path):
                raise InputError(f"{out}: is also an input, and would be overwritten")


def _files(source: Source | str | Path, data: Path | None) -> Iterator[Path]:
    from certpgo.datasets.source import resolve

    if isinstance(source, str):
        try:
            source = resolve(source, data)
        except InputError:
            return  # neither a file nor a dataset; reported when it is read
    path = source if isinstance(source, Path) else source.found
    if path is not None:
        yield from path.iterdir() if path.is_dir() else (path,)


def _is_same(a: Path, b: Path) -> bool:
    return a.resolve() == b.resolve() or (a.exists() and b.exists() and a.samefile(b))


def targets_of(out: Path | None, parts: Sequence[Instance]) -> list[Path | None]:
    """The file of each part; several parts get one each, named by their smallest ids."""
    if out is None or len(parts) == 1:
        return [out] * len(parts)
    return [out.with_stem(f"{out.stem}-{int(part.ids.min())}") for part in parts]

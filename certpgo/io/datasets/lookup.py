"""Finding and downloading dataset files."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path

from certpgo.errors import FileNotHere, InputError, MissingDependency, how_to_install
from certpgo.io.datasets.catalogue import Entry

#: Environment variable naming a data folder.
DATA_VARIABLE = "CERTPGO_DATA"
#: Most bytes of a download whose size the catalogue does not state, bytes at a time, and seconds
#: without any until it fails.
MOST, CHUNK, TIMEOUT = 1 << 26, 1 << 16, 30.0


def places(data: str | Path | None) -> dict[str, Path]:
    """The folders to search, in order: argument, environment, cache, gtsam's wheel."""
    found: dict[str, Path] = {}
    if data is not None:
        found["the data folder"] = Path(data)
        if not found["the data folder"].is_dir():
            raise InputError(f"{data}: no such folder")
    if variable := os.environ.get(DATA_VARIABLE):
        found[DATA_VARIABLE] = Path(variable)
        if not found[DATA_VARIABLE].is_dir():
            raise InputError(f"{variable}: no such folder ({DATA_VARIABLE})")
    found["the cache"] = cache_folder()
    wheel = importlib.util.find_spec("gtsam")
    if wheel is not None and wheel.origin is not None:
        found["the gtsam wheel"] = Path(wheel.origin).parent / "Data"
    return found


def cache_folder() -> Path:
    """The user's cache for downloads."""
    import platformdirs

    return Path(platformdirs.user_cache_dir("certpgo"))


def find(entry: Entry, data: str | Path | None) -> Path | None:
    """The first file with the entry's name and checksum, or None."""
    return next(filter(entry.agrees, _namesakes(entry, data)), None)


def missing(entry: Entry, data: str | Path | None) -> FileNotHere:
    """The error for a missing file: folders searched, and files with wrong checksums."""
    where = ", ".join(f"{place} ({folder})" for place, folder in places(data).items())
    others = _namesakes(entry, data)
    wrong = "".join(f"; {path} is another file (its checksum differs)" for path in others)
    return FileNotHere(f"{entry.name}: {entry.filename} is not in {where}{wrong}; {_remedy(entry)}")


def _namesakes(entry: Entry, data: str | Path | None) -> Iterator[Path]:
    """The files with the entry's name, in the order of `places`."""
    for folder in places(data).values():
        yield from filter(Path.is_file, sorted(folder.rglob(entry.filename)))


def download(entry: Entry) -> Path:
    """Download the file into the cache.

    Raises
    ------
    InputError
        The download failed or is larger than stated, or its checksum differs.
    """
    try:
        import pooch
    except ImportError:
        raise MissingDependency("pooch, which downloads files,", "downloads") from None
    target = cache_folder() / entry.file
    target.unlink(missing_ok=True)  # a file with a wrong checksum
    pooch.get_logger().setLevel("WARNING")
    try:
        path = Path(
            pooch.retrieve(
                entry.url,
                known_hash=None,
                fname=target.name,
                path=target.parent,
                downloader=_at_most(entry),
            )
        )
    except OSError as error:  # includes network errors
        reason = str(error).partition("\n")[0].partition(" (Caused by")[0]
        reason = "no connection" if "Max retries" in reason else reason
        raise InputError(
            f"{entry.name}: its file is not here, and the download of {entry.url} failed "
            f"({reason}); set --data or CERTPGO_DATA to a folder that contains it"
        ) from error
    if not entry.agrees(path):
        path.unlink()
        raise InputError(f"{entry.name}: {entry.url} is another file (its checksum differs)")
    return path


def _at_most(entry: Entry) -> Callable[[str, str, object], None]:
    """What downloads a file for pooch, of no more bytes than stated, or `MOST` if none are."""
    most = MOST if entry.bytes is None else entry.bytes

    def download(url: str, out: str, pooch: object) -> None:
        import requests  # which pooch needs

        size = 0
        with requests.get(url, stream=True, timeout=TIMEOUT) as response, open(out, "wb") as file:
            response.raise_for_status()
            for chunk in response.iter_content(CHUNK):
                size += len(chunk)
                if size > most:
                    raise InputError(f"{entry.name}: {url} has more than the {most} bytes expected")
                file.write(chunk)

    return download


def _remedy(entry: Entry) -> str:
    if entry.url is not None:
        return f"it can be downloaded from {entry.url}"
    if entry.origin == "gtsam wheel":
        return f"the GTSAM wheel has it: {how_to_install('baselines')}"
    return f"it is derived and has no download address: set {DATA_VARIABLE} to its folder"

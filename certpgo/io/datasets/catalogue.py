"""The catalogue of named files: origin, checksum, counts and licence of each.

The list is ``catalogue.csv``, next to this module. The package contains none of the files.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any

from certpgo.errors import SpecError

#: Contents of files: a measurement graph, the topology of one, ground truth, another solver's
#: iterate, or lists of names and inliers.
KINDS = ("graph", "adjacency", "truth", "iterate", "labels")


@dataclass(frozen=True, slots=True)
class Entry:
    """One named file.

    Attributes
    ----------
    name : its name
    kind : one of `KINDS`
    d : dimension of space
    file : its path below a data folder, of which only the last part is searched
    origin : ``OWNER/REPOSITORY`` on GitHub, ``"derived"`` or ``"gtsam wheel"``
    commit, path : in the origin
    checksum : ``"sha256:..."``, or ``"git:..."`` if only git's blob hash is known
    bytes : size, or None if unknown
    nodes, edges : counts, or None if not applicable
    truth : name of the entry with the ground truth, or empty
    licence : as stated by the origin
    weights_are : what the numbers of a measurement's precision are, if not its information
    """

    name: str
    kind: str
    d: int
    file: str
    origin: str
    commit: str
    path: str
    checksum: str
    bytes: int | None
    nodes: int | None
    edges: int | None
    truth: str
    licence: str
    weights_are: str = ""

    @property
    def filename(self) -> str:
        """Last part of the file's path."""
        return PurePosixPath(self.file).name

    @property
    def url(self) -> str | None:
        """Download address; None for files that are not in a repository."""
        if "/" not in self.origin:
            return None
        return f"https://raw.githubusercontent.com/{self.origin}/{self.commit}/{self.path}"

    def agrees(self, path: Path) -> bool:
        """Whether the file at ``path`` is this one, byte for byte."""
        size = path.stat().st_size
        if self.bytes is not None and size != self.bytes:
            return False
        kind, _, digest = self.checksum.partition(":")
        if kind == "git":
            blob = hashlib.sha1(b"blob %d\0" % size, usedforsecurity=False)
            blob.update(path.read_bytes())
            return blob.hexdigest() == digest
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest() == digest


@cache
def entries() -> dict[str, Entry]:
    """Every entry by name."""
    text = Path(__file__).with_name("catalogue.csv").read_text(encoding="utf-8")
    return {row["name"]: _entry(row) for row in csv.DictReader(text.splitlines())}


def names(kind: str | None = None) -> tuple[str, ...]:
    """Names of the catalogue's entries: all, or those of one kind (``"graph"``, ...)."""
    if kind is not None and kind not in KINDS:
        raise SpecError.unknown("kind of dataset", kind, KINDS)
    return tuple(e.name for e in entries().values() if kind in (None, e.kind))


def entry(name: str) -> Entry:
    """The entry or the file called ``name``; SpecError if there is none."""
    known = entries()
    if name in known:
        return known[name]
    same = [e for e in known.values() if e.filename == name]
    if len(same) != 1:
        near = difflib.get_close_matches(name, sorted(known), n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else "see certpgo list datasets"
        raise SpecError(f"unknown dataset {name!r}; {hint}")
    return same[0]


def _entry(row: dict[str, Any]) -> Entry:
    counts = {name: int(row[name]) if row[name] else None for name in ("bytes", "nodes", "edges")}
    return Entry(**{**row, **counts, "d": int(row["d"])})

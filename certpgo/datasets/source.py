"""A path or the name of a dataset, resolved once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from certpgo import datasets, io
from certpgo.errors import InputError, SpecError, nearest
from certpgo.graph import Instance


@dataclass(frozen=True)
class Source:
    """A file, or a dataset of the catalogue; see `resolve`.

    Attributes
    ----------
    name : as given by the user
    is_file : whether it is the path of a file
    data : folder to search first for datasets
    """

    name: str
    is_file: bool
    data: Path | None = None

    @property
    def hides_dataset(self) -> bool:
        """Whether it is a file whose path is also the name of a dataset."""
        return self.is_file and self.name in datasets.names()

    @cached_property
    def found(self) -> Path | None:
        """The local file, or None; searched only once."""
        return Path(self.name) if self.is_file else datasets.find(self.name, self.data)

    @property
    def is_here(self) -> bool:
        """Whether no download is needed."""
        return self.found is not None

    def path(self) -> Path:
        """The local file, downloaded if necessary."""
        return self.found or datasets.fetch(self.name, self.data)

    def graph(self, *, download: bool = True, **reading: Any) -> Instance:
        """The graph, with the dataset's ground truth if that is found.

        Parameters
        ----------
        download : whether to download a missing file
        **reading : options of `certpgo.io.read`
        """
        if self.is_file:
            return io.read(self.name, **reading)
        if self.found is None:
            return datasets.load(self.name, self.data, download=download, **reading)
        return datasets.load_file(self.name, self.found, self.data, **reading)


def resolve(name: str, data: Path | None = None) -> Source:
    """The file at a path, otherwise the dataset of that name; InputError if neither exists."""
    if not name:
        raise InputError("a file or dataset expected, not an empty name")
    if Path(name).exists():
        return Source(name, is_file=True, data=data)
    try:
        datasets.entry(name)
    except SpecError:
        near = nearest(name, datasets.names("graph"))
        hint = f"did you mean {' or '.join(near)}?" if near else "see certpgo list datasets"
        raise InputError(f"{name}: no such file or dataset; {hint}") from None
    return Source(name, is_file=False, data=data)

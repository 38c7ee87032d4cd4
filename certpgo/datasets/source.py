"""What a user calls a graph or an estimate, a path or a dataset's name, resolved once."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from certpgo import datasets, io
from certpgo.errors import InputError, SpecError
from certpgo.graph import Instance


@dataclass(frozen=True)
class Source:
    """A file, or a dataset of the catalogue; see `resolve`.

    Attributes
    ----------
    name : as the user gave it
    is_file : whether it is the path of a file
    data : folder to look for datasets in first
    """

    name: str
    is_file: bool
    data: Path | None = None

    @cached_property
    def found(self) -> Path | None:
        """The local file, or None: it is looked for once."""
        return Path(self.name) if self.is_file else datasets.find(self.name, self.data)

    @property
    def is_here(self) -> bool:
        """Whether it needs no download."""
        return self.found is not None

    def path(self) -> Path:
        """The local file, downloaded if need be.

        Raises
        ------
        InputError
            The file is nowhere, or the download failed.
        """
        return self.found or datasets.fetch(self.name, self.data)

    def graph(self, *, download: bool = True, **reading: Any) -> Instance:
        """The graph, with the dataset's ground truth where that is here.

        Parameters
        ----------
        download : whether to download a file that is not here
        **reading : options of `certpgo.io.read`

        Raises
        ------
        InputError
            It is nowhere, is no graph, or cannot be read.
        """
        if self.is_file:
            return io.read(self.name, **reading)
        if self.found is None:
            return datasets.load(self.name, self.data, download=download, **reading)
        return datasets.load_file(self.name, self.found, self.data, **reading)


def resolve(name: str, data: Path | None = None) -> Source:
    """The file at a path, or else the dataset of that name.

    Raises
    ------
    InputError
        Neither exists, with the nearest names of datasets.
    """
    if Path(name).exists():
        return Source(name, is_file=True, data=data)
    try:
        datasets.entry(name)
    except SpecError:
        near = difflib.get_close_matches(name, datasets.names("graph"), n=3, cutoff=0.6)
        hint = f"did you mean {' or '.join(near)}?" if near else "see certpgo list datasets"
        raise InputError(f"{name}: no such file or dataset; {hint}") from None
    return Source(name, is_file=False, data=data)

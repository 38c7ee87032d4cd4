"""What a user names: a file, or a dataset of the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from certpgo import io
from certpgo.errors import InputError, SpecError, nearest
from certpgo.io.datasets import lookup
from certpgo.io.datasets.catalogue import Entry, entries, entry, names

if TYPE_CHECKING:
    from certpgo.graph import Estimate, Instance
    from certpgo.linalg.arrays import BoolArray, IntArray


@dataclass(frozen=True)
class Source:
    """A file, by its path; see `resolve`."""

    name: str

    @property
    def found(self) -> Path | None:
        """The local file, or None."""
        return Path(self.name)

    @property
    def hides_dataset(self) -> bool:
        """Whether it is a file whose path is also the name of a dataset."""
        return self.name in entries()

    @property
    def origin(self) -> str:
        """Where a dataset is from, ``OWNER/REPOSITORY@COMMIT:PATH``; empty for other files."""
        return ""

    def path(self, *, download: bool = True) -> Path:
        """The local file, downloaded if necessary and allowed.

        Raises
        ------
        InputError
            The file is missing (with the folders searched), or the download failed.
        """
        return Path(self.name)

    def graph(
        self, *, download: bool = True, also: Sequence[Path] = (), **reading: Any
    ) -> Instance:
        """The graph, with its outliers and its ground truth of all nodes, if found.

        Parameters
        ----------
        download : whether to download a missing file
        also : further files that are read as one graph with it
        **reading : options of `certpgo.io.read`

        Raises
        ------
        InputError
            The file is missing, is not a graph, or cannot be read.
        """
        return io.read([self.name, *also], **reading)

    def truth(self, instance: Instance) -> tuple[IntArray, Estimate] | None:
        """Ground truth that is in another local file, or None: nodes and their poses.

        See `certpgo.io.read_truth`.
        """
        return None


@dataclass(frozen=True)
class Dataset(Source):
    """A file of the catalogue, which is searched in the folder ``data`` first."""

    entry: Entry
    data: str | Path | None = None

    #: It is the dataset.
    hides_dataset = False

    @property
    def origin(self) -> str:
        """Where it is from, as of a `Source`; a word where it is in no repository."""
        entry = self.entry
        return f"{entry.origin}@{entry.commit[:12]}:{entry.path}" if entry.url else entry.origin

    @cached_property
    def found(self) -> Path | None:
        """The local file, or None; searched only once."""
        return lookup.find(self.entry, self.data)

    @cached_property
    def _downloaded(self) -> Path:
        return lookup.download(self.entry)

    def path(self, *, download: bool = True) -> Path:
        """The local file, as of a `Source`; downloaded only once."""
        if self.found is not None:
            return self.found
        if download and self.entry.url is not None:
            return self._downloaded
        raise lookup.missing(self.entry, self.data)

    def graph(
        self, *, download: bool = True, also: Sequence[Path] = (), **reading: Any
    ) -> Instance:
        """The graph, as of a `Source`."""
        kind = self.entry.kind
        if kind not in ("graph", "adjacency"):
            raise InputError(f"{self.name} holds no graph but {kind}; fetch returns its path")
        reading["weights_are"] = reading.get("weights_are") or self.entry.weights_are or None
        instance = io.read([self.path(download=download), *also], **reading)
        if also:
            return instance
        instance = replace(instance, name=self.entry.name, outliers=self._outliers(instance))
        known = None if instance.truth is not None else self.truth(instance)
        if known is None or len(known[0]) < instance.graph.num_nodes:
            return instance
        return replace(instance, truth=known[1])

    def truth(self, instance: Instance) -> tuple[IntArray, Estimate] | None:
        """The dataset's ground truth, as of a `Source`."""
        path = self._other(self.entry.truth)
        return None if path is None else io.read_truth(path, instance)

    def _outliers(self, instance: Instance) -> BoolArray | None:
        """(m,) outliers according to the dataset's labels; None without labels."""
        from xml.etree import ElementTree

        import numpy as np

        path = self._other(f"{self.entry.name}_labels")
        if path is None or instance.graph.num_edges != self.entry.edges:
            return None
        outliers = np.zeros(instance.graph.num_edges, dtype=bool)
        # Loop closures by line number from 1.
        found = ElementTree.parse(path).iter("outlier_lc_indices")
        outliers[np.array([int(line.text or "") for line in found], dtype=np.intp) - 1] = True
        return outliers

    def _other(self, name: str) -> Path | None:
        """The local file of another entry of the catalogue; None if there is no such entry."""
        other = entries().get(name)
        return None if other is None else lookup.find(other, self.data)


def resolve(name: str, data: str | Path | None = None) -> Source:
    """The file at a path, otherwise the dataset of that name; InputError if neither exists."""
    if not name:
        raise InputError("a file or dataset expected, not an empty name")
    if Path(name).exists():
        return Source(name)
    try:
        return dataset(name, data)
    except SpecError:
        near = [*_near_files(Path(name)), *nearest(name, names("graph"))][:3]
        hint = f"did you mean {' or '.join(near)}?" if near else "see certpgo list datasets"
        if name == "-":
            hint = "a pipe is /dev/stdin"
        raise InputError(f"{name}: no such file or dataset; {hint}") from None


def _near_files(path: Path) -> list[str]:
    """Files of the same folder with a similar name, or with that name and another suffix."""
    if not path.name or not path.parent.is_dir():
        return []
    here = [p.name for p in path.parent.iterdir() if p.is_file()]
    stem = [name for name in here if Path(name).stem.lower() == path.stem.lower()]
    near = dict.fromkeys([*stem, *nearest(path.name, here)])
    return [str(path.parent / name) for name in near]


def dataset(name: str, data: str | Path | None = None) -> Dataset:
    """The dataset with this name or file name, whatever files there are; SpecError if none."""
    return Dataset(name, entry(name), data)

"""Named datasets, found by file name and checksum, and synthetic families.

A file is searched in the given folder, then in the folder named by the environment variable
``CERTPGO_DATA``, the user's cache and the gtsam wheel, and downloaded if it has an address. Folders
are searched recursively by file name and checksum. An unknown name is a SpecError.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from certpgo.datasets import lookup
from certpgo.datasets.catalogue import KINDS, Entry, entries, entry
from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate, Instance
from certpgo.linalg.arrays import BoolArray, IntArray

__all__ = ["Entry", "entry", "fetch", "find", "load", "names", "truth"]


def names(kind: str | None = None) -> tuple[str, ...]:
    """Names of the catalogue's entries: all, or those of one kind (``"graph"``, ...)."""
    if kind is not None and kind not in KINDS:
        raise SpecError.unknown("kind of dataset", kind, KINDS)
    return tuple(e.name for e in entries().values() if kind in (None, e.kind))


def find(name: str, data: str | Path | None = None) -> Path | None:
    """The local file of the dataset, or None; never downloads."""
    path, _ = lookup.search(entry(name), lookup.places(data).values())
    return path


def fetch(name: str, data: str | Path | None = None, *, download: bool = True) -> Path:
    """The file of the dataset, downloaded into the user's cache if necessary.

    Parameters
    ----------
    data : folder to search first
    download : whether to download

    Raises
    ------
    InputError
        The file is missing (with the folders searched), or the download failed.
    """
    dataset, folders = entry(name), lookup.places(data)
    path, others = lookup.search(dataset, folders.values())
    if path is not None:
        return path
    if download and dataset.url is not None:
        return lookup.download(dataset)
    raise lookup.missing(dataset, folders, others)


def load(
    name: str, data: str | Path | None = None, *, download: bool = True, **options: Any
) -> Instance:
    """Read the dataset, with its outliers and its ground truth of all nodes, if found.

    Parameters
    ----------
    data : folder to search first
    download : whether to download a missing file
    **options : reading options, see `certpgo.io.read`

    Raises
    ------
    InputError
        The file is missing, is not a graph, or cannot be read.
    """
    _require_graph(name)
    return load_file(name, fetch(name, data, download=download), data, **options)


def load_file(name: str, path: Path, data: str | Path | None = None, **options: Any) -> Instance:
    """`load` for a file that was already found."""
    from certpgo import io

    dataset = _require_graph(name)
    options["weights_are"] = options.get("weights_are") or dataset.weights_are or None
    instance = replace(io.read(path, **options), name=dataset.name)
    instance = replace(instance, outliers=_outliers(dataset, instance, data))
    known = None if instance.truth is not None else truth(name, instance, data)
    if known is None or len(known[0]) < instance.graph.num_nodes:
        return instance
    return replace(instance, truth=known[1])


def _require_graph(name: str) -> Entry:
    dataset = entry(name)
    if dataset.kind not in ("graph", "adjacency"):
        raise InputError(f"{name} holds no graph but {dataset.kind}; fetch returns its path")
    return dataset


def truth(
    name: str, instance: Instance, data: str | Path | None = None
) -> tuple[IntArray, Estimate] | None:
    """The dataset's ground truth from a local file, or None: nodes and their poses.

    See `certpgo.io.read_truth`.
    """
    dataset = entry(name)
    path = find(dataset.truth, data) if dataset.truth else None
    if path is None:
        return None
    from certpgo import io

    return io.read_truth(path, instance)


def _outliers(dataset: Entry, instance: Instance, data: str | Path | None) -> BoolArray | None:
    """(m,) outliers according to the dataset's labels; None without labels."""
    labels = f"{dataset.name}_labels"
    if labels not in names("labels"):
        return None
    path = find(labels, data)
    if path is None or instance.graph.num_edges != dataset.edges:
        return None
    outliers = np.zeros(instance.graph.num_edges, dtype=bool)
    # Loop closures by line number from 1.
    found = ElementTree.parse(path).iter("outlier_lc_indices")
    outliers[np.array([int(line.text or "") for line in found], dtype=np.intp) - 1] = True
    return outliers

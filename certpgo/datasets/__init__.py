"""Named real files, found by name and checksum, and synthetic families.

A file is looked for in the folder given, then in the folder that the environment variable
``CERTPGO_DATA`` names, the user's cache and the gtsam wheel, and downloaded where it has an
address. Folders are searched recursively by file name; the checksum decides.
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
    """Names of the catalogue's entries: all, or those of one kind (``"graph"``, ...).

    Raises
    ------
    SpecError
        The kind is unknown.
    """
    if kind is not None and kind not in KINDS:
        raise SpecError.unknown("kind of dataset", kind, KINDS)
    return tuple(e.name for e in entries().values() if kind in (None, e.kind))


def find(name: str, data: str | Path | None = None) -> Path | None:
    """The local file of the dataset, or None; never downloads.

    Raises
    ------
    SpecError
        The name is unknown.
    InputError
        ``data`` is no folder.
    """
    path, _ = lookup.search(entry(name), lookup.places(data).values())
    return path


def fetch(name: str, data: str | Path | None = None, *, download: bool = True) -> Path:
    """The file of the dataset, downloaded into the user's cache when it is not here.

    Parameters
    ----------
    data : folder to look in first
    download : whether to download

    Raises
    ------
    SpecError
        The name is unknown.
    InputError
        The file is nowhere (the places are named), or the download failed.
    """
    wanted, folders = entry(name), lookup.places(data)
    path, others = lookup.search(wanted, folders.values())
    if path is not None:
        return path
    if download and wanted.url is not None:
        return lookup.download(wanted)
    raise lookup.missing(wanted, folders, others)


def load(
    name: str, data: str | Path | None = None, *, download: bool = True, **options: Any
) -> Instance:
    """Read the dataset, with its ground truth where that is here too and covers every node.

    Where a file says which of its edges are wrong, and all were read, that comes along.

    Parameters
    ----------
    data : folder to look in first
    download : whether to download a file that is not here
    **options : reading options, see `certpgo.io.read`

    Raises
    ------
    SpecError
        The name is unknown.
    InputError
        The file is nowhere, is no graph, or cannot be read.
    """
    _require_graph(name)
    return load_file(name, fetch(name, data, download=download), data, **options)


def load_file(name: str, path: Path, data: str | Path | None = None, **options: Any) -> Instance:
    """`load` where the dataset's file has been found already."""
    from certpgo import io

    wanted = _require_graph(name)
    instance = replace(io.read(path, **options), name=wanted.name)
    instance = replace(instance, outliers=_outliers(wanted, instance, data))
    known = None if instance.truth is not None else truth(name, instance, data)
    if known is None or len(known[0]) < instance.graph.num_nodes:
        return instance
    return replace(instance, truth=known[1])


def _require_graph(name: str) -> Entry:
    wanted = entry(name)
    if wanted.kind not in ("graph", "adjacency"):
        raise InputError(f"{name} holds no graph but {wanted.kind}; fetch gives its path")
    return wanted


def truth(
    name: str, instance: Instance, data: str | Path | None = None
) -> tuple[IntArray, Estimate] | None:
    """The dataset's ground truth from a local file: the nodes covered, and their poses.

    None when there is none, or its file is not here. See `certpgo.io.read_truth`.

    Raises
    ------
    SpecError
        The name is unknown.
    InputError
        The file cannot be read, or is another graph's.
    """
    wanted = entry(name)
    path = find(wanted.truth, data) if wanted.truth else None
    if path is None:
        return None
    from certpgo import io

    return io.read_truth(path, instance)


def _outliers(wanted: Entry, instance: Instance, data: str | Path | None) -> BoolArray | None:
    """(m,) True at the edges that the dataset's labels call wrong; None without labels."""
    labels = f"{wanted.name}_labels"
    if labels not in names("labels"):
        return None
    path = find(labels, data)
    if path is None or instance.graph.num_edges != wanted.edges:
        return None
    wrong = np.zeros(instance.graph.num_edges, dtype=bool)
    # Loop closures by their line, counted from 1.
    found = ElementTree.parse(path).iter("outlier_lc_indices")
    wrong[np.array([int(line.text or "") for line in found], dtype=np.intp) - 1] = True
    return wrong

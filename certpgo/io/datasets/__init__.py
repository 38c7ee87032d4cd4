"""Named datasets, found by file name and checksum, and synthetic families.

A file is searched in the given folder, then in the folder named by the environment variable
``CERTPGO_DATA``, the user's cache and the gtsam wheel, and downloaded if it has an address. Folders
are searched recursively by file name and checksum. An unknown name is a SpecError.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from certpgo.io.datasets.catalogue import Entry, entry, names
from certpgo.io.datasets.source import dataset

if TYPE_CHECKING:
    from certpgo.graph import Estimate, Instance
    from certpgo.linalg.arrays import IntArray

__all__ = ["Entry", "entry", "fetch", "find", "load", "names", "truth"]


def find(name: str, data: str | Path | None = None) -> Path | None:
    """The local file of the dataset, or None; never downloads."""
    return dataset(name, data).found


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
    return dataset(name, data).path(download=download)


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
    return dataset(name, data).graph(download=download, **options)


def truth(
    name: str, instance: Instance, data: str | Path | None = None
) -> tuple[IntArray, Estimate] | None:
    """The dataset's ground truth from a local file, or None: nodes and their poses.

    See `certpgo.io.read_truth`.
    """
    return dataset(name, data).truth(instance)

"""What functions are given: objects, or the paths of files that hold them."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.errors import InputError, InputNotice, kind_of
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.estimates import posed_as, read_estimate
from certpgo.io.format import AnyPath
from certpgo.io.reading import read

__all__ = ["AnyPath", "as_instance", "estimated", "measured"]


def measured(given: Any) -> Any:
    """The instance in the file at a path, or in the files at several; anything else as it is.

    Raises
    ------
    FormatError
        As `certpgo.read`.
    """
    several = isinstance(given, list | tuple) and bool(given) and all(map(_is_path, given))
    if not several and not _is_path(given):
        return given
    instance = read([Path(one) for one in (given if several else [given])], quiet=True)
    for notice in instance.notices:  # to the caller of who opens it
        warnings.warn(f"{instance.source}: {notice}", InputNotice, stacklevel=3)
    return instance


def as_instance(given: Any, taker: str, name: str = "graph") -> Instance:
    """The instance of a graph, which is called ``name``, of an instance or of a path.

    Parameters
    ----------
    taker : what takes one of these, for the message that refuses anything else

    Raises
    ------
    FormatError
        As `certpgo.read`.
    InputError
        It is something else.
    """
    posed = measured(given)
    if isinstance(posed, Graph):
        return Instance(name, posed, np.arange(posed.num_nodes))
    if not isinstance(posed, Instance):
        raise InputError(f"{taker} takes a graph, an instance or a path, not {kind_of(posed)}")
    return posed


def _is_path(given: object) -> bool:
    return isinstance(given, str | os.PathLike)


def estimated(given: Any, of: object) -> Any:
    """The estimate in the file at a path, or of an answer; anything else as it is.

    What has ids, names or times is matched with an instance's nodes by them.

    Parameters
    ----------
    of : what is estimated; an instance says which node a pose in a file is of

    Raises
    ------
    FormatError
        As `certpgo.read_estimate`.
    """
    instance = of if isinstance(of, Instance) else None
    if isinstance(given, str | os.PathLike):
        return read_estimate(Path(given), instance)
    found = getattr(given, "estimate", given)
    if isinstance(found, Estimate):
        return found if instance is None else posed_as(found, instance)
    return given

"""What functions are given: objects, or the paths of files that hold them."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from certpgo.errors import InputNotice
from certpgo.graph import Estimate, Instance
from certpgo.io.estimates import posed_as, read_estimate
from certpgo.io.reading import read

#: A path, as text or an object.
AnyPath = str | Path


def measured(given: Any) -> Any:
    """The instance in the file at a path; anything else as it is.

    Raises
    ------
    FormatError
        As `certpgo.read`.
    """
    if not isinstance(given, str | os.PathLike):
        return given
    instance = read(Path(given), quiet=True)
    for notice in instance.notices:  # to the caller of who opens it
        warnings.warn(f"{instance.source}: {notice}", InputNotice, stacklevel=3)
    return instance


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

"""What functions are given: objects, or the paths of files that hold them."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

from certpgo.errors import InputNotice
from certpgo.graph import Estimate, Instance
from certpgo.io.reading import read, read_estimate

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

    Parameters
    ----------
    of : what is estimated; an instance says which node a pose in a file is of

    Raises
    ------
    FormatError
        As `certpgo.read_estimate`.
    """
    if isinstance(given, str | os.PathLike):
        return read_estimate(Path(given), of if isinstance(of, Instance) else None)
    found = getattr(given, "estimate", given)
    return found if isinstance(found, Estimate) else given

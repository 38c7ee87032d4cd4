"""Connections to clusters of Dask."""

from __future__ import annotations

import re
import threading
from contextlib import suppress
from typing import Any

from certpgo.errors import InputError, MissingDependency

#: Seconds that a scheduler may take to respond.
PATIENCE = 10.0
#: Of schedulers.
ADDRESS = re.compile(r"((tcp|ws)://)?(\[[0-9a-fA-F:.]+\]|[\w.-]+):\d{1,5}")


def dask_client(address: str) -> Any:
    """A client of the scheduler at an address such as ``tcp://host:8786``.

    Raises
    ------
    InputError
        None responds there.
    MissingDependency
        Dask is not installed.
    """
    try:
        import distributed
    except ImportError:
        raise MissingDependency("Dask", "cluster") from None
    if not ADDRESS.fullmatch(address):
        raise InputError(f"{address!r}: a Dask scheduler's address is expected, tcp://host:port")
    connect: Any = distributed.Client
    found: list[Any] = []

    def attempt() -> None:
        with suppress(OSError, ValueError):
            found.append(connect(address, timeout=PATIENCE, set_as_default=False))

    # What listens there may be something else, and say nothing.
    attempts = threading.Thread(target=attempt, daemon=True)
    attempts.start()
    attempts.join(2.0 * PATIENCE)
    if not found:
        raise InputError(f"{address}: no Dask scheduler responds there")
    return found[0]

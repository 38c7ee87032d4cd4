"""Graphs of tasks, as Dask takes them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any
from uuid import uuid4

Key = str


class TaskGraph:
    """Calls of functions, whose arguments may be keys of other calls.

    Attributes
    ----------
    calls : for each key the function and its arguments
    """

    def __init__(self) -> None:
        self.calls: dict[Key, Any] = {}
        self._name = uuid4().hex  # keys of a cluster are those of all graphs

    def add(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Key:
        """Add a call; keys may be arguments, or in lists that are."""
        key = f"{function.__name__}-{self._name}-{len(self.calls)}"
        called = partial(function, **options) if options else function
        self.calls[key] = (called, *arguments)
        return key

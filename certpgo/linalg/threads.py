"""Threads of BLAS, which wait for each other in small work.

OpenBLAS shares already a dot product of 10,000 numbers among all cores, and its threads spin while
they wait: on two cores a solve of sphere2500 takes three times the processor's time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, ContextDecorator, contextmanager
from functools import cached_property
from threading import Lock
from typing import Any

from certpgo.linalg import compiled

#: Multiplications from which work uses all threads: some ten seconds of one.
PARALLEL = 3e11


class _OneThread(ContextDecorator):
    """Limits BLAS to one thread while any thread of Python is within; the last one restores."""

    def __init__(self) -> None:
        self._lock, self._within = Lock(), 0
        self._before: list[tuple[Any, int]] = []

    def __enter__(self) -> None:
        with self._lock:
            if not self._within:
                threads = ((blas, blas.num_threads) for blas in self._libraries)
                self._before = [(blas, number) for blas, number in threads if number > 1]
                self._limit()
            self._within += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                self._restore()
                self._before = []

    def unless(self, is_large: bool) -> AbstractContextManager[object]:
        """One thread, or all for large work: in small fronts they only wait for each other."""
        return self.lifted() if is_large else self

    @contextmanager
    def lifted(self) -> Iterator[None]:
        """All threads again, for large work inside."""
        with self._lock:
            self._restore()
        try:
            yield
        finally:
            with self._lock:
                self._limit()

    def _limit(self) -> None:
        for blas, _ in self._before:
            blas.set_num_threads(1)

    def _restore(self) -> None:
        for blas, number in self._before:
            blas.set_num_threads(number)

    @cached_property
    def _libraries(self) -> list[Any]:
        from threadpoolctl import ThreadpoolController

        # SciPy's BLAS is another library than NumPy's, which the kernel has loaded.
        if not compiled.AVAILABLE:
            import scipy.linalg  # noqa: F401

        found = ThreadpoolController().lib_controllers
        return [library for library in found if library.user_api == "blas"]


#: Of BLAS; a context, or a decorator of functions.
one_thread = _OneThread()

"""A limit on the time of one run of a method."""

from __future__ import annotations

import faulthandler
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import FrameType

#: How much longer than its limit a worker may ignore the alarm before it is ended.
PATIENCE = 1.25


class OutOfTime(BaseException):
    """The limit has passed; not an `Exception`, so that no method catches it."""


@dataclass(frozen=True)
class Limit:
    """How long one run of a method may take.

    Attributes
    ----------
    seconds : None for no limit
    expendable : end the process when compiled code ignores the alarm; for workers
    """

    seconds: float | None = None
    expendable: bool = False

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Raise `OutOfTime` inside the block when the seconds have passed.

        The alarm rings between two steps of Python, in a process's main thread; elsewhere, and on
        systems without alarms, there is no limit.
        """
        main = threading.current_thread() is threading.main_thread()
        if self.seconds is None or not main or not hasattr(signal, "setitimer"):
            yield
            return
        with ExitStack() as stack:
            if self.expendable:
                nowhere = stack.enter_context(open(os.devnull, "w"))
                late = PATIENCE * self.seconds
                faulthandler.dump_traceback_later(late, exit=True, file=nowhere)
                stack.callback(faulthandler.cancel_dump_traceback_later)
            before = signal.signal(signal.SIGALRM, self._ring)
            stack.callback(signal.signal, signal.SIGALRM, before)
            stack.callback(signal.setitimer, signal.ITIMER_REAL, 0.0)
            signal.setitimer(signal.ITIMER_REAL, self.seconds)
            yield

    def _ring(self, signum: int, frame: FrameType | None) -> None:
        raise OutOfTime(f"not finished within {self.seconds:g} s")


NO_LIMIT = Limit()

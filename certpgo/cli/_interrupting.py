"""Ctrl-C during compiled code."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_SHOW_CURSOR = "\x1b[?25h"


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C end the process during the block, without Python's help.

    Python handles signals between two of its own instructions, so that compiled code delays Ctrl-C
    until it returns, minutes later for an interior-point solver. Shells report exit code 130.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    sys.stdout.flush()
    if sys.stderr.isatty():  # a spinner hides the cursor
        sys.stderr.write(_SHOW_CURSOR)
        sys.stderr.flush()
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        # None: the handler was not set by Python.
        signal.signal(signal.SIGINT, signal.default_int_handler if before is None else before)

"""The process of the command: its signals and streams, from before its packages are imported.

`certpgo` imports this module first, which acts when it is imported. It concerns the command alone,
never a program that imports the library.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import Any

#: Exit codes after Ctrl-C, and after SIGTERM.
INTERRUPTED, TERMINATED = 130, 143
#: New objects after which cycles among them are looked for: imports make many, and none.
OBJECTS = 10_000
#: Parts of NumPy that it loads when they are asked for. They take as long as SciPy's matrices.
_UNASKED = ("core", "ctypeslib", "f2py", "ma", "matlib", "polynomial", "testing")

#: Whether SIGTERM came.
_terminated = False


def begin() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, and SIGTERM do what Ctrl-C does."""
    for number, usual in _USUAL.items():
        if signal.getsignal(number) is _end:
            signal.signal(number, usual)
    if _RUNS_THE_COMMAND:
        gc.freeze()
        gc.set_threshold(OBJECTS)
        gc.enable()


def end_code(code: int) -> int:
    """The exit code of the process, for one that says that it was interrupted."""
    if _RUNS_THE_COMMAND:
        gc.freeze()  # Python looks for cycles once more when it ends
    return TERMINATED if _terminated and code == INTERRUPTED else code


def import_numerics() -> None:
    """Import NumPy, and SciPy's sparse matrices, without the parts of NumPy that neither uses.

    SciPy copies the names of NumPy, and so loads what NumPy loads for whoever asks for it.
    """
    import numpy

    whole: Any = numpy
    names, listed = whole.__all__, whole.__dir__
    if _RUNS_THE_COMMAND and "scipy" not in sys.modules:
        whole.__all__ = [name for name in names if name not in _UNASKED]
        whole.__dir__ = lambda: [name for name in listed() if name not in _UNASKED]
    try:
        import scipy.sparse  # noqa: F401
    finally:
        whole.__all__, whole.__dir__ = names, listed


def _runs_the_command() -> bool:
    # With -m, the package is imported before sys.argv names its file.
    program = sys.argv[0] if sys.argv else ""
    as_module = program == "-m" and "certpgo" in sys.orig_argv[1:3]
    return as_module or Path(program).stem == "certpgo"


def _end(signum: int, frame: FrameType | None) -> None:
    # An exception could be caught, or reworded, by the package that is being imported.
    with suppress(OSError):
        os.write(2, b"certpgo: interrupted\n")
    os._exit(INTERRUPTED if signum == signal.SIGINT else TERMINATED)


def _terminate(signum: int, frame: FrameType | None) -> None:
    """Do what Ctrl-C does at this moment, once: `timeout` and others send SIGTERM twice."""
    global _terminated
    handler = signal.getsignal(signal.SIGINT)
    if not _terminated and callable(handler):
        _terminated = True
        handler(signal.SIGINT, frame)


_USUAL = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: _terminate}


def _take_signals() -> None:
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and hasattr(signal, "pthread_sigmask"):
        # Jobs in the background of a script ignore Ctrl-C. Blocked, it does not come either, and
        # there is a handler for SIGTERM to call.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
        if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
            signal.signal(signal.SIGTERM, _end)


def _open_streams() -> None:
    """Open what was closed, and let names that are no UTF-8 be printed as they are."""
    while (opened := os.open(os.devnull, os.O_RDWR)) <= 2:  # the next file would be one of them
        os.set_inheritable(opened, True)
    os.close(opened)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="surrogateescape")


_RUNS_THE_COMMAND = _runs_the_command()
if _RUNS_THE_COMMAND:
    gc.disable()
    _take_signals()
    _open_streams()

"""Ctrl-C while the command imports its packages: one line instead of a traceback.

`certpgo` imports this module first, which acts when it is imported. It concerns the command alone,
never a program that imports the library.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType

#: Exit code after Ctrl-C.
INTERRUPTED = 130


def usual_interrupts() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _runs_the_command() -> bool:
    # With -m, the package is imported before sys.argv names its file.
    program = sys.argv[0] if sys.argv else ""
    as_module = program == "-m" and "certpgo" in sys.orig_argv[1:3]
    return as_module or Path(program).stem == "certpgo"


def _end(signum: int, frame: FrameType | None) -> None:
    # An exception could be caught, or reworded, by the package that is being imported.
    os.write(2, b"certpgo: interrupted\n")
    os._exit(INTERRUPTED)


if _runs_the_command() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end)

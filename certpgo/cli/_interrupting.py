"""Ctrl-C and SIGTERM: what they leave, and how they end compiled code."""

from __future__ import annotations

import _thread
import functools
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import typer

from certpgo._start import INTERRUPTED as INTERRUPTED
from certpgo.cli._show import outlasting_reader

#: Seconds after which Ctrl-C that was dropped is delivered again.
LATER = 0.01
_SHOW_CURSOR = "\x1b[?25h"
#: Python's own handlers of what ends a command.
_USUAL: dict[signal.Signals, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}


def tell_interrupted(stands: str, unwritten: Iterable[Path | None] = ()) -> None:
    """Print on stderr that Ctrl-C ended the work, what stands, and the files that are not written.

    Parameters
    ----------
    stands : what is known or written all the same
    unwritten : outputs that were asked for and will be missing; None for those that were not
    """
    missing = ", ".join(str(path) for path in unwritten if path is not None)
    lacking = f"; not written: {missing}" if missing else ""
    typer.echo(f"certpgo: interrupted: {stands}{lacking}", err=True)


def tells_unwritten(
    *names: str,
) -> Callable[[Callable[..., int | None]], Callable[..., int | None]]:
    """Let Ctrl-C, where it aborts a command, name the outputs that are written, and the others.

    Where any is asked for, the command goes on if nobody reads stdout any more.

    Parameters
    ----------
    names : the command's parameters that are paths of outputs
    """

    def decorated(command: Callable[..., int | None]) -> Callable[..., int | None]:
        @functools.wraps(command)
        def telling(**options: Any) -> int | None:
            asked = [options[name] for name in names if options.get(name) is not None]
            before = [_state(path) for path in asked]
            try:
                with outlasting_reader() if asked else nullcontext():
                    return command(**options)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(*_told(asked, before)) from None

        return telling

    return decorated


def _told(asked: Sequence[Path], before: Sequence[object]) -> Iterator[str]:
    """Which outputs changed since, and which did not, in words."""
    changed = [_state(path) != then for path, then in zip(asked, before, strict=True)]
    for said, whether in (("written", True), ("not written", False)):
        named = [
            str(path) for path, is_new in zip(asked, changed, strict=True) if is_new is whether
        ]
        if named:
            yield f"{said}: {', '.join(named)}"


def _state(path: Path) -> object:
    """What changes where a file is replaced; None if there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


@contextmanager
def heard_late() -> Iterator[None]:
    """Deliver Ctrl-C again where Python would drop it during the block.

    What is raised in a destructor or a weak reference's callback is printed, and ignored.
    """
    before = sys.unraisablehook

    def again(dropped: Any) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt):
            later = threading.Timer(LATER, _thread.interrupt_main)
            later.daemon = True
            later.start()
        else:
            before(dropped)

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def unmoved() -> Iterator[None]:
    """Ignore Ctrl-C and SIGTERM during the block, which only says how the work ended."""
    with _handled_by(signal.SIG_IGN):
        yield


@contextmanager
def ends_at_once() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end the process during the block, without Python's help.

    Python handles signals between two of its own instructions, so that compiled code delays them
    until it returns, minutes later for an interior-point solver. Shells report the usual codes.
    """
    if threading.current_thread() is threading.main_thread():
        sys.stdout.flush()
        if sys.stderr.isatty():  # a spinner hides the cursor
            sys.stderr.write(_SHOW_CURSOR)
            sys.stderr.flush()
    with _handled_by(signal.SIG_DFL):
        yield


@contextmanager
def _handled_by(handler: signal.Handlers) -> Iterator[None]:
    """Handle Ctrl-C and SIGTERM so during the block; in the main thread, which alone can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in _USUAL}
    try:
        yield
    finally:
        for number, usual in _USUAL.items():
            # None: the handler was not set by Python.
            signal.signal(number, usual if before[number] is None else before[number])

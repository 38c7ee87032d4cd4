"""Scenes that are live in the browser: one to look at, or a map that is drawn as it grows."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from certpgo.view.scene import Scene
from certpgo.view.viewer import PORT, Drawing, serving

#: Seconds between drawings at least.
PAUSE = 0.5


class Screen:
    """The browser's scene, and a sentence about it.

    Attributes
    ----------
    address : where it is
    drawn : how often it was drawn
    """

    def __init__(self, server: Any, address: str) -> None:
        self.address, self.drawn = address, 0
        self._server, self._due = server, 0.0
        self._said = server.gui.add_markdown("")

    def show(self, scene: Callable[[], Scene], sentence: str, *, last: bool = False) -> None:
        """Draw a scene; unless it is the last, only if the drawing before is not recent."""
        self._said.content = sentence
        if time.monotonic() < self._due and not last:
            return
        with self._server.atomic():
            self._server.scene.reset()
            Drawing(self._server, scene(), dark=False, colour=None)
        self._due = time.monotonic() + PAUSE
        self.drawn += 1


@contextmanager
def live(
    scene: Scene,
    *,
    dark: bool | None = None,
    colour: str | None = None,
    host: str = "127.0.0.1",
    port: int = PORT,
) -> Iterator[str]:
    """A scene in the browser while the block runs; yields the address.

    Parameters
    ----------
    dark, colour : as for `offline`; light by default
    host : address of this machine to listen at; by default only this machine can connect
    port : that is tried first; the next ones if it is taken

    Raises
    ------
    InputError
        No edge has such a measure.
    MissingDependency
        viser is not installed.
    """
    with serving(host, port) as server:
        drawing = Drawing(server, scene, dark=bool(dark), colour=colour)
        with drawing.controls():
            yield f"http://{host}:{server.get_port()}"


@contextmanager
def growing(*, host: str = "127.0.0.1", port: int = PORT) -> Iterator[Screen]:
    """Show scenes in the browser while the block runs.

    Parameters
    ----------
    host, port : as for `live`

    Raises
    ------
    MissingDependency
        viser is not installed.
    """
    with serving(host, port) as server:
        yield Screen(server, f"http://{host}:{server.get_port()}")

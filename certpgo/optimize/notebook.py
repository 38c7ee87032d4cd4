"""Progress of a long search below the cell of a notebook."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from certpgo.optimize.monitor import Iteration, Monitor, silent

#: Seconds before a line is shown, and between two of its states.
PATIENCE, PACE = 1.0, 0.2


@contextmanager
def watched(monitor: Monitor | None) -> Iterator[Monitor]:
    """The given monitor; without one a line in notebooks, which is gone at the end, or silence."""
    if monitor is not None or not in_notebook():
        yield monitor or silent
        return
    line = NotebookLine()
    try:
        yield line
    finally:
        line.close()


def in_notebook() -> bool:
    """Whether a Jupyter kernel runs this; IPython is not imported for it."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return getattr(shell, "kernel", None) is not None


@dataclass
class NotebookLine:
    """A monitor that shows the last iteration as a line, once the search has taken a second."""

    _next: float = field(default_factory=lambda: time.perf_counter() + PATIENCE, repr=False)
    _shown: Any = field(default=None, repr=False)

    def __call__(self, iteration: Iteration) -> bool:
        """Show the iteration, unless another one was shown just now; never stop."""
        if time.perf_counter() >= self._next:
            self._next = time.perf_counter() + PACE
            self._show(
                f"iteration {iteration.number}: cost {iteration.cost:.8g}, gradient "
                f"{iteration.gradient:.0e}, {iteration.seconds:.1f} s"
            )
        return False

    def close(self) -> None:
        """Remove the line."""
        if self._shown is not None:
            self._show("")

    def _show(self, line: str) -> None:
        from IPython.display import display

        data = {"text/plain": line}
        if self._shown is None:
            show: Any = display
            self._shown = show(data, raw=True, display_id=True)
        else:
            self._shown.update(data, raw=True)

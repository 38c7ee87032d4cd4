"""Output of the commands: results on stdout, everything else on stderr."""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer

#: Width of tables that are not printed to a terminal, in characters.
WIDTH = 160


def notice(sentence: str) -> None:
    """Print a note on stderr."""
    typer.echo(f"note: {sentence}", err=True)


@contextmanager
def noticing() -> Iterator[None]:
    """Print the block's warnings about its input or output on stderr."""
    from certpgo.errors import InputNotice

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputNotice)
        yield
    for warning in caught:
        if issubclass(warning.category, InputNotice):
            notice(str(warning.message))
        else:
            place = (warning.filename, warning.lineno)
            warnings.warn_explicit(warning.message, warning.category, *place)


def document(data: Any) -> None:
    """Print one JSON document on stdout; numbers that are not finite become null."""
    from certpgo.io.plain import plain

    typer.echo(json.dumps(plain(data), indent=2, allow_nan=False))


def facts(pairs: Iterable[tuple[str, str]]) -> None:
    """Print names and values, one pair per line."""
    listed = list(pairs)
    width = max(len(name) for name, _ in listed)
    for name, value in listed:
        typer.echo(f"{name:<{width}}  {value}")


def table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[str]], caption: str = ""
) -> None:
    """Print a table on stdout, as wide as the terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    class Piped(Console):
        def on_broken_pipe(self) -> None:
            """Leave it to the caller, which exits quietly; Rich would exit with an error."""
            raise BrokenPipeError

    console = Piped() if sys.stdout.isatty() else Piped(width=WIDTH)
    shown = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in header:
        shown.add_column(Text(name), overflow="fold")
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))
    console.print(shown)
    if caption:
        console.print(Text(caption))


@contextmanager
def working(message: str) -> Iterator[Any]:
    """A spinner on stderr while the block runs; silent if stderr is not a terminal."""
    if not sys.stderr.isatty():
        yield _Silent()
        return
    from rich.console import Console

    with Console(stderr=True).status(message) as status:
        yield status


class _Silent:
    def update(self, message: str) -> None:
        """Show nothing."""


class progress_bar:  # noqa: N801 - used like a function
    """A progress bar for bytes on stderr."""

    def __init__(self, message: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn

        columns = (TextColumn(message), BarColumn(), DownloadColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task(message, total=None)
        self._progress.start()

    def advance(self, done: int, total: int) -> None:
        """Show ``done`` of ``total`` bytes."""
        self._progress.update(self._task, completed=done, total=total)

    def close(self) -> None:
        """Remove the bar."""
        self._progress.stop()

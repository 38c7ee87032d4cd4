"""Output of the commands: results on stdout, everything else on stderr."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO, cast

import typer

if TYPE_CHECKING:
    from certpgo.optimize.monitor import Iteration

#: Width of tables that are not printed to a terminal, in characters.
WIDTH = 160
#: Characters between columns.
GUTTER = 3


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
    from certpgo.io.json_values import plain

    typer.echo(json.dumps(plain(data), indent=2, allow_nan=False))


def facts(pairs: Iterable[tuple[str, str]]) -> None:
    """Print names and values: one pair per line, or in a terminal wrapped between words."""
    from certpgo.graph.phrases import aligned

    for line in aligned(pairs, _terminal()):
        typer.echo(line)


def paragraph(text: str) -> None:
    """Print a text, wrapped between words in a terminal, or where COLUMNS says how wide."""
    width = shutil.get_terminal_size().columns if "COLUMNS" in os.environ else _terminal()
    lines = [text] if width is None else textwrap.wrap(text, width, break_long_words=False)
    typer.echo("\n".join(lines))


@contextmanager
def outlasting_reader() -> Iterator[None]:
    """Finish the block even if the reader of stdout is gone (| head); only then raise that error.

    What is printed since is discarded, so that files that were asked for are all written.
    """
    stream = _Outlasting(sys.stdout)
    sys.stdout = cast("TextIO", stream)
    try:
        yield
    finally:
        sys.stdout = stream.of
    if stream.gone is not None:
        raise stream.gone


class _Outlasting:
    """A stream whose reader may go."""

    def __init__(self, of: TextIO) -> None:
        self.of = of
        self.gone: BrokenPipeError | None = None

    def write(self, text: str) -> int:
        with self._discarding():
            self.of.write(text)
        return len(text)

    def flush(self) -> None:
        with self._discarding():
            self.of.flush()

    @contextmanager
    def _discarding(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError as gone:
            self.gone = gone
            discard_stdout()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.of, name)


def discard_stdout() -> None:
    """Discard what is still buffered for stdout, and all that is printed later."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _terminal() -> int | None:
    """The width of the terminal; None for pipes and files, whose lines stay whole."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    caption: str = "",
    *,
    optional: Sequence[str] = (),
) -> None:
    """Print a table on stdout, as wide as the terminal, or as COLUMNS says.

    Numbers, words and the names in the first column are never split where the table fits;
    ``optional`` columns are left out, in that order, until it does, and named below it.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    class Piped(Console):
        def on_broken_pipe(self) -> None:
            """Leave it to the caller, which exits quietly; Rich would exit with an error."""
            raise BrokenPipeError

    # COLUMNS counts in either case.
    width = _terminal() or shutil.get_terminal_size((WIDTH, 0)).columns
    console = Piped(width=width)
    header, rows, left_out = _fitted(header, list(rows), console.width, optional)
    columns = list(zip(header, *rows, strict=True))
    if sum(_needed(columns, width)) + GUTTER * len(columns) > width:
        for line in _listed(title, header, rows):
            typer.echo(line)
        return
    shown = Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for column, wide in zip(columns, _widths(columns, width), strict=True):
        shown.add_column(Text(column[0]), overflow="fold", min_width=wide, max_width=wide)
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))
    console.print(shown)
    if left_out:
        console.print(Text(f"Not shown at this width: {', '.join(left_out)}."))
    if caption:
        console.print(Text(caption))


def _listed(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """A table as lines, a cell each, for a terminal that it does not fit."""
    yield title
    for first, *others in rows:
        yield f"\n{first}"
        yield from (
            f"  {name}: {cell}" for name, cell in zip(header[1:], others, strict=True) if cell
        )


def _fitted(
    header: Sequence[str], rows: Sequence[Sequence[str]], width: int, optional: Sequence[str]
) -> tuple[list[str], list[list[str]], list[str]]:
    """The columns that fit side by side, their cells, and the titles of those left out."""
    columns = [[title, *cells] for title, *cells in zip(header, *rows, strict=True)]
    left_out: list[str] = []
    for title in optional:
        if sum(_needed(columns, width)) + GUTTER * len(columns) <= width:
            break
        left_out += [column[0] for column in columns if column[0] == title]
        columns = [column for column in columns if column[0] != title]
    titles, *shown = map(list, zip(*columns, strict=True))
    return titles, shown, left_out


def _needed(columns: Sequence[Sequence[str]], width: int) -> list[int]:
    """The least width of each column: of its longest word, or in the first one of the names."""
    needed = [_longest_word(column) for column in columns]
    names = max(map(len, columns[0]), default=0)
    return [max(needed[0], min(names, width // 2)), *needed[1:]]


def _widths(columns: Sequence[Sequence[str]], width: int) -> list[int]:
    """The width of each column: what it needs, and the rest to where cells take most lines."""
    widths = _needed(columns, width)
    longest = [max(map(len, cells)) for cells in columns]
    for _ in range(width - sum(widths) - GUTTER * len(columns)):
        lines = [text / wide for text, wide in zip(longest, widths, strict=True)]
        if max(lines) <= 1.0:
            break
        widths[lines.index(max(lines))] += 1
    return widths


def _longest_word(cells: Sequence[str]) -> int:
    return max((len(word) for cell in cells for word in cell.split()), default=1)


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


class StatusLine:
    """The monitor that updates the line of a spinner."""

    def __init__(self, line: Any = None) -> None:
        self.line = _Silent() if line is None else line

    def __call__(self, iteration: Iteration) -> bool:
        """Show the iteration; never stop."""
        reached = f"F {iteration.cost:.8g}, gradient {iteration.gradient:.0e}"
        self.line.update(f"iteration {iteration.number}: {reached}")
        return False


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

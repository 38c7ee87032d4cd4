"""The command line: one file per sub-command, found by scanning this folder.

A command is a function ``command`` that returns an exit code or None. Its file imports nothing
heavy at the top, so that ``certpgo --help`` is quick. It has ``EXAMPLES``, command lines that its
help begins with. It may have ``RULES``: combinations of options that are refused; and
``NUMERICS = False``, if it runs without NumPy and SciPy.
"""

from __future__ import annotations

import errno
import functools
import importlib
import inspect
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from certpgo import _start, registry
from certpgo.cli._help import HelpfulCommand, HelpfulGroup
from certpgo.cli._interrupting import heard_late, unmoved
from certpgo.cli._rules import refuse
from certpgo.cli._show import discard_stdout
from certpgo.errors import CertPGOError

Command = Callable[..., int | None]

#: Commands that exist in a checkout only.
BENCHMARKS = ("bench", "gate", "report", "reproduce")
#: Exit code if the reader of the output is gone.
PIPE_CLOSED = 141
#: What each exit code means.
EXIT_CODES = {
    0: "success or CERTIFIED",
    1: "unusable input, unknown name, or options that do not go together",
    2: "command line that is not as the printed usage says",
    3: "BOUNDED",
    4: "REFUTED",
    5: "UNDECIDED",
    6: "no proof, or proof refused",
    7: "gate failed",
    _start.INTERRUPTED: "interrupted by Ctrl-C",
    PIPE_CLOSED: "output pipe closed early",
    _start.TERMINATED: "ended by SIGTERM",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``certpgo``; returns the exit code.

    Parameters
    ----------
    argv : arguments after the program's name; by default those of the process
    """
    return _start.end_code(_code_of(lambda: _dispatched(sys.argv[1:] if argv is None else argv)))


def _dispatched(argv: Sequence[str]) -> int:
    """Run the command that the arguments name; returns its exit code."""
    arguments = [*argv]  # Not list(...): the command of that name is an attribute of this module.
    # Only the requested command is imported.
    known = arguments and arguments[0] in command_names()
    if not known and arguments and arguments[0] in BENCHMARKS:
        return _fail(f"{arguments[0]} is a command of the benchmarks; {registry.NO_CHECKOUT}")
    no_command = arguments[:1] == ["--version"]
    names = arguments[:1] if known else () if no_command else command_names()
    try:
        with heard_late():
            application(names)(arguments, prog_name="certpgo")
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # while the help was printed
            return PIPE_CLOSED
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def application(names: Sequence[str]) -> typer.Typer:
    """The application with the named commands."""
    codes = ", ".join(f"{code} {meaning}" for code, meaning in EXIT_CODES.items())
    app = typer.Typer(
        name="certpgo",
        cls=HelpfulGroup,
        rich_markup_mode=None,
        help="Certifiable pose-graph optimization and rotation averaging.",
        epilog=f"Exit codes: {codes}.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
    )
    app.callback()(_root)
    for name in names:
        function = _function(name)
        does, examples = _paragraphs(function), _examples(function)
        register = app.command(name, cls=HelpfulCommand, help=does, epilog=examples)
        register(_guarded(function))
    return app


def _paragraphs(function: Command) -> str:
    """The docstring with a line a paragraph, so that its own line ends do not show in the help."""
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _examples(function: Command) -> str:
    """The example command lines of the command's file, a line each."""
    examples: Sequence[str] = inspect.unwrap(function).__globals__.get("EXAMPLES", ())
    return "\n".join(examples)


def command_names() -> tuple[str, ...]:
    """Names of the commands: the files of this folder and, in a checkout, the benchmarks'."""
    return tuple(sorted({*_own_commands(), *registry.command_names()}))


def _own_commands() -> tuple[str, ...]:
    stems = (path.stem for path in Path(__file__).parent.glob("*.py"))
    return tuple(stem for stem in stems if not stem.startswith("_"))


def _function(name: str) -> Command:
    """The command, or one that reports why its file cannot be loaded."""
    try:
        if name in _own_commands():
            function: Command = importlib.import_module(f"{__name__}.{name}").command
        else:
            function = registry.get_command(name)
    except CertPGOError as reason:
        error = reason

        def unusable() -> None:
            """Unusable: its file cannot be loaded."""
            raise error

        return unusable
    return function


def _print_version(requested: bool) -> None:
    if requested:
        from certpgo import __version__

        typer.echo(f"certpgo {__version__}")
        raise typer.Exit(0)


_VERSION = typer.Option(
    "--version", help="Print the version.", callback=_print_version, is_eager=True
)


def _root(version: Annotated[bool, _VERSION] = False) -> None:
    """Options before the command."""


def _guarded(function: Command) -> Callable[..., None]:
    """The command, with expected errors turned into one line and an exit code."""
    known = inspect.signature(function).parameters

    @functools.wraps(function)
    def guarded(**options: object) -> None:
        def run() -> int | None:
            module = inspect.unwrap(function).__globals__
            if module.get("NUMERICS", True):
                # Not earlier: the help needs none. Until they are here, Ctrl-C ends at once.
                _start.import_numerics()
                importlib.import_module("certpgo.graph")
            _start.begin()
            from certpgo.io.pipes import pipes_kept

            # What --no-x gives is False.
            given = {k: v or True for k, v in options.items() if v != known[k].default}
            refuse(module.get("RULES", ()), **given)
            with pipes_kept():
                return function(**options)

        raise typer.Exit(_code_of(run))

    return guarded


def _code_of(run: Callable[[], int | None]) -> int:
    """The exit code of what is run, with expected errors told in one line."""
    try:
        code = run()
        sys.stdout.flush()
    except CertPGOError as error:
        code = _fail(str(error))
    except KeyboardInterrupt as stop:
        with unmoved():
            code = _fail("; ".join(["interrupted", *map(str, stop.args)]), _start.INTERRUPTED)
    except BrokenPipeError:  # the reader is gone (| head)
        code = PIPE_CLOSED
    except OSError as error:
        where = "standard output" if error.errno == errno.ENOSPC else ""
        place = f"{named}: " if (named := error.filename or where) else ""
        code = _fail(f"{place}{error.strerror or error}")
    try:
        sys.stdout.flush()
    except OSError:  # discard what Python flushes at exit
        discard_stdout()
    return code or 0


def _fail(message: str, code: int = 1) -> int:
    with suppress(OSError):  # nobody can be told
        typer.echo(f"certpgo: {' '.join(message.split())}", err=True)
    return code

"""How help is laid out: sections of names and texts, readable from 60 columns on.

Rich's panels give a third of 80 columns to the names of options, and break long ones.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import typer.core

from certpgo.cli._values import plainly

#: The sections of options that come after a command's common ones, which have none.
SEARCH = "How it is solved"
JUDGING = "How it is judged"
MATCHING = "Times, and ground truth"
READING = "Reading the graph"
_ORDER = ("Arguments", "Options", SEARCH, JUDGING, MATCHING, READING)

#: The commands by what they are for, most used first; a file that is not named here comes last.
GROUPS = {
    "Solve and certify": ("solve", "certify", "check", "prove", "bounds", "follow"),
    "From images and scans": ("reconstruct", "register"),
    "Look and convert": ("info", "view", "convert"),
    "Mistakes, maps and loop closures": ("diagnose", "outliers", "merge", "sparsify", "suggest"),
    "Compare": ("compare", "optima", "list", "fetch"),
    "Reproduce": ("reproduce", "report", "gate", "bench"),
}
OTHERS = "Others"
#: Lines of help, with 80 columns, that one can take in.
LINES = 60
#: Names and texts of options or commands, by the title of their section.
Sections = dict[str, list[tuple[str, str]]]
#: Columns that the longest name of an option or command takes before its text starts a new line.
NAMES = 26


def in_groups(names: Sequence[str]) -> dict[str, list[str]]:
    """The names of commands by group, in the order in which help lists them."""
    found = {group: [n for n in listed if n in names] for group, listed in GROUPS.items()}
    grouped = {name for listed in found.values() for name in listed}
    found[OTHERS] = [name for name in names if name not in grouped]
    return {group: listed for group, listed in found.items() if listed}


def _section_of(parameter: Any) -> str:
    usual = "Arguments" if parameter.param_type_name == "argument" else "Options"
    return getattr(parameter, "rich_help_panel", None) or usual


def _write(formatter: Any, sections: Sections) -> None:
    for title, records in sections.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records, col_max=NAMES)


def _write_names(formatter: Any, title: str, sections: Sections) -> None:
    """Write the sections with the names of their options alone."""
    with formatter.section(title):
        for name, records in sections.items():
            text = f"{name}: {', '.join(_primary(option) for option, _ in records)}"
            lines = textwrap.wrap(
                text,
                formatter.width,
                initial_indent="  ",
                subsequent_indent="    ",
                break_on_hyphens=False,
            )
            formatter.write("".join(f"{line}\n" for line in lines))


def _primary(option: str) -> str:
    """The long name of an option, without what it takes, its short name and its opposite."""
    return next(word for word in option.replace(",", " ").split() if word.startswith("--"))


class HelpfulCommand(typer.core.TyperCommand):
    """A command whose help has examples first, then its options in sections, common ones first.

    Help of more than `LINES` lines names the options of the last sections only; --help-all explains
    them all. The epilog holds the examples, a line each.
    """

    _explains_all = False

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the command line, and whether all of the help is asked for."""
        self._explains_all = "--help-all" in args
        return super().parse_args(ctx, args)

    def get_help_option_names(self, ctx: Any) -> list[str]:
        """The names of the option --help, in order."""
        return ["--help", "--help-all"]

    def get_help_option(self, ctx: Any) -> Any:
        """The option --help, which says what --help-all does."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.help = "Show this, or all options explained, and exit."
        return option

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, whose plain values are taken without Pydantic."""
        return plainly(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line: no braces of required arguments, dots once."""
        return [
            piece.replace("{", "").replace("}", "").replace("......", "...")
            for piece in super().collect_usage_pieces(ctx)
        ]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the command does, and the examples."""
        super().format_help_text(ctx, formatter)
        if self.epilog:
            with formatter.section("Examples"):
                for line in self.epilog.splitlines():
                    formatter.write(f"  {line}\n")

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write nothing: the examples are above."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options: as many of the sections as there is room for."""
        sections: Sections = {title: [] for title in _ORDER}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                if parameter.param_type_name == "argument":  # its metavar says what it is
                    record = parameter.metavar or record[0], record[1]
                sections.setdefault(_section_of(parameter), []).append(record)
        given = [title for title, records in sections.items() if records]
        usual = len([title for title in given if title in _ORDER[:2]])
        above = formatter.getvalue()
        for count in range(len(given), usual - 1, -1):
            part = type(formatter)(width=formatter.width)
            _write(part, {title: sections[title] for title in given[:count]})
            if count < len(given):
                rest = {title: sections[title] for title in given[count:]}
                _write_names(part, f"More ({ctx.command_path} --help-all)", rest)
            if self._explains_all or len((above + part.getvalue()).splitlines()) < LINES:
                break
        formatter.write(f"\n{part.getvalue()}")


class HelpfulGroup(typer.core.TyperGroup):
    """The program: its help lists the commands in groups."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, as those of commands."""
        return plainly(super().get_params(ctx))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with the first sentence of its help."""
        groups = in_groups(list(self.commands))
        # The whole sentence, on several lines if it is long.
        texts = {name: one.get_short_help_str(1000) for name, one in self.commands.items()}
        _write(formatter, {g: [(n, texts[n]) for n in names] for g, names in groups.items()})

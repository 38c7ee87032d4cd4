"""How help is laid out: sections of names and texts, readable from 60 columns on.

Rich's panels give a third of 80 columns to the names of options, and break long ones.
"""

from __future__ import annotations

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


def _write(formatter: Any, sections: dict[str, list[tuple[str, str]]]) -> None:
    for title, records in sections.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records, col_max=NAMES)


class HelpfulCommand(typer.core.TyperCommand):
    """A command whose help has its options in sections, common ones first."""

    def get_params(self, ctx: Any) -> list[Any]:
        """The parameters, whose plain values are taken without Pydantic."""
        return plainly(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The words of the usage line: no braces of required arguments, dots once."""
        return [
            piece.replace("{", "").replace("}", "").replace("......", "...")
            for piece in super().collect_usage_pieces(ctx)
        ]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options."""
        sections: dict[str, list[tuple[str, str]]] = {title: [] for title in _ORDER}
        for parameter in self.get_params(ctx):
            record = parameter.get_help_record(ctx)
            if record is not None:
                if parameter.param_type_name == "argument":  # its metavar says what it is
                    record = parameter.metavar or record[0], record[1]
                sections.setdefault(_section_of(parameter), []).append(record)
        _write(formatter, sections)


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

"""Pages of the command line, one per command, from the program itself."""

from __future__ import annotations

import typer

from certpgo.cli import EXIT_CODES, application, command_names

_HEAD = "| {} | |\n|---|---|\n"


def pages() -> dict[str, str]:
    """Markdown by file name: each command, and the exit codes they share."""
    group = typer.main.get_command(application(command_names()))
    commands = sorted(group.commands.items())  # type: ignore[attr-defined]
    made = {f"{name}.md": _page(name, command) for name, command in commands}
    rows = "".join(f"| {code} | {meaning} |\n" for code, meaning in EXIT_CODES.items())
    made["exit-codes.md"] = f"# Exit codes\n\n| code | means |\n|---|---|\n{rows}"
    return made


def _page(name: str, command: typer.core.TyperCommand) -> str:
    context = command.context_class(command, info_name=f"certpgo {name}")
    usage = " ".join(command.collect_usage_pieces(context)).translate({ord(c): None for c in "{}"})
    panels: dict[str, list[str]] = {}
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is None:
            continue
        kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
        panel = getattr(parameter, "rich_help_panel", None) or kind
        panels.setdefault(panel, []).append("| {} | {} |\n".format(*map(_cell, _marked(record))))
    tables = "\n".join(
        _HEAD.format(panel.lower()) + "".join(rows) for panel, rows in panels.items()
    )
    text = (command.help or "").replace("*", "\\*")
    examples = "".join(f"$ {line}\n" for line in (command.epilog or "").splitlines())
    return (
        f"# certpgo {name}\n\n```text\ncertpgo {name} {usage}\n```\n\n{text}\n\n"
        f"```console\n{examples}```\n\n{tables}\n"
        "See also the [exit codes](exit-codes.md).\n"
    )


def _marked(record: tuple[str, str]) -> tuple[str, str]:
    return f"`{record[0]}`", record[1].replace("*", "\\*").replace("<", "\\<")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")

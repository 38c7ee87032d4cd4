"""Values of options are those of Typer's own conversion, which takes Pydantic."""

import os
import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.core import TyperCommand

from certpgo.cli._help import HelpfulCommand


class Colour(StrEnum):
    RED = "red"
    DARK = "dark-red"


def even(text):
    if not text.isdecimal():
        raise ValueError("no number")
    if int(text) % 2:
        raise typer.BadParameter("odd")
    return int(text)


KINDS = [
    (str, {}),
    (int, {}),
    (float, {}),
    (float, {"min": 0.0, "max": 1.0}),
    (int, {"max": 5}),
    (int, {"max": 5, "clamp": True}),
    (Colour, {}),
    (Colour, {"case_sensitive": False}),
    (Path, {}),
    (Path, {"exists": True}),
    (Path, {"file_okay": False}),
    (list[str], {}),
    (list[int], {}),
    (list[Colour], {}),
    (int, {"parser": even}),
]
PATHS = (Path, list[str])
TEXTS = ["", " ", "a", "-", "0", "-0", "007", "5", "+5", "-5", "1_0", " 7 ", "6", "9" * 20]
TEXTS += ["0.5", ".5", "5.", "1e3", "1E-3", "1e999", "-1e-9", "nan", "inf", "0x10", "\u0665"]
TEXTS += ["red", "RED", "dark-red", "DARK", "true", "/nowhere/at/all", "/", os.devnull, "a\x1bb"]


def taken(cls, kind, options, texts):
    """The value that a command gets, or what is said instead."""
    app, found = typer.Typer(rich_markup_mode=None), []

    @app.command(cls=cls)
    def command(value: Annotated[kind | None, typer.Option("--value", **options)] = None) -> None:
        found.append(value)

    try:
        app([f"--value={text}" for text in texts], standalone_mode=False)
    except typer.BadParameter as error:
        return str(error)
    return [(type(value), str(value)) for value in found]


@pytest.mark.parametrize(("kind", "options"), KINDS)
def test_values_are_those_of_typer(kind, options):
    for texts in [[], *([text] for text in TEXTS), ["5", "red"], ["red", "red"]]:
        ours, theirs = (taken(cls, kind, options, texts) for cls in (HelpfulCommand, TyperCommand))
        if isinstance(theirs, str) and "parser" not in options and kind not in PATHS:
            assert isinstance(ours, str), texts
            assert " is not " in ours
            assert not re.search("Value error|Input should", ours)
        else:
            assert ours == theirs, texts

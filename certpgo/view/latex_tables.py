"""Tables in LaTeX, with the rules of booktabs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}
#: A number that plain text would spoil: negative, or with an exponent.
_NUMBER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)(?:e([+-]\d+))?(?![\w.])")


def latex_table(
    title: str, header: Sequence[str], rows: Iterable[Sequence[str]], below: str = ""
) -> list[str]:
    """Lines of a table with a caption: the first column of words, the others of numbers."""
    return [
        "\\begin{table}",
        "\\centering",
        f"\\caption{{{escaped(title)}}}",
        f"\\begin{{tabular}}{{@{{}}l{'r' * (len(header) - 1)}@{{}}}}",
        "\\toprule",
        latex_row(map(escaped, header)),
        "\\midrule",
        *(latex_row(map(numbered, row)) for row in rows),
        "\\bottomrule",
        "\\end{tabular}",
        *([f"\\par\\footnotesize {escaped(below)}"] if below else []),
        "\\end{table}",
    ]


def latex_row(cells: Iterable[str]) -> str:
    """A row of cells that are LaTeX."""
    return " & ".join(cells) + " \\\\"


def escaped(words: str) -> str:
    """The text with TeX's special characters escaped."""
    return "".join(_SPECIAL.get(character, character) for character in words)


def numbered(words: str) -> str:
    """The escaped text, its negative numbers and powers of ten set as mathematics."""
    parts: list[str] = []
    end = 0
    for match in _NUMBER.finditer(words):
        digits, exponent = match.groups()
        power = "" if int(exponent or 0) == 0 else f"\\times 10^{{{int(exponent)}}}"
        parts.append(escaped(words[end : match.start()]))
        plain = not power and not digits.startswith("-")
        parts.append(digits if plain else f"${digits}{power}$")
        end = match.end()
    return "".join([*parts, escaped(words[end:])])

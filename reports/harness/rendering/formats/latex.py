"""LaTeX: one longtable with a heading per section; needs booktabs and longtable."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import FIELDS, Table
from reports.harness.rendering.citations import citation
from reports.harness.rendering.formats import Form
from reports.harness.rendering.render import Section, notes, sections

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


def latex_text(table: Table, records: Sequence[Record]) -> str:
    """The table as LaTeX, to be read into a document."""
    shown = sections(table, records)
    header = _header(shown)
    of_words = set(FIELDS) - {"iterations"}
    numeric = {column.title for column in table.columns if column.key not in of_words}
    kinds = "".join("r" if name in numeric else "l" for name in header)
    return "\n".join(
        [
            "% needs \\usepackage{booktabs,longtable}",
            f"\\begin{{longtable}}{{@{{}}{kinds}@{{}}}}",
            f"\\caption{{{escaped(table.title)}{_cited(table)}}}\\label{{tab:{table.name}}}\\\\",
            "\\toprule",
            _row(map(escaped, header)),
            "\\midrule",
            "\\endhead",
            "\\bottomrule",
            "\\endlastfoot",
            *_body(shown, header),
            "\\end{longtable}",
            *(f"\n\\noindent {escaped(note)}" for note in notes(table, records)),
            "",
        ]
    )


def _header(shown: Iterable[Section]) -> tuple[str, ...]:
    """The columns of all sections, in the order in which each has them."""
    names: list[str] = []
    for section in shown:
        place = 0
        for name in section.header:
            if name in names:
                place = names.index(name) + 1
            else:
                names.insert(place, name)
                place += 1
    return tuple(names)


def _body(shown: Sequence[Section], header: Sequence[str]) -> Iterator[str]:
    for k, section in enumerate(shown):
        if k:
            yield "\\addlinespace"
        title = f"\\textit{{{escaped(section.title)}}}"
        yield f"\\multicolumn{{{len(header)}}}{{@{{}}l}}{{{title}}}\\\\"
        for row in section.rows:
            cells = dict(zip(section.header, row, strict=True))
            yield _row(numbered(cells.get(name, "")) for name in header)


def _row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + " \\\\"


def _cited(table: Table) -> str:
    name = table.published or table.name
    return f"~\\cite{{{name.partition('_')[0]}}}" if citation(name) else ""


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


FORM = Form("tex", "LaTeX", latex_text)

"""LaTeX: one longtable with a heading per section; needs booktabs and longtable."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from certpgo.view.latex_tables import escaped, latex_row, numbered
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import FIELDS, Table
from reports.harness.rendering.citations import citation
from reports.harness.rendering.formats import Form
from reports.harness.rendering.render import Section, notes, sections


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
            latex_row(map(escaped, header)),
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
            yield latex_row(numbered(cells.get(name, "")) for name in header)


def _cited(table: Table) -> str:
    name = table.published or table.name
    return f"~\\cite{{{name.partition('_')[0]}}}" if citation(name) else ""


FORM = Form("tex", "LaTeX", latex_text)

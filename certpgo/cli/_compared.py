"""The results of a comparison as files: tables in Markdown and in LaTeX."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from certpgo.solve.comparison import MethodResult

FAILED = "not run or failed"
#: Columns that are empty for most methods.
SPARSE = ("off by", "kept, %", "ATE", "RPE", "by phase", FAILED)


def section(
    results: Sequence[MethodResult], hidden: Sequence[str] = ()
) -> tuple[str, Sequence[str], list[Sequence[str]], str]:
    """Title, header, rows and caption of the results on one graph."""
    from certpgo.solve.comparison_table import captions, cells, columns, title

    rows: list[Sequence[str]] = [cells(result) for result in results]
    header: Sequence[str] = (*columns(results[0]), FAILED)
    # A column for a few methods is shown where it says something.
    shown = [
        k
        for k, name in enumerate(header)
        if name not in hidden and (name not in SPARSE or any(row[k] for row in rows))
    ]
    header = [header[k] for k in shown]
    rows = [[row[k] for k in shown] for row in rows]
    return title(results[0]), header, rows, " ".join(captions(results))


def markdown(results: Sequence[MethodResult]) -> str:
    """A page with a table for each graph."""
    from certpgo.solve.comparison_table import TITLE, notes, title
    from certpgo.view.markdown_tables import markdown_table

    lines = [f"# {TITLE}", ""]
    for _, group in itertools.groupby(results, key=lambda result: (result.graph, result.nodes)):
        rows = list(group)
        if not rows[0].method:
            lines += [f"## {title(rows[0])}", "", rows[0].error, ""]
            continue
        heading, header, body, caption = section(rows)
        lines += [f"## {heading}", "", caption, "", *markdown_table(header, body), ""]
    for sentence in notes(results):
        lines += [sentence, ""]
    return "\n".join(lines)


def latex(results: Sequence[MethodResult]) -> str:
    """A table for each graph, to be read into a document."""
    from certpgo.solve.comparison_table import title
    from certpgo.view.latex_tables import escaped, latex_table

    lines = ["% needs \\usepackage{booktabs}"]
    for _, group in itertools.groupby(results, key=lambda result: (result.graph, result.nodes)):
        rows = list(group)
        if rows[0].method:
            lines += latex_table(*section(rows, hidden=("by phase",)))
        else:
            lines += [f"\\par {escaped(f'{title(rows[0])}: {rows[0].error}')}"]
    return "\n".join([*lines, ""])

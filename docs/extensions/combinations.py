"""Pages of what takes what, from the table of capabilities and from the rules of a study."""

from __future__ import annotations

from certpgo.graph.capabilities import FEATURES, OPERATIONS
from reports.studies.bookkeeping.covering import Rule
from reports.studies.bookkeeping.factors import REFUSED

HEAD = """\
# What does not go together

`python -m reports.studies.bookkeeping --rows 10000` draws small graphs in which every pair of
features meets: kinds of measurements and nodes, weights, costs, files, commands and their options.
Each answer is judged by costs in plain NumPy, by descents of SciPy and by all choices of what
is rejected. What is refused is refused in one line. These are the combinations:

| together with | is | because | message |
|---|---|---|---|
"""

TABLE = """\
# What takes which measurements

`certpgo.solve`, `certify` and `Session` take measurements of every kind, mixed in one graph, under
each cost that knows them. Some operations do not take everything: they refuse it in a sentence that
is read from the table below (`certpgo.graph.capabilities`). A test tries every cell.

"""


def pages() -> dict[str, str]:
    """The texts of the pages by their names."""
    return {"refused.md": HEAD + "".join(map(_row, REFUSED)), "takes.md": TABLE + _matrix()}


def _matrix() -> str:
    """A row for each operation, a column for each feature."""
    rows = [["operation", *FEATURES, "instead", "why no scales"], ["---"] * (len(FEATURES) + 3)]
    for name, operation in OPERATIONS.items():
        cells = ["no" if feature in operation.lacks else "yes" for feature in FEATURES]
        rows.append([name, *cells, operation.instead, operation.of_scales])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(rule: Rule) -> str:
    (first, *rest) = (f"{name}: {', '.join(levels)}" for name, levels in rule.levels.items())
    said = rule.said.split("|")[0].replace(".*", "...").replace("(", "")
    return f"| {first} | {'; '.join(rest)} | {rule.why} | `{said}` |\n"

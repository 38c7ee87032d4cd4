"""The page of combinations that are refused, from the rules of the study that asks for them."""

from __future__ import annotations

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


def pages() -> dict[str, str]:
    """The text of the page by its name."""
    return {"refused.md": HEAD + "".join(map(_row, REFUSED))}


def _row(rule: Rule) -> str:
    (first, *rest) = (f"{name}: {', '.join(levels)}" for name, levels in rule.levels.items())
    said = rule.said.split("|")[0].replace(".*", "...").replace("(", "")
    return f"| {first} | {'; '.join(rest)} | {rule.why} | `{said}` |\n"

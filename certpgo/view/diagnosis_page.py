"""The page of a diagnosis."""

from __future__ import annotations

from pathlib import Path

from certpgo.diagnosis import Diagnosis, Finding
from certpgo.graph.phrases import cost_shown
from certpgo.io.writing import write_text
from certpgo.view.page import page

HEADER = ("kind", "finding", "so read", "as it stands", "what to do")


def write_diagnosis_page(path: str | Path, name: str, found: Diagnosis) -> None:
    """Write a page with all findings, complete in one file.

    Parameters
    ----------
    name : what the graph is called

    Raises
    ------
    InputError
        The file cannot be written.
    """
    text = page(
        "diagnosis.html",
        name=name,
        headline=found.headline,
        header=HEADER,
        findings=[_row(finding) for finding in found.findings],
        facts=[*found.facts(shown=1)],
        environment={},
    )
    write_text(Path(path), text)


def _row(finding: Finding) -> tuple[str, ...]:
    costs = (
        "" if cost is None else cost_shown(cost) for cost in (finding.cost, finding.cost_as_given)
    )
    return (finding.kind, finding.said, *costs, finding.next)

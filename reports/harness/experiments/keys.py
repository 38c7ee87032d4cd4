"""Content keys: equal where a run would repeat the same work, whatever the captions are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Literal

from certpgo.objective.choose_cost import CHORDAL
from reports.harness.experiments.metrics import Needs, needing
from reports.harness.experiments.spec import Method, Row, Table

Profile = Literal["quick", "full"]

#: Comes before the notes of a table or figure whose results are of the quick profile.
QUICK_NOTES = "Results of the quick profile, a part of the full one, which the notes are about:"
#: Hexadecimal digits of a key.
DIGITS = 16


def record_key(
    table: Table, row: Row, place: int, method: Method, repetition: int, profile: Profile
) -> str:
    """The key of a method's records on one instance of a row, one record per component.

    Parameters
    ----------
    place : the row's place in the table, which seeds a synthetic one
    repetition : which instance of a synthetic row
    """
    asked = set(table.metrics)
    if not method.solver and method.published:
        asked &= set(method.published)
    first = [m for m in table.methods if row.runs(m)][:1] if needing(asked, Needs.FIRST) else []
    return content_key(
        {
            "table": table.name,
            "seed": [table.seed, place, repetition] if row.generator else [],
            "row": _row(row, method),
            "method": _method(method),
            "profile": profile,
            "metrics": sorted(asked),
            "certify": table.certify,
            "reference": None if table.reference is None else _method(table.reference),
            "first": [_method(other) for other in first],
        }
    )


def content_key(content: Mapping[str, Any]) -> str:
    """The first digits of the SHA-256 of canonical JSON."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), default=_as_json)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def _row(row: Row, method: Method) -> dict[str, Any]:
    return _of_another_cost(row) | {
        "label": row.label,
        "dataset": row.dataset,
        "reading": row.reading,
        "judging": row.judging,
        "rotations": row.rotations,
        "known": row.known,
        "generator": row.generator,
        "arguments": row.arguments,
        "components": row.components,
        "settings": row.settings.get(method.label, {}),
        "absent": row.absent,
    }


def _method(method: Method) -> dict[str, Any]:
    return _of_another_cost(method) | {
        "label": method.label,
        "solver": method.solver,
        "settings": method.settings,
        "start": None if method.start is None else _method(method.start),
        "engine": method.engine,
        "takes": method.takes,
        "reads_source": method.reads_source,
        "max_nodes": method.max_nodes,
    }


def _of_another_cost(spec: Row | Method) -> dict[str, Any]:
    return {} if spec.cost == CHORDAL else {"cost": spec.cost}


def _as_json(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else str(value)

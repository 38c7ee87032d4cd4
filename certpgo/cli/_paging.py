"""Writing the HTML page of a certificate (--html)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from certpgo.cli._show import notice, working

if TYPE_CHECKING:
    from certpgo.cli._reading import Reading
    from certpgo.graph import Estimate, Instance
    from certpgo.objective.choose_cost import Certifiable
    from certpgo.optimize.monitor import Iteration
    from certpgo.solve.assessment import Assessment
    from certpgo.solve.settings import SolveSettings
    from certpgo.view.certificate_page import Origin


def origin_of(
    graph: str,
    reading: Reading,
    *,
    judging: Iterable[str] = (),
    estimate: str | Path | None = None,
    proof: Path | None = None,
    method: str = "",
    meaning: str = "",
    remarks: Sequence[str] = (),
    choice: Sequence[tuple[str, str]] = (),
    partial: bool = False,
    disagreeing: bool = False,
    settings: SolveSettings | None = None,
) -> Origin:
    """Where an estimate came from; without the date, so that pages are reproducible."""
    from certpgo.linalg.factor import default_engine
    from certpgo.registry import source
    from certpgo.solve.provenance import provenance
    from certpgo.view.certificate_page import Origin

    environment = provenance(default_engine(), source())
    del environment["date"]
    return Origin(
        graph=_portable(graph),
        estimate=_portable(estimate),
        reading=tuple(arguments(reading)),
        judging=tuple(judging),
        proof=_portable(proof),
        method=method,
        meaning=meaning,
        remarks=tuple(remarks),
        choice=tuple(choice),
        partial=partial,
        disagreeing=disagreeing,
        settings=() if settings is None else tuple(_settings(settings)),
        environment=environment,
    )


def _portable(path: str | Path | None) -> str:
    """A path for readers of a page, who have other folders: as given, or the name if absolute."""
    if path is None:
        return ""
    return Path(path).name if Path(path).is_absolute() else str(path)


def write_page(
    out: Path,
    instance: Instance,
    problem: Certifiable,
    estimate: Estimate,
    assessment: Assessment,
    origin: Origin,
    trace: Sequence[Iteration] = (),
    **seen: Any,
) -> None:
    """Write the page of a certificate; ``seen`` is more of what `certificate_page` shows.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    from certpgo.io.writing import write_text
    from certpgo.view.certificate_page import certificate_page

    with working(f"drawing {instance.name}"):
        text = certificate_page(instance, problem, estimate, assessment, origin, trace, **seen)
    write_text(out, text)
    notice(f"page written to {out}")


def _settings(settings: Any, prefix: str = "") -> Iterator[str]:
    """The settings of a search as key=value."""
    for field in fields(settings):
        value = getattr(settings, field.name)
        if is_dataclass(value):
            yield from _settings(value, f"{field.name}.")
        else:
            yield f"{prefix}{field.name}={value.value if isinstance(value, Enum) else value}"


def arguments(reading: Reading) -> Iterator[str]:
    """The command-line options for this way of reading a graph."""
    for field in fields(reading):
        value = getattr(reading, field.name)
        if value == field.default or field.name == "data":
            continue
        for one in value if isinstance(value, list) else [value]:
            yield ("--no-" if one is False else "--") + field.name.replace("_", "-")
            if not isinstance(one, bool):
                yield str(one.value if isinstance(one, Enum) else one)

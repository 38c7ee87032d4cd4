"""certpgo compare: methods side by side on the same graphs."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._options import Json
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, notice, table, working
from certpgo.cli._verdict import INTERRUPTED
from certpgo.errors import CertPGOError, InputError, SpecError
from certpgo.io.plural import counted

if TYPE_CHECKING:
    from certpgo.assess.comparison import Competitor, MethodResult
    from certpgo.graph import Instance

#: Data sets compared when none is named, as far as they are here, and small files of the gtsam
#: wheel that stand in for them.
USUAL = (
    "smallGrid3D",
    "parking-garage",
    "sphere2500",
    "torus3D",
    "sphere_bignoise_vertex3",
    "cubicle",
    "MIT",
    "intel",
    "manhattan",
    "city10000",
)
STAND_INS = ("sphere2500.txt", "w100", "w10000")
QUICK = ("smallGrid3D", "MIT", "w100")


@takes_reading
def command(
    graphs: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DATASET|FILE]...", help="By default the data sets found here."),
    ] = None,
    methods: Annotated[
        str | None, typer.Option("--methods", help="Names or labels, separated by commas.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("compare-results"),
    quick: Annotated[bool, typer.Option("--quick", help="Small graphs only.")] = False,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Run methods on graphs and print cost, proven gap, verdict and time of each."""
    from dataclasses import asdict

    from certpgo.assess.comparison import METHODS, NOTES

    chosen = METHODS if methods is None else _methods(methods.split(","))
    names = tuple(dict.fromkeys(graphs)) if graphs else _usual(reading, quick)
    sources = [reading.resolve(name) for name in names]
    for source in sources:
        source.path()  # said before the work, and downloaded where it was asked for
    found: list[MethodResult] = []
    unread: list[str] = []
    interrupted = False
    try:
        for source in sources:
            try:
                parts = reading.parts(reading.open(source, notices=False))
            except CertPGOError as error:
                unread.append(str(error))
                continue
            for part in parts:
                _compare(part, chosen if methods else _suited(chosen, part), found, shown=not json)
    except KeyboardInterrupt:
        if not found:
            raise
        interrupted = True
    if not found:
        raise InputError("; ".join(unread))
    _write(out, found, interrupted)
    if json:
        document([asdict(result) for result in found])
    else:
        for sentence in NOTES:
            typer.echo(sentence)
    if interrupted:
        notice(f"interrupted with {counted(len(found), 'result{s}')}")
    notice(f"written to {out / 'compare.jsonl'} and compare.md beside it")
    for reason in unread:
        notice(f"not read: {reason}")
    return INTERRUPTED if interrupted else int(bool(unread))


def _compare(
    part: Instance, methods: Sequence[Competitor], found: list[MethodResult], *, shown: bool
) -> None:
    """Append the results on a connected graph as they are made, and show those there are."""
    from certpgo.assess.comparison import TITLE, compare

    before = len(found)
    try:
        with working(part.name) as status:

            def announce(label: str) -> None:
                status.update(f"{part.name}: {label}")

            found += compare(part, methods, announce=announce)
    finally:
        if shown and len(found) > before:
            typer.echo("" if before else f"{TITLE}\n")
            table(*_section(found[before:]))


def _section(
    results: Sequence[MethodResult],
) -> tuple[str, Sequence[str], list[Sequence[str]], str]:
    """Title, header, rows and caption of the results on one graph."""
    from certpgo.assess.comparison import COLUMNS, captions, cells, title

    rows: list[Sequence[str]] = [cells(result) for result in results]
    header: Sequence[str] = (*COLUMNS, "not run or failed")
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], [row[:-1] for row in rows]
    return title(results[0]), header, rows, " ".join(captions(results))


def _write(out: Path, results: Sequence[MethodResult], interrupted: bool) -> None:
    import json
    from dataclasses import asdict

    from certpgo.assess.comparison import NOTES, TITLE
    from certpgo.io.plain import plain
    from certpgo.io.writing import folder_to_write, write_whole
    from certpgo.view.markdown_tables import markdown_table

    lines = [f"# {TITLE}", ""]
    if interrupted:
        lines += ["**Interrupted: the results of a run that did not end.**", ""]
    for _, group in itertools.groupby(results, key=lambda result: result.graph):
        title, header, rows, caption = _section(list(group))
        lines += [f"## {title}", "", caption, "", *markdown_table(header, rows), ""]
    for sentence in NOTES:
        lines += [sentence, ""]
    folder_to_write(out)
    data = [json.dumps(plain(asdict(result)), allow_nan=False) for result in results]
    write_whole(out / "compare.jsonl", "".join(f"{line}\n" for line in data).encode())
    write_whole(out / "compare.md", "\n".join(lines).encode())


def _methods(names: Sequence[str]) -> tuple[Competitor, ...]:
    """Methods by their label among the usual ones, or by their name in the registry."""
    from certpgo import registry
    from certpgo.assess.comparison import METHODS, Competitor

    labelled = {method.label: method for method in METHODS}
    known = {*labelled, *registry.solver_names()}
    for name in names:
        if name not in known:
            raise SpecError.unknown("method", name, known)
    return tuple(labelled.get(name) or Competitor(name) for name in dict.fromkeys(names))


def _suited(methods: Sequence[Competitor], part: Instance) -> tuple[Competitor, ...]:
    """The methods for such a graph; one that was asked for by name says why it is not."""
    return tuple(method for method in methods if method.suits(part.graph))


def _usual(reading: Reading, quick: bool) -> tuple[str, ...]:
    """The usual data sets that are here, or their stand-ins."""
    from certpgo.datasets.source import resolve

    here = [
        tuple(name for name in group if resolve(name, reading.data).is_here)
        for group in (USUAL, STAND_INS)
    ]
    names = here[0] or here[1]
    if not names:
        raise InputError(
            "none of the usual data sets is here: name a graph, or pip install "
            "'certpgo[baselines]' for some; certpgo fetch brings others, --data names a folder"
        )
    return tuple(name for name in names if name in QUICK) or names[:1] if quick else names

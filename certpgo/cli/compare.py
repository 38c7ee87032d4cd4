"""certpgo compare: several methods on the same graphs."""

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
    from certpgo.datasets.source import Source
    from certpgo.graph import Instance

#: Datasets compared by default, if available locally; otherwise small files of the gtsam wheel.
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
        typer.Argument(
            metavar="[DATASET|FILE]...", help="By default the usual datasets found locally."
        ),
    ] = None,
    methods: Annotated[
        str | None, typer.Option("--methods", help="Method names or labels, separated by commas.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("compare-results"),
    quick: Annotated[bool, typer.Option("--quick", help="Only small graphs.")] = False,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Compare methods on graphs: cost, proven gap, verdict and run time of each."""
    from dataclasses import asdict

    from certpgo.assess.comparison import METHODS, NOTES

    chosen = METHODS if methods is None else _methods(methods.split(","))
    named = [reading.resolve(name) for name in dict.fromkeys(graphs or ())]
    sources = named or _usual(reading, quick)
    for source in sources:
        source.path()  # report missing files and download datasets before any work
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
                # A method requested by name is run anyway, and reports why it is unsuited.
                suited = [method for method in chosen if methods or method.suits(part.graph)]
                _compare(part, suited, found, shown=not json)
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
    notice(f"results written to {out / 'compare.jsonl'} and {out / 'compare.md'}")
    for reason in unread:
        notice(f"not read: {reason}")
    return INTERRUPTED if interrupted else int(bool(unread))


def _compare(
    part: Instance, methods: Sequence[Competitor], found: list[MethodResult], *, shown: bool
) -> None:
    """Append the results on a connected graph; on interruption, show those so far."""
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
        lines += ["**Interrupted: the results are incomplete.**", ""]
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
    """Methods by label among the default ones, or by name in the registry."""
    from certpgo import registry
    from certpgo.assess.comparison import METHODS, Competitor

    labelled = {method.label: method for method in METHODS}
    known = {*labelled, *registry.solver_names()}
    for name in names:
        if name not in known:
            raise SpecError.unknown("method", name, known)
    return tuple(labelled.get(name) or Competitor(name) for name in dict.fromkeys(names))


def _usual(reading: Reading, quick: bool) -> list[Source]:
    """The usual datasets that are available locally, or their substitutes; never other files."""
    from certpgo.datasets.source import Source

    local = [
        [s for name in group if (s := Source(name, is_file=False, data=reading.data)).is_here]
        for group in (USUAL, STAND_INS)
    ]
    found = local[0] or local[1]
    if not found:
        raise InputError(
            "none of the usual datasets is available: name a graph, download some with certpgo "
            "fetch, set --data, or pip install 'certpgo[baselines]' for small ones"
        )
    return [s for s in found if s.name in QUICK] or found[:1] if quick else found

"""certpgo compare: several methods on the same graphs."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._compared import FAILED, latex, markdown, section
from certpgo.cli._completion import graphs as graphs_named
from certpgo.cli._completion import methods as method_names
from certpgo.cli._interrupting import INTERRUPTED, tell_interrupted
from certpgo.cli._options import (
    CostOption,
    Json,
    KernelOption,
    MaxDifference,
    Timestamps,
    chosen_cost,
)
from certpgo.cli._outputs import refuse_overwriting
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._rules import Rule
from certpgo.cli._show import document, notice, paragraph, table, working
from certpgo.cli._truth import OF_TRUTH, KnownPoses, TruthFile, TruthOffset
from certpgo.errors import CertPGOError, InputError, how_to_install

if TYPE_CHECKING:
    from certpgo.graph import Graph, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.solve.comparison import Competitor, MethodResult

EXAMPLES = (
    "certpgo compare",
    "certpgo compare graph.g2o --methods certified,newton",
    "certpgo compare graph.g2o --truth truth.tum --json",
)
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
STAND_INS = ("sphere2500.txt", "w100")
#: Seconds of a method per line of a file, certified, on one core of 2024: of ours, and of other
#: programs, whose graphs are built in Python; and the least that is said.
OURS, THEIRS, SHORT = 5e-5, 3e-4, 15.0
OTHERS = ("ceres", "g2o", "gtsam")
QUICK = ("smallGrid3D", "MIT", "w100")
RULES = (Rule("--timestamps needs --truth", "timestamps", without="truth"), OF_TRUTH)


@takes_reading
def command(
    graphs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="DATASET|FILE",
            autocompletion=graphs_named,
            help="Graphs (default: the usual datasets found locally).",
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            autocompletion=method_names,
            help="Method names or labels, separated by commas.",
        ),
    ] = None,
    cost: CostOption = None,
    kernel: KernelOption = None,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")
    ] = Path("compare-results"),
    quick: Annotated[bool, typer.Option("--quick", help="Only small graphs.")] = False,
    phases: Annotated[
        bool, typer.Option("--phases", help="Show the seconds of each phase.")
    ] = False,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    truth: TruthFile = None,
    truth_offset: TruthOffset = 0.0,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Compare methods on graphs: cost, proven gap, verdict and run time of each.

    One cost judges every estimate. Methods minimise it if they can. How far each is off, in metres,
    is proven, too: no optimum is further away.
    """
    from certpgo.io.matching import Matching
    from certpgo.solve.comparison import as_data
    from certpgo.solve.comparison_table import notes

    names = _named(methods, cost, kernel)
    named = [reading.resolve(name) for name in dict.fromkeys(graphs or ())]
    sources, of_truth = named or _usual(reading, quick), reading.resolve(truth)
    for source in sources:
        source.path()  # report missing files and download datasets before any work
    if truth is not None and len(sources) > 1:
        raise InputError("--truth is for a single graph")
    how = Matching.of(timestamps, max_difference).of_truth(truth_offset)
    _announce(sources, names)
    results = _Results(out)
    refuse_overwriting(results.files, *sources, *reading.others, of_truth)
    with results.kept():
        for source in sources:
            try:
                parts, under = _parts(source, reading, timestamps, cost, kernel)
            except CertPGOError as error:
                if len(sources) == 1:
                    raise
                results.leave_out(source.name, str(error))
                continue
            for part in parts:
                known = KnownPoses.of(of_truth, part, reading, how)
                chosen = _methods(names, under, part.graph, kernel)
                judged_by = under, kernel
                _compare(part, chosen, judged_by, results, known, None if json else phases)
    if json:
        document([as_data(result) for result in results.rows])
    else:
        typer.echo()
        for sentence in notes(results.rows):
            paragraph(sentence)
    return results.told()


def _parts(
    source: Source,
    reading: Reading,
    timestamps: str | None,
    cost: str | None,
    kernel: str | None,
) -> tuple[list[Instance], str]:
    """The connected graphs of a source, and the cost that judges estimates of them.

    Raises
    ------
    CertPGOError
        It cannot be read, is not connected, or does not have this cost.
    """
    from certpgo.io.timestamps import timed
    from certpgo.objective.choose_cost import objective_of

    opened = reading.open(source, notices=False, operation="compare")
    instance = timed(opened, timestamps)
    parts = reading.parts(instance)
    under = chosen_cost(cost, instance)
    for part in parts:
        objective_of(part, under, kernel)
    return parts, under


class _Results:
    """Results, each written as a line to a file that gets its name when it is complete.

    Attributes
    ----------
    path, partial : the file of all results, and the one of those so far
    rows : the results so far
    left_out : why graphs were left out
    interrupted : whether Ctrl-C ended the comparison
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "compare.jsonl"
        self.partial = folder / "compare.jsonl.partial"
        self.rows: list[MethodResult] = []
        self.left_out: list[str] = []
        self.interrupted = False

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that are written."""
        return self.path, self.partial, *self.tables

    @property
    def tables(self) -> tuple[Path, Path]:
        """The files that show the results: Markdown and LaTeX."""
        return self.path.with_suffix(".md"), self.path.with_suffix(".tex")

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Complete the files after the block; if it is cut short, say where the results are."""
        from certpgo.graph.phrases import counted

        try:
            yield
            self.complete()
        except BaseException as error:
            if not self.rows:
                raise
            kept = f"{counted(len(self.rows), 'result{s}')} so far kept in {self.partial}"
            if not isinstance(error, KeyboardInterrupt):
                notice(kept)
                raise
            tell_interrupted(kept, [self.path, *self.tables])
            self.interrupted = True

    def told(self) -> int:
        """Say what was written and left out; returns the exit code."""
        if not self.interrupted:
            tables = " and ".join(map(str, self.tables))
            notice(f"results written to {self.path}, and as tables to {tables}")
        for reason in self.left_out:
            notice(reason)
        return INTERRUPTED if self.interrupted else int(bool(self.left_out))

    def leave_out(self, graph: str, reason: str) -> None:
        """Add a row with the reason why a graph has no results."""
        from certpgo.solve.comparison import MethodResult

        self.left_out.append(f"not compared: {reason}")
        self.add(MethodResult(graph, error=self.left_out[-1]))

    def add(self, result: MethodResult) -> None:
        """Write a result; the first one replaces those of an interrupted run."""
        import json

        from certpgo.io.json_values import plain
        from certpgo.io.writing import folder_to_write
        from certpgo.solve.comparison import as_data

        folder_to_write(self.path.parent)
        line = json.dumps(plain(as_data(result)), allow_nan=False)
        try:
            with self.partial.open("a" if self.rows else "w", encoding="utf-8") as stream:
                stream.write(f"{line}\n")
        except OSError as error:
            raise InputError(f"{self.partial}: cannot be written: {error.strerror}") from None
        self.rows.append(result)

    def complete(self) -> None:
        """Replace the results of an earlier run."""
        from certpgo.io.writing import write_text, write_whole

        for path, text in zip(self.tables, (markdown, latex), strict=True):
            write_text(path, text(self.rows))
        write_whole(self.path, self.partial.read_bytes())
        self.partial.unlink()


def _compare(
    part: Instance,
    methods: Sequence[Competitor],
    judged_by: tuple[str, str | None],
    results: _Results,
    truth: KnownPoses | None,
    phases: bool | None,
) -> None:
    """Add the results on a connected graph, and show them, with phases or not; None for not at all.

    Estimates are judged by a cost, under a kernel or none. On interruption those so far are shown.
    Without a spinner, each is printed on stderr.
    """
    from certpgo.optima import known_optimum
    from certpgo.solve.comparison import compare
    from certpgo.solve.comparison_table import OPTIONAL, TITLE, in_a_line

    in_lines = len(methods) > 1 and not sys.stderr.isatty()
    before = len(results.rows)
    try:
        with working(part.name) as status:

            def announce(label: str) -> None:
                status.update(f"{part.name}: {label}")

            errors = None if truth is None else truth.errors
            cost, kernel = judged_by
            how: dict[str, Any] = {"announce": announce, "errors": errors}
            judged = compare(part, methods, cost=cost, kernel=kernel, **how)
            for result in judged:
                results.add(result)
                if in_lines:
                    typer.echo(in_a_line(result), err=True)
    finally:
        rows = results.rows[before:]
        if phases is not None and rows:
            is_first = not any(result.method for result in results.rows[:before])
            typer.echo(f"{TITLE}\n" if is_first else "")
            hidden = (FAILED,) if phases else (FAILED, "by phase")
            table(*section(rows, hidden), optional=OPTIONAL)
            cost, kernel = judged_by
            if kernel is None and (known := known_optimum(part, cost)) is not None:
                paragraph(f"{str(known)[0].upper()}{str(known)[1:]}.")
            for result in rows:
                if result.error:
                    paragraph(f"{result.method}: {FAILED}: {result.error}")


def _announce(sources: Sequence[Source], names: Sequence[str] | None) -> None:
    """Say which of the default methods are not here, and how long it takes."""
    from certpgo.solve.comparison import METHODS

    here = _available()
    absent = dict.fromkeys(method.solver for method in METHODS if method not in here)
    if absent and names is None:
        notice(f"not compared, as these are in a checkout only: {', '.join(absent)}")
    if (about := _duration(sources, names or [method.label for method in here])) is not None:
        notice(f"this takes about {about}")


def _available() -> tuple[Competitor, ...]:
    from certpgo import registry
    from certpgo.solve.comparison import METHODS

    known = registry.solver_names()
    return tuple(method for method in METHODS if method.solver in known)


def _named(methods: str | None, cost: str | None, kernel: str | None) -> list[str] | None:
    """The methods that are named; a SpecError if one is no label under a cost and no method."""
    from certpgo import registry
    from certpgo.objective.choose_cost import COSTS
    from certpgo.solve.comparison import methods_under

    costs = tuple(COSTS) if cost is None else (cost,)
    usual = (methods_under(under, _available(), kernel or "") for under in costs)
    labels = {one.label for listed in usual for one in listed}
    known = labels.union(registry.solver_names())
    names = None if methods is None else methods.split(",")
    for name in names or ():
        if name not in known:
            raise registry.unknown_method(name, known)
    return names


def _methods(
    names: Sequence[str] | None, cost: str, graph: Graph, kernel: str | None
) -> list[Competitor]:
    """Methods by label or name, suited or not; by default those that suit the graph."""
    from certpgo.solve.comparison import Competitor, methods_under

    usual = methods_under(cost, _available(), kernel or "")
    if names is None:
        return [method for method in usual if method.suits(graph)]
    known = {method.label: method for method in usual}
    others = [Competitor(name) for name in names if name not in known]
    known |= {method.label: method for method in methods_under(cost, others, kernel or "")}
    return [known[name] for name in dict.fromkeys(names)]


def _duration(sources: Sequence[Source], names: Sequence[str]) -> str | None:
    """How long a comparison takes, roughly, from the lines of the files; None if that is short."""
    from certpgo.graph.phrases import counted

    paths = [path for source in sources if (path := source.path()).is_file()]
    lines = sum(path.read_bytes().count(b"\n") for path in paths)
    seconds = lines * sum(THEIRS if name.startswith(OTHERS) else OURS for name in names)
    if seconds < SHORT:
        return None
    if seconds < 100.0:
        return f"{round(seconds, -1):.0f} seconds"
    return counted(round(seconds / 60.0), "minute{s}")


def _usual(reading: Reading, quick: bool) -> list[Source]:
    """The usual datasets that are available locally, or their substitutes; never other files."""
    from certpgo.io.datasets.source import dataset

    local = [
        [one for name in group if (one := dataset(name, reading.data)).found is not None]
        for group in (USUAL, STAND_INS)
    ]
    found: list[Source] = [*(local[0] or local[1])]
    if not found:
        raise InputError(
            "none of the usual datasets is available: name a graph, download some with certpgo "
            f"fetch, set --data; the GTSAM wheel has small ones ({how_to_install('baselines')})"
        )
    return [s for s in found if s.name in QUICK] or found[:1] if quick else found

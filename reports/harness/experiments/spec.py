"""What a table is: rows, methods, columns and the numbers a paper printed; validated, never run."""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

from certpgo.errors import SpecError
from certpgo.graph.components import Components
from certpgo.objective.choose_cost import CHORDAL
from certpgo.solve import comparison
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.metrics import METRICS, Better, Needs, metric_of, needing

#: A reference that is not a method: one numeric factorization of the optimum's certificate matrix.
FACTORIZATION = "factorization"
FIELDS = ("verdict", "certified_by", "seconds", "status", "iterations", "counts")


def _frozen(mapping: Mapping[str, Any]) -> MappingProxyType[str, Any]:
    return MappingProxyType(dict(mapping))


# Specifications are sent to other processes.
copyreg.pickle(MappingProxyType, lambda mapping: (_frozen, (dict(mapping),)))


@dataclass(frozen=True)
class Row:
    """An instance: a dataset or file, or a synthetic one with a seed.

    Attributes
    ----------
    dataset : name in the catalogue, or path of a file; empty for a synthetic row
    label : what the table calls it, by default the dataset
    reading : options for `certpgo.io.read`
    judging : options for reading the graph that metrics are evaluated on, where it is another
    rotations : of a pose graph, the rotations alone
    known : the nodes alone whose truth is known, and the edges between them
    methods : labels of the methods that run on this row; empty for all
    generator : function of `certpgo.io.datasets.synthetic` or `certpgo.io.datasets.thesis`, called
        with ``arguments``, ``rng`` and, if it takes that, ``data``, the folder to look in first
    arguments : its keyword arguments
    published : the key of this row in the table's published numbers
    comparable : those are of this very instance; others are shown, never compared
    components : of a graph that is not connected: ``"refuse"`` it, run ``"each"`` or the
        ``"largest"``
    settings : settings of single methods in this row alone, by the method's label
    absent : why the row cannot be run by anybody, where that is known; it is shown nevertheless
    cost : the cost by which its estimates are judged, see `certpgo.objective.choose_cost`
    """

    dataset: str = ""
    label: str = ""
    reading: Mapping[str, Any] = field(default_factory=dict)
    judging: Mapping[str, Any] | None = None
    rotations: bool = False
    known: bool = False
    methods: tuple[str, ...] = ()
    generator: str = ""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    published: str = ""
    comparable: bool = True
    components: Components = "refuse"
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    absent: str = ""
    cost: str = CHORDAL

    def __post_init__(self) -> None:
        if bool(self.dataset) == bool(self.generator):
            raise SpecError(f"row {self.label!r}: give either a dataset or a generator")
        for name in ("reading", "arguments", "settings"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        if not self.label:
            object.__setattr__(self, "label", self.dataset or self.generator)

    def runs(self, method: Method) -> bool:
        """Whether the method is among the row's."""
        return not self.methods or method.label in self.methods


@dataclass(frozen=True)
class Method(comparison.Competitor):
    """A `certpgo.solve.comparison.Competitor` with what else a table says of it.

    Attributes
    ----------
    solver : name in the registry; empty for the graph itself (eigenvalues and the like)
    start : the method whose estimate is the initial one, or None
    engine : factorization engine, by default the preferred one installed
    max_nodes : larger graphs are not for it, or would take too long; None for any
    published : metric to the column of the published numbers that holds it; of no solver, the
        metrics to evaluate
    printed : what the published numbers call the method, where they have one line per method: it is
        joined to the row's key
    """

    start: Method | None = None
    engine: str = ""
    max_nodes: int | None = None
    published: Mapping[str, str] = field(default_factory=dict)
    printed: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "published", _frozen(self.published))


def extended(method: comparison.Competitor) -> Method:
    """A method of the library's comparison as one of a table."""
    start = None if method.start is None else extended(method.start)
    return Method(**{**vars(method), "start": start})


class Cause(NamedTuple):
    """Why a printed number differs, where an experiment shows it.

    Attributes
    ----------
    text : the cause
    shown : the page of ``reports/results``, without suffix, that prints the experiment's numbers
    """

    text: str
    shown: str


@dataclass(frozen=True)
class Column:
    """A metric with its title and number format.

    Attributes
    ----------
    key : one of `reports.harness.experiments.metrics.METRICS`, or a field of the record: one of
        `FIELDS`
    title : the header
    format : a format specification such as ``".6g"``
    exact : the printed numbers are of the optimum itself, or of another draw of the noise: ours
        agree or differ, and none is better
    """

    key: str
    title: str
    format: str = ".6g"
    exact: bool = False

    def __post_init__(self) -> None:
        if self.key not in METRICS and self.key not in FIELDS:
            raise SpecError.unknown("column", self.key, (*METRICS, *FIELDS))

    @property
    def better(self) -> Better:
        """Which numbers are better than printed ones, if any."""
        return "" if self.exact else metric_of(self.key).better

    @property
    def is_time(self) -> bool:
        """Whether it shows times, or ratios of times."""
        return self.key == "seconds" or metric_of(self.key).is_time


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes
    ----------
    name : name of its file
    title, source : caption, and the citation of the numbers it is compared with
    rows, methods, columns : what is run, by what, and what is shown
    stand_ins : rows that are run when no row's file is here (files in the gtsam wheel)
    optional : leave rows out whose file is not here, instead of showing them as not run
    published : file of ``reports/published``, without suffix; empty for none
    key : its column that holds a row's ``published`` key; several, joined by commas, make keys that
        are joined by slashes
    comparable : the printed numbers are of the same instances, or of draws of the same kind;
        others are shown, never compared
    paper : they are of one of the two papers that this project reproduces; others are compared,
        but not counted among the papers'
    others : their columns, or parts of their keys, that are of programs which the paper compares
        its own methods with
    summary : of the instances of a synthetic row only the ``"mean"`` is shown, or the ``"median"``
        with quartiles; empty shows each; see `reports.harness.rendering.cells` for how each is
        compared
    certify : certify every estimate
    reference : the method that the others are timed against, or None
    seed, seeds : base seed, and how many instances a synthetic row represents
    quick : labels of the rows that the quick profile keeps
    notes : sentences printed below the table
    claims : what the paper says of it in words
    explained : why printed numbers differ, where that was checked, by row, by method or by both
        with a slash between
    remarks : what was tried where it is not explained, or why a number cannot be had, by the same;
        of lines that none of the rows corresponds to, by their key or a part of it
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    methods: tuple[Method, ...]
    columns: tuple[Column, ...]
    source: str = ""
    stand_ins: tuple[Row, ...] = ()
    optional: bool = False
    published: str = ""
    key: str = "dataset"
    comparable: bool = True
    paper: bool = True
    others: tuple[str, ...] = ()
    summary: Literal["", "mean", "median"] = ""
    certify: bool = True
    reference: Method | None = None
    seed: int = 0
    seeds: int = 1
    quick: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    explained: Mapping[str, Cause] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("explained", "remarks"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        if not (self.rows and self.methods and self.columns):
            raise SpecError(f"table {self.name}: rows, methods and columns must not be empty")
        labels = [row.label for row in self.rows + self.stand_ins]
        for kind, names in (("row", labels), ("method", [m.label for m in self.methods])):
            _refuse_repetition(self.name, kind, names)
        for label in (*self.quick, *(label for claim in self.claims for label in claim.rows)):
            if label not in labels:
                raise SpecError.unknown(f"row of table {self.name}", label, labels)
        if self.reference is None and needing(self.metrics, Needs.TIMING):
            raise SpecError(f"table {self.name}: times are relative to a reference; give one")
        if any(row.cost != CHORDAL for row in self.rows) and (
            self.reference is not None or needing(self.metrics, Needs.OPTIMUM, Needs.GRAPH)
        ):
            raise SpecError(f"table {self.name}: optima and times are of the chordal cost")
        if self.seeds < 1:
            raise SpecError(f"table {self.name}: seeds must be at least 1, not {self.seeds}")

    @property
    def metrics(self) -> tuple[str, ...]:
        """Keys of the columns that are evaluated."""
        return tuple(column.key for column in self.columns if column.key in METRICS)


def _refuse_repetition(table: str, kind: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SpecError(f"table {table}: two {kind}s are called {name!r}")
        seen.add(name)

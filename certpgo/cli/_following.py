"""A session that a command feeds, and what it says at each certificate."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import INTERRUPTED
from certpgo.cli._options import chosen_cost
from certpgo.cli._reading import Reading
from certpgo.cli._show import document, notice
from certpgo.cli._verdict import rejecting_many
from certpgo.errors import GraphError, InputError

if TYPE_CHECKING:
    from certpgo import Session, Standing
    from certpgo.graph import Estimate, Instance
    from certpgo.graph.labels import Label
    from certpgo.io.datasets.source import Source
    from certpgo.solve.fit import Fit

#: The name of a graph that comes from a pipe.
PIPE = "-"


@dataclass(frozen=True)
class Newest:
    """How far every optimum can have the newest pose from where a session has it.

    Attributes
    ----------
    pose, reference : what it and the pose that it is seen from are called
    metres, degrees : None where nothing is known, and metres of rotations alone
    in_its_unit : whether metres are in the unit of the reference
    """

    pose: Label | None = None
    reference: Label | None = None
    metres: float | None = None
    degrees: float | None = None
    in_its_unit: bool = False

    @classmethod
    def of(cls, session: Session) -> Newest:
        """That of the measurements of the moment."""
        from certpgo.certify.region import limits

        found, node = session.certificate.stated_distance(), session.newest
        if found is None or node is None:
            return cls()
        pose, reference = session.nodes[node], session.nodes[found.reference]
        return cls(pose, reference, *limits(found, node), found.scales is not None)

    @property
    def sentence(self) -> str:
        """The same in words; empty where nothing is known, and for the reference itself."""
        from certpgo.certify.region import apart
        from certpgo.graph.labels import called

        if self.metres is self.degrees is None or self.pose == self.reference:
            return ""
        unit = ", in its unit" if self.in_its_unit else ""
        within = f"{called(self.pose)} within {apart(self.metres, self.degrees)} of every optimum"
        return f"{within}, seen from {called(self.reference)}{unit}"

    def as_json(self) -> dict[str, Any]:
        """The same with the keys of `_verdict.distance_as_json`; the world is null."""
        from certpgo.graph.labels import WORLD

        node, seen = [None if one is WORLD else one for one in (self.pose, self.reference)]
        return {
            "distance_m": self.metres,
            "distance_deg": self.degrees,
            "distance_node": node,
            "distance_reference": seen,
        }


@dataclass
class Followed:
    """A session, and what was proven at its last certificate.

    Attributes
    ----------
    session : robust, or not
    name : of the graph
    whole : the graph, if it is read from a file
    cost : that judges it, where it is known from the start
    trace : whether each certificate is printed
    on_refresh : is called after each certificate
    newest : where the newest pose can be, as of the last certificate, if that was printed
    options : how the measurements so far were read
    matrices : of information, of the measurements as they came, which F averages
    """

    session: Session
    name: str
    whole: Instance | None
    cost: str | None
    trace: bool
    on_refresh: Callable[[Followed], object] = lambda followed: None
    standing: Standing | None = None
    newest: Newest = field(default_factory=Newest)
    rejected: int = 0
    ended: bool = False
    options: Mapping[str, str] = field(default_factory=dict)

    def add(self, part: Instance, names: Sequence[Label], every: int, status: Any) -> None:
        """Add measurements, and refresh if as many are new."""
        try:
            self.session.add(part, names)
        except GraphError as error:
            raise GraphError(f"{self.name}: {error}") from None
        self.options = part.options
        if self.session.pending >= every:
            self.refresh(status)

    def refresh(self, status: Any) -> None:
        """Renew the certificate, and say where the verdict turned."""
        before = self.standing
        try:
            self.standing = self.session.refresh()
        except GraphError:  # what is free so far, measurements to come determine
            return
        self._note(locate=self.trace)
        status.update(self.sentence)
        if self.trace:
            typer.echo(self.sentence)
        turned = before is not None and before.verdict.value == "CERTIFIED"
        if turned and self.standing.verdict.value != "CERTIFIED" and not self._is_robust:
            self.warn()
        self.on_refresh(self)

    def end(self, status: Any) -> None:
        """The certificate of the whole, and a warning of what disagrees in it."""
        from certpgo import RobustSession

        if not self.session.nodes:
            return
        status.update(f"{self.name}: the certificate of the whole")
        if isinstance(self.session, RobustSession):
            self.standing = self.session.settle()
        else:
            self.standing = self.session.refresh()
        self._note(locate=True)
        if not self._is_robust:
            self.warn()
        self.ended = True
        self.on_refresh(self)

    def warn(self) -> None:
        """Name what disagrees, with both certificates."""
        from certpgo.graph.capabilities import lacking

        found = self.session.suspicion()
        if found is not None:
            robust = not lacking(self.session.graph, "robust session")
            notice(f"{found}; --robust leaves such measurements out" if robust else f"{found}")

    def report(self, json: bool, *, interrupted: bool = False) -> int:
        """Print the last line; returns the exit code."""
        standing = self.standing
        if json:
            document(self._report(interrupted))
        elif standing is None:
            typer.echo(f"{self.name}: nothing is proven yet")
        else:
            fit = "" if self.fit is None else f"; chi^2 {self.fit}"
            typer.echo(f"{'interrupted; so far: ' if interrupted else ''}{self.sentence}{fit}")
        for warning in _verdict.warnings(self.fit):
            notice(warning)
        if standing is not None and (many := rejecting_many(self.rejected, standing.edges)):
            notice(many)
        if interrupted:
            return INTERRUPTED
        return 0 if standing is None else _verdict.weakest([standing.verdict.value])

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of all measurements, if they came and none is put aside."""
        from certpgo.objective.choose_cost import objective_of
        from certpgo.solve.fit import fit_of

        if not self.ended or self.rejected:
            return None
        instance, estimate = self.best()
        if self.whole is None:
            instance = replace(instance, options=self.options)
        return fit_of(instance, objective_of(instance, self.cost), estimate)

    @property
    def sentence(self) -> str:
        """What is proven, in a line."""
        from certpgo.certify.wording import named_cost
        from certpgo.graph.phrases import cost_shown, counted, gap_shown

        s = self.standing
        if s is None:
            return ""
        aside = f"; {self.rejected} put aside" if self.rejected else ""
        size = f"{counted(s.nodes, 'node{s}')}, {counted(s.edges, 'measurement{s}')}"
        cost = f"{named_cost(s.objective)} = {cost_shown(s.cost)}"
        proven = f"{s.stated}: {cost}, at most {gap_shown(s.gap)} above the optimum"
        newest = f"; {self.newest.sentence}".removesuffix("; ")
        return f"{proven}; {size}{aside}{newest}"

    def best(self) -> tuple[Instance, Estimate]:
        """The graph so far and its estimate, nodes by id; the whole graph once all are there."""
        import numpy as np

        part, estimate = self.session.as_instance(self.name)
        whole = self.whole
        if whole is None:
            return part, estimate
        place = {label: k for k, label in enumerate(part.labels)}
        if len(place) == whole.graph.num_nodes:
            return whole, estimate.subset(np.array([place[label] for label in whole.labels]))
        own = dict(zip(whole.labels, whole.ids.tolist(), strict=True))
        ids = np.array([own[label] for label in part.labels])
        return replace(part, ids=ids, moved_by=whole.moved_by), estimate

    @property
    def _is_robust(self) -> bool:
        return hasattr(self.session, "rejected")

    def _note(self, *, locate: bool) -> None:
        """What is rejected; if asked for, where the newest pose can be, which takes a bound."""
        self.rejected, self.newest = len(getattr(self.session, "rejected", ())), Newest()
        if locate:
            with suppress(GraphError):  # not all nodes are determined yet
                self.newest = Newest.of(self.session)
                self.standing = self.session.standing

    def _report(self, interrupted: bool) -> dict[str, Any]:
        from dataclasses import asdict

        fit = None if self.fit is None else _verdict.fit_as_json(self.fit)
        proven = {} if self.standing is None else asdict(self.standing)
        return {
            "graph": self.name,
            **proven,
            **self.newest.as_json(),
            "rejected": self.rejected,
            "interrupted": interrupted,
            "fit": fit,
        }


@dataclass(frozen=True)
class Stream:
    """Measurements as they come, and the cost that they are judged by.

    Attributes
    ----------
    whole : the graph that is read from a file; None for a pipe
    parts : measurements with the names of their nodes
    cost : None where the first measurements of a pipe tell it
    name : of a pipe, in messages
    counts : of lines of a pipe that notices are about, by what they are, so far
    """

    whole: Instance | None
    parts: Iterator[tuple[Instance, Sequence[Label]]]
    cost: str | None
    name: str = ""
    counts: Counter[str] = field(default_factory=Counter)

    @classmethod
    def of(cls, source: Source | None, every: int, reading: Reading, cost: str | None) -> Stream:
        """Open a file, a named pipe, or standard input if there is none.

        Raises
        ------
        InputError
            The file has several components, or an option is for files alone.
        """
        from certpgo.graph.streaming import streamed
        from certpgo.io.pipes import is_pipe
        from certpgo.io.stream import NAME
        from certpgo.objective.choose_cost import CHORDAL

        pipe = None if source is None else source.found
        if source is not None and not (pipe is not None and is_pipe(pipe)):
            parts = reading.parts(reading.open(source, operation=None))
            if len(parts) != 1:
                raise InputError("follow takes one component: --components largest")
            own = chosen_cost(cost, parts[0])
            return cls(parts[0], streamed(parts[0], every), own)  # type: ignore[arg-type]
        if reading.keep.value != "all":
            kept = f"--keep {reading.keep.value}"
            raise InputError(f"{kept} is for files: a pipe keeps all measurements")
        counts, name = Counter[str](), NAME if source is None else source.name
        coming = _piped(pipe, name, every, reading, counts)
        return cls(None, coming, CHORDAL if reading.rotations else cost, name, counts)

    def totals(self) -> Iterator[str]:
        """How many lines of a pipe were skipped or are unusual, one sentence each."""
        from certpgo.graph.phrases import counted

        for what, count in self.counts.items():
            if count:
                yield f"{self.name}: {counted(count, what)}"


def _piped(
    path: Path | None, name: str, every: int, reading: Reading, counts: Counter[str]
) -> Iterator[tuple[Instance, Sequence[Label]]]:
    """Measurements from a pipe; what is left out of it is said when it first comes."""
    from certpgo.graph.components import rotations_alone
    from certpgo.io.stream import piped

    said = set[str]()
    kept = {"name": name, "counts": counts, "say": notice, **reading.options}
    with nullcontext(sys.stdin.buffer) if path is None else path.open("rb") as pipe:
        for part in piped(pipe, every, **kept):
            sentences = [what.replace("{s}", "s") for what, count in counts.items() if count]
            sentences += [sentence for sentence in part.notices if not sentence[0].isdigit()]
            for sentence in sentences:
                if sentence not in said:
                    said.add(sentence)
                    notice(f"{name}: {sentence}")
            piece = rotations_alone(part) if reading.rotations else part
            yield piece, piece.labels

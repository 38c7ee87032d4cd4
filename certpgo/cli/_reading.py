"""The options for reading a graph, shared by several commands."""

from __future__ import annotations

import functools
import inspect
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints, overload

import typer

from certpgo.cli._help import READING
from certpgo.cli._show import notice, noticing, progress_bar
from certpgo.errors import GraphError, InputError

if TYPE_CHECKING:
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.matching import Matching

#: Seconds of reading after which a progress bar appears.
PATIENCE = 1.0


class Keep(StrEnum):
    """Which of several measurements between two nodes to keep."""

    ALL = "all"
    FIRST = "first"
    LAST = "last"


class About(StrEnum):
    """Coordinates of the rotational information in a file."""

    TANGENT = "tangent"
    QUATERNION = "quaternion"
    RPY = "rpy"


class Stated(StrEnum):
    """What the numbers of a measurement's precision in a file are."""

    INFORMATION = "information"
    SQRT_INFORMATION = "sqrt-information"
    COVARIANCE = "covariance"


class Components(StrEnum):
    """How to treat a graph with several components."""

    REFUSE = "refuse"
    EACH = "each"
    LARGEST = "largest"


def _option(name: str, help: str, metavar: str | None = None) -> Any:
    return typer.Option(name, help=help, metavar=metavar, rich_help_panel=READING)


@dataclass(frozen=True)
class Reading:
    """How graphs are read; each field is an option of every command that reads one."""

    keep: Annotated[
        Keep, _option("--keep", help="Which of several measurements between two nodes to keep.")
    ] = Keep.ALL
    rotation_information: Annotated[
        About | None,
        _option(
            "--rotation-information",
            help="Coordinates of the file's rotational information (default: those of the format): "
            "tangent vector, quaternion vector, or roll-pitch-yaw.",
        ),
    ] = None
    kappa: Annotated[
        float | None,
        _option("--kappa", help="Set the rotational weight of every measured rotation."),
    ] = None
    tau: Annotated[
        float | None, _option("--tau", help="Set the weight of every measured translation, 1/m^2.")
    ] = None
    unit_weights: Annotated[
        bool, _option("--unit-weights", help="Set all weights to 1, ignoring the file's.")
    ] = False
    mahalanobis: Annotated[bool, typer.Option("--mahalanobis", hidden=True)] = False
    weights_are: Annotated[
        Stated | None,
        _option(
            "--weights-are",
            help="How to interpret the file's precision values (default: information).",
        ),
    ] = None
    priors: Annotated[
        bool,
        _option("--priors/--no-priors", help="Read or skip priors, such as GPS."),
    ] = True
    landmarks: Annotated[
        bool,
        _option("--landmarks/--no-landmarks", help="Read or skip landmarks and their sightings."),
    ] = True
    fixed: Annotated[
        bool,
        _option(
            "--fixed/--no-fixed",
            help="Hold or release nodes that the file fixes (FIX), of similarities the scale too.",
        ),
    ] = True
    also: Annotated[
        list[str] | None,
        _option(
            "--also",
            help="Read this file too, as one graph: ids mean the same nodes (repeatable).",
            metavar="FILE",
        ),
    ] = None
    skip: Annotated[
        list[str] | None,
        _option("--skip", help="Leave out lines with this tag (repeatable).", metavar="TAG"),
    ] = None
    components: Annotated[
        Components,
        _option("--components", help="Which components of a disconnected graph to use."),
    ] = Components.REFUSE
    rotations: Annotated[
        bool, _option("--rotations", help="Ignore translations: rotation averaging.")
    ] = False
    topic: Annotated[
        str | None,
        _option("--topic", help="Topic to read from a ROS bag that has several.", metavar="NAME"),
    ] = None
    data: Annotated[
        Path | None,
        _option("--data", metavar="DIR", help="Folder in which to look for datasets first."),
    ] = None

    def __post_init__(self) -> None:
        """Refuse an option of earlier versions."""
        if self.mahalanobis:
            raise InputError(
                "--mahalanobis is for Python only, as read(..., mahalanobis=True): use --cost g2o "
                "or --cost gtsam, which take the file's full information matrices"
            )

    @overload
    def resolve(self, name: str) -> Source: ...
    @overload
    def resolve(self, name: str | None) -> Source | None: ...
    def resolve(self, name: str | None) -> Source | None:
        """The file or dataset with this path or name; called once, before any work.

        Raises
        ------
        InputError
            There is neither.
        """
        from certpgo.io.datasets.source import resolve

        if name is None:
            return None
        source = resolve(name, self.data)
        if source.hides_dataset:
            notice(f"{name} is a file here; the dataset of that name is not used")
        return source

    @property
    def others(self) -> list[Source]:
        """The files that are read as one graph with the first."""
        return [self.resolve(name) for name in self.also or ()]

    def of_all(self, graphs: list[str]) -> tuple[str, Reading]:
        """The first of several files, and how it is read with the others as one graph."""
        first, *rest = graphs
        return first, replace(self, also=[*rest, *(self.also or [])] or None)

    def topic_of(self, source: Source) -> str | None:
        """The topic that is chosen, if this is a bag."""
        from certpgo.io.format import has_topics

        return self.topic if self.topic is not None and has_topics(source.path()) else None

    @property
    def options(self) -> dict[str, Any]:
        """The options of `certpgo.io.read`."""
        about = self.rotation_information
        return {
            "keep": self.keep.value,
            "rotation_information": None if about is None else about.value,
            "kappa": self.kappa,
            "tau": self.tau,
            "unit_weights": self.unit_weights,
            "weights_are": None if self.weights_are is None else self.weights_are.value,
            "priors": self.priors,
            "landmarks": self.landmarks,
            "fixed": self.fixed,
            "skip": tuple(self.skip or ()),
        }

    def open(
        self, source: Source, *, notices: bool = True, operation: str | None = "tables"
    ) -> Instance:
        """Read the graph; with ``notices``, print its notices to stderr.

        Raises
        ------
        InputError
            The ``operation`` of `certpgo.graph.capabilities` does not take it.
        """
        from certpgo.graph.capabilities import require_capable
        from certpgo.graph.components import rotations_alone

        with _reading_progress() as progress:
            chosen: dict[str, Any] = {}
            if self.also:
                chosen["also"] = [other.path() for other in self.others]
            if topic := self.topic_of(source):
                chosen["topic"] = topic
            instance = source.graph(progress=progress, quiet=True, **self.options, **chosen)
        if operation is not None:
            require_capable(instance.graph, operation, str(source.path()))
        if notices:
            self.tell(instance)
        return rotations_alone(instance) if self.rotations else instance

    @staticmethod
    def tell(instance: Instance) -> None:
        """Print what was noticed when a graph was read."""
        for sentence in instance.notices:
            notice(f"{instance.name}: {sentence}")

    def parts(self, instance: Instance) -> list[Instance]:
        """The connected graphs to work on.

        Raises
        ------
        GraphError
            The graph is not connected, and ``--components`` is ``refuse``.
        """
        from certpgo.graph.components import connected_parts
        from certpgo.graph.phrases import counted

        try:
            parts = connected_parts(instance, self.components.value)
        except GraphError as error:
            raise GraphError(
                f"{instance.source or instance.name}: {error}; "
                "--components largest takes the largest one, --components each all of them",
                component_sizes=error.component_sizes,
            ) from None
        alone = sum(size == 1 for size in instance.graph.component_sizes)
        if alone and instance.graph.ranges is None and not instance.graph.is_connected:
            notice(f"left out: {counted(alone, 'node{s}')} without measurements")
        return parts


def takes_reading(command: Callable[..., int | None]) -> Callable[..., int | None]:
    """Replace a command's parameter ``reading`` by the options of `Reading`.

    A command's own option takes the place of one for reading that has its name.
    """
    hints = get_type_hints(command, include_extras=True)
    own = [
        parameter.replace(annotation=hints[name])
        for name, parameter in inspect.signature(command).parameters.items()
        if name != "reading"
    ]
    kinds = get_type_hints(Reading, include_extras=True)
    shared = [
        parameter.replace(annotation=kinds[name], kind=inspect.Parameter.KEYWORD_ONLY)
        for name, parameter in inspect.signature(Reading).parameters.items()
        if name not in hints
    ]

    @functools.wraps(command)
    def with_reading(**kwargs: Any) -> int | None:
        reading = Reading(**{p.name: kwargs.pop(p.name) for p in shared})
        if reading.topic is not None and not _have_bags(kwargs.values()):
            raise InputError("--topic is for ROS bags, and none is given")
        return command(**kwargs, reading=reading)

    keyword = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    with_reading.__signature__ = inspect.Signature([*keyword, *shared])  # type: ignore[attr-defined]
    with_reading.__annotations__ = {p.name: p.annotation for p in [*keyword, *shared]}
    return with_reading


def _have_bags(arguments: Iterable[Any]) -> bool:
    """Whether some argument, or an item of one, is a file with topics."""
    from certpgo.io.format import has_topics

    listed = [one for given in arguments for one in (given if _is_list(given) else [given])]
    return any(has_topics(Path(one)) for one in listed if isinstance(one, str | Path))


def _is_list(given: object) -> bool:
    return isinstance(given, list | tuple)


def restricted_to(part: Instance, estimate: Estimate, instance: Instance) -> Estimate:
    """An estimate of the whole instance for one of its parts."""
    from certpgo.io.matching import places

    if part is instance:
        return estimate
    return estimate.subset(places(part.ids, instance.ids))


def covered(
    source: Source, instance: Instance, reading: Reading, how: Matching
) -> tuple[Instance, Estimate]:
    """The estimate in a file, and the instance of the nodes that it has; a notice says if not all.

    Raises
    ------
    FormatError
        The file cannot be read, or is of another graph.
    """
    import numpy as np

    from certpgo.graph.components import restricted
    from certpgo.graph.phrases import counted
    from certpgo.io.estimates import read_part

    path = source.path()
    with noticing():
        nodes, estimate = read_part(path, instance, how, topic=reading.topic_of(source))
    n = instance.graph.num_nodes
    if len(nodes) == n:
        return instance, estimate
    count = f"{len(nodes)} of {n} nodes"
    between = np.isin(instance.graph.edges, nodes).all(axis=1)
    if not between.any():
        raise InputError(f"{path}: poses of {count}, and no measurements between these")
    measured = counted(int(between.sum()), "measurement{s}")
    said = f"poses of {count}: judged by the {measured} between these"
    notice(f"{path}: {said}")
    part = restricted(instance, nodes, f"{instance.name} [{count}]")
    return replace(part, notices=(*part.notices, said)), estimate


@contextmanager
def _reading_progress() -> Iterator[Callable[[int, int], None]]:
    """A callback that shows a progress bar on a terminal once reading takes `PATIENCE`."""
    start = time.perf_counter()
    bar = None

    def advance(done: int, total: int) -> None:
        nonlocal bar
        if bar is None and sys.stderr.isatty() and time.perf_counter() - start > PATIENCE:
            bar = progress_bar("reading")
        if bar is not None:
            bar.advance(done, total)

    try:
        yield advance
    finally:
        if bar is not None:
            bar.close()

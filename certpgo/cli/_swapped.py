"""Arguments in the wrong order are recognised, and the right order is named."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from certpgo.errors import CertPGOError, InputError

if TYPE_CHECKING:
    from certpgo.io.datasets.source import Source


@contextmanager
def graph_comes_first(command: str, graph: Source, others: Sequence[Source]) -> Iterator[None]:
    """Where reading the graph fails and another argument is one, the error says so."""
    try:
        yield
    except InputError as error:
        if not others or not _is_graph(others[0]):
            raise
        first, *rest = (other.name for other in others)
        line = " ".join(["certpgo", command, first, graph.name, *rest])
        advice = f"{first} is a graph, and the graph comes first: {line}"
        raise InputError(f"{error}; {advice}") from None


def _is_graph(source: Source) -> bool:
    try:
        return source.graph(download=False, quiet=True).graph.num_edges > 0
    except CertPGOError:
        return False

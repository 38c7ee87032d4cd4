"""What takes which measurements: one table, from which refusals and the site's matrix are read.

An operation that is not listed, or a feature that its row leaves out, is taken. What a single cost
or file format does not know, is said by that: see `certpgo.objective.choose_cost` and
`certpgo.io.unwritten`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from certpgo.errors import SpecError, refuse
from certpgo.graph.kinds import Kind
from certpgo.graph.ranges import Ranges


@dataclass(frozen=True)
class Feature:
    """What a graph may have.

    Attributes
    ----------
    called : in sentences, such as ``"distances"``
    is_in : whether a graph has it
    """

    called: str
    is_in: Callable[[Any], bool]


@dataclass(frozen=True)
class Operation:
    """What takes graphs.

    Attributes
    ----------
    does : subject and verb of a sentence that goes on with "not take"
    lacks : names of the features that it does not take
    instead : what takes them, the end of a sentence
    of_scales : why it does not take nodes of unknown scale
    """

    does: str
    lacks: tuple[str, ...]
    instead: str = ""
    of_scales: str = ""


FEATURES = {
    "distances": Feature("distances", lambda graph: _has(graph, distances=True)),
    "own kinds": Feature("other measurements", lambda graph: _has(graph, distances=False)),
    "inertial": Feature("preintegrated measurements", lambda graph: _is_inertial(graph)),
    "scales": Feature("nodes of unknown scale (similarities)", lambda graph: graph.has_scales),
    "partial edges": Feature(
        "edges that measure only a rotation or a translation, or points",
        lambda graph: graph.is_partial,
    ),
    "matrix weights": Feature("matrix weights or couplings", lambda graph: graph.has_couplings),
    "arms": Feature(
        "arms, as of mounted sensors and held poses", lambda graph: graph.arms is not None
    ),
}

_BLOCKS = "distances", "own kinds", "inertial"
#: What grows, or is rejected, a measurement at a time.
_UNSTREAMED = "inertial", "scales"
_FULLY = "certpgo.solve and certify do"
#: Why nodes of unknown scale are not taken where measurements are judged by their noise.
_NO_LAW = "one kappa weighs rotation and scale, so that weights state no law of noise"
_OF_POSES = "its methods are of rotations and positions"

#: By the name that code and options have for it.
OPERATIONS = {
    "priors": Operation("priors do", ("matrix weights", "arms"), "add them before"),
    "directions": Operation(
        "directions do", ("scales",), of_scales="their terms would measure scales, too"
    ),
    "joint graph": Operation("a joint graph does", ()),
    "loop closures": Operation("a choice of loop closures does", ()),
    "merge": Operation("certpgo merge does", ("inertial",), _FULLY),
    "robust merge": Operation(
        "certpgo merge --robust does", _UNSTREAMED, "it does without", _NO_LAW
    ),
    "session": Operation("a session does", ("inertial",), _FULLY),
    "robust session": Operation("a robust session does", _UNSTREAMED, _FULLY, _NO_LAW),
    "follow": Operation("certpgo follow does", ("inertial",), _FULLY),
    "robust fit": Operation("a robust fit does", _UNSTREAMED, _FULLY, _NO_LAW),
    "rejections": Operation(
        "a truncated cost does",
        ("scales",),
        of_scales="what is below a term grows with the scale of a node, beyond any price",
    ),
    "compare": Operation("a comparison does", ()),
    "bounds": Operation("this command does", ("scales",), _FULLY, _OF_POSES),
    "kernel": Operation(
        "a robust kernel does",
        ("scales", "matrix weights"),
        of_scales="what is below a term grows with the scale of a node, beyond any kernel",
    ),
    "tables": Operation(
        "this command does", (*_BLOCKS, "scales"), "certpgo solve and certify do", _OF_POSES
    ),
    "isotropic method": Operation(
        "this method does",
        (*_BLOCKS, "scales", "partial edges", "matrix weights", "arms"),
        of_scales="it is of rotations and positions",
    ),
    "method": Operation(
        "--method does", (*_BLOCKS, "scales"), "certpgo solve does without", _OF_POSES
    ),
    "proof": Operation(
        "--proof does", ("own kinds", "inertial"), "the checker does not know what these cost"
    ),
    "outliers": Operation("certpgo outliers does", _UNSTREAMED, _FULLY, _NO_LAW),
    "covariances": Operation("--covariances do", ("scales",), of_scales=_NO_LAW),
    "regions": Operation("--regions do", ("scales",), of_scales=_NO_LAW),
    "robust": Operation("--robust does", _UNSTREAMED, _FULLY, _NO_LAW),
}


def lacking(graph: Any, operation: str) -> str:
    """Why an operation does not take a graph, in a sentence without its end; empty if it does.

    Raises
    ------
    SpecError
        No such operation is in the table.
    """
    row = OPERATIONS.get(operation)
    if row is None:
        raise SpecError.unknown("operation", operation, OPERATIONS)
    for name in row.lacks:
        if FEATURES[name].is_in(graph):
            said = f"{row.does} not take {FEATURES[name].called}"
            said += f": {row.of_scales}" if name == "scales" and row.of_scales else ""
            return f"{said}; {row.instead}" if row.instead else said
    return ""


def require_capable(graph: Any, operation: str, source: str = "") -> None:
    """Refuse a graph that an operation does not take, as `lacking` says.

    Parameters
    ----------
    source : where it is from, to begin the message

    Raises
    ------
    InputError
        The operation does not take it.
    """
    refuse(lacking(graph, operation), source)


def _has(graph: Any, *, distances: bool) -> bool:
    known = (of for of in graph.blocks if of.kind is not Kind.INERTIAL)
    return any((type(block) is Ranges) is distances for block in known)


def _is_inertial(graph: Any) -> bool:
    return any(block.kind is Kind.INERTIAL for block in graph.blocks)

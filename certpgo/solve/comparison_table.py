"""The results of a comparison as tables: titles, columns, captions and notes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from certpgo.certify.certificate import CHORDAL as OF_F
from certpgo.certify.wording import named_cost
from certpgo.graph.phrases import counted, reading_sentence, rounded_up
from certpgo.objective.choose_cost import CHORDAL
from certpgo.solve.comparison import OF_THE_FILE, MethodResult

TITLE = "Methods side by side, every estimate certified by the same procedure"
_ON_COSTS = (
    "{cost}. f_ML is the log-likelihood of Moreira's thesis, with unit weights. No estimate of the "
    "graph costs less than this one by more than the gap. In no optimum is any node further from "
    "where it is here than the distance 'off by', seen from one pose. Both are proven. If a method "
    "rejects measurements (see the share kept), {name}, gap, verdict and distance are about the "
    "kept ones, and f_ML about all. CERTIFIED: the gap is at most {tolerance}. BOUNDED: it is "
    "larger. REFUTED: a better estimate is known, and local descent from this one does not reach "
    "it."
)
#: Notes printed below the tables; see `notes`.
NOTES = (
    _ON_COSTS.format(
        cost="F is the weighted squared error that is minimised",
        name="F",
        tolerance="1e-5 F plus 1e-12 of the total weight, the latter at most 1e-3 F",
    ),
    "GTSAM gets the weights of F: its own error then differs from F by terms of fourth order in "
    "the residuals.",
    f"In the row {OF_THE_FILE}, GTSAM reads the file itself, if it can, and minimises its own "
    "error with the file's full information matrices.",
    "Seconds are those of one run, without reading and certifying.",
    "Ceres' residuals are computed in Python, which is the phase evaluate of its seconds.",
)
#: Methods without which a note is left out, by the beginnings of their labels.
_ABOUT = {NOTES[1]: "gtsam", NOTES[2]: OF_THE_FILE, NOTES[4]: "ceres"}
#: The notes under the cost of another program; what GTSAM gets is said for each of its methods.
_OWN_NOTES = (
    _ON_COSTS.format(
        cost="The cost is that of each table's title, whatever a method minimises",
        name="the cost",
        tolerance="1e-5 of the cost plus 1e-12 of the total weight, the latter at most 1e-3 of the "
        "cost",
    ),
    *NOTES[2:],
)
#: Column titles of `cells`; see `columns`.
COLUMNS = (
    "method",
    "F",
    "f_ML",
    "gap",
    "gap / F",
    "verdict",
    "off by",
    "kept, %",
    "ATE",
    "RPE",
    "seconds",
    "by phase",
)
#: Those that a narrow table leaves out, the least needed first.
OPTIONAL = ("f_ML", "gap", "RPE", "kept, %", "seconds")


def notes(results: Iterable[MethodResult]) -> tuple[str, ...]:
    """The notes about these methods and the costs that judge them."""
    said = {
        note
        for result in results
        for note in (NOTES if result.objective == OF_F else _OWN_NOTES)
        if result.method and result.method.startswith(_ABOUT.get(note, ""))
    }
    return tuple(note for note in (*_OWN_NOTES[:1], *NOTES) if note in said)


def title(result: MethodResult) -> str:
    """Name and size of the graph, and the cost."""
    if result.nodes is None or result.edges is None or result.d is None:
        return result.graph
    size = sizes(result.nodes, result.edges, result.d)
    return f"{result.graph} ({size}): {named_cost(result.objective)}"


def columns(result: MethodResult) -> tuple[str, ...]:
    """The column titles for the result's objective."""
    if result.objective == OF_F:
        return COLUMNS
    return tuple({"F": "cost", "gap / F": "gap / cost"}.get(name, name) for name in COLUMNS)


def sizes(nodes: int, edges: int, d: int) -> str:
    """The size of a graph in words."""
    return f"{counted(nodes, 'node{s}')}, {counted(edges, 'edge{s}')}, {d}D"


def captions(results: Sequence[MethodResult]) -> Iterator[str]:
    """How the graph was read, which methods minimise the cost, and their remarks."""
    yield f"Read with {reading_sentence(results[0].reading)}."
    minimising = [result.method for result in results if result.minimised != CHORDAL]
    if results[0].objective != OF_F:
        yield f"Methods that minimise the cost: {', '.join(minimising) or 'none'}."
    yield from remarks((result.method, result.note) for result in results)


def remarks(notes: Iterable[tuple[str, str]]) -> Iterator[str]:
    """One sentence per distinct note, naming its methods."""
    methods: dict[str, list[str]] = {}
    for method, note in notes:
        if note:
            methods.setdefault(note, []).append(method)
    for note, names in methods.items():
        yield f"{', '.join(names)}: {note}."


def cells(result: MethodResult) -> tuple[str, ...]:
    """A method's row: one text per column of `COLUMNS`, then the error."""
    kept = None if result.kept is None else 100.0 * result.kept
    return (
        result.method,
        _at_most(result.certified_cost, 9, "g"),
        _number(result.f_ml, ".7g"),
        _at_most(result.gap, 3, "e"),
        _at_most(result.relative_gap, 2, "e"),
        result.verdict,
        _off(result),
        _number(kept, ".1f"),
        _accuracy(result.accuracy, "ate"),
        _accuracy(result.accuracy, "rpe"),
        f"{sum(result.seconds.values()):.3f}" if result.seconds else "",
        _phases(result.seconds),
        result.error,
    )


def _at_most(value: float | None, digits: int, form: str) -> str:
    """An upper bound, rounded up to so many digits."""
    if value is None:
        return ""
    return f"{float(rounded_up(value, digits)):.{digits - (form == 'e')}{form}}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _accuracy(accuracy: Mapping[str, float | None], kind: str) -> str:
    """An error of positions, or of rotations where there are none."""
    metres, degrees = accuracy.get(f"{kind}_m"), accuracy.get(f"{kind}_deg")
    if metres is not None:
        return f"{metres:.4g} m"
    return "" if degrees is None else f"{degrees:.4g} deg"


def _off(result: MethodResult) -> str:
    """The distance from every optimum; of rotations alone the angle."""
    if result.distance_m is not None:
        return f"{rounded_up(result.distance_m, 3)} m"
    degrees = result.distance_deg
    return "" if degrees is None else f"{rounded_up(degrees, 3)} deg"


def _phases(phases: Mapping[str, float]) -> str:
    """Seconds of each phase, if there are several."""
    return ", ".join(f"{k} {v:.3f}" for k, v in phases.items()) if len(phases) > 1 else ""


def seconds_by_phase(phases: Mapping[str, float]) -> str:
    """Total seconds, and those of each phase if there are several."""
    if not phases:
        return ""
    parts = _phases(phases)
    return f"{sum(phases.values()):.3f}" + (f" ({parts})" if parts else "")


def in_a_line(result: MethodResult) -> str:
    """A method's result in a line, as it is printed while others run."""
    said = f"{result.graph}: {result.method}: "
    if result.certified_cost is None or result.relative_gap is None:
        return f"{said}{result.error}"
    cost = _at_most(result.certified_cost, 9, "g")
    gap = _at_most(result.relative_gap, 2, "e")
    cost = f"cost {cost}, gap {gap} of it"
    return f"{said}{result.verdict}, {cost}, {sum(result.seconds.values()):.3f} s"

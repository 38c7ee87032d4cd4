"""Counts, bounds, weights and sources in words, and names and values in lines."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from pathlib import Path

from certpgo.linalg.arrays import FloatArray

#: Least number of characters for a value, however long its name.
ROOM = 24
#: Ratio of a matrix's eigenvalues from which it counts as anisotropic.
ROUND = 1.01
#: How texts have bytes of file names that are no UTF-8.
NO_UTF8 = "backslashreplace"
#: Bits of the index of GTSAM's Symbols, which are keys of eight bytes.
INDEX_BITS = 56


def counted(count: int, what: str) -> str:
    """The count and what is counted, ``{s}`` marking its plural: 1 node, 2 nodes."""
    return f"{count} {what.replace('{s}', '' if count == 1 else 's')}"


def in_utf8(text: str) -> str:
    """A text with escapes for bytes of file names that are no UTF-8."""
    return text.encode(errors=NO_UTF8).decode()


def rounded_up(value: float, digits: int) -> str:
    """An upper bound to so many digits: it still is one."""
    return _rounded(value, digits, ROUND_CEILING)


def rounded_down(value: float, digits: int) -> str:
    """A lower bound to so many digits: it still is one."""
    return _rounded(value, digits, ROUND_FLOOR)


def cost_shown(value: float) -> str:
    """A cost that belongs to a verdict: rounded up, wherever it is printed."""
    return rounded_up(value, 12)


def bound_shown(value: float) -> str:
    """A lower bound: rounded down, wherever it is printed."""
    return rounded_down(value, 12)


def gap_shown(value: float) -> str:
    """A gap: rounded up, wherever it is printed."""
    return rounded_up(value, 3)


def _rounded(value: float, digits: int, way: str) -> str:
    if math.isfinite(value):
        value = float(Context(digits, way).create_decimal(Decimal(value)))
    return f"{value:.{digits}g}"


def aligned(pairs: Iterable[tuple[str, str]], width: int | None = None) -> Iterator[str]:
    """Lines of names and values in two columns; words wrap within ``width`` characters, if any."""
    listed = list(pairs)
    column = max((len(name) for name, _ in listed), default=0) + 2
    for name, value in listed:
        room = len(value) if width is None else max(width - column, ROOM)
        # Words alone are broken: never a number, a path or a verdict.
        parts = textwrap.wrap(value, max(room, 1), break_long_words=False, break_on_hyphens=False)
        yield f"{name:<{column}}{parts[0] if parts else ''}".rstrip()
        yield from (" " * column + part for part in parts[1:])


def size_in_words(poses: int, points: int, edges: int, d: int, *, kind: str = "poses") -> str:
    """The size of a graph."""
    of_points = f" and {counted(points, 'point{s}')}" if points else ""
    return f"{counted(poses, f'{kind[:-1]}{{s}}')}{of_points}, {counted(edges, 'edge{s}')}, {d}D"


def ranges_of_weights(
    kappa: FloatArray, tau: FloatArray | None, area: str = "m^2"
) -> Iterator[tuple[str, str]]:
    """The ranges of the concentrations (m,); those of edges without are left out."""
    units = (("kappa", kappa, "(rotational weights)"), ("tau", tau, f"per {area} (translational)"))
    for name, weights, unit in units:
        if weights is not None and len(known := weights[weights > 0.0]):
            low, high = f"{known.min():.6g}", f"{known.max():.6g}"
            yield name, f"{low if low == high else f'{low} to {high}'} {unit}"


#: What the numbers in a file are, by the option that says so.
_STATED = {
    "information": "information matrices",
    "covariance": "covariances",
    "sqrt-information": "square roots of information matrices",
    "disparities": "disparities and calibration",
}


def reading_sentence(reading: Mapping[str, str]) -> str:
    """How a file was read, in words."""
    if not reading:
        return "as generated"
    weights, information = reading.get("weights", "file"), reading.get("information", "all")
    stated = _STATED[reading.get("weights_are", "information")]
    of_file = weights == "file" and information != "none"
    if information == "none" and weights in ("file", "unit"):
        sentence = "weights 1: the file has no information"
    elif weights == "synthetic":
        sentence = "weights as generated"
    elif weights == "unit":
        sentence = "all weights 1, ignoring those of the file"
    elif weights == "mahalanobis":
        sentence = f"Mahalanobis weights from the file's {stated}"
    elif of_file:
        rest = ", 1 where it has none" if information == "some" else ""
        sentence = f"weights from the file's {stated}{rest}"
    else:
        sentence = f"weights {weights}"
    about = reading.get("rotation_information", "tangent")
    if of_file and about != "tangent":
        sentence += f" (rotational part read as {about})"
    keep = reading.get("keep", "all")
    parallel = "parallel edges added" if keep == "all" else f"only the {keep} of parallel edges"
    return f"{sentence}; {parallel}"


def averaged(anisotropy: tuple[float, float]) -> str:
    """That weights average over directions, from `Information.anisotropy`; or empty."""
    parts = [
        f"{ratio:.3g} in {what}"
        for ratio, what in zip(anisotropy, ("translation", "rotation"), strict=True)
        if ratio > ROUND
    ]
    if not parts:
        return ""
    return f"over directions (anisotropy up to {' and '.join(parts)})"


def shown_path(path: str | Path) -> str:
    """A path below the working folder relative to it, else the file's name: never absolute."""
    given = Path(path)
    if not given.is_absolute():
        return str(path)
    here = Path.cwd()
    return str(given.relative_to(here)) if given.is_relative_to(here) else given.name


def solving(component_sizes: Sequence[int]) -> str:
    """What solves a graph with these components, in Python; its largest one, if it has several."""
    if len(component_sizes) == 1:
        return "certpgo.solve(graph)"
    largest = max(range(len(component_sizes)), key=lambda k: component_sizes[k])
    return f"certpgo.solve(graph.subgraph((graph.components == {largest}).nonzero()[0]))"


def components_in_words(sizes: Sequence[int]) -> str:
    """Whether a graph is connected, and else the sizes of its components."""
    if len(sizes) == 1:
        return "yes"
    return f"no: {len(sizes)} components of {few(sorted(sizes, reverse=True))} nodes"


def few(items: Sequence[object], count: int = 8) -> str:
    """The first items, ids as `shown_id` has them, separated by commas."""
    named = (shown_id(one) if isinstance(one, int) else str(one) for one in items[:count])
    return ", ".join(named) + (", ..." if len(items) > count else "")


def shown_id(number: int) -> str:
    """An id as its program prints it: GTSAM's Symbols have a letter in the highest of eight bytes.

    Examples
    --------
    >>> from certpgo.graph.phrases import shown_id
    >>> shown_id((ord("x") << 56) + 3), shown_id(1700000000000000000)
    ('x3', '1700000000000000000')
    """
    letter = chr(number >> INDEX_BITS) if 0 < number >> INDEX_BITS < 128 else ""
    return f"{letter}{number & ((1 << INDEX_BITS) - 1)}" if letter.isalpha() else str(number)


def listed(items: Sequence[str]) -> str:
    """Such as ``positions, distances and heights``."""
    *others, last = items
    return f"{', '.join(others)} and {last}" if others else last

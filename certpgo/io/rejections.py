"""Lists of rejected measurements."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance
from certpgo.graph.phrases import few
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import FloatArray, IntArray

#: Columns that a list has: the number of a measurement in its source, and the ids of its nodes; and
#: what it may have, a price and the cost that this is a price of.
COLUMNS, PRICE, OF_COST = ("edge", "i", "j"), "price", "of_cost"


@dataclass(frozen=True, eq=False)
class Rejected:
    """Measurements of a source that were rejected.

    Attributes
    ----------
    numbers : (k,) in the source, see `certpgo.Instance`
    prices : (k,) what each costs at most; None where the list has none
    of_cost : the name of the cost that they are of; "" where the list does not say it, of F
    """

    numbers: IntArray
    prices: FloatArray | None
    of_cost: str = ""

    def among(self, instance: Instance) -> tuple[IntArray, FloatArray | None]:
        """Indices of those that an instance has, as which they are given, and their prices."""
        row = {number: k for k, number in enumerate(instance.known_numbers.tolist())}
        here = np.array([number in row for number in self.numbers.tolist()], dtype=bool)
        edges = np.array([row[number] for number in self.numbers[here].tolist()], dtype=np.intp)
        return edges, None if self.prices is None else self.prices[here]


def read_rejected(path: str | Path, instance: Instance) -> Rejected:
    """The measurements that a CSV file names, as ``certpgo outliers`` writes it.

    It has columns ``edge``, the number of a measurement from 0, ``i`` and ``j``, the ids of its
    nodes, and perhaps ``price`` and ``of_cost``, the name of the cost that this is of, by default
    F; others do not count.

    Raises
    ------
    FormatError
        There is no such file, or it names something else than measurements of the instance, or
        prices of several costs.
    """
    path = Path(path)
    try:
        with readable(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        raise FormatError(path, None, "no such file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(path, None, f"not readable as CSV: {error}") from None
    named = zip(instance.known_numbers.tolist(), instance.pairs.tolist(), strict=True)
    pairs = {edge: ids for edge, ids in named if edge >= 0}
    found, prices, costs = list[int](), list[float](), {row.get(OF_COST) or "" for row in rows}
    if len(costs) > 1:
        raise FormatError(path, None, f"prices of one cost expected, not of {few(sorted(costs))}")
    for line, row in enumerate(rows, start=2):
        try:
            edge, i, j = (int(row[name]) for name in COLUMNS)
        except (KeyError, TypeError, ValueError):
            raise FormatError(path, line, f"expected integers {', '.join(COLUMNS)}") from None
        if pairs.get(edge) != [i, j]:
            said = f"not from {i} to {j}" if edge in pairs else "not one of its measurements"
            raise FormatError(path, line, f"edge {edge} of {instance.name} is {said}")
        found.append(edge)
        if PRICE in row:
            prices.append(_positive(path, line, row[PRICE]))
    return Rejected(np.array(found, dtype=np.intp), np.array(prices) if prices else None, *costs)


def _positive(path: Path, line: int, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise FormatError(path, line, f"a price is a positive number, not {text!r}")
    return value

"""Lists of rejected measurements."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance
from certpgo.linalg.arrays import FloatArray, IntArray

#: Columns that a list has: the index of a measurement, and the ids of its nodes; and one that it
#: may have.
COLUMNS, PRICE = ("edge", "i", "j"), "price"


def read_rejected(path: str | Path, instance: Instance) -> tuple[IntArray, FloatArray | None]:
    """(k,) measurements that a CSV file names, as ``certpgo outliers`` writes it, and their prices.

    It has columns ``edge``, the index of a measurement from 0, ``i`` and ``j``, the ids of its
    nodes, and perhaps ``price``, in units of F; others do not count.

    Raises
    ------
    FormatError
        There is no such file, or it names something else than measurements of the instance.
    """
    path = Path(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        raise FormatError(path, None, "no such file") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FormatError(path, None, f"not readable as CSV: {error}") from None
    pairs, found, prices = instance.pairs, list[int](), list[float]()
    for line, row in enumerate(rows, start=2):
        try:
            edge, i, j = (int(row[name]) for name in COLUMNS)
        except (KeyError, TypeError, ValueError):
            raise FormatError(path, line, f"expected integers {', '.join(COLUMNS)}") from None
        if not 0 <= edge < len(pairs) or pairs[edge].tolist() != [i, j]:
            raise FormatError(path, line, f"edge {edge} of {instance.name} is not from {i} to {j}")
        found.append(edge)
        if PRICE in row:
            prices.append(_positive(path, line, row[PRICE]))
    return np.array(found, dtype=np.intp), np.array(prices) if prices else None


def _positive(path: Path, line: int, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise FormatError(path, line, f"a price is a positive number, not {text!r}")
    return value

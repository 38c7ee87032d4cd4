"""Lists of rejected measurements."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance
from certpgo.linalg.arrays import IntArray

#: Columns that a list has: the index of a measurement, and the ids of its nodes.
COLUMNS = ("edge", "i", "j")


def read_rejected(path: str | Path, instance: Instance) -> IntArray:
    """(k,) indices of the measurements that a CSV file names, as ``certpgo outliers`` writes it.

    It has columns ``edge``, the index of a measurement from 0, and ``i`` and ``j``, the ids of its
    nodes; others do not count.

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
    pairs, found = instance.ids[instance.graph.edges], list[int]()
    for line, row in enumerate(rows, start=2):
        try:
            edge, i, j = (int(row[name]) for name in COLUMNS)
        except (KeyError, TypeError, ValueError):
            raise FormatError(path, line, f"expected integers {', '.join(COLUMNS)}") from None
        if not 0 <= edge < len(pairs) or pairs[edge].tolist() != [i, j]:
            raise FormatError(path, line, f"edge {edge} of {instance.name} is not from {i} to {j}")
        found.append(edge)
    return np.array(found, dtype=np.intp)

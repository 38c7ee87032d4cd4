"""GLOMAP's rotation averaging: relative poses in, global rotations out, by image names.

    NAME_1 NAME_2 QW QX QY QZ TX TY TZ      x_2 = R x_1 + t, t a direction only
    NAME QW QX QY QZ                        world to camera

Our R_12 and R_i are the transposes. Names have an extension, which identifies these files.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.graph import Estimate, Instance, RotationGraph
from certpgo.graph.keys import Keys
from certpgo.io.chunks import first_words, parsed, rows_of
from certpgo.io.compressed import uncompressed_name
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, Format, LabelledPoses, Progress, ReadOptions
from certpgo.io.names import name_numbers
from certpgo.linalg.arrays import FloatArray

_RELATIVE = "NAME_1 NAME_2 QW QX QY QZ TX TY TZ"
_GLOBAL = "NAME QW QX QY QZ"
_NAME = re.compile(rb".*\.[A-Za-z]\w*\Z")


def _recognises(path: Path, head: bytes) -> bool:
    first = first_words(head)
    names = {5: first[:1], 9: first[:2]}.get(len(first), [])
    return bool(names) and all(_NAME.match(name) for name in names)


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    texts, R = _table(path, 2, 7, _RELATIVE, options.progress)
    names = np.unique(texts)
    numbers = name_numbers(names.tolist())
    if numbers is None:
        numbering = "nodes are numbered in the order of image names"
        numbers = np.arange(len(names))
    else:
        numbering = "the numbers in image names are used as node ids"
    order = np.argsort(numbers)
    rank = np.argsort(order)
    edges = rank[np.searchsorted(names, texts)]
    return Instance(
        name=uncompressed_name(path).stem,
        graph=RotationGraph(len(names), edges, np.swapaxes(R, 1, 2), np.ones(len(edges))),
        ids=numbers[order],
        source=str(path),
        options={"weights": "unit", "information": "none"},
        notices=(
            "no weights in the file: kappa = 1",
            "translation directions are ignored",
            numbering,
        ),
        names=tuple(names[order].tolist()),
    )


def _read_poses(path: Path) -> LabelledPoses:
    texts, R = _table(path, 1, 4, _GLOBAL)
    names = texts[:, 0].tolist()
    if len(set(names)) < len(names):
        raise FormatError(path, None, f"image {Counter(names).most_common(1)[0][0]} appears twice")
    return LabelledPoses(np.swapaxes(R, 1, 2), None, names=tuple(names))


def _table(
    path: Path, names: int, numbers: int, expected: str, progress: Progress | None = None
) -> tuple[np.ndarray[tuple[int, int], np.dtype[np.str_]], FloatArray]:
    """Names (k, names) and rotations (k, 3, 3) of lines of names and numbers, QW QX QY QZ first."""

    def parse(text: bytes) -> tuple[list[list[str]], FloatArray]:
        rows = rows_of(text)
        try:
            table = np.array([[float(word) for word in words[names:]] for words in rows])
            texts = [[word.decode() for word in words[:names]] for words in rows]
        except ValueError:
            raise InputError(f"{expected} expected") from None
        if {len(words) for words in rows} - {names + numbers} or not np.isfinite(table).all():
            raise InputError(f"{expected} expected")
        if any(len(set(row)) < len(row) for row in texts):
            raise InputError("an image is measured from itself")
        return texts, quaternion.rotations(table.reshape(-1, numbers)[:, [1, 2, 3, 0]])

    parts = list(parsed(path, parse, progress))
    rows = [row for texts, _ in parts for row in texts]
    if not rows:
        raise FormatError(path, None, f"no lines of {expected}")
    return np.array(rows), np.concatenate([R for _, R in parts])


def _write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    if not keys.names:
        raise InputError("glomap's files name images, and the poses have no names")
    for name in keys.names:
        if not _NAME.match(name.encode()) or name.split() != [name]:
            raise InputError(f"glomap's files name images, with an extension, not {name!r}")
    q = quaternion.to_write(np.swapaxes(estimate.rotations, 1, 2))[:, [3, 0, 1, 2]]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for name, numbers in zip(keys.names, q.tolist(), strict=True):
            file.write(f"{name} {' '.join(map(repr, numbers))}\n")


def _pose_words(words: list[bytes]) -> list[bytes]:
    return words[1:5]


FORMAT = Format(
    name="glomap",
    suffixes=(),
    recognises=_recognises,
    holds="relative poses or global rotations",
    read_graph=_read_graph,
    read_poses=_read_poses,
    write_poses=_write_poses,
    chart=Chart("quaternion", _pose_words, world_to_camera=True),
    holds_translations=False,
    holds_name=lambda name: True,
)

"""PLY files: points, their colours, and triangles; text and binary."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError
from certpgo.io.writing import atomically
from certpgo.linalg.arrays import FloatArray, IntArray

#: NumPy's type for each of PLY's, in either of its spellings.
TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
COLOURS = ("red", "green", "blue")
#: Lines of a header; what has more is no header.
LONGEST = 1000


@dataclass
class _Element:
    """An element of the header: how many there are, and the properties of each."""

    name: str
    count: int
    fields: list[tuple[str, str]]
    has_lists: bool = False


def read_ply(path: str | Path) -> tuple[FloatArray, NDArray[np.uint8] | None]:
    """The points of a PLY file, and their colours if it has any.

    Returns
    -------
    points (n, 3) in the file's units, and colours (n, 3) or None

    Raises
    ------
    FormatError
        The file is no PLY file, ends too early, or holds something else; with the line.
    """
    path = Path(path)
    with path.open("rb") as file:
        order, elements, line = _header(path, file)
        before, vertex = _up_to_vertices(path, elements)
        if order:
            table = _binary_table(path, file, order, before, vertex)
        else:
            table = _text_table(path, file, line, before, vertex)
    points = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if not set(COLOURS) <= set(table.dtype.names or ()):
        return points, None
    colours = np.stack([table[name] for name in COLOURS], axis=1)
    if colours.dtype.kind == "f":  # from 0 to 1
        colours = np.rint(255.0 * np.clip(colours, 0.0, 1.0))
    return points, colours.astype(np.uint8)


def _header(path: Path, file: BinaryIO) -> tuple[str, list[_Element], int]:
    """Byte order (empty for text), elements, and the number of the header's last line."""
    order, elements = None, list[_Element]()
    for number, raw in enumerate(islice(file, LONGEST), 1):
        words = raw.decode("ascii", "replace").split()
        if number == 1 and words != ["ply"]:
            raise FormatError(path, 1, "a PLY file begins with the line ply")
        match words:
            case ["format", name, _] if name in ORDERS:
                order = ORDERS[name]
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), []))
            case ["property", "list", _, _, _] if elements:
                elements[-1].has_lists = True
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].fields.append((name, TYPES[kind]))
            case ["end_header"] if order is not None:
                return order, elements, number
            case ["ply" | "comment" | "obj_info", *_] | []:
                pass
            case _:
                shown = " ".join(words)[:60]
                raise FormatError(path, number, f"not a line of a PLY header: {shown}")
    raise FormatError(path, None, "the PLY header has no end_header")


def _up_to_vertices(path: Path, elements: list[_Element]) -> tuple[list[_Element], _Element]:
    """The elements before the vertices, and these."""
    for k, element in enumerate(elements):
        if element.name == "vertex":
            names = [name for name, _ in element.fields]
            if element.has_lists or len(set(names)) < len(names):
                raise FormatError(path, None, "vertices have lists, or a property twice")
            if not {"x", "y", "z"} <= set(names):
                raise FormatError(path, None, "vertices need the properties x, y and z")
            return elements[:k], element
    raise FormatError(path, None, "the PLY file has no vertices")


def _binary_table(
    path: Path, file: BinaryIO, order: str, before: list[_Element], vertex: _Element
) -> NDArray[Any]:
    if any(element.has_lists for element in before):
        raise FormatError(path, None, "lists before the vertices of a binary PLY file")
    for element in before:
        file.seek(element.count * _record(element, order).itemsize, 1)
    record = _record(vertex, order)
    content = file.read(vertex.count * record.itemsize)
    if (found := len(content) // record.itemsize) < vertex.count:
        raise FormatError(path, None, f"{vertex.count} vertices announced, {found} found")
    return np.frombuffer(content, record)


def _record(element: _Element, order: str) -> np.dtype[Any]:
    return np.dtype([(name, order + kind) for name, kind in element.fields])


def _text_table(
    path: Path, file: BinaryIO, line: int, before: list[_Element], vertex: _Element
) -> NDArray[Any]:
    skipped = sum(element.count for element in before)
    lines = list(islice(file, skipped, skipped + vertex.count))
    if len(lines) < vertex.count:
        announced = f"{vertex.count} vertices announced, {len(lines)} found"
        raise FormatError(path, line + skipped + len(lines), announced)
    names = [name for name, _ in vertex.fields]
    rows = numbers(path, lines, len(names), " ".join(names), line + skipped + 1)
    table = np.empty(vertex.count, _record(vertex, "="))
    for name, column in zip(names, rows.T, strict=True):
        table[name] = column
    return table


def numbers(path: Path, lines: list[bytes], columns: int, expected: str, first: int) -> FloatArray:
    """A table (n, columns) of lines, the first of which has that number in the file."""
    words = [line.split() for line in lines]
    try:
        table = np.array(words, dtype=np.float64)
        if table.shape == (len(lines), columns):
            return table
    except ValueError:
        pass
    for number, row in enumerate(words, first):
        try:
            if len(list(map(float, row))) == columns:
                continue
        except ValueError:
            pass
        raise FormatError(path, number, f"{expected} expected")
    return np.empty((0, columns))


def write_ply(
    path: str | Path,
    points: FloatArray,
    colours: NDArray[np.uint8] | None = None,
    faces: IntArray | None = None,
) -> None:
    """Write points or a mesh as a binary PLY file, complete or not at all.

    Parameters
    ----------
    points : (n, 3), metres, written in single precision
    colours : (n, 3), red, green and blue
    faces : (k, 3) numbers of points, counterclockwise seen from outside

    Raises
    ------
    InputError
        The file cannot be written, or colours or faces do not fit the points.
    """
    n = len(points)
    if colours is not None and np.shape(colours) != (n, 3):
        raise InputError(f"colours must be ({n}, 3), one for each point")
    if faces is not None and len(faces) and not (np.min(faces) >= 0 and np.max(faces) < n):
        raise InputError(f"faces must name points from 0 to {n - 1}")
    fields = [(axis, "<f4") for axis in "xyz"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property float {axis}" for axis in "xyz"]
    if colours is not None:
        fields += [(name, "u1") for name in COLOURS]
        header += [f"property uchar {name}" for name in COLOURS]
    vertices = np.empty(n, fields)
    for k, axis in enumerate("xyz"):
        vertices[axis] = points[:, k]
    for k, name in enumerate(COLOURS if colours is not None else ()):
        vertices[name] = np.asarray(colours)[:, k]
    triangles = np.empty(0 if faces is None else len(faces), [("n", "u1"), ("v", "<i4", 3)])
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        triangles["n"], triangles["v"] = 3, faces
    text = "\n".join([*header, "end_header", ""]).encode("ascii")
    content = text + vertices.tobytes() + triangles.tobytes()
    atomically(Path(path), lambda temporary: temporary.write_bytes(content))

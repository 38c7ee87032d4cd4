"""Reading point clouds and meshes: PLY, in text or binary, metres."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError
from certpgo.linalg.arrays import FloatArray, IntArray

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class Surface:
    """A point cloud, or a mesh if there are faces.

    Attributes
    ----------
    points : (p, 3) metres
    colours : (p, 3) red, green and blue in 0 ... 255; None for none
    faces : (f, 3) triangles of points; empty for a cloud
    """

    points: FloatArray
    colours: NDArray[np.uint8] | None
    faces: IntArray


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[tuple[str, str, str]]  # name, type, and of a list the type of its length


def is_ply(path: Path) -> bool:
    """Whether a file says that it is a PLY file."""
    with path.open("rb") as file:
        return file.read(4) in (b"ply\n", b"ply\r")


def read_surface(path: str | Path) -> Surface:
    """Read a point cloud or mesh; faces of more than three points become fans of triangles.

    Raises
    ------
    FormatError
        The file is not PLY, ends early, or has no x, y and z.
    """
    path = Path(path)
    order, elements, body = _header(path)
    data = {}
    for element, columns in _elements(path, order, elements, body):
        data[element] = columns
    vertex = data.get("vertex", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise FormatError(path, None, "vertices with properties x, y and z expected")
    if not len(vertex["x"]):
        raise FormatError(path, None, "at least one point expected")
    points = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(float)
    if not np.isfinite(points).all():
        raise FormatError(path, None, "finite coordinates expected")
    colours = None
    if set(_COLOURS) <= vertex.keys():
        colours = np.stack([vertex[name] for name in _COLOURS], axis=1)
        colours = (255.0 * colours if colours.dtype.kind == "f" else colours).astype(np.uint8)
    face = data.get("face", {})
    faces = face.get("vertex_indices", face.get("vertex_index", np.zeros((0, 3), dtype=np.intp)))
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise FormatError(path, None, f"faces of points 0 to {len(points) - 1} expected")
    return Surface(points, colours, faces)


def _header(path: Path) -> tuple[str, list[_Element], bytes]:
    head, found, body = path.read_bytes().partition(b"end_header")
    lines = head.decode("ascii", errors="replace").splitlines()
    if not found or not lines or lines[0].strip() != "ply":
        raise FormatError(path, None, "a PLY file with its header expected")
    order, elements = None, list[_Element]()
    for number, line in enumerate(lines[1:], start=2):
        match line.split():
            case ["format", name, _] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, kind, name] if {length, kind} <= _TYPES.keys():
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if kind in _TYPES and elements:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                raise FormatError(path, number, "format, element, property or comment expected")
    if order is None:
        raise FormatError(path, None, f"format {', '.join(_ORDERS)} expected")
    return order, elements, body.partition(b"\n")[2]


def _elements(
    path: Path, order: str, elements: list[_Element], body: bytes
) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """The columns of each element; lists are triangles."""
    start, words = 0, body.split() if not order else []
    for element in elements:
        lists = [kind for _, kind, length in element.properties if length]
        try:
            if not lists:
                columns, start = _table(element, order, body, words, start)
            elif len(element.properties) == 1:
                columns, start = _triangles(element, order, body, words, start)
            else:
                raise FormatError(path, None, f"element {element.name}: a list alone expected")
        except (ValueError, IndexError):
            expected = f"{element.rows} of element {element.name} expected"
            raise FormatError(path, None, expected) from None
        yield element.name, columns


def _table(
    element: _Element, order: str, body: bytes, words: list[bytes], start: int
) -> tuple[dict[str, NDArray[Any]], int]:
    row = np.dtype([(name, order + kind) for name, kind, _ in element.properties])
    if order:
        table = np.frombuffer(body, row, element.rows, start)
        return {name: table[name] for name in row.names or ()}, start + table.nbytes
    width = len(element.properties)
    end = start + width * element.rows
    numbers = np.array(words[start:end], dtype=float).reshape(element.rows, width)
    columns = zip(element.properties, numbers.T, strict=True)
    return {name: column.astype(kind) for (name, kind, _), column in columns}, end


def _triangles(
    element: _Element, order: str, body: bytes, words: list[bytes], start: int
) -> tuple[dict[str, NDArray[Any]], int]:
    ((name, kind, length),) = element.properties
    if order:
        row = np.dtype([("length", order + length), ("corners", order + kind, 3)])
        if start + element.rows * row.itemsize <= len(body):
            table = np.frombuffer(body, row, element.rows, start)
            if (table["length"] == 3).all():
                corners = table["corners"].astype(np.intp)
                return {name: corners}, start + table.nbytes
    faces = []
    for _ in range(element.rows):
        if order:
            count = int(np.frombuffer(body, order + length, 1, start)[0])
            start += np.dtype(length).itemsize
            corners = np.frombuffer(body, order + kind, count, start).astype(np.intp)
            start += corners.size * np.dtype(kind).itemsize
        else:
            count = int(words[start])
            corners = np.array(words[start + 1 : start + 1 + count], dtype=np.intp)
            if len(corners) < count:
                raise IndexError
            start += 1 + count
        faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, count - 1)]
    return {name: np.array(faces, dtype=np.intp).reshape(-1, 3)}, start

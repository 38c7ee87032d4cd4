"""MATLAB 5 files of one sparse matrix, with every index checked.

A file is a header of 128 bytes and data elements: a type, a size and as many bytes, perhaps
compressed. SciPy's reader does not check sizes and compressed columns, and a damaged file makes it
write outside its arrays.

Source: MathWorks, MAT-File Format, R2019b, pages 1-5 ... 1-20.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from certpgo.errors import FormatError, InputError, in_file
from certpgo.io.compressed import largest, refuse_bombs
from certpgo.io.pipes import readable
from certpgo.linalg.arrays import IntArray

#: The first bytes of a file.
SIGNATURE = b"MATLAB 5.0 MAT-file"

_HEADER_BYTES, _ORDER_PLACE = 128, 126
_MATRIX, _COMPRESSED = 14, 15
_TYPES = "i1 u1 i2 u2 i4 u4 f4 f8 i8 u8"
_NUMBERS = dict(zip((1, 2, 3, 4, 5, 6, 7, 9, 12, 13), _TYPES.split(), strict=True))
_SPARSE_CLASS, _COMPLEX_FLAG = 5, 0x800

Element = tuple[int, bytes]


class Pattern(NamedTuple):
    """The nonzero pattern of a sparse matrix."""

    shape: tuple[int, int]
    rows: IntArray
    columns: IntArray


def sparse_pattern(path: Path) -> Pattern:
    """The pattern of the one sparse matrix in a file.

    Raises
    ------
    FormatError
        The file is damaged, contains something else, or is too large when expanded.
    """
    content = readable(path).read_bytes()
    order = {b"IM": "<", b"MI": ">"}.get(content[_ORDER_PLACE:_HEADER_BYTES], "")
    if not (order and content.startswith(SIGNATURE)):
        raise FormatError(path, None, "not a readable MATLAB 5 file")
    with in_file(path):
        elements = _elements(content[_HEADER_BYTES:], order)
        matrices = [_Matrix.of(order, *_inflated(path, order, *element)) for element in elements]
        named = [matrix for matrix in matrices if matrix.name]  # MATLAB's own has none
        if len(named) != 1 or not named[0].is_real_sparse:
            raise InputError("one sparse adjacency matrix expected")
        return named[0].pattern()


def _elements(content: bytes, order: str) -> Iterator[Element]:
    """Type and bytes of each data element."""
    place = 0
    while place < len(content):
        if len(content) - place < 8:
            raise _damaged("an element's tag")
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start = place + 8
        if kind >> 16:  # at most four bytes, in the tag itself
            kind, size, start = kind & 0xFFFF, kind >> 16, place + 4
        if size > len(content) - start or (start < place + 8 and size > 4):
            raise _damaged("an element's size")
        yield kind, content[start : start + size]
        place = start + size
        if kind != _COMPRESSED:
            place += -place % 8


def _inflated(path: Path, order: str, kind: int, content: bytes) -> Element:
    """The element, decompressed if necessary."""
    if kind != _COMPRESSED:
        return kind, content
    stream, most = zlib.decompressobj(), largest(path)
    try:
        tag = stream.decompress(content, 8)
        if len(tag) == 8:
            refuse_bombs(path, struct.unpack(f"{order}II", tag)[1])
        whole = tag + stream.decompress(stream.unconsumed_tail, most + 1)
    except zlib.error:
        raise _damaged("compressed data") from None
    if not stream.eof:
        raise _damaged("compressed data")
    return next(_elements(whole, order), (0, b""))


class _Matrix(NamedTuple):
    """The parts of a matrix element."""

    order: str
    flags: int
    dims: tuple[int, ...]
    name: bytes
    parts: list[Element]

    @classmethod
    def of(cls, order: str, kind: int, content: bytes) -> _Matrix:
        parts = list(_elements(content, order)) if kind == _MATRIX else []
        if len(parts) < 3:
            raise _damaged("a matrix")
        flags, dims = (_numbers(order, *part) for part in parts[:2])
        if flags.dtype.kind != "u" or dims.dtype.kind != "i" or not (len(flags) and len(dims) > 1):
            raise _damaged("a matrix's header")
        return cls(order, int(flags[0]), tuple(dims.tolist()), parts[2][1], parts[3:])

    @property
    def is_real_sparse(self) -> bool:
        return self.flags & 0xFF == _SPARSE_CLASS and not self.flags & _COMPLEX_FLAG

    def pattern(self) -> Pattern:
        """Rows and columns of the entries; InputError if the parts are inconsistent."""
        if len(self.dims) != 2 or len(self.parts) != 3 or min(self.dims) < 0:
            raise _damaged("a sparse matrix")
        height, width = self.dims
        rows, starts = (_indices(self.order, *part) for part in self.parts[:2])
        if len(starts) <= width or starts[0] != 0:
            raise _damaged("compressed columns")
        counts = np.diff(starts[: width + 1])
        total = int(starts[width])
        filled = _numbers(self.order, *self.parts[2])[:total] != 0
        rows = rows[:total]
        if (counts < 0).any() or not len(rows) == len(filled) == total:
            raise _damaged("compressed columns")
        if total and not 0 <= rows.min() <= rows.max() < height:
            raise _damaged("row indices")
        return Pattern((height, width), rows[filled], np.repeat(np.arange(width), counts)[filled])


def _numbers(order: str, kind: int, content: bytes) -> np.ndarray[tuple[int], np.dtype[np.generic]]:
    if kind not in _NUMBERS:
        raise _damaged("an element's type")
    dtype = np.dtype(order + _NUMBERS[kind])
    if len(content) % dtype.itemsize:
        raise _damaged("an element's size")
    return np.frombuffer(content, dtype)


def _indices(order: str, kind: int, content: bytes) -> IntArray:
    numbers = _numbers(order, kind, content)
    if numbers.dtype.kind not in "iu":
        raise _damaged("indices")
    return numbers.astype(np.intp)


def _damaged(what: str) -> InputError:
    return InputError(f"a damaged MATLAB 5 file ({what})")

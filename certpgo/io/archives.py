"""Archives of NumPy's arrays, as they may be damaged or made to do harm."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from certpgo.errors import FormatError
from certpgo.io.compressed import refuse_bombs
from certpgo.io.pipes import readable


def arrays_in(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz file by name.

    Raises
    ------
    FormatError
        It is no archive of plain arrays, or expands out of proportion.
    """
    try:
        with zipfile.ZipFile(readable(path)) as archive:
            refuse_bombs(path, sum(member.file_size for member in archive.infolist()))
            return {
                member.filename.removesuffix(".npy"): _array(archive, member)
                for member in archive.infolist()
            }
    except FormatError:
        raise
    except Exception:  # zipfile, zlib and NumPy raise various errors
        raise FormatError(path, None, "an archive of plain NumPy arrays expected") from None


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """An array; ValueError if header and data disagree, or for objects and invalid text."""
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    with archive.open(member) as stream:
        shape, by_columns, dtype = readers[npy.read_magic(stream)](stream)
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or min(shape, default=0) < 0 or size != member.file_size - stream.tell():
            raise ValueError
        # Limit the bytes read, as the sizes in the archive may be wrong.
        data = stream.read(size)
    array: NDArray[Any] = np.ndarray(shape, dtype, data, order="F" if by_columns else "C")
    if dtype.kind == "U":
        "".join(array.ravel().tolist()).encode()  # ValueError if invalid
    return array

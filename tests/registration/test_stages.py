"""What is kept of a long computation is read again, or made again if it is damaged."""

import io
import zipfile

import numpy as np
import pytest

from certpgo.errors import InputNotice
from certpgo.registration.stages import Cache


def archive(*members, method=zipfile.ZIP_STORED):
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", method) as file:
        for name, data in members:
            file.writestr(name, data)
    return content.getvalue()


def array_of(shape):
    """A header that promises an array, and nothing after it."""
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()


DAMAGED = {
    "empty": b"",
    "words": b"damaged",
    "half": archive(("a.npy", array_of((3,)) + bytes(24)))[:90],
    "no array": archive(("a.npy", b"words")),
    "promises": archive(("a.npy", array_of((10**12,)))),
    "expands": archive(("a.npy", bytes(1 << 25)), method=zipfile.ZIP_DEFLATED),
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED)
def test_a_damaged_file_is_made_again(tmp_path, content):
    cache, made = Cache(tmp_path), {"a": np.arange(3.0)}
    cache.arrays(["key"], lambda: made)
    [path] = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(content)
    with pytest.warns(InputNotice) as said:
        found = cache.arrays(["key"], lambda: made)
    assert found is made
    assert len(said) == 1
    assert str(said[0].message).startswith(f"{path}: ")
    assert str(said[0].message).endswith("; it is made again")
    assert path.read_bytes() == whole
    kept = cache.arrays(["key"], lambda: pytest.fail("was kept"))
    assert np.array_equal(kept["a"], made["a"])

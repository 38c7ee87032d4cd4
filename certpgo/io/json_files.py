"""Files of JSON, perhaps compressed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError
from certpgo.io.compressed import RATIO, opened

#: Bytes that lists, objects and other values take in memory, at least.
_LIST, _OBJECT, _VALUE = 72, 240, 32
#: Bytes in memory that a file of any size may take.
_SMALL = 256 << 20


def read_json(path: Path) -> Any:
    """The content of a file.

    Raises
    ------
    FormatError
        It is no JSON, with the line; or it expands out of proportion to its size.
    """
    with opened(path) as file:
        text = file.read()
    taken = _LIST * text.count(b"[") + _OBJECT * text.count(b"{") + _VALUE * text.count(b",")
    if taken > max(RATIO * path.stat().st_size, _SMALL):
        said = f"JSON of more than {taken >> 20} MB in memory, out of proportion to the file's size"
        raise FormatError(path, None, said)
    try:
        return json.loads(text.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise FormatError(path, error.lineno, f"JSON expected: {error.msg}") from None
    except (UnicodeDecodeError, RecursionError):
        raise FormatError(path, None, "JSON expected, in UTF-8") from None
    except ValueError:
        raise FormatError(path, None, "JSON with numbers of fewer digits expected") from None


def as_id(value: Any) -> int:
    """A number as an id of 64 bits; a ValueError if it is none."""
    number = int(value)
    if not -(2**63) <= number < 2**63:
        raise ValueError(f"{value} is no id of 64 bits")
    return number

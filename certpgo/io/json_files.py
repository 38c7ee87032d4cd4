"""Files of JSON, perhaps compressed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError
from certpgo.io.compressed import opened


def read_json(path: Path) -> Any:
    """The content of a file; a FormatError with the line where it is no JSON."""
    try:
        with opened(path) as file:
            return json.loads(file.read().decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise FormatError(path, error.lineno, f"JSON expected: {error.msg}") from None
    except (UnicodeDecodeError, RecursionError):
        raise FormatError(path, None, "JSON expected, in UTF-8") from None

"""What can go wrong, and how it is said: one line, naming the place and what was expected."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

#: Names that are all shown where another was given.
FEW = 8


class CertPGOError(Exception):
    """Base of every error this package raises on purpose; the text is one line."""


class InputError(CertPGOError, ValueError):
    """The user's data or arguments are unusable."""


class FormatError(InputError):
    """A file does not follow its format.

    Parameters
    ----------
    path : path of the file
    line : 1-based line number, or None when the whole file is meant
    expected : what the format asks for at that place
    """

    def __init__(self, path: str | Path, line: int | None, expected: str) -> None:
        self.path, self.line, self.expected = Path(path), line, expected
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {expected}")


class GraphError(InputError):
    """A graph or estimate violates what its type promises.

    Attributes
    ----------
    component_sizes : nodes in each component, largest first, when connectivity is the matter
    """

    def __init__(self, message: str, *, component_sizes: tuple[int, ...] = ()) -> None:
        self.component_sizes = component_sizes
        super().__init__(message)


class NumericalError(CertPGOError, ArithmeticError):
    """A computation could not be carried out to any useful accuracy."""


class MissingDependency(CertPGOError, ImportError):  # noqa: N818 - the condition is the name
    """An optional package is not installed.

    Parameters
    ----------
    what : the feature that needs it
    extra : the extra of this package that brings it, e.g. ``"baselines"``
    package : what to install instead, where no extra does
    """

    def __init__(self, what: str, extra: str = "", *, package: str = "") -> None:
        self.extra = extra
        wanted = package or f"'certpgo[{extra}]'"
        super().__init__(f"{what} is not installed: pip install {wanted}")


class SpecError(CertPGOError, LookupError):
    """A name or setting is unknown."""

    @classmethod
    def unknown(cls, kind: str, name: str, known: Iterable[str]) -> SpecError:
        """The error for ``name`` not being among ``known``: the nearest, or all if they are few."""
        names = sorted(known)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else ""
        if not near or len(names) <= FEW:
            known_are = f"known: {', '.join(names)}" if names else "there are none"
            hint = f"{hint} {known_are}".lstrip()
        return cls(f"unknown {kind} {name!r}; {hint}")


class InputNotice(UserWarning):
    """Something in the input was assumed, skipped or unusual; the answer stands."""

"""Errors and warnings; each message is one line with the place and what was expected."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Any

#: Number of known names up to which all are listed.
FEW = 8
#: Similarity, from 0 to 1, from which on another name may have been meant.
CLOSE = 0.65
#: Letters from which on the beginning of a name stands for it.
BEGINNING = 3
_NONE: Mapping[str, int] = MappingProxyType({})
_TOLERANCES = "tolerances must lie within 0 ... 1: rtol={rtol}, atol={atol}"
#: Arguments that are numbers, by name: what they are, which are taken, and what is said of others.
NUMBERS: Mapping[str, tuple[str, Callable[[Any], bool], str]] = {
    "rtol": ("a number as tolerance", lambda x: 0.0 <= x < 1.0, _TOLERANCES),
    "atol": ("a number as tolerance", lambda x: 0.0 <= x < 1.0, _TOLERANCES),
    "time_limit": (
        "seconds as time limit",
        lambda x: x >= 0.0,
        "the time limit must not be negative: {time_limit}",
    ),
    "max_rank": (
        "a number as maximal rank",
        lambda x: x >= 1,
        "the maximal rank must be at least 1, not {max_rank}",
    ),
    "quantile": (
        "a number as quantile",
        lambda x: 0.0 < x < 1.0,
        "a quantile lies between 0 and 1, not at {quantile}",
    ),
    "level": (
        "a number as level",
        lambda x: 0.0 < x < 1.0,
        "a level lies between 0 and 1, not at {level}",
    ),
    "metres": (
        "a number of metres",
        lambda x: 0.0 < x < math.inf,
        "a positive number of metres expected, not {metres}",
    ),
    "degrees": (
        "a number of degrees",
        lambda x: 0.0 < x <= 180.0,
        "degrees above 0 and up to 180 expected, not {degrees}",
    ),
}


def nearest(name: str, names: Iterable[str]) -> list[str]:
    """At most three names that may have been meant: similar ones, or longer by an ending."""
    import difflib

    listed = list(names)
    longer = [n for n in listed if len(name) >= BEGINNING and n.startswith(name)]
    similar = difflib.get_close_matches(name, listed, n=3, cutoff=CLOSE)
    return list(dict.fromkeys([*similar, *longer]))[:3]


def kind_of(thing: object) -> str:
    """The name of an object's type with its article, for messages."""
    if thing is None:
        return "None"
    name = type(thing).__name__
    return f"{'an' if name[:1].upper() in 'AEIO' else 'a'} {name}"


def require(given: object, kinds: type | tuple[type, ...] | UnionType, expected: str) -> None:
    """Refuse an argument of another kind by an InputError that names both."""
    if not isinstance(given, kinds):
        raise InputError(f"{expected} expected, not {kind_of(given)}")


def require_path(given: object, of: str) -> None:
    """Refuse what is no path by an InputError."""
    require(given, str | os.PathLike, f"the path of {of}")


def require_numbers(**given: object) -> None:
    """Refuse arguments, but for None, that are no numbers or not in the range of `NUMBERS`."""
    for name, value in given.items():
        expected, is_taken, said = NUMBERS[name]
        if value is not None:
            require(value, Real, expected)
            if not is_taken(value):
                raise InputError(said.format(**given))


def refuse(said: str, source: str = "") -> None:
    """Refuse for a reason, if there is one, by an InputError that names where it is from."""
    if said:
        raise InputError(f"{source}: {said}" if source else said)


def how_to_install(extra: str, package: str = "") -> str:
    """The command that installs the packages of an extra, or one of them, by their own names.

    These are on the package index; certpgo itself may have come from a checkout or a wheel.
    """
    import platform
    from importlib import metadata

    try:
        lines = metadata.requires("certpgo") or []
    except metadata.PackageNotFoundError:
        lines = []
    wanted = []
    for line in lines:
        requirement, _, condition = (part.strip() for part in line.partition(";"))
        name = re.split(r"[<>=!~\[ ]", requirement)[0]
        if f'extra == "{extra}"' not in condition or name == "certpgo":
            continue
        if package in ("", name):
            for known in (sys.platform, platform.machine()):
                if f'!= "{known}"' in condition:
                    return f"there is no wheel of {name} for {known}"
            wanted.append(f"'{requirement}'")
    return " ".join(["pip install", *(wanted or [package or f"'certpgo[{extra}]'"])])


class CertPGOError(Exception):
    """Base of the errors that this package raises; the message is one line.

    Examples
    --------
    >>> import certpgo
    >>> try:
    ...     certpgo.read("nowhere.g2o")
    ... except certpgo.CertPGOError as error:
    ...     print(error)
    nowhere.g2o: ...
    """

    def __reduce__(self) -> tuple[Any, ...]:
        # Constructors take other arguments than the message; errors come from other processes, too.
        return type(self).__new__, (type(self), *self.args), self.__dict__


class InputError(CertPGOError, ValueError):
    """Data or arguments are unusable.

    Examples
    --------
    >>> import certpgo
    >>> certpgo.solve(2500)
    Traceback (most recent call last):
        ...
    certpgo.errors.InputError: solve takes a graph, a problem, an instance or a path, not an int
    """


class FormatError(InputError):
    r"""A file does not follow its format.

    Parameters
    ----------
    path : path of the file
    line : 1-based line number, or None for the whole file
    expected : what the format requires there

    Examples
    --------
    >>> from pathlib import Path
    >>> import certpgo
    >>> _ = Path("short.g2o").write_text("EDGE_SE2 0 1 1 0\n")
    >>> try:
    ...     certpgo.read("short.g2o")
    ... except certpgo.FormatError as error:
    ...     print(error.line)
    1
    """

    def __init__(self, path: str | Path, line: int | None, expected: str) -> None:
        self.path, self.line, self.expected = Path(path), line, expected
        place = f"{path}:{line}" if line is not None else f"{path}"
        super().__init__(f"{place}: {expected}")


@contextmanager
def in_file(path: str | Path, line: int | None = None) -> Iterator[None]:
    """Let errors about what a file contains name it, and the line."""
    try:
        yield
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(path, line, str(error)) from None


class NoEdges(FormatError):  # noqa: N818 - the condition is the name
    """A file holds no measurements.

    Parameters
    ----------
    counts : what its lines are instead, as of `certpgo.graph.Instance`
    """

    def __init__(
        self, path: str | Path, line: int | None, expected: str, counts: Mapping[str, int] = _NONE
    ) -> None:
        super().__init__(path, line, expected)
        self.counts = counts


class NoMeasurements(NoEdges):
    """A file holds an estimate where measurements are expected."""


class FileNotHere(InputError):  # noqa: N818 - the condition is the name
    """The file of a dataset is not on this machine."""


class GraphError(InputError):
    """A graph or estimate violates its invariants.

    Attributes
    ----------
    component_sizes : nodes in each component, largest first, if the graph is not connected

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> edges, identities = np.array([[0, 1], [2, 3], [3, 4]]), np.array([np.eye(2)] * 3)
    >>> graph = certpgo.RotationGraph(5, edges, identities, np.ones(3))
    >>> try:
    ...     certpgo.solve(graph)
    ... except certpgo.GraphError as error:
    ...     print(error.component_sizes)
    (3, 2)
    """

    def __init__(self, message: str, *, component_sizes: tuple[int, ...] = ()) -> None:
        self.component_sizes = component_sizes
        super().__init__(message)


class NumericalError(CertPGOError, ArithmeticError):
    """A computation failed or is too inaccurate.

    Examples
    --------
    >>> from certpgo import NumericalError
    >>> issubclass(NumericalError, ArithmeticError)
    True
    """


class MissingDependency(CertPGOError, ImportError):  # noqa: N818 - the condition is the name
    """An optional package is not installed.

    Parameters
    ----------
    what : the package or the feature that needs it
    extra : extra of this package that includes it, e.g. ``"baselines"``
    package : the package to install, if not all of the extra, or if no extra includes it
    remedy : what to do, where that is not ``pip install``

    Examples
    --------
    >>> from certpgo import MissingDependency
    >>> print(MissingDependency("Ray", package="ray"))
    Ray is not installed: pip install ray
    """

    def __init__(self, what: str, extra: str = "", *, package: str = "", remedy: str = "") -> None:
        self.extra = extra
        super().__init__(f"{what} is not installed: {remedy or how_to_install(extra, package)}")


class SpecError(CertPGOError, LookupError):
    """A name or setting is unknown.

    Examples
    --------
    >>> from certpgo import SpecError, get_solver
    >>> try:
    ...     get_solver("newtons")
    ... except SpecError as error:
    ...     print(error)
    unknown method 'newtons'; did you mean newton...?
    """

    @classmethod
    def unknown(cls, kind: str, name: str, known: Iterable[str]) -> SpecError:
        """The error for an unknown ``name``, with the nearest known ones or all if few."""
        names = sorted(known)
        near = nearest(name, names)
        hint = f"did you mean {' or '.join(near)}?" if near else ""
        if not near or len(names) <= FEW:
            known_are = f"known: {', '.join(names)}" if names else "there are none"
            hint = f"{hint} {known_are}".lstrip()
        return cls(f"unknown {kind} {name!r}; {hint}")


class UnusableFile(SpecError):  # noqa: N818 - the condition is the name
    """A Python file that is looked up by name cannot be used.

    Parameters
    ----------
    path : path of the file
    reason : the problem, or the exception raised on loading
    """

    def __init__(self, path: str | Path, reason: str | BaseException) -> None:
        self.path = Path(path)
        if isinstance(reason, BaseException):
            kind = "" if isinstance(reason, CertPGOError) else f"{type(reason).__name__}: "
            reason = f"cannot be loaded: {kind}{str(reason).partition(chr(10))[0]}"
        super().__init__(f"{path}: {reason}")


class InputNotice(UserWarning):
    """Something in the input was assumed, skipped or unusual; the result remains valid.

    Examples
    --------
    A file whose translations are all zero is read as a rotation graph, with a notice:

    >>> import warnings
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> certpgo.write("cycle.g2o", winding_cycle(4, 0.1, 0)[0])
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     graph = certpgo.read("cycle.g2o").graph
    >>> [notice.category.__name__ for notice in caught]
    ['InputNotice']
    """

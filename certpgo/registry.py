"""Names to modules by scanning folders; nothing is imported until asked for.

A method is one file of ``certpgo/solvers`` or, in a checkout, ``baselines``, exposing ``SOLVER``;
a competitor's rule for certifying is one file of ``baselines/certifiers`` exposing ``CERTIFIER``;
a table is one file of ``reports/tables`` exposing ``TABLE``, a figure one of ``reports/figures``
exposing ``FIGURE``. Files whose names start with an underscore are shared code. The checkout's
folders are not in the wheel and are loaded by path.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from certpgo.errors import MissingDependency, SpecError, UnusableFile
from certpgo.estimate import Estimate
from certpgo.problem import Problem
from certpgo.solution import Solver

#: Environment variable naming the checkout, where it is not beside the package.
REPOSITORY_VARIABLE = "CERTPGO_REPOSITORY"

#: The certified pipeline, which is made of methods and no file among them.
PIPELINE = "certified"

#: A rule that is told an estimate and returns the one it calls optimal (the same, or where its own
#: descent ended), or None. InputError says that it does not judge such a thing.
Certifier = Callable[[Problem, Estimate], Estimate | None]

_PACKAGE = Path(__file__).parent


def solver_names() -> tuple[str, ...]:
    """Names of the methods here: the package's own, and the baselines in a checkout."""
    own = _stems(_PACKAGE / "solvers")
    return tuple(sorted({PIPELINE, *own, *_stems(_checkout_folder("baselines"))}))


def get_solver(name: str) -> type[Solver]:
    """The method called ``name``, a frozen dataclass class of settings.

    Raises
    ------
    SpecError
        No such method, with the nearest names; or its file cannot be loaded, or exposes no
        dataclass ``SOLVER``.

    Examples
    --------
    >>> from certpgo import RotationProblem, get_solver
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> problem = RotationProblem(winding_cycle(6, 0.3, 0)[0].graph)
    >>> get_solver("eigen_ra")(weights="unit").solve(problem).status.value
    'closed form'
    >>> get_solver("eigen_r")
    Traceback (most recent call last):
        ...
    certpgo.errors.SpecError: unknown method 'eigen_r'; did you mean eigen_ra or ...?
    """
    if name == PIPELINE:
        module = importlib.import_module("certpgo.solve")
    elif name in _stems(_PACKAGE / "solvers"):
        module = _imported(f"certpgo.solvers.{name}", _PACKAGE / "solvers" / f"{name}.py")
    elif name in _stems(_checkout_folder("baselines")):
        module = _load(repository() / "baselines", name)
    else:
        raise SpecError.unknown("method", name, solver_names())
    solver: type[Solver] = _exposed(module, "SOLVER")
    _require_settings(solver, module.__file__ or name)
    return solver


def _require_settings(solver: Any, path: str) -> None:
    if not (isinstance(solver, type) and is_dataclass(solver)):
        raise UnusableFile(path, "SOLVER must be a dataclass of settings")
    missing = [part for part in ("poses", "rotations", "solve") if not hasattr(solver, part)]
    if missing:
        raise UnusableFile(path, f"SOLVER lacks {', '.join(missing)}")


def certifier_names() -> tuple[str, ...]:
    """Names of the competitors' certifiers in a checkout."""
    return _stems(_checkout_folder("baselines/certifiers"))


def get_certifier(name: str) -> Certifier:
    """The certifier called ``name``.

    Raises
    ------
    SpecError
        No checkout, no such certifier, or a file that exposes no ``CERTIFIER``.
    """
    if name not in certifier_names():
        raise SpecError.unknown("certifier", name, certifier_names())
    certifier: Certifier = _exposed(
        _load(repository() / "baselines", f"certifiers.{name}"), "CERTIFIER"
    )
    return certifier


def table_names() -> tuple[str, ...]:
    """Names of the tables that `reproduce` knows; none without a checkout."""
    return _stems(_checkout_folder("reports/tables"))


def get_table(name: str) -> Any:
    """The specification of the table called ``name``, as ``moreira2020-table5.7`` or with ``_``.

    Raises
    ------
    SpecError
        No checkout, no such table (with the nearest names), or a file that exposes no ``TABLE``.
    """
    return _report("tables", "table", name)


def figure_names() -> tuple[str, ...]:
    """Names of the figures that `reproduce` knows; none without a checkout."""
    return _stems(_checkout_folder("reports/figures"))


def get_figure(name: str) -> Any:
    """The specification of the figure called ``name``, as ``moreira2020-figure5.1`` or with ``_``.

    Raises
    ------
    SpecError
        No checkout, no such figure (with the nearest names), or a file that exposes no ``FIGURE``.
    """
    return _report("figures", "figure", name)


def get_report(name: str) -> Any:
    """The table or figure called ``name``.

    Raises
    ------
    SpecError
        No checkout, or nothing of that name, with the nearest names of both kinds.
    """
    repository()
    if _stem(name) in figure_names():
        return get_figure(name)
    if _stem(name) in table_names():
        return get_table(name)
    raise SpecError.unknown("table or figure", _stem(name), (*table_names(), *figure_names()))


def repository() -> Path:
    """The root of the checkout, which holds ``baselines`` and ``reports``.

    It is the folder named by the environment variable ``CERTPGO_REPOSITORY``, else the one that
    the package lies in, else the working directory.

    Raises
    ------
    SpecError
        There is none.
    """
    root = checkout()
    if root is None:
        raise SpecError(
            "compare, reproduce, report and gate need the checkout: run them in its folder, "
            f"or let {REPOSITORY_VARIABLE} name it"
        )
    return root


def _report(folder_name: str, kind: str, name: str) -> Any:
    folder = repository() / "reports" / folder_name
    if _stem(name) not in _stems(folder):
        raise SpecError.unknown(kind, _stem(name), _stems(folder))
    return _exposed(_load(folder, _stem(name)), kind.upper())


def _stem(name: str) -> str:
    return name.replace("-", "_").replace(".", "_")


def checkout() -> Path | None:
    """The root of the checkout, or None; see `repository`."""
    named = os.environ.get(REPOSITORY_VARIABLE)
    return next(filter(_is_complete, [Path(named).resolve()] if named else _places()), None)


def source() -> Path:
    """The folder that the package lies in, whose commit says what ran."""
    return _PACKAGE.parent


def _places() -> Iterator[Path]:
    yield source().resolve()
    with suppress(OSError):  # a working directory that is gone
        here = Path.cwd()
        if (here / _PACKAGE.name).is_dir():
            yield here.resolve()


def _is_complete(root: Path) -> bool:
    return (root / "baselines").is_dir() and (root / "reports").is_dir()


def _checkout_folder(relative: str) -> Path | None:
    root = checkout()
    return None if root is None else root / relative


def _stems(folder: Path | None) -> tuple[str, ...]:
    if folder is None:
        return ()
    return tuple(sorted(p.stem for p in folder.glob("*.py") if not p.stem.startswith("_")))


def _load(folder: Path, name: str) -> ModuleType:
    # The folder becomes a package of its own, so that its files may import each other relatively.
    package = f"certpgo_{folder.name}"
    present = sys.modules.get(package)
    if present is None or list(present.__path__) != [str(folder)]:
        for stale in [k for k in sys.modules if k == package or k.startswith(f"{package}.")]:
            del sys.modules[stale]
        parent = ModuleType(package)
        parent.__path__ = [str(folder)]
        sys.modules[package] = parent
        importlib.invalidate_caches()
    return _imported(f"{package}.{name}", folder / f"{name.replace('.', '/')}.py")


def _imported(name: str, path: Path) -> ModuleType:
    """The module, or an error that names its file, whatever running that raises."""
    try:
        return importlib.import_module(name)
    except MissingDependency:
        raise
    except (Exception, SystemExit) as error:
        raise UnusableFile(path, error) from error


def _exposed(module: ModuleType, attribute: str) -> Any:
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise UnusableFile(module.__file__ or module.__name__, f"must expose {attribute}") from None

"""Registry of methods and benchmarks: files found by scanning folders and imported on demand.

A method is a file of ``certpgo/optimize/methods``, ``certpgo/solve/methods`` or, in a checkout,
``baselines``, that exposes ``SOLVER``. A checkout also holds the benchmarks, which are not in the
wheel: folders of files that each expose a specification, loaded by path, and the package
``reports.harness`` with their commands. Files whose names start with an underscore are shared code.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import types
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from certpgo.errors import MissingDependency, SpecError, UnusableFile, require

if TYPE_CHECKING:
    from certpgo.graph import Graph
    from certpgo.optimize.solution import Solver

#: Environment variable with the checkout's path, if the package is installed elsewhere.
REPOSITORY_VARIABLE = "CERTPGO_REPOSITORY"
#: What to do without a checkout.
NO_CHECKOUT = (
    "this needs a checkout of certpgo (it is not in the wheel): run it there, or set "
    f"{REPOSITORY_VARIABLE} to its path"
)

_PACKAGE = Path(__file__).parent
_METHODS = ("optimize.methods", "solve.methods")
_COMMANDS = "reports/harness/commands"


# --- Methods


def solver_names() -> tuple[str, ...]:
    """Names of the available methods: the package's own, and the baselines in a checkout."""
    return tuple(sorted({*_own_methods(), *names_in("baselines")}))


def _own_methods() -> dict[str, str]:
    """The package's own methods, with the packages that they are in."""
    folders = {package: _PACKAGE / package.replace(".", "/") for package in _METHODS}
    return {name: package for package, folder in folders.items() for name in _stems(folder)}


def get_solver(name: str) -> type[Solver]:
    """The method called ``name``: a frozen dataclass of its settings.

    Raises
    ------
    SpecError
        There is no such method, or its file cannot be loaded or exposes no dataclass ``SOLVER``.

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> get_solver("eigen_ra")(weights="unit").solve(problem).status.value
    'closed form'
    >>> get_solver("eigen_r")
    Traceback (most recent call last):
        ...
    certpgo.errors.SpecError: unknown method 'eigen_r'; did you mean eigen_ra or ...?
    """
    require(name, str, "the name of a method")
    if package := _own_methods().get(name):
        path = _PACKAGE / package.replace(".", "/") / f"{name}.py"
        module = _imported(f"certpgo.{package}.{name}", path)
    elif name in names_in("baselines"):
        module = load_file("baselines", name)
    else:
        raise unknown_method(name, solver_names())
    solver = exposed(module, "SOLVER")
    file = module.__file__ or name
    if not (isinstance(solver, type) and is_dataclass(solver)):
        raise UnusableFile(file, "SOLVER must be a dataclass of settings")
    missing = [part for part in ("poses", "rotations", "solve") if not hasattr(solver, part)]
    if missing:
        raise UnusableFile(file, f"SOLVER lacks {', '.join(missing)}")
    return cast("type[Solver]", solver)


def build(name: str, settings: Mapping[str, Any], *graphs: Graph) -> Solver:
    """The method called ``name`` with these settings, for graphs of kinds that it takes.

    Raises
    ------
    SpecError
        The method or a setting is unknown, or a setting has neither value nor default, or the
        method takes poses only, or rotations only.
    InputError
        The method rejects a setting's value.
    """
    solver = get_solver(name)
    known = setting_fields(solver)
    for key in settings:
        if key not in known:
            raise SpecError.unknown(f"setting of {name}", key, known)
    for key in known.keys() - defaults(solver).keys() - settings.keys():
        problem = f"{name}'s setting {key} has no default: --set {key}=VALUE sets it"
        raise UnusableFile(inspect.getfile(solver), problem)
    kinds = {graph.kind for graph in graphs}
    if "poses" in kinds and not solver.poses:
        raise SpecError(f"{name} takes rotation graphs only; this graph measures poses")
    if "rotations" in kinds and not solver.rotations:
        raise SpecError(f"{name} takes pose graphs only; this graph measures rotations")
    return solver(**settings)


def setting_fields(solver: type[Solver]) -> dict[str, Field[Any]]:
    """The settings of a method by name, without nested ones."""
    given = (f for f in fields(solver) if f.init)  # type: ignore[arg-type]
    return {f.name: f for f in given if not (is_dataclass(f.type) or is_dataclass(_default(f)))}


def defaults(solver: type[Solver]) -> dict[str, Any]:
    """Default values by setting, without settings that have none."""
    values = {name: _default(field) for name, field in setting_fields(solver).items()}
    return {name: value for name, value in values.items() if value is not MISSING}


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def parse_settings(name: str, assignments: Iterable[str]) -> dict[str, Any]:
    """Settings of a method from strings ``key=value``, each converted to its field's type.

    Raises
    ------
    SpecError
        A setting is unknown, ``=`` is missing, or the value has the wrong type.
    """
    solver = get_solver(name)
    try:
        hints = get_type_hints(solver)
    except NameError as error:
        raise UnusableFile(inspect.getfile(solver), error) from error
    parsed: dict[str, Any] = {}
    for text in assignments:
        key, equals, value = text.partition("=")
        if not equals:
            raise SpecError(f"a setting must be key=value, not {text!r}")
        if key not in setting_fields(solver):
            raise SpecError.unknown(f"setting of {name}", key, setting_fields(solver))
        parsed[key] = _converted(f"{name}: {key}", value, hints[key])
    return parsed


def _converted(what: str, text: str, kind: Any) -> Any:
    origin = get_origin(kind)
    if origin is Literal:
        if text not in get_args(kind):
            raise SpecError.unknown(f"value of {what}", text, map(str, get_args(kind)))
        return text
    if origin in (Union, types.UnionType):
        if text.lower() == "none" and type(None) in get_args(kind):
            return None
        [kind] = [k for k in get_args(kind) if k is not type(None)][:1]
        return _converted(what, text, kind)
    if kind is bool:
        if text.lower() not in ("true", "false"):
            raise SpecError(f"{what} must be true or false, not {text!r}")
        return text.lower() == "true"
    if kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            number = "an integer" if kind is int else "a number"
            raise SpecError(f"{what} must be {number}, not {text!r}") from None
    return text


def unknown_method(name: str, known: Iterable[str]) -> SpecError:
    """The error for an unknown method, which says where those of other programs are."""
    error = SpecError.unknown("method", name, known)
    if checkout() is not None:
        return error
    return SpecError(f"{error}; methods of other programs, such as GTSAM's, need a checkout")


# --- The checkout

_FOLDERS = ("baselines", "reports")


def repository() -> Path:
    """The root of the checkout, which holds ``baselines`` and ``reports``.

    It is the folder in the environment variable ``CERTPGO_REPOSITORY``, which needs only one of the
    two; else the one that contains the package, else the working directory.

    Raises
    ------
    SpecError
        None of these is a checkout.
    """
    root = checkout()
    if root is None:
        raise SpecError(NO_CHECKOUT)
    return root


def checkout() -> Path | None:
    """The root of the checkout, or None; see `repository`."""
    if named := os.environ.get(REPOSITORY_VARIABLE):
        root = Path(named).resolve()
        return root if any((root / folder).is_dir() for folder in _FOLDERS) else None
    return next(filter(_is_complete, _places()), None)


def source() -> Path:
    """The folder that contains the package, whose commit identifies the code."""
    return _PACKAGE.parent


def names_in(folder: str) -> tuple[str, ...]:
    """Names of the files in a folder of the checkout; none without a checkout."""
    root = checkout()
    return () if root is None else _stems(root / folder)


def load_file(folder: str, name: str) -> ModuleType:
    """Import a file of a folder of the checkout; dots in ``name`` separate subfolders.

    Raises
    ------
    SpecError
        There is no checkout.
    UnusableFile
        Running the file fails.
    """
    _make_harness_importable()
    # The folder becomes a package, so that its files can import each other relatively.
    path = repository() / folder
    package = f"certpgo_{path.name}"
    loaded = sys.modules.get(package)
    if loaded is None or list(loaded.__path__) != [str(path)]:
        for stale in [k for k in sys.modules if k == package or k.startswith(f"{package}.")]:
            del sys.modules[stale]
        parent = ModuleType(package)
        parent.__path__ = [str(path)]
        sys.modules[package] = parent
        importlib.invalidate_caches()
    return _imported(f"{package}.{name}", path / f"{name.replace('.', '/')}.py")


def exposed(module: ModuleType, attribute: str) -> Any:
    """An attribute that a module must expose.

    Raises
    ------
    UnusableFile
        The module lacks it.
    """
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise UnusableFile(module.__file__ or module.__name__, f"must expose {attribute}") from None


def command_names() -> tuple[str, ...]:
    """Names of the benchmark commands; none without a checkout."""
    root = _make_harness_importable()
    return () if root is None else _stems(root / _COMMANDS)


def get_command(name: str) -> Any:
    """The benchmark command called ``name``.

    Raises
    ------
    UnusableFile
        Its file cannot be loaded, or exposes no ``command``.
    """
    root = _make_harness_importable() or repository()
    module = _imported(f"reports.harness.commands.{name}", root / _COMMANDS / f"{name}.py")
    return exposed(module, "command")


def call_pickled(call: bytes) -> Any:
    """Call a pickled function with its arguments, in a process without the benchmarks loaded."""
    import pickle

    _make_harness_importable()
    function, *arguments = pickle.loads(call)
    return function(*arguments)


def _make_harness_importable() -> Path | None:
    """Make ``reports.harness`` importable; returns the root of its checkout, or None."""
    places = [root for root in (checkout(), *_places()) if root is not None]
    root = next((root for root in places if (root / _COMMANDS).is_dir()), None)
    if root is not None and str(root) not in sys.path:
        sys.path.append(str(root))
    return root


def _places() -> Iterator[Path]:
    yield source().resolve()
    with suppress(OSError):  # the working directory may have been deleted
        current = Path.cwd()
        if (current / _PACKAGE.name).is_dir():
            yield current.resolve()


def _is_complete(root: Path) -> bool:
    return all((root / folder).is_dir() for folder in _FOLDERS)


def _stems(folder: Path) -> tuple[str, ...]:
    files = [*folder.glob("*.py"), *(path.parent for path in folder.glob("*/__init__.py"))]
    return tuple(sorted(p.stem for p in files if not p.stem.startswith("_")))


def _imported(name: str, path: Path) -> ModuleType:
    """Import a module; any exception becomes an error with the path of its file."""
    try:
        return importlib.import_module(name)
    except MissingDependency:
        raise
    except (Exception, SystemExit) as error:
        raise UnusableFile(path, error) from error

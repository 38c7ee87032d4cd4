"""certpgo list: methods, datasets and formats, and whether they are available."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._options import Data, Json
from certpgo.cli._show import document, table
from certpgo.errors import CertPGOError, how_to_install

if TYPE_CHECKING:
    from certpgo.optimize.solution import Solver

EXAMPLES = (
    "certpgo list methods",
    "certpgo list datasets formats",
)
Rows = list[dict[str, str]]


class Listing(StrEnum):
    """What can be listed."""

    METHODS = "methods"
    DATASETS = "datasets"
    TABLES = "tables"
    FIGURES = "figures"
    FORMATS = "formats"
    ENGINES = "engines"


def command(
    kinds: Annotated[
        list[Listing] | None,
        typer.Argument(metavar="KIND", help="What to list; everything by default."),
    ] = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """List methods, datasets, tables, figures, formats and engines with their availability."""
    listed = {kind.value: _rows(kind, data) for kind in kinds or list(Listing)}
    if json:
        document(listed)
        return
    for name, rows in listed.items():
        if not rows:
            typer.echo(f"{name}: {_NONE.get(name, 'none')}\n")
            continue
        header = list(rows[0])
        cells = [list(row.values()) for row in rows]
        table(name, header, cells, _CAPTIONS.get(name, ""), optional=["settings"])


#: Why a list is empty.
_NONE = dict.fromkeys(("tables", "figures"), "in a checkout only, and this is none")
_CAPTIONS = {"methods": "settings with their defaults; change them with --set KEY=VALUE\n"}


def _rows(kind: Listing, data: Path | None) -> Rows:
    if kind is Listing.METHODS:
        return _methods()
    if kind is Listing.DATASETS:
        return _datasets(data)
    if kind is Listing.TABLES:
        return _experiments("reports/tables", "TABLE")
    if kind is Listing.FIGURES:
        return _experiments("reports/figures", "FIGURE")
    return _formats() if kind is Listing.FORMATS else _engines()


def _methods() -> Rows:
    from certpgo import registry

    return [_method(name, registry.get_solver) for name in registry.solver_names()]


def _method(name: str, get_solver: Callable[[str], type[Solver]]) -> dict[str, str]:
    try:
        solver = get_solver(name)
    except CertPGOError as error:  # a broken file must not hide the others
        return {"name": name, "takes": "", "here": "no", "what": str(error), "settings": ""}
    return {
        "name": name,
        "takes": _kinds(solver),
        "here": _missing_package(name) or "yes",
        "what": _summary(solver),
        "settings": _settings(solver),
    }


def _kinds(solver: type[Solver]) -> str:
    if solver.poses and solver.rotations:
        return "both"
    return "poses" if solver.poses else "rotations"


def _summary(solver: type) -> str:
    # Clauses with backquotes refer to the Python documentation.
    first = (solver.__doc__ or "").strip().partition("\n")[0]
    return re.sub(r"[;,] [^;,]*`.*", "", first).rstrip(".")


def _settings(solver: type[Solver]) -> str:
    from certpgo.registry import defaults, setting_fields

    known = {key: f"={_text(value)}" for key, value in defaults(solver).items()}
    return ", ".join(key + known.get(key, "") for key in setting_fields(solver))


def _text(value: object) -> str:
    # In the syntax of --set: true, false, none.
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


#: By prefix of a method's name: the package it calls, and the extra that installs it.
_CALLED = {
    "gtsam": ("gtsam", "baselines"),
    "g2o": ("g2opy", "baselines"),
    "ceres": ("pyceres", "baselines"),
    "pymanopt": ("pymanopt", "test"),
    "sdp": ("cvxpy", ""),
}


def _missing_package(method: str) -> str:
    from certpgo.optimize.methods._sdp import INSTALL_CVXPY

    package, extra = _CALLED.get(method.partition("_")[0], ("", ""))
    if not package or importlib.util.find_spec(package) is not None:
        return ""
    return f"no: {how_to_install(extra, package) if extra else INSTALL_CVXPY}"


def _datasets(data: Path | None) -> Rows:
    from certpgo.io import datasets

    rows = []
    for name in datasets.names():
        entry, path = datasets.entry(name), datasets.find(name, data)
        missing = "no: certpgo fetch" if entry.url else "no, and no download is known"
        rows.append(
            {
                "name": name,
                "holds": entry.kind,
                "d": str(entry.d),
                "nodes": str(entry.nodes or ""),
                "edges": str(entry.edges or ""),
                "here": str(path) if path else missing,
            }
        )
    return rows


def _experiments(folder: str, attribute: str) -> Rows:
    from certpgo import registry

    return [_title(folder, name, attribute) for name in registry.names_in(folder)]


def _title(folder: str, name: str, attribute: str) -> dict[str, str]:
    from certpgo import registry

    try:
        title = registry.exposed(registry.load_file(folder, name), attribute).title
    except (CertPGOError, AttributeError) as error:
        title = str(error)
    return {"name": name, "title": title}


def _formats() -> Rows:
    from certpgo.io.format import formats

    return [
        {
            "name": form.name,
            "suffixes": " ".join(form.suffixes),
            "graphs": _ways(form.read_graph, form.write_graph),
            "estimates": _ways(form.read_poses, form.write_poses),
        }
        for form in formats().values()
    ]


def _ways(read: object, write: object) -> str:
    return ", ".join(name for name, way in (("read", read), ("write", write)) if way is not None)


#: Of what is computed by NumPy and SuperLU, and read by Python; see docs/multifrontal.md.
_COSTS = (
    "reading takes 2 to 4 times as long, solving 2 to 15, certifying 5 to 20; answers are as good"
)


def _engines() -> Rows:
    from certpgo.linalg import compiled
    from certpgo.linalg.factor import default_engine, engines

    licences = {"multifrontal": "MIT, compiled with certpgo", "superlu": "BSD, in SciPy"}
    why = compiled.COMPILED if compiled.LEFT_OUT else "installed without a C compiler"
    missing = f"no: {why}; {_COSTS}"
    return [
        {
            "name": name,
            "licence": licence,
            "here": "yes" if name in engines() else missing,
            "in use": "yes" if name == default_engine() else "",
        }
        for name, licence in licences.items()
    ]

"""Pages of the methods, found as by the registry: a new file appears on the site by itself."""

from __future__ import annotations

import ast
from pathlib import Path

from certpgo import registry

_SOLVER = """\
{name}
{line}

.. automodule:: certpgo.optimize.methods.{name}
   :no-members:

.. autoclass:: certpgo.optimize.methods.{name}.{solver}
   :no-members:

Input: {kinds}.
"""

_SHARED = """\
Settings that methods share
===========================

"""

_BASE = """\
.. autoclass:: {module}.{name}
   :no-members:

"""

#: Included by the page of methods; not a page itself.
_OVERVIEW = """\
| method | input | description |
|---|---|---|
"""

_BASELINES = """\
Baselines
=========

Competing methods, in the checkout's folder ``baselines`` and not part of the wheel.
``certpgo.get_solver(NAME)`` and ``--method NAME`` find them like any method, and
``certpgo list methods`` shows which packages they need and their settings.

.. list-table::
   :header-rows: 1

   * - name
     - description
"""


def pages() -> dict[str, str]:
    """Pages by file name: each method of the package, lists of them and of the baselines."""
    own = [path.stem for path in _files(registry.checkout(), "certpgo/optimize/methods")]
    made = {f"{name}.rst": _solver_page(name) for name in own}
    rows = "".join(
        f"   * - ``{path.stem}``\n     - {_summary(path)}\n"
        for path in _files(registry.checkout(), "baselines")
    )
    made["baselines.rst"] = _BASELINES + rows
    made["overview.txt"] = _OVERVIEW + "".join(
        f"| [`{name}`](methods/{name}.rst) | {_kinds(name)} | {_summary(path)} |\n"
        for name, path in zip(
            own, _files(registry.checkout(), "certpgo/optimize/methods"), strict=True
        )
    )
    bases = {base for name in own for base in registry.get_solver(name).__mro__}
    shared = sorted((b.__module__, b.__name__) for b in bases if "solvers._" in b.__module__)
    made["shared-settings.rst"] = _SHARED + "".join(
        _BASE.format(module=module, name=name) for module, name in shared
    )
    return made


def _solver_page(name: str) -> str:
    solver = registry.get_solver(name)
    return _SOLVER.format(
        name=name, line="=" * len(name), solver=solver.__name__, kinds=_kinds(name)
    )


def _kinds(name: str) -> str:
    solver = registry.get_solver(name)
    return " and ".join(kind for kind in ("poses", "rotations") if getattr(solver, kind))


def _files(root: Path | None, folder: str) -> list[Path]:
    if root is None:
        return []
    return sorted(p for p in (root / folder).glob("*.py") if not p.stem.startswith("_"))


def _summary(path: Path) -> str:
    """A file's first sentence; the file is not imported, since its package may be missing."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return text.partition("\n\n")[0].replace("\n", " ")

"""Tables and figures by name: one file each in the checkout's ``reports``."""

from __future__ import annotations

from typing import Any

from certpgo import registry
from certpgo.errors import SpecError

TABLES, FIGURES = "reports/tables", "reports/figures"


def table_names() -> tuple[str, ...]:
    """Names of the tables that `reproduce` knows; none without a checkout."""
    return registry.names_in(TABLES)


def get_table(name: str) -> Any:
    """The specification of the table called ``name``, as ``moreira2020-table5.7`` or with ``_``.

    Raises
    ------
    SpecError
        No checkout, no such table (with the nearest names), or a file that exposes no ``TABLE``.
    """
    return _get(TABLES, "table", name)


def figure_names() -> tuple[str, ...]:
    """Names of the figures that `reproduce` knows; none without a checkout."""
    return registry.names_in(FIGURES)


def get_figure(name: str) -> Any:
    """The specification of the figure called ``name``, as ``moreira2020-figure5.1`` or with ``_``.

    Raises
    ------
    SpecError
        No checkout, no such figure (with the nearest names), or a file that exposes no ``FIGURE``.
    """
    return _get(FIGURES, "figure", name)


def get_experiment(name: str) -> Any:
    """The table or figure called ``name``.

    Raises
    ------
    SpecError
        No checkout, or no table or figure of that name, with the nearest names of both kinds.
    """
    registry.repository()
    if _stem(name) in figure_names():
        return get_figure(name)
    if _stem(name) in table_names():
        return get_table(name)
    raise SpecError.unknown("table or figure", _stem(name), (*table_names(), *figure_names()))


def _get(folder: str, kind: str, name: str) -> Any:
    registry.repository()
    stem = _stem(name)
    if stem not in registry.names_in(folder):
        raise SpecError.unknown(kind, stem, registry.names_in(folder))
    return registry.exposed(registry.load_file(folder, stem), kind.upper())


def _stem(name: str) -> str:
    return name.replace("-", "_").replace(".", "_")

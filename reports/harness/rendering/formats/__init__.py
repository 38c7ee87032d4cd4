"""Formats of rendered tables: one file each in this folder, exposing ``FORM``."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Table


@dataclass(frozen=True)
class Form:
    """A format of rendered tables.

    Attributes
    ----------
    suffix : of the files, without the dot
    title : what it is called
    render : the table's text, a pure function
    """

    suffix: str
    title: str
    render: Callable[[Table, Sequence[Record]], str]


def forms() -> Mapping[str, Form]:
    """Every format of the folder, by suffix."""
    names = sorted(module.name for module in pkgutil.iter_modules(__path__))
    modules = [importlib.import_module(f"{__name__}.{name}") for name in names]
    return MappingProxyType({module.FORM.suffix: module.FORM for module in modules})

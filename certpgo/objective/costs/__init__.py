"""The costs of relative poses, one file each, found by their names.

``NAME.py`` exposes ``COST``, a `certpgo.objective.edge_cost.EdgeCost` called NAME. Adding a file
here adds the cost everywhere, see `COSTS`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from certpgo.errors import UnusableFile

if TYPE_CHECKING:
    from certpgo.objective.edge_cost import EdgeCost

#: The name of F itself.
CHORDAL = "chordal"


@cache
def _names(*folders: str) -> tuple[str, ...]:
    return tuple(sorted(module.name for module in pkgutil.iter_modules(folders)))


class _Folder(Mapping[str, "type[EdgeCost]"]):
    """Costs by name, each loaded when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        return iter(_names(*__path__))

    def __len__(self) -> int:
        return len(_names(*__path__))

    def __contains__(self, name: object) -> bool:
        return name in _names(*__path__)

    def __getitem__(self, name: str) -> type[EdgeCost]:
        if name not in _names(*__path__):
            raise KeyError(name)
        try:
            cost: type[EdgeCost] = import_module(f"{__name__}.{name}").COST
        except Exception as error:
            raise UnusableFile(f"{name}.py", error) from error
        if cost.name != name:
            raise UnusableFile(f"{name}.py", f"COST must be called {name}, not {cost.name}")
        return cost


#: The costs of the folder by name.
COSTS: Mapping[str, type[EdgeCost]] = _Folder()

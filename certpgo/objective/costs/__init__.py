"""The costs of relative poses, one file each, found by their names.

``NAME.py`` exposes ``COST``, a `certpgo.objective.edge_cost.EdgeCost` called NAME. Adding a file
here adds the cost everywhere, see `COSTS`.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from certpgo.errors import UnusableFile

if TYPE_CHECKING:
    from certpgo.objective.edge_cost import EdgeCost

#: The name of F itself.
CHORDAL = "chordal"


class _Folder(Mapping[str, "type[EdgeCost]"]):
    """Costs by name, each loaded when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(module.name for module in pkgutil.iter_modules(__path__)))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in tuple(self)

    def __getitem__(self, name: str) -> type[EdgeCost]:
        if name not in self:
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

"""What is said about graphs of the register: remarks, published values, wrong values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from certpgo.errors import FormatError
from certpgo.objective.costs import COSTS

FILE = "remarks.toml"


@dataclass(frozen=True)
class StatedValue:
    """A value of an optimum that others state.

    Attributes
    ----------
    cost : that it is of
    value : as it is printed
    source : where it stands; or of a wrong one, why it is not the optimum
    """

    cost: str
    value: str
    source: str


@dataclass(frozen=True)
class Remarks:
    """What is said about a graph.

    Attributes
    ----------
    text : sentences, or empty
    published : the best values in print
    wrong : values that circulate and are not the optimum
    """

    text: str = ""
    published: tuple[StatedValue, ...] = ()
    wrong: tuple[StatedValue, ...] = ()

    def of(self, cost: str) -> tuple[StatedValue, ...]:
        """The published values under a cost."""
        return tuple(one for one in self.published if one.cost == cost)


def read_remarks(folder: Path) -> dict[str, Remarks]:
    """The remarks of a register, by name of graph; none if it has no such file.

    Raises
    ------
    FormatError
        The file is not as described in its first lines.
    """
    import tomllib

    path = folder / FILE
    if not path.is_file():
        return {}
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8"))
        return {name: _remarks(name, table) for name, table in found.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        said = f"expected remarks by graph: {str(error) or type(error).__name__}"
        raise FormatError(path, None, said) from None


def _remarks(name: str, table: dict[str, Any]) -> Remarks:
    if unknown := table.keys() - {"remark", "published", "wrong"}:
        raise ValueError(f"[{name}] has {', '.join(sorted(unknown))}")
    published = tuple(_printed(one, "source") for one in table.get("published", ()))
    wrong = tuple(_printed(one, "reason") for one in table.get("wrong", ()))
    return Remarks(table.get("remark", ""), published, wrong)


def _printed(one: dict[str, str], of: str) -> StatedValue:
    if one["cost"] not in COSTS:
        raise ValueError(f"unknown cost {one['cost']!r}")
    return StatedValue(one["cost"], one["value"], one[of])

"""Which options of a command exclude or need each other: the rows of its table, and what reads it.

A command's file lists them as ``RULES``, which are tried before the command begins. Others hold for
what it finds: that a graph has several components, say.
"""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase

from certpgo.errors import InputError


class Rule:
    """A combination of options that is refused.

    Parameters
    ----------
    said : why, with ``{option}`` for the first option, and ``{name}`` for the value of any
    given : names of the command's parameters, all given: with values other than the default. Of
        ``"a|b"`` one is enough, and ``"a=x*"`` has such a value
    without : the same, of what is not given
    """

    def __init__(self, said: str, *given: str, without: str = "") -> None:
        self.said, self.given, self.without = said, given, without


def chordal_only(*options: str) -> Rule:
    """That options exist, together, for the chordal cost only."""
    named = " ".join(f"--{option}" for option in options)
    said = f"{named} is for --cost chordal, not for --cost {{cost}}"
    return Rule(said, *options, "cost", without="cost=chordal")


def no_kernel(*options: str) -> Rule:
    """That options exist for costs without a kernel only."""
    return Rule("--{option} is not for a cost with --kernel", "|".join(options), "kernel")


def without_known_scale(option: str) -> Rule:
    """That --graph is an .npz file, which alone holds graphs without any known scale."""
    said = "{graph}: only .npz files hold a graph without any known scale"
    return Rule(said, option, "graph", without="graph=?*.npz")


def refuse(rules: Iterable[Rule], /, **values: object) -> None:
    """Refuse the first combination that a rule is about.

    Parameters
    ----------
    values : of the options, and what else is so; None or False for what is not given

    Raises
    ------
    InputError
        As the rule says.
    """
    for rule in rules:
        found = [_given(names, values) for names in rule.given]
        if all(found) and not _given(rule.without, values):
            option = "".join(found[:1]).replace("_", "-")
            raise InputError(rule.said.format(option=option, **values))


def _given(names: str, values: dict[str, object]) -> str:
    """The first of some options, divided by bars, that is given; empty if none is."""
    for name, _, pattern in (one.partition("=") for one in names.split("|")):
        value = values.get(name)
        if value is not None and value is not False and fnmatchcase(str(value), pattern or "*"):
            return name
    return ""

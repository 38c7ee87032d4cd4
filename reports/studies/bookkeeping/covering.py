"""Rows in which every pair of levels of two factors meets, at random.

A row chooses a level of each factor. Pairs that a program refuses would hide the others in their
row, so that rows avoid them, and each is asked on its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

Factors = Mapping[str, Sequence[str]]
Row = dict[str, str]
Pair = tuple[tuple[str, str], tuple[str, str]]
#: Attempts at a row with a pair.
ATTEMPTS = 100


@dataclass(frozen=True)
class Rule:
    """Levels that do not go together.

    Attributes
    ----------
    levels : for each factor, those that are meant
    said : what the message says, a regular expression; empty where the question cannot be asked
    why : for the documentation; empty where the question cannot be asked
    """

    levels: Mapping[str, tuple[str, ...]]
    said: str = ""
    why: str = ""

    def forbids(self, row: Mapping[str, str]) -> bool:
        """Whether a row, or the part of it that is chosen, has all of these."""
        return all(row.get(factor) in levels for factor, levels in self.levels.items())

    @property
    def choices(self) -> list[Row]:
        """Each choice of one level of each factor."""
        return [dict(zip(self.levels, one, strict=True)) for one in product(*self.levels.values())]


def rows(factors: Factors, rules: Sequence[Rule], rng: np.random.Generator) -> list[Row]:
    """A covering array: each pair that the rules allow is in a row, if it can be in one."""
    left, found = set(pairs(factors, rules)), []
    while left:
        pair = sorted(left)[int(rng.integers(len(left)))]
        row = _row(factors, rules, rng, dict(pair), left)
        left -= {pair} if row is None else pairs_of(row)
        found += [] if row is None else [row]
    return found


def refused(
    factors: Factors, rules: Sequence[Rule], rng: np.random.Generator
) -> Iterator[tuple[Row, Rule]]:
    """A row for each choice that is refused, in which nothing else is; with its rule."""
    for rule in rules:
        for choice in rule.choices if rule.said else []:
            others = [other for other in rules if not other.forbids(choice)]
            if any(not other.said and other.forbids(choice) for other in rules):
                continue
            row = _row(factors, others, rng, choice, set())
            if row is not None:
                yield row, rule


def pairs(factors: Factors, rules: Sequence[Rule]) -> Iterator[Pair]:
    """All pairs of levels that no rule forbids."""
    for (a, of_a), (b, of_b) in combinations(factors.items(), 2):
        for one, other in product(of_a, of_b):
            if not any(rule.forbids({a: one, b: other}) for rule in rules):
                yield _pair((a, one), (b, other))


def pairs_of(row: Mapping[str, str]) -> set[Pair]:
    """The pairs in a row."""
    return {_pair(a, b) for a, b in combinations(row.items(), 2)}


def _pair(a: tuple[str, str], b: tuple[str, str]) -> Pair:
    return (a, b) if a < b else (b, a)


def _row(
    factors: Factors,
    rules: Sequence[Rule],
    rng: np.random.Generator,
    begun: Row,
    wanted: set[Pair],
) -> Row | None:
    """A row with what is begun, and many of the wanted pairs; None if none was found."""
    names = [name for name in factors if name not in begun]
    about = {name: [rule for rule in rules if name in rule.levels] for name in names}
    for _ in range(ATTEMPTS):
        row = dict(begun)
        for k in rng.permutation(len(names)).tolist():
            name = names[k]
            allowed = [
                level
                for level in rng.permutation(factors[name]).tolist()
                if not any(rule.forbids({**row, name: level}) for rule in about[name])
            ]
            if not allowed:
                break
            gains = [
                sum(_pair(item, (name, level)) in wanted for item in row.items())
                for level in allowed
            ]
            row[name] = allowed[int(np.argmax(gains))]
        if len(row) == len(factors):
            return {name: row[name] for name in factors}
    return None

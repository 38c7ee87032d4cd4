"""Competitors' rules for certifying: one file each in the checkout's ``baselines/certifiers``."""

from __future__ import annotations

from collections.abc import Callable

from certpgo import registry
from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic

#: A rule that is given an estimate and returns the one it calls optimal (the same, or where its own
#: descent ended), or None. It raises InputError for a problem that it does not take.
Rule = Callable[[Quadratic, Estimate], Estimate | None]


def rule_names() -> tuple[str, ...]:
    """Names of the competitors' rules; none without a checkout."""
    return registry.names_in("baselines/certifiers")


def get_rule(name: str) -> Rule:
    """The rule called ``name``.

    Raises
    ------
    SpecError
        No checkout, no such rule, or a file that exposes no ``CERTIFIER``.
    """
    if name not in rule_names():
        raise SpecError.unknown("certifier", name, rule_names())
    rule: Rule = registry.exposed(
        registry.load_file("baselines", f"certifiers.{name}"), "CERTIFIER"
    )
    return rule

"""What a diagnosis finds: mistakes as hypotheses, each with two costs side by side."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from certpgo.graph.display import Speaking
from certpgo.graph.phrases import cost_shown, counted
from certpgo.io.json_values import plain

#: Findings that are shown.
SHOWN = 5
COMMAND = "certpgo"
#: The noise is overstated, and what is remarked where anything is found: these spoil no map.
OVERSTATED, REMARK = "noise-too-large", "bridge"


@dataclass(frozen=True)
class Finding:
    """One mistake that explains what is seen, and what to do about it.

    Attributes
    ----------
    kind : its name, such as ``"quaternion-w-first"``
    said : a sentence with the numbers, without its end
    next : what to type or to do next
    cost, cost_as_given : what is judged with the mistake undone, and as it stands: costs, or errors
        against truth, of one unit; None where nothing is compared
    strength : how much it explains, to compare findings: the logarithm to base 10 of the ratio of
        the two costs, unless it is stated
    edges : numbers of the measurements that it is about, see `certpgo.Instance`
    proven : whether it is proven, not only by far the better explanation

    Examples
    --------
    >>> from certpgo import Finding
    >>> wrong = Finding("mirrored", "y has the other sign", "negate y", 3.0, 3000.0)
    >>> print(wrong, round(wrong.strength, 3))
    Y has the other sign. Negate y 3.0
    """

    kind: str
    said: str
    next: str
    cost: float | None = None
    cost_as_given: float | None = None
    strength: float = math.nan
    edges: tuple[int, ...] = ()
    proven: bool = False

    def __post_init__(self) -> None:
        if math.isnan(self.strength):
            object.__setattr__(self, "strength", explained(self.cost, self.cost_as_given))

    def __str__(self) -> str:
        sentences = (self.said, self.next) if self.next else (self.said,)
        return ". ".join(map(_begun, sentences))


def _begun(sentence: str) -> str:
    """A sentence with its first letter large, unless it begins with a command to type."""
    if sentence.startswith(f"{COMMAND} "):
        return sentence
    return f"{sentence[:1].upper()}{sentence[1:]}"


def explained(cost: float | None, as_given: float | None) -> float:
    """The logarithm to base 10 of the ratio of two costs; 0 without both, 16 at most."""
    if cost is None or as_given is None or not as_given > 0.0:
        return 0.0
    return 16.0 if cost <= 1e-16 * as_given else math.log10(as_given / cost)


@dataclass(frozen=True)
class Costs:
    """What a map costs, and what the best one does.

    Attributes
    ----------
    best : the least cost known
    lower_bound : no estimate costs less; None if nothing is proven
    given : of the estimate that is asked about; None without one
    is_optimal : whether the best one is proven to be the optimum

    Examples
    --------
    >>> from certpgo.diagnosis.finding import Costs
    >>> print(Costs(427.2, 427.1, 430.5, is_optimal=True))
    the estimate costs 430.5, the optimum 427.2
    >>> print(Costs(427.2, 390.0))
    the best estimate costs 427.2, none less than 390
    """

    best: float
    lower_bound: float | None = None
    given: float | None = None
    is_optimal: bool = False

    def __str__(self) -> str:
        best = "the optimum" if self.is_optimal else "the best estimate"
        said = f"{best} costs {cost_shown(self.best)}"
        if self.given is not None:
            said = f"the estimate costs {cost_shown(self.given)}, {best} {cost_shown(self.best)}"
        if self.is_optimal or self.lower_bound is None:
            return said
        return f"{said}, none less than {cost_shown(self.lower_bound)}"


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Speaking):
    """What may be wrong with a map, best explanation first.

    Attributes
    ----------
    findings : of falling strength; empty if nothing was found
    tried : how many hypotheses were tried
    about : what was examined, in a phrase
    detectable : what sizes of errors would have been found, in words
    costs : of the map that is asked about and of the best one known, where there is no finding
    truth : of how many poses it is known, and how far off these are, in words; empty without one

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> made = helix(6, np.random.default_rng(0))
    >>> turned = certpgo.Estimate(np.swapaxes(made.truth.rotations, 1, 2), made.truth.translations)
    >>> found = certpgo.diagnose(made, turned)
    >>> found.findings[0].kind
    'inverse-rotations'
    """

    findings: tuple[Finding, ...]
    tried: int
    about: str
    detectable: str = ""
    costs: Costs | None = None
    truth: str = ""

    @property
    def _kinds(self) -> set[str]:
        return {finding.kind for finding in self.findings}

    @property
    def headline(self) -> str:
        """The first finding, or that there is none, in sentences without the last full stop."""
        if self.findings:
            first = self.findings[0]
            if first.kind == OVERSTATED and self._kinds <= {OVERSTATED, REMARK}:
                said = f"nothing is wrong with the map but its stated noise: {first.said}"
                first = replace(first, said=said)
            return str(first).removesuffix(".")
        said = f"None of {counted(self.tried, 'known mistake{s}')} explains anything here"
        return said if self.costs is None else f"{said}: {self.costs}"

    def facts(self, shown: int = SHOWN) -> Iterator[tuple[str, str]]:
        """What was examined, and what would have been seen, as names and values.

        Parameters
        ----------
        shown : how many findings are listed between these, but for the first: ``"or 2"``, ...
        """
        yield "examined", self.about
        for number, finding in enumerate(self.findings[1:shown], 2):
            yield f"or {number}", str(finding)
        if self.truth:
            yield "truth", self.truth
        if self.detectable:
            yield "detectable", self.detectable

    @property
    def _headline(self) -> str:
        return self.headline

    def _facts(self) -> Iterator[tuple[str, str]]:
        return self.facts()

    def as_data(self) -> dict[str, Any]:
        """Everything, for JSON."""
        return {
            "about": self.about,
            "tried": self.tried,
            "detectable": self.detectable or None,
            "truth": self.truth or None,
            "costs": None if self.costs is None else asdict(self.costs),
            "findings": [asdict(finding) for finding in self.findings],
        }

    def to_json(self, indent: int | None = 2) -> str:
        """The same as a JSON object; infinite numbers are null.

        Parameters
        ----------
        indent : of the lines; None for a single one
        """
        return json.dumps(plain(self.as_data()), indent=indent, allow_nan=False)

"""Why a map is wrong: mistakes of conventions, measurements, noise, frames and times."""

from __future__ import annotations

from typing import TYPE_CHECKING

from certpgo._lazy import attributes

if TYPE_CHECKING:
    from certpgo.diagnosis.diagnosing import cause_in_measurements, diagnose, first_finding
    from certpgo.diagnosis.examined import Examined, KnownTruth
    from certpgo.diagnosis.finding import Diagnosis, Finding

__all__ = [
    "Diagnosis",
    "Examined",
    "Finding",
    "KnownTruth",
    "cause_in_measurements",
    "diagnose",
    "first_finding",
]

# What a graph says as it stands needs no search.
_HOMES = {
    "Diagnosis": "finding",
    "Examined": "examined",
    "Finding": "finding",
    "KnownTruth": "examined",
    "cause_in_measurements": "diagnosing",
    "diagnose": "diagnosing",
    "first_finding": "diagnosing",
}
__getattr__ = attributes(__name__, _HOMES)

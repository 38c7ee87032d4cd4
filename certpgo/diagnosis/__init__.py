"""Why a map is wrong: mistakes of conventions, measurements, noise, frames and times."""

from certpgo.diagnosis.diagnosing import diagnose, first_finding
from certpgo.diagnosis.examined import Examined, KnownTruth
from certpgo.diagnosis.finding import Diagnosis, Finding

__all__ = ["Diagnosis", "Examined", "Finding", "KnownTruth", "diagnose", "first_finding"]

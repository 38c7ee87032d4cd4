"""Why a map is wrong: mistakes of conventions, measurements, noise, frames and times."""

from certpgo.diagnosis.diagnosing import diagnose
from certpgo.diagnosis.examined import KnownTruth
from certpgo.diagnosis.finding import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "KnownTruth", "diagnose"]

"""Certificates: multipliers, bounds, verdicts. Independent of any solver."""

from certpgo.certify.bounds import Bounds, bounds
from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.dual import DualBound, dual_bound
from certpgo.objective.objective import cost_upper

__all__ = [
    "Bounds",
    "Certificate",
    "DualBound",
    "Tier",
    "Verdict",
    "bounds",
    "cost_upper",
    "dual_bound",
]

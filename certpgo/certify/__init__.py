"""Certificates: multipliers, bounds, verdicts. Independent of any solver."""

from __future__ import annotations

from typing import TYPE_CHECKING

from certpgo._lazy import attributes

if TYPE_CHECKING:
    from certpgo.certify.certificate import Certificate, Tier, Verdict
    from certpgo.certify.dual import DualBound, dual_bound

__all__ = ["Certificate", "DualBound", "Tier", "Verdict", "dual_bound"]

# What bounds alone needs no verdict.
_HOMES = {
    "Certificate": "certificate",
    "DualBound": "dual",
    "Tier": "certificate",
    "Verdict": "certificate",
    "dual_bound": "dual",
}
__getattr__ = attributes(__name__, _HOMES)

"""The register of certified optima of public graphs.

`recognise` and `known_optimum` tell whether a graph is a public one, from its measurements alone,
and what is proven of its optimum; no search is needed for that. `Register` is the list itself.
"""

from __future__ import annotations

from certpgo.optima.fingerprint import Fingerprint, fingerprint
from certpgo.optima.recognition import Recognised, known_optimum, recognise
from certpgo.optima.register import Absent, Optimum, Register, Sizes

__all__ = [
    "Absent",
    "Fingerprint",
    "Optimum",
    "Recognised",
    "Register",
    "Sizes",
    "fingerprint",
    "known_optimum",
    "recognise",
]

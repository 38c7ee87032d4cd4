"""The compiled kernel, where certpgo was installed with a C compiler; else there is no `kernel`.

``CERTPGO_KERNEL=0`` in the environment leaves it out. Whoever calls a function of the kernel asks
`compiled.AVAILABLE` first, and has the same in NumPy, SciPy or Python.
"""

import os

#: Whether the environment leaves it out.
LEFT_OUT = os.environ.get("CERTPGO_KERNEL") == "0"

try:
    if LEFT_OUT:
        raise ImportError
    from certpgo.linalg import _kernel as kernel
except (ImportError, AttributeError, KeyError):  # no kernel, or another SciPy than it knows
    AVAILABLE = False
else:
    AVAILABLE = True

#: How to get it.
COMPILED = (
    "CERTPGO_KERNEL=0 leaves it out"
    if LEFT_OUT
    else "install certpgo again from its sources, where a C compiler is"
)

#: Largest rank of points that it takes.
LARGEST_RANK = 32

__all__ = ["AVAILABLE", "COMPILED", "LARGEST_RANK", "LEFT_OUT", "kernel"]

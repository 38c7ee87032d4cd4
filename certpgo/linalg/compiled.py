"""The compiled kernel, where certpgo was installed with a C compiler; else there is no `kernel`."""

try:
    from certpgo.linalg import _kernel as kernel
except (ImportError, AttributeError, KeyError):  # no kernel, or another SciPy than it knows
    AVAILABLE = False
else:
    AVAILABLE = True

#: How to get it.
COMPILED = "install certpgo again from its sources, where a C compiler is"

#: Largest rank of points that it takes.
LARGEST_RANK = 32

__all__ = ["AVAILABLE", "COMPILED", "LARGEST_RANK", "kernel"]

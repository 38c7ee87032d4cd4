"""The compiled kernel, where certpgo was installed with a C compiler; else there is no `kernel`.

``CERTPGO_KERNEL=0`` in the environment leaves it out. Whoever calls a function of the kernel asks
`compiled.AVAILABLE` first, and has the same in NumPy, SciPy or Python.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from types import ModuleType

import scipy

#: Whether the environment leaves it out.
LEFT_OUT = os.environ.get("CERTPGO_KERNEL") == "0"

#: SciPy's modules in which the kernel finds BLAS and LAPACK.
_TABLES = ("scipy.linalg.cython_blas", "scipy.linalg.cython_lapack")


@contextmanager
def _tables_alone() -> Iterator[list[ModuleType]]:
    """SciPy's tables without the package around them, whose import takes as long as NumPy's.

    The package finds nothing of this: it imports them again.
    """
    held = list[ModuleType]()
    if "scipy.linalg" not in sys.modules:
        folders = [os.path.join(folder, "linalg") for folder in scipy.__path__]
        for name in _TABLES:
            spec = PathFinder.find_spec(name, folders)
            if spec is not None and spec.loader is not None:
                held.append(module := module_from_spec(spec))
                sys.modules[name] = module
                spec.loader.exec_module(module)
    try:
        yield held
    finally:
        for module in held:
            sys.modules.pop(module.__name__, None)


try:
    if LEFT_OUT:
        raise ImportError
    with _tables_alone() as _held:  # as long as the kernel
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

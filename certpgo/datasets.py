"""The former name of `certpgo.io.datasets`."""

import sys
import warnings

from certpgo.io.datasets import (
    Entry,
    catalogue,
    edges,
    entry,
    fetch,
    find,
    load,
    names,
    synthetic,
    thesis,
    truth,
)

__all__ = [
    "Entry",
    "catalogue",
    "edges",
    "entry",
    "fetch",
    "find",
    "load",
    "names",
    "synthetic",
    "thesis",
    "truth",
]

# So that `from certpgo.datasets.synthetic import helix` works too.
for _module in (catalogue, edges, synthetic, thesis):
    sys.modules[_module.__name__.replace(".io.", ".")] = _module
warnings.warn("certpgo.datasets is now certpgo.io.datasets", DeprecationWarning, stacklevel=2)

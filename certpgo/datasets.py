"""The former name of `certpgo.io.datasets`."""

import sys
import warnings

from certpgo.io import datasets
from certpgo.io.datasets import catalogue, edges, synthetic, thesis

warnings.warn("certpgo.datasets is now certpgo.io.datasets", DeprecationWarning, stacklevel=2)
# Both names are of the same modules.
for _module in (datasets, catalogue, edges, synthetic, thesis):
    sys.modules[_module.__name__.replace(".io.", ".")] = _module

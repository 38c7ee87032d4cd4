"""The links of rtabmap's graphs: their types (corelib/include/rtabmap/core/Link.h)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.graph.phrases import counted
from certpgo.linalg.arrays import IntArray

#: Types of links between poses, from neighbours to merged ones.
BETWEEN = range(7)
#: Of a pose in the world.
PRIOR = 7
_SKIPPED = {
    PRIOR: "prior{s} of poses",
    8: "sighting{s} of landmarks",
    9: "measurement{s} of gravity",
}


def skipped_links(kinds: IntArray, *, priors: bool = True) -> Iterator[str]:
    """Notices about links (k,) that are not read, by their types.

    Parameters
    ----------
    priors : whether priors are skipped
    """
    for kind, what in _SKIPPED.items():
        if (count := int(np.sum(kinds == kind))) and (priors or kind != PRIOR):
            yield counted(count, f"{what} skipped")
    if others := int(np.sum(~np.isin(kinds, [*BETWEEN, *_SKIPPED]))):
        yield counted(others, "link{s} of unknown type skipped")

"""Colours of shares: viridis, distinguishable with any colour blindness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from certpgo.linalg.arrays import FloatArray

#: Viridis, sampled; the pages' script has the same.
STOPS = np.array(
    [
        [68, 1, 84],
        [71, 44, 122],
        [59, 81, 139],
        [44, 113, 142],
        [33, 144, 141],
        [39, 173, 129],
        [92, 200, 99],
        [170, 220, 50],
        [253, 231, 37],
    ]
)


def colours(shares: FloatArray, *, dark: bool = False) -> NDArray[np.uint8]:
    """(k, 3) colours of shares (k,); large ones stand out on a light or ``dark`` background."""
    at = np.clip(shares, 0.0, 1.0)
    place = (0.2 + 0.8 * at if dark else 0.88 * (1.0 - at)) * (len(STOPS) - 1)
    channels = [np.interp(place, np.arange(len(STOPS)), STOPS[:, c]) for c in range(3)]
    return np.stack(channels, axis=1).round().astype(np.uint8)

"""Positions from offsets by elimination, where weights lie as far apart as a graph allows."""

import numpy as np

from certpgo.linalg import scalar_least_squares as network


def test_ties_that_underflow_are_none() -> None:
    """Three nodes held by a strong hub tie two others by 2^-1197, which no double holds."""
    arms = [(u, v) for v in (3, 4, 5) for u in (0, 1, 2)]
    weak, strong = 2.0**-399, 2.0**399
    weights = np.tile([weak, weak, strong], 3)
    offsets = np.tile([[1.0], [2.0], [0.0]], (3, 1))
    x = network.positions(6, np.array(arms), weights, offsets, np.array([3, 4, 5, 0, 1, 2]))
    np.testing.assert_allclose(x[:, 0], [-1.0, -2.0, 0.0, 0.0, 0.0, 0.0], atol=1e-15)

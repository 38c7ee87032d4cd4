"""g2o's chi2 and a prior that poses move in their own plane, w v_z^2 on every edge.

A convex function lies above its tangents: w v_z^2 >= w (2 s v_z - s^2), with equality at v_z = s.
g2o's minorant tau |v - b|^2 - 2 <N, Q> + C takes up the linear term as b' = b - (w s / tau) z.
What b' as rounded leaves, d = b_z - b'_z, is tau d (b_z + b'_z) - 2 tau d v_z + w v_z^2, at least
tau d (b_z + b'_z) - (tau d)^2 / w: that is added to C, rounded down.
"""

from dataclasses import replace

import numpy as np

from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.costs.g2o import G2oCost


class PlanarMotion(G2oCost):
    """g2o's chi2, and a prior that v_z = 0 with ten times the mean weight of translations."""

    name = "planar"
    provable = False  # the checker does not know it

    @property
    def title(self):
        return f"{super().title} and a planar-motion prior"

    @property
    def w(self):
        return 10.0 * self.graph.tau

    @property
    def weights(self):
        W = np.pad(self.graph.information_matrices, ((0, 0), (0, 1), (0, 1)))
        W[:, -1, -1] = self.w
        return W

    def residuals(self, v, Q):
        return np.concatenate([super().residuals(v, Q), v[:, -1:]], axis=1)

    def linearized(self, v, Q):
        _, in_v, in_w = super().linearized(v, Q)
        in_v, in_w = (np.pad(A, ((0, 0), (0, 1), (0, 0))) for A in (in_v, in_w))
        in_v[:, -1, -1] = 1.0
        return self.residuals(v, Q), in_v, in_w

    def enclosures(self, v, Q):
        return super().enclosures(v, Q) + self.w * v[:, -1].squared()

    def minorants(self, v, Q):
        found = super().minorants(v, Q)
        before, b = Ball.exact(found.b[:, -1]), found.b.copy()
        b[:, -1] -= self.w * v[:, -1] / found.tau
        pull = found.tau * (before - b[:, -1])
        left = pull * (before + b[:, -1]) - pull.squared() / self.w
        return replace(found, b=b, constant=(left + found.constant).lower, touching=None)


COST = PlanarMotion

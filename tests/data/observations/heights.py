"""A kind of measurement that the package does not know: heights above planes, in one file."""

from dataclasses import dataclass

import numpy as np

from certpgo.graph.observations import Observations
from certpgo.graph.scale import Scale
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.minorants import Minorants
from certpgo.objective.term import Term

#: Weight of a minorant, over that of the height.
EASE = 2.0**-20


@dataclass(frozen=True, eq=False, repr=False)
class Heights(Observations):
    """Heights of nodes j above planes through nodes i, whose normals are in the frames of these."""

    normals: FloatArray
    heights: FloatArray
    weights: FloatArray


@dataclass(frozen=True, eq=False)
class Height(Term):
    """w (n.v - h)^2, which is at least -eps |v - b|^2 + w eps (n.b - h)^2 / (eps + w |n|^2)."""

    of: Heights
    takes = Heights
    plural = "heights"
    in_metres = True

    @property
    def edges(self):
        return self.of.edges

    @property
    def weights(self):
        return self.of.weights[:, None, None]

    @property
    def scale(self):
        none = 0.0 * self.of.weights
        return Scale(none, self.of.weights, self.of.heights**2, none > 0.0)

    def residuals(self, v, Q):
        return (self.of.normals * v).sum(axis=1, keepdims=True) - self.of.heights[:, None]

    def linearized(self, v, Q):
        turned = np.zeros((len(v), 1, so.tangent_dim(v.shape[1])))
        return self.residuals(v, Q), self.of.normals[:, None], turned

    def enclosures(self, v, Q):
        return (v.dot(self.of.normals) - self.of.heights).squared() * self.of.weights

    def minorants(self, v, Q):
        n, w = self.of.normals, self.of.weights
        ease = EASE * w
        b = v + self.residuals(v, Q) * n / EASE
        there, exact = Ball.exact(b).dot(n) - self.of.heights, Ball.exact(w)
        constant = there.squared() * (exact * ease) / (ease + exact * Ball.exact(n).dot(n))
        none = np.zeros_like(v)
        return Minorants(-ease, none, b, none[:, :, None] * none[:, None], constant.lower)

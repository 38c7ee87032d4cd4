"""EigenRAO: EigenRA with outliers, reweighted until the smallest eigenvalue converges.

Moreira 2020, section 4.5 and Algorithm 3, with these choices where the text is ambiguous:

- *Which matrix is weighted.* The off-diagonal blocks of (Laplacian x 1) o Rtilde; its diagonal
  blocks stay at the degrees, consistent with W_ii = 1 and with row sums restored to the degrees.
- *The loss.* Eq. 4.9 reads a + b exp(pi - e/2) and never vanishes for the default a and b. Read as
  a + b exp((pi - e)/2), and clipped at zero, it vanishes at 97 degrees, close to the threshold of
  90, and rejects outliers in half the iterations: the default. ``loss="printed"`` is the former.
- *The error e.* The Frobenius norm of a logarithm is sqrt(2) times the angle; as the threshold
  pi/2 is an angle, so is e. ``frobenius=True`` is the other reading, for both loss and threshold.
- *W or E.* The text restores the row sums of the accumulated weights W to the degrees; line 12 of
  Algorithm 3 prints E above the sums of W (and sums over i), which does not. ``accumulate=False``
  uses the weights of the last iteration only, in both places: outliers then keep some weight.

A measurement counts as rejected if it is replaced, or if its weight is negligible.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.capabilities import require_capable
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray
from certpgo.linalg.eigen import Eigenpairs, krylov_schur
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import factor_shifted
from certpgo.optimize import spectral
from certpgo.optimize.iterative import Iterative
from certpgo.optimize.methods._robust import connected, remark
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.progress import Progress
from certpgo.optimize.solution import Solution

#: Shifts that make a reweighted matrix definite, in units of the mean degree: its row sums are only
#: nearly the degrees, so that it may be slightly indefinite.
SHIFTS = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
#: Weights (about 1 on average) below which a measurement is rejected.
NEGLIGIBLE = 1e-3


@dataclass(frozen=True, eq=False)
class Step:
    """An iteration of EigenRAO.

    Attributes
    ----------
    estimate : rotations from the weighted matrix
    eigenvalue : its smallest eigenvalue
    weights : (m,) W of the measurements
    replaced : (m,) which measurements were replaced by their estimates
    """

    estimate: Estimate
    eigenvalue: float
    weights: FloatArray
    replaced: BoolArray


@dataclass(frozen=True)
class EigenRAO(Iterative):
    """Rotation averaging with outliers, by eigenvectors; d = 2 and 3.

    Attributes
    ----------
    a, b : of the loss a + b exp((pi - e)/2)
    eta : measurements with larger error are replaced by their estimates, radians
    loss, frobenius, accumulate : readings of Algorithm 3, see above
    tolerance : change of the smallest eigenvalue, over the mean degree, at which to stop
    max_iterations : stop anyway

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.thesis import langevin_graph
    >>> instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    >>> problem = Quadratic(instance.graph)
    >>> solution = get_solver("eigen_rao")().solve(problem)
    >>> float((solution.weights[instance.outliers] == 0.0).mean()) > 0.8
    True
    """

    a: float = -1.75
    b: float = 0.85
    eta: float = math.pi / 2
    loss: Literal["halved", "printed"] = "halved"
    frobenius: bool = False
    accumulate: bool = True
    tolerance: float = 2e-5
    max_iterations: int = 20

    poses: ClassVar[bool] = False
    takes_initial: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        largest = self.a + self.b * math.exp(math.pi / 2)
        if not (self.eta > 0.0 and self.b > 0.0 and 0.0 < largest < 1e6):
            raise SpecError(
                "eta, b and the loss at zero error must be positive and below a million"
            )

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations of the problem, and the weights W of the kept measurements."""
        watch = Stopwatch()
        rotation = problem.rotation
        rotation.require_joined()
        if initial is not None:
            problem.check(initial)
        progress = Progress(monitor, self.tolerance, self.max_iterations, watch)
        eigenvalue = math.inf
        for step in self.steps(rotation, watch):
            change = abs(step.eigenvalue - eigenvalue) / float(rotation.node_weights.mean())
            eigenvalue = step.eigenvalue
            if not progress.advance(rotation.cost(step.estimate), change, change):
                break
        W = np.where(step.replaced | (step.weights < NEGLIGIBLE), 0.0, step.weights)
        weights = connected(rotation, W, rotation.edge_costs(step.estimate))
        return progress.solution(
            Estimate(step.estimate.rotations),
            rotation.cost(step.estimate),
            note=remark(rotation, weights),
            weights=weights,
        )

    def steps(self, rotation: Quadratic, watch: Stopwatch | None = None) -> Iterator[Step]:
        """The iterations of Algorithm 3, without end; the first is EigenRA's estimate."""
        require_capable(rotation.graph, "isotropic method")
        watch = watch or Stopwatch()
        i, j = rotation.graph.edges.T
        measured = Rbar = rotation.graph.rotations
        W, replaced = np.ones(len(i)), np.zeros(len(i), dtype=bool)
        vectors = None
        while True:
            with watch.phase("eigen"):
                pairs = _smallest_eigenpairs(rotation, W, Rbar, vectors)
                vectors = pairs.vectors
                R = spectral.round_to_rotations(vectors, rotation.d)
            estimate = Estimate.trusted(R)
            yield Step(estimate, float(pairs.values[0]), W, replaced)
            with watch.phase("reweight"):
                e = rotation.residual_angles(estimate) * (math.sqrt(2.0) if self.frobenius else 1.0)
                replaced = e > self.eta
                Rbar = np.where(replaced[:, None, None], np.swapaxes(R[i], 1, 2) @ R[j], measured)
                rho = self.rho(e)
                W = _restored(rotation, W * rho if self.accumulate else rho)

    def rho(self, e: FloatArray) -> FloatArray:
        """The loss of errors (radians), eq. 4.9, in the chosen reading."""
        exponent = (math.pi - e) / 2.0 if self.loss == "halved" else math.pi - e / 2.0
        return np.maximum(self.a + self.b * np.exp(exponent), 0.0)


def _smallest_eigenpairs(
    problem: Quadratic, W: FloatArray, Rbar: FloatArray, start: FloatArray | None
) -> Eigenpairs:
    """Of the matrix with degrees on its diagonal and off-diagonal blocks -kappa W Rbar_ij."""
    degree = problem.node_weights
    off_diagonal = -(problem.graph.kappa * W)[:, None, None] * Rbar

    def build(shift: float) -> CSC:
        diagonal = (degree + shift)[:, None, None] * np.eye(problem.d)
        return problem.pattern.assemble(diagonal, off_diagonal)

    A, shift, factor = factor_shifted(problem, build, float(degree.mean()), SHIFTS)
    return krylov_schur(A, factor.solve, problem.d, shift=shift, tol=1e-4, start=start)


def _restored(problem: Quadratic, W: FloatArray) -> FloatArray:
    """W with row sums restored to the degrees, then symmetrized: lines 12 to 14.

    A node whose measurements all have weight zero keeps it.
    """
    i, j = problem.graph.edges.T
    sums = operators.degrees(problem.graph.edges, problem.graph.kappa * W, problem.n)
    scale = problem.node_weights / np.where(sums > 0.0, sums, np.inf)
    return np.asarray(0.5 * W * (scale[i] + scale[j]))


SOLVER = EigenRAO

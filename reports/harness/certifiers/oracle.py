"""The truth in balls: costs, and lower bounds by an interval L D L^T, with python-flint.

None of the package's operators or factorizations is used. The data are exact: the rotations
nearest to the stored matrices, enclosed in balls, and the stored translations and weights. Of the
costs of other programs there are no lower bounds.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from certpgo.errors import MissingDependency
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic

#: Bits of the balls' midpoints, and of another attempt where long chains have used them up.
BITS, MORE_BITS = 160, 1024
#: Shifts of the multipliers that are tried, in units of each node's curvature.
SHIFTS = tuple(10.0**-k for k in range(14, 6, -1))

Matrix = dict[tuple[int, int], Any]


def cost(problem: Quadratic | Sum, estimate: Estimate) -> tuple[float, float]:
    """A lower and an upper bound on the cost of an estimate."""
    with library().ctx.workprec(BITS):
        if isinstance(problem, Sum):
            return _own_cost(problem, estimate)
        return _cost(problem, estimate)


def _cost(problem: Quadratic, estimate: Estimate) -> tuple[float, float]:
    flint = library()
    R, measured = _rotations(estimate.rotations), _rotations(problem.rotation.graph.rotations)
    total = flint.arb(0)
    for e, (i, j) in enumerate(problem.graph.edges.tolist()):
        residual = R[j] - R[i] * measured[e]
        squares = (residual * residual.transpose()).trace()
        total += float(problem.rotation.graph.kappa[e]) * squares
        if problem.has_positions and estimate.translations is not None:
            t, step = estimate.translations, _column(problem.graph.translations[e])
            gap = _column(t[j]) - _column(t[i]) - R[i] * step
            total += float(problem.graph.tau[e]) * (gap.transpose() * gap)[0, 0]
    return _below(total), -_below(-total)


def _own_cost(problem: Sum, estimate: Estimate) -> tuple[float, float]:
    flint, t = library(), estimate.translations
    R, measured = _rotations(estimate.rotations), _rotations(problem.graph.rotations)
    residual, Omega = RESIDUALS[problem.cost_name], problem.graph.information_matrices
    total = flint.arb(0)
    for e, (i, j) in enumerate(problem.graph.edges.tolist()):
        step = R[i].transpose() * (_column(t[j]) - _column(t[i]))  # type: ignore[index]
        back = measured[e].transpose()
        y = back * (step - _column(problem.graph.translations[e]))
        if problem.graph.kappa[e]:
            r = residual(y, back * R[i].transpose() * R[j])
        else:  # a position alone
            zeros = [0] * (len(Omega[e]) - problem.d)
            r = flint.arb_mat([[x] for x in (*y.entries(), *zeros)])
        total += (
            r.transpose() * flint.arb_mat(problem.graph.information_matrices[e].tolist()) * r
        )[0, 0]
    return _below(total), -_below(-total)


def _g2o_residual(y: Any, E: Any) -> Any:
    """y, then the angle of E, or the vector part of its unit quaternion (w, b), w >= 0."""
    if E.nrows() == 2:
        turned = [library().arb.atan2(E[1, 0] - E[0, 1], E[0, 0] + E[1, 1])]
    else:
        w = (1 + E.trace()).sqrt() / 2
        turned = [x / (2 * w) for x in _vee(E)]
    return library().arb_mat([[x] for x in (*y.entries(), *turned)])


def _gtsam_residual(y: Any, E: Any) -> Any:
    """V^-1 y, then omega = Log E, by the inverse of V, an infinite series in closed form."""
    arb, arb_mat = library().arb, library().arb_mat
    sines = _vee(E)
    cosine = E.trace() / 2 if E.nrows() == 2 else (E.trace() - 1) / 2
    square = sum((x * x for x in sines), arb(0))
    if square < 1e-40 and cosine > 0:
        # 1 <= theta / sin(theta) <= 1 + theta^2, and 1/12 <= c <= 1/12 + theta^2.
        longer, c = arb(1, 2e-40), arb(1) / 12 + arb(0, 2e-40)
    else:
        sine = square.sqrt()
        theta = arb.atan2(sine, cosine)
        longer = theta / sine
        c = (1 - theta / 2 * (theta / 2).cot()) / theta**2
    omega = [x * longer for x in sines]
    if E.nrows() == 2:
        [w] = omega
        hat = arb_mat([[0, -w], [w, 0]])
    else:
        x, z, v = omega
        hat = arb_mat([[0, -v, z], [v, 0, -x], [-z, x, 0]])
    u = y - hat * y / 2 + hat * (hat * y) * c
    return arb_mat([[x] for x in (*u.entries(), *omega)])


#: By name, the costs of measured poses that the oracle knows.
RESIDUALS = {"g2o": _g2o_residual, "gtsam": _gtsam_residual}


def _vee(E: Any) -> list[Any]:
    """Of a rotation by theta about n, sin(theta) n."""
    pairs = [(1, 0)] if E.nrows() == 2 else [(2, 1), (0, 2), (1, 0)]
    return [(E[a, b] - E[b, a]) / 2 for a, b in pairs]


def lower_bound(problem: Quadratic, point: Estimate, allowed: float) -> float:
    """A number that F* is proven to be at least, from the multipliers of a stationary point.

    Minus infinity where no shift of the multipliers that costs at most ``allowed`` leaves the
    certificate matrix positive semidefinite: the relaxation is loose, or the point not optimal.
    """
    multipliers = problem.multipliers(point)
    with library().ctx.workprec(BITS):
        M = _objective(problem)
        for shift in SHIFTS:
            loss = shift * np.asarray(problem.curvature)
            if problem.d * float(loss.sum()) > allowed:
                break
            reduced = multipliers - loss[:, None, None] * np.eye(problem.d)
            if _is_definite(_certificate_matrix(problem, M, reduced)):
                diagonal = np.diagonal(reduced, axis1=1, axis2=2)
                return math.nextafter(math.fsum(diagonal.ravel()), -math.inf)
    return -math.inf


def is_proof(
    problem: Quadratic, multipliers: FloatArray, *, over_complex: bool = False
) -> bool | None:
    """Whether tr(Lam) is a lower bound: M - blkdiag(0, Lam) is positive semidefinite.

    None where the balls are too wide to say.

    Parameters
    ----------
    over_complex : whether M is that of poses in the plane over complex numbers
    """
    for bits in (BITS, MORE_BITS):
        with library().ctx.workprec(bits):
            M = _objective(problem)
            if over_complex:
                S = _certificate_matrix(problem, _over_complex(M), multipliers, positions=2)
            else:
                S = _certificate_matrix(problem, M, multipliers)
            found = _is_definite(S)
        if found is not None:
            return found
    return None


def _certificate_matrix(
    problem: Quadratic, M: Matrix, multipliers: FloatArray, positions: int = 1
) -> Matrix:
    """M - blkdiag(0, Lam), without the first translation, and the rotations that points lack."""
    flint, d = library(), problem.d
    rows = positions if problem.has_positions else 0
    width = d + rows
    S = dict(M)
    for node, block in enumerate(0.5 * (multipliers + np.swapaxes(multipliers, 1, 2))):
        for a in range(d):
            for b in range(d):
                at = node * width + rows + a, node * width + rows + b
                S[at] = S.get(at, flint.arb(0)) - float(block[a, b])
    cut = set(range(rows))
    for node in np.setdiff1d(np.arange(problem.n), problem.poses).tolist():
        cut.update(node * width + rows + a for a in range(d))
    return {at: x for at, x in S.items() if cut.isdisjoint(at)}


def _over_complex(M: Matrix) -> Matrix:
    """The same form of (t, J t, u, J u), J a quarter turn: half at (t, u, J u), half at J times it.

    J J u = -u.
    """
    copies = ((0, 1), (2, 1), (3, 1)), ((1, 1), (3, 1), (2, -1))
    lifted: Matrix = {}
    for (p, q), value in M.items():
        for copy in copies:
            (a, sign), (b, other) = copy[p % 3], copy[q % 3]
            at = p // 3 * 4 + a, q // 3 * 4 + b
            lifted[at] = lifted.get(at, library().arb(0)) + value * sign * other / 2
    return lifted


def _objective(problem: Quadratic) -> Matrix:
    """M with F = tr(X M X^T), by the definition of F, edge by edge."""
    flint, d = library(), problem.d
    poses = problem.has_positions
    width = d + poses
    M: Matrix = {}

    def add(p: int, q: int, value: Any) -> None:
        M[p, q] = M.get((p, q), flint.arb(0)) + value

    measured = _rotations(problem.rotation.graph.rotations)
    for e, (i, j) in enumerate(problem.graph.edges.tolist()):
        kappa = flint.arb(float(problem.rotation.graph.kappa[e]))
        at_i, at_j = i * width + poses, j * width + poses
        for a in range(d):
            add(at_i + a, at_i + a, kappa)
            add(at_j + a, at_j + a, kappa)
            for b in range(d):
                entry = -kappa * measured[e][a, b]
                add(at_i + a, at_j + b, entry)
                add(at_j + b, at_i + a, entry)
        if problem.has_positions:
            tau = flint.arb(float(problem.graph.tau[e]))
            step = [(at_i + a, -float(x)) for a, x in enumerate(problem.graph.translations[e])]
            terms = [(j * width, 1.0), (i * width, -1.0), *step]
            for p, x in terms:
                for q, y in terms:
                    add(p, q, tau * x * y)
    return M


def _is_definite(S: Matrix) -> bool | None:
    """Whether a symmetric matrix is positive definite, by L D L^T; None where a pivot may be 0."""
    rows: dict[int, dict[int, Any]] = {}
    for (p, q), value in S.items():
        rows.setdefault(p, {})[q] = value
    for k in sorted(rows):
        column = rows.pop(k)
        pivot = column.pop(k)
        if not pivot > 0:
            return False if pivot < 0 else None
        others = list(column.items())
        for place, (p, x) in enumerate(others):
            row, ratio = rows[p], x / pivot
            del row[k]
            for q, y in others[: place + 1]:
                row[q] = rows[q][p] = row.get(q, 0) - ratio * y
    return True


def _rotations(R: FloatArray) -> list[Any]:
    """The rotations nearest to stored matrices, in balls."""
    flint, d = library(), R.shape[-1]
    identity = flint.arb_mat(np.eye(d).tolist())
    enclosed = []
    for stored in R.tolist():
        X = flint.arb_mat(stored)
        for _ in range(3):  # Newton's iteration for the polar factor, quadratic from rounding on
            X = X * (3 * identity - X.transpose() * X) / 2
        left = X.transpose() * X - identity
        # |X - Q| <= |X^T X - I|, and the largest row sum bounds the norm.
        size = sum(float(abs(left[a, b]).upper()) for a in range(d) for b in range(d))
        ball = flint.arb(0, size)
        enclosed.append(X + flint.arb_mat([[ball] * d] * d))
    return enclosed


def _column(v: FloatArray) -> Any:
    return library().arb_mat([[float(x)] for x in v])


def _below(ball: Any) -> float:
    """A double that is no larger than any number of the ball."""
    return math.nextafter(float(ball.lower()), -math.inf)


def library() -> Any:
    """The library.

    Raises
    ------
    MissingDependency
        It is not installed.
    """
    try:
        import flint
    except ImportError:
        raise MissingDependency(
            "python-flint, which the zoo knows the truth from,", "test", package="python-flint"
        ) from None
    return flint

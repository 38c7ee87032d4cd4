"""Metrics of an estimate with respect to the measurements and to ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from certpgo.errors import InputError, require
from certpgo.graph import Estimate, Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.procrustes import dilation, procrustes
from certpgo.objective import operators

#: Share of the largest extent below which positions are on a line.
STRAIGHT = 1e-6


def f_ml(graph: Graph, estimate: Estimate) -> float:
    """The thesis' log-likelihood, section 5.1: unit weights, 1/2 before the translations only.

    -1/2 sum ||t_j - t_i - R_i t_ij||^2 + sum tr(R_ij R_j^T R_i); without translations the second
    sum alone.
    """
    i, j = graph.edges.T
    R = estimate.rotations
    total = float(np.einsum("mab,mcb,mca->", graph.rotations, R[j], R[i]))
    if graph.has_positions:
        r = operators.translation_residuals(graph, estimate)
        total -= 0.5 * float(np.einsum("ma,ma->", r, r))
    return total


def symmetry(graph: Graph, estimate: Estimate) -> FloatArray:
    """(m,) symmetry s in [-1, 1] of each edge, thesis section 4.4; 1 supports Hypothesis 4.1.1.

    s(X) = (|X_sym| - |X_anti|) / (|X_sym| + |X_anti|) in Frobenius norms, of
    S_ij = t_j (t_i - t_ij)^T R_ij in the thesis' frame, where translations are -R_i^T t_i and the
    measured R_ij is ours; it prints R_ji, which is not symmetric without noise.
    A zero S_ij, as where a pose is the origin, counts as symmetric.
    """
    R, (i, j) = estimate.rotations, graph.edges.T
    t = -np.einsum("nba,nb->na", R, _translations(estimate))
    row = np.einsum("ma,mab->mb", t[i] - graph.translations, graph.rotations)
    S = t[j][:, :, None] * row[:, None, :]
    transpose = np.swapaxes(S, 1, 2)
    even = np.linalg.norm(0.5 * (S + transpose), axis=(1, 2))
    odd = np.linalg.norm(0.5 * (S - transpose), axis=(1, 2))
    total = even + odd
    return np.where(total > 0.0, (even - odd) / np.where(total > 0.0, total, 1.0), 1.0)


def mean_symmetry(graph: Graph, estimate: Estimate) -> float:
    """Mean of `symmetry` over the edges."""
    return float(symmetry(graph, estimate).mean())


@dataclass(frozen=True)
class AngularErrors:
    """Rotation errors after the best common rotation, degrees."""

    mean_deg: float
    median_deg: float
    rmse_deg: float
    worst_deg: float


@dataclass(frozen=True)
class PositionErrors:
    """Distances between positions after the best rigid motion or similarity, metres."""

    mean: float
    rmse: float
    worst: float


@dataclass(frozen=True)
class TrajectoryErrors:
    """Root mean square errors of a trajectory; metres are None without translations.

    Attributes
    ----------
    poses : number of poses that were compared
    ate_m, ate_deg : absolute errors of positions and rotations, after alignment of positions; of
        a truth of positions alone degrees are None
    rpe_m, rpe_deg : errors of the steps from each pose to the next, in the frame of the first; None
        where the truth has no such frames
    scaled : whether alignment was by a similarity, so that lengths are in the truth's unit
    """

    poses: int
    ate_m: float | None
    ate_deg: float | None
    rpe_m: float | None
    rpe_deg: float | None
    scaled: bool = False


def align(estimate: Estimate, truth: Estimate, *, norm: Literal["l2", "l1"] = "l2") -> FloatArray:
    """The rotation S (d, d) that aligns S R_i with the truth.

    ``"l2"`` minimises the sum of squared chordal distances in closed form; ``"l1"`` the sum of
    angles, by Weiszfeld's algorithm from that solution.
    """
    _require_as_many(estimate, truth)
    differences = truth.rotations @ np.swapaxes(estimate.rotations, 1, 2)
    S = np.asarray(so.project(differences.sum(axis=0)[None])[0])
    if norm == "l2":
        return S
    for _ in range(1000):
        v = so.log(S.T @ differences)
        weight = 1.0 / np.maximum(np.linalg.norm(v, axis=1), 1e-12)
        step = np.einsum("n,na->a", weight, v) / weight.sum()
        S = np.asarray(S @ so.exp(step))
        if np.linalg.norm(step) < 1e-12:
            break
    return S


def angular_errors(
    estimate: Estimate, truth: Estimate, *, norm: Literal["l2", "l1"] = "l2"
) -> AngularErrors:
    """Mean, median and root mean square angle to the truth after alignment, degrees.

    Thesis Table 5.1.
    """
    S = align(estimate, truth, norm=norm)
    error = np.swapaxes(S @ estimate.rotations, 1, 2) @ truth.rotations
    angles = np.degrees(so.angle(error))
    return AngularErrors(
        mean_deg=float(angles.mean()),
        median_deg=float(np.median(angles)),
        rmse_deg=float(np.sqrt(np.mean(angles**2))),
        worst_deg=float(angles.max()),
    )


def trajectory_errors(
    estimate: Estimate, truth: Estimate, *, scaled: bool = False
) -> TrajectoryErrors:
    """Absolute and relative errors of a trajectory, as evo gives them.

    The estimate is first aligned by `align_positions`; by its rotations (`align`) where it has no
    translations, or positions on a line, which leave the turn open.

    Parameters
    ----------
    estimate, truth : the same k poses or rotations, in the order of the trajectory; the truth may
        be positions alone, all of which are points in its keys
    scaled : whether alignment changes the scale, too, as that of the estimate means nothing

    Raises
    ------
    InputError
        The numbers of poses differ, or only one of them has translations.
    """
    _require_as_many(estimate, truth)
    if (estimate.translations is None) != (truth.translations is None):
        raise InputError("the estimate or the truth has no translations")
    moved = estimate.moved(*alignment(estimate, truth, scaled=scaled))
    if truth.keys.are_positions:
        at = _rms_metres(moved, truth)
        return TrajectoryErrors(truth.num_nodes, at, None, None, None, scaled)
    step, true_step = _steps(moved), _steps(truth)
    return TrajectoryErrors(
        truth.num_nodes,
        _rms_metres(moved, truth),
        _rms_degrees(moved, truth),
        _rms_metres(step, true_step),
        _rms_degrees(step, true_step),
        scaled,
    )


def alignment(
    estimate: Estimate, truth: Estimate, *, scaled: bool = False
) -> tuple[FloatArray, FloatArray | None, float]:
    """How `Estimate.moved` takes an estimate to the truth: a rotation, a shift and a scale.

    The rotation is the best one for positions; that of `align` where one has none, or is on a line.
    """
    _require_as_many(estimate, truth)
    given, true = estimate.translations, truth.translations
    if given is None or true is None:
        return align(estimate, truth), None, 1.0
    unturned = estimate.keys.are_positions or truth.keys.are_positions
    if not unturned and (_is_on_a_line(given) or _is_on_a_line(true)):
        return _onto(true, given, align(estimate, truth), scaled)
    [S], _, _ = procrustes(true[None], given[None])
    return _onto(true, given, S, scaled)


def _onto(
    true: FloatArray, given: FloatArray, S: FloatArray, scaled: bool
) -> tuple[FloatArray, FloatArray, float]:
    """A rotation, and the best shift and, if asked, scale of positions (k, d) for it."""
    centre, origin, s = given.mean(axis=0), true.mean(axis=0), 1.0
    if scaled:
        [fitted] = dilation((true - origin)[None], (given - centre)[None], S[None])
        s = 1.0 if np.isnan(fitted) else max(float(fitted), np.finfo(float).tiny)
    return S, origin - s * S @ centre, s


def _steps(trajectory: Estimate) -> Estimate:
    """Each pose in the frame of the one before."""
    R, t = trajectory.rotations, trajectory.translations
    back = np.swapaxes(R[:-1], 1, 2)
    moved = None if t is None else np.einsum("nab,nb->na", back, t[1:] - t[:-1])
    return Estimate.trusted(back @ R[1:], moved)


def _is_on_a_line(t: FloatArray) -> bool:
    spread = np.linalg.svd(t - t.mean(axis=0), compute_uv=False)
    return len(spread) < 2 or bool(spread[1] <= STRAIGHT * spread[0])


def _rms_metres(a: Estimate, b: Estimate) -> float | None:
    if a.translations is None or b.translations is None:
        return None
    squares = ((a.translations - b.translations) ** 2).sum(axis=1)
    return float(np.sqrt(squares.mean())) if len(squares) else 0.0


def _rms_degrees(a: Estimate, b: Estimate) -> float:
    angles = np.degrees(so.angle(np.swapaxes(a.rotations, 1, 2) @ b.rotations))
    return float(np.sqrt(np.mean(angles**2))) if len(angles) else 0.0


def f_gt(estimate: Estimate, truth: Estimate, *, anchored: bool = False) -> float:
    """The thesis' ground-truth error, eq. 5.1: sum ||M_i - Mhat_i||_F^2 over poses.

    M_i is the inverse of pose i, [R_i^T, -R_i^T t_i]. The estimate is first aligned to minimise the
    sum, by one rotation and one shift in closed form; or, if ``anchored``, so that the first poses
    are the same. Without translations only rotations count.
    """
    _require_as_many(estimate, truth)
    estimate = estimate.anchored(0, truth) if anchored else estimate.moved(align(estimate, truth))
    R, true = estimate.rotations, truth.rotations
    total = float(((R - true) ** 2).sum())
    if estimate.translations is None or truth.translations is None:
        return total
    # A shift s moves R_i^T t_i by R_i^T s: the best s is the mean of R_i times the errors.
    errors = np.einsum("nba,nb->na", true, truth.translations)
    errors -= np.einsum("nba,nb->na", R, estimate.translations)
    if not anchored:
        shift = np.einsum("nab,nb->na", R, errors).mean(axis=0)
        errors -= np.einsum("nba,b->na", R, shift)
    return total + float((errors**2).sum())


def align_positions(estimate: Estimate, truth: Estimate, *, scaled: bool = False) -> Estimate:
    """The estimate moved to minimise the sum of squared distances to the true positions.

    Horn's closed form; with a scale that is as good as can be if ``scaled`` (Umeyama 1991).

    Raises
    ------
    InputError
        The numbers of nodes differ, or translations are missing.
    """
    _require_as_many(estimate, truth)
    given, true = map(_translations, (estimate, truth))
    [S], _, _ = procrustes(true[None], given[None])
    return estimate.moved(*_onto(true, given, S, scaled))


def position_errors(estimate: Estimate, truth: Estimate, *, scaled: bool = False) -> PositionErrors:
    """Mean, root mean square and worst distance to the true positions, metres.

    After `align_positions`, with the same errors raised.
    """
    moved = align_positions(estimate, truth, scaled=scaled)
    distances = np.linalg.norm(_translations(moved) - _translations(truth), axis=1)
    return PositionErrors(
        mean=float(distances.mean()),
        rmse=float(np.sqrt(np.mean(distances**2))),
        worst=float(distances.max()),
    )


def _require_as_many(estimate: Estimate, truth: Estimate) -> None:
    for one in (estimate, truth):
        require(one, Estimate, "an Estimate")
    if (estimate.num_nodes, estimate.d) != (truth.num_nodes, truth.d):
        raise InputError(
            f"the estimate has {estimate.num_nodes} nodes, the ground truth {truth.num_nodes}"
        )


def _translations(estimate: Estimate) -> FloatArray:
    if estimate.translations is None:
        raise InputError("the estimate has no translations")
    return estimate.translations

"""Mistakes that people make with a map, planted in clean ones whose noise is as stated.

Each takes a clean map and returns one with the mistake; the names of findings that are right come
with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

import certpgo
from certpgo import Estimate, Instance
from certpgo.diagnosis import KnownTruth
from certpgo.diagnosis.examined import Clock
from certpgo.graph.information import Information
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so

#: Standard deviations of steps: metres and radians; closures are as good.
SIGMA_T, SIGMA_R = 0.05, 0.02
#: Poses, and loop closures.
N, LOOPS = 60, 40


@dataclass(frozen=True)
class Planted:
    """A map, with what a user says of it.

    Attributes
    ----------
    instance : the measurements
    estimate : that is asked about, or None
    truth : or None
    """

    instance: Instance
    estimate: Estimate | None = None
    truth: KnownTruth | None = None


@dataclass(frozen=True)
class Mistake:
    """A mistake.

    Attributes
    ----------
    name : what it is
    kinds : of findings that name it
    plant : a clean map, its best estimate and a generator of random numbers to the map with it
    dimensions : in which it can be made
    also : of findings that name another mistake that is made with it; empty for none
    """

    name: str
    kinds: tuple[str, ...]
    plant: Callable[[Instance, Estimate, np.random.Generator], Planted]
    dimensions: tuple[int, ...] = (2, 3)
    also: tuple[str, ...] = ()

    def is_named(self, kinds: Sequence[str]) -> bool:
        """Whether findings of these kinds, best first, name it first, and what is made with it."""
        right = bool(kinds) and kinds[0] in (*self.kinds, *self.also)
        return right and all(set(of) & set(kinds) for of in (self.kinds, self.also) if of)


def clean(d: int, seed: int) -> Instance:
    """A walk on a lattice with loop closures, whose noise is as stated, and its truth."""
    rng = np.random.default_rng([d, seed])
    q = so.tangent_dim(d)
    turns = np.zeros((N, q))
    turns[:, -1] = rng.choice([0.0, 0.5 * np.pi, -0.5 * np.pi], N, p=[0.6, 0.2, 0.2])
    if d == 3:
        turns += 0.2 * rng.standard_normal((N, q))
    R, t = [np.eye(d)], [np.zeros(d)]
    for turn in so.exp(turns)[1:]:
        t.append(t[-1] + R[-1] @ np.eye(d)[0] * rng.uniform(0.7, 1.4))
        R.append(R[-1] @ turn)
    truth = Estimate(np.array(R), np.array(t))
    far = [(i, j) for i in range(N) for j in range(i + 2, N)]
    loops = [far[k] for k in rng.choice(len(far), LOOPS, replace=False)]
    edges = np.array([(k, k + 1) for k in range(N - 1)] + loops)
    i, j = edges.T
    back = np.swapaxes(truth.rotations[i], 1, 2)
    m = len(edges)
    measured = back @ truth.rotations[j] @ so.exp(SIGMA_R * rng.standard_normal((m, q)))
    at = truth.translations
    steps = np.einsum("mab,mb->ma", back, at[j] - at[i]) + SIGMA_T * rng.standard_normal((m, d))
    sizes = np.r_[np.full(d, SIGMA_T), np.full(q, SIGMA_R)]
    # Not the same in all directions, and correlated a little, as of real sensors.
    A = np.eye(d + q) + 0.1 * np.triu(np.ones((d + q, d + q)), 1)
    # g2o's are about the vector part of a quaternion, which is half of the angle.
    unit = np.r_[np.ones(d), np.full(q, 2.0 if d == 3 else 1.0)]
    one = unit[:, None] * (A.T @ np.diag(sizes**-2) @ A) * unit
    return _with_information(edges, measured, steps, np.tile(one, (m, 1, 1)), d, truth)


def _with_information(edges, measured, steps, information, d, truth=None, numbers=None) -> Instance:
    """An instance of such measurements, in g2o's convention of tangents."""
    information = 0.5 * (information + np.swapaxes(information, 1, 2))
    about = "quaternion" if d == 3 else "tangent"
    stated = Information.of(information, "g2o", about)
    inverse = np.linalg.inv(stated.about_tangents().distinct)
    moved, turned = inverse[:, :d, :d], inverse[:, d:, d:]
    # Matrices of another order need not be definite.
    moved, turned = (np.abs(np.trace(of, axis1=1, axis2=2)) for of in (moved, turned))
    kappa = (1.0 if d == 2 else 1.5) / turned
    graph = certpgo.PoseGraph(certpgo.RotationGraph(N, edges, measured, kappa), steps, d / moved)
    graph = graph.with_information(stated)
    return Instance("walk", graph, np.arange(N), truth=truth)


def _changed(instance: Instance, chosen, change) -> Instance:
    """The same with some measurements (m,) changed: rotations and translations to others."""
    graph = instance.graph
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[chosen], t[chosen] = change(R[chosen], t[chosen])
    return _with_information(graph.edges, R, t, graph.information_matrices, graph.d)


def _weighed(instance: Instance, change) -> Instance:
    """The same with other information matrices."""
    graph = instance.graph
    W = change(graph.information_matrices)
    return _with_information(graph.edges, graph.rotations, graph.translations, W, graph.d)


# --- Ways to write poses --------------------------------------------------------------------------


def _inverse(R, t):
    back = np.swapaxes(R, 1, 2)
    return back, -np.einsum("nab,nb->na", back, t)


def _w_first(R, t):
    return quaternion.rotations(np.roll(quaternion.to_write(R), 1, axis=1)), t


def _transposed(R, t):
    return np.swapaxes(R, 1, 2), t


def _inverse_positions(R, t):
    return R, _inverse(R, t)[1]


def _mirrored(R, t):
    return R, t * np.where(np.arange(t.shape[1]) == 1, -1.0, 1.0)


def _other_hand(R, t):
    signs = np.where(np.arange(t.shape[1]) == 1, -1.0, 1.0)
    return signs[:, None] * R * signs, signs * t


def _permuted(R, t):
    return R, np.roll(t, 1, axis=1)


def _of_camera(R, t):
    if R.shape[1] == 2:
        return R @ np.array([[0.0, -1.0], [1.0, 0.0]]), t
    return R @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), t


def _times(factor):
    return lambda R, t: (R, factor * t)


def _backwards(R, t):
    return R[::-1], t[::-1]


def _of_estimate(way):
    return lambda instance, best, rng: Planted(
        instance, Estimate(*way(best.rotations, best.translations))
    )


def _of_truth(way):
    def plant(instance, best, rng):
        known = instance.truth
        poses = Estimate(*way(known.rotations, known.translations))
        return Planted(replace(instance, truth=None), None, KnownTruth(np.arange(N), poses))

    return plant


def _mounted(R, t):
    C = so.exp(np.array([[0.5]]) if R.shape[1] == 2 else np.array([[0.4, -0.2, 0.7]]))[0]
    return R @ C, t


def _lever(R, t):
    return R, t + R @ np.array([2.0, -3.0, 2.5])[: R.shape[1]]


def _clocked(late, unit=1.0):
    def plant(instance, best, rng):
        t = instance.truth.translations
        at = 0.5 * np.arange(N)
        stamps = np.linspace(0.0, at[-1], 20 * N)
        track = np.stack([np.interp(stamps, at, x) for x in t.T], axis=1)
        clock = Clock(at, unit * (stamps + late), track)
        # What matches by these times is of another moment.
        wrong = np.stack([np.interp(at - late, at, x) for x in t.T], axis=1)
        poses = Estimate(instance.truth.rotations, wrong)
        nodes = np.arange(N) if unit == 1.0 else np.zeros(0, dtype=int)
        return Planted(replace(instance, truth=None), None, KnownTruth(nodes, poses, clock))

    return plant


# --- Measurements ---------------------------------------------------------------------------------


def _steps_of(instance):
    return np.abs(np.diff(instance.graph.edges, axis=1)[:, 0]) == 1


def _of_edges(way, which):
    def plant(instance, best, rng):
        steps = _steps_of(instance)
        chosen = {"all": np.ones_like(steps), "odometry": steps, "closures": ~steps}[which]
        return Planted(_changed(instance, chosen, way))

    return plant


def _of_one_edge(way):
    def plant(instance, best, rng):
        chosen = rng.choice(np.flatnonzero(~_steps_of(instance)), 1)
        return Planted(_changed(instance, chosen, way))

    return plant


def _between_others(instance, best, rng):
    graph = instance.graph
    [e] = rng.choice(np.flatnonzero(~_steps_of(instance)), 1)
    edges = graph.edges.copy()
    i, j = edges[e]
    edges[e] = (i, j + 1) if j + 1 < N else (i, j - 1)
    W = graph.information_matrices
    return Planted(_with_information(edges, graph.rotations, graph.translations, W, graph.d))


def _copied(instance, best, rng):
    graph = instance.graph
    e, f = rng.choice(np.flatnonzero(~_steps_of(instance)), 2, replace=False)
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[e], t[e] = R[f], t[f]
    return Planted(_with_information(graph.edges, R, t, graph.information_matrices, graph.d))


def _elsewhere(R, t):
    return so.exp(np.full((1, so.tangent_dim(R.shape[1])), 0.9)) @ R, t + 4.0


def _of_weights(change):
    return lambda instance, best, rng: Planted(_weighed(instance, change))


def _of_weights_of(factor, steps):
    """Information times a factor, of odometry or of all else."""

    def plant(instance, best, rng):
        chosen = _steps_of(instance) == steps
        by = np.where(chosen, factor, 1.0)[:, None, None]
        return Planted(_weighed(instance, lambda W: by * W))

    return plant


def _in_toro_order(W):
    if W.shape[1] == 3:
        # g2o: 11 12 13 22 23 33; TORO: 11 12 22 33 13 23
        a = [W[:, 0, 0], W[:, 0, 1], W[:, 1, 1], W[:, 2, 2], W[:, 0, 2], W[:, 1, 2]]
        out = np.zeros_like(W)
        for (r, c), x in zip([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)], a, strict=True):
            out[:, r, c] = out[:, c, r] = x
        return out
    rotation_first = [3, 4, 5, 0, 1, 2]
    return W[:, rotation_first][:, :, rotation_first]


def _roots(W):
    """Upper triangular roots, read as the upper half of symmetric matrices."""
    U = np.swapaxes(np.linalg.cholesky(W), 1, 2)
    return U + np.swapaxes(np.triu(U, 1), 1, 2)


def _tangents(W):
    unit = np.r_[np.ones(3), np.full(3, 0.5)]
    return unit[:, None] * W * unit


def _stiff(W):
    out = W.copy()
    out[7] *= 1e9
    return out


def _wound(instance, best, rng):
    half = np.arange(N) >= N // 2
    turn = np.zeros((N, so.tangent_dim(best.d)))
    turn[half, -1] = np.pi
    R = best.rotations @ so.exp(turn)
    t = best.translations.copy()
    t[half] = 2.0 * t[N // 2] - t[half]
    return Planted(instance, certpgo.Estimate(R, t))


def _early(instance, best, rng):
    t = best.translations + 0.3 * rng.standard_normal(best.translations.shape)
    return Planted(instance, Estimate(best.rotations, t))


def _nowhere(instance, best, rng):
    return Planted(instance, Estimate(np.tile(np.eye(best.d), (N, 1, 1)), np.zeros((N, best.d))))


# --- Errors of one sensor -------------------------------------------------------------------------


def _mount(d):
    """Where a sensor is on the body: its turn and its place, metres."""
    turn = np.array([[0.4]] if d == 2 else [[0.2, -0.3, 0.4]])
    return so.exp(turn)[0], np.array([0.8, -0.5, 0.6])[:d]


def _axes(d):
    """Of a camera, whose z looks ahead."""
    if d == 2:
        return np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def _mounted_motions(R, t):
    C, a = _mount(R.shape[1])
    return C.T @ R @ C, (t + R @ a - a) @ C


def _biased(R, t):
    bias = np.zeros((1, so.tangent_dim(R.shape[1])))
    bias[0, -1] = 0.04
    return R @ so.exp(bias), t


def _of_positions(way):
    """Measured positions of all poses, to 5 cm."""

    def plant(instance, best, rng):
        known = instance.truth
        t = known.translations + SIGMA_T * rng.standard_normal(known.translations.shape)
        t = way(known.rotations, t)
        plain = instance.graph.with_information(None)
        nodes = np.arange(N)
        graph = certpgo.with_priors(plain, nodes, translations=t - t.mean(axis=0), tau=SIGMA_T**-2)
        named = {"ids": np.arange(N + 1), "world": N, "truth": None}
        return Planted(replace(instance, graph=graph, **named))

    return plant


def _swapped(R, t):
    return t[:, [1, 0, 2][: t.shape[1]]]


#: Points, and poses from which each is seen.
POINTS, SEEN = 12, 6


def _of_sightings(way):
    """Points that are each seen from some poses, to 5 cm."""

    def plant(instance, best, rng):
        known, d = instance.truth, instance.graph.d
        points = known.translations[rng.choice(N, POINTS)] + rng.standard_normal((POINTS, d))
        pairs = [(i, k) for k in range(POINTS) for i in rng.choice(N, SEEN, replace=False)]
        i, k = np.array(pairs).T
        back = np.swapaxes(known.rotations[i], 1, 2)
        y = (back @ (points[k] - known.translations[i])[:, :, None])[:, :, 0]
        y = way(y + SIGMA_T * rng.standard_normal(y.shape))
        graph, m = instance.graph, len(y)
        edges = np.concatenate([graph.edges, np.stack([i, N + k], axis=1)])
        R = np.concatenate([graph.rotations, np.tile(np.eye(d), (m, 1, 1))])
        kappa, tau = np.r_[graph.kappa, np.zeros(m)], np.r_[graph.tau, np.full(m, SIGMA_T**-2)]
        turns = certpgo.RotationGraph(N + POINTS, edges, R, kappa)
        t = np.concatenate([graph.translations, y])
        seen = certpgo.PoseGraph(turns, t, tau, points=np.arange(N + POINTS) >= N)
        return Planted(replace(instance, graph=seen, ids=np.arange(N + POINTS), truth=None))

    return plant


# --- Several at once ------------------------------------------------------------------------------


def _ids_of_two(instance, best, rng):
    """The maps of two robots in one file, whose poses have the same ids."""
    graph, other = instance.graph, clean(best.d, int(rng.integers(2**31))).graph
    both = zip(_columns(graph), _columns(other), strict=True)
    columns = [np.concatenate(pair) for pair in both]
    return Planted(_with_information(*columns, best.d))


def _columns(graph):
    return graph.edges, graph.rotations, graph.translations, graph.information_matrices


def _truth_of_another_run(instance, best, rng):
    """A right estimate, and a truth that is to blame."""
    other = clean(best.d, int(rng.integers(2**31))).truth
    known = KnownTruth(np.arange(N), other)
    return Planted(replace(instance, truth=None), best, known)


def _mirrored_truth(instance, best, rng):
    poses = Estimate(*_mirrored(instance.truth.rotations, instance.truth.translations))
    return Planted(replace(instance, truth=None), best, KnownTruth(np.arange(N), poses))


def _with_a_wrong_closure(way, *, knows=False):
    """An estimate that is read wrongly, and a map with a wrong closure, which it knows or not."""

    def plant(instance, best, rng):
        planted = _of_one_edge(_elsewhere)(instance, best, rng)
        found = best if knows else certpgo.solve(planted.instance).estimate
        return replace(planted, estimate=Estimate(*way(found.rotations, found.translations)))

    return plant


# --- Estimates that are merely bad ----------------------------------------------------------------


def _drifted(size):
    def read(instance, best, rng):
        R, t, d = best.rotations, best.translations, best.d
        turns = np.cumsum(size * rng.standard_normal((N, so.tangent_dim(d))), axis=0)
        steps = np.concatenate([t[:1], np.diff(t, axis=0)])
        X = so.exp(turns)
        return X @ R, np.cumsum((X @ steps[:, :, None])[:, :, 0], axis=0)

    return read


def _shaken(metres, radians):
    def read(instance, best, rng):
        turns = radians * rng.standard_normal((N, so.tangent_dim(best.d)))
        t = best.translations + metres * rng.standard_normal(best.translations.shape)
        return best.rotations @ so.exp(turns), t

    return read


def _some_moved(count, metres):
    def read(instance, best, rng):
        t = best.translations.copy()
        t[rng.choice(N, count, replace=False)] += metres
        return best.rotations, t

    return read


def _stretched(instance, best, rng):
    return best.rotations, best.translations * np.linspace(0.5, 2.0, best.d)


def _bent(instance, best, rng):
    turns = np.zeros((N, so.tangent_dim(best.d)))
    turns[:, -1] = np.linspace(0.0, 2.0, N)
    X = so.exp(turns)
    return X @ best.rotations, (X @ best.translations[:, :, None])[:, :, 0]


def _one_end_kept(instance, best, rng):
    t = best.translations.copy()
    t[N // 2 :] = t[N // 2]
    return best.rotations, t


def _anywhere(instance, best, rng):
    R = so.project(rng.standard_normal((N, best.d, best.d)))
    return R, 10.0 * rng.standard_normal(best.translations.shape)


def _smoothed(instance, best, rng):
    window = np.ones(9) / 9.0
    t = [np.convolve(np.pad(x, 4, mode="edge"), window, "valid") for x in best.translations.T]
    return best.rotations, np.stack(t, axis=1)


#: Ways to be wrong that no convention explains: rotations and positions from the best ones.
BAD = {
    "drifted a little": _drifted(0.02),
    "drifted": _drifted(0.1),
    "drifted far": _drifted(0.5),
    "positions shaken by 1 m": _shaken(1.0, 0.0),
    "positions shaken by 10 m": _shaken(10.0, 0.0),
    "rotations shaken by 0.3 rad": _shaken(0.0, 0.3),
    "both shaken": _shaken(1.0, 0.3),
    "one pose 20 m off": _some_moved(1, 20.0),
    "ten poses 5 m off": _some_moved(10, 5.0),
    "stretched along axes": _stretched,
    "bent": _bent,
    "its second half in one point": _one_end_kept,
    "random poses": _anywhere,
    "positions smoothed": _smoothed,
}
#: Findings that are no cause of these: what optimizers do.
NO_CAUSES = ("stopped-early", "wrong-basin", "saddle", "no-initialization", "other-cost")

SPACE = (3,)
#: In the plane transposed rotations are mirrored translations, seen in a mirror.
OF_MIRRORS = ("transposed-rotations", "mirrored-edges")
MISTAKES = (
    Mistake("estimate with w first", ("quaternion-w-first",), _of_estimate(_w_first), SPACE),
    Mistake("inverse poses", ("inverse-poses",), _of_estimate(_inverse)),
    Mistake("inverse rotations", ("inverse-rotations",), _of_estimate(_transposed)),
    Mistake("inverse positions", ("inverse-positions",), _of_estimate(_inverse_positions)),
    Mistake("mirrored positions", ("mirrored",), _of_estimate(_mirrored)),
    Mistake("other handedness", ("other-handedness",), _of_estimate(_other_hand)),
    Mistake("columns permuted", ("permuted-axes",), _of_estimate(_permuted), SPACE),
    Mistake("axes of a camera", ("permuted-axes",), _of_estimate(_of_camera)),
    Mistake("millimetres", ("millimetres",), _of_estimate(_times(1e3))),
    Mistake("feet", ("feet",), _of_estimate(_times(1.0 / 0.3048))),
    Mistake("another scale", ("scaled",), _of_estimate(_times(0.37))),
    Mistake("poses from last to first", ("reordered",), _of_estimate(_backwards)),
    Mistake(
        "poses of the next node",
        ("reordered",),
        _of_estimate(lambda R, t: (np.roll(R, 1, axis=0), np.roll(t, 1, axis=0))),
    ),
    Mistake("stopped early", ("stopped-early",), _early),
    Mistake("no initial values", ("no-initialization",), _nowhere),
    Mistake("truth with w first", ("quaternion-w-first",), _of_truth(_w_first), SPACE),
    Mistake("truth of inverse poses", ("inverse-poses",), _of_truth(_inverse)),
    Mistake("truth mirrored", ("mirrored", "other-handedness"), _of_truth(_mirrored)),
    Mistake("truth of a camera", ("permuted-axes",), _of_truth(_of_camera)),
    Mistake("truth of a turned body", ("other-frame",), _of_truth(_mounted)),
    Mistake("truth of another point", ("lever-arm",), _of_truth(_lever)),
    Mistake("truth in millimetres", ("millimetres",), _of_truth(_times(1e3))),
    Mistake("truth of another scale", ("scaled",), _of_truth(_times(0.7))),
    Mistake("truth's clock late", ("shifted-times",), _clocked(1.7)),
    Mistake("truth's clock in nanoseconds", ("times-units",), _clocked(0.0, 1e9)),
    Mistake("all edges inverted", ("inverted-edges",), _of_edges(_inverse, "all")),
    Mistake("closures inverted", ("inverted-closures",), _of_edges(_inverse, "closures")),
    Mistake("odometry inverted", ("inverted-odometry",), _of_edges(_inverse, "odometry")),
    Mistake("edges' rotations transposed", OF_MIRRORS, _of_edges(_transposed, "all")),
    Mistake("edges with w first", ("edges-w-first",), _of_edges(_w_first, "all"), SPACE),
    Mistake(
        "edges' translations in the other frame",
        ("translations-in-other-frame", "inverse-translations", "negated-translations"),
        _of_edges(lambda R, t: (R, np.einsum("mba,mb->ma", R, t)), "all"),
    ),
    Mistake("edges mirrored", OF_MIRRORS, _of_edges(_mirrored, "all")),
    Mistake("information in another order", ("information-order",), _of_weights(_in_toro_order)),
    Mistake("covariances for information", ("covariance",), _of_weights(np.linalg.inv)),
    Mistake("square roots of information", ("square-root",), _of_weights(_roots)),
    Mistake("information of tangents", ("quaternion-information",), _of_weights(_tangents), SPACE),
    Mistake("one closure inverted", ("inverted-edge",), _of_one_edge(_inverse)),
    Mistake("one closure of the next node", ("wrong-node",), _between_others),
    Mistake("one closure copied", ("copied-edge",), _copied),
    Mistake("one closure wrong", ("wrong-measurement",), _of_one_edge(_elsewhere)),
    Mistake(
        "noise stated 4 times too small", ("noise-too-small",), _of_weights(lambda W: 16.0 * W)
    ),
    Mistake(
        "noise stated 4 times too large", ("noise-too-large",), _of_weights(lambda W: W / 16.0)
    ),
    Mistake(
        "closures' noise stated 3 times too small",
        ("noise-too-small",),
        _of_weights_of(9.0, steps=False),
    ),
    Mistake(
        "odometry's noise stated 3 times too small",
        ("noise-too-small",),
        _of_weights_of(9.0, steps=True),
    ),
    Mistake("one stiff edge", ("stiff-edge",), _of_weights(_stiff)),
    Mistake(
        "identity information",
        ("identity-information", "noise-too-large"),
        _of_weights(lambda W: np.tile(np.eye(W.shape[1]), (len(W), 1, 1))),
    ),
    Mistake("closures in feet", ("closures-feet",), _of_edges(_times(1 / 0.3048), "closures")),
    Mistake(
        "closures of a mounted sensor",
        ("closures-turned", "closures-lever-arm"),
        _of_edges(_mounted_motions, "closures"),
    ),
    Mistake("a wheel's scale", ("odometry-scaled",), _of_edges(_times(1.15), "odometry")),
    Mistake("a gyroscope's bias", ("odometry-turn-bias",), _of_edges(_biased, "odometry")),
    Mistake("positions in feet", ("positions-feet",), _of_positions(lambda R, t: t / 0.3048)),
    Mistake("positions with x and y swapped", ("positions-mirrored",), _of_positions(_swapped)),
    Mistake(
        "positions of an antenna",
        ("positions-lever-arm",),
        _of_positions(lambda R, t: t + R @ _mount(t.shape[1])[1]),
    ),
    Mistake("sightings in feet", ("sightings-feet",), _of_sightings(lambda y: y / 0.3048)),
    Mistake(
        "sightings of a camera",
        ("sightings-turned",),
        _of_sightings(lambda y: y @ _axes(y.shape[1])),
    ),
    Mistake(
        "sightings of a sensor elsewhere",
        ("sightings-lever-arm",),
        _of_sightings(lambda y: y - _mount(y.shape[1])[1]),
    ),
    Mistake("ids of two robots", ("ids-used-twice",), _ids_of_two),
    Mistake(
        "a right estimate, truth of another run", ("truth-contradicts",), _truth_of_another_run
    ),
    Mistake("a right estimate, truth mirrored", ("mirrored", "other-handedness"), _mirrored_truth),
    Mistake(
        "inverse poses and a wrong closure",
        ("inverse-poses",),
        _with_a_wrong_closure(_inverse),
        also=("wrong-measurement",),
    ),
    Mistake(
        "millimetres, robust to a wrong closure",
        ("millimetres", "scaled"),  # the best scale is off by what the closure pulls
        _with_a_wrong_closure(_times(1e3), knows=True),
        also=("wrong-measurement",),
    ),
)

"""The named families of cases; each yields its cases, fewer in the quick profile."""

from __future__ import annotations

import itertools
import math
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from certpgo.errors import InputNotice
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets, read, read_estimate
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.solving import solve
from reports.harness.certifiers import extremes, located, made, own_costs
from reports.harness.certifiers.made import Made
from reports.harness.certifiers.points import (
    ZooPoint,
    best_of,
    stationary,
    truth_by_form,
    truth_by_oracle,
    truth_by_search,
    truth_in_hand,
)

SIZES = (10, 20, 50, 60, 100, 200, 500, 1000, 2000)
#: Nodes and noise in degrees of the cycles that are descended from winding 1.
NOISY = ((60, 0.6), (60, 2.9), (100, 0.6), (100, 1.7), (200, 1.1), (200, 2.9))
#: The optimum of the parking garage's rotations.
GARAGE = "parking-garage"


def _wound(quick: bool) -> Iterator[ZooPoint]:
    for d, n, k in itertools.product((2, 3), _sizes(quick), (1, 2, 3)):
        yield _other(made.wound(n, 0.3, k, d), f"{d}D n={n} k={k}")


def _right(quick: bool) -> Iterator[ZooPoint]:
    for d, n in itertools.product((2, 3), _sizes(quick)):
        yield _best(made.wound(n, 0.3, 0, d), f"{d}D n={n}")


def _sizes(quick: bool) -> tuple[int, ...]:
    return tuple(n for n in SIZES if n <= 200) if quick else SIZES


def _noisy(is_wound: bool, quick: bool) -> Iterator[ZooPoint]:
    """Cycles with noise, descended from the wound-up or from the right start."""
    for (n, degrees), d, seed in itertools.product(NOISY, (2, 3), range(1 if quick else 10)):
        rng = np.random.default_rng(np.random.SeedSequence((n, d, seed)))
        problem = _cycle_problem(n, math.radians(degrees), rng, d)
        best, optimum = _cycle_optimum(problem)
        truth = truth_by_form(problem, best, optimum)
        point = best
        if is_wound:
            turn = made.wound(n, 0.0, 1, d).other
            point = stationary(problem, Estimate(so.project(turn @ best.rotations)))
        yield ZooPoint(f"{d}D n={n} noise {degrees} deg, seed {seed}", problem, point, truth)


def _scaled(power: int, quick: bool) -> Iterator[ZooPoint]:
    factor = 2.0**power
    exact = (_other(made.wound(n, 0.3, k), f"n={n} k={k}") for n in SIZES[:7] for k in (1, 2))
    for case in itertools.chain(exact, _noisy(True, True)):
        upper, lower = factor * case.truth.upper, factor * case.truth.lower
        truth = replace(case.truth, upper=upper, lower=lower)
        yield replace(case, problem=case.problem.scaled(factor), truth=truth)


def _bridged(quick: bool) -> Iterator[ZooPoint]:
    for d, n, weight in itertools.product((2, 3), (10, 60, 200), (1e-4, 1.0, 1e4)):
        rng = np.random.default_rng(n)
        ring = made.wound(n, 0.3, 1, d)
        tree = made.relabelled(made.with_tree(ring, 8, weight, rng), rng)
        pair = made.joined(ring, made.wound(n, -0.2, 1, d), bridge=weight)
        yield from _both(tree, f"{d}D n={n} with a tree of weight {weight:g}")
        yield from _both(pair, f"{d}D two of n={n}, bridge of weight {weight:g}")


def _parallel(quick: bool) -> Iterator[ZooPoint]:
    for d, n in itertools.product((2, 3), (10, 60, 200, 600)):
        rng = np.random.default_rng(n)
        split = made.wound(n, 0.3, 1, d)
        for _ in range(3):
            split = made.with_parallels(split, rng)
        yield from _both(made.relabelled(split, rng), f"{d}D n={n}")


def _weighted(quick: bool) -> Iterator[ZooPoint]:
    for d, n, decades in itertools.product((2, 3), (20, 60, 200), (0.5, 1, 2, 3)):
        rng = np.random.default_rng(np.random.SeedSequence((n, round(2 * decades))))
        found = made.wound_weighted(10.0 ** rng.uniform(0, decades, n), 0.3, 1, d)
        if found is not None:
            yield from _both(found, f"{d}D n={n}, {decades:g} decades")


def _poses(quick: bool) -> Iterator[ZooPoint]:
    """Wound-up cycles of poses: all at one place, and around exact circles of several radii."""
    for d, n in itertools.product((2, 3), (10, 60, 200)):
        ring = made.wound(n, 0.3, 1, d)
        for tau in (1e-6, 1.0, 1e6):
            problem, best, other = ring.poses_problem(np.full(n, tau))
            truth = truth_by_form(problem, best, ring.optimum)
            yield ZooPoint(f"{d}D n={n} at one place, tau={tau:g}", problem, other, truth)
        for radius in (1e-4, 1.0, 1e4):
            yield _circle(n, d, radius)


def _circle(n: int, d: int, radius: float) -> ZooPoint:
    ring = made.wound(n, 0.0, 1, d)
    angles = 2.0 * np.pi * np.arange(n) / n
    t = np.zeros((n, d))
    t[:, 0], t[:, 1] = radius * np.cos(angles), radius * np.sin(angles)
    i, j = ring.graph.edges.T
    graph = PoseGraph(ring.graph, t[j] - t[i], np.full(n, 1.0 / radius**2))
    problem = Quadratic(graph)
    truth = truth_by_form(problem, problem.complete(ring.best), 0.0)
    point = stationary(problem, Estimate(ring.other, t))
    return ZooPoint(f"{d}D n={n} circle of {radius:g} m", problem, point, truth)


def _near_ties(quick: bool) -> Iterator[ZooPoint]:
    """Two windings that cost nearly the same: theta just below pi."""
    for d, n, short in itertools.product((2, 3), (5, 20, 100), (1e-1, 1e-2, 1e-3, 1e-4, 1e-7)):
        yield from _both(made.wound(n, math.pi - short, -1, d), f"{d}D n={n}, {short:g} short")


def _loose_in_the_plane(quick: bool) -> Iterator[ZooPoint]:
    """Four rotations whose relaxation is not tight, and a worse stationary point if there is."""
    found = 0
    for seed in itertools.count():
        rng = np.random.default_rng(np.random.SeedSequence((4, seed)))
        problem = Quadratic(_random_complete(4, 2, rng))
        searched = truth_by_search(problem)
        if searched is None or not searched[0].loose:
            continue
        truth, best = searched
        worse = best_of(problem, [Estimate(so.random(rng, 4, 2)) for _ in range(6)])[-1]
        yield ZooPoint(f"K_4, seed {seed}, at the optimum", problem, best, truth)
        if problem.cost(worse) > (1.0 + 1e-4) * problem.cost(best):
            yield ZooPoint(f"K_4, seed {seed}, another point", problem, worse, truth)
        found += 1
        if found == (4 if quick else 20):
            return


def _noise_in_space(quick: bool) -> Iterator[ZooPoint]:
    """Random measurements between all pairs: loose or nearly, the best of eight descents."""
    for seed in range(8 if quick else 30):
        rng = np.random.default_rng(np.random.SeedSequence((8, seed)))
        problem = Quadratic(_random_complete(4 + seed % 8, 3, rng))
        points = best_of(problem, [Estimate(so.random(rng, problem.n, 3)) for _ in range(8)])
        truth = truth_by_oracle(problem, points[0])
        yield ZooPoint(f"K_{problem.n}, seed {seed}, best", problem, points[0], truth)
        yield ZooPoint(f"K_{problem.n}, seed {seed}, worst", problem, points[-1], truth)


def _half_turns(quick: bool) -> Iterator[ZooPoint]:
    """Short wound-up cycles, and two nodes with opposite measurements."""
    for d in (2, 3):
        for n, k in ((3, 1), (4, 1), (4, 2), (5, 2), (6, 3), (7, 3)):
            for theta in (0.0, 1e-8, 0.1):
                yield _other(made.wound(n, theta, k, d), f"{d}D n={n} k={k} theta={theta:g}")
        for weight in (0.5, 0.999, 1.0 - 1e-9):
            half = so.exp(math.pi * np.eye(so.tangent_dim(d))[-1:])
            measured = np.concatenate([np.eye(d)[None], half])
            graph = RotationGraph(2, np.array([[0, 1], [0, 1]]), measured, np.array([1.0, weight]))
            problem = Quadratic(graph)
            points = [Estimate(np.stack([np.eye(d), R])) for R in measured]
            # The sum of both is best matched by the heavier one.
            truth = truth_by_form(problem, points[0], 8.0 * weight)
            for k, point in enumerate(points):
                yield ZooPoint(
                    f"{d}D opposites, weight {weight!r}, point {k}", problem, point, truth
                )


def _written(quick: bool) -> Iterator[ZooPoint]:
    """Graphs and estimates through g2o files whose quaternions have any norm."""
    for n, norm in itertools.product((20, 60, 200), (1e-3, 0.5, 3.0, 1e3)):
        ring = made.wound(n, 0.3, 1, 3)
        for rotations, kind in ((ring.best, "right"), (ring.other, "wound up")):
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
                warnings.simplefilter("ignore", InputNotice)
                path = Path(folder) / "graph.g2o"
                path.write_text("".join(_lines(ring, rotations, norm)), encoding="utf-8")
                graph = rotations_alone(read(path)).graph
                point = read_estimate(path)
            problem = Quadratic(graph)
            optimum = float(problem.graph.kappa[0]) * ring.optimum
            truth = truth_by_form(problem, Estimate(ring.best), optimum)
            yield ZooPoint(f"{kind} n={n} norm {norm:g}", problem, Estimate(point.rotations), truth)


def _lines(ring: Made, rotations: FloatArray, norm: float) -> Iterator[str]:
    information = " ".join("1" if a == b else "0" for a in range(6) for b in range(a, 6))
    for node, q in enumerate(_quaternions(rotations)):
        yield f"VERTEX_SE3:QUAT {node} 0 0 0 {_numbers(norm * q)}\n"
    for (i, j), q in zip(ring.graph.edges, _quaternions(ring.graph.rotations), strict=True):
        yield f"EDGE_SE3:QUAT {i} {j} 0 0 0 {_numbers(norm * q)} {information}\n"


def _quaternions(R: FloatArray) -> FloatArray:
    v = so.log(R)
    half = 0.5 * np.linalg.norm(v, axis=1, keepdims=True)
    return np.concatenate([0.5 * v * np.sinc(half / np.pi), np.cos(half)], axis=1)


def _numbers(values: FloatArray) -> str:
    return " ".join(repr(float(x)) for x in values)


def _infeasible(quick: bool) -> Iterator[ZooPoint]:
    for d, n in itertools.product((2, 3), (20, 200)):
        ring = made.wound(n, 0.3, 1, d)
        mirror = np.diag([1.0] * (d - 1) + [-1.0])
        reflected = ring.best.copy()
        reflected[n // 2] = reflected[n // 2] @ mirror
        for name, rotations in (
            ("one reflected", reflected),
            ("all reflected", mirror @ ring.best),
            ("scaled by 0.5", 0.5 * ring.best),
            ("scaled by 0.999", 0.999 * ring.best),
            ("wound up, scaled by 1e-3", 1e-3 * ring.other),
        ):
            case = _best(ring, f"{d}D n={n} {name}")
            yield replace(case, point=Estimate.trusted(rotations))


def _stretched(quick: bool) -> Iterator[ZooPoint]:
    """Estimates that cost a multiple of the optimum, moved along the graph's softest mode."""
    for n, d in ((60, 2), (200, 2), (200, 3), (1000, 3)):
        problem = _cycle_problem(n, 0.01, np.random.default_rng(n), d)
        best, optimum = _cycle_optimum(problem)
        truth = truth_by_form(problem, best, optimum)
        for times in (1.1, 3.2, 10.0):
            point = _soft_move(problem, best, times)
            yield ZooPoint(f"{d}D cycle n={n}, {times:g} F*", problem, point, truth)


def _garage(quick: bool) -> Iterator[ZooPoint]:
    """The same of the parking garage's rotations, where its file is here."""
    if datasets.find(GARAGE) is None:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputNotice)
        graph = rotations_alone(datasets.load(GARAGE, download=False)).graph
    problem = Quadratic(graph)
    best = solve(graph).estimate
    # Too large for the oracle: the better point refutes, and that the optimum is one stays open.
    truth = truth_in_hand(problem, best)
    yield ZooPoint("F*", problem, best, truth)
    for times in (1.1, 3.2, 10.0, 100.0):
        yield ZooPoint(f"{times:g} F*", problem, _soft_move(problem, best, times), truth)


def _soft_move(problem: Quadratic, best: Estimate, times: float) -> Estimate:
    """The rotations turned along the Fiedler vector about one axis, to ``times`` the cost."""
    factor = problem.grounded_factor(problem.laplacian)
    mode = np.random.default_rng(0).standard_normal(problem.n)
    for _ in range(50):
        mode -= mode.mean()
        solved = mode.copy()[:, None]
        solved[0] = 0.0
        mode = factor.solve(solved)[:, 0]  # type: ignore[union-attr]
        mode /= np.linalg.norm(mode)
    axis = np.eye(so.tangent_dim(problem.d))[-1]

    def moved(size: float) -> Estimate:
        return Estimate(so.exp(size * mode[:, None] * axis) @ best.rotations)

    low, high = 0.0, 1e-9
    target = times * problem.cost(best)
    while problem.cost(moved(high)) < target:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if problem.cost(moved(middle)) < target else (low, middle)
    return moved(high)


def _cycle_optimum(problem: Quadratic) -> tuple[Estimate, float]:
    """Of a cycle 0 - 1 - ... - 0 of unit weights: its error turned evenly into all edges."""
    measured, n = problem.graph.rotations, problem.n
    chain = np.empty_like(measured)
    chain[0] = np.eye(problem.d)
    for k in range(1, n):
        chain[k] = chain[k - 1] @ measured[k - 1]
    # chain[n - 1] measured[n - 1] is the identity but for the error.
    error = so.log((chain[-1] @ measured[-1])[None])[0]
    shares = so.exp(-np.arange(n)[:, None] / n * error)
    angle = float(np.linalg.norm(error))
    best = stationary(problem, Estimate(so.project(shares @ chain)))
    return best, 8.0 * n * math.sin(angle / (2.0 * n)) ** 2


def _random_complete(n: int, d: int, rng: np.random.Generator) -> Graph:
    edges = np.argwhere(np.tri(n, k=-1).T)
    return RotationGraph(n, edges, so.random(rng, len(edges), d), np.ones(len(edges)))


def _cycle_problem(n: int, sigma: float, rng: np.random.Generator, d: int) -> Quadratic:
    return Quadratic(synthetic.cycle(n, sigma, rng, d).graph)


def _best(ring: Made, name: str) -> ZooPoint:
    problem, best, _ = ring.rotations_problem()
    return ZooPoint(name, problem, best, truth_by_form(problem, best, ring.optimum))


def _other(ring: Made, name: str) -> ZooPoint:
    problem, best, other = ring.rotations_problem()
    return ZooPoint(name, problem, other, truth_by_form(problem, best, ring.optimum))


def _both(ring: Made, name: str) -> Iterator[ZooPoint]:
    yield _best(ring, f"{name}, at the optimum")
    yield _other(ring, f"{name}, wound up")


FAMILIES: dict[str, Callable[[bool], Iterator[ZooPoint]]] = {
    "wound-up cycles": _wound,
    "noisy wound-up cycles, descended": partial(_noisy, True),
    **{
        f"wound-up, weights times 2^{p}": partial(_scaled, p) for p in (-390, -40, -20, 20, 40, 380)
    },
    "wound-up, uneven weights": _weighted,
    "wound-up, bridges": _bridged,
    "wound-up, parallel edges": _parallel,
    "wound-up poses": _poses,
    "residuals near 180 degrees": _half_turns,
    "half-turn triangles": extremes.half_turn_triangles,
    "contradicting measurements": extremes.contradicting,
    "weights at the ends of their range": extremes.uneven,
    "long bridges": extremes.long_bridges,
    "near ties": _near_ties,
    "loose relaxations in the plane": _loose_in_the_plane,
    "pure noise in space": _noise_in_space,
    "quaternions that are not unit, from files": _written,
    "moved along the softest mode": _stretched,
    f"{GARAGE}, moved along the softest mode": _garage,
    "no rotations: reflected, scaled": _infeasible,
    "g2o's and GTSAM's costs, wound-up cycles": own_costs.wound,
    "g2o's and GTSAM's costs, exact data": own_costs.exact,
    "g2o's and GTSAM's costs, noise": own_costs.noisy,
    "g2o's and GTSAM's costs, MIT and intel": own_costs.read,
    "landmarks, exact data": partial(located.exact, located.LANDMARKS),
    "landmarks, noise": partial(located.noisy, located.LANDMARKS),
    "sightings alone, noise": partial(located.noisy, located.SIGHTINGS_ALONE),
    "positions and attitudes, exact data": partial(located.exact, located.PRIORS),
    "positions and attitudes, noise": partial(located.noisy, located.PRIORS),
    "positions in a plane, noise": partial(located.noisy, located.PRIORS_IN_A_PLANE),
    "rotations or positions alone, noise": partial(located.noisy, located.PARTIAL),
    "cycles at the optimum": _right,
    "noisy cycles at the optimum": partial(_noisy, False),
}

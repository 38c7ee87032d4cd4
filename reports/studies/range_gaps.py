"""How much of the gap of measured distances tighter relaxations could close.

    python -m reports.studies.range_gaps [DATASET ...] [--copies K]

For each dataset with distances: the gap of the relaxation over real matrices, that of ours (over
complex numbers in the plane, so that lifted rotations keep their handedness), how many of the
descents from projections of its minimum find the best map, and by how much triangle inequalities
are violated there.

The last column bounds what any further constraint can do. The mean of the Gram matrices of K maps
meets every convex constraint that the Gram matrices of maps meet: of handedness, of triangles, of
the volumes of simplices. The cost is a convex function of the Gram matrix, and its value for that
mean,

    1/K sum_k F(map k) + sum w (d - (1/K sum_k |t_j - t_i|_k^2)^(1/2))^2,

is nowhere below the minimum of any such relaxation. What descents on it find is therefore above all
of their bounds, and its difference to the best map is a gap that remains, whatever is added.
"""

import warnings
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import certpgo
from certpgo.certify.normalized import NormalizedProblem
from certpgo.graph.relaxed_point import Lift, translations_of
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.lifted_distances import LiftedDistances
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.descent import descend
from certpgo.solve.relaxation import Relaxed
from reports.studies._printing import options

DATASETS = ("goats_15", "goats_16", "mrclam5a", "plaza2")
ROW = "{:14}{:>12}{:>9}{:>9}{:>8}{:>11}{:>9}"
#: Starts of the descent on several maps, its steps, and the relative decrease at which it ends.
STARTS, STEPS, CLOSE = 3, 200, 1e-9
#: Projections of the relaxation's minimum that are descended from.
PROJECTED = 12
#: By which maps are moved apart when their number is doubled, over the median distance.
SPREAD = 0.1
#: Relative difference of two costs below which maps are the same.
SAME = 1e-6


@dataclass(frozen=True, eq=False)
class Maps:
    """K maps of equal weight: their rotations (K, n, d, d) and positions (K, n, d)."""

    R: np.ndarray
    t: np.ndarray


class Mean:
    """The cost of the mean of the Gram matrices of K maps, and descent on it."""

    def __init__(self, problem: LiftedDistances, K: int) -> None:
        self.problem, self.graph, self.K = problem, problem.measured, K
        self.d, self.q = problem.d, so.tangent_dim(problem.d)
        size = np.full(problem.n, self.d)
        size[problem.poses] += self.q
        self.first, self.N = np.cumsum(size) - size, int(size.sum())

    def lengths(self, maps: Maps) -> np.ndarray:
        """(k,) root mean squares of |t_j - t_i|."""
        i, j = self.problem.ranges.edges.T
        squares = ((maps.t[:, j] - maps.t[:, i]) ** 2).sum(axis=2)
        return np.maximum(np.sqrt(squares.mean(axis=0)), np.finfo(float).tiny)

    def residuals(self, maps: Maps) -> np.ndarray:
        """All residuals: rotations and translations, map by map, then distances."""
        graph, (i, j), R, t = self.graph, self.graph.edges.T, maps.R, maps.t
        kappa, tau = graph.kappa / self.K, graph.tau / self.K
        turned = R[:, j] - R[:, i] @ graph.rotations
        moved = t[:, j] - t[:, i] - (R[:, i] @ graph.translations[:, :, None])[..., 0]
        turned *= np.sqrt(kappa)[:, None, None]
        moved *= np.sqrt(tau)[:, None]
        parts = np.concatenate([turned.reshape(self.K, -1), moved.reshape(self.K, -1)], axis=1)
        ranges = self.problem.ranges
        misfit = np.sqrt(ranges.weights) * (self.lengths(maps) - ranges.distances)
        return np.concatenate([parts.ravel(), misfit])

    def cost(self, maps: Maps) -> float:
        """The cost of the mean."""
        r = self.residuals(maps)
        return float(r @ r)

    def jacobian(self, maps: Maps) -> sparse.csc_matrix:
        """Of the residuals, in world translations and body rotations."""
        graph, (i, j), d, q = self.graph, self.graph.edges.T, self.d, self.q
        m, measured = graph.num_edges, graph.rotations
        generators, axes = so.hat(np.eye(q)), np.arange(d)
        kappa, tau = np.sqrt(graph.kappa / self.K), np.sqrt(graph.tau / self.K)
        rows, columns, values = [], [], []

        def put(row: np.ndarray, column: np.ndarray, value: np.ndarray) -> None:
            row, column, value = np.broadcast_arrays(row, column, value)
            kept = value != 0.0
            for into, given in ((rows, row), (columns, column), (values, value)):
                into.append(given[kept])

        per = m * (d * d + d)
        entry = (np.arange(m * d * d)).reshape(m, 1, d, d)
        coordinate = m * d * d + np.arange(m * d).reshape(m, d)
        turn = d + np.arange(q)
        for k in range(self.K):
            at, down, R = k * self.N + self.first, k * per, maps.R[k]
            there = kappa[:, None, None, None] * (R[j][:, None] @ generators)
            here = -kappa[:, None, None, None] * (R[i][:, None] @ generators @ measured[:, None])
            for node, value in ((j, there), (i, here)):
                put(down + entry, at[node][:, None, None, None] + turn[:, None, None], value)
            for node, sign in ((j, 1.0), (i, -1.0)):
                put(down + coordinate, at[node][:, None] + axes, sign * tau[:, None])
            lever = np.einsum("mab,qbc,mc->mqa", R[i], generators, graph.translations)
            column = at[i][:, None, None] + turn[:, None]
            put((down + coordinate)[:, None], column, -tau[:, None, None] * lever)
        a, b = self.problem.ranges.edges.T
        pull = np.sqrt(self.problem.ranges.weights) / self.lengths(maps) / self.K
        row = self.K * per + np.arange(len(a))[:, None]
        for k in range(self.K):
            step = pull[:, None] * (maps.t[k][b] - maps.t[k][a])
            for node, sign in ((b, 1.0), (a, -1.0)):
                put(row, k * self.N + self.first[node][:, None] + axes, sign * step)
        shape = (self.K * per + len(a), self.K * self.N)
        placed = np.concatenate(rows), np.concatenate(columns)
        return sparse.csc_matrix((np.concatenate(values), placed), shape=shape)

    def moved(self, maps: Maps, x: np.ndarray) -> Maps:
        """The maps after a step."""
        steps, poses = x.reshape(self.K, self.N), self.problem.poses
        t = maps.t + steps[:, self.first[:, None] + np.arange(self.d)]
        R, turns = maps.R.copy(), steps[:, self.first[poses][:, None] + self.d + np.arange(self.q)]
        for k in range(self.K):
            R[k, poses] = so.project(R[k, poses] @ so.exp(turns[k]))
        return Maps(R, t)

    def descend(self, maps: Maps) -> tuple[float, Maps]:
        """The cost where Levenberg and Marquardt's method ends, and the maps."""
        cost, damping = self.cost(maps), 1e-6
        for _ in range(STEPS):
            J = self.jacobian(maps)
            H, g = (J.T @ J).tocsc(), J.T @ self.residuals(maps)
            diagonal = H.diagonal()
            while damping < 1e12:
                A = (H + sparse.diags(damping * (diagonal + 1e-12 * diagonal.max()))).tocsc()
                solve = splu(A, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve
                trial = self.moved(maps, -solve(g))
                lower = self.cost(trial)
                if lower < cost:
                    break
                damping = max(10.0 * damping, 1e-9)
            else:
                return cost, maps
            fall, maps, cost = cost - lower, trial, lower
            damping = max(damping / 10.0, 1e-12)
            if fall < CLOSE * cost:
                break
        return cost, maps


def lowest_mean(problem: LiftedDistances, starts: list[Lift], scale: float, copies: int) -> float:
    """The lowest cost found of a mean: of two of the starts' maps, then of twice as many.

    Parameters
    ----------
    scale : by which positions of the starts, which keep a part of each length, are multiplied
    """
    found = []
    for seed in range(STARTS):
        chosen = np.random.default_rng(seed).choice(len(starts), 2, replace=False)
        R = np.stack([starts[k].rotations for k in chosen])
        t = scale * np.stack([translations_of(starts[k]) for k in chosen])
        found.append(Mean(problem, 2).descend(Maps(R, t)))
    cost, maps = min(found, key=lambda one: one[0])
    apart = SPREAD * float(np.median(problem.ranges.distances))
    while 2 * len(maps.R) <= copies:
        noise = apart * np.random.default_rng(0).standard_normal(
            (2 * len(maps.t), *maps.t[0].shape)
        )
        more = Maps(np.repeat(maps.R, 2, axis=0), np.repeat(maps.t, 2, axis=0) + noise)
        lower, maps = Mean(problem, len(more.R)).descend(more)
        cost = min(cost, lower)
    return cost


def climbed(normalized: NormalizedProblem) -> Relaxed:
    """The relaxation at its minimum."""
    problem = normalized.problem
    relaxed = Relaxed(problem.lifted_form, normalized.stop, problem.d + problem.most_ranks)
    for _ in relaxed.bounds():
        pass
    return relaxed


def row(name: str, copies: int) -> str:
    """The line of a dataset."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        posed = objective_of(datasets.load(name), "chordal")
    problem, best = posed.lifted_form, certpgo.solve(posed).cost
    normalized = NormalizedProblem.of(posed, "standard", 1e-5, 1e-9)
    unit, relaxed = normalized.unit, climbed(normalized)
    point = relaxed.point

    def gap(value: float) -> str:
        return f"{100.0 * (1.0 - value / best):.2f} %"

    real = "same"
    if problem.d == 2:
        flat = NormalizedProblem.of(posed, "standard", 1e-5, 1e-9)
        form = flat.problem.lifted_form
        form.__dict__["whole"] = Quadratic(form.whole.graph, form.engine)
        real = gap(unit * climbed(flat).bound.value)
    starts = [*islice(relaxed.projections(), PROJECTED)]
    costs = np.array([unit * descend(normalized.problem, start).cost for start in starts])
    found = int((costs < (1.0 + SAME) * best).sum())
    lowest = lowest_mean(problem, starts, np.sqrt(point.rank / problem.d), copies)
    ours = gap(unit * relaxed.bound.value)
    violated = f"{triangles(problem, translations_of(point)):.1e}"
    return ROW.format(
        name, f"{best:.8g}", real, ours, f"{found}/{len(starts)}", violated, gap(lowest)
    )


def triangles(problem: LiftedDistances, t: np.ndarray) -> float:
    """The largest violation of a triangle inequality, relative to the sides, at positions (n, r).

    Of triangles of two distances that share a node, and a distance or measurement between the
    others.
    """
    sides = {frozenset(pair) for pair in problem.graph.edges.tolist()}
    ends: dict[int, list[int]] = {}
    for i, j in problem.ranges.edges.tolist():
        ends.setdefault(i, []).append(j)
        ends.setdefault(j, []).append(i)
    worst = 0.0
    for apex, others in ends.items():
        near = set(others)
        for pair in sides:
            if pair <= near:
                a, b = pair
                p, q, r = (np.linalg.norm(t[x] - t[y]) for x, y in ((apex, a), (apex, b), (a, b)))
                worst = max(worst, (2.0 * max(p, q, r) - p - q - r) / (p + q + r))
    return worst


def main() -> None:
    """Print the table."""
    arguments = options(__doc__, datasets=DATASETS, copies=4)
    heads = "F", "real", "ours", "starts", "triangles", "remains"
    print(ROW.format("graph", *heads))
    for name in arguments.datasets:
        print(row(name, arguments.copies), flush=True)


if __name__ == "__main__":
    main()

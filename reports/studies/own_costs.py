"""Certificates in g2o's cost on small random instances, against the best of many descents.

    python -m reports.studies.own_costs 1000 --seed 0

Rings with chords and random graphs, in 2D and 3D, of little to much noise, with information of
condition up to 1e4, with cross terms or without, isotropic in the translations or not. Judged are
the estimate of `solve`, ends of descents, points near the best of them, and rings wound up once.
Prints how often the optimal and the other estimates got which verdict, and every answer that is
false; exit code 1 if there was one. False is

- a lower bound above the cost of any estimate found;
- CERTIFIED, if another estimate costs less by more than the gap;
- REFUTED, if the better estimate that it names does not cost less;
- an exception, or a warning.
"""

import argparse
import multiprocessing
import sys
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo import Certificate, Estimate, certify, solve
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.costs.g2o import G2oCost
from certpgo.optimize.initialization import start_of
from certpgo.optimize.levenberg_marquardt import descend

#: Instances that a process is given at once.
BLOCK = 10
#: Descents from random rotations.
DESCENTS = 8
#: Relative excess over the best cost found up to which an estimate is called optimal.
SAME = 1e-9
#: Ranks that the staircase may add to d: enough for bounds, and fast.
MORE_RANKS = 2


@dataclass(frozen=True, eq=False)
class Case:
    """A problem with what it was made from.

    Attributes
    ----------
    problem : measurements under g2o's cost
    truth : what was measured
    is_ring : whether consecutive nodes are joined in a ring
    kind : dimension, noise and information, in words
    """

    problem: Sum
    truth: Estimate
    is_ring: bool
    kind: str


def case_of(seed: int, first: int = 0) -> Case:
    """The instance of a seed; ``first`` begins another series."""
    rng = np.random.default_rng(np.random.SeedSequence((16, first, seed)))
    d, is_ring = int(rng.integers(2, 4)), bool(rng.random() < 0.5)
    n = int(rng.integers(3, 11))
    p, q = d * (d + 1) // 2, so.tangent_dim(d)
    edges = _edges(rng, n, is_ring)
    m = len(edges)
    R, t = so.random(rng, n, d), 3.0 * rng.standard_normal((n, d))
    if is_ring:  # rings of small turns, that can be wound up
        R = so.exp(0.3 * rng.standard_normal((n, q)))
    noise = 10.0 ** rng.uniform(-3.0, 0.3)
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    measured = back @ R[j] @ so.exp(noise * rng.standard_normal((m, q)))
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + noise * rng.standard_normal((m, d))
    cross, isotropic = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
    decades = float(rng.uniform(0.0, 4.0))
    Omega = _information(rng, m, p, decades)
    if not cross:
        Omega[:, :d, d:] = Omega[:, d:, :d] = 0.0
        if isotropic:
            Omega[:, :d, :d] = np.exp(rng.standard_normal((m, 1, 1))) * np.eye(d)
    Omega *= 10.0 ** rng.uniform(-3.0, 3.0)
    kappa = np.trace(Omega[:, d:, d:], axis1=1, axis2=2) / (2.0 * q)
    tau = d / np.trace(np.linalg.inv(Omega[:, :d, :d]), axis1=1, axis2=2)
    graph = PoseGraph(RotationGraph(n, edges, measured, kappa), steps, tau)
    size = "small" if noise < 0.05 else "medium" if noise < 0.4 else "large"
    if cross:
        weights = f"cross terms of condition {'below' if decades < 2.0 else 'above'} 100"
    else:
        weights = f"{'isotropic' if isotropic else 'anisotropic'} translations, no cross terms"
    kind = f"{d}D, {size} noise, {weights}"
    return Case(Sum(graph.with_information(Omega), G2oCost), Estimate(R, t), is_ring, kind)


def _edges(rng: np.random.Generator, n: int, is_ring: bool) -> np.ndarray:
    first = [(k, (k + 1) % n) for k in range(n)]
    if not is_ring:
        first = [(int(rng.integers(k)), k) for k in range(1, n)]
    more = [tuple(rng.choice(n, 2, replace=False)) for _ in range(int(rng.integers(0, n + 1)))]
    edges = np.array(first + more, dtype=np.intp)
    flip = rng.random(len(edges)) < 0.5
    edges[flip] = edges[flip][:, ::-1]
    return edges


def _information(rng: np.random.Generator, m: int, p: int, decades: float) -> FloatArray:
    B = np.linalg.qr(rng.standard_normal((m, p, p)))[0]
    A = (B * 10.0 ** (-decades * rng.random((m, 1, p)))) @ np.swapaxes(B, 1, 2)
    return np.asarray(0.5 * (A + np.swapaxes(A, 1, 2)))


def estimates(
    case: Case, rng: np.random.Generator, descents: int
) -> Iterator[tuple[str, Estimate]]:
    """Starting points for descents, by name."""
    problem, n, d = case.problem, case.problem.n, case.problem.d
    yield "truth", case.truth
    yield "chordal", start_of(problem.chordal).estimate
    if case.is_ring:
        axis = np.eye(so.tangent_dim(d))[0]
        for sign in (1.0, -1.0):
            turns = sign * 2.0 * np.pi * np.arange(n)[:, None] / n * axis
            yield "wound up", problem.chordal.complete(so.exp(turns) @ case.truth.rotations)
    for _ in range(descents):
        yield "random", problem.chordal.complete(so.random(rng, n, d))


def outcomes(
    seed: int, first: int = 0, descents: int = DESCENTS, *, brief: bool = False
) -> Counter[str]:
    """The verdicts on estimates of one instance, and what of them is false.

    If ``brief``, only those of `solve`, near the best and of one start, which may be wound up.
    """
    found: Counter[str] = Counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            _judge(case_of(seed, first), seed, first, descents, brief, found)
        except Exception as error:
            found[f"FALSE: seed {seed}: {error!r}"] += 1
    return found


def _judge(
    case: Case, seed: int, first: int, descents: int, brief: bool, found: Counter[str]
) -> None:
    problem = case.problem
    rng = np.random.default_rng(np.random.SeedSequence((17, first, seed)))
    starts = list(estimates(case, rng, descents))
    ends = [descend(problem, start).estimate for _, start in starts]
    solved = solve(problem, max_rank=problem.d + MORE_RANKS, time_limit=10.0)
    others = [end for end in ends if np.isfinite(problem.cost(end))]
    best = min([solved.estimate, *others], key=problem.cost)
    ceiling = problem.enclosure(best)[1]
    p = so.tangent_dim(problem.d)
    near = best.rotations @ so.exp(1e-3 * rng.standard_normal((problem.n, p)))
    judged: list[tuple[str, Estimate, Certificate]] = [
        ("solve", solved.estimate, solved.certificate)
    ]
    worst = max(others, key=problem.cost)
    given = {"near the best": Estimate(near, best.translations), starts[2][0]: starts[2][1]}
    if not brief:
        given |= {"the best": best, "the worst end": worst}
        for name, x in (("the best", best), ("the worst end", worst)):
            judged.append((f"{name}, unrefined", x, certify(problem, x, refine=False)))
    for name, x in given.items():
        judged.append((name, x, certify(problem, x)))
    for *_, c in judged:
        for found_on_the_way in (c.refined, c.better):
            if found_on_the_way is not None:
                ceiling = min(ceiling, problem.enclosure(found_on_the_way)[1])
    for name, x, c in judged:
        low, high = problem.enclosure(x)
        verdict = c.verdict.value
        if c.lower_bound > ceiling:
            found[f"FALSE: seed {seed}: {name}: a bound of {c.lower_bound} above {ceiling}"] += 1
        if c.cost_upper < low:
            found[f"FALSE: seed {seed}: {name}: a cost of {c.cost_upper} below {low}"] += 1
        if verdict == "CERTIFIED" and (c.gap > c.tolerance or low - ceiling > c.gap):
            found[f"FALSE: seed {seed}: {name}: CERTIFIED, but {ceiling} is less"] += 1
        if verdict == "REFUTED" and not (c.better and problem.enclosure(c.better)[1] < low):
            found[f"FALSE: seed {seed}: {name}: REFUTED, by nothing better"] += 1
        optimal = high <= ceiling * (1.0 + SAME) + SAME * c.atol * problem.scale
        found[f"{'optimal' if optimal else 'other'} estimates: {verdict}"] += 1
        if name == "solve":
            found[f"solve: {case.kind}: {verdict}"] += 1
            found[f"solve: {'best' if optimal else 'beaten'}: {verdict}"] += 1


def block(part: tuple[int, int, int]) -> Counter[str]:
    """The sum of the outcomes of a block of seeds, by its first one, series and descents."""
    start, series, descents = part
    seeds = range(start, start + BLOCK)
    return sum((outcomes(seed, series, descents) for seed in seeds), Counter())


def main() -> None:
    """Run, print, and exit with 1 if anything was false."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("instances", type=int, nargs="?", default=1000)
    parser.add_argument("--seed", type=int, default=0, help="of the series")
    parser.add_argument("--descents", type=int, default=DESCENTS, help="from random rotations")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    found: Counter[str] = Counter()
    starts = range(0, options.instances, BLOCK)
    blocks = [(start, options.seed, options.descents) for start in starts]
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        for counts in pool.imap_unordered(block, blocks):
            found += counts
    for outcome, count in sorted(found.items()):
        print(f"{count:8}  {outcome}")
    sys.exit(any("FALSE" in outcome for outcome in found))


if __name__ == "__main__":
    main()

"""Verdicts about rejections, held against all choices of what to take back.

    python -m reports.studies.truncated [--graphs 1000] [--doubtful 8] [--seed 0] [--out FILE]

Random graphs of 4 to 9 poses or rotations, in the plane and in space, with noise as stated and up
to so many doubtful measurements, a third of which are right and the others wrong by anything
between a hundredth and three radians and metres. The price is between 3 and 60. For every choice
of doubtful measurements, the graph of the others and these is solved. A bound is false if it is
above the lowest cost found, CERTIFIED if another choice costs less than the tolerance allows, a
rise if taking the measurement back costs less, and a refutation if the measurement is right. That
a kept measurement is worth keeping, proven, is false if some choice without it costs less; of each
graph, so many proven ones are tried.
Proof files are written, checked by both checkers, and damaged in what they say of rejected
measurements: one is false if a checker accepts it and its bound is above the lowest cost found for
the prices that it states. Printed as CSV: per kind of graph, the verdicts and what was false.
"""

import itertools
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certpgo import (
    Estimate,
    Graph,
    NumericalError,
    certify,
    checker,
    integer_checker,
    read,
    solve,
    write,
    write_proof,
)
from certpgo.certify import Certificate
from certpgo.certify.leave_one_out import worth_keeping
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.errors import GraphError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import budgets, proven_rises
from reports.studies._printing import options, print_table

#: Relative rounding of costs that are compared.
SAME = 1e-9
#: Damaged copies of each proof, and kept measurements that are left out.
DAMAGED, LEFT_OUT = 8, 3


def random_graph(
    rng: np.random.Generator, d: int, poses: bool, most: int
) -> tuple[Graph, BoolArray, BoolArray]:
    """A graph, and which measurements are doubtful, and wrong."""
    n, k = int(rng.integers(4, 10)), int(rng.integers(1, most + 1))
    pairs = [(i, i + 1) for i in range(n - 1)]
    pairs += [
        tuple(rng.choice(n, 2, replace=False)) for _ in range(int(rng.integers(1, 2 * n)) + k)
    ]
    edges, m = np.array(pairs), len(pairs)
    doubtful = np.arange(m) >= m - k
    wrong = doubtful & (rng.random(m) < 2.0 / 3.0)
    size = np.where(wrong, 10.0 ** rng.uniform(-2.0, 0.5, m), 0.0)
    kappa, tau = np.exp(0.7 * rng.normal(size=(2, m))) * np.array([[200.0], [100.0]])
    R, t = so.random(rng, n, d), 3.0 * rng.normal(size=(n, d))
    i, j = edges.T
    back = np.swapaxes(R[i], 1, 2)
    # In the plane, kappa is the information of the angle; in space 2 kappa.
    sigma = 1.0 / np.sqrt(kappa if d == 2 else 2.0 * kappa)
    turns = rng.normal(size=(m, so.tangent_dim(d))) * np.maximum(size, sigma)[:, None]
    rotation = RotationGraph(n, edges, back @ R[j] @ so.exp(turns), kappa)
    if not poses:
        return rotation, doubtful, wrong
    steps = (back @ (t[j] - t[i])[:, :, None])[:, :, 0]
    steps += rng.normal(size=(m, d)) * np.maximum(size, 1.0 / np.sqrt(tau))[:, None]
    return PoseGraph(rotation, steps, tau), doubtful, wrong


def examined(seed: int, most: int) -> tuple[str, Counter[str]]:
    """The kind of a random graph, and what was found of it."""
    rng = np.random.default_rng(seed)
    d, poses = int(rng.integers(2, 4)), bool(rng.integers(2))
    graph, doubtful, wrong = random_graph(rng, d, poses, most)
    whole, price = Quadratic(graph), math.exp(rng.uniform(1.0, 4.0))
    problem = TruncatedCost(whole, np.where(doubtful, price, np.inf))
    kept = solve(problem.kept)
    certificate = certify(problem, kept.estimate)
    rises = proven_rises(problem, kept.estimate, Stop())
    best, single = math.inf, np.full(int(doubtful.sum()), math.inf)
    costs: list[tuple[tuple[float, ...], float]] = []
    for choice in itertools.product((0.0, 1.0), repeat=len(single)):
        factors = np.ones(len(doubtful))
        factors[doubtful] = choice
        cost = solve(graph.reweighted(factors), initial=kept.estimate, time_limit=5.0).cost
        best = min(best, cost + price * choice.count(0.0))
        costs.append((choice, cost))
        if sum(choice) == 1.0:
            single[choice.index(1.0)] = cost
    found = Counter({certificate.verdict.value: 1, "graphs": 1, "rises": len(rises)})
    room = SAME * best
    found["false bounds"] += certificate.lower_bound > best + room
    claimed = certificate.cost_upper - certificate.tolerance > best + room
    found["false CERTIFIED"] += certificate.verdict.value == "CERTIFIED" and claimed
    found["false rises"] += int((rises > single - kept.certificate.lower_bound + room).sum())
    refuted = rises > budgets(whole)[doubtful]
    for prices, lower, is_damaged in proofs(graph, problem, certificate, rng):
        lowest = min(cost + prices @ (1.0 - np.array(choice)) for choice, cost in costs)
        found["damaged accepted" if is_damaged else "proofs"] += 1
        found["false proofs"] += lower > lowest * (1.0 + SAME)
    normalized = NormalizedProblem.of(problem, "standard", RTOL, ATOL)
    prices_of_all = np.full(len(doubtful), price)
    worth = worth_keeping(normalized, certificate.refined, prices_of_all / normalized.unit)
    found["worth keeping"] += int(worth.sum())
    for e in rng.permutation(np.flatnonzero(worth))[:LEFT_OUT].tolist():
        lowest = min(
            _cost(graph, np.where(doubtful, choice, np.arange(len(doubtful)) != e), kept.estimate)
            + price * (doubtful & ~choice).sum()
            for choice in _choices(doubtful)
        )
        allowed = certificate.refined_cost - certificate.tolerance - room
        found["false keeping"] += lowest + price < allowed
    found["refuted"] += int(refuted.sum())
    found["right refuted"] += int((refuted & ~wrong[doubtful]).sum())
    return f"{'poses' if poses else 'rotations'} {d}D", found


def _choices(doubtful: BoolArray) -> Iterator[BoolArray]:
    for choice in itertools.product((False, True), repeat=int(doubtful.sum())):
        whole = np.zeros_like(doubtful)
        whole[doubtful] = choice
        yield whole


def _cost(graph: Graph, taken: BoolArray, start: Estimate) -> float:
    """F of some measurements at its optimum; of the part that they determine, if not all."""
    try:
        return solve(graph.reweighted(1.0 * taken), initial=start, time_limit=5.0).cost
    except GraphError:
        return math.inf


def proofs(
    graph: Graph,
    problem: TruncatedCost,
    certificate: Certificate,
    rng: np.random.Generator,
) -> Iterator[tuple[FloatArray, float, bool]]:
    """Prices and lower bounds of proofs that a checker accepts, and whether they were damaged."""
    with tempfile.TemporaryDirectory() as folder:
        source, proof = Path(folder) / "graph.g2o", Path(folder) / "proof"
        write(source, graph)
        instance = read(source, quiet=True)
        try:
            write_proof(
                proof, source, instance, certificate.refined, certificate, prices=problem.prices
            )
        except NumericalError:
            return
        with np.load(proof) as archive:
            arrays = dict(archive)
        rows = arrays["rejections"]
        for k in range(DAMAGED + 1):
            if k > 0:
                arrays["rejections"] = _damaged(rows, rng)
                np.savez(proof.open("wb"), **arrays)
            for check in (checker.check, integer_checker.check):
                try:
                    lower = float(check(source, proof).lower)
                except (
                    checker.Refused,
                    checker.Unreadable,
                    integer_checker.Refused,
                    integer_checker.Unreadable,
                ):
                    continue
                yield arrays["rejections"][:, 0], lower, k > 0


def _damaged(rows: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Rows with a column, or a number, that is more or less by a factor or by itself."""
    found = rows.copy()
    place = (rng.integers(len(rows)), rng.integers(rows.shape[1]))
    chosen = place if rng.integers(2) else (slice(None), place[1])
    found[chosen] *= 1.0 + rng.choice([-2.0, -1.0, 1.0]) * 10.0 ** rng.uniform(-16.0, 1.0)
    return found


def main() -> None:
    """Run the campaign."""
    asked = options(__doc__, graphs=1000, doubtful=8, seed=0, out=None)
    kinds: dict[str, Counter[str]] = {}
    for seed in range(asked.seed, asked.seed + asked.graphs):
        kind, found = examined(seed, asked.doubtful)
        kinds.setdefault(kind, Counter()).update(found)
    verdicts = ("CERTIFIED", "BOUNDED", "REFUTED", "UNDECIDED")
    false = ("false bounds", "false CERTIFIED", "false rises", "right refuted", "false proofs")
    found = ("rises", "refuted", "worth keeping", "proofs", "damaged accepted")
    columns = ("graphs", *verdicts, *found, *false, "false keeping")
    table = [{"kind": kind, **{c: kinds[kind][c] for c in columns}} for kind in sorted(kinds)]
    print_table(table, asked.out)


if __name__ == "__main__":
    main()

"""Attacks certificates over similarities, and counts how often the relaxation is tight.

    python -m reports.studies.similarities attack [--graphs N] [--sdp N] [--seed S]
    python -m reports.studies.similarities damage [--graphs N] [--each N] [--seed S]
    python -m reports.studies.similarities map [--graphs N]
    python -m reports.studies.similarities logarithms [--graphs N] [--seed S]

``attack`` solves small random graphs, descends from many random starts and looks for a point below
a proven bound. Of some it solves the relaxation with Clarabel, an interior-point method, whose
minimum no bound may exceed and every bound at a higher rank should reach. ``damage`` changes proof
files of such graphs, and the graphs beneath them with the digest that the proof states, and asks
both checkers: what one of them proves must be true of the optimum, whose bounds are known; it also
prints relative gaps of the proofs before that. ``map`` counts the graphs whose relaxation is tight,
by the noise of rotations and of scales.
``logarithms`` looks for maps below bounds on the cost of logarithms, by descents that begin near
the answer and by random ones with scales near its. All print a table, and attacks fail if anything
false was found.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import Estimate
from certpgo.errors import CertPGOError
from certpgo.graph import Graph, Instance
from certpgo.io.datasets.monocular import random_maps
from certpgo.linalg import rotations as so
from certpgo.objective.logarithms import LogarithmCost
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.solve.proving import write_proof
from reports.studies.damaged_proofs import damaged, packed, verdicts

#: Noise of rotations, radians, of logarithms of scales, and of translations.
NOISES = (0.05, 0.1, 0.2, 0.4, 0.8)
#: Random starts of each graph, and relative differences that are an optimizer's rounding.
STARTS, SOLVED, INTERIOR = 6, 1e-9, 2e-6


def sampled(rng: np.random.Generator) -> Graph:
    """A random graph, of random dimension, size, noise, unit, known scales and points."""
    d, n = int(rng.integers(2, 4)), int(rng.integers(4, 10))
    points = int(rng.integers(0, 3)) if n > 5 else 0
    poses = n - points
    known = rng.choice(poses, int(rng.integers(0, 3)), replace=False).tolist()
    turn, scale, move = rng.choice(NOISES, 3)
    m = poses - 1 + int(rng.integers(1, 8))
    graph, _ = random_maps(
        rng, d, n, m, turn=turn, scale=scale, move=move, known=known, points=points
    )
    in_mean_unit = rng.integers(0, 2)
    return graph.with_unknown_scales(~graph.is_point) if in_mean_unit else graph


def lowest(problem: Quadratic, rng: np.random.Generator, count: int) -> float:
    """The lowest cost that descents from random rotations and scales find."""
    best, n = np.inf, problem.n
    for _ in range(count):
        s = np.where(problem.graph.free, np.exp(rng.standard_normal(n)), 1.0)
        start = problem.complete(so.random(rng, n, problem.d), s)
        best = min(best, problem.enclosure(descend(problem, start).estimate)[1])
    return best


def relaxation(problem: Quadratic) -> float:
    """The minimum of the semidefinite relaxation, translations eliminated, by Clarabel."""
    import cvxpy as cp

    M, d = problem.matrix.toarray(), problem.d
    layout = problem.pattern.layout_of(problem.matrix)
    turned = problem.rotation_rows
    T = M[np.ix_(~turned, ~turned)]
    across = M[np.ix_(turned, ~turned)]
    Q = M[np.ix_(turned, turned)] - across @ np.linalg.pinv(T) @ across.T
    G = cp.Variable(Q.shape, PSD=True)
    sizes, constraints, poses = [], [], np.flatnonzero(layout.sizes > 1)
    for k, node in enumerate(poses.tolist()):
        block = G[k * d : (k + 1) * d, k * d : (k + 1) * d]
        sizes.append(block[0, 0] if problem.graph.free[node] else 1.0)
        constraints.append(block == sizes[-1] * np.eye(d))
    if problem.kinds.in_mean_unit:
        constraints.append(sum(sizes) == len(sizes))
    posed = cp.Problem(cp.Minimize(cp.trace(Q @ G)), constraints)
    return float(posed.solve(solver=cp.CLARABEL))


def attack(graphs: int, sdp: int, seed: int, starts: int = STARTS) -> list[str]:
    """What is false among the answers for random graphs, a line each; prints a table."""
    false, counts, ranks = [], Counter(), Counter()
    missed = 0
    for k in range(graphs):
        rng = np.random.default_rng([seed, k])
        graph = sampled(rng)
        problem, answer = Quadratic(graph), certpgo.solve(graph)
        verdict, bound = answer.verdict.value, answer.certificate.lower_bound
        counts[verdict] += 1
        ranks[answer.levels[-1].rank - graph.d] += 1
        found = lowest(problem, rng, starts)
        if found < bound:
            false.append(f"graph {k}: {verdict}, a point costs {found!r} < bound {bound!r}")
        if verdict == "CERTIFIED" and found < answer.cost - answer.certificate.tolerance:
            false.append(f"graph {k}: CERTIFIED at {answer.cost!r}, a point costs {found!r}")
        missed += found < answer.cost * (1.0 - 1e-6)
        if k < sdp:
            least = relaxation(problem)
            off = INTERIOR * max(problem.scale, least)
            if bound > least + off:
                false.append(f"graph {k}: bound {bound!r} above the relaxation's {least!r}")
            if bound < least - 10.0 * off:
                counts["bounds below the relaxation"] += 1
    print(f"{graphs} graphs, {starts} descents each, {min(sdp, graphs)} relaxations by Clarabel")
    for name, count in sorted(counts.items()):
        print(f"{name:30}{count:7}")
    print(f"{'ranks above d at the end':30}{dict(sorted(ranks.items()))}")
    print(f"{'answers that were not the best':30}{missed:7}")
    print(f"{'false':30}{len(false):7}")
    return false


def traded(rng: np.random.Generator, arrays: dict[str, Any], free: np.ndarray) -> dict[str, Any]:
    """A proof whose multipliers are traded: less at one pose, more at another, or more at all."""
    array, d = arrays["multipliers"].copy(), arrays["translations"].shape[1]
    on_diagonal = np.equal(*np.triu_indices(d))
    size = 10.0 ** rng.uniform(-12, 0) * np.abs(array).max(initial=0.0)
    poses = np.flatnonzero(array.any(axis=1))
    if rng.random() < 0.3:
        array[np.ix_(poses, on_diagonal)] += size
    elif len(poses) > 1:
        less = rng.choice(np.flatnonzero(free) if free.any() else poses)
        more = rng.choice(poses)
        array[less, on_diagonal] -= size
        array[more, on_diagonal] += size
    return {**arrays, "multipliers": array}


def changed(rng: np.random.Generator, stored: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """A graph's arrays with a flag, a scale, a weight or a measurement changed."""
    name = str(rng.choice(["free", "scales", "kappa", "tau", "translations", "edges"]))
    array = stored[name].copy()
    k = int(rng.integers(len(array)))
    if name == "free":
        array[k] = not array[k]
    elif name == "edges":
        array[k] = array[k, ::-1]
    else:
        array[k] *= rng.choice([0.5, 1.0 + 1e-6, 3.0])
    return name, {**stored, name: array}


def tried(
    rng: np.random.Generator, path: Path, arrays: dict[str, Any], each: int
) -> Iterator[tuple[str, dict[str, Any]]]:
    """What is changed, and the proof: of arrays, of traded multipliers, and of the graph."""
    with np.load(path) as archive:
        stored = {name: archive[name] for name in archive.files}
    yield "nothing", arrays
    for number in range(each):
        if number % 4 == 3:
            name, other = changed(rng, stored)
            np.savez(path, **other)
            claim = json.loads(bytes(arrays["claim"]))
            claim["graph_sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
            header = np.frombuffer(json.dumps(claim).encode(), np.uint8)
            yield f"graph: {name}", {**arrays, "claim": header}
        elif number % 4 == 2:
            yield "multipliers, traded", traded(rng, arrays, stored["free"])
        else:
            yield damaged(rng, arrays)


def damage(graphs: int, each: int, seed: int) -> list[str]:
    """What is false among the answers of both checkers, a line each; prints a table."""
    said, false, gaps = Counter[tuple[str, str]](), [], []
    with tempfile.TemporaryDirectory() as folder:
        path, proof = Path(folder) / "map.npz", Path(folder) / "map.cert"
        for k in range(graphs):
            rng = np.random.default_rng([seed, k])
            graph = sampled(rng)
            whole = Instance("map", graph, np.arange(graph.num_nodes))
            certpgo.write(path, whole)
            content, answer = path.read_bytes(), certpgo.solve(graph)
            try:
                bounds = write_proof(proof, path, whole, answer.estimate, answer.certificate)
            except CertPGOError:
                said["nothing", "no proof was found"] += 1
                continue
            gaps.append(bounds.relative_gap)
            with np.load(proof) as archive:
                arrays = {name: archive[name].copy() for name in archive.files}
            for what, other in tried(rng, path, arrays, each):
                proof.write_bytes(packed(other))
                least, found = bounds.upper, verdicts(path, proof)
                if what.startswith("graph") and any(found):
                    least = certpgo.solve(path).certificate.cost_upper
                for name, one in zip(("doubles", "integers"), found, strict=True):
                    if one is not None and (one.lower > least or one.upper < one.lower):
                        false.append(f"graph {k}, {name}, {what}: {one}, optimum <= {least!r}")
                path.write_bytes(content)
                how = ("refused", "proven by one", "proven")[sum(one is not None for one in found)]
                said[what, how] += 1
    print(f"{sum(said.values())} proofs of {graphs} graphs, each checked in doubles and integers")
    for (what, how), count in sorted(said.items()):
        print(f"{what:30}{how:24}{count:7}")
    print(f"{'false':54}{len(false):7}")
    low, middle, high = np.quantile(gaps, [0.0, 0.5, 1.0])
    print(f"relative gaps of the {len(gaps)} proofs: {low:.2g} to {high:.2g}, median {middle:.2g}")
    return false


def tightness(graphs: int, seed: int = 0) -> None:
    """Print how many of so many graphs are certified, by noise."""
    for d in (2, 3):
        print(f"\n{d}D: 8 poses, 14 measurements; CERTIFIED of {graphs}, median gap of the others")
        print(f"{'rotations':>12}" + "".join(f"{f'scales {x:g}':>16}" for x in NOISES))
        for turn in NOISES:
            row = []
            for scale in NOISES:
                tight, gaps = 0, []
                for k in range(graphs):
                    rng = np.random.default_rng([seed, d, k])
                    graph, _ = random_maps(rng, d, turn=turn, scale=scale, move=turn)
                    graph = graph.with_unknown_scales(~graph.is_point)
                    found = certpgo.solve(graph).certificate
                    tight += found.verdict == "CERTIFIED"
                    if found.verdict != "CERTIFIED":
                        gaps.append(found.relative_gap)
                row.append(f"{tight}" + (f" ({100 * np.median(gaps):.1f} %)" if gaps else ""))
            print(f"{turn:>12g}" + "".join(f"{cell:>16}" for cell in row), flush=True)


def attack_logarithms(graphs: int, seed: int) -> list[str]:
    """What is false among the bounds on the cost of logarithms, a line each; prints a table."""
    false, tried, gaps = [], 0, []
    for k in range(graphs):
        rng = np.random.default_rng([seed, k])
        d, (turn, scale, move) = int(rng.integers(2, 4)), rng.choice(NOISES[:4], 3)
        graph, _ = random_maps(rng, d, turn=turn, scale=scale, move=move)
        if rng.integers(0, 2):
            graph = graph.with_unknown_scales(np.ones(graph.num_nodes, dtype=bool))
        fit, problem = certpgo.fit_logarithms(graph, time_limit=20.0), LogarithmCost(graph)
        gaps.append(1.0 - fit.lower_bound(1.0) / fit.cost)
        found = [fit.estimate]
        for within in (1.02, 1.2, 2.0):
            there = shaken(rng, fit.estimate, graph, within)
            found += [there, certpgo.fit_logarithms(graph, initial=there, time_limit=20.0).estimate]
        for estimate in found:
            ratio = estimate.scales / fit.estimate.scales
            unit = np.sqrt(np.mean(ratio**2))
            bound = fit.lower_bound(max((ratio / unit).max(), (unit / ratio).max()))
            cost = problem.cost(estimate)
            tried += 1
            if cost < bound:
                false.append(f"graph {k}: a map costs {cost!r} < bound {bound!r}")
    print(f"{graphs} graphs, {tried} maps")
    print(f"{'relative gap, median, 90 %':30}{np.median(gaps):10.2g}{np.quantile(gaps, 0.9):10.2g}")
    print(f"{'false':30}{len(false):7}")
    return false


def shaken(rng: np.random.Generator, estimate: Estimate, graph: Graph, within: float) -> Estimate:
    """A map near another, with scales within a factor of the other's."""
    n, d = estimate.num_nodes, estimate.d
    turn = so.exp(0.3 * rng.standard_normal((n, so.tangent_dim(d))))
    s = np.where(graph.free, within ** rng.uniform(-1.0, 1.0, n), 1.0)
    t = estimate.translations + 0.3 * rng.standard_normal((n, d))
    return Estimate(estimate.rotations @ turn, t, scales=s * estimate.scales)


def main() -> int:
    """Run one of them; exit code 1 if anything is false."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("attack", "damage", "map", "logarithms"))
    parser.add_argument("--graphs", type=int, default=None)
    parser.add_argument("--each", type=int, default=40, help="changes of each proof")
    parser.add_argument("--sdp", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    if asked.what == "map":
        tightness(asked.graphs or 40, asked.seed)
        return 0
    if asked.what == "logarithms":
        false = attack_logarithms(asked.graphs or 300, asked.seed)
    elif asked.what == "damage":
        false = damage(asked.graphs or 50, asked.each, asked.seed)
    else:
        false = attack(asked.graphs or 2000, asked.sdp, asked.seed)
    for line in false:
        print(line)
    return int(bool(false))


if __name__ == "__main__":
    sys.exit(main())

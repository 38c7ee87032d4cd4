"""How long a proof by cycles lives on a stream: ``python -m reports.studies.aging_cycles [SET]``.

The first nodes of a set are proven by `certpgo.certify.cycles.prove`. Then nodes arrive with their
measurements, and the optimal rotations change. Old cycles keep their torques and springs; the lower
bound of docs/concepts/bounds.md says what they prove of the new graph:

- as they are;
- with one more cycle for each new loop closure, without a solver: the shortest way back over older
  measurements, all torque that is left on the closure, and springs in proportion to what edges have
  left, as small as pass.

Bounds are computed in doubles here. Writes reports/results/aging_cycles.md.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.csgraph import breadth_first_order

import certpgo
from certpgo import io
from certpgo.certify.cycles import CycleProof, prove
from certpgo.graph import Estimate, RotationGraph
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.view.markdown_tables import markdown_table
from reports.studies._printing import RESULTS, options

OUT = RESULTS / "aging_cycles.md"
SETS = ("MIT", "intel")
#: Share of the nodes that the proof is of, and rows of the table, at most.
FIRST, ROWS = 0.6, 10
#: What an edge has left at least, relative to its weight, to hold a cycle of its own.
LEAST = 1e-6
HEADER = ("nodes", "new closures", "F", "old cycles", "one more for each closure")


@dataclass(frozen=True, eq=False)
class Left:
    """What cycles leave of the edges of a graph.

    Attributes
    ----------
    torques : (m, 1 or 3) phi_e - sum f_C, the r_e of the bound
    asked : (m,) sum w_eC - c_e, its delta_e
    """

    torques: np.ndarray
    asked: np.ndarray

    @classmethod
    def of(cls, proof: CycleProof, problem: Quadratic, estimate: Estimate) -> "Left":
        """By the cycles of a proof whose edges are the graph's first ones."""
        graph, R, cycles = problem.graph, estimate.rotations, proof.cycles
        i, j = graph.edges.T
        E = R[i] @ graph.rotations @ np.swapaxes(R[j], 1, 2)
        skew = so.vee(0.5 * (E - np.swapaxes(E, 1, 2))).reshape(len(i), -1)
        cosines = 0.5 * (np.trace(E, axis1=1, axis2=2) - (graph.d - 2))
        torques, unit = graph.kappa[:, None] * skew, 2.0**-proof.bits
        springs = unit * np.array([w for each in proof.springs for w in each], dtype=float)
        carried = unit * np.array(proof.torques, dtype=float).reshape(-1, skew.shape[1])
        np.subtract.at(torques, cycles.edges, cycles.signs[:, None] * carried[cycles.owners])
        asked = np.bincount(cycles.edges, springs, len(i)) - graph.kappa * cosines
        return cls(torques, asked)

    def loss(self) -> float:
        """F less the lower bound, by terms without cancellation."""
        squares = (self.torques**2).sum(axis=1)
        root = np.hypot(self.asked, np.sqrt(squares))
        slack = np.where(self.asked < 0.0, root - self.asked, 1.0)
        each = np.where(self.asked < 0.0, squares / slack, self.asked + root)
        return 4.0 * float(each.sum())

    def closed(self, graph: RotationGraph, old: int) -> "Left":
        """With a cycle for each closure behind so many old edges, from the last one on."""
        torques, asked = self.torques.copy(), self.asked.copy()
        for edge in reversed(closures(graph.edges, old)):
            edges, signs = way_back(graph, edge)
            torque = torques[edge].copy()
            spare = np.maximum(-asked[edges], LEAST * graph.kappa[edges])
            asked[edges] += passing(spare, float(np.linalg.norm(torque)))
            torques[edges] -= signs[:, None] * torque
        return Left(torques, asked)


def passing(spare: np.ndarray, torque: float) -> np.ndarray:
    """Springs in proportion to what is spare with which a cycle just passes."""
    if torque == 0.0:
        return np.zeros(len(spare))

    def beyond(log: float) -> float:
        return float(np.arctan2(torque, np.exp(log) * spare).sum() - np.pi)

    # Above the root, so that the cycle passes.
    ends = np.log(torque / spare.max()) - 30.0, np.log(torque / spare.min()) + 30.0
    return np.exp(brentq(beyond, *ends, xtol=1e-12) + 1e-9) * spare


def closures(edges: np.ndarray, old: int) -> list[int]:
    """The edges from an index on that join nodes which earlier ones have."""
    seen = set(edges[:old].ravel().tolist())
    found = []
    for k, (i, j) in enumerate(edges[old:].tolist(), start=old):
        if i in seen and j in seen:
            found.append(k)
        seen |= {i, j}
    return found


def way_back(graph: RotationGraph, edge: int) -> tuple[np.ndarray, np.ndarray]:
    """A cycle of an edge and the fewest earlier ones, in any order: its edges, and their signs."""
    (start, end), before = graph.edges[edge].tolist(), graph.edges[:edge]
    ones = np.ones(edge)
    joined = sparse.csr_array((ones, before.T), shape=(graph.num_nodes, graph.num_nodes))
    _, parents = breadth_first_order(joined, end, directed=False)
    steps = {(j, i): (k, -1) for k, (i, j) in enumerate(before.tolist())}
    steps |= {(i, j): (k, 1) for k, (i, j) in enumerate(before.tolist())}
    walked = [(edge, 1)]
    while start != end:
        parent = int(parents[start])
        walked.append(steps[parent, start])
        start = parent
    edges, signs = np.array([walked[0], *walked[:0:-1]]).T
    return edges, signs


def prefix(graph: RotationGraph, n: int) -> RotationGraph:
    """The first n nodes, measurements in the order in which they arrive."""
    last = graph.edges.max(axis=1)
    order = np.argsort(last, kind="stable")
    order = order[last[order] < n]
    return RotationGraph(n, graph.edges[order], graph.rotations[order], graph.kappa[order])


def optimum(graph: RotationGraph) -> tuple[Quadratic, Estimate]:
    """The optimal rotations, stationary to the last digits."""
    problem = Quadratic(graph)
    best = Estimate(certpgo.solve(graph, cost="chordal").estimate.rotations)
    return problem, newton(problem, best, NewtonSettings(max_iterations=300)).estimate


def turned(estimate: Estimate, like: Estimate) -> Estimate:
    """The estimate in the world of another of its first nodes: torques are vectors there."""
    R, first = estimate.rotations, like.rotations
    turns = first @ np.swapaxes(R[: len(first)], 1, 2)
    return Estimate(so.project(turns.sum(axis=0, keepdims=True)) @ R)


def rows(graph: RotationGraph) -> Iterator[list[str]]:
    """Of each prefix, its closures since the proof, its cost, and both relative losses."""
    n = int(FIRST * graph.num_nodes)
    problem, first = optimum(prefix(graph, n))
    proof, old = prove(problem, first), problem.graph.num_edges
    whole = prefix(graph, graph.num_nodes)
    arrive = whole.edges[closures(whole.edges, old)].max(axis=1)
    which = np.unique(np.linspace(0, len(arrive) - 1, ROWS).astype(int))
    for size in np.unique([n, arrive[0], *(arrive[which] + 1)]):
        problem, here = optimum(prefix(graph, int(size)))
        left = Left.of(proof, problem, turned(here, first))
        closed, cost = left.closed(problem.graph, old), problem.cost(here)
        yield [
            f"{size:,}",
            str(len(closures(problem.graph.edges, old))),
            f"{cost:.9g}",
            *(f"{found.loss() / cost:.1e}" for found in (left, closed)),
        ]


def main() -> None:
    """Follow each set that is here."""
    arguments = options(__doc__, names=SETS, out=OUT)
    parts = [ABOUT]
    for name in arguments.names:
        path = datasets.find(name)
        if path is None:
            raise FileNotFoundError(f"{name}: file not here")
        graph = io.read(path, quiet=True).graph.rotations_alone
        parts += [f"## {name}", "\n".join(markdown_table(HEADER, list(rows(graph))))]
        print(parts[-1], flush=True)
    Path(arguments.out).write_text("\n\n".join(parts) + "\n")


ABOUT = f"""\
# How long a proof by cycles lives

The rotations of the first {100 * FIRST:.0f} % of a set's nodes are proven by cycles. Then nodes
arrive, and these cycles keep their torques and springs. The last columns are gaps, relative to F:
of F and what is proven of the optimum of the grown graph, with the old cycles alone, and with one
more cycle for each new closure, which needs no solver. Bounds are computed in doubles. Made by
`python -m reports.studies.aging_cycles`.

While no loop is closed, nothing is lost. A closure moves torques, and old cycles alone lose at
least what it adds to F. One more cycle for each closure leaves what the closure changes in other
cycles: a bound, no longer a proof to six digits. For that the cone program has to run again."""

if __name__ == "__main__":
    main()

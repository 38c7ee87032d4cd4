"""How anisotropic translational information may be under the costs of g2o and GTSAM.

    python -m reports.studies.conditions [NAME ...]

Every edge gets a translational information with eigenvalues tau (c^(1/2), 1, c^(-1/2)) at random
axes, tau its mean in the file; its rotational information stays as it is. The translations are
those of the file, whose noise that information misjudges, or measured anew from the chordal
optimum, with the noise that it states. Prints a row of Markdown per condition c: the verdict, the
gap, what the minorants miss of f where they are expanded, at the best estimate ("missed": above
zero, they do not touch there; what else is in the gap, the relaxation loses), and the surrogates
that were minimised.
"""

import time

import numpy as np

from certpgo import solve
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph, Instance, PoseGraph
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import COSTS, Sum
from reports.harness.experiments.timing import one_core
from reports.studies._printing import options

NAMES = ("smallGrid3D", "sphere2500")
CONDITIONS = (1.0, 3.0, 10.0, 100.0, 1000.0)
HEADER = "| graph | cost | translations | c | f | verdict | gap / f | missed / f | surrogates | s |"
#: Seconds after which the search of a row ends.
LIMIT = 60.0


def uneven(
    instance: Instance, condition: float, drawn_from: Estimate | None, seed: int = 0
) -> Graph:
    """The graph with that information, and translations of the file or drawn."""
    rng = np.random.default_rng(seed)
    graph = instance.graph
    if not graph.has_positions or graph.information is None or graph.d != 3:
        raise ValueError("poses in space with information matrices are expected")
    information = np.array(graph.information_matrices)
    tau = np.trace(information[:, :3, :3], axis1=1, axis2=2) / 3.0
    spread = condition ** np.array([0.5, 0.0, -0.5])
    axes = so.random(rng, graph.num_edges, 3)
    T = (axes * (tau[:, None, None] * spread)) @ np.swapaxes(axes, 1, 2)
    information[:, :3, :3] = T = 0.5 * (T + np.swapaxes(T, 1, 2))
    information[:, :3, 3:] = information[:, 3:, :3] = 0.0
    translations = graph.translations
    if drawn_from is not None and (t := drawn_from.translations) is not None:
        i, j = graph.edges.T
        R = drawn_from.rotations
        noise = rng.standard_normal((graph.num_edges, 3)) / np.sqrt(tau[:, None] * spread)
        exact = (np.swapaxes(R[i], 1, 2) @ (t[j] - t[i])[:, :, None])[:, :, 0]
        translations = exact + (axes @ noise[:, :, None])[:, :, 0]
    weights = 3.0 / np.trace(np.linalg.inv(T), axis1=1, axis2=2)
    return PoseGraph(graph.rotations_alone, translations, weights).with_information(information)


def row(problem: Sum) -> str:
    """Verdict, gap, and what is missed, for one problem."""
    begin = time.perf_counter()
    found = solve(problem, time_limit=LIMIT)
    seconds = time.perf_counter() - begin
    f, gap = found.cost, found.certificate.relative_gap
    surrogates = (found.solution.note or "").partition("; ")[2].partition(" ")[0]
    try:
        below = problem.surrogate(found.estimate)
        missed = 1.0 - (below.problem.cost(found.estimate) + below.constant) / f
        shown = f"{missed:.1e}"
    except CertPGOError:
        shown = "no minorants"
    return f"{f:.8g} | {found.verdict.value} | {gap:.1e} | {shown} | {surrogates} | {seconds:.1f} |"


def main() -> None:
    """Print the table."""
    names = options(__doc__, names=NAMES).names
    with one_core():
        print(HEADER, "|---" * HEADER[:-1].count("|") + "|", sep="\n", flush=True)
        for name in names:
            instance = datasets.load(name, download=False, quiet=True)
            truth = solve(instance, cost="chordal").estimate
            for cost, kind in ((name, COSTS[name]) for name in ("g2o", "gtsam")):
                for label, origin in (("file's", None), ("drawn", truth)):
                    for c in CONDITIONS:
                        problem = Sum(uneven(instance, c, origin), kind)
                        print(f"| {name} | {cost} | {label} | {c:g} | {row(problem)}", flush=True)


if __name__ == "__main__":
    main()

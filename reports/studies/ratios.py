"""Ratios that are claims of the package but no table.

    python -m reports.studies.ratios [NAME ...]

Measured under the harness' timing protocol, side by side in one process; whole processes in turn
where start-up is the subject. Prints one line each and judges nothing.
"""

import argparse
import functools
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from certpgo.certify import Verdict
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.io import datasets, read, write
from certpgo.linalg import rotations as so
from certpgo.objective import operators
from certpgo.objective.problem import problem_of
from certpgo.optimize import spectral
from reports.harness.experiments.timing import one_core, paired
from reports.harness.scaling import restarts


def random_graph(n: int, m: int, d: int = 3) -> PoseGraph:
    """A chain with random further edges."""
    rng = np.random.default_rng(0)
    i = np.r_[np.arange(n - 1), rng.integers(0, n, m - n + 1)]
    j = np.r_[np.arange(1, n), (i[n - 1 :] + rng.integers(1, n, m - n + 1)) % n]
    rotation = RotationGraph(n, np.c_[i, j], so.random(rng, m, d), np.ones(m))
    return PoseGraph(rotation, rng.standard_normal((m, d)), np.ones(m))


def assembly() -> None:
    """The connection Laplacian at 100,000 edges, against a loop over the edges."""
    graph = random_graph(40_000, 100_000).rotation

    def loop() -> None:
        blocks: dict[tuple[int, int], np.ndarray] = {}
        for (i, j), R, kappa in zip(
            graph.edges.tolist(), graph.rotations, graph.kappa, strict=True
        ):
            for key, block in (
                ((i, i), kappa * np.eye(3)),
                ((j, j), kappa * np.eye(3)),
                ((i, j), -kappa * R),
                ((j, i), -kappa * R.T),
            ):
                blocks[key] = blocks[key] + block if key in blocks else block

    ratio = paired(
        loop, lambda: operators.connection_laplacian(operators.pattern(graph), graph), rounds=3
    )
    print(f"assembly     loop over edges / vectorized           {ratio.ratio:7.1f}")


def reading() -> None:
    """A g2o file of a million edges, against numpy.loadtxt of the same columns."""
    for d, columns in ((3, 30), (2, 11)):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "big.g2o"
            write(path, random_graph(400_000, 1_000_000, d))
            plain = Path(folder) / "edges.txt"
            lines = [s for s in path.read_text().splitlines(True) if s.startswith("EDGE")]
            plain.write_text("".join(lines))
            ratio = paired(
                functools.partial(read, path, quiet=True),
                functools.partial(np.loadtxt, plain, usecols=range(1, columns + 1)),
                rounds=3,
            )
        print(f"reading      g2o {d}D, 1e6 edges / numpy.loadtxt      {ratio.ratio:7.2f}")


def start() -> None:
    """``import certpgo`` against its dependencies, and the seconds of ``certpgo --help``."""

    def process(*arguments: str) -> None:
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)

    ours = "import numpy, scipy.sparse.linalg, certpgo"
    ratio = paired(
        lambda: process("-c", ours),
        lambda: process("-c", "import numpy, scipy.sparse.linalg"),
        rounds=15,
    )
    print(f"start        import certpgo / numpy, scipy.sparse.linalg {ratio.ratio:4.2f}")
    program = "from certpgo.cli import main; main(['--help'])"
    help_ = paired(lambda: process("-c", program), lambda: process("-c", "pass"))
    print(f"start        certpgo --help                        {help_.first:8.2f} s")


def eigensolver() -> None:
    """The block Krylov-Schur method against ARPACK, on one factor and to one tolerance."""
    for name in ("intel", "manhattan", "parking-garage", "sphere2500", "torus3D", "cubicle"):
        if datasets.find(name) is None:
            print(f"eigensolver  {name}: file not here")
            continue
        problem = problem_of(datasets.load(name, download=False, quiet=True).graph).rotation
        ratio = paired(
            functools.partial(spectral.smallest_eigenpairs, problem),
            functools.partial(spectral.smallest_eigenpairs, problem, method="arpack"),
        )
        print(f"eigensolver  {name + ': krylov_schur / arpack':<40} {ratio.ratio:5.2f}")


def restarted() -> None:
    """200 random graphs: how often one of 50 restarts beats an answer that is BOUNDED."""
    graphs = enumerate(restarts.graphs(200, seed=1))
    outcomes = [restarts.attacked(k, graph, 50) for k, graph in graphs]
    bounded = [outcome for outcome in outcomes if outcome.verdict is Verdict.BOUNDED]
    for outcome in bounded:
        if outcome.excess > 1e-6:
            print(f"restarts     graph {outcome.number}: beaten by {outcome.excess:.1e} of F")
    beaten = sum(outcome.excess > 1e-6 for outcome in bounded)
    print(f"restarts     200 graphs, {len(bounded)} BOUNDED, beaten by 50 restarts {beaten:7d}")


BENCHMARKS = {
    "assembly": assembly,
    "eigensolver": eigensolver,
    "reading": reading,
    "restarts": restarted,
    "start": start,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[[], *BENCHMARKS], metavar="NAME")
    with one_core() as how:
        print(how)
        for name in parser.parse_args().names or BENCHMARKS:
            BENCHMARKS[name]()

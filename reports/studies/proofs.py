"""Proofs of the public optima, and what checking them takes: ``python -m reports.studies.proofs``.

Writes reports/results/proofs.md. A checker's time is over one numeric factorization of the
certificate matrix by the preferred engine, in turn and in one process (the timing protocol); its
memory is that of a process of its own.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from certpgo import checker, io, solve
from certpgo.graph import Instance
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets
from certpgo.linalg import factor
from certpgo.solve.proving import write_proof
from reports.harness.experiments.reference import factorization
from reports.harness.experiments.timing import one_core, paired
from reports.studies._printing import RESULTS, options

OUT = RESULTS / "proofs.md"
SETS = (
    "smallGrid3D",
    "sphere2500",
    "torus3D",
    "parking-garage",
    "cubicle",
    "sphere_bignoise_vertex3",
    "MIT",
    "intel",
    "manhattan",
    "kitti_00",
    "kitti_05",
    "city10000",
    "ais2klinik",
    "ring",
    "M3500a",
    "M3500b",
    "M3500c",
    "burghers",
    "stonewall",
    "drone",
)
#: Relative gaps of a prototype, poses and rotations: what a proof should reach.
EXPECTED = {
    "smallGrid3D": (1.4e-12, 2.7e-13),
    "sphere2500": (1.0e-9, 1.3e-11),
    "torus3D": (1.6e-11, 4.6e-12),
    "parking-garage": (1.8e-7, 1.2e-7),
    "cubicle": (1.7e-9, 1.4e-10),
    "sphere_bignoise_vertex3": (9.6e-13, 2.0e-13),
}
HEADER = (
    "data",
    "kind",
    "nodes / edges",
    "F(x) <=",
    "F* >=",
    "gap",
    "expected",
    "prove, s",
    "check, s",
    "factorizations",
    "MB",
    "bytes / node",
)
#: Runs the checker as a program and then says the most memory that the process had.
PROGRAM = """
import runpy, sys
sys.argv = sys.argv[1:]
try:
    runpy.run_path(sys.argv[0], run_name="__main__")
finally:
    lines = open("/proc/self/status").read().splitlines()
    print(next(line.split()[1] for line in lines if line.startswith("VmHWM")), file=sys.stderr)
"""


def row(instance: Instance, path: Path, folder: Path, expected: float | None) -> tuple[str, ...]:
    """A line of the table."""
    graph, proof = instance.graph, folder / "proof.cert"
    answer = solve(graph, cost="chordal")
    start = time.perf_counter()
    said = write_proof(proof, path, instance, answer.estimate, answer.certificate)
    seconds = time.perf_counter() - start
    with one_core():
        times = paired(lambda: checker.check(path, proof), factorization(graph), rounds=3)
    command = [sys.executable, "-c", PROGRAM, checker.__file__, str(path), str(proof)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return (
        "poses" if graph.has_positions else "rotations",
        f"{graph.num_nodes} / {graph.num_edges}",
        f"{said.upper:.15g}",
        f"{said.lower:.15g}",
        f"{said.relative_gap:.1e}",
        "" if expected is None else f"{expected:.1e}",
        f"{seconds:.2f}",
        f"{times.first:.2f}",
        f"{times.ratio:.0f}",
        f"{int(done.stderr.split()[-1]) / 1e3:.0f}",
        f"{proof.stat().st_size / graph.num_nodes:.0f}",
    )


def main() -> None:
    """Prove every set that is here."""
    arguments = options(__doc__, names=SETS, out=OUT)
    lines = [" | ".join(HEADER), " | ".join("---" for _ in HEADER)]
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.names:
            path = datasets.find(name)
            if path is None:
                print(f"{name}: file not here", file=sys.stderr)
                continue
            whole = io.read(path, quiet=True)
            kinds = [whole]
            if whole.graph.has_positions and name in EXPECTED:
                kinds.append(rotations_alone(whole))
            for k, instance in enumerate(kinds):
                expected = EXPECTED[name][k] if name in EXPECTED else None
                line = (name, *row(instance, path, Path(folder), expected))
                lines.append(" | ".join(line))
                print(lines[-1], flush=True)
    said = (
        "# Proofs\n\nProved by `certpgo/checker.py`; made by `python -m reports.studies.proofs`.\n"
        "A factorization is one numeric factorization of the certificate matrix by "
        f"{factor.default_engine()}.\n*Expected*: the relative gap that a prototype reached.\n\n"
    )
    arguments.out.write_text(said + "".join(f"| {line} |\n" for line in lines))


if __name__ == "__main__":
    main()

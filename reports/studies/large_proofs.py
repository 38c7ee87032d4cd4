"""Large graphs from file to proof, and checked: ``python -m reports.studies.large_proofs``.

Solves helices (`certpgo.io.datasets.synthetic.helix`) on the command line, writes their proofs, and
runs the checker alone on them. Both are processes of their own, of one thread. Seconds are of the
processor, but those of the solver alone are by the clock; memory is the most that a process had.
The last of the default sizes, a million poses, takes 13 GB and about half an hour. Writes
reports/results/large_proofs.md.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import certpgo
from certpgo import checker
from certpgo.io.datasets import synthetic
from reports.studies._printing import RESULTS, options

OUT = RESULTS / "large_proofs.md"
TURNS = (100, 200, 316, 1000)
HEADER = (
    "poses / measurements",
    "F(x) <=",
    "gap, standard tier",
    "gap, proven",
    "solve, s",
    "solve, prove and check, s",
    "GB",
    "check, s",
    "GB",
    "proof, MB",
)


def measured(*command: object) -> tuple[str, float, float]:
    """What a command prints, its seconds of the processor, and its memory in GB."""
    one_thread = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen([*map(str, command)], stdout=out, env=one_thread)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        said = out.read().decode()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, process.args)
    return said, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6


def row(turns: int, folder: Path) -> Iterator[str]:
    """A line of the table."""
    graph, proof = folder / "helix.g2o", folder / "helix.cert"
    instance = synthetic.helix(turns, np.random.default_rng(0))
    certpgo.write(graph, instance)
    yield f"{instance.graph.num_nodes:,} / {instance.graph.num_edges:,}"
    solve = ("solve", graph, "--cost", "chordal", "--tier", "standard", "--json", "--proof", proof)
    said, seconds, memory = measured(sys.executable, "-m", "certpgo", *solve)
    result, checking, checked = measured(sys.executable, checker.__file__, graph, proof)
    answer = json.loads(said)
    yield f"{answer['cost']:.12g}"
    yield f"{answer['relative_gap']:.1e}"
    yield result.splitlines()[0].split()[-1]
    yield f"{sum(answer['solution']['seconds'].values()):.1f}"
    yield f"{seconds:.1f}"
    yield f"{memory:.1f}"
    yield f"{checking:.1f}"
    yield f"{checked:.1f}"
    yield f"{proof.stat().st_size / 1e6:.1f}"


def main() -> None:
    """Prove and check helices of some sizes."""
    arguments = options(__doc__, turns=TURNS, out=OUT)
    lines = [" | ".join(HEADER), " | ".join("---" for _ in HEADER)]
    for turns in arguments.turns:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(" | ".join(row(turns, Path(folder))))
        print(lines[-1], flush=True)
    said = (
        "# Proofs of large graphs\n\nHelices, from file to proof and checked by "
        "`certpgo/checker.py`; made by `python -m reports.studies.large_proofs`.\nSeconds are of "
        "the processor, on one thread, but of the solver alone by the clock; a proof is checked "
        "before it is written,\nand once more by the checker alone. Memory is the most that each "
        "program had.\n\n"
    )
    arguments.out.write_text(said + "".join(f"| {line} |\n" for line in lines))


if __name__ == "__main__":
    main()

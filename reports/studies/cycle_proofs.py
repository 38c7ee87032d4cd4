"""What cycles of springs prove of public sets: ``python -m reports.studies.cycle_proofs [SET ..]``.

For each set the optimal rotations of its graph without positions, as `solve` finds them, then
`certpgo.certify.cycles.prove`, the proof as a file, and `certpgo/cycle_checker.py`, a process of
its own. Seconds of the processor, on one thread; the cone program's solver gives up by the clock.
Records are kept in reports/results/cycle_proofs.json, and the page beside it is made from them:
sets that are named are run again, the others keep their records.
"""

import json
import math
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import certpgo
from certpgo import cycle_checker, io
from certpgo.certify.cycle_file import write_cycles
from certpgo.certify.cycles import PATIENCE, prove
from certpgo.graph import Estimate
from certpgo.io import datasets
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.view.markdown_tables import markdown_table
from reports.studies._printing import RESULTS, options
from reports.studies.large_proofs import measured

OUT = RESULTS / "cycle_proofs.json"
SETS = (
    "cycle20_0.5_SO3",
    "tinyGrid3D",
    "smallGrid3D",
    "MIT",
    "intel",
    "kitti_00",
    "manhattan",
    "parking-garage",
    "sphere2500",
    "torus3D",
)
HEADER = (
    "data",
    "nodes / edges",
    "proven",
    "ratio",
    "cycles",
    "F",
    "gap",
    "residual",
    "prove, s",
    "check, s",
    "file, kB",
)
ABOUT = """\
# Proofs by cycles

Rotations of public sets, each in a graph of the set's rotations alone, proven optimal by cycles of
springs; made by `python -m reports.studies.cycle_proofs`. The theorem is in
[Bounds](../concepts/bounds.md#cycles-of-springs).

*ratio*: the share of the stiffness of edges that the best split over the list of cycles asks for;
at most 1 proves. *cycles*: those of the proof. *gap*: of F and the lower bound by exact
arithmetic, relative. *residual*: the largest, degrees. Seconds are of the processor, on one thread.
The solver of the cone program is given at most {seconds:g} seconds by the clock.

"""


def row(name: str, seconds: float) -> dict[str, Any]:
    """What is found of a set."""
    path = datasets.find(name)
    if path is None:
        raise FileNotFoundError(f"{name}: file not here")
    instance = io.read(path, quiet=True)
    problem = Quadratic(instance.graph.rotations_alone)
    best = certpgo.solve(problem.graph, cost="chordal").estimate
    settings = NewtonSettings(max_iterations=300)
    here = newton(problem, Estimate(best.rotations), settings).estimate
    started = time.process_time()
    proof = prove(problem, here, seconds=seconds)
    took = time.process_time() - started
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "proof.cycles"
        answer = write_cycles(file, path, instance, proof)
        size = file.stat().st_size
        said, checking, _ = measured(sys.executable, cycle_checker.__file__, path, file)
    if said.splitlines()[0] != str(answer):
        raise AssertionError(f"{name}: the checker says {said!r}, and said {answer}")
    return {
        "nodes": problem.n,
        "edges": problem.graph.num_edges,
        "proven": proof.proven,
        "reason": proof.reason,
        "solved": "solver says" not in proof.reason,
        "ratio": proof.ratio,
        "cycles": len(proof.cycles),
        "cost": proof.cost,
        "lower_bound": proof.lower_bound,
        "residual": float(problem.residual_angles(here).max()) * 180.0 / math.pi,
        "prove_seconds": took,
        "check_seconds": checking,
        "bytes": size,
        "patience": seconds,
    }


def page(records: Mapping[str, Any]) -> str:
    """The page of all records, in the order of `SETS`."""
    names = [*(name for name in SETS if name in records), *sorted(set(records) - set(SETS))]
    table = markdown_table(HEADER, [cells(name, records[name]) for name in names])
    left = [
        f"- {name}: {of['reason']}; it had {of['patience']:g} seconds."
        for name in names
        if not (of := records[name])["proven"]
    ]
    patience = max(of["patience"] for of in records.values())
    parts = [ABOUT.format(seconds=patience) + "\n".join(table)]
    if left:
        parts += ["Not proven:", "\n".join(left)]
    if missing := [name for name in SETS if name not in records]:
        parts.append(f"Not run: {', '.join(missing)}.")
    return "\n\n".join(parts) + "\n"


def cells(name: str, of: Mapping[str, Any]) -> list[str]:
    """A row of the table."""
    return [
        name,
        f"{of['nodes']:,} / {of['edges']:,}",
        "yes" if of["proven"] else "no",
        f"{of['ratio']:.3g}" if of["solved"] else "-",
        f"{of['cycles']:,}",
        f"{of['cost']:.9g}",
        f"{1.0 - of['lower_bound'] / of['cost']:.1e}",
        f"{of['residual']:.1f}",
        f"{of['prove_seconds']:.1f}",
        f"{of['check_seconds']:.1f}",
        f"{of['bytes'] / 1e3:,.0f}",
    ]


def main() -> None:
    """Run the sets that are named."""
    arguments = options(__doc__, names=SETS, out=OUT, seconds=PATIENCE)
    out = arguments.out
    records: dict[str, Any] = json.loads(out.read_text()) if out.exists() else {}
    for name in arguments.names:
        try:
            records[name] = row(name, arguments.seconds)
        except (certpgo.CertPGOError, FileNotFoundError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        print(" | ".join(cells(name, records[name])), flush=True)
        out.write_text(json.dumps(records, indent=1) + "\n")
        out.with_suffix(".md").write_text(page(records))


if __name__ == "__main__":
    main()

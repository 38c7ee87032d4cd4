"""Proofs of public sets at both levels of trust: ``python -m reports.studies.integer_proofs``.

Proves each optimum of the chordal cost, and some of the cost of g2o, and checks the proof with
`certpgo/checker.py`, which trusts doubles, and with `certpgo/integer_checker.py`, which trusts
Python's integers. Both are processes of their own, of one thread. Writes
reports/results/integer_proofs.md.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import certpgo
from certpgo import checker, integer_checker, io
from certpgo.graph.components import rotations_alone
from certpgo.io import datasets
from certpgo.solve.proving import write_proof
from reports.studies._printing import RESULTS, options
from reports.studies.large_proofs import measured

OUT = RESULTS / "integer_proofs.md"
SETS = (
    "tinyGrid3D",
    "Klaus3",
    "toyExample",
    "smallGrid3D",
    "smallGrid3D rotations",
    "MIT",
    "ring",
    "stonewall",
    "intel",
    "kitti_00",
    "kitti_05",
    "manhattan",
    "M3500a",
    "M3500b",
    "M3500c",
    "burghers",
    "drone",
    "parking-garage",
    "parking-garage rotations",
    "parking-garage_SO3",
    "sphinx_SO3",
    "cycle200_0.5_SO3",
    "cityTrees_reduced_1k",
    "victoriaPark_reduced_1k",
    "cityTrees10000",
    "ais2klinik",
    "sphere2500",
    "sphere2500 rotations",
    "sphere_bignoise_vertex3",
    "torus3D",
    "city10000",
    "cubicle",
    "Ellis_Island",
    "tinyGrid3D g2o",
    "Klaus3 g2o",
    "toyExample g2o",
    "smallGrid3D g2o",
    "MIT g2o",
    "ring g2o",
    "intel g2o",
    "kitti_07 g2o",
    "kitti_00 g2o",
    "kitti_05 g2o",
    "manhattan g2o",
    "M3500a g2o",
    "M3500b g2o",
    "M3500c g2o",
    "parking-garage g2o",
    "cityTrees_reduced_1k g2o",
    "victoriaPark_reduced_1k g2o",
    "inputGrid3D-noOutliers g2o",
    "cityTrees10000 g2o",
    "ais2klinik g2o",
    "sphere2500 g2o",
    "sphere_bignoise_vertex3 g2o",
    "torus3D g2o",
    "city10000 g2o",
)
HEADER = (
    "data",
    "kind",
    "nodes / edges",
    "F(x) <=",
    "F* >=",
    "gap",
    "in doubles",
    "doubles, s",
    "integers, s",
)


def row(said: str, folder: Path) -> Iterator[str]:
    """A line of the table."""
    name, _, what = said.partition(" ")
    path, proof = datasets.find(name), folder / "proof.cert"
    if path is None:
        raise FileNotFoundError(f"{name}: file not here")
    instance = io.read(path, quiet=True)
    instance = rotations_alone(instance) if what == "rotations" else instance
    answer = certpgo.solve(instance, cost="g2o" if what == "g2o" else "chordal")
    write_proof(proof, path, instance, answer.estimate, answer.certificate)
    graph = instance.graph
    yield name
    yield "g2o's cost" if what == "g2o" else "poses" if graph.has_positions else "rotations"
    yield f"{graph.num_nodes} / {graph.num_edges}"
    first, seconds, _ = measured(sys.executable, checker.__file__, path, proof)
    exact, longer, _ = measured(sys.executable, integer_checker.__file__, path, proof)
    theirs, mine = bounds(first), bounds(exact)
    others = [x for x, y in zip(theirs, mine, strict=True) if x != y]
    yield from mine
    yield ", ".join(others) or "the same"
    yield from (f"{seconds:.2f}", f"{longer:.2f}")


def bounds(said: str) -> list[str]:
    """Both bounds and the gap in what a checker prints."""
    return [part.split()[-1] for part in said.splitlines()[0].split(", ")]


def main() -> None:
    """Prove and check every set that is here."""
    arguments = options(__doc__, names=SETS, out=OUT)
    lines = [" | ".join(HEADER), " | ".join("---" for _ in HEADER)]
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.names:
            try:
                lines.append(" | ".join(row(name, Path(folder))))
            except (certpgo.CertPGOError, FileNotFoundError) as error:
                print(f"{name}: {error}", file=sys.stderr)
                continue
            print(lines[-1], flush=True)
    said = (
        "# Proofs in integers\n\nThe same proofs, checked by `certpgo/checker.py` in doubles and "
        "by `certpgo/integer_checker.py` in integers;\nmade by `python -m reports.studies."
        "integer_proofs`. The bounds are those of the integers; *in doubles*: what the other\n"
        "checker prints instead. Seconds are of the processor, on one thread, with Python's start."
        "\n\n"
    )
    arguments.out.write_text(said + "".join(f"| {line} |\n" for line in lines))


if __name__ == "__main__":
    main()

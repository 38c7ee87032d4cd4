"""Every method there is, on graphs small enough for each; a new one is here by being there."""

from certpgo import registry
from certpgo.errors import CertPGOError
from reports.harness.experiments.spec import Column, Method, Row, Table


def _method(name: str) -> Method:
    try:
        solver = registry.get_solver(name)
    except CertPGOError:
        return Method(name)  # its cells say why
    if solver.poses and solver.rotations:
        return Method(name)
    return Method(name, takes="poses" if solver.poses else "rotations")


TABLE = Table(
    name="every_method",
    title="Every method, with its default settings",
    rows=(
        Row(generator="helix", label="helix of 16 poses", arguments={"turns": 4}),
        Row(
            generator="random_graph",
            label="random graph of 12 rotations",
            arguments={"n": 12, "mean_degree": 4.0, "sigma": 0.1},
        ),
        Row(generator="cycle", label="cycle of 8 rotations", arguments={"n": 8, "sigma": 0.1}),
    ),
    methods=tuple(_method(name) for name in registry.solver_names()),
    columns=(
        Column("cost", "F", ".9g"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("verdict", "verdict"),
        Column("status", "ended"),
        Column("iterations", "iterations"),
        Column("total_seconds", "seconds", ".4f"),
    ),
    seed=1,  # on which no step count hangs on the last digit of a BLAS kernel
    quick=("helix of 16 poses", "random graph of 12 rotations"),
    notes=(
        "One instance a row, drawn from the table's seed. A file in certpgo/optimize/methods or "
        "baselines is a method of this table. Seconds are one run's, imports included where a "
        "package is first used.",
    ),
)

"""Moreira 2020, Table D.1: EigenRA and EigenMA on the Burghers sequence."""

from reports.harness.experiments.claims import Claim, number, within
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table

from ._sets import UNIT


def quasi_optimal(records: list[Record]) -> bool | None:
    """Whether EigenRA's cost is within a thousandth of its spectral bound."""
    cost, bound = (number(records, "EigenRA", metric) for metric in ("cost", "own_bound"))
    return None if cost is None or bound is None else cost <= bound * 1.001


CLAIMS = (
    Claim("EigenRA's cost is within 0.1 % of its lower bound", quasi_optimal, "Table D.1 (p. 79)"),
    Claim(
        "The average symmetry validates Hypothesis 4.1.1: it is at least 0.98",
        within("mean_symmetry", "EigenMA", 0.98, 1.0),
        "Table D.1 (p. 79)",
    ),
)

TABLE = Table(
    name="moreira2020_tableD_1",
    title="The Burghers sequence (Moreira 2020, Table D.1)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table D.1",
    rows=(
        Row(
            "burghers",
            "burghers, rotations",
            UNIT,
            rotations=True,
            published="burghers",
            methods=("EigenRA", "certified optimum"),
        ),
        Row(
            "burghers",
            reading=UNIT,
            published="burghers",
            methods=("EigenMA", "certified optimum"),
        ),
    ),
    methods=(
        Method(
            "eigen_ra",
            "EigenRA",
            {"tol": 1e-10},
            published={"own_bound": "eigenra_cost_lower_bound", "cost": "eigenra_minimum_cost"},
        ),
        Method("eigen_ma", "EigenMA", published={"mean_symmetry": "mean_symmetry"}),
        Method("certified", "certified optimum"),
    ),
    columns=(
        Column("cost", "F", ".4e"),
        Column("own_bound", "spectral bound", ".4e"),
        Column("lower_bound", "proven bound", ".4e"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("mean_symmetry", "s", ".2f"),
        Column("verdict", "verdict"),
        Column("total_seconds", "seconds", ".3f"),
    ),
    published="moreira2020_tableD_1",
    notes=(
        "All weights 1, as the file states none. The printed cost and bound are of the rotations: "
        "tr(R L R^T), and n times the sum of the three smallest eigenvalues.",
    ),
    claims=CLAIMS,
    remarks={
        "EigenMA": "tried: cutting digits off, which gives the printed 0.99 of 0.9958; but Table "
        "5.7 rounds its symmetries"
    },
)

"""Moreira 2020, Table D.1: EigenRA and EigenMA on the Burghers sequence."""

from certpgo.harness.spec import Column, Method, Row, Table

UNIT = {"unit_weights": True}

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
)

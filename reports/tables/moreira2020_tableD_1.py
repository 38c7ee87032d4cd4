"""Moreira 2020, Table D.1: EigenRA and EigenMA on the Burghers sequence."""

from certpgo.harness.spec import Column, Method, Row, Table

UNIT = {"unit_weights": True}

TABLE = Table(
    name="moreira2020_tableD_1",
    title="The Burghers sequence (Moreira 2020, Table D.1)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table D.1",
    rows=(
        Row("burghers", reading=UNIT),
        Row("burghers", "burghers, rotations", UNIT, rotations=True),
    ),
    methods=(
        Method("eigen_ra", "EigenRA", {"tol": 1e-10}, takes="rotations"),
        Method("eigen_ma", "EigenMA", {"tol": 1e-10}, takes="poses"),
        Method("certified", "certified optimum"),
    ),
    columns=(
        Column("cost", "F", ".4e"),
        Column("own_bound", "spectral bound", ".4e"),
        Column("lower_bound", "proven bound", ".4e"),
        Column("mean_symmetry", "s", ".2f"),
        Column("total_seconds", "seconds", ".3f"),
    ),
)

"""Certifying rotation averagers: what each says of its answer, and what we say."""

from reports.harness.experiments.spec import Column, Method, Row, Table

from ._sets import rows

TABLE = Table(
    name="certifiers",
    title="Certifying rotation averagers, each answer judged by the same procedure",
    rows=(
        *rows("smallGrid3D", "sphere2500", "parking-garage", rotations=True),
        Row(generator="cycle", label="cycle of 100", arguments={"n": 100, "sigma": 0.05}),
        Row(
            generator="random_graph",
            label="noisy random graph",
            arguments={"n": 60, "mean_degree": 6.0, "sigma": 0.6},
        ),
    ),
    methods=(
        Method("certified"),
        Method("low_rank"),
        Method("gtsam_shonan"),
        Method("gtsam_shonan", "gtsam_shonan (chordal start)", {"start": "chordal"}),
        Method("gtsam_staircase"),
        Method("pymanopt_trust_region"),
    ),
    columns=(
        Column("verdict", "our verdict"),
        Column("cost", "F", ".10g"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("status", "ended"),
        Column("seconds", "seconds (by phase)"),
    ),
    quick=("smallGrid3D", "noisy random graph"),
    notes=(
        "Rotations alone, with the files' kappa. What a method says of its own answer stands above "
        "each table: Shonan accepts any smallest eigenvalue above -1e-4, GTSAM's staircase -1e-3, "
        "whatever the weights.",
        "Seconds are one run's; for ratios see the tables certified_rotations and certified.",
    ),
)

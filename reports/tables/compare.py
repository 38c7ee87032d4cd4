"""Methods side by side on the SLAM sets found here, or else on the gtsam wheel's own files."""

from certpgo.harness.spec import Column, Method, Row, Table

EIGEN_MA = Method("eigen_ma", takes="poses")
EIGEN_RA = Method("eigen_ra", takes="rotations")

TABLE = Table(
    name="compare",
    title="Methods side by side, each answer judged alike",
    rows=(
        Row("smallGrid3D"),
        Row("parking-garage"),
        Row("sphere2500"),
        Row("torus3D"),
        Row("sphere_bignoise_vertex3"),
        Row("cubicle"),
        Row("MIT"),
        Row("intel"),
        Row("manhattan"),
        Row("city10000"),
    ),
    stand_ins=(Row("sphere2500.txt"), Row("w100"), Row("w10000")),
    optional=True,
    methods=(
        Method("certified"),
        Method("spanning_tree"),
        EIGEN_MA,
        Method("eigen_ma", "eigen_ma (unit weights)", {"weights": "unit"}, takes="poses"),
        Method("eigen_q", takes="poses"),
        Method("fixed_point", "eigen_ma + fixed_point", start=EIGEN_MA, takes="poses"),
        Method("newton", "eigen_ma + newton", start=EIGEN_MA, takes="poses"),
        EIGEN_RA,
        Method("laplacian_gauss_newton", takes="rotations"),
        Method("fixed_point", "eigen_ra + fixed_point", start=EIGEN_RA, takes="rotations"),
        Method("newton", "eigen_ra + newton", start=EIGEN_RA, takes="rotations"),
        Method("gtsam_chordal", takes="poses"),
        Method("gtsam_gauss_newton", takes="poses"),
        Method("gtsam_levenberg_marquardt", takes="poses"),
        Method("gtsam_fastsync"),
        Method(
            "gtsam_gauss_newton",
            "gtsam_gauss_newton (file's information)",
            takes="poses",
            reads_source=True,
        ),
    ),
    columns=(
        Column("cost", "F", ".9g"),
        Column("f_ml", "f_ML", ".7g"),
        Column("gap", "gap", ".2e"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("verdict", "verdict"),
        Column("kept_percent", "kept, %", ".1f"),
        Column("seconds", "seconds (by phase)"),
    ),
    quick=("smallGrid3D", "MIT", "w100"),
    notes=(
        "F is the weighted squared error that is minimised, f_ML the thesis' log-likelihood with "
        "unit weights. The gap is proven: no answer of the graph can have an F smaller than "
        "this one's by more. Where a method rejects measurements, and the column says what share "
        "it kept, verdict and gap are of those alone, F and f_ML of all. CERTIFIED: the gap is at "
        "most 1e-5 F. BOUNDED: it is larger. REFUTED: a better answer is known that improving "
        "this one step by step does not reach.",
        "GTSAM minimises F to first order, but in its last row: there it reads the file itself and "
        "minimises its own error with the file's full information matrices.",
        "Seconds are one run's, reading and judging excluded; for ratios see the table speed.",
    ),
)

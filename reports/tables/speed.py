"""EigenMA against GTSAM's chordal initialization, under the timing protocol, with both engines."""

from reports.harness.experiments.spec import Column, Method, Row, Table

TABLE = Table(
    name="speed",
    title="EigenMA against GTSAM's chordal initialization",
    rows=(
        Row("smallGrid3D"),
        Row("parking-garage"),
        Row("sphere2500"),
        Row("torus3D"),
        Row("sphere_bignoise_vertex3"),
        Row("cubicle"),
        Row("intel"),
        Row("manhattan"),
        Row("city10000"),
    ),
    stand_ins=(Row("sphere2500.txt"), Row("w100"), Row("w10000")),
    optional=True,
    methods=(
        Method("eigen_ma", "eigen_ma (SuperLU)", engine="superlu"),
        Method("eigen_ma", "eigen_ma (multifrontal)", engine="multifrontal"),
    ),
    reference=Method("gtsam_chordal"),
    columns=(
        Column("median_seconds", "seconds", ".4f"),
        Column("reference_seconds", "GTSAM chordal, seconds", ".4f"),
        Column("ratio", "ratio to chordal", ".3f"),
    ),
    certify=False,
    quick=("smallGrid3D", "intel", "w100"),
    notes=(
        "One core, one thread; graphs in memory and GTSAM's own graph object built beforehand; "
        "assembly and symbolic analysis counted for eigen_ma. One warm-up of each, then seven "
        "rounds in turn; the ratio is the median of the rounds' ratios. GTSAM has no chordal "
        "initialization in 2D: LAGO stands in for it.",
    ),
)

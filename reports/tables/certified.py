"""Certified optima of pose graphs against GTSAM: chordal initialization, then Gauss-Newton."""

from reports.harness.experiments.spec import Column, Method, Table

from ._sets import SPACE, rows

TABLE = Table(
    name="certified",
    title="Certified optima of pose graphs against GTSAM's chordal initialization and Gauss-Newton",
    rows=rows(*SPACE, "manhattan", "intel"),
    stand_ins=rows("sphere2500.txt"),
    optional=True,
    methods=(Method("certified"),),
    reference=Method("gtsam_gauss_newton", start=Method("gtsam_chordal")),
    columns=(
        Column("verdict", "verdict"),
        Column("cost", "F", ".10g"),
        Column("relative_gap", "relative gap", ".1e"),
        Column("median_seconds", "seconds", ".3f"),
        Column("reference_seconds", "GTSAM, seconds", ".3f"),
        Column("ratio", "ratio to GTSAM", ".3f"),
        Column("iterations", "iterations"),
        Column("counts", "work"),
    ),
    quick=("parking-garage",),
    notes=(
        "One core, one thread; from the graph in memory to the certified estimate, the standard "
        "certificate included, against GTSAM's two steps on its graph object built beforehand, "
        "which certify nothing. One warm-up of each, then seven rounds in turn; the ratio is the "
        "median of the rounds' ratios. GTSAM has no chordal initialization in 2D: LAGO stands in "
        "for it.",
    ),
)

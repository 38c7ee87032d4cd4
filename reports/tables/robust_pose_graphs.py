"""Robust pose graphs: wrong loop closures found, and what is kept certified."""

from reports.harness.experiments.spec import Column, Method, Row, Table

TABLE = Table(
    name="robust_pose_graphs",
    title="Pose graphs with wrong loop closures",
    rows=tuple(Row(f"grid1000_{share}p_outliers") for share in (10, 30, 50)),
    methods=(
        Method("graduated_non_convexity", "graduated non-convexity"),
        Method(
            "graduated_non_convexity",
            "graduated non-convexity, from the certified optimum",
            start=Method("certified", "certified optimum of all"),
        ),
        Method("eig_se3", "EIG-SE(3)"),
        Method("irls_eig_se3", "IRLS EIG-SE(3)"),
        Method("certified", "certified optimum, not robust"),
    ),
    columns=(
        Column("precision", "precision", ".3f"),
        Column("recall", "recall", ".3f"),
        Column("kept_percent", "kept, %", ".1f"),
        Column("cost", "F", ".5g"),
        Column("verdict", "verdict"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("total_seconds", "seconds", ".2f"),
    ),
    quick=("grid1000_10p_outliers",),
    notes=(
        "Precision: of the rejected measurements, the share that the labels call wrong; recall: "
        "of the wrong ones, the share rejected. F, verdicts and gaps of graduated non-convexity "
        "are of the measurements it kept, the others' of all. Iterations start from the tree of "
        "the earliest measurements, the odometry, unless said otherwise.",
    ),
)

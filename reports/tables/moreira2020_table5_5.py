"""Moreira 2020, Table 5.5: EigenMA beside EIG-SE(3) on a path over a sphere."""

from certpgo.harness.spec import Column, Method, Row, Table

MISSING = (80, 85, 90, 95, 99)
SIGMAS = (1.0, 2.0, 5.0)

TABLE = Table(
    name="moreira2020_table5_5",
    title="Ground-truth error of closed forms (Moreira 2020, Table 5.5)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table 5.5",
    rows=tuple(
        Row(
            generator="spherical_path",
            label=f"{missing} % missing, sigma_R {sigma:g} deg",
            arguments={"missing": missing / 100.0, "sigma_deg": sigma, "sigma_t": 0.01},
            published=f"{missing}/{sigma}",
        )
        for missing in MISSING
        for sigma in SIGMAS
    ),
    methods=(
        Method(
            "eigen_ma",
            "EigenMA",
            {"translations": "thesis"},
            published={"f_gt": "eigenma_f_gt"},
        ),
        Method("eigen_ma", "EigenMA (translations minimise F)"),
        Method("eig_se3", "EIG-SE(3)", published={"f_gt": "eig_se3_f_gt"}),
    ),
    columns=(
        Column("f_gt", "f_GT", ".3e"),
        Column("rmse_deg", "RMSE, deg", ".3f"),
        Column("total_seconds", "seconds", ".2f"),
    ),
    published="moreira2020_table5_5",
    key="missing_percent,sigma_R_deg",
    comparable=False,
    summary="mean",
    certify=False,
    seeds=10,
    quick=("99 % missing, sigma_R 1 deg",),
    notes=(
        "Means over the seeds, 1000 poses on a sphere of radius 100, sigma_t 0.01. The thesis "
        "shows the path without defining it, and f_GT grows with the squared distance of poses "
        "from the origin, so that only the order of the methods can be compared. Here f_GT is what "
        "the rotation and shift of the world that make it least leave.",
    ),
)

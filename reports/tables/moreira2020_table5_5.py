"""Moreira 2020, Table 5.5: EigenMA beside EIG-SE(3) on a path over a sphere."""

from reports.harness.experiments.claims import Claim, below
from reports.harness.experiments.spec import Column, Method, Row, Table

MISSING = (80, 85, 90, 95, 99)
SIGMAS = (1.0, 2.0, 5.0)

TRIED = (
    "tried: a path around the origin, with the equation's noise; one from the origin, with sigma_R "
    "per axis, aligned as well as can be or by its first camera; the thesis shows the path without "
    "defining it, and f_GT grows with the squared distance of poses from the origin"
)
#: The arguments of the second reading, and what its rows are called.
FROM_ORIGIN, READ_SO = {"from_origin": True, "per_axis": True}, ", from the origin, per axis"


def label(missing: int, sigma: float, suffix: str = "") -> str:
    """What the row is called."""
    return f"{missing} % missing, sigma_R {sigma:g} deg{suffix}"


def row(missing: int, sigma: float, suffix: str, **reading: bool) -> Row:
    """A row of a reading of the path and its noise."""
    return Row(
        generator="spherical_path",
        label=label(missing, sigma, suffix),
        arguments={"missing": missing / 100.0, "sigma_deg": sigma, "sigma_t": 0.01, **reading},
        published=f"{missing}/{sigma}",
        comparable=bool(reading),
        methods=("EigenMA", "EIG-SE(3)") if reading else (),
    )


WHERE = "section 5.4.1, Table 5.5 (p. 53)"
CLAIMS = (
    Claim(
        "EigenMA's average error f_GT is smaller than EIG-SE(3)'s in every scenario",
        below("f_gt", "EigenMA", "EIG-SE(3)"),
        WHERE,
        each=True,
    ),
    Claim(
        "At 99 % missing EIG-SE(3) degenerates entirely: its f_GT is at least 5 times EigenMA's",
        below("f_gt", "EigenMA", "EIG-SE(3)", 0.2),
        WHERE,
        each=True,
        rows=tuple(label(99, sigma) for sigma in SIGMAS),
        remark="With eigenvectors that have converged it does not degenerate; the thesis' may not "
        "have, as those of its Table 5.7",
    ),
)

TABLE = Table(
    name="moreira2020_table5_5",
    title="Ground-truth error of closed forms (Moreira 2020, Table 5.5)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table 5.5",
    rows=tuple(
        row(missing, sigma, suffix, **reading)
        for suffix, reading in (("", {}), (READ_SO, FROM_ORIGIN))
        for missing in MISSING
        for sigma in SIGMAS
    ),
    methods=(
        Method(
            "eigen_ma",
            "EigenMA",
            {"translations": "thesis"},
            published={"f_gt": "eigenma_f_gt", "f_gt_anchored": "eigenma_f_gt"},
        ),
        Method("eigen_ma", "EigenMA (translations minimise F)"),
        Method(
            "eig_se3",
            "EIG-SE(3)",
            published={"f_gt": "eig_se3_f_gt", "f_gt_anchored": "eig_se3_f_gt"},
        ),
    ),
    columns=(
        Column("f_gt", "f_GT", ".3e", exact=True),
        Column("rmse_deg", "RMSE, deg", ".3f"),
        Column("total_seconds", "seconds", ".2f"),
    ),
    published="moreira2020_table5_5",
    key="missing_percent,sigma_R_deg",
    others=("eig_se3_f_gt",),
    summary="mean",
    certify=False,
    seeds=10,
    quick=("99 % missing, sigma_R 1 deg",),
    notes=(
        "Means over the seeds, 1000 poses on a sphere of radius 100, sigma_t 0.01. The thesis "
        "shows the path without defining it, and f_GT grows with the squared distance of poses "
        "from the origin. Here f_GT is what the rotation and shift of the world that make it least "
        "leave. In the first reading the sphere is around the origin, and only the order of the "
        "methods is compared. In the second the path begins at the origin and sigma_R is the "
        "deviation per axis; the printed values are compared with this f_GT, and with that of "
        "estimates whose first camera is moved onto the true one (f_gt_anchored).",
    ),
    claims=CLAIMS,
    remarks=dict.fromkeys(("EigenMA", "EIG-SE(3)"), TRIED),
)

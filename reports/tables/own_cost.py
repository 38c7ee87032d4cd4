"""Optima under the costs that g2o and GTSAM minimise, with the files' full information."""

from certpgo.objective.choose_cost import CHORDAL
from reports.harness.experiments.spec import Cause, Column, Method, Row, Table

#: Of which a prototype's values are known.
KNOWN = (
    "intel",
    "MIT",
    "kitti_00",
    "kitti_05",
    "manhattan",
    "ais2klinik",
    "M3500a",
    "M3500b",
    "M3500c",
    "city10000",
    "smallGrid3D",
    "sphere2500",
    "torus3D",
    "parking-garage",
    "sphere_bignoise_vertex3",
)
OTHERS = (
    "ring",
    "cityTrees10000",
    "inputGrid3D-noOutliers",
    "Klaus3",
    "tinyGrid3D",
    "toyExample",
    "pose2example",
    "w100",
    "w10000",
    "pose3example",
    "pose3example-grid",
)
#: Whose files GTSAM cannot read.
UNREAD = ("w100", "w10000")
#: Whose landmarks are left out, which GTSAM reads as bearings and ranges.
WITH_LANDMARKS = ("cityTrees10000",)
POSES_ALONE = {"landmarks": False}
#: Some information matrices are not positive definite.
REFUSED = ("cubicle",)

OF_F = Method("certified", "optimum of F")
OF_G2O = Method("certified", "optimum of g2o's cost", cost="g2o", published={"cost": "g2o"})
OF_GTSAM = Method("certified", "optimum of GTSAM's cost", cost="gtsam", published={"cost": "gtsam"})


def _gtsam(label: str, start: Method | None = None) -> Method:
    return Method("gtsam_levenberg_marquardt", label, start=start, reads_source=True)


OF_GTSAM_ITSELF = (
    _gtsam("GTSAM, from its chordal initialization"),
    _gtsam("GTSAM, from odometry", Method("spanning_tree", "odometry")),
    _gtsam("GTSAM, from our optimum", OF_GTSAM),
)


def _optimizer(solver: str, label: str, start: Method | None = None) -> Method:
    return Method(solver, label, start=start, cost="g2o")


OF_OPTIMIZERS = (
    _optimizer("g2o_gauss_newton", "g2o's Gauss-Newton"),
    _optimizer("g2o_gauss_newton", "g2o's Gauss-Newton, from our optimum", OF_G2O),
    _optimizer("g2o_levenberg_marquardt", "g2o's Levenberg-Marquardt"),
    _optimizer("ceres_levenberg_marquardt", "Ceres' Levenberg-Marquardt"),
)

#: Costs that estimates are judged by: what rows call them, and the methods compared.
JUDGES = {
    "g2o": ("g2o's cost", (OF_G2O, *OF_OPTIMIZERS, OF_F)),
    "gtsam": ("GTSAM's cost", (OF_GTSAM, *OF_GTSAM_ITSELF, OF_F)),
    CHORDAL: ("F", (OF_F, OF_G2O, OF_GTSAM)),
}


def _rows(dataset: str) -> list[Row]:
    costs = [cost for cost in JUDGES if cost != CHORDAL or dataset not in REFUSED]
    return [
        Row(
            dataset,
            f"{dataset}, {JUDGES[cost][0]}",
            methods=tuple(
                method.label
                for method in JUDGES[cost][1]
                if method not in OF_GTSAM_ITSELF or dataset not in UNREAD
            ),
            reading=POSES_ALONE if dataset in WITH_LANDMARKS else {},
            published=dataset if dataset in KNOWN and cost != CHORDAL else "",
            cost=cost,
        )
        for cost in costs
    ]


TABLE = Table(
    name="own_cost",
    title="Optima under g2o's and GTSAM's costs, with the files' full information",
    source="a prototype of these certificates, from GTSAM's own optima under its cost",
    rows=tuple(row for dataset in (*KNOWN, *OTHERS, *REFUSED) for row in _rows(dataset)),
    methods=(OF_G2O, OF_GTSAM, *OF_GTSAM_ITSELF, *OF_OPTIMIZERS, OF_F),
    columns=(
        Column("verdict", "verdict"),
        Column("cost", "cost", ".10g", exact=True),
        Column("relative_gap", "gap / cost", ".1e"),
        Column("over_bound", "cost / bound", ".5g"),
        Column("own_bound", "bound of the search", ".10g"),
        Column("status", "ended"),
        Column("total_seconds", "seconds", ".2f"),
    ),
    published="own_cost_prototype",
    paper=False,
    quick=tuple(
        row.label for name in ("smallGrid3D", "MIT", "pose2example") for row in _rows(name)
    ),
    notes=(
        "All estimates of a section are judged by the cost that it names: g2o's chi2 of EdgeSE2 or "
        "EdgeSE3:QUAT, twice GTSAM's error of BetweenFactorPose2 or BetweenFactorPose3, or F, in "
        "which kappa and tau stand for each information matrix. The proven bound is on that cost, "
        "so that an estimate that is optimal under one cost is BOUNDED or REFUTED under another. "
        "Cost over bound is at least the cost over that of the optimum; where the optimum is "
        "certified, both are the same but for the tolerance. A verdict is that of `certify` on the "
        "estimate alone; where the relaxation is not tight, the search that found an optimum may "
        "have proven more about the cost that it minimised: the bound of the search.",
        "GTSAM runs Levenberg-Marquardt with its default settings on the factors that it reads "
        "from the file (those of w100 and w10000 it cannot read); in the plane LAGO stands in for "
        "its chordal initialization. g2o and Ceres begin there, too, and run with their default "
        "settings on our graph with full information; Ceres' residuals are computed in Python. "
        "Seconds are one run's, without judging the answer; those of our optima include their "
        "certificate.",
        "All sets of the catalogue that have information matrices, but for those that have wrong "
        "measurements (see robust_pose_graphs).",
    ),
    explained={
        "ais2klinik, GTSAM's cost": Cause(
            "ours is lower, 172.8129400, and certified: the prototype's estimate was GTSAM's, "
            "which stops short of the optimum here",
            "own_cost",
        ),
    },
)

"""Moreira 2020, Table 5.7: times of closed forms over that of the chordal relaxation."""

from reports.harness.experiments.claims import Claim, below, within
from reports.harness.experiments.spec import Column, Method, Row, Table

from ._sets import SLAM

#: As the thesis calls them.
PRINTED = ("Garage", "Grid3D", "Cubicle", "Sphere", "Torus3D", "Rim")


WHERE = "section 5.4.2, Table 5.7 (p. 54)"
CLAIMS = (
    Claim(
        "The chordal relaxation lags behind EigenMA by a considerable amount: EigenMA takes at "
        "most half its time",
        within("ratio", "EigenMA", 0.0, 0.5),
        WHERE,
        each=True,
    ),
    Claim(
        "EIG-SE(3) is slower than EigenMA",
        below("ratio", "EigenMA", "EIG-SE(3)"),
        WHERE,
        each=True,
    ),
)

TABLE = Table(
    name="moreira2020_table5_7_ratios",
    title="Times of closed forms over the chordal relaxation's (Moreira 2020, Table 5.7)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table 5.7",
    rows=tuple(
        Row(name, reading=reading, published=printed)
        for (name, reading), printed in zip(SLAM.items(), PRINTED, strict=True)
    ),
    methods=(
        Method("eigen_ma", "EigenMA", published={"ratio": "eigenma_ratio"}),
        Method("eig_se3", "EIG-SE(3)", published={"ratio": "eig_se3_ratio"}),
        Method("eigen_ma", "chordal (ours)", {"anchor": "chordal"}),
    ),
    reference=Method("gtsam_chordal"),
    columns=(
        Column("median_seconds", "seconds", ".4f"),
        Column("reference_seconds", "GTSAM chordal, seconds", ".4f"),
        Column("ratio", "ratio to chordal", ".3f"),
    ),
    published="moreira2020_table5_7_ratios",
    comparable=False,
    certify=False,
    quick=("parking-garage",),
    notes=(
        "One core, one thread; one warm-up of each, then seven rounds in turn; the ratio is the "
        "median of the rounds' ratios. The printed ratios are of the thesis' C++ and MATLAB "
        "programs, whose chordal relaxation is its own; GTSAM's stands in for it here.",
    ),
    claims=CLAIMS,
)

"""Moreira 2020, Table 5.7: log-likelihood of EigenMA beside chordal and Gauss-Newton."""

from reports.harness.experiments.claims import Claim, below, number, together
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table

from ._sets import SIMPLE, UNIT

EIGEN_MA = Method(
    "eigen_ma",
    "EigenMA",
    # Anchoring the first camera (Appendix B.6) gives the printed digits of the sphere, where noise
    # is large, and changes none of the others'; the printed digits ask for the tolerance.
    {"translations": "thesis", "anchor": "first", "tol": 1e-10},
    published={"f_ml": "eigenma_f_ml", "mean_symmetry": "eigenma_mean_symmetry"},
)

CHORDAL, EIG_SE3 = "chordal relaxation (anchored)", "EIG-SE(3)"
GAUSS_NEWTON = "Gauss-Newton from EigenMA (GTSAM)"
SPHERE = "sphere_bignoise_vertex3"
#: An increase of f_ML that is not "significant", relative.
SLIGHT = 1e-3


def quasi_optimal(records: list[Record]) -> bool | None:
    """Whether Gauss-Newton increases EigenMA's likelihood but slightly."""
    start, end = (number(records, name, "f_ml") for name in ("EigenMA", GAUSS_NEWTON))
    return None if start is None or end is None else end - start <= SLIGHT * abs(end)


def far_from_optimal(records: list[Record]) -> bool | None:
    """Whether Gauss-Newton increases EigenMA's likelihood by more."""
    told = quasi_optimal(records)
    return None if told is None else not told


WHERE = "section 5.4.2, Table 5.7 (p. 54)"
CLAIMS = (
    Claim(
        "On Garage, Grid3D and Cubicle Gauss-Newton does not increase EigenMA's f_ML by a "
        "significant amount (0.1 %)",
        quasi_optimal,
        WHERE,
        each=True,
        rows=("parking-garage", "grid3D", "cubicle"),
    ),
    Claim(
        "The only data sets of considerable difference to the local maximum are Sphere and Rim: "
        "Torus3D has none",
        quasi_optimal,
        WHERE,
        each=True,
        rows=("torus3D",),
    ),
    Claim(
        "On Sphere and Rim the difference is considerable",
        far_from_optimal,
        WHERE,
        each=True,
        rows=(SPHERE, "rim"),
    ),
    Claim(
        "On Sphere and Rim EigenMA attains the highest objective of the three suboptimal methods",
        together(below("f_ml", CHORDAL, "EigenMA"), below("f_ml", EIG_SE3, "EigenMA")),
        WHERE,
        each=True,
        rows=(SPHERE, "rim"),
    ),
    Claim(
        "EigenMA attains a higher objective than the chordal relaxation on Cubicle, Sphere, "
        "Torus3D and Rim",
        below("f_ml", CHORDAL, "EigenMA"),
        "Table 5.7 (p. 54)",
        each=True,
        rows=("cubicle", SPHERE, "torus3D", "rim"),
        remark="on cubicle ours are 50599.0, as printed, and 50599.4, where 50596.4 is printed",
    ),
    Claim(
        "Except for Garage, EIG-SE(3) produces poorer results than EigenMA",
        below("f_ml", EIG_SE3, "EigenMA"),
        WHERE,
        each=True,
        rows=("grid3D", "cubicle", SPHERE, "torus3D", "rim"),
    ),
    Claim(
        "EigenMA is faster than Gauss-Newton, GTSAM's standing in for g2o",
        below("total_seconds", "EigenMA", GAUSS_NEWTON),
        "section 5.4.2 (p. 55)",
        each=True,
    ),
)
OTHER_PROGRAM = "the thesis' {} is another implementation, {}"

TABLE = Table(
    name="moreira2020_table5_7",
    title="Log-likelihood of closed-form estimates (Moreira 2020, Table 5.7)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Table 5.7",
    rows=(
        Row("parking-garage", reading=UNIT, published="Garage"),
        Row("grid3D", reading=UNIT, published="Grid3D"),
        Row("cubicle", reading=SIMPLE, judging=UNIT, published="Cubicle"),
        Row(SPHERE, reading=UNIT, published="Sphere"),
        Row("torus3D", reading=UNIT, published="Torus3D"),
        Row("rim", reading=SIMPLE, judging=UNIT, published="Rim"),
    ),
    methods=(
        EIGEN_MA,
        Method("eigen_ma", "EigenMA (translations minimise F)"),
        Method("eigen_ma", CHORDAL, {"anchor": "chordal"}, published={"f_ml": "chordal_f_ml"}),
        Method("gtsam_chordal", "chordal (GTSAM)"),
        Method("eig_se3", EIG_SE3, published={"f_ml": "eig_se3_f_ml"}),
        Method("eig_se3", "EIG-SE(3) (singular vectors)", {"vectors": "singular"}),
        Method(
            "gtsam_gauss_newton",
            GAUSS_NEWTON,
            start=EIGEN_MA,
            published={"f_ml": "gauss_newton_f_ml"},
        ),
    ),
    columns=(
        Column("f_ml", "f_ML", ".1f"),
        Column("mean_symmetry", "s", ".2f"),
        Column("cost", "F", ".7g"),
        Column("lower_bound", "proven bound", ".7g"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("verdict", "verdict"),
        Column("seconds", "seconds (by phase)"),
    ),
    published="moreira2020_table5_7",
    others=("chordal_f_ml", "eig_se3_f_ml", "gauss_newton_f_ml"),
    quick=("parking-garage",),
    notes=(
        "f_ML weighs every edge 1. EigenMA's translations are the thesis' own (eq. 4.12, which "
        "counts each edge in both directions), and its rotations are projected after anchoring the "
        "first camera (Appendix B.6). On sphere_bignoise_vertex3 that matters: without it f_ML is "
        "17346.9; on the other sets no printed digit changes. The second row does neither: it "
        "minimises F for the rotations found. cubicle: estimated from the last of parallel edges, "
        "evaluated on all.",
        "F, of the measurements that were read, weighs every edge 1 too; bounds are proven by the "
        "standard tier. Few closed forms are optimal to its tolerance of 1e-5.",
        "The chordal relaxation holds the first camera and solves a linear system (Appendix B.6), "
        "with translations that minimise F; GTSAM's is next to it. On sphere_bignoise_vertex3 its "
        "answer depends on which camera is held: f_ML is 13324.7, 12964.5, 15404.1 and 17725.7 "
        "with nodes 0, 1, 1100 and 2199. The thesis' Gauss-Newton is "
        "g2o with at most 10 iterations, so that its numbers need not agree with GTSAM's.",
        "EIG-SE(3) takes the leading eigenvectors of the block matrix with identities on its "
        "diagonal, normalized by degrees, which gives the printed digits of "
        "sphere_bignoise_vertex3: there noise has pushed the rotations' eigenvalues below those "
        "of the graph Laplacian, whose eigenvectors are taken for rotations. On the other graphs "
        "the eigenvalues lie within 1e-3 of 1 and ours have converged; the published numbers "
        "differ, and could be those of eigenvectors that have not: after 300 restarts of Arnoldi's "
        "method four random starts gave an f_ML of -293049 to 18308.7 on parking-garage and of "
        "50344.7 to 50591.6 on cubicle, and on torus3D three gave 26985.1 to 26995.4 after 80. The "
        "other row takes right singular vectors, as thesis eq. 2.20 says.",
    ),
    claims=CLAIMS,
    remarks={
        "cubicle/chordal relaxation (anchored)": "ours is 50599.4 and 50596.4 printed; holding "
        "another camera, or keeping the first or all of parallel edges, gives 50599.3 to 50600.3",
        f"{SPHERE}/chordal relaxation (anchored)": "the answer depends on which camera is held, "
        "12964.5 to 17725.7 for four of them: ours holds the first",
        GAUSS_NEWTON: OTHER_PROGRAM.format("Gauss-Newton", "g2o with at most 10 iterations"),
        EIG_SE3: "tried: eigenvectors that have not converged, see the notes; the printed number "
        "lies in their range on parking-garage and torus3D, not on cubicle",
        "torus3D/EigenMA": "tried: every method here, of which all have a mean symmetry of 0.935; "
        "EigenMA's f_ML agrees to every printed digit",
    },
)

"""Eriksson et al. 2018, Table 1: cycles of cameras, local search against the convex relaxation."""

from reports.harness.experiments.claims import Claim, below, together, within
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table

SIZES, NOISES = (20, 50, 100, 200), (0.2, 0.5)

LM = "Levenberg-Marquardt, a random start"
ALGORITHM_1 = "Algorithm 1"
INTERIOR = "interior points on (D), Clarabel"
STAIRCASE = "staircase (certified)"
WHERE = "section 6, synthetic data"


def short_residuals(records: list[Record]) -> bool | None:
    """Whether the bound of Theorem 4.2 holds for the optimum of every instance."""
    bounds = [r.certified_by for r in records if r.method == STAIRCASE and r.certified_by]
    return all("Theorem 4.2" in by.split(", ") for by in bounds) if bounds else None


def has_no_gap(records: list[Record]) -> bool | None:
    """Whether every instance's optimum is certified by the dual."""
    verdicts = [r.verdict for r in records if r.method == STAIRCASE and r.verdict]
    return all(verdict == "CERTIFIED" for verdict in verdicts) if verdicts else None


CLAIMS = (
    Claim(
        "The LM algorithm significantly outperforms Algorithm 1 and interior points in time",
        together(below("total_seconds", LM, ALGORITHM_1), below("total_seconds", LM, INTERIOR)),
        WHERE,
        each=True,
    ),
    Claim(
        "LM only obtains the global optimum about 30 to 70 % of the time",
        within("global_percent", LM, 30.0, 70.0),
        WHERE,
        each=True,
    ),
    Claim(
        "Algorithm 1 finds the global optimum of every single instance, independent of the noise "
        "and of the number of cameras",
        within("global_percent", ALGORITHM_1, 100.0, 100.0),
        WHERE,
        each=True,
    ),
    Claim(
        "Interior points find the global optimum of every single instance",
        within("global_percent", INTERIOR, 100.0, 100.0),
        WHERE,
        each=True,
    ),
    Claim(
        "Algorithm 1 outperforms interior points quite significantly: at least twice as fast",
        below("total_seconds", ALGORITHM_1, INTERIOR, 0.5),
        WHERE,
        each=True,
    ),
    Claim(
        "Theorem 4.2: the global optimum of a cycle has residuals of at most pi / n",
        short_residuals,
        "section 4.1",
        each=True,
    ),
    Claim(
        "The relaxation of a cycle has no gap, whatever the noise",
        has_no_gap,
        "section 4.1",
        each=True,
    ),
)

TABLE = Table(
    name="eriksson2018_table1",
    title="Running times and errors on cycles (Eriksson et al. 2018, Table 1)",
    source="A. Eriksson, C. Olsson, F. Kahl, T.-J. Chin, Rotation Averaging and Strong Duality, "
    "CVPR 2018, Table 1",
    rows=tuple(
        Row(
            generator="orbital",
            label=f"cycle of {n}, sigma {sigma} rad",
            arguments={"n": n, "sigma": sigma},
            published=f"{n}/{sigma}",
        )
        for n in SIZES
        for sigma in NOISES
    ),
    methods=(
        Method(
            "gtsam_random_starts",
            LM,
            published={
                "error": "lm_avg_error",
                "global_percent": "lm_global_percent",
                "total_seconds": "lm_time_s",
            },
        ),
        Method(
            "block_coordinate_descent",
            ALGORITHM_1,
            published={"relaxation_error": "alg1_avg_error", "total_seconds": "alg1_time_s"},
        ),
        Method("rotation_coordinate_descent"),
        Method(
            "sdp_dual",
            INTERIOR,
            {"chordal": False},
            max_nodes=20,
            published={"relaxation_error": "sedumi_avg_error", "total_seconds": "sedumi_time_s"},
        ),
        Method("sdp_dual", "interior points on (D), Clarabel, chordal", {"chordal": True}),
        Method("riemannian_gradient"),
        Method("certified", STAIRCASE),
        Method("cycle_closed_form"),
    ),
    columns=(
        Column("error", "error", ".2e", exact=True),
        Column("global_percent", "% global", ".0f", exact=True),
        Column("total_seconds", "seconds", ".4f"),
        Column("verdict", "verdict"),
        Column("certified_by", "bounds that hold"),
        Column("status", "ended"),
    ),
    published="eriksson2018_table1",
    key="n,sigma_rad",
    others=("lm_avg_error", "lm_global_percent", "sedumi_avg_error"),
    summary="mean",
    seeds=50,
    quick=("cycle of 20, sigma 0.2 rad",),
    notes=(
        "Means over 50 instances, as in the paper. Cameras go once "
        "around the z axis; each measurement is turned about a random axis by a normally "
        "distributed angle. Sigma is its standard deviation here; the paper speaks of variance. "
        "Printed errors and shares are compared with ours, of other instances of the same kind. "
        "Machines and years differ: printed times stand next to ours and are not compared. "
        "SeDuMi's numbers are next to Clarabel's without its chordal decomposition.",
        "The error is F of the rotations less the proven optimum's F; the paper takes the lowest "
        "value found. What it prints of Algorithm 1 and SeDuMi is the relaxation's, before it is "
        "rounded to rotations: compared with it is ours (relaxation_error), which is 5 to 120 "
        "times larger at our stopping rule, while the rounded rotations are optimal to rounding. "
        "It was computed of Algorithm 1 and up to 50 cameras; other records are older than it. "
        "Global: F within 1e-6 of the optimum. Levenberg-Marquardt (GTSAM on the chordal cost) "
        "starts at one random turn a camera; what it misses is wound around the cycle. It has no "
        "bound, nor have rotation_coordinate_descent and riemannian_gradient. The others end with "
        "one: Algorithm 1 when its own duality gap is small, Clarabel by multipliers made "
        "feasible, the staircase by a proof, which it reaches in most rows before "
        "Levenberg-Marquardt is done. The verdicts are the judge's, by the same procedure "
        "for each answer, and their time is nobody's.",
        "On long cycles Algorithm 1 is slow, as the paper's own times say: a change at one camera "
        "travels one camera an update. Like rotation_coordinate_descent it stops at 10,000 sweeps: "
        "where it ended at that limit, its seconds are not those to a small gap, and it has no "
        "bound. Clarabel with its chordal decomposition, which splits a cycle into triangles, is "
        "faster there; without it times grow too fast, and it is run up to 20 cameras only. From "
        "a rank-d start rotation coordinate descent may stall in a cycle that is wound up, as any "
        "local method does; Algorithm 1 from the identity does not.",
        "A cycle needs none of this: the closed form shares the closing error out, and is optimal "
        "by Theorem 4.2.",
    ),
    claims=CLAIMS,
    remarks={
        LM: "tried: four starts, three parametrizations, sigma as variance, another program "
        "(printed_rows); no share of 50 runs rounds to 73, 55, 45 or 33 %",
        ALGORITHM_1: "tried: later ends, which give any error, none of them all (printed_rows); "
        "ours ends at a duality gap of 1e-6 of F or after 10,000 sweeps, and a few slow cycles "
        "decide its mean",
        INTERIOR: "tried: nothing; Clarabel is another program than SeDuMi, of other tolerances",
    },
)

"""Eriksson et al. 2018, Table 2: largest residuals against residual-angle bounds."""

from reports.harness.experiments.claims import Claim, below, number, unknown
from reports.harness.experiments.records import Record
from reports.harness.experiments.spec import Column, Method, Row, Table

from ._sets import UNIT

NO_EDGES = "the paper's edge set is not here"

SCENES = (
    "Ellis_Island",
    "Madrid_Metropolis",
    "Montreal_Notre_Dame",
    "NYC_Library",
    "Piazza_del_Popolo",
    "Tower_of_London",
    "Union_Square",
    "Yorkminster",
)
CYCLES = ("cycle20_0.5_SO3", "cycle200_0.5_SO3")

SPHINX = "Sphinx (70 cameras, another edge set)"
NOT_HERE = {name: f"{name} (not here)" for name in ("Gustavus", "Alcatraz", "Pumpkin", "Buddha")}
INTERIOR = "interior points on (D), Clarabel"
WHERE = "section 6, real-world data"


def _verdicts(records: list[Record], method: str) -> list[str]:
    return [r.verdict for r in records if r.method == method and r.verdict]


def algorithm_1_is_optimal(records: list[Record]) -> bool | None:
    """Whether every answer of Algorithm 1 is certified."""
    verdicts = _verdicts(records, "Algorithm 1")
    return all(verdict == "CERTIFIED" for verdict in verdicts) if verdicts else None


def is_within_bound(records: list[Record]) -> bool | None:
    """Whether the optimum's residuals are below the angle of Theorem 4.1."""
    largest, bound = (
        number(records, "certified", f"{k}_deg") for k in ("max_residual", "alpha_max")
    )
    return None if largest is None or bound is None else largest <= bound


def is_tight_beyond_bound(records: list[Record]) -> bool | None:
    """Whether the dual certifies the optimum where its residuals are above the bound."""
    if is_within_bound(records) is not False:
        return None
    return all(verdict == "CERTIFIED" for verdict in _verdicts(records, "certified"))


CLAIMS = (
    Claim(
        "Algorithm 1 correctly produces the global optimum at each instance",
        algorithm_1_is_optimal,
        WHERE,
        each=True,
    ),
    Claim(
        "Algorithm 1 significantly outperforms interior points: at least twice as fast",
        below("total_seconds", "Algorithm 1", INTERIOR, 0.5),
        WHERE,
        each=True,
        remark="Clarabel splits a cycle into triangles (its chordal decomposition), and is faster "
        "than Algorithm 1 there; beyond 50 cameras it is not run",
    ),
    Claim(
        "Theorem 4.1 guarantees the optimum of all real-world instances but Pumpkin",
        unknown,
        WHERE,
        remark="The paper's edge sets are not here. On the public Sphinx graph, which has "
        "another, one wrong measurement (23.4 degrees) is above the bound (8.9); without it the "
        "others are below",
    ),
    Claim(
        "Where Theorem 4.1 is too conservative (as for Pumpkin), strong duality holds nevertheless",
        is_tight_beyond_bound,
        WHERE,
        each=True,
    ),
)

TABLE = Table(
    name="eriksson2018_table2",
    title="Largest residuals and residual-angle bounds (Eriksson et al. 2018, Table 2)",
    source="A. Eriksson, C. Olsson, F. Kahl, T.-J. Chin, Rotation Averaging and Strong Duality, "
    "CVPR 2018, Table 2",
    rows=(
        Row("sphinx_SO3", SPHINX, UNIT, published="Sphinx"),
        *(Row(name, label, published=name, absent=NO_EDGES) for name, label in NOT_HERE.items()),
        *(Row(name, rotations=True, reading=UNIT, components="largest") for name in SCENES),
        *(Row(name, reading=UNIT) for name in CYCLES),
        Row(
            generator="random_graph",
            label="random graph, 100 nodes of degree 20",
            arguments={"n": 100, "mean_degree": 20.0, "sigma": 0.05},
        ),
        Row(
            generator="random_graph",
            label="random graph, 50 nodes of degree 8",
            arguments={"n": 50, "mean_degree": 8.0, "sigma": 0.2},
        ),
        *(
            Row(
                generator="viewing_graph",
                label=f"{name}'s viewing graph, simulated rotations",
                arguments={"name": f"{name}.mat", "sigma": 0.05},
            )
            for name in ("Notre_Dame", "Ellis_Island", "Alamo")
        ),
    ),
    methods=(
        Method(
            "block_coordinate_descent",
            "Algorithm 1",
            published={
                "total_seconds": "alg1_time_s",
                "max_residual_deg": "max_residual_deg",
                "alpha_max_deg": "alpha_max_deg",
            },
        ),
        Method("rotation_coordinate_descent"),
        Method(
            "sdp_dual",
            INTERIOR,
            max_nodes=50,
            published={"total_seconds": "sedumi_time_s"},
        ),
        Method("certified"),
    ),
    columns=(
        Column("total_seconds", "seconds", ".3f"),
        Column("max_residual_deg", "largest residual, deg", ".2f"),
        Column("alpha_max_deg", "alpha_max, deg", ".2f"),
        Column("normalized_alpha_max_deg", "normalized, deg", ".2f"),
        Column("certified_by", "certified by"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("verdict", "verdict"),
    ),
    published="eriksson2018_table2",
    comparable=False,
    quick=(SPHINX, "cycle20_0.5_SO3"),
    notes=(
        "alpha_max is Theorem 4.1's, by the second eigenvalue of the graph's Laplacian over the "
        "largest degree; normalized is ours, by that of the normalized Laplacian, never smaller. A "
        "stationary answer whose residuals all stay below either is optimal. Rows: each camera's "
        "own residuals against that eigenvalue. Theorem 4.2 and the sum are for cycles. The "
        "factorization alone decides where no angle does, and what it proves is the verdict.",
        "All weights 1. The paper's edge sets are not here: the public Sphinx graph has as many "
        "cameras and another alpha_max, the other four rows stand for what the paper prints. "
        "Without the measurement of the largest residual, which the truth contradicts, Sphinx's "
        "largest is 6.53 degrees, without two 6.04, near the printed 6.14, and Theorem 4.1 "
        "guarantees the optimum as printed (printed_rows). The images and reconstructions of "
        "Figure 3 are not here. The "
        "1DSfM scenes hold wrong measurements, whose residuals no bound by angles survives; their "
        "viewing graphs with simulated rotations (0.05 rad an axis) show what the bounds are worth "
        "without them. Interior points are run up to 50 cameras.",
    ),
    claims=CLAIMS,
    remarks={SPHINX: f"{NO_EDGES}, and the public graph of that name has another"},
)

"""Certified optima in units of one numeric factorization of the certificate matrix."""

from dataclasses import replace

from reports.harness.experiments.spec import FACTORIZATION, Column, Method, Table

from ._sets import OTHERS, PRINTED, SPACE, rows

TABLE = Table(
    name="certified_factors",
    title="Certified optima in factorizations of the optimum's certificate matrix",
    source="D. M. Rosen, L. Carlone, A. S. Bandeira, J. J. Leonard, SE-Sync, IJRR 2019, Tables 1 "
    "and 2",
    rows=tuple(
        replace(row, published=row.dataset if row.dataset in PRINTED else "")
        for row in rows(*SPACE, *OTHERS)
    ),
    stand_ins=rows("w100", "w10000"),
    optional=True,
    methods=(Method("certified", published={"cost": "optimum_F"}),),
    published="rosen2019_se_sync_table",
    paper=False,
    reference=Method(FACTORIZATION),
    columns=(
        Column("verdict", "verdict"),
        Column("cost", "F", ".10g", exact=True),
        Column("lower_bound", "F* >=", ".10g"),
        Column("relative_gap", "relative gap", ".1e"),
        Column("median_seconds", "seconds", ".3f"),
        Column("ratio", "factors", ".1f"),
        Column("iterations", "iterations"),
        Column("counts", "work"),
    ),
    quick=("intel", "w100"),
    notes=(
        "One core, one thread; from the graph in memory to the certified estimate. A factor is one "
        "numeric factorization of the pinned certificate matrix at the optimum, its analysis "
        "excluded, timed in turn with the method.",
    ),
    remarks={
        "manhattan": "tried: a proof, by which the optimum is 6431.39, a unit of the last printed "
        "digit below",
        **dict.fromkeys(("CSAIL", "grid3D", "rim"), "file not here"),
    },
)

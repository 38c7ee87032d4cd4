"""Certified optima in units of one numeric factorization of the certificate matrix."""

from certpgo.harness.spec import FACTORIZATION, Column, Method, Table

from ._sets import OTHERS, SPACE, rows

TABLE = Table(
    name="certified_factors",
    title="Certified optima in factorizations of the optimum's certificate matrix",
    rows=rows(*SPACE, *OTHERS),
    stand_ins=rows("w100", "w10000"),
    optional=True,
    methods=(Method("certified"),),
    reference=Method(FACTORIZATION),
    columns=(
        Column("verdict", "verdict"),
        Column("cost", "F", ".10g"),
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
)

"""Certified rotation averaging against GTSAM's chordal initialization alone."""

from reports.harness.experiments.spec import Column, Method, Table

from ._sets import SPACE, rows

TABLE = Table(
    name="certified_rotations",
    title="Certified rotation averaging against GTSAM's chordal initialization alone",
    rows=rows(*SPACE, rotations=True),
    stand_ins=rows("sphere2500.txt", rotations=True),
    optional=True,
    methods=(Method("certified"),),
    reference=Method("gtsam_chordal"),
    columns=(
        Column("verdict", "verdict"),
        Column("cost", "F", ".10g"),
        Column("relative_gap", "relative gap", ".1e"),
        Column("median_seconds", "seconds", ".3f"),
        Column("reference_seconds", "GTSAM, seconds", ".3f"),
        Column("ratio", "ratio to GTSAM", ".3f"),
        Column("counts", "work"),
    ),
    quick=("parking-garage",),
    notes=(
        "As in the table of pose graphs, of which the rotations alone are taken, with the files' "
        "kappa; GTSAM initializes the rotations and stops.",
    ),
)

"""Methods side by side on the SLAM sets found here, or else on the gtsam wheel's own files."""

from certpgo.solve.comparison import METHODS
from certpgo.solve.comparison_table import NOTES, TITLE
from reports.harness.experiments.spec import Column, Row, Table, extended

TABLE = Table(
    name="compare",
    title=TITLE,
    rows=(
        Row("smallGrid3D"),
        Row("parking-garage"),
        Row("sphere2500"),
        Row("torus3D"),
        Row("sphere_bignoise_vertex3"),
        Row("cubicle"),
        Row("MIT"),
        Row("intel"),
        Row("manhattan"),
        Row("city10000"),
    ),
    stand_ins=(Row("sphere2500.txt"), Row("w100"), Row("w10000")),
    optional=True,
    methods=tuple(map(extended, METHODS)),
    columns=(
        Column("cost", "F", ".9g"),
        Column("f_ml", "f_ML", ".7g"),
        Column("gap", "gap", ".2e"),
        Column("relative_gap", "gap / F", ".1e"),
        Column("verdict", "verdict"),
        Column("kept_percent", "kept, %", ".1f"),
        Column("seconds", "seconds (by phase)"),
    ),
    quick=("smallGrid3D", "MIT", "w100"),
    notes=NOTES,
)

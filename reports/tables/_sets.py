"""Sets that several tables are measured on, and how they are read."""

from reports.harness.experiments.spec import Row

#: With GTSAM's step as reference.
SPACE = ("sphere2500", "torus3D", "sphere_bignoise_vertex3", "parking-garage")
#: Where GTSAM throws, and in the plane.
OTHERS = (
    "cubicle",
    "city10000",
    "ais2klinik",
    "manhattan",
    "intel",
    "MIT",
    "kitti_00",
    "kitti_05",
    "M3500a",
    "M3500b",
    "M3500c",
    "ring",
)


#: Of which SE-Sync's authors print the optimum.
PRINTED = (
    "sphere2500",
    "torus3D",
    "parking-garage",
    "cubicle",
    "city10000",
    "ais2klinik",
    "manhattan",
    "intel",
)
#: Every edge weighing 1; and of parallel edges the last.
UNIT = {"unit_weights": True}
SIMPLE = {**UNIT, "keep": "last"}
#: The thesis' pose graphs, as it reads them.
SLAM = {
    "parking-garage": UNIT,
    "grid3D": UNIT,
    "cubicle": SIMPLE,
    "sphere_bignoise_vertex3": UNIT,
    "torus3D": UNIT,
    "rim": SIMPLE,
}


def rows(*names: str, rotations: bool = False) -> tuple[Row, ...]:
    """One row a set."""
    return tuple(Row(name, rotations=rotations) for name in names)

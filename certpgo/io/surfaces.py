"""Point clouds and meshes: PLY, in text or binary, metres, by trimesh."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError, MissingDependency, in_file
from certpgo.io.pipes import readable
from certpgo.io.writing import atomically
from certpgo.linalg.arrays import FloatArray, IntArray

#: Bytes within which a header ends.
HEADER = 65536


def _no_faces() -> IntArray:
    return np.zeros((0, 3), dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Surface:
    """A point cloud, or a mesh if there are faces.

    Attributes
    ----------
    points : (p, 3) metres
    colours : (p, 3) red, green and blue in 0 ... 255; None for none
    faces : (f, 3) triangles of points, counterclockwise seen from outside; empty for a cloud
    """

    points: FloatArray
    colours: NDArray[np.uint8] | None = None
    faces: IntArray = field(default_factory=_no_faces)

    def __post_init__(self) -> None:
        p = len(self.points)
        if np.shape(self.points) != (p, 3):
            raise InputError(f"points must be (p, 3), not {np.shape(self.points)}")
        if self.colours is not None and np.shape(self.colours) != (p, 3):
            raise InputError(f"colours must be ({p}, 3), one for each point")
        if len(self.faces) and not 0 <= np.min(self.faces) <= np.max(self.faces) < p:
            raise InputError(f"faces must name points from 0 to {p - 1}")


def is_ply(path: Path) -> bool:
    """Whether a file says that it is PLY."""
    with readable(path).open("rb") as file:
        return file.read(4) in (b"ply\n", b"ply\r")


def read_surface(path: str | Path) -> Surface:
    """Read a point cloud or mesh; faces of four points become two triangles.

    Points that are not finite, with which scanners mark what they did not see, are left out of
    clouds.

    Raises
    ------
    FormatError
        The file is not PLY, ends early, or has no point with x, y and z.
    MissingDependency
        trimesh is not installed.
    """
    path = Path(path)
    (vertices, triangles), read = _announced(path), _read(path)
    points = np.asarray(getattr(read, "vertices", np.zeros((0, 3))), dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise FormatError(path, None, "at least one vertex with x, y and z expected")
    if len(points) != vertices:
        raise FormatError(path, None, f"{vertices} vertices announced, {len(points)} found")
    faces = np.asarray(getattr(read, "faces", _no_faces()), dtype=np.intp)
    if len(faces) < triangles:  # more, where quadrilaterals are two
        raise FormatError(path, None, f"{triangles} faces announced, {len(faces)} found")
    colours = _colours(read)
    seen = np.isfinite(points).all(axis=1)
    if not seen.any() or (len(faces) and not seen.all()):
        raise FormatError(path, None, "finite coordinates expected")
    colours = None if colours is None else colours[seen]
    with in_file(path):
        return Surface(points[seen], colours, faces)


def _announced(path: Path) -> tuple[int, int]:
    """Numbers of vertices and faces in the header, which trimesh does not check in text files."""
    try:
        with readable(path).open("rb") as file:
            head, end, _ = file.read(HEADER).partition(b"end_header")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    found = {name: int(n) for name, n in re.findall(rb"^element (\w+) (\d+)\s*$", head, re.M)}
    if not end or b"vertex" not in found:
        raise FormatError(path, None, "a PLY header with element vertex and end_header expected")
    return found[b"vertex"], found.get(b"face", 0)


def _read(path: Path) -> Any:
    try:
        import trimesh
    except ImportError:
        raise MissingDependency("trimesh, which reads and writes PLY,", "view") from None
    try:
        # Nothing is merged, nor reordered.
        return trimesh.load(readable(path), file_type="ply", process=False, fix_texture=False)
    except KeyError as error:
        expected = f"vertices with x, y and z expected, {error} is missing"
        raise FormatError(path, None, expected) from None
    except Exception as error:  # of many kinds, from NumPy and trimesh
        why = str(error).partition("\n")[0]
        raise FormatError(path, None, f"a complete PLY file expected ({why})") from None


def _colours(read: Any) -> NDArray[np.uint8] | None:
    """The colours in the file; trimesh would make some up for meshes without."""
    if getattr(read, "visual", None) is not None:
        found = read.visual.vertex_colors if read.visual.kind == "vertex" else None
    else:
        found = getattr(read, "colors", None)
    if found is None or np.shape(found)[0] != len(read.vertices):
        return None
    return np.asarray(found, dtype=np.uint8)[:, :3]


def write_surface(path: str | Path, surface: Surface) -> None:
    """Write a cloud or mesh as a binary PLY file in single precision, complete or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    MissingDependency
        trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError:
        raise MissingDependency("trimesh, which reads and writes PLY,", "view") from None
    made: Any
    if len(surface.faces):
        made = trimesh.Trimesh(surface.points, surface.faces, process=False)
        if surface.colours is not None:
            made.visual.vertex_colors = surface.colours
    else:
        made = trimesh.PointCloud(surface.points, surface.colours)  # type: ignore[no-untyped-call]
    content = made.export(file_type="ply", encoding="binary")
    atomically(Path(path), lambda temporary: temporary.write_bytes(content))


def glb(surface: Surface) -> bytes:
    """A coloured mesh as binary glTF, matt and seen from both sides.

    Raises
    ------
    MissingDependency
        trimesh is not installed.
    """
    try:
        import trimesh
        from trimesh.visual.material import PBRMaterial
    except ImportError:
        raise MissingDependency("trimesh, which writes meshes,", "view") from None
    matt = PBRMaterial(doubleSided=True, metallicFactor=0.0, roughnessFactor=1.0)  # type: ignore[no-untyped-call]
    visual: Any = trimesh.visual.TextureVisuals(material=matt)  # type: ignore[no-untyped-call]
    opaque = np.full((len(surface.points), 1), 255, dtype=np.uint8)
    visual.vertex_attributes["color"] = np.hstack([surface.colours, opaque])  # type: ignore[list-item]
    made: Any = trimesh.Trimesh(surface.points, surface.faces, process=False, visual=visual)
    content: bytes = made.export(file_type="glb")
    return content

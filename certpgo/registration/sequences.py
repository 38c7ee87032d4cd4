"""RGB-D sequences: the folders of TUM, ICL-NUIM, Open3D (Redwood) and 7-Scenes."""

from __future__ import annotations

import hashlib
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.errors import FormatError, InputError, MissingDependency, require_path
from certpgo.graph import Estimate
from certpgo.graph.phrases import counted
from certpgo.io.chunks import read_rows
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.camera import Camera, camera_of, read_camera

#: Units of a metre in depth images, where a folder's kind does not say otherwise.
MILLIMETRES, TUM_SCALE = 1000.0, 5000.0
#: Seconds that a colour and a depth image of TUM may be apart.
SIMULTANEOUS = 0.02
#: Raw depths that mean "none".
NO_DEPTH = 65535
#: The last bytes of whole files.
ENDINGS = {b"\x89PNG": b"IEND\xaeB`\x82", b"\xff\xd8\xff": b"\xff\xd9"}
#: Entries of R^T R - I of printed poses: 7-Scenes rounds its own to 2e-4.
PRINTED = 1e-2
IMAGES = (".png", ".jpg", ".jpeg")
#: Folders of colour images beside ``depth``.
COLOURS = ("color", "rgb", "image")
#: What a folder of frames may hold.
LAYOUTS = (
    "rgb.txt and depth.txt or associations.txt (TUM, ICL-NUIM), frame-*.color.* and "
    "frame-*.depth.png (7-Scenes), or images in color and depth (Open3D) expected"
)


@dataclass(frozen=True, eq=False)
class Frame:
    """A colour image with the depths at its pixels.

    Attributes
    ----------
    colour : (h, w, 3) red, green and blue, 0 to 255
    depth : (h, w) metres, 0 for none
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]


@dataclass(frozen=True, eq=False, kw_only=True)
class FrameSequence(ABC):
    """Frames in the order in which they were taken.

    Attributes
    ----------
    name : for titles
    names : of the frames
    times : (n,) seconds, or numbers of frames
    camera : that of the depth images
    truth : poses of the camera that came with the frames, or None
    registered : whether depth images are of the colour camera; those of 7-Scenes are not
    """

    name: str
    names: tuple[str, ...]
    times: FloatArray
    camera: Camera
    truth: Estimate | None = None
    registered: bool = True

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.names)

    @abstractmethod
    def frame(self, k: int) -> Frame:
        """The k-th frame; FormatError if a file of it is damaged."""

    @abstractmethod
    def key(self, k: int) -> str:
        """A digest of the k-th frame's content, by which results are kept."""

    def chosen(self, numbers: Iterable[int]) -> FrameSequence:
        """Some of the frames, in that order."""
        kept = list(numbers)
        return replace(
            self,
            names=tuple(self.names[k] for k in kept),
            times=self.times[kept],
            truth=None if self.truth is None else self.truth.subset(np.array(kept)),
            **self._of_frames(kept),
        )

    @abstractmethod
    def _of_frames(self, kept: list[int]) -> dict[str, Any]:
        """The fields of a subclass for some of the frames."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FolderSequence(FrameSequence):
    """Frames in files.

    Attributes
    ----------
    files : colour and depth images
    depth_scale : units of a metre in the depth images
    """

    files: tuple[tuple[Path, Path], ...]
    depth_scale: float

    def frame(self, k: int) -> Frame:
        """The k-th frame; FormatError names the file that is damaged."""
        cv2 = require_cv2()
        for path in self.files[k]:
            if not path.is_file():
                raise FormatError(path, None, "no such image")
        colour, depth = self.files[k]
        image = _decoded(colour, cv2.IMREAD_COLOR)
        raw = _decoded(depth, cv2.IMREAD_UNCHANGED)
        if raw.ndim != 2 or raw.dtype != np.uint16:
            found = f"{8 * raw.dtype.itemsize} bits, {counted(raw[:1, :1].size, 'channel{s}')}"
            raise FormatError(depth, None, f"depth has 16 bits in one channel; here {found}")
        if raw.shape != image.shape[:2]:
            sizes = " and ".join(f"{w}x{h}" for h, w in (raw.shape, image.shape[:2]))
            raise FormatError(depth, None, f"depth and colour images differ in size: {sizes}")
        metres = np.where(raw == NO_DEPTH, 0, raw).astype(np.float32) / np.float32(self.depth_scale)
        return Frame(np.ascontiguousarray(image[:, :, ::-1]), metres)

    def key(self, k: int) -> str:
        """A digest of the k-th frame's files, camera and scale."""
        digest = hashlib.sha256(repr((self.camera, self.depth_scale)).encode())
        for path in self.files[k]:
            digest.update(path.read_bytes() if path.is_file() else b"none")
        return digest.hexdigest()

    def _of_frames(self, kept: list[int]) -> dict[str, Any]:
        return {"files": tuple(self.files[k] for k in kept)}


def require_cv2() -> Any:
    """OpenCV.

    Raises
    ------
    MissingDependency
        It is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise MissingDependency("opencv-python-headless", "rgbd") from None
    return cv2


def _decoded(path: Path, flag: int) -> NDArray[Any]:
    """An image as OpenCV has it: blue, green, red."""
    data = path.read_bytes()
    ending = next((end for start, end in ENDINGS.items() if data.startswith(start)), None)
    # Decoders fill the rest of a truncated image with grey, and only print a warning.
    if ending is not None and ending not in data[-64:]:
        raise FormatError(path, None, "the image is truncated")
    image = require_cv2().imdecode(np.frombuffer(data, np.uint8), flag) if data else None
    if image is None:
        raise FormatError(path, None, "a PNG or JPEG image expected")
    return np.asarray(image)


def read_sequence(
    folder: str | Path, *, camera: str | Camera | None = None, depth_scale: float | None = None
) -> FrameSequence:
    """The frames in a folder as TUM, ICL-NUIM, Open3D (Redwood) or 7-Scenes have them.

    Images are read when they are needed.

    Parameters
    ----------
    folder : ``rgb.txt`` and ``depth.txt`` with times and files, or ``associations.txt`` with both
        (TUM, ICL-NUIM); ``frame-*.color.*`` beside ``frame-*.depth.png`` (7-Scenes); or images in
        ``color``, ``rgb`` or ``image`` beside ``depth`` (Open3D)
    camera : of the depth images, as `Camera`, ``"fx,fy,cx,cy"`` or a file; by default a file of
        intrinsics in the folder. TUM and ICL-NUIM have none: theirs stand on their sites
    depth_scale : units of a metre in depth images; by default 5000 for TUM and ICL-NUIM, otherwise
        1000, millimetres

    Raises
    ------
    InputError
        No such folder, no frames, no camera; FormatError where a list, a pose or the intrinsics
        cannot be read.

    Examples
    --------
    >>> import certpgo
    >>> try:
    ...     certpgo.read_sequence("nowhere")
    ... except certpgo.InputError as error:
    ...     print(error)
    nowhere: no such folder
    """
    require_path(folder, "a folder")
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if depth_scale is not None and not 0.0 < depth_scale < np.inf:
        raise InputError(f"a depth scale is the units of a metre, positive: not {depth_scale}")
    if (folder / "associations.txt").is_file() or (folder / "rgb.txt").is_file():
        found, usual = _of_tum(folder), TUM_SCALE
    elif list(folder.glob("frame-*.color.*")):
        found, usual = _of_seven_scenes(folder), MILLIMETRES
    else:
        found, usual = _of_folders(folder), MILLIMETRES
    intrinsics = _camera(folder) if camera is None else camera
    chosen = camera_of(intrinsics) if isinstance(intrinsics, str) else intrinsics
    return FolderSequence(
        name=folder.resolve().name,
        camera=chosen,
        depth_scale=usual if depth_scale is None else depth_scale,
        **found,
    )


def _camera(folder: Path) -> Camera:
    for pattern in ("camera-intrinsics.txt", "camera*.param", "*intrinsic*.json", "camera*.json"):
        for path in sorted(folder.glob(pattern)):
            return read_camera(path)
    raise InputError(f"{folder}: no intrinsics: give --camera fx,fy,cx,cy or a file of them")


def _of_tum(folder: Path) -> dict[str, Any]:
    """TUM's and ICL-NUIM's lists; only frames with colour and depth."""
    if (folder / "associations.txt").is_file():
        rows = _rows(folder / "associations.txt", 4, "time file time file")
        both = [(float(r[0]), folder / r[1], folder / r[3]) for r in rows]
        # TUM's tool has colour first, ICL-NUIM depth.
        if both and "depth" in rows[0][1]:
            both = [(time, second, first) for time, first, second in both]
    else:
        colours = _rows(folder / "rgb.txt", 2, "time file")
        depths = _rows(folder / "depth.txt", 2, "time file")
        times = np.array([float(row[0]) for row in depths])
        both = []
        for row in colours:
            nearest = int(np.argmin(np.abs(times - float(row[0]))))
            if abs(times[nearest] - float(row[0])) <= SIMULTANEOUS:
                both.append((float(row[0]), folder / row[1], folder / depths[nearest][1]))
    if not both:
        raise InputError(f"{folder}: no colour and depth images within {SIMULTANEOUS} s")
    times = np.array([time for time, _, _ in both])
    truths = [*folder.glob("groundtruth.txt"), *folder.glob("*.gt.freiburg")]
    return {
        "names": tuple(colour.name for _, colour, _ in both),
        "times": times,
        "files": tuple((colour, depth) for _, colour, depth in both),
        "truth": _at_times(truths[0], times) if truths else None,
    }


def _rows(path: Path, width: int, what: str) -> list[list[str]]:
    """The words of each line of a list."""
    if not path.is_file():
        raise FormatError(path, None, "no such list")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != width or not all(map(_is_number, words[::2])):
            raise FormatError(path, number, f"expected: {what}")
        rows.append(words)
    if not rows:
        raise FormatError(path, None, f"no lines: {what}")
    return rows


def _is_number(word: str) -> bool:
    return re.fullmatch(r"[-+]?\d+\.?\d*(e[-+]?\d+)?", word) is not None


def _at_times(path: Path, times: FloatArray) -> Estimate | None:
    """The poses of a TUM trajectory nearest to some times; None if it does not reach all."""
    stamps, t, R = read_rows(path, 8, "timestamp tx ty tz qx qy qz qw", _tum_pose)
    nearest = np.abs(stamps[None] - times[:, None]).argmin(axis=1)
    if (np.abs(stamps[nearest] - times) > SIMULTANEOUS).any():
        return None
    return Estimate(R[nearest], t[nearest])


def _tum_pose(rows: FloatArray) -> tuple[FloatArray, ...]:
    return rows[:, 0], rows[:, 1:4], quaternion.rotations(rows[:, 4:])


def _of_seven_scenes(folder: Path) -> dict[str, Any]:
    colours = sorted(folder.glob("frame-*.color.*"))
    stems = [path.name.partition(".")[0] for path in colours]
    poses = [folder / f"{stem}.pose.txt" for stem in stems]
    return {
        "names": tuple(stems),
        "times": np.arange(len(stems), dtype=np.float64),
        "files": tuple(
            (colour, folder / f"{stem}.depth.png")
            for colour, stem in zip(colours, stems, strict=True)
        ),
        "truth": _truth(_matrices(poses)) if all(path.is_file() for path in poses) else None,
        "registered": False,
    }


def _matrices(paths: Iterable[Path]) -> list[tuple[Path, list[list[float]]]]:
    return [(path, [_numbers(path, k, line) for k, line in _lines(path)]) for path in paths]


def _of_folders(folder: Path) -> dict[str, Any]:
    """Open3D's: the k-th colour image belongs to the k-th depth image."""
    colours = next((found for name in COLOURS if (found := _images(folder / name))), [])
    depths = _images(folder / "depth")
    if not colours or not depths:
        raise InputError(f"{folder}: no frames: {LAYOUTS}")
    if len(colours) != len(depths):
        counts = f"{len(colours)} colour and {len(depths)} depth images"
        raise InputError(f"{folder}: {counts}; as many of each expected, in the same order")
    log, truth = folder / "trajectory.log", None
    if log.is_file():
        rows = [_numbers(log, k, line) for k, line in _lines(log)]
        blocks = [(log, rows[k + 1 : k + 5]) for k in range(0, len(rows), 5)]
        truth = _truth(blocks) if len(blocks) == len(colours) else None
    return {
        "names": tuple(path.name for path in colours),
        "times": np.arange(len(colours), dtype=np.float64),
        "files": tuple(zip(colours, depths, strict=True)),
        "truth": truth,
    }


def _images(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*") if path.suffix.lower() in IMAGES)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    lines = enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
    return ((number, line) for number, line in lines if line.strip())


def _numbers(path: Path, number: int, line: str) -> list[float]:
    try:
        return [float(word) for word in line.split()]
    except ValueError:
        raise FormatError(path, number, "numbers expected") from None


def _truth(blocks: list[tuple[Path, list[list[float]]]]) -> Estimate:
    """Poses of printed matrices [R t; 0 1], camera to world."""
    poses = np.empty((len(blocks), 4, 4))
    for pose, (path, rows) in zip(poses, blocks, strict=True):
        if [len(row) for row in rows] != [4, 4, 4, 4] or rows[3] != [0.0, 0.0, 0.0, 1.0]:
            raise FormatError(path, None, "4 rows of 4 numbers expected for a pose, [R t; 0 1]")
        pose[:] = rows
        defect = so.worst_defect(pose[None, :3, :3])[1]
        if not (defect <= PRINTED and np.isfinite(pose).all()):
            raise FormatError(path, None, f"{so.shortfall(pose[:3, :3], defect)}")
    return Estimate(so.project(poses[:, :3, :3]), poses[:, :3, 3])

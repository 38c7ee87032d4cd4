"""The interface of file formats, and their detection.

Each module in `certpgo.io.formats` defines a format by a constant ``FORMAT``.
"""

from __future__ import annotations

import importlib
import pkgutil
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from certpgo.errors import FormatError, InputError, InputNotice, SpecError, UnusableFile, kind_of
from certpgo.graph import Estimate, Instance
from certpgo.graph.keys import Keys
from certpgo.io.compressed import opened, uncompressed_name
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: A path, as text or an object.
AnyPath = str | Path
RotationInformation = Literal["tangent", "quaternion", "rpy"]
WeightsAre = Literal["information", "sqrt-information", "covariance"]
Progress = Callable[[int, int], None]

_HEAD_BYTES = 1 << 14
#: Files that only the program that writes them reads, by suffix.
_CONTAINERS = {
    ".pbstream": "a state of Cartographer expected, which begins otherwise: write the nodes and "
    "constraints of its proto::PoseGraph as g2o, or its trajectory as TUM",
    ".posegraph": "a graph of slam_toolbox, whose binary archive only its own build reads: write "
    "its vertices and edges as g2o, or its trajectory as TUM",
}


@dataclass(frozen=True)
class ReadOptions:
    """Options of a format's reader.

    Attributes
    ----------
    rotation_information : what the rotational information refers to; None for the format's default
    ignore_information : whether all weights are overridden, so that the file's are not read
    ignore_variances : whether those of distances are, too
    weights_are : what the numbers of a measurement's precision are
    skip_priors : whether measurements of single poses are skipped
    skip_landmarks : whether points and their sightings are skipped
    skip : tags of lines that are skipped
    also : further files that are read as one graph with the first
    progress : called with bytes read and bytes in total, or None
    """

    rotation_information: RotationInformation | None = None
    ignore_information: bool = False
    ignore_variances: bool = False
    weights_are: WeightsAre = "information"
    skip_priors: bool = False
    skip_landmarks: bool = False
    skip: tuple[str, ...] = ()
    also: tuple[Path, ...] = ()
    progress: Progress | None = None


@dataclass(frozen=True, eq=False)
class LabelledPoses:
    """Poses with the keys of their file.

    Attributes
    ----------
    rotations : (k, d, d)
    translations : (k, d), or None
    ids : (k,) integers; None if the format uses order, names or times instead. Timestamps that are
        all whole may be ids: they are in both.
    times_ns : (k,) integers, nanoseconds, for formats with timestamps
    names : (k,) of images, for formats with names
    points : (k,) which are points, without rotation; None for none
    scales : (k,) of similarities; None for poses
    camera : focal lengths and centre of the one camera of all poses; empty for none
    unturned : whether the file has positions alone, and the rotations mean nothing
    in_space : positions that the numbers of planar poses are, if they are not that
    """

    rotations: FloatArray
    translations: FloatArray | None
    ids: IntArray | None = None
    times_ns: IntArray | None = None
    names: tuple[str, ...] = ()
    points: BoolArray | None = None
    scales: FloatArray | None = None
    camera: tuple[float, ...] = ()
    unturned: bool = False
    in_space: LabelledPoses | None = None

    @classmethod
    def positions(
        cls, t: FloatArray, ids: IntArray | None, times_ns: IntArray | None
    ) -> LabelledPoses:
        """Positions (k, 3) alone."""
        return cls(np.tile(np.eye(3), (len(t), 1, 1)), t, ids, times_ns, unturned=True)

    @classmethod
    def of(cls, estimate: Estimate) -> LabelledPoses:
        """The poses of an estimate with its keys."""
        keys = estimate.keys
        unturned = keys.are_positions
        named = keys.ids, keys.times_ns, keys.names, None if unturned else keys.points
        R, t = estimate.rotations, estimate.translations
        return cls(R, t, *named, estimate.scales, keys.camera, unturned)

    @property
    def keys(self) -> Keys:
        """The keys alone."""
        return Keys(self.ids, self.times_ns, self.names, self.points, self.camera)

    def subset(self, chosen: IntArray) -> LabelledPoses:
        """Some poses, by index, in that order."""
        t, keys = self.translations, self.keys.subset(chosen)
        named = keys.ids, keys.times_ns, keys.names, keys.points
        t, s = (None if x is None else x[chosen] for x in (t, self.scales))
        more = s, self.camera, self.unturned
        return LabelledPoses(self.rotations[chosen], t, *named, *more)

    def without_points(self) -> LabelledPoses:
        """The poses alone."""
        if self.points is None:
            return self
        return replace(self.subset(np.flatnonzero(~self.points)), points=None)


def estimate_at(poses: LabelledPoses, order: IntArray, with_translations: bool) -> Estimate:
    """Some poses, by index, in that order, without keys.

    Raises
    ------
    InputError
        Translations are missing.
    """
    if not with_translations:
        return Estimate(poses.rotations[order])
    scales = None if poses.scales is None else poses.scales[order]
    t = require_translations(poses)[order]
    return Estimate(poses.rotations[order], t, scales=scales)


def require_translations(poses: LabelledPoses) -> FloatArray:
    """The translations of poses; an InputError if there are none."""
    if poses.translations is None:
        raise InputError("rotations only, but the graph measures translations")
    return poses.translations


@dataclass(frozen=True)
class Chart:
    """How a text file represents a pose.

    Attributes
    ----------
    rotation : unit quaternions, or matrices; planar poses are embedded at z = 0
    numbers : from the words of a line to those of its pose, without ids and times; empty for a line
        without a pose
    planar_angle : whether planar rotations are angles instead
    world_to_camera : whether the file contains R^T and -R^T t
    """

    rotation: Literal["quaternion", "matrix"]
    numbers: Callable[[list[bytes]], list[bytes]]
    planar_angle: bool = False
    world_to_camera: bool = False


GraphReader = Callable[[Path, ReadOptions], Instance]
PoseReader = Callable[[Path], LabelledPoses]
GraphWriter = Callable[[Path, Instance], None]
PoseWriter = Callable[[Path, Estimate, Keys], None]


@dataclass(frozen=True)
class Format:
    """A file format, and its readers and writers.

    Attributes
    ----------
    name : as in ``format=``
    suffixes : of the files it writes, the usual one first
    recognises : whether the first bytes of a file (or a folder: no bytes) are of this format
    holds : what such a file contains, for messages
    read_graph, write_graph : for measurements, or None
    read_poses : for estimates, or None
    write_poses : for an estimate and the keys of its nodes, or None
    holds_points : whether such a file of an estimate can store points
    holds_ranges : whether such a file of a graph can store distances, and points that no pose sees
    holds_scales : whether such a file of a graph or an estimate can store scales
    holds_translations : whether such a file can store them
    holds_ids : whether a file of an estimate can store node ids
    holds_times : whether it can store timestamps; in a TUM file, in place of ids
    holds_name : whether it can store a name of a node
    chart : how a text file represents a pose; None if unknown
    joins_files : whether several such files can be read as one graph
    on_topic : the format that reads one topic of such a file; None where there are no topics
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[Path, bytes], bool]
    holds: str
    read_graph: GraphReader | None = None
    read_poses: PoseReader | None = None
    write_graph: GraphWriter | None = None
    write_poses: PoseWriter | None = None
    holds_translations: bool = True
    holds_points: bool = False
    holds_ranges: bool = False
    holds_scales: bool = False
    holds_ids: bool = False
    holds_times: bool = False
    holds_name: Callable[[str], bool] = lambda name: False
    chart: Chart | None = None
    joins_files: bool = False
    on_topic: Callable[[str], Format] | None = None


@cache
def formats() -> Mapping[str, Format]:
    """Every format in the folder, by name; warns about files that cannot be loaded."""
    return MappingProxyType({form.name: form for form in _each()})


def _each() -> Iterator[Format]:
    """The formats, in the order in which they are asked; the rest of them is not loaded."""
    from certpgo.io import formats as package

    for module in pkgutil.iter_modules(package.__path__):
        path = Path(module.module_finder.path, f"{module.name}.py")  # type: ignore[union-attr]
        if (form := _loaded(f"{package.__name__}.{module.name}", path)) is not None:
            yield form


@cache
def _loaded(module: str, path: Path) -> Format | None:
    try:
        form: Format = importlib.import_module(module).FORMAT
    except Exception as error:
        warnings.warn(str(UnusableFile(path, error)), InputNotice, stacklevel=4)
        return None
    return form


def get_format(name: str) -> Format:
    """The format of that name; SpecError if there is none."""
    if name not in formats():
        raise SpecError.unknown("format", name, formats())
    return formats()[name]


def file_of(given: object) -> Path:
    """The path that is given to be read as an estimate; InputError if it is something else."""
    if isinstance(given, str | PathLike):
        return Path(given)
    instead = "certify_values takes GTSAM's Values"
    raise InputError(f"read_estimate reads a file, not {kind_of(given)}: {instead}")


def has_topics(path: Path) -> bool:
    """Whether a file or folder is there whose topics can be chosen."""
    try:
        return format_of(path).on_topic is not None
    except InputError:
        return False


def format_of(path: Path, name: str | None = None, topic: str | None = None) -> Format:
    """The format of an existing file or folder: as named, or by content, then by suffix.

    Parameters
    ----------
    topic : the only topic to read, of a bag

    Raises
    ------
    FormatError
        The path does not exist, is empty, or has no known format; or a file without topics.
    SpecError
        ``name`` is unknown.
    """
    form = _format_of(path, name)
    if topic is None:
        return form
    if form.on_topic is None:
        raise FormatError(path, None, f"a {form.name} file has no topics")
    return form.on_topic(topic)


def _format_of(path: Path, name: str | None) -> Format:
    head = _head(path)
    if name is not None:
        form = get_format(name)
        if path.is_dir() and not form.recognises(path, head):
            raise FormatError(path, None, f"a {name} file expected, not a folder")
        return form
    for form in _each():
        if form.recognises(path, head):
            return form
    text = b"\0" not in head and bool(head)
    for form in formats().values():
        # The reader then reports which line is wrong.
        if text and uncompressed_name(path).suffix in form.suffixes:
            return form
    if path.is_dir():
        raise FormatError(
            path,
            None,
            "a folder must hold EGs.txt (1DSfM), images.bin or images.txt (COLMAP), or "
            "metadata.yaml (rosbag2)",
        )
    raise FormatError(path, None, _unknown(path, head))


def _unknown(path: Path, head: bytes) -> str:
    """What a file of no known format seems to be."""
    if path.suffix in _CONTAINERS:
        return _CONTAINERS[path.suffix]
    rows = [line for line in head.splitlines() if line.strip() and not line.startswith(b"#")]
    columns = rows[0].count(b",") + 1 if rows and b"\0" not in head else 1
    if columns > 2:
        return (
            f"{columns} columns separated by commas: a trajectory has timestamp, x, y, z, qw, qx, "
            "qy, qz, or a first line that names its columns"
        )
    known = ", ".join(sorted(formats()))
    return f"no known format; known: {known} (guide: Read your own format)"


def _head(path: Path) -> bytes:
    if path.is_dir():
        return b""
    try:
        with opened(path) as file:
            head = file.read(_HEAD_BYTES).removeprefix(BOM_UTF8)
    except FileNotFoundError:
        raise FormatError(path, None, "no such file") from None
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    if not head:
        raise FormatError(path, None, "the file is empty")
    return head


def format_to_write(path: Path, name: str | None) -> Format:
    """The format called ``name``, or by the path's suffix.

    Raises
    ------
    SpecError
        ``name`` is unknown.
    InputError
        The suffix is unknown.
    """
    if name is not None:
        return get_format(name)
    writable = [f for f in formats().values() if f.write_graph or f.write_poses]
    for form in writable:
        if path.suffix in form.suffixes:
            return form
    known = ", ".join(sorted(suffix for form in writable for suffix in form.suffixes))
    raise InputError(f"{path}: unknown suffix; use one of {known}, or name the format (--format)")

"""Writing graphs and estimates, atomically."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from certpgo.errors import InputError, InputNotice, kind_of, refuse, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.held import as_stated
from certpgo.graph.keys import SECOND, Keys
from certpgo.graph.phrases import in_utf8
from certpgo.io.format import Format, format_to_write
from certpgo.io.frames import Anchor, anchored
from certpgo.io.timestamps import node_times
from certpgo.io.unwritten import lost_of_graph, lost_of_keys, unheld
from certpgo.linalg.arrays import IntArray


class AnyAnswer(Protocol):
    """What has an estimate."""

    @property
    def estimate(self) -> Estimate:
        """One pose or rotation per node."""
        ...


def write(
    path: str | Path,
    what: Estimate | AnyAnswer | Graph | Instance,
    *,
    instance: Instance | None = None,
    ids: ArrayLike | None = None,
    format: str | None = None,
    anchor: Anchor | None = None,
    timestamps: str | Path | None = None,
) -> None:
    """Write a graph or an estimate, in the format of the path's suffix.

    The file is written under a temporary name and then renamed, so it is complete or absent. A
    symbolic link is followed; a pipe or device is written to. Ids, times and names go to every
    format that holds them; an `InputNotice` says what is not written of them, and of the ground
    truth and known outliers that were read from a file.

    Parameters
    ----------
    path : .g2o, .npz, .pyfg or .json (Open3D) for a graph; these, .tum, .kitti, .rots or .ply for
        an estimate
    what : an instance (graph, ids, initial values, fixed nodes), a graph, an estimate, or what has
        one, such as an answer of `certpgo.solve`
    instance : for an estimate, the instance it solves: its ids, initial values and fixed nodes; an
        answer has its own
    ids : (n,) distinct node ids; by default the instance's, else those with which the estimate was
        read, else 0 ... n-1
    format : name of the format, if the suffix does not determine it
    anchor : frame of an estimate: ``"file"``, the default with an instance, is the world where
        there are priors, and otherwise puts the pose of the smallest id at its initial value in
        the instance, or the identity if it has none; ``"identity"`` puts it at
        the identity; ``"prior"`` puts the instance's first fixed node at its initial value;
        ``"none"``, the default without an instance, does not move the estimate
    timestamps : of an estimate: node ``"ids"``, ``"index"``, or a file with one per node; by
        default the nodes' times where they are known, and else in a TUM file their ids

    Raises
    ------
    InputError
        The format cannot represent it, an argument is wrong, or the file cannot be written.
    SpecError
        ``format`` is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> instance = helix(3, np.random.default_rng(0))
    >>> certpgo.write("helix.g2o", instance)
    >>> certpgo.read("helix.g2o").graph.num_edges == instance.graph.num_edges
    True
    """
    require(path, str | os.PathLike, "write(path, what): a path")
    path = Path(path)
    form = format_to_write(path, format)
    if isinstance(estimate := getattr(what, "estimate", None), Estimate):
        what, instance = estimate, instance or getattr(what, "instance", None)
    if isinstance(what, Estimate):
        _write_estimate(path, form, what, instance, ids, anchor, timestamps)
        return
    if not isinstance(what, Instance | Graph):
        raise InputError(f"a graph or an estimate is written, not {kind_of(what)}")
    if form.write_graph is None:
        raise InputError(f"{path}: {form.name} cannot be written for a graph")
    graph_writer = form.write_graph
    whole = as_stated(_as_instance(path, what, ids))
    refuse(next(unheld(form, whole), ""), str(path))
    atomically(path, lambda temporary: graph_writer(temporary, whole))
    for lost in lost_of_graph(form, whole):
        warnings.warn(f"{path}: {lost}", InputNotice, stacklevel=2)


def _write_estimate(
    path: Path,
    form: Format,
    estimate: Estimate,
    instance: Instance | None,
    ids: ArrayLike | None,
    anchor: Anchor | None,
    timestamps: str | Path | None,
) -> None:
    writer = form.write_poses
    if writer is None:
        raise InputError(f"{path}: {form.name} cannot be written for an estimate")
    if instance is not None and instance.graph.d != estimate.d:
        raise InputError(f"estimate of another graph: {estimate.d}D, not {instance.graph.d}D")
    keys = _keys(estimate, instance, ids)
    placed = anchored(estimate, keys.ids_of(estimate.num_nodes), instance, anchor)
    if instance is not None and instance.world is not None:
        keys = keys.subset(np.arange(instance.world))
    lost = []
    if keys.points is not None and keys.points.any() and not form.holds_points:
        poses = np.flatnonzero(~keys.points)
        placed, keys = placed.subset(poses), keys.subset(poses)
        lost.append(f"{form.name} files hold poses only: points are not written")
    if estimate.translations is not None and not form.holds_translations:
        lost.append(f"{form.name} files hold rotations only: translations are not written")
    if placed.scales is not None and not form.holds_scales:
        lost.append(f"{form.name} files hold poses only: scales are not written")
    keys = _timed(keys, placed.num_nodes, timestamps)
    if form.name == "tum" and keys.times_ns is not None and not keys.times_differ:
        keys = replace(keys, times_ns=None)
        lost.append("several poses have one timestamp: node ids are written instead")
    if timestamps is None or not form.holds_times:
        lost.extend(lost_of_keys(form, keys))
    if not all(map(form.holds_name, keys.names)):
        keys = replace(keys, names=())
    atomically(path, lambda temporary: writer(temporary, placed, keys))
    for sentence in lost:
        warnings.warn(f"{path}: {sentence}", InputNotice, stacklevel=3)


def _keys(estimate: Estimate, instance: Instance | None, ids: ArrayLike | None) -> Keys:
    """The keys of all nodes: of the instance, else of the estimate's own source."""
    own, n = estimate.keys, estimate.num_nodes
    if instance is not None:
        given = _ids(ids, n, instance)
        times = own.times_ns if instance.times_ns is None else instance.keys.times_ns
        names = () if ids is not None else instance.names
        return replace(instance.keys, ids=given, times_ns=times, names=names)
    return own if ids is None else replace(own, ids=_ids(ids, n, None), names=())


def _timed(keys: Keys, n: int, timestamps: str | Path | None) -> Keys:
    """The keys with the times that are chosen, and without others."""
    if timestamps is None:
        return keys
    if timestamps == "ids":
        return replace(keys, times_ns=None)
    if timestamps == "index":
        return replace(keys, times_ns=np.arange(n) * SECOND)
    return replace(keys, times_ns=node_times(Path(timestamps), n))


def _as_instance(path: Path, what: Graph | Instance, ids: ArrayLike | None) -> Instance:
    if isinstance(what, Instance):
        return what if ids is None else replace(what, ids=_ids(ids, what.graph.num_nodes, None))
    return Instance(path.stem, what, _ids(ids, what.num_nodes, None), world=what.world)


def _ids(ids: ArrayLike | None, n: int, instance: Instance | None) -> IntArray:
    if instance is not None and instance.graph.num_nodes != n:
        raise InputError(f"estimate of another graph: {n} nodes, not {instance.graph.num_nodes}")
    if ids is None:
        return np.arange(n) if instance is None else instance.ids
    keys = np.asarray(ids)
    if keys.shape != (n,) or keys.dtype.kind not in "iu" or len(np.unique(keys)) != n:
        raise InputError(f"ids must be {n} distinct integers")
    return keys.astype(np.intp)


def write_whole(path: Path, content: bytes) -> Path:
    """Write a file atomically; returns its path."""
    atomically(path, lambda temporary: temporary.write_bytes(content))
    return path


def write_text(path: Path, text: str) -> None:
    """Write a text atomically, in UTF-8; bytes of file names that are none as escapes."""
    write_whole(path, in_utf8(text).encode())


def folder_to_write(folder: Path) -> Path:
    """The folder, created if necessary; InputError if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable_folder(folder, error) from None
    return folder


def unwritable_folder(folder: Path, error: OSError) -> InputError:
    """The error that a folder cannot be made, or written to."""
    is_file = isinstance(error, FileExistsError | NotADirectoryError)
    reason = "a file is there, not a folder" if is_file else error.strerror
    return InputError(f"{folder}: cannot write there: {reason}")


def is_stream(path: Path) -> bool:
    """Whether a path leads to a pipe or a character device, which is written to, never replaced.

    Raises
    ------
    InputError
        It leads to a block device or a socket, which is no place for a file.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return False
    if stat.S_ISBLK(mode) or stat.S_ISSOCK(mode):
        raise InputError(f"{path}: cannot be written: it is a block device or a socket")
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def atomically(path: Path, write_to: Callable[[Path], object]) -> None:
    """Write a temporary file and rename it; InputError if that fails.

    A symbolic link stays: the file that it leads to is written. Pipes and devices get the complete
    content, as they cannot be replaced.
    """
    try:
        if is_stream(path):
            _into_stream(path, write_to)
        else:
            _in_place_of(Path(os.path.realpath(path)), write_to)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _into_stream(path: Path, write_to: Callable[[Path], object]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / "output"
        write_to(temporary)
        with temporary.open("rb") as content, path.open("wb") as stream:
            shutil.copyfileobj(content, stream)


def _in_place_of(path: Path, write_to: Callable[[Path], object]) -> None:
    if path.is_symlink():  # after resolution: a loop
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        write_to(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)

"""Reading graphs, estimates and ground truth from files."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from certpgo.errors import CertPGOError, FormatError, InputError, InputNotice
from certpgo.graph import Estimate, Instance, PoseGraph
from certpgo.graph.edges import Keep, simple_edges
from certpgo.graph.points import with_points
from certpgo.io.assemble import estimate_for, truth_for
from certpgo.io.chosen_weights import ChosenWeights
from certpgo.io.dead_reckoning import integrated
from certpgo.io.format import (
    LabelledPoses,
    Progress,
    ReadOptions,
    RotationInformation,
    WeightsAre,
    file_of,
    format_of,
)
from certpgo.io.names import named_ids
from certpgo.io.timestamps import with_node_ids
from certpgo.linalg.arrays import IntArray

_MEANINGS = ("tangent", "quaternion", "rpy")


def read(
    path: str | Path,
    *,
    keep: Keep = "all",
    rotation_information: RotationInformation | None = None,
    kappa: float | None = None,
    tau: float | None = None,
    unit_weights: bool = False,
    mahalanobis: bool = False,
    weights_are: WeightsAre | None = None,
    priors: bool = True,
    landmarks: bool = True,
    truth: str | Path | None = None,
    format: str | None = None,
    topic: str | None = None,
    progress: Progress | None = None,
    quiet: bool = False,
) -> Instance:
    r"""Read a measurement graph; the format is detected by content, then by suffix.

    Conventions are converted to ours: R_i is world <- body i, metres, radians. Weights are those of
    Rosen et al. (SE-Sync, IJRR 2019), from the information matrix Omega of each edge:
    tau = d / tr(Omega_t^-1), and kappa = 3 / (2 tr(Omega_R^-1)) in 3D, Omega_theta in 2D; 1 without
    information.

    Parameters
    ----------
    path : a g2o, PyFG, TORO, iSAM, Open3D (JSON), .mat (viewing graph), .npz or GLOMAP relative
        poses file, a bag of ROS with rtabmap's graph, a 1DSfM folder or its EGs.txt
    keep : of parallel edges, ``"all"`` (their terms add), or the ``"first"`` or ``"last"``
    rotation_information : what the rotational information refers to: ``"tangent"`` (default of g2o
        and TORO), ``"quaternion"`` (its vector part, half the angle: kappa is a quarter) or
        ``"rpy"`` (default of iSAM; for small angles the same as tangent)
    kappa, tau : a concentration that replaces the file's on every edge; tau in 1/m^2
    unit_weights : kappa = tau = 1 on every edge, and ranges weigh 1
    mahalanobis : weigh rotations by all of the file's rotational information, so that their terms
        are its Mahalanobis distances to second order: half of Omega_theta in 2D, a matrix in 3D
    weights_are : what the numbers after a measurement are: ``"information"``, the default,
        ``"sqrt-information"`` (upper triangular) or ``"covariance"``, which some programs write in
        files of the same form; a PyFG file's are covariances
    priors : whether measurements of single poses and positions are read, as edges from one more
        node, the world (``Instance.world``); else they are skipped
    landmarks : whether points, what sees them and ranges to them are read; else they are skipped
    truth : a file with ground truth for every node, see `read_truth`
    format : name of the format, if content and suffix do not determine it
    topic : of a bag, where several have graphs
    progress : called with bytes read and bytes in total, after each chunk
    quiet : collect notices in ``Instance.notices`` without also warning

    Raises
    ------
    FormatError
        With path, line and what was expected there.
    InputError
        Contradictory options, or incomplete truth.
    SpecError
        ``format`` is unknown.

    Examples
    --------
    >>> from pathlib import Path
    >>> import certpgo
    >>> line = "EDGE_SE2 {} {} 1 0 1.5707963 25 0 0 25 0 100\n"
    >>> edges = ((10, 20), (20, 30), (30, 40), (40, 10))
    >>> _ = Path("square.g2o").write_text("\n".join(line.format(*edge) for edge in edges))
    >>> instance = certpgo.read("square.g2o")
    >>> instance.graph.num_nodes, instance.graph.rotation.kappa[0], instance.graph.tau[0]
    (4, np.float64(100.0), np.float64(25.0))
    >>> instance.ids
    array([10, 20, 30, 40])
    """
    path = Path(path)
    form = format_of(path, format, topic)
    if form.read_graph is None:
        raise FormatError(path, None, f"{form.name} files hold {form.holds}, no measurements")
    weights = ChosenWeights(kappa, tau, unit_weights, mahalanobis)
    _check_choice("keep", keep, ("all", "first", "last"))
    if rotation_information is not None:
        _check_choice("rotation_information", rotation_information, _MEANINGS)
    weights_are = weights_are or "information"
    _check_choice("weights_are", weights_are, get_args(WeightsAre))
    options = ReadOptions(
        rotation_information,
        ignore_information=weights.override_all,
        weights_are=weights_are,
        skip_priors=not priors,
        skip_landmarks=not landmarks,
        progress=progress,
    )
    instance = form.read_graph(path, options)
    if rotation_information == "quaternion" and instance.graph.d == 2:
        raise InputError("rotational information on a quaternion is for 3D; in 2D use the angle")
    instance = _with_choices(instance, keep, weights)
    if truth is not None:
        instance = _with_truth(instance, Path(truth))
    _warn(path, () if quiet else instance.notices)
    return instance


def read_estimate(
    path: str | Path,
    instance: Instance | None = None,
    *,
    timestamps: str | Path = "ids",
    format: str | None = None,
    topic: str | None = None,
) -> Estimate:
    """Read one pose or rotation per node.

    Parameters
    ----------
    path : a g2o or PyFG (its vertices), TUM, KITTI, .npz, 1DSfM rotations, Bundler, COLMAP
        (images.txt), Open3D (JSON) or GLOMAP rotations file, or a bag of ROS
    instance : the graph the estimate is for, which determines the order of nodes and whether
        translations are needed. Without it the order is by ascending id, or the file's, and
        translations that are all zero are dropped.
    timestamps : meaning of the timestamps of a TUM file or bag: node ``"ids"``; none, as poses are
        in the order of nodes (``"index"``); or a file with the time of each node, one per line
    format : name of the format, if content and suffix do not determine it
    topic : of a bag, where several have poses

    Raises
    ------
    FormatError
        With path, line and what was expected there; or it is the estimate of another graph.
    InputError
        No path, but an object such as GTSAM's Values, which is for `certpgo.certify_values`.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import helix
    >>> instance = helix(3, np.random.default_rng(0))
    >>> certpgo.write("truth.tum", instance.truth, instance=instance, anchor="none")
    >>> estimate = certpgo.read_estimate("truth.tum", instance)
    >>> bool(abs(estimate.translations - instance.truth.translations).max() < 1e-12)
    True
    """
    path = file_of(path)
    poses = _poses(path, format, topic)
    try:
        poses = _labelled(poses, instance, timestamps)
        if instance is None:
            estimate = _in_own_order(poses)
        else:
            poses = _in_dimension(poses, instance.graph.d)
            with_translations = isinstance(instance.graph, PoseGraph)
            estimate = _of_nodes(instance, poses, with_translations)
    except FormatError:
        raise
    except InputError as error:
        raise FormatError(path, None, str(error)) from None
    _warn(path, poses.notices)
    return estimate


def read_truth(
    path: str | Path,
    instance: Instance,
    *,
    format: str | None = None,
    topic: str | None = None,
) -> tuple[IntArray, Estimate]:
    """Read ground truth, possibly of some nodes only.

    Parameters
    ----------
    path : a file of poses as for `read_estimate`, a Bundler file, or an iSAM file of noise-free
        relative poses, which are integrated along a spanning tree from the smallest id
    instance : the graph it is for; ids are matched, and ids not in the graph are ignored
    format : name of the format, if content and suffix do not determine it
    topic : of a bag, where several have poses

    Returns
    -------
    nodes : (k,) nodes with truth, ascending
    truth : their k poses, in that order

    Raises
    ------
    FormatError
        With path, line and what was expected there.
    """
    path = Path(path)
    form = format_of(path, format, topic)
    if form.read_poses is not None:
        poses = form.read_poses(path)
    elif form.read_graph is not None:
        poses = integrated(form.read_graph(path, ReadOptions(ignore_information=True)))
    else:
        raise FormatError(path, None, f"{form.name} files hold {form.holds}, no truth")
    try:
        poses = _labelled(poses, instance, "ids")
        found = truth_for(instance, _in_dimension(poses, instance.graph.d))
    except InputError as error:
        raise FormatError(path, None, str(error)) from None
    _warn(path, poses.notices)
    return found


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(f"{name} must be one of {', '.join(choices)}, not {value!r}")


def _warn(path: Path, notices: Iterable[str]) -> None:
    for notice in notices:
        warnings.warn(f"{path}: {notice}", InputNotice, stacklevel=3)


def _poses(path: Path, name: str | None, topic: str | None) -> LabelledPoses:
    form = format_of(path, name, topic)
    if form.read_poses is None:
        raise FormatError(path, None, f"{form.name} files hold {form.holds}, no estimate")
    return form.read_poses(path)


def _labelled(
    poses: LabelledPoses, instance: Instance | None, timestamps: str | Path
) -> LabelledPoses:
    """The poses with the ids of their nodes, from times or names if necessary."""
    ids = None if instance is None else instance.ids[: instance.world]
    if not poses.names:
        return with_node_ids(poses, ids, timestamps)
    graph = None if instance is None else instance.graph
    if isinstance(graph, PoseGraph) and graph.points is None:
        poses = poses.without_points()
    names = () if instance is None else instance.names[: instance.world]
    found, notice = named_ids(poses, ids, names)
    return replace(poses, ids=found, notices=(notice,) if notice else ())


def _with_choices(instance: Instance, keep: Keep, weights: ChosenWeights) -> Instance:
    instance = weights.apply(instance)
    graph, information = instance.graph, instance.information
    if keep != "all":
        kept = simple_edges(graph.num_nodes, graph.edges, keep)
        graph = graph.with_edges(kept)
        information = information and information.subset(kept)
    # An .npz file stores its options; only those chosen now replace them.
    options = {"keep": "all", "rotation_information": "tangent", "weights": "file"}
    options |= instance.options
    if keep != "all":
        options["keep"] = keep
    if str(weights) != "file":
        options["weights"] = str(weights)
    return replace(instance, graph=graph, options=options, information=information)


def _with_truth(instance: Instance, path: Path) -> Instance:
    nodes, estimate = read_truth(path, instance)
    n = instance.graph.num_nodes
    if instance.world is not None and np.array_equal(nodes, np.arange(n - 1)):
        nodes, estimate = np.arange(n), instance.with_world(estimate)
    if len(nodes) < n:
        raise InputError(f"{path}: truth for {len(nodes)} of {n} nodes only; use read_truth")
    return replace(instance, truth=estimate)


def _of_nodes(instance: Instance, poses: LabelledPoses, with_translations: bool) -> Estimate:
    """The poses of an instance's nodes; the world's is not among them, and points may not be."""
    ids, graph = instance.ids[: instance.world], instance.graph
    seen = graph.points if isinstance(graph, PoseGraph) else None
    if poses.points is not None and seen is None:
        poses = poses.without_points()
    if seen is None or poses.points is not None or not isinstance(graph, PoseGraph):
        return instance.with_world(estimate_for(ids, poses, with_translations))
    nodes = np.flatnonzero(~seen[: instance.world])
    of_poses = estimate_for(ids[nodes], poses, with_translations)
    whole = with_points(graph, of_poses, nodes)
    return instance.with_world(whole.subset(np.arange(len(ids))))


def _in_own_order(poses: LabelledPoses) -> Estimate:
    t = poses.translations
    if t is not None and not t.any():
        t = None
    try:
        estimate = Estimate(poses.rotations, t)
    except CertPGOError as error:
        raise InputError(str(error)) from None
    return estimate if poses.ids is None else estimate.subset(np.argsort(poses.ids))


def _in_dimension(poses: LabelledPoses, d: int) -> LabelledPoses:
    """Poses for a d-dimensional graph; planar poses embedded at z = 0 become 2D."""
    R, t = poses.rotations, poses.translations
    if R.shape[-1] == d:
        return poses
    planar = d == 2 and not R[:, 2, :2].any() and not R[:, :2, 2].any() and (R[:, 2, 2] > 0.0).all()
    if not planar or (t is not None and t[:, 2].any()):
        raise InputError(f"{R.shape[-1]}D poses, but the graph is {d}D")
    return replace(poses, rotations=R[:, :2, :2], translations=None if t is None else t[:, :2])

"""Reading graphs, estimates and ground truth from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from certpgo.errors import FormatError, InputError, require_path
from certpgo.graph import Graph, Instance
from certpgo.graph.edges import Keep, simple_edges
from certpgo.graph.held import with_held
from certpgo.io.chosen_weights import ChosenWeights
from certpgo.io.estimates import matched_truth, truth_in_words, warn_of
from certpgo.io.format import (
    AnyPath,
    Progress,
    ReadOptions,
    RotationInformation,
    WeightsAre,
    format_of,
)
from certpgo.io.matching import Matching

_MEANINGS = ("tangent", "quaternion", "rpy")


def read(
    path: AnyPath | Sequence[AnyPath],
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
    fixed: bool = True,
    skip: Sequence[str] = (),
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
        poses file, a bag of ROS with rtabmap's graph, a 1DSfM folder or its EGs.txt; or several
        files of one format of text, read as one graph: ids mean the same node in all, the first
        vertex of a node counts, and so does a measurement that several files have, as often as one
        of them has it
    keep : of parallel edges, ``"all"`` (their terms add), or the ``"first"`` or ``"last"``
    rotation_information : what the rotational information refers to: ``"tangent"`` (default of g2o
        and TORO), ``"quaternion"`` (its vector part, half the angle: kappa is a quarter) or
        ``"rpy"`` (default of iSAM; for small angles the same as tangent)
    kappa, tau : a concentration that replaces the file's wherever a rotation, or a translation, is
        measured; tau in 1/m^2
    unit_weights : both are 1 there, and ranges weigh 1
    mahalanobis : weigh rotations by all of the file's rotational information, so that their terms
        are its Mahalanobis distances to second order: half of Omega_theta in 2D, a matrix in 3D
    weights_are : what the numbers after a measurement are: ``"information"``, the default,
        ``"sqrt-information"`` (upper triangular) or ``"covariance"``, which some programs write in
        files of the same form; a PyFG file's are covariances
    priors : whether measurements of single poses and positions are read, as edges from one more
        node, the world (``Instance.world``); else they are skipped
    landmarks : whether points, what sees them and ranges to them are read; else they are skipped
    fixed : whether nodes that the file fixes are held where they are, see
        ``certpgo.graph.held.with_held``; else all are estimated. It matters where there are
        several, or priors
    skip : tags whose lines are left out, of files of tagged lines: measurements that are not known
        here; ``Instance.options["skip"]`` lists them
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
        Contradictory options, incomplete truth, or fixed nodes with distances.
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
    >>> instance.graph.num_nodes, instance.graph.kappa[0], instance.graph.tau[0]
    (4, np.float64(100.0), np.float64(25.0))
    >>> instance.ids
    array([10, 20, 30, 40])
    """
    paths: list[Any] = list(path) if isinstance(path, list | tuple) else [path]
    for one in paths:
        require_path(one, "a graph")
    if not paths:
        raise InputError("a file is expected, not an empty list")
    path, *also = map(Path, paths)
    form = format_of(path, format, topic)
    for other in also:
        found = format_of(other, format).name
        if not form.joins_files:
            said = f"several {form.name} files are not read as one graph: certpgo merge joins maps"
            raise FormatError(other, None, said)
        if found != form.name:
            said = f"{path} is a {form.name} file, and this one {found}: convert one of them"
            raise FormatError(other, None, said)
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
        ignore_variances=weights.unit,
        weights_are=weights_are,
        skip_priors=not priors,
        skip_landmarks=not landmarks,
        skip=(skip,) if isinstance(skip, str) else tuple(skip),
        also=tuple(also),
        progress=progress,
    )
    instance = form.read_graph(path, options)
    if rotation_information == "quaternion" and instance.graph.d == 2:
        raise InputError("rotational information on a quaternion is for 3D; in 2D use the angle")
    instance = with_held(_with_choices(instance, keep, rotation_information, weights), hold=fixed)
    if truth is not None:
        instance = _with_truth(instance, Path(truth))
    warn_of(path, () if quiet else instance.notices)
    return instance


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{name} must be one of {', '.join(choices)}, not {value!r}")


def _with_choices(
    instance: Instance, keep: Keep, about: str | None, weights: ChosenWeights
) -> Instance:
    # An .npz file stores its options; only those chosen now replace them.
    options = {"keep": "all", "rotation_information": about or "tangent", "weights": "file"}
    options |= instance.options
    instance = weights.apply(replace(instance, graph=_about(instance.graph, options)))
    graph = instance.graph
    if keep != "all":
        instance = instance.with_edges(simple_edges(graph.num_nodes, graph.edges, keep))
    if keep != "all":
        options["keep"] = keep
    if str(weights) != "file":
        options["weights"] = str(weights)
    return replace(instance, options=options)


def _about(graph: Graph, options: Mapping[str, str]) -> Graph:
    """The graph whose information says what its kappa was taken to be about.

    An .npz file may say it without the option, of a graph that was not read.
    """
    if graph.information is None:
        return graph
    if options["rotation_information"] != "quaternion":
        return graph
    return graph.with_information(replace(graph.information, about="quaternion"))


def _with_truth(instance: Instance, path: Path) -> Instance:
    nodes, estimate, found = matched_truth(path, instance, Matching())
    n = instance.graph.num_nodes
    if estimate.keys.are_positions:
        raise InputError(f"{path}: positions alone, without rotations; use read_truth")
    if instance.world is not None and np.array_equal(nodes, np.arange(n - 1)):
        nodes, estimate = np.arange(n), instance.with_world(estimate)
    if len(nodes) < n:
        raise InputError(f"{path}: truth for {len(nodes)} of {n} nodes only; use read_truth")
    said = () if found.is_plain else (f"{path}: {truth_in_words(found, instance)}",)
    return replace(instance, truth=estimate, notices=(*instance.notices, *said))

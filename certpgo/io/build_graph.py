"""From the contents of a file of tagged lines to a graph."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError, NoEdges, NoMeasurements
from certpgo.graph import Estimate, Graph, Instance, PoseGraph, RotationGraph, SimilarityGraph
from certpgo.graph.information import joined_information
from certpgo.graph.mounted import Frames, mounted
from certpgo.graph.phrases import counted, shown_path
from certpgo.graph.priors import origin_of, with_priors
from certpgo.graph.ranges import Ranges
from certpgo.io.compressed import uncompressed_name
from certpgo.io.dialect import Dialect
from certpgo.io.format import LabelledPoses, ReadOptions
from certpgo.io.lines import FARTHEST, UNINFORMED, read_lines
from certpgo.io.nodes import (
    Nodes,
    named_nodes,
    numbered_by_id,
    numbered_by_name,
    refuse_duplicates,
)
from certpgo.io.records import Records, Rows
from certpgo.io.several import counted_once, joined_name, joined_source, located
from certpgo.linalg.arrays import FloatArray, IntArray


def instance_from_lines(dialect: Dialect, path: Path, options: ReadOptions) -> Instance:
    """The instance in a file of tagged lines, or in several."""
    about, of_covariances = options.rotation_information, dialect.precision is not None
    if of_covariances and about not in (None, dialect.rotation_information):
        said = f"the rotational covariances are about tangents, not {about}"
        raise FormatError(path, None, said)
    if of_covariances and options.weights_are == "sqrt-information":
        raise FormatError(path, None, "the numbers are covariances, not sqrt-information")
    paths = (path, *options.also)
    content, firsts = read_lines(paths, dialect, options)
    with located(paths, firsts):
        counted_once(content, path, firsts)
        instance = _instance(dialect, path, options, content)
    if len(paths) == 1:
        return instance
    chosen = {**instance.options, "also": ", ".join(shown_path(one) for one in options.also)}
    return replace(instance, name=joined_name(paths), source=joined_source(paths), options=chosen)


def _instance(dialect: Dialect, path: Path, options: ReadOptions, content: Records) -> Instance:
    """The instance of these contents."""
    _refuse_no_edges(path, dialect, content)
    if dialect.named:
        nodes, rows = numbered_by_name(path, content, skip_landmarks=options.skip_landmarks)
    else:
        nodes, rows = numbered_by_id(path, content)
    measured, priors = Rows.joined([rows["edge"], rows["sighting"]]), rows["prior"]
    _refuse_far(path, nodes.ids, measured)
    _refuse_far(path, nodes.ids, priors)
    unit = min(nodes.fixed, default=0)
    of_poses = dialect.named or nodes.points is not None or measured.translations.any()
    graph = _graph(nodes, measured, unit, with_translations=bool(of_poses or len(priors)))
    notices = _notices(content, nodes, graph, len(rows["sighting"]))
    if graph.has_scales:
        nodes, notice = in_unit_of(nodes, unit)
        notices.append(notice)
    initial, world, origin = nodes.values, None, None
    if not graph.has_positions:
        initial = initial and Estimate(initial.rotations)
    elif len(priors):
        graph, origin, notice = anchored(graph, priors)
        notices.append(notice)
        world, nodes = len(nodes.ids), nodes.with_world(path)
        graph = _of_bodies(graph, nodes.mounts)
    chosen = _choices(dialect, options, content.counts[UNINFORMED], len(measured))
    if "weights_are" in chosen and not dialect.precision:
        kind = options.weights_are
        notices.append(f"the numbers of a measurement's precision are read as its {kind}")
    ranges = _ranges(graph.num_nodes, rows.get("range"))
    if graph.has_positions and ranges is not None:
        graph = graph.with_ranges(ranges)
        notices.append(counted(ranges.num_edges, "range{s}"))
    instance = Instance(
        name=uncompressed_name(path).stem,
        graph=graph,
        ids=nodes.ids,
        fixed=nodes.fixed,
        source=str(path),
        options=chosen,
        notices=tuple(notices),
        counts=content.counts,
        names=nodes.names,
        world=world,
        origin=origin,
        apart=nodes.apart,
        moved_by=nodes.moved_by,
        times_ns=nodes.times_ns,
        camera=content.camera,
    )
    return replace(instance, initial=None if initial is None else instance.with_world(initial))


def in_unit_of(nodes: Nodes, unit: int) -> tuple[Nodes, str]:
    """The nodes with their initial values in the unit of one of them, and a notice that says so."""
    said = f"the scale of node {nodes.ids[unit]} is 1, the unit of the map"
    values = nodes.values
    if values is None or values.scales is None or values.translations is None:
        return nodes, said
    one = float(values.scales[unit])
    scaled = Estimate(values.rotations, values.translations / one, values.keys, values.scales / one)
    return replace(nodes, values=scaled), said if one == 1.0 else f"{said}; it was {one:.6g}"


def poses_from_lines(dialect: Dialect, path: Path) -> LabelledPoses:
    """The poses and points on the vertex lines of a file."""
    content, _ = read_lines(
        [path], dialect, ReadOptions(ignore_information=True, ignore_variances=True)
    )
    if dialect.named:
        nodes, values = named_nodes(path, content)
        keys = None, nodes.times_ns, nodes.names, nodes.points
        return LabelledPoses(values.rotations, values.translations, *keys)
    poses, points = content.take("pose"), content.take("point")
    if not len(poses):
        raise FormatError(path, None, "no vertex lines")
    vertices = Rows.joined([poses, points])
    ids = vertices.nodes[:, 0]
    refuse_duplicates(path, ids, vertices.lines)
    is_point = np.arange(len(ids)) >= len(poses) if len(points) else None
    scales = vertices.scales if len(vertices.scales) else None
    R, t, camera = vertices.rotations, vertices.translations, content.camera
    return LabelledPoses(R, t, ids, points=is_point, scales=scales, camera=camera)


def _refuse_no_edges(path: Path, dialect: Dialect, content: Records) -> None:
    known = content.rows.keys()
    if known & {"edge", "sighting"}:
        return
    said = "no edges: this is an estimate, not a graph"
    if beside := [f"{kind}s" for kind in ("prior", "range") if kind in known]:
        said = "no edges: measurements between poses, or of points, expected with "
        said += " and ".join(beside)
        if dialect.named:
            raise FormatError(path, None, said)
    if "pose" in known:
        raise NoMeasurements(path, None, said, content.counts)
    raise NoEdges(path, None, "no edges", content.counts)


def _refuse_far(path: Path, ids: IntArray, rows: Rows) -> None:
    """Refuse a translation whose square, times a weight, may be beyond the range of doubles."""
    largest = np.abs(rows.translations).max(axis=1, initial=0.0)
    if len(rows) and largest.max() > FARTHEST:
        row = int(np.argmax(largest))
        i, j = ids[rows.nodes[row][[0, -1]]]
        said = f"edge {i} to {j}: translations up to {FARTHEST:.0e} expected, not {largest[row]:g}"
        raise FormatError(path, None, said)


def _graph(nodes: Nodes, measured: Rows, unit: int, *, with_translations: bool) -> Graph:
    """Measurements between poses, then those of points; of similarities, a node has scale 1."""
    n, R, kappa = len(nodes.ids), measured.rotations, measured.kappa
    rotation = RotationGraph(n, measured.nodes, R, kappa)
    if len(measured.scales):
        free = np.arange(n) != unit
        t, tau, scales = measured.translations, measured.tau, measured.scales
        return SimilarityGraph(rotation, t, tau, scales=scales, free=free)
    if not with_translations:
        return rotation
    return PoseGraph(
        rotation,
        measured.translations,
        measured.tau,
        points=nodes.points,
        information=measured.information,
    )


def anchored(graph: Graph, priors: Rows) -> tuple[Graph, FloatArray | None, str]:
    """The graph with the world as its last node, the world's origin, and a notice."""
    placed = priors.tau > 0.0
    origin = origin_of(priors.translations[placed])
    joined = with_priors(
        graph,
        priors.nodes[:, 0],
        priors.rotations if priors.kappa.any() else None,
        # Where an attitude alone is said to be means nothing.
        np.where(placed[:, None], priors.translations - origin, 0.0) if placed.any() else None,
        kappa=priors.kappa,
        tau=priors.tau,
    )
    stated, m = joined.information, graph.num_edges + len(priors)
    place = stated and stated[np.arange(m, joined.num_edges)]
    both = joined_information([graph.information, priors.information, place])
    said = counted(len(priors), "prior{s}, measured from a node that stands for the world")
    for alone, what in ((priors.kappa == 0.0, "positions"), (~placed, "attitudes")):
        if alone.any():
            said += f"; {int(alone.sum())} of them {what} alone"
    return joined.with_information(both), origin if origin.any() else None, said


def _of_bodies(graph: Graph, mounts: Frames | None) -> Graph:
    """The graph whose last measurements, the priors, are of sensors that are on their bodies."""
    if mounts is None:
        return graph
    none = Frames.none(graph.num_edges, graph.d)
    m = graph.num_measurements
    of_priors = slice(m - len(mounts.translations), m)
    second = Frames(none.rotations.copy(), none.translations.copy())
    second.rotations[of_priors] = mounts.rotations
    second.translations[of_priors] = mounts.translations
    return mounted(graph, graph.edges, none, second)


def _ranges(num_nodes: int, rows: Rows | None) -> Ranges | None:
    if rows is None or not len(rows):
        return None
    return Ranges(num_nodes, rows.nodes, rows.translations[:, 0], rows.tau)


def _choices(
    dialect: Dialect, options: ReadOptions, uninformed: int, measurements: int
) -> dict[str, str]:
    """The reading options of the instance."""
    about = options.rotation_information or dialect.rotation_information
    chosen: dict[str, str] = {"rotation_information": about}
    if uninformed:
        chosen["information"] = "none" if uninformed == measurements else "some"
    if options.skip:
        chosen["skip"] = ", ".join(options.skip)
    if (kind := dialect.precision or options.weights_are) != "information":
        chosen["weights_are"] = kind
    return chosen


def _notices(content: Records, nodes: Nodes, graph: Graph, sightings: int) -> list[str]:
    notices = [counted(count, what) for what, count in content.counts.items() if count]
    if nodes.points is not None:
        points = counted(int(nodes.points.sum()), "point{s}")
        moved = f"; point k has the id k + {nodes.moved_by}" if nodes.moved_by else ""
        notices.append(f"{points}, {counted(sightings, 'sighting{s}')}{moved}")
    if not graph.has_positions:
        notices.append("all translations are zero: read as a rotation graph")
    if len(content.cameras) > 1:
        notices.append(f"{len(content.cameras)} different cameras: they are not kept")
    if nodes.unvalued:
        said = "node{s} without a vertex line: no initial values"
        notices.append(counted(nodes.unvalued, said))
    return notices

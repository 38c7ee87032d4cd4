"""A scene as data for the pages' script."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from certpgo.graph.kinds import PRIORS, Kind
from certpgo.graph.phrases import counted
from certpgo.io.surfaces import Surface
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.view.scene import Placement, Scene
from certpgo.view.sureness import COVARIANCES, REGIONS

#: Edges drawn at most: the costliest, and the others sampled evenly.
EDGES = 20_000
#: Share of these reserved for the costliest.
COSTLIEST = 0.1
#: Poses drawn at most with a frustum.
FRUSTA = 150
#: Points of a cloud drawn at most.
CLOUD = 15_000
#: Of what surrounds nodes, as style sheets call it.
INKS = {REGIONS: "good", COVARIANCES: "c3"}
#: Of points without a colour.
GREY = 128
#: Kinds of edges, in data.
BETWEEN, SIGHTING, PRIOR, RANGE = 0, 1, 2, 3
_CODES = {SIGHTING: [Kind.SIGHTING], PRIOR: PRIORS, RANGE: [Kind.RANGE]}

Data = dict[str, Any]


def page_scene(
    scene: Scene, costs: FloatArray, *, limit: int = EDGES, rejected: IntArray | None = None
) -> Data:
    """Positions, edges and residuals of a scene's answer for the pages' script.

    Parameters
    ----------
    scene : of a graph; the last placement is the answer, the first is "before"
    costs : (m,) terms of F of its edges at the answer
    limit : maximal number of edges drawn
    rejected : (r, 2) nodes of measurements that the answer does without, which are not its edges

    Returns
    -------
    ``dimensions``; ``points`` (k, 2 or 3) with ``ids``; ``frame``, the ``centre`` and the ``axes``
    of the box; ``edges`` (e, 2) into the points, with their ``numbers`` in the graph and whether
    each is a ``loop`` closure (between nodes whose ids are not consecutive); ``measures``, each
    with ``unit``, ``values`` (e,), `NOT_MEASURED` for what an edge does not measure, and the
    ``top`` of its colours; ``ends``, the first and the last pose if positions are measured;
    ``frusta`` (s, 2, 2 or 3); ``metric``, whether positions were estimated; ``length``, their unit;
    ``flat``, whether all is in a plane; ``sentences`` on what is shown. Where there is another
    estimate, ``before`` with its name, points, values and frusta; where the truth is known,
    ``truth``, its steps (s, 2, 2 or 3).
    Where there are landmarks or a world or distances, ``landmarks`` (k,) flags, and ``kinds`` (e,)
    of edges: the ends of a `PRIOR` are both the measured node. Where there are clouds or meshes,
    ``cloud``, a sample of their points (p, 3) with ``colours`` (p,); of rejected measurements,
    ``rejected`` (r, 2, 3). With a certificate, ``outlines``, each with its ``name``, ``ink``,
    ``points`` (k, 2 or 3) and ``shapes``, see `certpgo.view.sureness.Outlines`.
    """
    answer = scene.placements[-1]
    drawn = _chosen(costs, limit)
    nodes = np.unique(scene.edges[drawn])
    count = len(answer.nodes)
    if count <= limit:
        nodes = np.arange(count)
    kinds = np.select([scene.are(*of) for of in _CODES.values()], list(_CODES), BETWEEN)
    sentences = [scene.sentence, *_said(scene)]
    if len(drawn) < len(scene.edges):
        sentences.append(
            f"{len(drawn):,} of {len(scene.edges):,} edges are drawn: the "
            f"{int(COSTLIEST * limit):,} costliest, and the others sampled evenly."
        )
    if len(nodes) < count:
        sentences.append(f"Of {count:,} nodes, the {len(nodes):,} at these edges are drawn.")
    # A layout of planar rotations is planar, as the graph is; one in space may be flat too.
    d = scene.d
    rounding = _decimals(answer.positions)
    poses = answer.nodes[scene.poses(answer)]
    more: Data = {}
    if (kinds != BETWEEN).any():
        more["landmarks"] = scene.landmarks[nodes].astype(int).tolist()
        more["kinds"] = kinds[drawn].tolist()
    if scene.surfaces:
        more["cloud"] = _cloud([surface for _, surface in scene.surfaces], rounding)
        sentences.append(f"Of points, {len(more['cloud']['points']):,} are drawn at most.")
    if rejected is not None and len(rejected):
        more["rejected"] = _rounded(answer.spread(len(scene.ids))[rejected, :d], rounding)
        sentences.append(f"Red: {counted(len(rejected), 'rejected edge{s}')}.")
    if scene.outlines:
        more["outlines"] = [
            {
                "name": outlines.name,
                "ink": INKS[outlines.name],
                "points": _rounded(outlines.centres[:, :d], rounding),
                "shapes": [[_values(row) for row in one] for one in outlines.shapes[:, :d, :d]],
            }
            for outlines in scene.outlines
        ]
        sentences += [outlines.sentence for outlines in scene.outlines]
    if len(scene.placements) > 1:
        before = scene.placements[0]
        more["before"] = {
            "name": before.name,
            "points": _rounded(before.spread(len(scene.ids))[nodes, :d], rounding),
            "values": [_values(m.values[drawn]) for m in before.measures],
            "frusta": _frusta(scene, before, rounding),
        }
    if scene.truth is not None and scene.metric:
        sentences.append("The thin line is the ground truth, aligned with the estimate.")
        more["truth"] = _rounded(scene.steps(scene.truth)[:limit, :, :d], rounding)
    return {
        **more,
        "dimensions": d,
        "points": _rounded(answer.spread(len(scene.ids))[nodes, :d], rounding),
        "frame": {
            "centre": _rounded(scene.frame.centre[:d], rounding),
            "axes": _rounded(scene.frame.axes[:d, :d], 6),
        },
        "ids": scene.ids[nodes].tolist(),
        "edges": np.searchsorted(nodes, scene.edges[drawn]).tolist(),
        "numbers": drawn.tolist(),
        "loop": (~scene.are_steps[drawn]).astype(int).tolist(),
        "measures": [
            {
                "unit": measure.unit,
                "values": _values(measure.values[drawn]),
                "top": float(f"{measure.top:.3g}"),
            }
            for measure in answer.measures
        ],
        "ends": np.flatnonzero(np.isin(nodes, poses[[0, -1]])).tolist() if scene.metric else [],
        "frusta": _frusta(scene, answer, rounding),
        "metric": scene.metric,
        "length": scene.length_unit,
        "flat": scene.is_flat,
        "sentences": sentences,
    }


def _cloud(surfaces: Sequence[Surface], decimals: int) -> Data:
    """Points (p, 3) sampled evenly, with colours as CSS has them; grey where there are none."""
    points = np.concatenate([surface.points for surface in surfaces])
    colours = np.concatenate(
        [
            np.full((len(s.points), 3), GREY, np.uint8) if s.colours is None else s.colours
            for s in surfaces
        ]
    )
    drawn = np.random.default_rng(0).permutation(len(points))[:CLOUD]
    return {
        "points": _rounded(points[drawn], decimals),
        "colours": [bytes(colour).hex() for colour in colours[drawn].astype(np.uint8)],
    }


def _frusta(scene: Scene, placement: Placement, decimals: int) -> Any:
    """Lines (s, 2, 2 or 3) of few poses; of graphs of positions only where there are few."""
    if scene.metric and len(placement.nodes) > FRUSTA:
        return []
    return _rounded(scene.frusta(placement, FRUSTA)[..., : scene.d], decimals)


def _said(scene: Scene) -> list[str]:
    """How landmarks, priors and distances are drawn, where there are any."""
    said = []
    if scene.landmarks.any():
        said.append(f"Drawn as dots: {counted(int(scene.landmarks.sum()), 'landmark{s}')}.")
    if count := int(scene.are(*PRIORS).sum()):
        priors = counted(count, "prior{s}")
        said.append(f"Drawn as rings, at the nodes that they measure: {priors}.")
    faint = {kind: int(scene.are(kind).sum()) for kind in (Kind.SIGHTING, Kind.RANGE)}
    if drawn := [counted(count, kind.phrase) for kind, count in faint.items() if count]:
        said.append(f"Drawn as faint lines: {', '.join(drawn)}.")
    return said


def _chosen(costs: FloatArray, limit: int) -> IntArray:
    """Indices of the drawn edges, ascending."""
    m = len(costs)
    if m <= limit:
        return np.arange(m)
    order = np.argsort(-costs, kind="stable")
    worst = int(COSTLIEST * limit)
    others = np.sort(order[worst:])
    evenly = others[np.linspace(0, len(others) - 1, limit - worst).round().astype(int)]
    return np.sort(np.concatenate([order[:worst], evenly]))


def _values(values: FloatArray) -> list[float]:
    return [float(f"{value:.4g}") for value in values.tolist()]


def _decimals(points: FloatArray) -> int:
    """Decimals for about 1e-5 of the extent of points."""
    extent = float(np.ptp(points, axis=0).max(initial=0.0))
    return 5 - int(np.floor(np.log10(extent))) if extent > 0.0 else 5


def _rounded(points: FloatArray, decimals: int) -> Any:
    return (np.round(points, decimals) + 0.0).tolist()

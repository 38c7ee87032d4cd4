"""Small SVG pictures of trajectories and of graphs, without a library."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo.linalg.arrays import FloatArray, IntArray

#: How far the view looks down on the plane that positions lie nearest to, degrees.
ELEVATION = 60.0
#: Edge of a picture and its margin, pixels; points and edges drawn at most.
SIZE, MARGIN, POINTS, EDGES = 220.0, 8.0, 800, 400
_OPEN = f'<svg width="{SIZE:.0f}" height="{SIZE:.0f}" viewBox="0 0 {SIZE:.0f} {SIZE:.0f}"'


def principal_frame(t: FloatArray) -> FloatArray:
    """Principal axes of positions (n, d) as rows, each with its largest component positive."""
    axes = np.linalg.svd(t - t.mean(axis=0), full_matrices=False)[2]
    largest = np.argmax(np.abs(axes), axis=1)
    return np.asarray(axes * np.sign(axes[range(len(axes)), largest])[:, None])


def seen(t: FloatArray, frame: FloatArray) -> FloatArray:
    """Positions (n, 3) as seen on the plane of a picture, (n, 2)."""
    along, across, up = (t @ frame.T).T
    tilt = np.radians(ELEVATION)
    return np.stack([along, np.sin(tilt) * across + np.cos(tilt) * up], axis=1)


def flat(t: FloatArray) -> FloatArray:
    """Positions (n, d) on the plane of a picture, (n, 2); those in the plane stay as they are."""
    return t if t.shape[1] == 2 or len(t) < 3 else seen(t, principal_frame(t))


def closures(edges: IntArray) -> IntArray:
    """(k, 2) distinct pairs that are no step from one node to the next."""
    pairs = np.unique(np.sort(edges, axis=1), axis=0)
    return np.asarray(pairs[pairs[:, 1] - pairs[:, 0] > 1])


def drawn(t: FloatArray, edges: IntArray, path: IntArray) -> str:
    """Positions (n, d) as an SVG element: a path through nodes, over edges (k, 2); or empty."""
    if len(path) < 2 or not np.isfinite(t).all():
        return ""
    at = _in_pixels(flat(t)[:, :2])
    steps = path[_sample(len(path), POINTS)]
    (x, y), (u, v) = at[path[0]], at[path[-1]]
    line = " ".join(f"{a:.1f},{b:.1f}" for a, b in at[steps])
    return (
        f'{_OPEN} role="img" aria-label="trajectory" fill="none">{_chords(at, edges)}'
        f'<polyline points="{line}" stroke="#0072B2" stroke-width="1.3"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="#009E73"><title>start</title></circle>'
        f'<circle cx="{u:.1f}" cy="{v:.1f}" r="3.5" fill="#D55E00"><title>end</title></circle>'
        "</svg>"
    )


def circle_of(n: int, edges: IntArray) -> str:
    """Nodes on a circle, in their order, and edges (m, 2) as chords: an SVG element."""
    turn = 2.0 * np.pi * np.arange(n) / n
    at = _in_pixels(np.stack([np.sin(turn), np.cos(turn)], axis=1))
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.6"/>' for x, y in at[_sample(n, EDGES)])
    return (
        f'{_OPEN} role="img" aria-label="graph" fill="none">{_chords(at, edges)}'
        f'<g fill="#0072B2">{dots}</g></svg>'
    )


def _chords(at: FloatArray, edges: IntArray) -> str:
    def lines() -> Iterator[str]:
        for (x, y), (u, v) in at[edges[_sample(len(edges), EDGES)]]:
            yield f"M{x:.1f},{y:.1f}L{u:.1f},{v:.1f}"

    return f'<path d="{"".join(lines())}" stroke="currentColor" stroke-width="0.4" opacity="0.5"/>'


def _in_pixels(at: FloatArray) -> FloatArray:
    """Positions (n, 2) within the margins, of one scale, centred, y upwards."""
    low, extent = at.min(axis=0), np.ptp(at, axis=0)
    inner = SIZE - 2.0 * MARGIN
    scale = inner / max(float(extent.max()), 1e-300)
    moved = scale * (at - low) + 0.5 * (inner - scale * extent) + MARGIN
    return np.stack([moved[:, 0], SIZE - moved[:, 1]], axis=1)


def _sample(count: int, most: int) -> IntArray:
    """At most that many indices below ``count``, evenly spaced, the last included."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.intp)

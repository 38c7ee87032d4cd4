"""Errors of one sensor: its unit, its frame and place on the poses, and the drift of turns."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.planted import N, changed, walk, with_positions
from strategies import rng_of

import certpgo
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.sensors import _errors
from certpgo.diagnosis.study import study
from certpgo.diagnosis.systematic import score
from certpgo.linalg import rotations as so

ODOMETRY, CLOSURES = np.s_[: N - 1], np.s_[N - 1 :]
CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def place(d):
    return np.array([1.0, -0.6, 0.8])[:d]


def of(instance, rows, way):
    graph = instance.graph
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[rows], t[rows] = way(R[rows], t[rows])
    return changed(instance, rotations=R, translations=t)


def in_frame(C, a):
    """Motions of a sensor that is at (C, a) on the body."""
    return lambda R, t: (C.T @ R @ C, (t + R @ a - a) @ C)


def turn(d):
    return so.exp(np.array([[0.4]] if d == 2 else [[0.2, -0.3, 0.4]]))[0]


def bias(d):
    turned = np.zeros((1, so.tangent_dim(d)))
    turned[0, -1] = 0.03
    return lambda R, t: (R @ so.exp(turned), t)


OF_EDGES = {
    "odometry-scaled": (ODOMETRY, lambda d: lambda R, t: (R, 1.2 * t)),
    "odometry-turn-bias": (ODOMETRY, bias),
    "closures-feet": (CLOSURES, lambda d: lambda R, t: (R, t / 0.3048)),
    "closures-turned": (CLOSURES, lambda d: in_frame(turn(d), np.zeros(d))),
    "closures-lever-arm": (CLOSURES, lambda d: in_frame(np.eye(d), place(d))),
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", OF_EDGES)
def test_errors_of_odometry_and_closures(kind, d):
    rows, way = OF_EDGES[kind]
    [found, *_] = certpgo.diagnose(of(walk(d), rows, way(d))).findings
    assert found.kind == kind
    assert found.cost < 0.7 * found.cost_as_given
    if kind == "closures-lever-arm":
        at = found.next.partition("(")[2].partition(")")[0]
        np.testing.assert_allclose([float(x) for x in at.split(",")], place(d), atol=0.15)


def positions_of(d, way):
    instance = walk(d)
    best = certpgo.solve(instance).estimate
    rng = rng_of(d)
    t = way(best.rotations, best.translations) + 0.05 * rng.standard_normal((N, d))
    return with_positions(instance, t - t.mean(axis=0), 0.05)


POSITIONS = {
    "positions-feet": lambda R, t: t / 0.3048,
    "positions-mirrored": lambda R, t: t[:, [1, 0, 2][: t.shape[1]]],
    "positions-lever-arm": lambda R, t: t + R @ place(t.shape[1]),
    None: lambda R, t: t @ turn(t.shape[1]),  # the world may be turned
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", POSITIONS)
def test_errors_of_positions(kind, d):
    found = certpgo.diagnose(positions_of(d, POSITIONS[kind])).findings
    assert [finding.kind for finding in found[:1]] == ([kind] if kind else [])


@pytest.mark.parametrize("first", ["latitude", "longitude"])
def test_latitudes_that_were_taken_for_metres(first):
    middle, radius = np.array([48.0, 11.0]), 6_371_000.0

    def degrees(R, t):
        north, east = np.degrees(t[:, 1] / radius), np.degrees(t[:, 0] / radius)
        both = np.stack([north, east / np.cos(np.radians(middle[0]))], axis=1)
        return both if first == "latitude" else both[:, ::-1]

    instance = positions_of(2, lambda R, t: t)
    graph = instance.graph
    rows = instance.measurements.are(certpgo.graph.kinds.Kind.POSITION)
    t = graph.translations.copy()
    t[rows] = degrees(None, t[rows])
    origin = middle if first == "latitude" else middle[::-1]
    wrong = replace(instance, graph=replace(graph, translations=t), origin=origin)
    [found, *_] = certpgo.diagnose(wrong).findings
    assert found.kind == "positions-degrees"
    assert f"{first} first" in found.said


def sightings(d, way, path):
    """A file of a walk in which each of ten points is seen from six poses."""
    instance, rng = walk(d), rng_of(d + 7)
    best = certpgo.solve(instance).estimate
    points = best.translations[rng.choice(N, 10)] + rng.standard_normal((10, d))
    pairs = [(i, k) for k in range(10) for i in rng.choice(N, 6, replace=False)]
    certpgo.write(path, instance)
    kept = [line for line in path.read_text().splitlines() if line.startswith("EDGE")]
    lines = ["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"] if d == 3 else []
    for i, k in pairs:
        y = best.rotations[i].T @ (points[k] - best.translations[i])
        y = way(y + 0.05 * rng.standard_normal(d))
        tag, sensor = ("EDGE_SE2_XY", "") if d == 2 else ("EDGE_SE3_TRACKXYZ", " 0")
        weights = "400 0 400" if d == 2 else "400 0 0 400 0 400"
        lines.append(f"{tag} {i} {N + k}{sensor} {' '.join(map(repr, y.tolist()))} {weights}")
    path.write_text("\n".join([*kept, *lines]) + "\n")
    return certpgo.read(path, quiet=True)


SIGHTINGS = {
    "sightings-feet": lambda d: lambda y: y / 0.3048,
    "sightings-turned": lambda d: lambda y: y @ (CAMERA if d == 3 else turn(2)),
    "sightings-lever-arm": lambda d: lambda y: y - place(d),
    "sightings-mirrored": lambda d: lambda y: y * np.array([1.0, -1.0, 1.0])[:d],
    None: lambda d: lambda y: y,
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("kind", SIGHTINGS)
def test_errors_of_sightings(kind, d, tmp_path):
    seen = sightings(d, SIGHTINGS[kind](d), tmp_path / "seen.g2o")
    found = certpgo.diagnose(seen, time_limit=0.3).findings  # of a broken map nothing is proven
    assert [finding.kind for finding in found[:1]] == ([kind] if kind else [])
    if d == 3 and kind == "sightings-turned":
        assert "120 degrees" in found[0].said


@pytest.mark.parametrize("d", [2, 3])
def test_slopes_are_derivatives_of_residuals(d):
    """By differences of the squared residuals of one estimate, of a sensor that is elsewhere."""
    examined = Examined(of(walk(d), CLOSURES, in_frame(turn(d), place(d))))
    graph, posed = examined.instance.graph, examined.studied
    for error in _errors(examined):
        moved = replace(error, arm=0.1 * place(d)) if error.carried.any() else error
        read = moved.read(graph)
        fit = study(replace(posed, measured=read), examined.answer.estimate, examined.anchor)
        slopes = [*moved.slopes(fit, read)]
        pairs = zip(fit.parts, slopes, strict=True)
        gradient = 2.0 * sum(np.einsum("kr,krc->c", part.residuals, B) for part, B in pairs)
        for k, expected in enumerate(gradient):
            step = 1e-6 * np.eye(len(gradient))[k]
            reads = [moved.moved(sign * step).read(graph) for sign in (1.0, -1.0)]
            high, low = (replace(posed, measured=one).cost(fit.estimate) for one in reads)
            assert (high - low) / 2e-6 == pytest.approx(expected, rel=0.02, abs=1.0)
        assert score(moved, fit, read).left <= fit.fit.chi2


def test_a_sensor_that_is_read_where_it_is_leaves_the_cost_of_the_body():
    right = walk(3)
    poses = certpgo.solve(right).estimate
    wrong = of(right, CLOSURES, in_frame(turn(3), place(3)))
    [error] = [one for one in _errors(Examined(wrong)) if one.of == "loop closures"]
    read = replace(error, turn=turn(3), arm=place(3)).read(wrong.graph)
    # Under F only rotations say the same of the sensor and the body.
    turned = certpgo.Quadratic(read.rotations_alone).cost(poses.with_translations(None))
    alone = certpgo.Quadratic(right.graph.rotations_alone).cost(poses.with_translations(None))
    assert turned == pytest.approx(alone, rel=1e-9)

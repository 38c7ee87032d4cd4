"""Certified regions and covariances around the nodes of a map: the numbers that are drawn."""

import json
import re

import numpy as np
import pytest
from mixtures import scaled_mixture
from strategies import point_graph, pose_graph, rng_of, rotation_graph

import certpgo
from certpgo import Instance, Marginals, PoseGraph, Verdict, certify, solve
from certpgo.graph import Estimate, RotationGraph
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so
from certpgo.solve.assessment import assess
from certpgo.solve.likelihood import LEVEL, excesses, quantiles_of_nodes
from certpgo.view import sureness
from certpgo.view.caption import legend
from certpgo.view.certificate_page import Origin, certificate_page
from certpgo.view.load_scene import scene_of
from certpgo.view.page_scene import page_scene
from certpgo.view.sureness import COVARIANCES, REGIONS

KINDS = ("poses", "points", "priors", "bounded", "rejected")


def answered(kind, d=2):
    """An instance and its answer, with measurements of a kind."""
    rng = rng_of(3)
    if kind == "points":
        graph = point_graph(rng, 8, 4, d, noise=0.02)[0]
    elif kind == "bounded":
        # Few distances that do not agree with odometry: their relaxation is loose.
        rng, n, m = rng_of(0), 7, 8
        graph, R, t = pose_graph(rng, n, d, extra=0, noise=0.1)
        pairs = np.array([rng.choice(n, 2, replace=False) for _ in range(m)])
        lengths = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
        lengths = np.abs(lengths + rng.standard_normal(m))
        graph = graph.with_ranges(certpgo.Ranges(n, pairs, lengths, np.full(m, 50.0)))
    else:
        graph, R, t = pose_graph(rng, 8, d, extra=12, noise=0.02)
    if kind == "rejected":
        rotations = graph.rotations.copy()
        rotations[-1] = -rotations[-1]
        wrong = RotationGraph(8, graph.edges, rotations, 100.0 * graph.kappa)
        wrong = PoseGraph(wrong, graph.translations, 100.0 * graph.tau)
        answer = certpgo.solve_robustly(wrong)
        assert len(answer.rejected)
        return Instance("wrong", wrong, np.arange(8)), answer
    n = graph.num_nodes
    if kind == "priors":
        # Where the world is seen from one side.
        Q = so.random(rng, 1, d)[0]
        fixed = certpgo.with_priors(
            graph, np.arange(8), rotations=Q @ R, kappa=10.0, translations=t @ Q.T, tau=2.0
        )
        instance = Instance("fixed", fixed, np.arange(9), world=8)
        return instance, solve(instance)
    instance = Instance("graph", graph, 10 + np.arange(n))
    return instance, solve(instance)


def of_any_size(scene):
    """All outlines of an answer by name, larger ones than the map too."""
    placed = scene.placements[-1]
    found = scene.sureness.outlines(placed.nodes, placed.positions, np.inf)
    return {one.name: one for one in found}


@pytest.mark.parametrize("kind", KINDS)
def test_circles_are_regions_and_ellipses_are_covariances(kind):
    instance, answer = answered(kind)
    scene = scene_of(instance, answer)
    outlines = of_any_size(scene)
    regions = answer.regions()
    d, reference = scene.d, regions.reference
    drawn = outlines[REGIONS]
    radii = np.sqrt(drawn.shapes[:, 0, 0])
    assert drawn.shapes[:, :d, :d] == pytest.approx(radii[:, None, None] ** 2 * np.eye(d))
    assert radii == pytest.approx(regions.metres[drawn.nodes], rel=1e-12)
    placed = scene.placements[-1].spread(len(scene.ids))
    assert np.array_equal(drawn.centres, placed[drawn.nodes])
    assert reference not in drawn.nodes
    if kind == "bounded":
        assert answer.verdict is Verdict.BOUNDED
    # Covariances in the frame of the picture, relative to the same pose.
    there, local = instance.in_world(answer.estimate), outlines[COVARIANCES]
    world = instance.world
    framed = answer.estimate if world is None else answer.estimate.anchored(world)
    marginals = Marginals(answer.problem, framed, reference, instance.held)
    quantiles = quantiles_of_nodes(answer.problem, LEVEL)
    for node, shape in zip(local.nodes.tolist(), local.shapes, strict=True):
        R = np.eye(d) if instance.graph.is_point[node] else there.rotations[node]
        own = quantiles[node] * R @ marginals.covariance(node)[:d, :d] @ R.T
        np.testing.assert_allclose(shape[:d, :d], own, rtol=1e-6, atol=1e-9 * np.trace(own))
    if kind != "bounded":
        # A ball holds the ellipsoid of its node, which is local.
        for node, radius in zip(drawn.nodes.tolist(), radii, strict=True):
            [at] = np.flatnonzero(local.nodes == node)
            assert radius**2 >= 0.999 * np.linalg.eigvalsh(local.shapes[at])[-1]


@pytest.mark.parametrize("kind", KINDS)
def test_no_estimate_of_low_cost_is_outside_of_a_circle(kind):
    instance, answer = answered(kind)
    problem, best, rng = answer.problem, answer.estimate, rng_of(5)
    drawn = of_any_size(scene_of(instance, answer))[REGIONS]
    reference, d, tried = answer.regions().reference, problem.d, 0
    most = answer.certificate.cost_upper + excesses(problem, LEVEL)
    for size in np.repeat(10.0 ** np.arange(-4.0, 1.0, 0.25), 4):
        R = best.rotations @ so.exp(size * rng.standard_normal((problem.n, so.tangent_dim(d))))
        t = best.translations + size * rng.standard_normal(best.translations.shape)
        other = Estimate(R, t)
        cost = problem.cost(other)
        seen, own = (
            (x.translations - x.translations[reference]) @ x.rotations[reference]
            for x in (other, best)
        )
        apart = np.linalg.norm(seen - own, axis=1)[drawn.nodes]
        inside = cost <= most[drawn.nodes]
        assert (apart <= np.sqrt(drawn.shapes[:, 0, 0]))[inside].all()
        tried += int(inside.sum())
    assert tried


def test_few_are_drawn_along_the_track_and_none_larger_than_the_map(monkeypatch):
    instance = helix(4, np.random.default_rng(0))
    answer = solve(instance)
    monkeypatch.setattr(sureness, "MOST", 5)
    regions, covariances = scene_of(instance, answer).outlines
    assert len(regions.nodes) <= 5
    n = instance.graph.num_nodes
    assert set(regions.nodes) <= set(np.linspace(0, n - 1, 5).round().astype(int))
    assert f"They are drawn of 5 of {n} nodes, evenly." in regions.sentence
    assert f"seen from node {answer.certificate.distance.reference}" in regions.sentence
    far = sureness.Sureness(instance, answer.problem, answer.certificate, answer.estimate)
    placed = scene_of(instance, answer).placements[-1]
    limit = 2.0 * float(np.sqrt(regions.shapes[:, 0, 0].max())) * (1.0 - 1e-9)
    fewer, _ = far.outlines(placed.nodes, placed.positions, limit)
    assert len(fewer.nodes) == len(regions.nodes) - 1
    assert fewer.sentence.endswith("Left out, as larger than the map: those of 1 node.")
    assert covariances.sentence.startswith("Covariances at 95 %")


def test_nothing_is_drawn_where_nothing_is_known():
    graph = rotation_graph(rng_of(0), 6, 3, noise=0.05)[0]
    assert scene_of(graph, solve(graph)).outlines == ()
    few = {"distances": 0, "heights": 0}
    scaled = scaled_mixture(rng_of(0), 3, 6, noise=0.03, known=(0,), **few)[0]
    assert scene_of(scaled, solve(scaled)).outlines == ()
    instance = helix(4, np.random.default_rng(0))
    answer = solve(instance)
    assert scene_of(instance, answer.estimate).outlines == ()
    # Of another estimate than the answer's.
    assert scene_of(instance, answer, answer.estimate.moved(np.eye(3), np.ones(3))).outlines == ()
    screened = certify(instance, answer.estimate, tier="screen")
    of = sureness.Sureness(instance, answer.problem, screened, answer.estimate)
    placed = scene_of(instance, answer).placements[-1]
    assert [one.name for one in of.outlines(placed.nodes, placed.positions, 1e9)] == [COVARIANCES]


def test_pages_and_captions_have_them():
    instance = helix(4, np.random.default_rng(0))
    answer = solve(instance)
    scene = scene_of(instance, answer)
    data = page_scene(scene, answer.problem.edge_costs(answer.estimate))
    assert [one["name"] for one in data["outlines"]] == [REGIONS, COVARIANCES]
    for one, outlines in zip(data["outlines"], scene.outlines, strict=True):
        assert np.shape(one["points"]) == outlines.centres.shape
        assert one["shapes"] == pytest.approx(outlines.shapes, rel=1e-3)
        assert outlines.sentence in data["sentences"]
        assert any(outlines.sentence in text for _, text in legend(scene, "degrees", None))
    assessed = assess(answer.problem, answer.estimate, answer.certificate, instance=instance)
    given = instance, answer.problem, answer.estimate, assessed, Origin("helix.g2o")
    page = certificate_page(*given)
    box = re.search(r'<p class="verdict.*?</p>', page, re.DOTALL)[0]
    distance = answer.certificate.distance
    assert distance.sentence(instance.named) in box
    assert "of every optimum" in distance.sentence(instance.named)
    [drawn] = re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert json.loads(drawn)["outlines"] == data["outlines"]
    assert page.count('class="outlines"') == 2
    # Seen from another pose, all is.
    there = certificate_page(*given, distance=answer.certificate.distance_from(1))
    assert there.count("seen from node 1.") == 4  # said below, and kept in the data
    assert there.count("seen from node 1.") == 4  # said below, and kept in the data


@pytest.mark.parametrize("d", [2, 3])
def test_wires_are_on_the_ellipsoid(d):
    rng = rng_of(1)
    A = np.zeros((3, 3, 3))
    B = rng.standard_normal((3, d, d))
    A[:, :d, :d] = B @ np.swapaxes(B, 1, 2)
    centres = np.zeros((3, 3))
    centres[:, :d] = rng.standard_normal((3, d))
    one = sureness.Outlines("some", np.arange(3), centres, A, "")
    wires = one.wires(8)
    assert wires.shape == ((1 if d == 2 else 3) * 3 * 8, 2, 3)
    rings = wires.reshape(-1, 3, 8, 2, 3) - centres[:, None, None]
    inverse = np.linalg.pinv(A)
    assert np.einsum("pnsea,nab,pnseb->pnse", rings, inverse, rings) == pytest.approx(1.0)

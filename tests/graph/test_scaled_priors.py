"""Positions in a world give a map without a unit its scale; what else is measured is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import InputError, Instance, Quadratic
from certpgo.graph.kinds import Kind, Node
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.monocular import drifting, random_maps
from certpgo.linalg import rotations as so
from certpgo.optimize.levenberg_marquardt import descend


def located(rng, d, noise, *, known=False, points=0):
    """A map with the positions of some of its nodes, and the truth."""
    graph, truth = random_maps(rng, d, turn=noise, scale=noise, move=noise, points=points)
    if not known:
        graph = graph.with_unknown_scales(~graph.is_point)
    nodes = np.sort(rng.choice(graph.num_nodes, 5, replace=False))
    fixes = truth.translations[nodes] + noise * rng.standard_normal((5, d))
    return certpgo.with_priors(graph, nodes, translations=fixes, tau=noise**-2), truth


def test_positions_give_a_map_its_unit():
    """Almost without noise, the answer in the world is the truth, with its scales and positions."""
    graph, truth = located(np.random.default_rng(0), 3, 1e-3)
    assert graph.nodes.tolist() == [Node.SCALED] * 8 + [Node.POSE]
    assert not graph.in_mean_unit
    assert (graph.kinds[-5:] == Kind.POSITION).all()
    answer = certpgo.solve(graph)
    there = answer.estimate.anchored(8)
    assert answer.verdict == "CERTIFIED"
    assert there.scales[:8] == pytest.approx(truth.scales, rel=1e-2)
    assert there.translations[:8] == pytest.approx(truth.translations, abs=2e-2)
    assert "poses of known scale" in answer.certificate.objective


@given(seeds, dimensions, st.sampled_from([0.02, 0.1, 0.4]), st.booleans(), st.integers(0, 2))
@settings(max_examples=25)
def test_no_descent_ends_below_the_bound(seed, d, noise, known, points):
    rng = rng_of(seed)
    graph, _ = located(rng, d, noise, known=known, points=points)
    answer, problem = certpgo.solve(graph), Quadratic(graph)
    assert answer.certificate.lower_bound <= answer.certificate.cost_upper
    for _ in range(4):
        s = np.where(graph.free, np.exp(rng.standard_normal(problem.n)), 1.0)
        start = problem.complete(so.random(rng, problem.n, d), s)
        least = problem.enclosure(descend(problem, start).estimate)[1]
        assert answer.certificate.lower_bound <= least + 1e-12 * problem.scale
        if answer.verdict == "CERTIFIED":
            assert least >= answer.cost * (1.0 - 1e-5) - 1e-12 * problem.scale


def test_positions_in_a_plane_are_certified_though_a_mirror_image_fits():
    rng = np.random.default_rng(0)
    t = np.where([True, True, False], 3.0 * rng.standard_normal((9, 3)), 0.0)
    truth = certpgo.Estimate(so.random(rng, 9, 3), t)
    graph, truth = drifting(truth, [[0, 8], [1, 7], [0, 4]], rng)
    graph = certpgo.with_priors(graph, np.arange(9), translations=t, tau=100.0)
    answer = certpgo.solve(graph)
    assert answer.verdict == "CERTIFIED"
    assert answer.estimate.scales[:9] == pytest.approx(truth.scales, rel=0.05)


def test_they_are_proven():
    graph, _ = located(np.random.default_rng(1), 3, 0.05)
    answer = certpgo.solve(graph, tier="proof")
    assert answer.verdict == "CERTIFIED"
    assert answer.certificate.tier == "proof"


def test_files_keep_them(tmp_path):
    graph, _ = located(np.random.default_rng(1), 3, 0.05)
    instance = Instance("map", graph, np.arange(9), world=8)
    certpgo.write(tmp_path / "map.npz", instance)
    back = certpgo.read(tmp_path / "map.npz", quiet=True).graph
    assert np.array_equal(back.nodes, graph.nodes)
    assert Quadratic(back).title == Quadratic(graph).title
    assert certpgo.solve(back).cost == certpgo.solve(graph).cost
    with pytest.raises(InputError, match=r"\.npz"):
        certpgo.write(tmp_path / "map.g2o", instance)


def test_a_session_gets_its_unit_from_the_world():
    graph, _ = located(np.random.default_rng(2), 3, 0.1)
    instance = Instance("map", graph, np.arange(9), world=8)
    priors = graph.kinds == Kind.POSITION
    session = certpgo.Session(every=None)
    session.add(instance.with_edges(~priors))
    session.refresh()
    assert "root mean square" in session.standing.objective
    session.add(instance.with_edges(priors))
    assert session.lower_bound == 0.0
    session.refresh()
    assert session.standing.cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)
    assert session.standing.verdict == "CERTIFIED"
    followed = certpgo.Session(every=3)
    for part, names in streamed(instance):
        followed.add(part, names)
    assert followed.refresh().cost == pytest.approx(session.standing.cost, rel=1e-9)


def test_what_would_measure_a_scale_is_refused():
    graph, truth = random_maps(np.random.default_rng(0), 3)  # node 0 has a known scale
    R, t = truth.rotations[:2], truth.translations[:2]
    with pytest.raises(InputError, match="node 1: its rotation in the world"):
        certpgo.with_priors(graph, np.arange(2), R, t, kappa=1.0, tau=1.0)
    found = certpgo.with_priors(graph, np.arange(2), R, t, kappa=np.array([1.0, 0.0]), tau=1.0)
    assert certpgo.solve(found).verdict == "CERTIFIED"
    turned = certpgo.with_priors(graph, np.arange(1), R[:1], kappa=1.0)
    assert turned.kinds[-1] == Kind.ASSUMED
    assert certpgo.solve(turned).cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)


def test_a_single_position_gives_no_unit():
    """All scales could shrink to zero around it, at no cost."""
    graph, truth = random_maps(np.random.default_rng(0), 3)
    free, t = graph.with_unknown_scales(np.ones(8, bool)), truth.translations
    for nodes, fixes in (([1], t[:1]), ([1, 1], t[:2]), ([1, 2], t[[0, 0]])):
        with pytest.raises(InputError, match="two nodes at different positions"):
            certpgo.with_priors(free, nodes, translations=fixes, tau=1.0)
    certpgo.with_priors(graph, [1], translations=t[:1], tau=1.0)

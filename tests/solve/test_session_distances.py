"""How far a session's poses can be from every optimum, with measurements of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from mixtures import mixture, scaled_mixture
from strategies import point_graph, pose_graph, rng_of, rotation_graph

import certpgo
from certpgo import WORLD, Instance, Session
from certpgo.graph.kinds import Node
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.synthetic import helix
from certpgo.io.datasets.thesis import langevin_graph
from certpgo.linalg import rotations as so

KINDS = ("rotations", "poses", "points", "priors", "mixture", "scales", "outliers")


def measured(kind):
    """A graph, or an instance, and the session for it."""
    rng = rng_of(3)
    if kind == "rotations":
        return rotation_graph(rng, 8, 3, noise=0.05)[0], Session(every=None)
    if kind == "points":
        return point_graph(rng, 8, 4, 2, noise=0.05)[0], Session(every=None)
    if kind == "mixture":
        return mixture(rng, 2, 8, 2, 2, 5)[0], Session(every=None)
    if kind == "scales":
        few = {"distances": 0, "heights": 0}
        graph = scaled_mixture(rng, 3, 6, noise=0.03, known=(0,), **few)[0]
        return graph, Session(every=None)
    graph, _, t = pose_graph(rng, 8, 3, extra=12, noise=0.05)
    if kind == "priors":
        fixed = certpgo.with_priors(graph, np.arange(8), translations=t, tau=2.0)
        return Instance("fixed", fixed, np.arange(9), world=8), Session(every=None)
    if kind == "outliers":
        graph = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15).graph
        return graph, certpgo.RobustSession(every=None)
    return graph, Session(every=None)


def seen_from(x, i):
    """The relative poses of an estimate in the frame of node i."""
    turned = x.rotations[i].T @ x.rotations
    t = x.translations
    return None if t is None else (t - t[i]) @ x.rotations[i], turned


@pytest.mark.parametrize("kind", KINDS)
def test_the_optimum_of_the_batch_is_within_the_distance(kind):
    given, session = measured(kind)
    for part, names in streamed(given, 7 if kind != "outliers" else 200):
        session.add(part, names)
        try:
            session.refresh()
        except certpgo.GraphError:  # not all nodes are determined yet
            continue
        certificate = session.certificate
        distance = certificate.distance
        assert distance is not None
        # Of the measurements of the moment, and the newest pose is one of them.
        assert len(distance.degrees) == len(session.nodes) == session.graph.num_nodes
        newest = session.nodes[session.newest]
        assert newest is not WORLD
        assert not session.graph.is_point[session.newest]
        best = certpgo.solve(session.graph, cost=session._terms.cost)
        i = distance.reference
        (here, turned), (there, other) = seen_from(session.estimate, i), seen_from(best.estimate, i)
        rigid = session.graph.nodes != Node.POINT
        angles = np.degrees(so.angle(np.swapaxes(turned, 1, 2) @ other))
        allowed = best.certificate.distance_from(i)  # which may be off itself
        assert (angles <= distance.degrees + allowed.degrees + 1e-6)[rigid].all()
        if here is None:
            assert distance.metres is None
            continue
        apart = np.linalg.norm(here - there, axis=1)
        assert (apart <= distance.metres + allowed.metres).all()
        assert np.isfinite(distance.metres).all()


def test_a_new_measurement_has_no_distance_before_it_is_certified():
    graph = helix(4, np.random.default_rng(0)).graph
    session = Session(every=None)
    parts = list(streamed(graph, 12))
    session.add(*parts[0])
    before = session.certificate.distance
    for part, names in parts[1:]:
        session.add(part, names)
    after = session.certificate.distance
    assert len(before.metres) < len(after.metres) == len(session.nodes)
    again = certpgo.certify(session.graph, session.estimate, cost="chordal").distance
    assert after.reference == again.reference
    np.testing.assert_allclose(after.metres, again.metres, rtol=0.5)


def test_parts_of_files_meet_in_one_world(tmp_path):
    step = "EDGE_SE2 {} {} 1 0 0 100 0 0 100 0 100\n".format
    prior = "EDGE_PRIOR_SE2 {} {} 0 0 100 0 0 100 0 100\n".format
    session = Session()
    for name, text in (("a", step(0, 1) + prior(0, 0)), ("b", step(1, 2) + prior(2, 2.1))):
        path = tmp_path / f"{name}.g2o"
        path.write_text(text)
        session.add(certpgo.read(path, quiet=True))
    distance = session.certificate.distance
    assert session.nodes[distance.reference] is WORLD
    assert session.nodes[session.newest] == 2
    assert distance.metres.max() < 1e-3
    whole, estimate = session.as_instance()  # the world last
    again = certpgo.certify(whole, estimate).distance_from(3)
    order = [session.nodes.index(name) for name in (0, 1, 2, WORLD)]
    np.testing.assert_allclose(distance.metres[order], again.metres, rtol=0.5, atol=1e-9)


def test_held_nodes_stay_where_they_are(tmp_path):
    path = tmp_path / "held.g2o"
    path.write_text(
        "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(4))
        + "FIX 0\nFIX 3\n"
        + "".join(f"EDGE_SE2 {k} {k + 1} 1.1 0 0 100 0 0 100 0 100\n" for k in range(3))
    )
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    # Sessions refuse them, as others would be moved; the batch knows their distance.
    with pytest.raises(certpgo.InputError, match="held"):
        Session().add(instance)
    seen = answer.certificate.distance_from(0)
    assert seen.metres[3] < 1e-2
    assert seen.metres.max() < 1e-2


def test_the_newest_pose_is_the_last_of_what_came():
    session = Session(every=None)
    assert session.newest is None
    graph, _, t = pose_graph(rng_of(0), 6, 2, extra=4, noise=0.05)
    for part, names in streamed(graph, 3):
        session.add(part, names)
        known = [name for name in session.nodes if name is not WORLD]
        assert session.nodes[session.newest] == max(known)
    fixed = certpgo.with_priors(graph, [0], translations=t[:1], tau=2.0)
    session = Session(every=None)
    session.add(replace(Instance("fixed", fixed, np.arange(7)), world=6))
    assert session.nodes[session.newest] == 5

"""Sessions with nodes of unknown scale stand where the whole graph does, in its unit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixtures import scaled_mixture
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import GraphError, InputError, Quadratic, Ranges, Session, Verdict
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.monocular import in_one_unit, random_maps
from certpgo.linalg import rotations as so
from certpgo.optimize.levenberg_marquardt import descend


def random_graph(rng, d, known, points=0, noise=0.1):
    """A map whose scales are unknown but for these."""
    graph, _ = random_maps(rng, d, turn=noise, scale=noise, move=noise, points=points)
    free = ~graph.is_point
    free[list(known)] = False
    return graph.with_unknown_scales(free)


def same(session):
    """Whether a session is at the optimum of its measurements, under their cost."""
    graph, standing = session.graph, session.standing
    batch = certpgo.solve(graph)
    assert standing.objective == batch.certificate.objective == Quadratic(graph).title
    assert standing.cost == pytest.approx(batch.cost, rel=1e-9, abs=1e-12 * batch.certificate.scale)
    # Where a bound loses about what is allowed, one of both may be closer.
    assert standing.verdict is batch.verdict or standing.gap <= 1e-3 * standing.cost
    assert standing.lower_bound <= batch.certificate.cost_upper


def sound(session, rng):
    """Whether the cost is that of the estimate, and no bound is above what descents find."""
    problem, standing = Quadratic(session.graph), session.standing
    own = problem.cost(session.estimate)
    assert standing.cost == pytest.approx(own, rel=1e-9, abs=1e-12 * problem.scale)
    starts = [session.estimate]
    for _ in range(3):
        s = np.where(session.graph.free, np.exp(rng.standard_normal(problem.n)), 1.0)
        starts.append(problem.complete(so.random(rng, problem.n, problem.d), s))
    for start in starts:
        least = problem.enclosure(descend(problem, start).estimate)[1]
        assert standing.lower_bound <= least + 1e-12 * problem.scale


#: No scale known; that of the first node; of one that comes late; of two.
KNOWN = st.sampled_from([(), (0,), (5,), (2, 6)])


@given(seeds, dimensions, KNOWN, st.integers(0, 2), st.sampled_from([0.05, 0.4]))
@settings(max_examples=10)
def test_a_stream_stands_where_the_whole_does(seed, d, known, points, noise):
    rng = rng_of(seed)
    graph = random_graph(rng, d, [k for k in known if k < 8 - points], points, noise)
    session = Session(every=None)
    for count, (part, names) in enumerate(streamed(graph)):
        session.add(part, names)
        if count % 3 == 0:
            sound(session, rng)
        if count % 5 == 4:
            session.refresh()
            same(session)
            sound(session, rng)
    session.refresh()
    same(session)


def test_with_each_node_another_mean_is_the_unit():
    """A bound is of one mean: it stays with loops, and goes with a node."""
    graph = random_graph(np.random.default_rng(0), 3, ())
    session = Session(every=None)
    parts = list(streamed(graph))
    reached, dropped, kept = 0, 0, 0
    for part, names in parts:
        session.refresh() if session.nodes else None
        before = session.lower_bound
        session.add(part, names)
        if len(session.nodes) > reached:
            assert session.lower_bound == 0.0
            dropped += before > 0.0
        else:
            assert session.lower_bound == before
            kept += before > 0.0
        reached = len(session.nodes)
    assert dropped > 1 < kept


def test_the_first_known_scale_is_the_unit_from_then_on():
    rng = np.random.default_rng(1)
    graph = random_graph(rng, 3, (7,))
    early = (graph.edges < 7).all(axis=1)
    session = Session(every=None)
    session.add(graph.with_edges(early))
    assert session.refresh().verdict is Verdict.CERTIFIED
    assert "root mean square" in session.standing.objective
    session.add(graph.with_edges(~early))
    assert session.lower_bound == 0.0
    assert "known scale" in session.standing.objective
    assert session.estimate.scales[list(session.nodes).index(7)] == 1.0
    sound(session, rng)
    session.refresh()
    same(session)


@given(seeds, dimensions, KNOWN)
@settings(max_examples=10)
def test_removed_measurements_take_their_bounds_with_them(seed, d, known):
    rng = rng_of(seed)
    graph = random_graph(rng, d, known)
    session = Session(every=5)
    for part, names in streamed(graph):
        session.add(part, names)
    session.refresh()
    for _ in range(3):
        # In the order of arrival, the last ones are loops.
        session.remove(
            [int(rng.choice([e for e in session.edges.tolist() if _is_loop(session, e)]))]
        )
        sound(session, rng)
        session.refresh()
        same(session)


def _is_loop(session, number):
    graph = session.graph.with_edges(session.edges != number)
    return graph.is_connected and not session.graph.is_partial


def test_new_nodes_are_composed_with_their_scales():
    """A chain is met exactly, whatever its units, in either direction of its edges."""
    graph, _ = random_maps(np.random.default_rng(3), 3, m=7)
    session = Session(every=None)
    for part, names in reversed(list(streamed(graph))):
        session.add(part, names)
    assert session.standing.verdict is Verdict.CERTIFIED
    assert session.standing.cost <= session.standing.tolerance


def test_a_node_is_of_one_kind():
    graph, _ = random_maps(np.random.default_rng(0), 3)
    session = Session(every=None)
    session.add(graph)
    before = session.standing
    with pytest.raises(GraphError, match="1 is a pose and a pose of unknown scale"):
        session.add(in_one_unit(graph))
    assert session.standing == before


def test_what_does_not_go_with_scales_leaves_the_session_as_it_was():
    graph, _ = random_maps(np.random.default_rng(0), 3)
    plain = in_one_unit(graph).subgraph([0, 1])
    session = Session(every=None)
    session.add(graph)
    before = session.standing
    mixed, _ = scaled_mixture(np.random.default_rng(0), 3)
    (heights,) = (block for block in mixed.blocks if not isinstance(block, Ranges))
    seen = replace(heights, edges=[[0, 1]] * heights.num_edges)
    with pytest.raises(InputError, match="heights are measured in a frame of unknown scale"):
        Session().add(mixed.with_blocks(seen))
    with pytest.raises(InputError, match="do not go with arms"):
        session.add(
            certpgo.graph.PoseGraph(
                plain.rotations_alone, plain.translations, plain.tau, np.ones((1, 3))
            ),
            [0, "a"],
        )
    assert session.standing == before
    with pytest.raises(InputError, match="the cost is F"):
        Session(cost="g2o").add(graph)


def test_nothing_is_suspected_of_nodes_without_a_unit():
    session = Session(every=None)
    session.add(random_graph(np.random.default_rng(0), 3, (), noise=0.8))
    assert session.suspicion() is None


def test_the_instance_of_a_session_keeps_scales():
    graph = random_graph(np.random.default_rng(0), 3, (0,))
    session = Session(every=None)
    session.add(graph, np.arange(7, -1, -1).tolist())
    instance, estimate = session.as_instance()
    assert Quadratic(instance.graph).enclosure(estimate)[1] == pytest.approx(
        session.standing.cost, rel=1e-12
    )


@given(seeds, dimensions)
@settings(max_examples=8)
def test_distances_and_own_kinds_come_with_scales(seed, d):
    """Of a world, in whose unit they are; then some go again."""
    rng = rng_of(seed)
    graph, truth = scaled_mixture(rng, d)
    m = graph.num_edges
    part = np.sort(rng.choice(np.arange(m), m // 2, replace=False))
    first = np.union1d(part, np.arange(m)[: graph.num_nodes])
    session = Session(every=None)
    session.add(graph.with_blocks())
    session.add(graph.with_edges(first[:1]).with_blocks(*graph.blocks), range(graph.num_nodes))
    whole = graph.with_edges(np.r_[np.arange(m), first[0]])
    session.refresh()
    batch = certpgo.solve(whole)
    standing = session.standing
    assert standing.objective == batch.certificate.objective
    assert standing.cost == pytest.approx(batch.cost, rel=1e-8)
    assert standing.lower_bound <= batch.certificate.cost_upper
    assert batch.certificate.lower_bound <= standing.cost
    assert standing.lower_bound <= certpgo.certify(whole, truth, refine=False).cost_upper
    session.remove(session.edges[-2:])
    removed = session.refresh()
    assert removed.cost <= standing.cost * (1.0 + 1e-9)


def test_without_a_known_scale_there_is_no_unit_for_distances():
    graph = random_graph(np.random.default_rng(0), 3, ())
    session = Session(every=None)
    session.add(graph)
    distances = Ranges(graph.num_nodes, [[0, 3]], [1.0], [1.0])
    before = session.standing
    with pytest.raises(InputError, match="no pose has a known scale"):
        session.add(graph.with_edges([0]).with_blocks(distances), range(graph.num_nodes))
    assert session.standing == before

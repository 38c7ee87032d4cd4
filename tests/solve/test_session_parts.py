"""A session fed with the parts of a file, each read alone, is the batch on the whole."""

import contextlib
import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import definite, rng_of, seeds

import certpgo
from certpgo import WORLD, Instance, RobustSession, Session, Verdict
from certpgo.errors import GraphError, InputError
from certpgo.graph.components import restricted
from certpgo.graph.labels import Landmark
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so

#: Cuts of each kind of file.
CUTS = int(os.environ.get("CERTPGO_CUTS", "6"))
#: Of equal optima, found from different starts.
SAME = 1e-7


def read(folder, *lines, name="part.g2o"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n")
    return certpgo.read(path, quiet=True)


def step(i, j, x=1.0):
    return f"EDGE_SE2 {i} {j} {x} 0 0 100 0 0 100 0 100"


def prior(i, x, y=0.0):
    return f"EDGE_PRIOR_SE2 {i} {x} {y} 0 100 0 0 100 0 100"


def fed(session, *parts):
    for part in parts:
        session.add(part)
    return session


def same_as_batch(session, whole, cost=None):
    """Assert that a refreshed session has F and verdict of the batch.

    Where the batch is not CERTIFIED, what it finds depends on the order of nodes: bounds must hold.
    """
    batch, standing = certpgo.solve(whole, cost=cost), session.refresh()
    W = batch.certificate.scale
    assert standing.edges == whole.graph.num_measurements
    proven = session.certificate
    if standing.lower_bound <= proven.lower_bound:  # else that of fewer measurements is better
        assert standing.verdict is proven.verdict
    if batch.verdict is Verdict.CERTIFIED:
        assert standing.verdict is Verdict.CERTIFIED
        assert standing.cost == pytest.approx(batch.cost, rel=SAME, abs=1e-12 * W)
    else:
        assert standing.lower_bound <= batch.certificate.cost_upper
        assert standing.cost >= batch.certificate.lower_bound


NEAR = ([step(0, 1), step(1, 2), prior(0, 0)], [step(2, 3), step(3, 4), prior(4, 4)])
FAR = (
    [step(0, 1), prior(0, 500000, 5000000), prior(1, 500001, 5000000)],
    [step(1, 2), prior(1, 500001, 5000000), prior(2, 500002, 5000000)],
)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("cost", ["chordal", "g2o", "gtsam", "robust"])
@pytest.mark.parametrize("lines", [NEAR, FAR])
def test_instances_with_priors_share_one_world(lines, cost, first, tmp_path):
    # Exact measurements: F was 225 and 300, CERTIFIED, where one world was a pose of the other.
    parts = [read(tmp_path, *lines[k]) for k in (first, 1 - first)]
    session = RobustSession() if cost == "robust" else Session(cost=cost)
    standing = fed(session, *parts).refresh()
    assert standing.verdict is Verdict.CERTIFIED
    assert standing.cost < 1e-20
    assert set(session.nodes) == {*np.concatenate([p.ids[: p.world] for p in parts]), WORLD}
    instance, estimate = session.as_instance()
    x = instance.in_world(estimate).translations
    offset = 0.0 if lines is NEAR else [500000.0, 5000000.0]
    expected = np.c_[instance.ids[: instance.world], np.zeros(len(x))] + offset
    assert x == pytest.approx(expected, abs=1e-8)


def test_the_world_is_no_node_whatever_the_names_say(tmp_path):
    parts = [read(tmp_path, *lines) for lines in FAR]
    session = Session(cost="chordal")
    for part in parts:  # 2 is the world's id in the first, a pose's in the second
        session.add(part, part.ids.tolist())
    assert session.refresh().cost < 1e-20
    assert set(session.nodes) == {0, 1, 2, WORLD}
    with pytest.raises(InputError, match="3 different names are expected"):
        session.add(parts[0], [WORLD, 1, 2])
    # In a graph the name says which node it is.
    graph = certpgo.with_priors(parts[1].graph.subgraph([0, 1]), [0], np.eye(2)[None], kappa=1.0)
    session.add(graph, [1, 2, WORLD])
    assert session.refresh().cost < 1e-9
    backward = graph.with_edges([0]).subgraph([0, 1])
    with pytest.raises(InputError, match="edges leave the world, and none leads to it"):
        session.add(backward, [1, WORLD])


def test_origins_that_no_double_joins_go_back_to_the_files_own(tmp_path):
    far = [step(0, 1), prior(0, 4000000.5), prior(1, 4000002.0)]
    near = [step(1, 2, -4000001.3), prior(2, 0.2), prior(2, 0.25)]
    parts, whole = [read(tmp_path, *lines) for lines in (far, near)], read(tmp_path, *far, *near)
    assert parts[0].origin is not None
    for order in (parts, parts[::-1]):
        session = Session(every=1)
        same_as_batch(fed(session, *order), whole)
        assert session.as_instance()[0].origin is None
    # A bound from before the move still holds, and the estimate is as good.
    session = fed(Session(), parts[0])
    before = session.refresh()
    session.add(parts[1])
    assert 0.0 < before.lower_bound == session.lower_bound < certpgo.solve(whole).cost
    third = 4000002.0 - 0.5 / 3 - 4000001.3
    rise = 100 * ((0.2 - third) ** 2 + (0.25 - third) ** 2)
    assert session.standing.cost == pytest.approx(before.cost + rise, rel=1e-6)


def test_origins_that_cannot_be_joined_are_refused(tmp_path):
    parts = [read(tmp_path, *lines) for lines in FAR]
    tiny = replace(parts[0], origin=np.array([1e-20, 0.0]))
    session = fed(Session(cost="chordal"), tiny)
    before = session.refresh()
    with pytest.raises(InputError, match="cannot be joined without rounding"):
        session.add(parts[1])
    assert session.standing == before
    with pytest.raises(GraphError, match="poses in 2D and poses in 3D"):
        session.add(helix_with_priors())


def helix_with_priors():
    made = helix(3, np.random.default_rng(0))
    fixes = made.truth.translations[:2]
    graph = certpgo.with_priors(made.graph, [0, 1], translations=fixes, tau=1.0)
    return Instance("helix", graph, np.arange(graph.num_nodes), world=graph.num_nodes - 1)


@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_landmarks_that_are_numbered_apart_are_no_poses(cost, tmp_path):
    seen = "LANDMARK2 {} {} {} {} 50 0 50".format
    first = [step(0, 1), step(1, 2), seen(0, 1, 5.0, 0.1), seen(0, 5, 7, 1), seen(2, 1, 3, 0)]
    second = [step(2, 3), step(3, 4), step(4, 5), seen(5, 1, 0.2, 0), seen(3, 5, 4.1, 1.1)]
    parts = [read(tmp_path, *lines) for lines in (first, second)]
    session = fed(Session(cost=cost), *parts)
    same_as_batch(session, read(tmp_path, *first, *second), cost)
    assert set(session.nodes) == {*range(6), Landmark(1), Landmark(5)}
    instance, estimate = session.as_instance()
    assert certpgo.certify(instance, estimate).verdict is Verdict.CERTIFIED
    assert instance.labels == (*range(6), Landmark(1), Landmark(5))
    assert instance.ids.tolist() == [*range(6), 7, 11]


def test_a_node_is_a_pose_or_a_point(tmp_path):
    session = fed(Session(), read(tmp_path, step(0, 1), step(1, 2)))
    before = session.standing
    with pytest.raises(GraphError, match="node 2 is a pose and a point"):
        session.add(read(tmp_path, "EDGE_SE2_XY 0 2 1 1 50 0 50"))
    assert session.standing == before
    session.add(read(tmp_path, "EDGE_SE2_XY 0 7 1 1 50 0 50"))
    with pytest.raises(GraphError, match="node 7 is a pose and a point"):
        session.add(read(tmp_path, step(2, 7)))
    assert session.refresh().edges == 3


def test_nodes_with_names_are_found_by_these(tmp_path):
    def lines(names, measured):
        vertices = [f"VERTEX_SE2 0 {name} 0 0 0" for name in names]
        edges = [f"EDGE_SE2 0 {i} {j} {x} 0 0 .01 0 0 .01 0 .01" for i, j, x in measured]
        return [*vertices, *edges, f"VERTEX_SE2:PRIOR 0 {names[0]} 0 0 0 .01 0 0 .01 0 .01"]

    first, second = [("A0", "A1", 1.0), ("A1", "B0", 1.0)], [("B0", "A0", -1.7)]
    one = read(tmp_path, *lines(["A0", "A1", "B0"], first), name="one.pyfg")
    two = read(tmp_path, *lines(["B0", "A0"], second), name="two.pyfg")
    session = fed(Session(), one, two)
    assert set(session.nodes) == {"A0", "A1", "B0", WORLD}
    both = lines(["A0", "A1", "B0"], first + second)
    extra = "VERTEX_SE2:PRIOR 0 B0 0 0 0 .01 0 0 .01 0 .01"
    same_as_batch(session, read(tmp_path, *both, extra, name="whole.pyfg"))


def test_where_the_world_is_is_assumed_once():
    made = helix(3, np.random.default_rng(0))
    graph, n = made.graph, made.graph.num_nodes
    R = made.truth.rotations @ so.exp(0.05 * np.random.default_rng(1).standard_normal((n, 3)))
    fixes = made.truth.translations[[0, 5]] + 0.1
    parts = []
    for nodes in (np.arange(n // 2 + 1), np.arange(n // 2, n)):
        part = certpgo.with_priors(graph.subgraph(nodes), np.arange(len(nodes)), R[nodes], kappa=9)
        parts.append((part, [*nodes.tolist(), WORLD]))
    low, high = graph.edges.min(axis=1), graph.edges.max(axis=1)
    across = graph.with_edges((low < n // 2) & (high > n // 2))
    twice = [*range(n), n // 2]
    whole = certpgo.with_priors(graph, twice, R[twice], kappa=9)
    located = certpgo.with_priors(graph, [0, 5], translations=fixes, tau=9.0)
    placed = located.with_edges(located.edges[:, 0] == n).subgraph([0, 5, n]), [0, 5, WORLD]
    located = certpgo.with_priors(located, twice, R[twice], kappa=9, world=n)
    for known, best in (([], whole), ([placed], located)):
        for order in ([*parts, *known], [*parts[::-1], *known], [parts[0], *known, parts[1]]):
            session = Session(every=5)
            for part in [*order, (across, range(n))]:
                session.add(*part)
            same_as_batch(session, Instance("whole", best, np.arange(n + 1), world=n))


def test_a_refresh_waits_until_all_nodes_are_determined(tmp_path):
    fix = "EDGE_PRIOR_SE2_XY {} {} {} 4 0 4".format
    lines = [step(0, 1), step(0, 1, 1.2), step(1, 2), fix(0, 0, 0), fix(2, 2, 1)]
    whole, session = read(tmp_path, *lines), Session(every=3, cost="chordal")
    session.add(only(whole, [0, 1]))
    session.add(only(whole, [3]))
    with pytest.raises(GraphError, match="no measurement determines the rotation of the world"):
        session.refresh()
    assert session.pending == 3
    session.add(only(whole, [2]))
    session.add(only(whole, [4]))
    assert session.pending == 0
    same_as_batch(session, whole, "chordal")


def test_a_wrong_prior_is_put_aside_wherever_its_origin_is(tmp_path):
    steps = [step(k, k + 1) for k in range(12)]
    far = [prior(k, 4000000.0 + k, 0) for k in range(9)]
    near = [prior(12, 4000000.0 + 12, 0), prior(11, 0.1, 0.3)]  # 4000 km away
    parts = [read(tmp_path, *steps, *far), read(tmp_path, step(11, 12), *near)]
    session = fed(RobustSession(every=None), *parts)
    session.settle()
    assert session.rejected.tolist() == [len(steps) + len(far) + 2]
    assert session.standing.cost < 1e-6
    session.add(read(tmp_path, step(0, 1), prior(1, 0.1, 0.0)))
    assert session.settle().verdict is Verdict.CERTIFIED
    assert session.rejected.tolist() == [23, 25]


def only(instance, chosen):
    """The chosen measurements of an instance, and their nodes."""
    nodes = np.unique(instance.graph.edges[np.asarray(chosen)])
    return restricted(instance.with_edges(np.asarray(chosen)), nodes, instance.name)


class Files:
    """Lines of a random graph, kind by kind, as the reader orders them."""

    def __init__(self, rng, d, landmarks, far):
        self.rng, self.d, self.lines, self.nodes = rng, d, [], []
        n = int(rng.integers(4, 8))
        self.R = so.exp(0.6 * rng.standard_normal((n, so.tangent_dim(d))))
        self.t = 3.0 * rng.standard_normal((n, d))
        self.origin = np.array([400000.0, 5000000.0, 100.0][:d]) if far else np.zeros(d)
        for k in range(n - 1):
            self.between(k, k + 1)
        for _ in range(n):
            self.between(*rng.choice(n, 2, replace=False).tolist())
        # Numbers of LANDMARK2 are those of poses too.
        first = 0 if landmarks == "LANDMARK2" else 100
        for point in range(first, first + 3 if landmarks else first):
            where = 4.0 * rng.standard_normal(d)
            for i in rng.choice(n, 3, replace=False).tolist():
                self.sighting(landmarks, i, point, where)
        for i in rng.choice(n, int(rng.integers(0, n)), replace=False).tolist():
            self.prior(i)
        for i in rng.choice(n, int(rng.integers(3, n + 1)), replace=False).tolist():
            self.position(i)

    def say(self, tag, nodes, ids, numbers, p):
        """A line with the information of p numbers, and the nodes that it measures."""
        information = 50.0 * definite(self.rng, 1, p, 2.0)[0][np.triu_indices(p)]
        words = [tag, *ids, *(repr(float(x)) for x in (*numbers, *information))]
        self.lines.append(" ".join(map(str, words)))
        self.nodes.append(nodes)

    def pose(self, R, t):
        """The numbers of a pose measured with noise."""
        q = so.tangent_dim(self.d)
        R = R @ so.exp(0.05 * self.rng.standard_normal((1, q)))[0]
        t = t + 0.05 * self.rng.standard_normal(self.d)
        if self.d == 2:
            return [*t, np.arctan2(R[1, 0], R[0, 0])]
        return [*t, *Rotation.from_matrix(R).as_quat()]

    def between(self, i, j):
        tag = "EDGE_SE2" if self.d == 2 else "EDGE_SE3:QUAT"
        measured = self.pose(self.R[i].T @ self.R[j], self.R[i].T @ (self.t[j] - self.t[i]))
        self.say(tag, [i, j], [i, j], measured, 3 * (self.d - 1))

    def sighting(self, tag, i, point, where):
        seen = self.R[i].T @ (where - self.t[i]) + 0.05 * self.rng.standard_normal(self.d)
        tag, sensor = (tag, []) if self.d == 2 else ("EDGE_SE3_TRACKXYZ", [0])
        self.say(tag, [i], [i, point, *sensor], seen, self.d)

    def prior(self, i):
        tag, sensor = ("EDGE_PRIOR_SE2", []) if self.d == 2 else ("EDGE_SE3_PRIOR", [0])
        measured = self.pose(self.R[i], self.t[i] + self.origin)
        self.say(tag, [i], [i, *sensor], measured, 3 * (self.d - 1))

    def position(self, i):
        tag, sensor = ("EDGE_PRIOR_SE2_XY", []) if self.d == 2 else ("EDGE_SE3_XYZPRIOR", [0])
        there = self.t[i] + self.origin + 0.05 * self.rng.standard_normal(self.d)
        self.say(tag, [i], [i, *sensor], there, self.d)

    def cut(self, count):
        """The numbers of the lines of each part; priors come with measurements of their pose."""
        part = self.rng.integers(0, count, len(self.lines))
        holders = [k for k, line in enumerate(self.lines) if "PRIOR" not in line]
        for k, (line, nodes) in enumerate(zip(self.lines, self.nodes, strict=True)):
            if "PRIOR" in line:
                part[k] = part[self.rng.choice([h for h in holders if nodes[0] in self.nodes[h]])]
        return [np.flatnonzero(part == k) for k in range(count) if (part == k).any()]


def feed(session, parts, rng):
    """Add (instance, numbers of its lines) in any order; returns the numbers as they came."""
    waiting, came = list(parts), []
    while waiting:
        rng.shuffle(waiting)
        left = []
        for part, lines in waiting:
            try:
                session.add(part)
                came += lines.tolist()
            except GraphError:  # not connected yet
                left.append((part, lines))
        if len(left) == len(waiting):  # none can be first: take them apart
            left = [(only(p, [k]), lines[[k]]) for p, lines in left for k in range(len(lines))]
        waiting = left
    return came


@settings(max_examples=CUTS)
@given(seeds, st.integers(1, 4), st.sampled_from([None, 1, 7]), st.booleans())
@pytest.mark.parametrize(
    ("d", "landmarks", "cost"),
    [
        (2, "LANDMARK2", "chordal"),
        (2, "LANDMARK2", "g2o"),
        (2, "EDGE_SE2_XY", "gtsam"),
        (3, "", "g2o"),
        (3, "", "gtsam"),
        (3, "EDGE_SE3_TRACKXYZ", "chordal"),
        (3, "EDGE_SE3_TRACKXYZ", "g2o"),
    ],
)
def test_any_cut_in_any_order_is_the_batch(
    tmp_path_factory, d, landmarks, cost, seed, count, every, far
):
    rng, folder = rng_of(seed), tmp_path_factory.mktemp("cut")
    files = Files(rng, d, landmarks, far)
    whole = read(folder, *files.lines)
    assert whole.graph.num_edges == len(files.lines)
    parts = [(read(folder, *(files.lines[k] for k in cut)), cut) for cut in files.cut(count)]
    session = Session(every=every, cost=cost)
    came = np.array(feed(session, parts, rng))
    same_as_batch(session, whole, cost)
    assert set(session.nodes) == set(whole.labels)
    # What is left when some are removed is the batch on the rest.
    for _ in range(3):
        gone = rng.choice(session.edges, int(rng.integers(1, 4)), replace=False)
        with contextlib.suppress(GraphError):
            session.remove(gone)
    rest = only(whole, np.sort(came[session.edges]))
    same_as_batch(session, rest, cost)


@settings(max_examples=CUTS)
@given(seeds, st.sampled_from(["rotations", "attitudes", "directions"]), st.integers(1, 9))
def test_any_cut_of_what_files_do_not_say_is_the_batch(seed, kind, size):
    rng = rng_of(seed)
    made = helix(3, rng, rotation_noise=0.05, translation_noise=0.05)
    n, R = made.graph.num_nodes, made.truth.rotations
    graph, nodes = made.graph, rng.choice(made.graph.num_nodes, 5, replace=False)
    if kind == "attitudes":
        turned = R[nodes] @ so.exp(0.05 * rng.standard_normal((5, 3)))
        graph = certpgo.with_priors(graph, nodes, turned, kappa=rng.uniform(20.0, 90.0, 5))
    elif kind == "directions":
        up = R[nodes][:, 2, :] + 0.05 * rng.standard_normal((5, 3))
        graph = certpgo.with_directions(graph, nodes, up, kappa=50.0)
    else:
        graph = graph.rotations_alone
    world = graph.num_nodes - 1 if graph.num_nodes > n else None
    whole = Instance(kind, graph, 7 * np.arange(graph.num_nodes), world=world)
    order = rng.permutation(graph.num_edges)
    cuts = [order[first : first + size] for first in range(0, len(order), size)]
    session = Session(every=5)
    came = np.array(feed(session, [(only(whole, cut), cut) for cut in cuts], rng))
    assumed = np.flatnonzero(~graph.is_measured)  # has no number in the session
    came = came[~np.isin(came, assumed)]
    same_as_batch(session, whole)
    with contextlib.suppress(GraphError):
        session.remove(rng.choice(len(came), 2, replace=False))
    rest = came[session.edges[session.edges >= 0]]
    same_as_batch(session, only(whole, np.append(rest, assumed)))

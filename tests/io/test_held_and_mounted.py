"""Several fixed poses, and priors of sensors that are somewhere on their bodies."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize
from scipy.spatial.transform import Rotation

import certpgo
from certpgo.errors import InputError
from certpgo.graph.components import connected_parts, restricted, rotations_alone
from certpgo.graph.held import displaced, with_held
from certpgo.graph.kinds import places_world
from certpgo.graph.priors import with_world_placed
from certpgo.graph.streaming import streamed
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.solve.fit import fit_of

#: Two rotations of sensors, as in rtabmap's exports; 0.149434741972 by scipy's least squares.
OFFSET = """PARAMS_SE3OFFSET 0 0.2 0 0.5 0 0 0.7071067811865476 0.7071067811865476
VERTEX_SE3:QUAT 1 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 2 1 0 0 0 0 0 1
VERTEX_SE3:QUAT 3 2 0.5 0 0 0 0 1
EDGE_SE3:QUAT 1 2 1 0 0 0 0 0 1 {I}
EDGE_SE3:QUAT 2 3 1 0.5 0 0 0 0 1 {I}
EDGE_SE3_PRIOR 1 0 0.2 0 0.5 0 0 0.7071067811865476 0.7071067811865476 {I}
EDGE_SE3_PRIOR 3 0 2.2 0.6 0.5 0 0 0.7071067811865476 0.7071067811865476 {I}
""".replace("{I}", "100 0 0 0 0 0 100 0 0 0 0 100 0 0 0 400 0 0 400 0 400")
#: Where the sensor of the generated priors is on its body.
SENSOR = np.array([0.4, 0.1, -0.6]), Rotation.from_rotvec([0.3, -0.2, 0.7])
PAIRS = [*((k, k + 1) for k in range(7)), (0, 4), (6, 2), (7, 3), (5, 1), (5, 0), (7, 5), (7, 0)]


def _text(d, t, R):
    numbers = [*t[:d], *(R.as_quat() if d == 3 else R.as_rotvec()[2:])]
    return " ".join(repr(float(x)) for x in numbers)


def written(path, d, rng, fixed=(), priors=(), positions=(), sigma=0.01, wrong=0.03):
    """A file of eight poses, its poses as written, and its information matrices."""
    turn, p = np.array([1.0, 1.0, 1.0]) * ([1, 1, 1] if d == 3 else [0, 0, 1]), d * (d + 1) // 2

    def drawn(scale):
        return rng.normal(0, scale, 3) * [1, 1, d == 3], rng.normal(0, scale, 3) * turn

    def noisy(t, R, scale):
        dt, w = drawn(scale)
        return t + R.apply(dt), R * Rotation.from_rotvec(w)

    def information(size=p):
        A = 3.0 * rng.normal(size=(size, size)) + 10.0 * np.eye(size)
        return " ".join(repr(float(x)) for x in (A @ A.T)[np.triu_indices(size)])

    poses = [(np.zeros(3), Rotation.identity())]
    while len(poses) < 8:
        (t, R), (dt, w) = poses[-1], drawn(0.4)
        poses.append((t + R.apply(dt + np.eye(3)[0]), R * Rotation.from_rotvec(w)))
    tag = ("VERTEX_SE2", "EDGE_SE2", "EDGE_PRIOR_SE2")
    if d == 3:
        tag = ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "EDGE_SE3_PRIOR")
    lines = [f"PARAMS_SE3OFFSET 4 {_text(3, *SENSOR)}"] if d == 3 else []
    lines += [f"{tag[0]} {k} {_text(d, *noisy(*pose, wrong))}" for k, pose in enumerate(poses)]
    lines += [f"FIX {k}" for k in fixed]
    for i, j in PAIRS:
        (a, A), (b, B) = poses[i], poses[j]
        found = noisy(A.inv().apply(b - a), A.inv() * B, sigma)
        lines.append(f"{tag[1]} {i} {j} {_text(d, *found)} {information()}")
    for k in priors:
        t, R = poses[k]
        if d == 3:
            t, R = t + R.apply(SENSOR[0]), R * SENSOR[1]
        sensor = " 4" if d == 3 else ""
        lines.append(f"{tag[2]} {k}{sensor} {_text(d, *noisy(t, R, sigma))} {information()}")
    for k in positions:
        where = " ".join(repr(float(x)) for x in poses[k][0] + drawn(sigma)[0])
        lines.append(f"EDGE_SE3_XYZPRIOR {k} 4 {where} {information(3)}")
    path.write_text("\n".join(lines) + "\n")
    return path


CASES = [
    pytest.param(2, {"fixed": (0, 5)}, id="plane"),
    pytest.param(2, {"fixed": (3,), "priors": (2, 5, 6)}, id="plane with a world"),
    pytest.param(3, {"fixed": (0, 5, 6)}, id="space"),
    pytest.param(3, {"priors": (2, 5, 6)}, id="sensors"),
    pytest.param(3, {"fixed": (5, 0), "priors": (2, 5), "positions": (1, 4, 7)}, id="all together"),
]


@pytest.mark.parametrize(("d", "kinds"), CASES)
@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_where_poses_are_held_the_cost_is_that_of_the_file(tmp_path, d, kinds, cost):
    rng = np.random.default_rng(3)
    path = written(tmp_path / "g.g2o", d, rng, **kinds)
    held, free = (certpgo.read(path, fixed=fixed, quiet=True) for fixed in (True, False))
    fixed = [*kinds.get("fixed", ())]
    if free.world is not None:
        fixed.append(free.world)
    n = free.graph.num_nodes
    t = free.initial.translations + rng.normal(0, 1.0, (n, d))
    R = free.initial.rotations @ so.exp(rng.normal(0, 1.0, (n, 1 if d == 2 else 3)))
    R[fixed], t[fixed] = free.initial.rotations[fixed], free.initial.translations[fixed]
    anywhere = certpgo.Estimate(R, t)
    terms = objective_of(free, cost).edge_costs(anywhere)
    constant = np.isin(free.graph.edges, fixed).all(axis=1)
    expected = float(terms[~constant].sum()) if len(fixed) > 1 else float(terms.sum())
    assert objective_of(held, cost).cost(anywhere) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("d", "kinds"), CASES)
def test_held_poses_are_where_they_are_and_the_answer_is_proven(tmp_path, d, kinds):
    path = written(
        tmp_path / "g.g2o", d, np.random.default_rng(4), **kinds, sigma=0.003, wrong=0.001
    )
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance)
    assert answer.verdict.value == "CERTIFIED"
    assert not answer.certificate.broken
    fixed = [*kinds.get("fixed", ())]
    if instance.world is not None:
        fixed.append(instance.world)
    if len(fixed) > 1:
        there = answer.estimate.anchored(fixed[0], instance.initial)
        moved = there.translations - instance.initial.translations
        assert np.abs(moved[fixed]).max() < 1e-7
        assert np.abs(moved).max() > 1e-4
        assert not answer.marginals.covariances[fixed].any()
        # The file's poses are not where the measurements alone would have them.
        free = certpgo.solve(certpgo.read(path, fixed=False, quiet=True))
        assert answer.cost > 1.001 * free.cost


@pytest.mark.parametrize(("d", "kinds"), CASES)
@pytest.mark.parametrize("cost", ["chordal", "g2o"])
def test_a_search_that_is_stopped_leaves_held_poses_where_they_are(tmp_path, d, kinds, cost):
    path = written(tmp_path / "g.g2o", d, np.random.default_rng(4), **kinds, sigma=0.1, wrong=0.1)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, cost=cost, time_limit=0.0)
    assert answer.solution.status.value == "time limit"
    held = list(instance.held) or [0]
    there = answer.estimate.anchored(held[0], instance.initial)
    for own, fixed in zip(poses_of(there), poses_of(instance.initial), strict=True):
        np.testing.assert_allclose(own[held], fixed[held], atol=1e-12)
    assert answer.cost == pytest.approx(objective_of(instance, cost).cost(answer.estimate))
    assert answer.certificate.lower_bound <= answer.cost


def poses_of(estimate):
    return estimate.rotations, estimate.translations


def test_an_answer_names_the_nodes_that_are_held(tmp_path):
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(4), fixed=(0, 5))
    for fixed, held in ((True, ""), (False, ", not held here")):
        said = " ".join(str(certpgo.solve(certpgo.read(path, fixed=fixed, quiet=True))).split())
        assert f" fixed 0, 5 by the file{held} next " in said


def test_the_sensors_of_rtabmap(tmp_path):
    path = tmp_path / "off.g2o"
    path.write_text(OFFSET)
    answer = certpgo.solve(certpgo.read(path, quiet=True))
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(0.149434741972, abs=1e-11)
    certpgo.write(tmp_path / "again.g2o", certpgo.read(path, quiet=True))
    again = certpgo.solve(certpgo.read(tmp_path / "again.g2o", quiet=True))
    assert again.cost == pytest.approx(0.149434741972, abs=1e-11)


def test_a_position_is_of_the_body(tmp_path):
    """As in g2o's EdgeSE3XYZPrior, whose error has no sensor."""
    path = tmp_path / "g.g2o"
    path.write_text(OFFSET.replace("PRIOR 3 0 2.2 0.6 0.5 0 0 0.70", "XYZPRIOR 3 0 2.2 0.6 0.5 # "))
    said = " ".join(certpgo.read(path, quiet=True).notices)
    assert "1 position of bodies whose sensor is elsewhere: taken as the body's" in said


def _problem(tmp_path, **kinds):
    path = written(tmp_path / "g.g2o", 3, np.random.default_rng(5), **kinds)
    instance = certpgo.read(path, quiet=True)
    return instance, objective_of(instance, "g2o")


def _moved(estimate, x):
    n, d = estimate.translations.shape
    x = x.reshape(n, -1)
    return certpgo.Estimate(estimate.rotations @ so.exp(x[:, d:]), estimate.translations + x[:, :d])


def test_derivatives_with_arms_are_those_of_the_cost(tmp_path):
    instance, problem = _problem(tmp_path, fixed=(0, 5), priors=(2, 5, 6))
    assert instance.graph.arms.any()
    here = _moved(instance.initial, np.random.default_rng(6).normal(0, 0.1, 9 * 6))
    _, gradient = problem.equations.first(here)
    for direction in np.random.default_rng(7).normal(size=(4, 9 * 6)):
        along = [problem.cost(_moved(here, h * direction)) for h in (1e-5, -1e-5)]
        slope = (along[0] - along[1]) / 2e-5
        assert 2.0 * float((gradient.ravel() * direction).sum()) == pytest.approx(slope, rel=1e-6)


def test_surrogates_with_arms_are_below_the_cost_and_touch_it(tmp_path):
    instance, problem = _problem(tmp_path, fixed=(0, 5), priors=(2, 5, 6))
    below = problem.surrogate(instance.initial)
    touching = below.problem.cost(instance.initial) + below.constant
    assert touching == pytest.approx(problem.cost(instance.initial), rel=1e-9)
    for x in np.random.default_rng(8).normal(0, 0.5, (20, 9 * 6)):
        there = _moved(instance.initial, x)
        assert below.problem.cost(there) + below.constant <= problem.cost(there)
        low, high = problem.enclosure(there)
        assert low <= problem.cost(there) <= high < low + 1e-6 * high


def test_a_wrong_loop_to_a_held_pose_is_named_as_in_the_file(tmp_path):
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(9), (0, 5, 7), wrong=0.0)
    lines = path.read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("EDGE_SE2 7 3 "))
    words = lines[at].split()
    words[3] = repr(float(words[3]) + 2.0)
    lines[at] = " ".join(words)
    path.write_text("\n".join(lines) + "\n")
    instance = certpgo.read(path, quiet=True)
    robust = certpgo.solve_robustly(instance)
    assert instance.pairs[robust.solution.rejected].tolist() == [[7, 3]]


def test_what_cannot_be_held_is_said(tmp_path):
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(1), fixed=(0, 5))
    instance = certpgo.read(path, quiet=True)
    # As it was read it is not what the source states any more.
    changed = replace(instance, graph=instance.graph.with_weights(3.0, 7.0))
    certpgo.write(tmp_path / "out.npz", changed)
    again = certpgo.read(tmp_path / "out.npz", quiet=True)
    with pytest.raises(InputError, match=r"holds fixed nodes as constraints, which only \.npz"):
        certpgo.write(tmp_path / "out.g2o", again)
    with pytest.raises(InputError, match="nodes 0, 5 by constraints: it cannot be read with these"):
        certpgo.read(tmp_path / "out.npz", fixed=False)
    assert again.notices == instance.notices
    assert (again.graph.tau == 7.0).all()
    assert (again.graph.kappa == 3.0).all()
    assert (again.graph.arms == instance.graph.arms).all()
    assert (again.pairs == instance.pairs).all()
    assert again.held == instance.held == (0, 5)
    answer = certpgo.solve(instance, cost="chordal")
    proof = tmp_path / "x.cert", path, instance, answer.estimate, answer.certificate
    with pytest.raises(InputError, match="the checker holds no nodes that a file fixes"):
        certpgo.write_proof(*proof)
    rest = path.read_text().split("\n", 1)[1]
    path.write_text(rest)
    free = certpgo.read(path, quiet=True)
    assert "2 nodes fixed by the file: all are estimated" in free.notices[-1]
    assert free.notices[-1].endswith("initial values of all nodes")
    assert (free.graph.num_edges, free.held) == (len(PAIRS), ())


def test_npz_files_hold_fixed_nodes_as_their_source_states_them(tmp_path):
    # As constraints they could not be released, and what is measured between them was left out.
    path = tmp_path / "g.g2o"
    omega = "10 0 0 10 0 10"
    vertices = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(4)]
    steps = ((0, 2, "2.5 0.3 0.1"), (0, 1, "1.1 0 0"), (1, 2, "1 0.1 0"), (2, 3, "1 0 0.2"))
    edges = [f"EDGE_SE2 {i} {j} {step} {omega}" for i, j, step in (*steps, (1, 3, "2 0 0"))]
    path.write_text("\n".join([*vertices, "FIX 0", "FIX 2", *edges, ""]))
    for written_held in (True, False):
        out = tmp_path / f"{written_held}.npz"
        certpgo.write(out, certpgo.read(path, quiet=True, fixed=written_held))
        for fixed, count in ((True, 4), (False, 5)):
            first, again = (certpgo.read(one, quiet=True, fixed=fixed) for one in (path, out))
            assert again.num_measurements == first.num_measurements == count
            assert again.known_numbers.tolist() == first.known_numbers.tolist()
            assert (again.held, again.notices) == (first.held, first.notices)
            assert certpgo.solve(again).cost == pytest.approx(certpgo.solve(first).cost, rel=1e-6)
    alone = rotations_alone(certpgo.read(path, quiet=True))
    for suffix in ("npz", "g2o"):
        certpgo.write(tmp_path / f"alone.{suffix}", alone)
        again = certpgo.read(tmp_path / f"alone.{suffix}", quiet=True)
        assert again.held == alone.held == (0, 2)
        assert certpgo.solve(again).cost == pytest.approx(certpgo.solve(alone).cost, rel=1e-6)


def test_held_poses_get_no_measurements_from_elsewhere(tmp_path):
    # They would be of nodes that one edge holds, and bend it: CERTIFIED, but of another cost.
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(1), fixed=(0, 5))
    held, free = (certpgo.read(path, quiet=True, fixed=fixed) for fixed in (True, False))
    for session in (certpgo.Session(), certpgo.RobustSession()):
        with pytest.raises(InputError, match=r"nodes 0, 5 are held .* release them"):
            session.add(held)
        session.add(free)
    one = free.graph.with_edges([0]).subgraph([0, 1])
    between = certpgo.Instance("between", one, np.array([0, 105]))
    with pytest.raises(InputError, match="nodes 0, 5 are held"):
        certpgo.merge([held, free], between, offset=100)
    assert certpgo.merge([free, free], between, offset=100).instance.graph.num_nodes == 16
    # Measurements of one file that come one by one know where held poses are.
    session = certpgo.Session()
    for part, names in streamed(held):
        session.add(part, names)
    assert session.refresh().cost == pytest.approx(certpgo.solve(held).cost, rel=1e-6)


@pytest.mark.parametrize(("d", "kinds"), CASES[:3])
def test_an_estimate_that_moves_held_poses_is_named(tmp_path, d, kinds):
    path = written(tmp_path / "g.g2o", d, np.random.default_rng(5), **kinds)
    held, free = (certpgo.read(path, fixed=fixed, quiet=True) for fixed in (True, False))
    inside, outside = tmp_path / "inside.npz", tmp_path / "outside.npz"
    for file, instance in ((inside, held), (outside, free)):
        certpgo.write(file, certpgo.solve(instance, cost="chordal").estimate, instance=instance)
    with warnings.catch_warnings(action="error"):
        kept = certpgo.read_estimate(inside, held)
        certpgo.read_estimate(outside, free)
    with pytest.warns(certpgo.InputNotice, match="fixes are not where it holds them"):
        moved = certpgo.read_estimate(outside, held)
    assert displaced(held, kept) == ""
    assert " degrees and " in displaced(held, moved)
    for cost, title in (("chordal", "chordal cost F"), ("g2o", "g2o's chi2 of ")):
        found = certpgo.certify(held, moved, cost=cost)
        assert (found.broken, certpgo.certify(held, kept, cost=cost).broken) == (True, False)
        assert title in found.cost_in_words
        assert "held nodes that are moved" in " ".join(str(found).split())
    problem = objective_of(held, "chordal")
    assert fit_of(held, problem, kept) is not None
    assert fit_of(held, problem, moved) is None


def test_constraints_are_no_measurements(tmp_path):
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(1), fixed=(0, 3, 5))
    held, free = (certpgo.read(path, quiet=True, fixed=fixed) for fixed in (True, False))
    assert ((~held.is_measured).sum(), (~free.is_measured).sum()) == (2, 0)
    assert held.num_measurements == held.graph.num_edges - 2
    assert free.num_measurements == free.graph.num_edges
    assert held.measurements.in_words[-1] == "2 constraints of fixed nodes"


@pytest.mark.parametrize("size", [1, 4, 100])
@pytest.mark.parametrize(("d", "kinds"), [*CASES[:3], CASES[4]])
def test_a_stream_counts_the_measurements_alone(tmp_path, d, kinds, size):
    path = written(tmp_path / "g.g2o", d, np.random.default_rng(4), **kinds, sigma=0.003)
    whole = certpgo.read(path, quiet=True)
    turned = rotations_alone(certpgo.read(path, quiet=True, fixed=True))
    for instance in (whole, turned) if whole.world is None else (whole,):
        session = certpgo.Session(every=None)
        for part, names in streamed(instance, size):
            session.add(part, names)
        numbers = session.edges[session.edges >= 0]
        assert session.standing.edges == instance.num_measurements == len(numbers)
        assert sorted(numbers) == list(range(instance.num_measurements))
        assert session.graph.num_edges == instance.graph.num_edges
        assert session.refresh().cost == pytest.approx(certpgo.solve(instance).cost, rel=1e-6)


def test_the_world_stays_where_a_pose_is_held_in_it(tmp_path):
    # The edge between a held pose and the world is a constraint, no place that is assumed.
    path = written(
        tmp_path / "g.g2o", 2, np.random.default_rng(4), fixed=(3,), priors=(2, 5, 6), sigma=0.1
    )
    held = certpgo.read(path, quiet=True)
    world = held.graph.edges[:, 0] == held.world
    assert world.any()
    assert not places_world(held.graph).any()
    assert with_world_placed(held.graph, held.initial) is held.initial
    moved = held.initial.translations.copy()
    moved[3] += [1.0, 0.0]
    estimate = held.initial.with_translations(moved)
    np.testing.assert_array_equal(with_world_placed(held.graph, estimate).translations, moved)


#: A square in which one side says nothing of y; its last pose is turned and may be held.
OPEN_AXIS = """VERTEX_SE2 0 0 0 0
VERTEX_SE2 1 1 0 0.3
VERTEX_SE2 2 1 1 0.7
VERTEX_SE2 3 0 1 1.1
EDGE_SE2 0 1 1 0 0.3 9 1 0 8 0 50
EDGE_SE2 1 2 0.3 0.9 0.4 9 0 2 8 0 50
EDGE_SE2 2 3 -0.7 0.7 0.4 9 1 0 8 1 50
EDGE_SE2 1 3 -0.6 1.3 0.8 7 0 3 0 0 40
"""


def test_an_axis_that_a_held_pose_turns_is_named(tmp_path):
    path = tmp_path / "open.g2o"
    path.write_text(OPEN_AXIS + "FIX 0\nFIX 3\n")
    held, free = (certpgo.read(path, quiet=True, fixed=fixed) for fixed in (True, False))
    assert free.graph.is_definite.all()
    assert certpgo.solve(free, cost="g2o").cost > 0.0
    said = r"open.* not positive definite \(what they leave open is along no axis"
    with pytest.raises(InputError, match=said):
        certpgo.solve(held, cost="g2o")
    ((part, names),) = streamed(held, 100)
    with pytest.raises(InputError, match=said):
        certpgo.Session(cost="g2o").add(part, names)


def measured_in_part(path, d, rng):
    """A file with all that g2o holds: fixed nodes, priors, and information on parts of poses."""
    size, p = (7, 6) if d == 3 else (3, 3)
    vertex, edge, prior, position = {
        2: ("VERTEX_SE2", "EDGE_SE2", "EDGE_PRIOR_SE2", "EDGE_PRIOR_SE2_XY"),
        3: ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "EDGE_SE3_PRIOR", "EDGE_SE3_XYZPRIOR"),
    }[d]
    sensor = " 4" if d == 3 else ""

    def pose(x):
        turn = Rotation.from_rotvec(rng.normal(0, 0.1, 3) * ([1, 1, 1] if d == 3 else [0, 0, 1]))
        return _text(d, np.array([x, *rng.normal(0, 0.1, 2)]), turn)

    def information(rows):
        A = 3.0 * rng.normal(size=(p, p)) + 10.0 * np.eye(p)
        M = (A @ A.T) * np.isin(np.arange(p), rows) * np.isin(np.arange(p), rows)[:, None]
        return " ".join(repr(float(x)) for x in M[np.triu_indices(p)])

    every, moved, turned, some = range(p), range(d), range(d, p), [0, *range(d, p)]
    lines = [f"PARAMS_SE3OFFSET 4 {_text(3, *SENSOR)}"] if d == 3 else []
    lines += [
        f"{vertex} {k} {_text(d, np.array([k, 0, 0]), Rotation.identity())}" for k in range(5)
    ]
    lines += ["FIX 3 0"]
    ends = [(0, 1, every), (1, 2, some), (2, 3, every), (3, 4, every), (0, 2, moved)]
    for i, j, rows in [*ends, (1, 3, turned), (0, 3, every), (4, 0, every)]:
        lines += [f"{edge} {i} {j} {pose(j - i)} {information(rows)}"]
    for k, rows in ((1, every), (2, moved), (4, turned)):
        lines += [f"{prior} {k}{sensor} {pose(k)} {information(rows)}"]
    whole = "4 0 4" if d == 2 else "4 0 0 4 0 4"
    lines += [f"{position} 2{sensor} {' '.join('0' * d)} {whole}"]
    path.write_text("\n".join(lines) + "\n")
    assert len(pose(0.0).split()) == size
    return path


@pytest.mark.parametrize("d", [2, 3])
def test_what_a_g2o_file_holds_is_written_to_g2o_again(tmp_path, d):
    instance = certpgo.read(
        measured_in_part(tmp_path / "g.g2o", d, np.random.default_rng(d)), quiet=True
    )
    certpgo.write(tmp_path / "again.g2o", instance)
    again = certpgo.read(tmp_path / "again.g2o", quiet=True)
    assert again.held == instance.held
    assert (again.pairs == instance.pairs).all()
    assert (again.known_numbers == instance.known_numbers).all()
    assert again.measurements.counts == instance.measurements.counts
    for name in ("rotations", "translations"):
        np.testing.assert_array_equal(getattr(again.initial, name), getattr(instance.initial, name))
    for cost in ("chordal", "g2o"):
        there, here = (objective_of(one, cost) for one in (again, instance))
        for k in range(3):
            point = certpgo.Estimate(
                so.random(np.random.default_rng(k), 6, d),
                np.random.default_rng(k).normal(size=(6, d)),
            )
            assert there.cost(point) == pytest.approx(here.cost(point), rel=1e-12)
    free = certpgo.read(tmp_path / "again.g2o", quiet=True, fixed=False)
    assert free.graph.num_edges == 12  # also those between held nodes


def test_nothing_is_estimated_where_all_measurements_are_between_held_nodes(tmp_path):
    path = tmp_path / "held.g2o"
    poses = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nFIX 0\nFIX 1\n"
    path.write_text(poses + "EDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n")
    with pytest.raises(InputError, match=r"0, 1 are fixed, and all measurements are between them"):
        certpgo.read(path)
    free = certpgo.read(path, quiet=True, fixed=False)
    assert certpgo.solve(free).cost == pytest.approx(0.0, abs=1e-20)


def test_a_part_of_a_graph_has_the_measurements_of_held_nodes_that_it_has(tmp_path):
    """An estimate that lacks the first held node: its measurements go, those of the others stay."""
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(1), fixed=(0, 5, 6))
    held, free = (certpgo.read(path, quiet=True, fixed=fixed) for fixed in (True, False))
    some = np.arange(1, 8)
    part = restricted(held, some, "part")
    named = {tuple(pair) for pair in part.pairs[part.known_numbers >= 0].tolist()}
    inside = [tuple(pair) for pair in free.pairs.tolist() if 0 not in pair]
    assert named == {*inside} - {(5, 6)}
    assert part.held == (4, 5)


def ground_control(path, d, rng, held):
    """Poses in a frame of their own that see points which a survey holds, far from its origin."""
    vertex, point, edge, seen = {
        2: ("VERTEX_SE2", "VERTEX_XY", "EDGE_SE2", "EDGE_SE2_XY"),
        3: ("VERTEX_SE3:QUAT", "VERTEX_TRACKXYZ", "EDGE_SE3:QUAT", "EDGE_SE3_TRACKXYZ"),
    }[d]
    turn = Rotation.from_rotvec([0.0, 0.0, 0.6])
    poses = [
        (np.array([k, 0.3 * k, 0.0]), turn * Rotation.from_rotvec([0, 0, 0.1 * k]))
        for k in range(6)
    ]
    survey = np.array([500.0, 300.0, 10.0])
    points = survey + np.array([[2.0, 1, 0], [3, -2, 0.5], [7, 3, 1], [5, 5, 2]])
    lines = ["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1"] if d == 3 else []
    local = turn.inv()
    for k, (t, R) in enumerate(poses):
        lines += [f"{vertex} {k} {_text(d, local.apply(t), local * R)}"]
    for k, p in enumerate(points):
        lines += [f"{point} {10 + k} {' '.join(repr(float(x)) for x in p[:d])}"]
        lines += [f"FIX {10 + k}"] if k < held else []
    measured, p = [], d * (d + 1) // 2
    for i in range(5):
        (t, R), (u, S) = poses[i], poses[i + 1]
        step = R.inv().apply(u - t) + 0.02 * rng.normal(size=3) * [1, 1, d == 3]
        measured += [(i, i + 1, step, R.inv() * S, 25.0)]
        weights = np.diag([25.0] * d + [25.0 * (1 if d == 2 else 2)] * (p - d))
        triangle = " ".join(map(repr, weights[np.triu_indices(p)].tolist()))
        lines += [f"{edge} {i} {i + 1} {_text(d, step, R.inv() * S)} {triangle}"]
    for i, k in ((0, 0), (2, 0), (1, 1), (4, 1), (3, 2), (5, 2), (5, 3)):
        t, R = poses[i]
        z = R.inv().apply(points[k] - survey - t) + 0.02 * rng.normal(size=3) * [1, 1, d == 3]
        measured += [(i, 10 + k, z, None, 100.0)]
        sensor = " 0" if d == 3 else ""
        triangle = " ".join(map(repr, (100.0 * np.eye(d))[np.triu_indices(d)].tolist()))
        z = " ".join(repr(float(x)) for x in z[:d])
        lines += [f"{seen} {i} {10 + k}{sensor} {z} {triangle}"]
    path.write_text("\n".join(lines) + "\n")
    return measured, points, [(survey + t, R) for t, R in poses]


def least_cost(measured, points, poses, d, held):
    """F by SciPy with the points held, and the first pose's position."""
    axes, free = np.r_[[True] * d, [False] * (3 - d)], len(points) - held
    turns = axes if d == 3 else ~axes

    def placed(x):
        moves = x[: 6 * len(poses)].reshape(-1, 2, 3)
        now = [
            (t + m * axes, R * Rotation.from_rotvec(w * turns))
            for (t, R), (m, w) in zip(poses, moves, strict=True)
        ]
        moved = points.copy()
        moved[held:] += x[6 * len(poses) :].reshape(free, 3) * axes
        return now, moved

    def residuals(x):
        now, seen = placed(x)
        for i, j, z, R, weight in measured:
            t, Q = now[i]
            end = seen[j - 10] if R is None else now[j][0]
            yield np.sqrt(weight) * (Q.inv().apply(end - t) - z)[:d]
            if R is not None:
                off = (Q * R).as_matrix() - now[j][1].as_matrix()
                yield 5.0 * off.ravel()

    start = np.zeros(6 * len(poses) + 3 * free)
    found = optimize.least_squares(
        lambda x: np.concatenate(list(residuals(x))), start, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    return 2.0 * found.cost, placed(found.x)[0][0][0][:d]


@pytest.mark.parametrize(("d", "held"), [(2, 4), (2, 2), (3, 4), (3, 3)])
def test_points_that_a_file_fixes_are_held_where_they_are(tmp_path, d, held):
    """Ground control without a pose that is fixed: the answer is in the survey's frame."""
    path = tmp_path / "control.g2o"
    measured, points, poses = ground_control(path, d, np.random.default_rng(d), held)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance, cost="chordal")
    cost, first = least_cost(measured, points, poses, d, held)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(cost, rel=1e-6)
    found = instance.in_world(answer.estimate)
    np.testing.assert_allclose(found.translations[0], first, atol=1e-5)
    np.testing.assert_allclose(found.translations[6 : 6 + held], points[:held, :d], atol=1e-9)
    certpgo.write(tmp_path / "again.g2o", instance)
    again = certpgo.read(tmp_path / "again.g2o", quiet=True)
    assert certpgo.solve(again, cost="chordal").cost == pytest.approx(cost, rel=1e-6)
    certpgo.write(tmp_path / "answer.g2o", answer.estimate, instance=instance)
    judged = certpgo.certify(again, str(tmp_path / "answer.g2o"), cost="chordal")
    assert judged.verdict.value == "CERTIFIED"
    assert np.isfinite(answer.covariance(0)).all()
    free = certpgo.solve(certpgo.read(path, quiet=True, fixed=False), cost="chordal")
    assert free.cost < answer.cost


def test_parts_of_rotations_alone_are_of_rotations_and_keep_what_is_held(tmp_path):
    held = Rotation.from_rotvec(np.outer(np.radians([0.0, 10.0, 25.0]), [0, 0, 1])).as_quat()
    values = [f"VERTEX_SE3:QUAT {k} {k} 0 0 {' '.join(map(str, q))}" for k, q in enumerate(held)]
    values += [f"VERTEX_SE3:QUAT {k} {k} 0 0 0 0 0 1" for k in (5, 6)]
    weight = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 8 0 0 8 0 8"
    edges = [f"EDGE_SE3:QUAT {i} {j} 1 9 0 0 0 0 1 {weight}" for i, j in [(0, 1), (1, 2), (5, 6)]]
    path = tmp_path / "held.g2o"
    path.write_text("\n".join([*values, "FIX 0 2", *edges]) + "\n")
    alone = rotations_alone(certpgo.read(path, quiet=True))
    parts = connected_parts(alone, "each")
    assert [part.graph.kind for part in parts] == ["rotations"] * 2
    assert [part.pairs.tolist() for part in parts] == [[[0, 1], [1, 2], [0, 2]], [[5, 6]]]
    assert parts[0].known_numbers.tolist() == [0, 1, -1]
    # Held 25 degrees apart, where the two measurements say 0: each is off by half of that.
    assert certpgo.solve(parts[0]).cost == pytest.approx(
        2 * 4.0 * 8.0 * np.sin(np.radians(25.0) / 4) ** 2, rel=1e-9
    )


def test_known_outliers_are_known_where_poses_are_held(tmp_path):
    instance = certpgo.read(written(tmp_path / "held.g2o", 3, np.random.default_rng(0)))
    flags = np.arange(instance.graph.num_edges) % 3 == 0
    known = with_held(replace(instance, fixed=(0, 1, 5), outliers=flags))
    assert known.held == (0, 1, 5)
    numbers = known.known_numbers
    assert known.outliers.tolist() == [k >= 0 and bool(flags[k]) for k in numbers.tolist()]


def test_constraints_are_known_in_any_order_of_edges(tmp_path):
    path = written(tmp_path / "g.g2o", 2, np.random.default_rng(1), fixed=(0, 5))
    held = certpgo.read(path, quiet=True)
    back = np.arange(held.graph.num_edges)[::-1]
    for instance in (held, rotations_alone(held)):
        turned = instance.with_edges(back)
        assert turned.is_measured.tolist() == held.is_measured[::-1].tolist()
        assert turned.known_numbers.tolist() == held.known_numbers[::-1].tolist()
        assert turned.pairs.tolist() == held.pairs[::-1].tolist()
        assert turned.measurements.in_words == instance.measurements.in_words

"""Measurements of huge weight: a leaf changes neither optimum nor bound, no verdict is empty."""

import math
from pathlib import Path

import numpy as np
import pytest
from strategies import pose_graph

import certpgo
from certpgo import Estimate, Ranges, Tier, Verdict, certify, solve
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.obstacle import LimitedBy
from certpgo.certify.stiff_edges import BRIDGE, IN_CYCLE, eased
from certpgo.certify.verdict import loses_to_rounding
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.scale import MOST, Scale
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.exact_fit import fits_exactly
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import rejecting
from reports.studies import stiff_edges as study

DATA = Path(__file__).parents[1] / "data"
WEIGHTS = [1e6, 1e12, 1e15, 1e20, 1e30]


def ring(weight, turn=2.0 * np.pi / 30.0):
    """A circle of 30 cameras 1 m apart, one with another in a mount of this weight.

    The graph measures exact circles; the estimate turns by ``turn`` at each camera, so at twice the
    right one it winds around twice, with sides as long.
    """
    n, right = 30, 2.0 * np.pi / 30.0
    edges = np.array([*((k, (k + 1) % n) for k in range(n)), (0, n)])
    R = np.array([*[turned(right)] * n, np.eye(3)])
    t = np.array([*[(1.0, 0, 0)] * n, (0.1, 0, 0)])
    weights = np.r_[np.ones(n), weight]
    graph = PoseGraph(RotationGraph(n + 1, edges, R, weights), t, weights)
    headings = turn * np.arange(n)
    steps = np.stack([np.cos(headings), np.sin(headings), np.zeros(n)], axis=1)
    positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)[:-1], [[0.1, 0, 0]]])
    rotations = np.array([*map(turned, headings), np.eye(3)])
    return graph, Estimate(rotations, positions)


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("weight", WEIGHTS)
@pytest.mark.parametrize("tier", ["standard", "proof"])
def test_a_mount_certifies_nothing_of_a_wound_estimate(weight, tier):
    graph, wound = ring(weight, 4.0 * np.pi / 30.0)
    problem = Quadratic(graph)
    judged = certify(problem, wound, refine=False, tier=tier)
    assert judged.verdict is Verdict.UNDECIDED
    assert not judged.is_optimal
    if weight < 1e30:  # where rounding of its own residual costs more than all others
        assert certify(problem, wound, tier=tier).verdict is Verdict.REFUTED
    _, right = ring(weight)
    found = certify(problem, right, tier=tier)
    assert found.verdict is Verdict.CERTIFIED
    assert str(found).startswith("EXACT FIT. ")


@pytest.mark.parametrize("weight", WEIGHTS[:4])
@pytest.mark.parametrize(
    ("cost", "lower", "upper", "verdict"),
    [
        ("g2o", 102.37672, 122.279134, Verdict.BOUNDED),  # as without the leaf
        ("chordal", 157.056040, 157.056040, Verdict.CERTIFIED),  # over complex numbers
        ("gtsam", 99.42177, 125.946649, Verdict.BOUNDED),
    ],
)
def test_a_leaf_changes_neither_optimum_nor_bound(tmp_path, weight, cost, lower, upper, verdict):
    text = (DATA / "loose_with_stiff_leaf.g2o").read_text()
    path = tmp_path / "leaf.g2o"
    path.write_text(text.replace("1000000000000000.0", repr(weight)))
    found = solve(certpgo.read(path), cost=cost).certificate
    assert found.verdict is verdict
    assert found.lower_bound == pytest.approx(lower, rel=1e-4)
    assert found.cost_upper == pytest.approx(upper, rel=1e-6)


@pytest.mark.parametrize("weight", WEIGHTS[:4])
def test_noisy_measurements_stay_certified_beside_a_mount(weight):
    graph, _, _ = pose_graph(np.random.default_rng(3), 12, 3, noise=0.05)
    alone = solve(graph).certificate
    kappa, tau = (np.r_[w, weight] for w in (graph.kappa, graph.tau))
    edges, R = np.r_[graph.edges, [(0, 12)]], np.r_[graph.rotations, [np.eye(3)]]
    t = np.r_[graph.translations, [(0.1, 0, 0)]]
    found = solve(PoseGraph(RotationGraph(13, edges, R, kappa), t, tau)).certificate
    assert alone.verdict is found.verdict is Verdict.CERTIFIED
    assert found.relative_gap < 1e-5
    assert found.lower_bound == pytest.approx(alone.lower_bound, rel=1e-6)


@pytest.mark.filterwarnings("ignore::certpgo.InputNotice")
@pytest.mark.parametrize("refine", [True, False])
def test_a_scan_given_twice_certifies_no_map_that_is_3_m_off(refine):
    instance = certpgo.read(DATA / "scan_given_twice.g2o")
    off = instance.initial.translations.copy()
    off[2] += (3.0, 0, 0)
    found = certify(instance, instance.initial.with_translations(off), refine=refine)
    assert found.verdict is (Verdict.BOUNDED if refine else Verdict.UNDECIDED)
    assert found.cost_upper > 4e8
    assert solve(instance).certificate.is_exact_fit


GPS = """PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1
EDGE_SE3:QUAT 0 1 0.319181214 0.00156118433 -0.000252786441 0 0 0 1 {e}
EDGE_SE3:QUAT 1 2 0.319181214 0.00156118433 -0.000252786441 0 0 0 1 {e}
EDGE_SE3_XYZPRIOR 0 0 0 0 0 {p}
EDGE_SE3_XYZPRIOR 2 0 0.18027407 -0.592937857 0.00239996889 {p}
"""
STEP = "1000000 0 0 0 0 0 1000000 0 0 0 0 1000000 0 0 0 10000 0 0 10000 0 10000"


@pytest.mark.filterwarnings("ignore::certpgo.InputNotice")
@pytest.mark.parametrize("cost", ["g2o", "chordal", "gtsam"])
@pytest.mark.parametrize("weight", ["1e20", "1e30"])
def test_exact_positions_leave_a_bound(tmp_path, cost, weight):
    """Two steps of .319185 m between points .619742 m apart: 2e6 (.319185 - .309871)^2."""
    path = tmp_path / "gps.g2o"
    path.write_text(GPS.format(e=STEP, p=f"{weight} 0 0 {weight} 0 {weight}"))
    found = solve(certpgo.read(path), cost=cost).certificate
    assert found.cost_computed == pytest.approx(173.511, rel=1e-5)
    assert 160.0 < found.lower_bound <= 173.512
    assert (f"as computed       {found.cost_computed:.9g}" in str(found)) is (weight == "1e30")
    if (cost, weight) == ("chordal", "1e20"):
        assert found.verdict is Verdict.CERTIFIED


def test_one_weight_does_not_make_w_its_own():
    ones = Scale.of(
        RotationGraph(4, np.array([(0, 1), (1, 2), (2, 3)]), [np.eye(3)] * 3, [1, 1, 1])
    )
    assert ones.total == 3.0
    graph = RotationGraph(4, np.array([(0, 1), (1, 2), (2, 3)]), [np.eye(3)] * 3, [1, 1e30, 1])
    assert Scale.of(graph).total == 2.0 + MOST
    assert (ones + Scale.of(graph)).total == 5.0 + MOST
    assert Scale.none().total == 0.0


def test_stiff_measurements_are_lowered_by_powers_of_two():
    graph, _ = ring(3e15)
    assert eased(Quadratic(ring(2.0**9)[0])).scale == Quadratic(ring(2.0**9)[0]).scale
    soft = eased(Quadratic(graph))
    last = soft.graph.kappa[-1]
    assert 0.5 < last <= 1.0
    assert math.frexp(3e15 / last)[0] == 0.5
    assert (soft.graph.kappa[:-1] == 1.0).all()
    in_cycle = graph.reweighted(np.r_[2.0**40, np.ones(29), 1.0 / 3e15])
    assert eased(Quadratic(in_cycle)).graph.tau[0] == IN_CYCLE
    assert eased(Quadratic(in_cycle), cycles=False).graph.tau[0] == 2.0**40
    assert BRIDGE < IN_CYCLE


@pytest.mark.parametrize("factor", [2.0**-60, 1.0, 2.0**70])
@pytest.mark.parametrize("unit", [2.0**-30, 1.0, 2.0**30])
def test_exact_fits_depend_on_no_scale(factor, unit):
    graph, right = ring(1e12)
    kappa, tau = factor * graph.kappa, factor / unit**2 * graph.tau
    scaled = PoseGraph(
        RotationGraph(31, graph.edges, graph.rotations, kappa),
        unit * graph.translations,
        tau,
    )
    at = Estimate(right.rotations, unit * right.translations)
    assert certify(Quadratic(scaled), at).is_exact_fit
    moved = at.translations.copy()
    moved[5] += 1e-6 * unit
    found = certify(Quadratic(scaled), at.with_translations(moved))
    assert found.verdict is Verdict.BOUNDED
    assert found.basin_is_global
    turn = turned(1.2)
    there = Estimate(turn @ at.rotations, at.translations @ turn.T + unit * np.array([7.0, -3, 2]))
    assert certify(Quadratic(scaled), there).is_exact_fit


def test_a_cost_that_is_not_rounding_is_no_exact_fit():
    instance, best = winding_cycle(9, 1e-6, 0)
    problem = Quadratic(instance.graph)
    assert not fits_exactly(problem, best)
    found = certify(problem, best)
    assert found.verdict is Verdict.CERTIFIED
    assert not found.is_exact_fit
    assert found.relative_gap < 1e-3
    assert "EXACT" not in str(found)
    assert found.as_data()["is_exact_fit"] is False


@pytest.mark.parametrize("far", [0.0, 5e6])
def test_an_origin_far_away_makes_no_exact_fit(far):
    """Errors of 4 micrometres in a loop of 20 m are none of rounding, wherever the origin is."""
    n, off = 20, 4e-6
    edges = np.array([(k, (k + 1) % n) for k in range(n)])
    positions = np.cumsum([*[(2.0, 0.0)] * 10, *[(-2.0, 0.0)] * 10], axis=0)
    steps = positions[edges[:, 1]] - positions[edges[:, 0]] + [off, 0.0]
    rotation = RotationGraph(n, edges, np.tile(np.eye(2), (n, 1, 1)), np.full(n, 1e12))
    problem = Quadratic(PoseGraph(rotation, steps, np.ones(n)))
    at = Estimate(rotation.rotations, positions + far)
    assert not certify(problem, at, refine=False).is_exact_fit
    exact = Quadratic(PoseGraph(rotation, steps - [off, 0.0], np.ones(n)))
    assert certify(exact, at, refine=False).is_exact_fit


def test_distances_far_from_the_origin_are_no_exact_fit_unless_met():
    t = 5e6 + np.array([(0.0, 0.0), (3.0, 0.0), (0.0, 4.0)])
    steps = t[1:] - t[0]
    rotation = RotationGraph(3, [(0, 1), (0, 2)], np.tile(np.eye(2), (2, 1, 1)), np.ones(2))
    graph = PoseGraph(rotation, steps, np.ones(2))
    at = Estimate(np.tile(np.eye(2), (3, 1, 1)), t)
    for length, fits in ((5.0, True), (5.0 + 4e-6, False)):
        ranges = Ranges(3, [(1, 2)], [length], [1.0])
        assert fits_exactly(objective_of(graph.with_ranges(ranges)), at) is fits


@pytest.mark.parametrize("seed", [6, 24])
def test_a_stiff_leaf_raises_no_bound_on_a_truncated_cost(seed):
    """Where a minorant is above its cost's traces by rounding, a lower weight would raise it."""
    rng = np.random.default_rng(seed)
    graph, _, _ = pose_graph(rng, 5, 2, noise=0.01)
    edges = np.r_[graph.edges, [(0, 5)]]
    R = np.r_[graph.rotations, graph.rotations[:1]]
    t = np.r_[graph.translations, rng.standard_normal((1, 2))]
    A = rng.standard_normal((len(edges), 3, 3))
    W = A @ np.swapaxes(A, 1, 2) + np.eye(3)
    W[-1] *= 2.0**57
    weights = np.r_[np.ones(graph.num_edges), 2.0**57]
    whole = PoseGraph(RotationGraph(6, edges, R, weights), t, weights)
    information = Information.of(0.5 * (W + np.swapaxes(W, 1, 2)), "gtsam")
    problem = objective_of(whole.with_information(information), "gtsam")
    found = certify(rejecting(problem, np.array([2])), solve(problem).estimate)
    assert 0.0 < found.lower_bound <= found.best_cost


@pytest.mark.parametrize("weight", [2.0**33, 2.0**50])
@pytest.mark.parametrize("d", [2, 3])
def test_a_stiff_bridge_changes_no_verdict_on_rejections(d, weight):
    rng = np.random.default_rng(7)
    graph, _, _ = pose_graph(rng, 6, d, noise=0.02)
    joined = PoseGraph(
        RotationGraph(
            12,
            np.r_[graph.edges, graph.edges + 6, [(2, 8)]],
            np.r_[graph.rotations, graph.rotations, [np.eye(d)]],
            np.r_[100.0 * graph.kappa, graph.kappa, weight],
        ),
        np.r_[graph.translations, graph.translations, [np.ones(d)]],
        np.r_[100.0 * graph.tau, graph.tau, weight],
    )
    soft = joined.reweighted(np.r_[np.ones(2 * graph.num_edges), 1.0 / weight])
    costs = []
    for measured in (soft, joined):
        problem = Quadratic(measured)
        at = solve(problem).estimate
        for posed in (problem, rejecting(problem, np.array([1]))):
            found = certify(posed, at)
            assert found.verdict is Verdict.CERTIFIED
            assert found.refined_cost <= found.cost_upper * (1.0 + 1e-5)
            costs.append((found.lower_bound, found.cost_upper))
    np.testing.assert_allclose(costs[:2], costs[2:], rtol=1e-4)


@pytest.mark.parametrize("atol", [1e-3, 0.5])
def test_no_tolerance_of_w_certifies_a_gap_of_more_than_a_thousandth(atol):
    instance, wound = winding_cycle(9, 0.3, 1)
    found = certify(Quadratic(instance.graph), wound, refine=False, atol=atol)
    assert found.verdict is not Verdict.CERTIFIED
    assert found.tolerance <= (found.rtol + 1e-3) * found.cost_upper


@pytest.mark.filterwarnings("ignore::certpgo.InputNotice")
def test_rounding_is_named_only_where_the_relaxation_is_no_lower(tmp_path):
    """The relaxation of measured positions in a plane may mirror; no tier closes that gap."""
    path = tmp_path / "loose.g2o"
    path.write_text((DATA / "loose_with_stiff_leaf.g2o").read_text())
    instance = certpgo.read(path)
    answer = solve(instance)
    for found in (answer.certificate, certify(instance, answer.estimate)):
        assert found.verdict is Verdict.BOUNDED
        assert found.limited_by is LimitedBy.LOOSE
    problem = Quadratic(ring(1.0)[0])
    normalized = NormalizedProblem.of(problem, Tier.STANDARD, 1e-5, 1e-12)
    assert not loses_to_rounding(normalized, None, 1.0)


def test_a_session_is_not_certified_by_a_mount():
    graph, _ = ring(1e15)
    session = certpgo.Session(cost="chordal")
    session.add(graph)
    assert session.refresh().stated == "EXACT FIT"
    bad = PoseGraph(
        RotationGraph(2, np.array([(0, 1)]), [turned(0.5)], [10.0]), [(1.0, 0, 0)], [10.0]
    )
    session.add(bad, [3, 20])
    standing = session.standing
    assert standing.cost > 1.0
    assert standing.verdict is not Verdict.CERTIFIED
    assert session.refresh().lower_bound > 1.0
    assert standing.stated == standing.verdict.value


def test_a_sample_of_the_study():
    table, false = study.run(6, seed=5)
    assert false == []
    assert sum(row[verdict] for row in table for verdict in study.ORDER) == 6


def test_predicates_of_public_classes_are_properties():
    """`assert certificate.is_optimal` always passes if that is a method."""
    found = []
    for name in certpgo.__all__:
        public = getattr(certpgo, name)
        if isinstance(public, type):
            members = {key: value for one in public.__mro__ for key, value in vars(one).items()}
            found += [
                f"{name}.{key}"
                for key, value in members.items()
                if key.startswith(("is_", "has_", "are_", "can_")) and callable(value)
            ]
    assert found == []
    instance, best = winding_cycle(6, 0.3, 0)
    certificate = certify(Quadratic(instance.graph), best)
    assert certificate.is_optimal is True
    assert certificate.proves_optimal(certificate.cost_upper)
    assert not certificate.proves_optimal(2.0 * certificate.cost_upper)

"""What is said of an answer beside its verdict: against definitions, and what really happens."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dense_cost, dimensions, point_graph, pose_graph, rng_of, seeds

from certpgo import certify, io, with_priors
from certpgo.certify import Verdict
from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance
from certpgo.graph.phrases import bound_shown, cost_shown
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.io.digits import writing_of
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton
from certpgo.solve.assessment import assess, costly_edges, distance
from certpgo.solve.batch import JudgedPart, judge_all, write_rows
from certpgo.solve.judging import Judge

JARGON = (
    "dual",
    "multiplier",
    "eigen",
    "relax",
    "semidefinite",
    "lagrang",
    "stationar",
    "manifold",
)


def optimum(seed, n, d, **options):
    graph, R, t = pose_graph(rng_of(seed), n, d, **options)
    problem = Quadratic(graph)
    return problem, newton(problem, Estimate(R, t)).estimate


@settings(max_examples=20)
@given(seeds, dimensions)
def test_distances_do_not_see_the_frame(seed, d):
    rng = rng_of(seed)
    _, estimate = optimum(seed, 8, d)
    moved = estimate.moved(so.random(rng, 1, d)[0], 10.0 * rng.standard_normal(d))
    same = distance(estimate, moved)
    assert max(same.worst_deg, same.worst_m) < 1e-9
    shaken = Estimate(
        estimate.rotations @ so.exp(0.1 * rng.standard_normal((8, so.tangent_dim(d)))),
        estimate.translations + 0.1 * rng.standard_normal((8, d)),
    )
    there, elsewhere = distance(estimate, shaken), distance(moved, shaken)
    assert there.mean_deg == pytest.approx(elsewhere.mean_deg, rel=1e-9)
    assert there.worst_m == pytest.approx(elsewhere.worst_m, rel=1e-9)
    assert 0.0 < there.mean_deg <= there.worst_deg
    assert 0.0 < there.mean_m <= there.worst_m


def test_the_distance_of_one_turned_and_one_moved_node():
    n = 1000  # so many that one outlier hardly moves the alignment
    rng = np.random.default_rng(0)
    R, t = so.random(rng, n, 3), rng.standard_normal((n, 3))
    turned, shifted = R.copy(), t.copy()
    turned[3] = turned[3] @ so.exp(np.array([0.0, 0.0, math.radians(10.0)]))
    shifted[7, 0] += 0.5
    found = distance(Estimate(R, t), Estimate(turned, shifted))
    assert found.worst_deg == pytest.approx(10.0, rel=2e-2)
    assert found.mean_deg == pytest.approx(0.01, rel=1.0)
    assert found.worst_m == pytest.approx(0.5, rel=2e-2)
    assert distance(Estimate(R), Estimate(turned)).worst_m is None


@settings(max_examples=20)
@given(seeds, dimensions)
def test_costly_edges_are_terms_of_the_cost(seed, d):
    graph, R, t = pose_graph(rng_of(seed), 6, d)
    problem, estimate = Quadratic(graph), Estimate(R, t)
    ids = np.array([10, 20, 30, 40, 50, 60])
    edges = costly_edges(problem, estimate, Instance("six", graph, ids), graph.num_edges)
    assert sum(edge.cost for edge in edges) == pytest.approx(dense_cost(graph, R, t), rel=1e-12)
    assert sum(edge.share for edge in edges) == pytest.approx(1.0, rel=1e-12)
    costs = [edge.cost for edge in edges]
    assert costs == sorted(costs, reverse=True)
    for edge in edges:
        i, j = graph.edges[edge.edge]
        assert edge.ids == (ids[i], ids[j])
        r = t[j] - t[i] - R[i] @ graph.translations[edge.edge]
        assert edge.metres == pytest.approx(np.linalg.norm(r), rel=1e-9)


@settings(max_examples=10)
@given(seeds, dimensions)
def test_distances_are_between_poses_alone(seed, d):
    """Landmarks and the world have rotations in an estimate, and no place in a trajectory."""
    rng = rng_of(seed)
    graph, truth = point_graph(rng, 5, 4, d)
    nodes = graph.pose_nodes
    joined = with_priors(graph, nodes[:3], translations=truth.translations[nodes[:3]], tau=4.0)
    instance = Instance("field", joined, np.arange(joined.num_nodes), world=graph.num_nodes)
    assert instance.poses.tolist() == nodes.tolist()
    problem = Quadratic(joined)
    start = Estimate(
        np.concatenate([truth.rotations, np.eye(d)[None]]),
        np.concatenate([truth.translations, np.zeros((1, d))]),
    )
    best = newton(problem, start).estimate
    R, t = best.rotations.copy(), best.translations.copy()
    R[graph.is_point.nonzero()[0]] = so.random(rng, int(graph.is_point.sum()), d)
    t[-1] += 100.0  # the world
    t[: graph.num_nodes][graph.is_point] += 50.0
    found = assess(problem, Estimate(R, t), certify(problem, best), instance=instance)
    assert found.distance.worst_deg < 1e-4
    assert found.distance.worst_m < 1e-6
    for edge in found.edges:
        e = edge.edge
        assert (edge.angle is None) == (joined.kappa[e] == 0.0)
        assert (edge.metres is None) == (joined.tau[e] == 0.0)


def test_a_bad_edge_is_named_and_a_perfect_answer_has_none():
    graph, R, t = pose_graph(np.random.default_rng(0), 20, 3, noise=0.0)
    translations = graph.translations.copy()
    translations[5] += 1.0
    problem = Quadratic(replace(graph, translations=translations))
    worst = costly_edges(problem, Estimate(R, t))[0]
    assert worst.edge == 5
    assert worst.metres == pytest.approx(math.sqrt(3.0), rel=1e-9)
    assert worst.share > 0.999
    exact, _ = winding_cycle(20, 0.0, 0)
    same = Estimate(np.tile(np.eye(3), (20, 1, 1)))
    assert costly_edges(Quadratic(exact.graph), same) == ()
    broken = Estimate(R, 1e200 * rng_of(0).standard_normal((20, 3)))
    with np.errstate(over="ignore"):
        assert costly_edges(problem, broken) == ()


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("suffix", [".g2o", ".tum"])
@pytest.mark.parametrize("d", [2, 3])
def test_what_digits_cost_is_what_they_do_cost(tmp_path, d, suffix, count):
    problem, best = optimum(1, 60, d, noise=0.02)
    ids = np.arange(60)
    path = tmp_path / f"estimate{suffix}"
    io.write(path, best)
    lines = []
    for line in path.read_text().splitlines():
        words = line.split()
        start = 2 if suffix == ".g2o" else 1
        lines.append(" ".join(words[:start] + [f"{float(w):.{count}f}" for w in words[start:]]))
    path.write_text("\n".join(lines) + "\n")
    given = io.read_estimate(path, Instance("walk", problem.graph, ids))
    found = assess(problem, given, certify(problem, given), writing=writing_of(path))
    assert found.rounding.digits.count == count
    # Rounding another copy of the optimum: the same size, not the same draw.
    assert 0.5 < found.rounding.cost / found.excess < 2.0
    assert found.best_is_optimal


def test_an_answer_short_of_the_optimum():
    problem, best = optimum(0, 12, 3)
    turns = np.zeros((12, 3))
    turns[4, 2] = 0.05
    given = Estimate(best.rotations @ so.exp(turns), best.translations)
    certificate = certify(problem, given)
    found = assess(problem, given, certificate)
    assert certificate.verdict is Verdict.BOUNDED
    assert found.best is certificate.refined
    assert found.best_is_optimal
    assert found.excess == pytest.approx(problem.cost(given) - problem.cost(best), rel=1e-6)
    assert 1.0 < found.distance.worst_deg < math.degrees(0.05) * 1.001
    assert found.rounding is None
    screened = assess(problem, given, certify(problem, given, tier="screen"))
    assert not screened.best_is_optimal


def test_the_best_answer_is_the_better_one_or_the_answer_itself():
    instance, wound = winding_cycle(20, 0.1, 1)
    problem = Quadratic(instance.graph)
    certificate = certify(problem, wound)
    found = assess(problem, wound, certificate)
    assert certificate.verdict is Verdict.REFUTED
    assert found.best is certificate.better
    assert found.best_is_optimal
    assert found.distance.worst_deg > 90.0
    certified = certify(problem, certificate.better)
    again = assess(problem, certificate.better, certified)
    assert certified.verdict is Verdict.CERTIFIED
    assert again.excess <= certified.tolerance


def sentences():
    instance, wound = winding_cycle(20, 0.1, 1)
    cycle = Quadratic(instance.graph)
    yield certify(cycle, wound)
    yield certify(cycle, wound, refine=False)
    yield certify(cycle, certify(cycle, wound).better)
    problem, best = optimum(0, 12, 3)
    yield certify(problem, best)
    poor = Estimate(best.rotations, 2.0 * best.translations)
    yield certify(problem, poor)
    yield certify(problem, poor, refine=False)
    yield certify(problem, poor, tier="screen")
    exact, _ = winding_cycle(20, 0.0, 0)
    yield certify(Quadratic(exact.graph), Estimate(np.tile(np.eye(3), (20, 1, 1))))


def test_sentences_need_no_paper():
    said = list(sentences())
    assert {c.verdict for c in said} == set(Verdict)
    for c in said:
        assert not any(word in c.reason.lower() for word in JARGON), c.reason
        assert "\n" not in c.reason
        assert cost_shown(c.cost_upper) in c.reason
        if c.verdict is not Verdict.UNDECIDED:
            assert bound_shown(c.lower_bound) in c.reason


def part_of(problem, name="walk"):
    return JudgedPart(Instance(name, problem.graph, np.arange(problem.n)), problem, Judge(problem))


def test_one_bound_serves_all_answers_that_lead_to_it(monkeypatch):
    from certpgo.certify import bound

    computed = []
    original = bound.dual_bound
    monkeypatch.setattr(
        bound, "dual_bound", lambda *a, **k: computed.append(1) or original(*a, **k)
    )
    problem, best = optimum(0, 12, 3)
    shaken = {
        str(k): Estimate(
            best.rotations @ so.exp(0.01 * rng_of(k).standard_normal((12, 3))), best.translations
        )
        for k in range(6)
    }
    part = part_of(problem)
    rows = list(judge_all(shaken, lambda name: [(part, shaken[name])]))
    assert len(computed) == 1
    alone = [certify(problem, shaken[name]) for name in shaken]
    for row, certificate in zip(rows, alone, strict=True):
        assert row.verdict == certificate.verdict.value == "BOUNDED"
        assert row.cost == pytest.approx(certificate.cost_upper, rel=1e-9)
        assert row.cost <= certificate.cost_upper
        assert row.lower_bound == pytest.approx(certificate.lower_bound, rel=1e-6)


def test_no_rows_follow_an_interruption():
    problem, best = optimum(0, 12, 3)
    stopped = Judge(problem, monitor=lambda _: True)
    part = JudgedPart(Instance("walk", problem.graph, np.arange(12)), problem, stopped)
    step = so.exp(0.01 * rng_of(0).standard_normal((12, 3)))  # a descent is needed
    shaken = Estimate(best.rotations @ step, best.translations)
    rows = list(judge_all(["one", "two"], lambda _: [(part, shaken)]))
    assert [row.estimate for row in rows] == ["one"]


def test_a_certified_optimum_refutes_all_others_without_another_search():
    instance, wound = winding_cycle(20, 0.1, 1)
    problem = Quadratic(instance.graph)
    judge = Judge(problem)
    first = judge.certify(certify(problem, wound).better)
    assert first.verdict is Verdict.CERTIFIED
    second = judge.certify(wound)
    assert second.verdict is Verdict.REFUTED
    assert second.better is first.refined
    assert second.lower_bound == first.lower_bound
    assert judge.certify(first.refined).verdict is Verdict.CERTIFIED


def test_what_cannot_be_read_is_a_row(tmp_path):
    problem, best = optimum(0, 8, 2)
    part = part_of(problem)

    def read(name):
        if name == "bad":
            raise InputError("bad:3: numbers\nexpected")
        return [(part, best)]

    rows = list(judge_all(["good", "bad", "good"], read))
    assert [row.verdict for row in rows] == ["CERTIFIED", "ERROR", "CERTIFIED"]
    assert rows[1].reason == "bad:3: numbers expected"
    path = tmp_path / "out.csv"
    write_rows(path, rows)
    header, first, second, _ = path.read_text().splitlines()
    assert header.split(",")[:3] == ["estimate", "graph", "verdict"]
    assert header.split(",")[-1] == "reason"
    assert float(first.split(",")[3]) == rows[0].cost
    distance = certify(problem, best).distance
    assert (rows[0].distance_m, rows[0].distance_deg) == pytest.approx(distance.largest, rel=0.5)
    assert (rows[2].distance_m, rows[2].distance_deg) == (rows[0].distance_m, rows[0].distance_deg)
    assert second == "bad,,ERROR" + "," * 16 + "bad:3: numbers expected"
    with pytest.raises(InputError, match="cannot be written"):
        write_rows(tmp_path / "nowhere" / "out.csv", rows)


def test_gaps_of_rotations_have_no_metres():
    problem, best = optimum(0, 8, 3)
    alone = Quadratic(problem.graph.rotations_alone)
    [row] = judge_all(["one"], lambda _: [(part_of(alone), Estimate(best.rotations))])
    assert row.mean_m is None
    assert row.worst_deg is not None

"""The zoo: ours is never false in a sample, and the zoo finds the faults that are known."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from strategies import pose_graph, rng_of, rotation_graph

from certpgo.graph import RotationGraph

pytest.importorskip("flint", reason="python-flint is not installed")

from certpgo.certify import Verdict
from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.judging import Judge
from reports.harness.certifiers import campaign, made, oracle, rules, search, summary, zoo
from reports.harness.certifiers.families import FAMILIES
from reports.harness.certifiers.opinions import Opinion, certifiers, tally_of
from reports.harness.certifiers.points import (
    Known,
    ZooPoint,
    stationary,
    truth_by_form,
    truth_by_oracle,
)
from reports.harness.experiments.journal import Journal, from_line, to_line
from reports.harness.experiments.zoo_records import ALL, BLOCK, FAULTS, ZooRecord, total

RULES = ("se_sync_rule", "cora_rule")


def only(prefix):
    return {name: certifier for name, certifier in certifiers().items() if name.startswith(prefix)}


def wound_case(n, winding, factor=1.0):
    problem, best, other = made.wound(n, 0.3, winding).rotations_problem()
    truth = truth_by_form(problem, best, 8.0 * n * math.sin(0.3 / (2 * n)) ** 2)
    truth = replace(truth, upper=factor * truth.upper, lower=factor * truth.lower)
    return ZooPoint("wound", problem.scaled(factor), other, truth)


@pytest.mark.parametrize("name", FAMILIES)
def test_ours_is_false_nowhere_in_a_family(name):
    judges = only("certpgo")
    cases = [c for c in FAMILIES[name](True) if c.problem.n <= 200][::20]
    tally = total(tally_of(case, judges) for case in cases)
    assert tally.faults == []
    assert tally.of("certpgo standard")["missed"] == 0
    assert tally.of("certpgo standard")["failed"] == 0


@pytest.mark.parametrize("kind", campaign.KINDS, ids=lambda kind: kind.name)
def test_ours_is_false_nowhere_in_random_instances(kind):
    judges, points = only("certpgo"), Counter()
    for seed in range(4):
        for cases in campaign.draws(kind, seed):
            for case in cases:
                tally = tally_of(case, judges)
                assert tally.faults == []
                points += tally.points
            shared = Judge(cases[0].problem)
            for case in cases[::-1]:
                certificate = shared.certify(case.point)
                assert certificate.lower_bound <= case.truth.upper
                if certificate.verdict is Verdict.CERTIFIED:
                    assert not case.is_beaten(case.point)
    assert points["optimal"] + points["not optimal"] >= 5


@pytest.mark.parametrize("seed", [382, 888])
def test_a_proof_holds_for_the_stored_matrices(seed):
    """Not only for the quaternions that the proof is about, rounding away from them."""
    for cases in campaign.draws(campaign.kind_called("up to four in the plane, random"), seed):
        problem = cases[0].problem
        certificate = Judge(problem, tier="proof").certify(cases[0].point)
        assert certificate.multipliers is None or oracle.is_proof(problem, certificate.multipliers)


def test_the_rules_accept_what_the_zoo_knows_to_be_wrong():
    judges = {name: certifiers()[name] for name in RULES}
    assert tally_of(wound_case(500, 1), judges).of("se_sync_rule")["false"] == 1
    scaled = tally_of(wound_case(60, 1, 2.0**-40), judges)
    assert [scaled.of(rule)["false"] for rule in RULES] == [1, 1]
    fine = tally_of(wound_case(60, 1), judges)
    assert [fine.of(rule)["not certified"] for rule in RULES] == [1, 1]


@pytest.mark.gtsam
def test_gtsam_accepts_wound_up_cycles():
    pytest.importorskip("gtsam", reason="the gtsam wheel is not installed")
    judges = only("gtsam")
    tally = tally_of(wound_case(1000, 1), judges)
    assert tally.of("gtsam_shonan")["false"] == tally.of("gtsam_staircase")["false"] == 1
    tally = tally_of(wound_case(20, 1), judges)
    assert (
        tally.of("gtsam_shonan")["not certified"]
        == tally.of("gtsam_staircase")["not certified"]
        == 1
    )


def always(opinion):
    return {"certpgo rigged": lambda problem, point: opinion(point)}


def test_every_fault_of_a_certifier_is_noticed():
    case = wound_case(20, 1)
    right = replace(case, point=made.wound(20, 0.3, 1).rotations_problem()[1])

    def outcomes(case, opinion):
        tally = tally_of(case, always(opinion))
        found = set(tally.of("certpgo rigged"))
        assert len(tally.faults) == len(found & set(FAULTS))
        return found

    assert "false" in outcomes(case, Opinion)
    assert "false bound" in outcomes(case, lambda p: Opinion(None, 1.001 * case.truth.upper))
    assert outcomes(case, lambda p: Opinion(None, case.truth.lower)) == {"not certified"}
    assert "false refutation" in outcomes(right, lambda p: Opinion(None, better=p))
    assert "false basin" in outcomes(case, lambda p: Opinion(None, basin=p))
    own = case.problem.multipliers(case.point)
    assert "false proof" in outcomes(case, lambda p: Opinion(None, multipliers=own))
    loosened = own - np.eye(3)
    assert "bound confirmed" in outcomes(case, lambda p: Opinion(None, multipliers=loosened))
    assert outcomes(right, lambda p: Opinion(None)) == {"not certified", "missed"}
    assert outcomes(right, Opinion) == {"certified"}
    loose = replace(right, truth=replace(right.truth, loose=True))
    assert outcomes(loose, lambda p: Opinion(None)) == {"not certified", "missed, loose"}
    shrunk = replace(right, point=Estimate.trusted(0.5 * right.point.rotations))
    assert "false" in outcomes(shrunk, Opinion)


def test_a_refusal_and_a_failure_are_told_apart():
    case = wound_case(20, 1)

    def refuse(point):
        raise InputError("not this")

    def fail(point):
        raise RuntimeError("broken")

    assert tally_of(case, always(refuse)).of("certpgo rigged")["refused"] == 1
    assert tally_of(case, always(fail)).of("certpgo rigged")["failed"] == 1


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("make", [rotation_graph, pose_graph])
def test_the_oracle_encloses_the_cost_and_proves_the_optimum(d, make):
    graph, *truth = make(rng_of(7), 6, d)
    problem = Quadratic(graph)
    best = stationary(problem, Estimate(*truth))
    low, high = oracle.cost(problem, best)
    assert low <= high <= low * (1.0 + 1e-14)
    assert problem.cost(best) == pytest.approx(low, rel=1e-12)
    found = truth_by_oracle(problem, best)
    assert found.known is Known.ORACLE
    assert not found.loose
    assert 0.0 < found.upper - found.lower < 1e-6 * found.upper


@pytest.mark.parametrize("d", [2, 3])
def test_the_oracle_agrees_with_closed_forms_and_proves_nothing_of_wound_up_points(d):
    ring = made.wound(12, 0.5, 1, d)
    problem, best, other = ring.rotations_problem()
    assert oracle.lower_bound(problem, best, 1e-6) == pytest.approx(ring.optimum, rel=1e-8)
    assert oracle.lower_bound(problem, other, 1e-6) == -math.inf


@pytest.mark.parametrize("seed", range(20))
def test_the_search_finds_what_no_descent_undercuts(seed):
    rng = rng_of(seed)
    n = 3 + seed % 2
    edges = np.argwhere(np.tri(n, k=-1).T)
    graph = RotationGraph(n, edges, so.random(rng, len(edges), 2), rng.uniform(0.5, 2, len(edges)))
    problem = Quadratic(graph)
    found = search.minimum(problem)
    starts = [Estimate(so.random(rng, n, 2)) for _ in range(10)]
    lowest = min(problem.cost(stationary(problem, start)) for start in starts)
    reached = problem.cost(stationary(problem, found.best))
    assert found.lower <= lowest * (1.0 + 1e-12)
    assert reached == pytest.approx(lowest, rel=1e-9)
    assert reached - found.lower < 1e-5 * reached


def test_the_search_refuses_what_is_too_large():
    for n, d in ((5, 2), (4, 3)):
        with pytest.raises(InputError, match="at most four"):
            search.minimum(made.wound(n, 0.3, 0, d).rotations_problem()[0])


@pytest.mark.parametrize("seed", range(12))
def test_dressing_keeps_the_optimum_and_what_is_stationary(seed):
    rng, d = rng_of(seed), 2 + seed % 2
    ring = made.wound(5 + seed, 0.4, 1, d)
    if seed % 3 == 0:
        ring = made.wound_weighted(rng.uniform(1.0, 3.0, 9), 1.4, -1, d)
    other = made.joined(ring, made.wound(6, -0.3, -1, d), bridge=3.0 if seed % 2 else None)
    dressed = made.with_parallels(made.with_tree(other, 3, 0.1, rng), rng)
    dressed = made.relabelled(dressed, rng)
    tau = rng.uniform(0.1, 10.0, dressed.graph.num_edges)
    for problem, best, wound in (dressed.rotations_problem(), dressed.poses_problem(tau)):
        assert problem.cost(best) == pytest.approx(dressed.optimum, rel=1e-9)
        assert problem.cost(wound) > 1.01 * dressed.optimum
        assert problem.stationarity(best) < 1e-12
        assert problem.stationarity(wound) < 1e-12
        assert truth_by_oracle(problem, best).known is Known.ORACLE


def test_instances_are_functions_of_their_seed():
    kind = campaign.kind_called("noise, random")
    first, again = (next(campaign.draws(kind, 3))[0] for _ in range(2))
    assert first.truth == again.truth
    assert np.array_equal(first.point.rotations, again.point.rotations)
    other = next(campaign.draws(kind, 4))[0]
    assert other.truth != first.truth


def test_a_campaign_has_at_least_as_many_instances_as_asked_for():
    counted = [0, 0]
    for _, first in campaign.blocks(10_000):
        counted[0] += BLOCK
        counted[1] += first == 0
    assert counted[0] >= 10_000
    assert counted[1] == len(campaign.KINDS)
    assert sum(kind.share for kind in campaign.KINDS) == pytest.approx(1.0)


def test_a_run_goes_on_and_its_report_is_a_function_of_its_records(tmp_path, monkeypatch):
    names = ("no rotations: reflected, scaled", "near ties")
    wanted = [zoo.Job(name, quick=True) for name in names]
    made_here = []

    def serial(jobs, workers):
        for job in jobs:
            made_here.append(job)
            yield job, zoo.record_of(job)

    monkeypatch.setattr(zoo, "_made", serial)
    records = list(zoo.run_jobs(Journal(tmp_path, "zoo", ZooRecord), wanted[:1]))
    records = list(zoo.run_jobs(Journal(tmp_path, "zoo", ZooRecord), wanted))
    assert made_here == wanted
    text = summary.zoo_markdown(records)
    assert text == summary.zoo_markdown(
        [from_line(to_line(record), ZooRecord) for record in records]
    )
    assert "| near ties | 60 | 36 | 24 | closed form | 36 / 0 / 0 |" in text
    assert "| no rotations: reflected, scaled | 20 | 0 | 0 | closed form | – |" in text  # noqa: RUF001
    assert "Where certpgo is false" not in text
    false = replace(records[0], faults=["seed 1: certpgo standard: false"])
    assert "Where certpgo is false" in summary.zoo_markdown([false])
    full = [replace(wanted[0], quick=False)]
    monkeypatch.setattr(zoo, "certifiers", dict)
    list(zoo.run_jobs(Journal(tmp_path, "zoo", ZooRecord), full))
    assert made_here[-1] == full[0]  # another profile, other certifiers: not the same record


def test_a_block_counts_what_its_instances_are():
    kind = replace(campaign.kind_called("wound-up, random"), share=1.0)
    tally = campaign.block(kind, 0, {})
    assert tally.faults == []
    assert tally.instances[ALL] == BLOCK
    assert tally.instances["closed form"] == BLOCK
    assert tally.points["not optimal"] >= BLOCK


def test_poses_at_one_place_cost_what_their_rotations_do():
    problem, best, _ = made.wound(8, 0.3, 1).poses_problem(np.full(8, 2.0))
    assert problem.has_positions
    assert oracle.cost(problem, best)[1] == pytest.approx(made.wound(8, 0.3, 0).optimum)


def test_competitors_are_files_of_a_folder():
    assert set(RULES) <= set(rules.rule_names())
